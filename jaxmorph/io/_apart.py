"""VTK in a process of its own, which a damaged file may end: it ends nothing else."""

import multiprocessing.spawn
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

MEMORY_OF_A_FILE = 4 * 10**8
MEMORY_OF_A_BYTE = 200
"""Bytes of memory that any file may need, and that a byte of it may need."""


def run_apart(path: Path, size: int, folder: str) -> bytes:
    """Runs `_apart_script.py` on a file of so many bytes, and returns what it prints.

    Raises `ValueError` for a process that ended by a signal, or with a message.
    """
    most = MEMORY_OF_A_FILE + MEMORY_OF_A_BYTE * size
    script = Path(__file__).with_name("_apart_script.py")
    python = os.fsdecode(multiprocessing.spawn.get_executable() or "")
    # this process may be another program that has Python in it
    if "py" not in Path(python).name.lower():
        python = shutil.which("python3") or "python3"
    words = [python, "-P", str(script), str(path.absolute()), folder, str(most)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run(
        words, capture_output=True, stdin=subprocess.DEVNULL, env=environment, check=False
    )
    if done.returncode < 0:
        name = signal.Signals(-done.returncode).name
        raise ValueError(
            f"a damaged file (its reader ended by {name}, or would have taken {most / 1e6:.0f} MB)."
        )
    if done.returncode:
        why = done.stderr.decode(errors="replace").strip().split("\n")[-1]
        raise ValueError(f"no mesh that VTK reads, or a damaged one ({why[:300]}).")
    return done.stdout
