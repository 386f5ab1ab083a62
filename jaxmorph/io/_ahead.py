"""Reading in a process of its own, beside the imports of the process that wants the mesh.

Imports and NumPy's reading of text both hold Python's lock: a thread beside them gains nothing.
"""

import os
import pickle
import signal
import sys
import warnings
from typing import Any, BinaryIO

from jaxmorph._host.package.cores import cores

_begun: dict[str, tuple[int, BinaryIO]] = {}
"""The process that reads a file, and the pipe from which its mesh comes."""


def begin(path: str | os.PathLike[str]) -> None:
    """Begins to read a mesh in a child of this process, if that can help.

    It cannot on one core, or after imports. On Linux alone a process may have a child safely, as
    long as it has no threads: so not once NumPy is imported.
    """
    if sys.platform != "linux" or "numpy" in sys.modules or cores() < 2:
        return
    reader, writer = os.pipe()
    try:
        child = os.fork()
    except OSError:  # a limit to processes or memory
        os.close(reader)
        os.close(writer)
        return
    if not child:
        os.close(reader)  # or the child would wait for itself where its parent has ended
        _send(path, writer)
    os.close(writer)
    _begun[os.fspath(path)] = child, os.fdopen(reader, "rb")


def _send(path: str | os.PathLike[str], writer: int) -> None:
    """Reads a mesh, sends it, and ends this process. Nothing is sent after a warning or error."""
    try:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        nowhere = os.open(os.devnull, os.O_RDWR)
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        from jaxmorph._host.package.files import input_path

        from ._reading import file_mesh

        with warnings.catch_warnings(record=True) as told:
            mesh = file_mesh(input_path(path))
        if not told:
            with os.fdopen(writer, "wb") as pipe:
                pickle.dump(mesh, pipe, protocol=5)
    finally:
        os._exit(0)


def taken(path: str | os.PathLike[str]) -> Any:
    """Returns the mesh that a child has read of a file; None if the caller has to read it.

    Where a child has failed the caller does so too, and tells what is wrong.
    """
    child, pipe = _begun.pop(os.fspath(path), (0, None))
    if pipe is None:
        return None
    try:
        with pipe:
            return pickle.load(pipe)
    except (EOFError, pickle.UnpicklingError):
        return None
    finally:
        os.waitpid(child, 0)
