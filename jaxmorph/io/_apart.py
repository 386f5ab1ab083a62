"""Other libraries in a process of their own, which a damaged file may end: it ends nothing else."""

import multiprocessing.spawn
import os
import pathlib
import signal
import subprocess
from typing import Any

SMALL, UNPACKED = 4 * 10**8, 200
"""Bytes of memory that any file may need, and that a byte of it may need."""


def run_apart(script: str, size: int, *words: Any) -> bytes:
    """Runs a script of this package on a file of so many bytes, and returns what it prints.

    The script's words end with the memory that it may take, in bytes. Raises `ValueError` for a
    process that ended by a signal, or with a message.
    """
    most = SMALL + UNPACKED * size
    program = os.fsdecode(multiprocessing.spawn.get_executable())
    call = [program, "-P", str(pathlib.Path(__file__).with_name(script)), *map(str, words), str(most)]
    done = subprocess.run(call, capture_output=True, stdin=subprocess.DEVNULL, check=False)
    if done.returncode < 0:
        name = signal.Signals(-done.returncode).name
        raise ValueError(f"a damaged file (its reader ended by {name}, or would have taken {most / 1e6:.0f} MB).")
    if done.returncode:
        why = done.stderr.decode(errors="replace").strip().split("\n")[-1]
        raise ValueError(f"no mesh in this file, or a damaged one ({why[:300]}).")
    return done.stdout
