"""Surfaces without node ids: STL, OBJ, NPZ; and displacements between two of one connectivity."""

import dataclasses
import pathlib
import re

import numpy as np

from jaxmorph._host.package.files import read_arrays, real_array

from .._host.surface.gaps import closest, fans
from .text.sections import parse, scan


@dataclasses.dataclass(frozen=True, eq=False)
class Shape:
    """`points` (p, 2 or 3), and `simplices`: triangles (t, 3), or a curve's segments (t, 2)."""

    points: np.ndarray
    simplices: np.ndarray


def read_shape(path: pathlib.Path) -> Shape:
    """Reads a surface: .stl (text, binary), .obj (faces, lines), .npz (points with either).

    It raises `ValueError` for other endings and contents, and for simplices beyond the points.
    """
    readers = {".stl": _stl, ".obj": _obj, ".npz": _npz}
    if path.suffix.lower() not in readers:
        raise ValueError(f"{path}: a surface is read from {', '.join(readers)}, found the ending {path.suffix!r}.")
    shape = readers[path.suffix.lower()](path)
    if not len(shape.simplices) or shape.points.ndim != 2 or not np.isfinite(shape.points).all():
        contents = f"{len(shape.simplices)} faces between points of shape {shape.points.shape}"
        raise ValueError(f"{path}: not a surface, or a damaged one: {contents}, all finite, expected.")
    if shape.simplices.min() < 0 or shape.simplices.max() >= len(shape.points):
        raise ValueError(f"{path}: a face names a point that is not among the {len(shape.points)} of this file.")
    return shape


def _stl(path: pathlib.Path) -> Shape:
    data = path.read_bytes()
    count = int.from_bytes(data[80:84], "little")
    if len(data) == 84 + 50 * count and count:
        facets = np.frombuffer(data, np.dtype([("n", "<f4", 3), ("x", "<f4", (3, 3)), ("a", "<u2")]), count, 84)
        points = facets["x"].reshape(-1, 3).astype(float)
    else:
        values = parse(b" ".join(re.findall(rb"vertex\s([^\r\n]*)", data)), np.float64)
        if len(values) % 9:
            raise ValueError(f"{path}: {len(values)} coordinates of vertices are no whole number of triangles.")
        points = values.reshape(-1, 3)
    return Shape(points, np.arange(len(points)).reshape(-1, 3))


def _obj(path: pathlib.Path) -> Shape:
    data = path.read_bytes()
    rows = re.findall(rb"^v\s+(\S+\s+\S+\s+\S+)", data, re.MULTILINE)
    values = parse(b" ".join(rows), np.float64)
    if len(values) != 3 * len(rows):
        raise ValueError(f"{path}: a vertex holds something that is not a number.")
    points = values.reshape(-1, 3)
    for mark, corners in ((b"f", 3), (b"l", 2)):
        text = b"\n".join(re.findall(rb"^" + mark + rb"\s+([^\r\n]*)", data, re.MULTILINE))
        if text.strip():
            text = re.sub(rb"/\S*", b"", text)
            ids, counts = parse(text, np.int64), scan(text)[2]
            if len(ids) != counts.sum() or (counts < corners).any() or (ids < 1).any():
                raise ValueError(f"{path}: faces and lines need the numbers, from 1, of {corners} vertices or more.")
            return Shape(points, fans(ids - 1, counts) if corners == 3 else _chains(ids - 1, counts))
    return Shape(points, np.zeros((0, 3), np.int64))


def _chains(ids: np.ndarray, counts: np.ndarray) -> np.ndarray:
    pairs = np.stack([ids[:-1], ids[1:]], axis=1)
    return np.delete(pairs, np.cumsum(counts)[:-1] - 1, axis=0)


def _npz(path: pathlib.Path) -> Shape:
    arrays = read_arrays(path)
    kind = next((name for name in ("triangles", "lines") if name in arrays), None)
    if kind is None or "points" not in arrays:
        raise ValueError(
            f"{path}: arrays points, and triangles or lines, expected; found {', '.join(arrays) or 'none'}."
        )
    corners = 3 if kind == "triangles" else 2
    if arrays[kind].dtype.kind not in "iu" or arrays[kind].ndim != 2 or arrays[kind].shape[1] != corners:
        found = f"{arrays[kind].dtype} of shape {arrays[kind].shape}"
        raise ValueError(f"{path}: {kind} must be whole numbers (k, {corners}), found {found}.")
    return Shape(real_array(path, arrays, "points"), arrays[kind].astype(np.int64))


def carried(before: Shape, values: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Interpolates `values` (p, k) of `before` at its places closest to `x` (m, d); with distances.

    It is linear on each triangle or segment, and exact at its corners.
    """
    simplex, weights, distance = closest(before.points[before.simplices][..., : x.shape[1]], x)
    return np.einsum("mc,mck->mk", weights, values[before.simplices[simplex]]), distance
