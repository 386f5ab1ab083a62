"""Displacements of a mesh's moving nodes from a file, or from two surfaces (STL, OBJ, NPZ)."""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from jaxmorph import Facets, Mesh
from jaxmorph._host.package.arguments import checked
from jaxmorph._host.package.files import input_path, read_arrays, real_array
from jaxmorph._host.surface.gaps import closest, fans

from ._format import faults_of
from ._registry import read
from ._surface import in_order, read_named, read_surface
from ._text import PathLike, parse, scan

SHAPES = (".stl", ".obj")
OFF = 0.01
"""Distance of a moving node off the surface, as a share of its bounding box's diagonal."""


@checked
def read_displacement(
    path: PathLike,
    mesh: Mesh,
    moving: Int[ndarray, " m"],
    *,
    before: PathLike | None = None,
    is_position: bool = True,
) -> Float[ndarray, "m d"]:
    """Reads the displacement of each of the nodes `moving`, in their order.

    With `before` it goes from one surface to another of the same points in the same order (.stl,
    .obj, or .npz of `points` and `triangles`, in 2-D `lines`). Each node takes the displacement of
    the closest place of `before`. Without `before` it goes by node id. The file is a table `id, x,
    y[, z]` (SU2's `surface_*.dat`, .csv), or .npz of `displacement` or `position` and `ids`
    (default: in the order of `moving`).

    **Arguments:**

    - `path`: the file, or the surface after the motion.
    - `mesh`: the mesh; `mesh.points` is undeformed.
    - `moving`: ids (m,) of the moving nodes.
    - `before`: the surface before the motion. Default: none.
    - `is_position`: a table holds new positions (True, default) or displacements.

    **Returns:** displacements (m, d) in the unit of the mesh.

    **Raises:** `ValueError` for missing or foreign nodes, surfaces of different connectivity, and
    nodes off the surface `before` by more than 0.01 of its size.
    """
    path, moving = input_path(path), np.asarray(moving)
    points = np.asarray(mesh.points)
    if before is not None:
        return _between(input_path(before), path, points[moving])
    of_file, d = getattr(mesh.source, "node_ids", None), points.shape[1]
    numbers = moving if of_file is None else of_file[moving]
    with faults_of(path):
        if path.suffix.lower() in SHAPES:
            raise ValueError("a surface without node ids; give the surface before the motion too.")
        if path.suffix.lower() == ".npz":
            ids, values, name = read_named(path, ("displacement", "position"), numbers)
            is_position = name == "position"
        else:
            ids, values = read_surface(path, d)
        values = in_order(ids, values, d, numbers, (numbers, "the moving patches"))
    return values - points[moving] if is_position else values


@checked
def read_facets(path: PathLike, d: int = 3, *, smooth: bool = False) -> Facets:
    """Reads a surface in 3-D, a curve in 2-D: a scan, or the tessellation of a CAD model.

    **Arguments:**

    - `path`: .stl, .obj, .npz of `points` and `triangles` (2-D: `lines`), or a mesh, of which its
      faces count, else its boundary.
    - `d`: 2 takes x and y of .obj. Default 3.
    - `smooth`: as `Facets` takes it.

    **Raises:** `ValueError` for a damaged file, and for triangles in 2-D or lines in 3-D.
    """
    path = input_path(path)
    if path.suffix.lower() not in READERS:
        return Facets.of(read(path), smooth=smooth)
    shape = read_shape(path)
    if shape.points.shape[1] < d or shape.simplices.shape[1] != d:
        found = f"faces of {shape.simplices.shape[1]} points in {shape.points.shape[1]}-D"
        raise ValueError(f"{path}: {'lines' if d == 2 else 'triangles'} in {d}-D are expected, found {found}.")
    return Facets(shape.points[:, :d], shape.simplices, smooth=smooth)


def _between(before: Path, after: Path, x: ndarray) -> ndarray:
    old, new = read_shape(before), read_shape(after)
    if old.points.shape != new.points.shape or not np.array_equal(old.simplices, new.simplices):
        sizes = " and ".join(f"{len(surface.points)} points, {len(surface.simplices)} faces" for surface in (old, new))
        raise ValueError(f"{before} and {after} differ in connectivity: {sizes}.")
    d = x.shape[1]
    if old.points.shape[1] < d or (old.simplices.shape[1] != d and d == 2):
        raise ValueError(f"{before}: a mesh in {d}-D takes {'lines of OBJ or NPZ' if d == 2 else 'a surface in 3-D'}.")
    # linear on each triangle or segment, and exact at its corners
    simplex, weights, distance = closest(old.points[old.simplices][..., :d], x)
    values = np.einsum("mc,mck->mk", weights, (new.points - old.points)[old.simplices[simplex], :d])
    limit = OFF * np.linalg.norm(np.ptp(old.points, axis=0))
    off = np.flatnonzero(distance > limit)
    if off.size:
        place = ", ".join(f"{value:.4g}" for value in x[distance.argmax()])
        raise ValueError(
            f"{before}: {off.size} of {len(x)} moving nodes are off this surface by more than {limit:.3g}, at most by "
            f"{distance.max():.3g} near ({place}). Does the surface have the mesh's units and origin?"
        )
    return values


