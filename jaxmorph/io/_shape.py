"""Surfaces without node ids: STL, OBJ, NPZ; and displacements between two of one connectivity."""

import dataclasses
import pathlib
import re

import numpy as np
from scipy import spatial

from jaxmorph._host.package.files import read_arrays, real_array

from .text.sections import parse, scan

BLOCK = 1 << 12
"""Points looked for together."""
NEAR = 8
"""Nearest simplices that bound the distance to all others."""


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
            return Shape(points, _fans(ids - 1, counts) if corners == 3 else _chains(ids - 1, counts))
    return Shape(points, np.zeros((0, 3), np.int64))


def _fans(ids: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Cuts polygons into triangles about their first corner."""
    first = np.cumsum(counts) - counts
    owner = np.repeat(np.arange(len(counts)), counts - 2)
    step = np.arange(len(owner)) - np.repeat(np.cumsum(counts - 2) - counts + 2, counts - 2)
    return np.stack([ids[first[owner]], ids[first[owner] + step + 1], ids[first[owner] + step + 2]], axis=1)


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
    d = x.shape[1]
    corners = before.points[before.simplices][..., :d]
    centre = corners.mean(axis=1)
    radius = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
    # simplices of one size together: one ball around a point then holds all that can be closest
    level = np.floor(np.log2(np.maximum(radius, radius.max() * 1e-9)))
    groups = [np.flatnonzero(level == value) for value in np.unique(level)]
    trees = [(group, spatial.KDTree(centre[group]), radius[group].max()) for group in groups]
    result, distances = np.empty((len(x), values.shape[1])), np.empty(len(x))
    for at in range(0, len(x), BLOCK):
        block = slice(at, at + BLOCK)
        pairs = _candidates(trees, corners, x[block])
        weights, distance = _closest(corners[pairs[1]], x[block][pairs[0]])
        order = np.lexsort((distance, pairs[0]))
        best = order[np.unique(pairs[0][order], return_index=True)[1]]
        at_corners = values[before.simplices[pairs[1][best]]]
        result[block] = np.einsum("mc,mck->mk", weights[best], at_corners)
        distances[block] = distance[best]
    return result, distances


def _candidates(trees: list, corners: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs rows of `x` with the simplices that may be the closest ones to them."""
    bound = np.full(len(x), np.inf)
    for group, tree, _ in trees:
        count = min(NEAR, len(group))
        near = group[np.asarray(tree.query(x, k=count)[1]).reshape(len(x), count)]
        rows = np.repeat(np.arange(len(x)), count)
        distance = _closest(corners[near.ravel()], x[rows])[1].reshape(len(x), count)
        bound = np.minimum(bound, distance.min(axis=1))
    rows, simplices = [], []
    for group, tree, radius in trees:
        balls = tree.query_ball_point(x, (bound + radius) * (1 + 1e-9))
        rows.append(np.repeat(np.arange(len(x)), [len(ball) for ball in balls]))
        simplices.append(group[np.concatenate([np.zeros(0, np.int64), *map(np.asarray, balls)]).astype(np.int64)])
    return np.concatenate(rows), np.concatenate(simplices)


def _closest(corners: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Computes weights (m, c) of corners (m, c, d) at each simplex' place closest to `x`.

    The distance comes with them.
    """
    if corners.shape[1] == 2:
        weights = _on_segment(corners[:, 0], corners[:, 1], x)
        return weights, np.linalg.norm(np.einsum("mc,mcd->md", weights, corners) - x, axis=1)
    a, b, c = np.moveaxis(corners, 1, 0)
    choices = []
    for i, j in ((0, 1), (1, 2), (2, 0)):
        weights = np.zeros((len(x), 3))
        weights[:, [i, j]] = _on_segment(corners[:, i], corners[:, j], x)
        choices.append(weights)
    u, v, w = b - a, c - a, x - a
    uu, uv, vv, wu, wv = (np.einsum("md,md->m", p, q) for p, q in ((u, u), (u, v), (v, v), (w, u), (w, v)))
    area = uu * vv - uv**2
    size = np.where(area > 0, area, 1)
    s, t = (vv * wu - uv * wv) / size, (uu * wv - uv * wu) / size
    inside = (area > 0) & (s >= 0) & (t >= 0) & (s + t <= 1)
    choices.append(np.where(inside[:, None], np.stack([1 - s - t, s, t], axis=1), choices[0]))
    stacked = np.stack(choices)
    distance = np.linalg.norm(np.einsum("emc,mcd->emd", stacked, corners) - x, axis=2)
    best = distance.argmin(axis=0), np.arange(len(x))
    return stacked[best], distance[best]


def _on_segment(a: np.ndarray, b: np.ndarray, x: np.ndarray) -> np.ndarray:
    along = b - a
    length = np.einsum("md,md->m", along, along)
    t = np.einsum("md,md->m", x - a, along) / np.where(length > 0, length, 1)
    t = np.clip(t, 0, 1)
    return np.stack([1 - t, t], axis=1)
