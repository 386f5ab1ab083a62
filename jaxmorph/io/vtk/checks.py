"""What VTK does not check of a file, and how its errors are told."""

import contextlib
import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from jaxmorph._mesh import vtk

from .._text import parse


def check_nodes(data: Any, announced: int) -> None:
    """Raises `ValueError` for cells that have other numbers of nodes than their file."""
    nodes = sum(cells.GetNumberOfConnectivityIds() for cells in vtk.cell_arrays(data) if cells)
    if announced != nodes:
        raise ValueError(f"{announced} numbers in connectivity, {nodes} expected: a damaged file.")


def numbers(text: bytes, kind: str) -> np.ndarray:
    """Reads a text's numbers. Raises `ValueError` for numbers that the type cannot hold."""
    dtype = np.dtype(kind)
    values = parse(
        text, {"f": np.float64, "u": np.uint64 if dtype.itemsize == 8 else np.int64}.get(dtype.kind, np.int64)
    )
    if dtype.kind == "f":
        limit = float(np.finfo(dtype).max)
        is_wrong = (np.abs(values) > limit) & (np.isfinite(values) if b"inf" in text.lower() else True)
    else:
        is_wrong = (values < np.iinfo(dtype).min) | (values > np.iinfo(dtype).max)
    if is_wrong.any():
        raise ValueError(f"a number beyond the range of its type, {dtype.name}")
    return values


def check_streams(numbers: np.ndarray, begins: np.ndarray, ends: np.ndarray) -> None:
    """Raises `ValueError` where numbers are not faces of polyhedra: counts, and nodes."""
    # All polyhedra are gone through together: round k looks at face k of each that has as many.
    if (begins >= ends).any():
        raise ValueError("a polyhedron without faces")
    faces, at = numbers[begins].astype(np.int64), begins.astype(np.int64) + 1
    if (faces < 0).any() or (faces > ends - begins).any():
        raise ValueError(f"a polyhedron of {faces.max()} faces")
    left = np.arange(len(at))
    for turn in range(int(faces.max(initial=0))):
        left = left[faces[left] > turn]
        if (at[left] >= ends[left]).any():
            raise ValueError("a polyhedron has fewer faces than it says")
        size = numbers[at[left]]
        if (size < 1).any() or (size >= ends[left] - at[left]).any():
            raise ValueError(f"a face of a polyhedron has {size.min()} to {size.max()} nodes")
        at[left] += 1 + size
    if (at != ends).any():
        raise ValueError("a polyhedron has more numbers than its faces need")


def check_lists(ends: np.ndarray, ids: np.ndarray, count: int) -> None:
    """Raises `ValueError` for lists, up to `ends`, that are not all `ids`, each below `count`."""
    if (np.diff(ends, prepend=0) < 0).any() or (ends[-1] if len(ends) else 0) != len(ids):
        raise ValueError(f"lists of polyhedra that do not end with their {len(ids)} numbers")
    if len(ids) and not 0 <= ids.min() <= ids.max() < count:
        raise ValueError(f"lists of polyhedra name {ids.min()} to {ids.max()}, of {count}")


@contextlib.contextmanager
def errors_told() -> Iterator[None]:
    """Raises `ValueError` for the first error that VTK tells, which else goes to the terminal."""
    core = vtk.vtk("vtkCommonCore")
    told, window = core.vtkStringOutputWindow(), core.vtkOutputWindow.GetInstance()
    verbosity = core.vtkLogger.GetCurrentVerbosityCutoff()
    shows = core.vtkObject.GetGlobalWarningDisplay()
    core.vtkObject.GlobalWarningDisplayOn()
    core.vtkOutputWindow.SetInstance(told)
    core.vtkLogger.SetStderrVerbosity(core.vtkLogger.VERBOSITY_OFF)
    try:
        yield
    finally:
        core.vtkOutputWindow.SetInstance(window)
        core.vtkLogger.SetStderrVerbosity(verbosity)
        core.vtkObject.SetGlobalWarningDisplay(shows)
    text = told.GetOutput()
    text = text if isinstance(text, str) else text.decode(errors="replace")  # it may quote bytes of the file
    errors = re.findall(r"(?:ERROR|Warning): In .*\n(?:\w+ \(0x[0-9a-f]+\): )?((?:.+\n)+)", text)
    if errors:
        raise ValueError(f"a damaged file, or one cut short ({' '.join(errors[0].split())[:200]}).")
