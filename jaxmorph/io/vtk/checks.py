"""What VTK does not check of a file, and how its errors are told."""

import contextlib
import re
from collections.abc import Iterator

import numpy as np

from jaxmorph._mesh import vtk

from .._text import parse


def numbers(text: bytes, kind: str) -> np.ndarray:
    dtype = np.dtype(kind)
    if b"d" in text or b"D" in text:
        raise ValueError("an exponent of Fortran's, which VTK does not know")
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


def check_ends(ends: np.ndarray, count: int, name: str) -> None:
    """Raises `ValueError` for lists that do not end, one after the other, with `count` numbers."""
    last = int(ends[-1]) if len(ends) else 0
    if last != count or (np.diff(ends.astype(np.int64), prepend=0) < 0).any():
        raise ValueError(f"{count} numbers in {name}, {last} expected: a damaged file, or one cut short.")


@contextlib.contextmanager
def errors_told() -> Iterator[None]:
    """Raises `ValueError` for VTK's first error, which VTK would print on the terminal."""
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
