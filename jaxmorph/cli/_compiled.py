"""JAX as the commands use it: double precision, and compiled code that is kept between runs."""

import os

import jax

from jaxmorph._kernels.kept import is_off, keep, machine

LIMIT = 256 * 2**20
"""Bytes that the folder holds at most; the program that was used longest ago goes first."""


def begin(is_own: bool) -> None:
    """Switches double precision on, and the cache of compiled code.

    `is_own` says that the process runs this command alone.
    """
    jax.config.update("jax_enable_x64", True)
    keep_compiled(is_own)


def keep_compiled(is_own: bool = False) -> None:
    """Turns on JAX's persistent compilation cache in the user's cache folder.

    A process of its own also keeps whole programs there.

    Nothing is kept if `JAXMORPH_CACHE` is `off`, if JAX has a folder already, if the folder cannot
    be written to, or without the packages that find and lock it.
    """
    if is_off() or jax.config.values["jax_compilation_cache_dir"]:
        return
    try:
        import filelock  # noqa: F401  JAX locks the folder with it
        import platformdirs
    except ImportError:
        return
    folder = platformdirs.user_cache_path("jaxmorph") / "compiled" / machine()
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    except OSError:
        return
    if os.access(folder, os.W_OK):
        jax.config.update("jax_compilation_cache_dir", str(folder))
        jax.config.update("jax_compilation_cache_max_size", LIMIT)
        # reading takes a tenth of the shortest compilation
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
        if is_own:
            keep(str(folder), LIMIT)
