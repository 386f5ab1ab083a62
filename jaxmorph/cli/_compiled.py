"""JAX as the commands use it: double precision, and a cache of compiled code on disk."""

import hashlib
import os
import pathlib
import platform
from typing import Any

import jax

LIMIT = 256 * 2**20
"""Bytes in the cache at most; what was used longest ago goes first."""


def begin() -> None:
    """Switches double precision on, and JAX's compilation cache, in the user's cache folder.

    There is no cache if JAX has a folder already, if the folder is missing or open to other users,
    or without the packages that find and lock it.
    """
    config: Any = jax.config
    config.update("jax_enable_x64", True)
    if config.jax_compilation_cache_dir:
        return
    try:
        import filelock  # noqa: F401  JAX locks the folder with it
        import platformdirs

        folder = platformdirs.user_cache_path("jaxmorph") / "compiled" / _machine()
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        is_private = _is_private(folder)
    except (ImportError, OSError):
        return
    if is_private:
        config.update("jax_compilation_cache_dir", str(folder))
        config.update("jax_compilation_cache_max_size", LIMIT)
        config.update("jax_persistent_cache_min_compile_time_secs", 0)  # reading takes a tenth of any compilation


def _is_private(folder: pathlib.Path) -> bool:
    """Checks whether this user alone can write to a folder: machine code in it may do anything."""
    about = folder.stat()
    is_mine = os.name != "posix" or (about.st_uid == os.getuid() and not about.st_mode & 0o022)
    return is_mine and os.access(folder, os.W_OK)


def _machine() -> str:
    """Names the kind of processor, on which another kind's code may not run."""
    facts = [platform.machine()]
    try:
        lines = pathlib.Path("/proc/cpuinfo").read_text().splitlines()
        facts += sorted({line for line in lines if line.startswith(("model name", "flags", "Features", "CPU part"))})
    except OSError:
        pass
    return hashlib.sha256("\n".join(facts).encode()).hexdigest()[:16]
