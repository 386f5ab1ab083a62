"""Memory of a process of tests: compiled code is dropped where it fills memory, so that a worker stays near 1.5 GB."""

import contextlib
import ctypes
import gc
import os
import pathlib

import equinox as eqx
import jax

MORE = 0.25e9
"""Memory that compiled code may take before it is dropped, bytes."""
EMPTIED = [0.5e9]
"""Memory of this process after compiled code was dropped last, bytes."""


def drop_compiled() -> None:
    """Drops compiled code where it fills memory."""
    if resident() > EMPTIED[0] + MORE:
        eqx.clear_caches()
        jax.clear_caches()
        gc.collect()
        with contextlib.suppress(OSError, AttributeError):  # glibc alone has it
            ctypes.CDLL(None).malloc_trim(0)
        EMPTIED[0] = resident()


def resident() -> int:
    """Memory of this process, bytes; 0 where the system does not tell."""
    try:
        pages = pathlib.Path("/proc/self/statm").read_text().split()[1]
    except OSError:
        return 0
    return int(pages) * os.sysconf("SC_PAGE_SIZE")