class Simplices(NamedTuple):
    """`points` (p, 2 or 3), and `simplices`: triangles (t, 3), or a curve's segments (t, 2)."""

    points: ndarray
    simplices: ndarray


def read_shape(path: Path) -> Simplices:
    """Reads a surface: .stl (text, binary), .obj (faces, lines), .npz (points with either)."""
    with faults_of(path):
        if path.suffix.lower() not in READERS:
            raise ValueError(f"a surface is read from {', '.join(READERS)}, found the ending {path.suffix!r}.")
        points, simplices = READERS[path.suffix.lower()](path)
        if not len(simplices) or points.ndim != 2 or not np.isfinite(points).all():
            contents = f"{len(simplices)} faces between points of shape {points.shape}"
            raise ValueError(f"not a surface, or a damaged one: {contents}, all finite, expected.")
        if simplices.min() < 0 or simplices.max() >= len(points):
            raise ValueError(f"a face names a point that is not among the {len(points)} of this file.")
        return Simplices(points, simplices)


def _stl(path: Path) -> Simplices:
    data = path.read_bytes()
    count = int.from_bytes(data[80:84], "little")
    if len(data) == 84 + 50 * count and count:
        facets = np.frombuffer(data, np.dtype([("n", "<f4", 3), ("x", "<f4", (3, 3)), ("a", "<u2")]), count, 84)
        points = facets["x"].reshape(-1, 3).astype(float)
    else:
        values = parse(b" ".join(re.findall(rb"vertex\s([^\r\n]*)", data)), np.float64)
        if len(values) % 9:
            raise ValueError(f"{len(values)} coordinates of vertices are no whole number of triangles.")
        points = values.reshape(-1, 3)
    return Simplices(points, np.arange(len(points)).reshape(-1, 3))


def _obj(path: Path) -> Simplices:
    data = path.read_bytes()
    rows = re.findall(rb"^v\s+(\S+\s+\S+\s+\S+)", data, re.MULTILINE)
    values = parse(b" ".join(rows), np.float64)
    if len(values) != 3 * len(rows):
        raise ValueError("a vertex holds something that is not a number.")
    points = values.reshape(-1, 3)
    for mark, corners in ((b"f", 3), (b"l", 2)):
        text = b"\n".join(re.findall(rb"^" + mark + rb"\s+([^\r\n]*)", data, re.MULTILINE))
        if text.strip():
            text = re.sub(rb"/\S*", b"", text)
            ids, counts = parse(text, np.int64), scan(text)[2]
            if len(ids) != counts.sum() or (counts < corners).any() or (ids < 1).any():
                raise ValueError(f"faces and lines need the numbers, from 1, of {corners} vertices or more.")
            return Simplices(points, fans(ids - 1, counts) if corners == 3 else _chains(ids - 1, counts))
    return Simplices(points, np.zeros((0, 3), np.int64))


def _chains(ids: ndarray, counts: ndarray) -> ndarray:
    pairs = np.column_stack([ids[:-1], ids[1:]])
    return np.delete(pairs, np.cumsum(counts)[:-1] - 1, axis=0)


def _npz(path: Path) -> Simplices:
    arrays = read_arrays(path)
    kind = next((name for name in ("triangles", "lines") if name in arrays), "")
    if not kind or "points" not in arrays:
        listed = ", ".join(arrays) or "none"
        raise ValueError(f"arrays points, and triangles or lines, expected; found {listed}.")
    simplices, corners = arrays[kind], 3 if kind == "triangles" else 2
    if simplices.dtype.kind not in "iu" or simplices.ndim != 2 or simplices.shape[1] != corners:
        found = f"{simplices.dtype} of shape {simplices.shape}"
        raise ValueError(f"{kind} must be whole numbers (k, {corners}), found {found}.")
    return Simplices(real_array(path, arrays, "points"), simplices.astype(np.int64))


READERS = {".stl": _stl, ".obj": _obj, ".npz": _npz}
