"""What a file holds of a mesh's points: numbers of four bytes, or places computed from them."""

import dataclasses
import functools
import pathlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from jaxmorph._host.cells.topology import EDGES, SHAPES
from jaxmorph._host.package.errors import place_of, warn

SHARE = 0.1
"""Share of the motion, or of an edge, that rounding may take without a word."""

EVERYTHING = ((slice(None), slice(None)),)
"""The `singles` of a file that has single precision everywhere."""


@dataclasses.dataclass(frozen=True, eq=False)
class Held:
    """How a file holds the points of its mesh, where it does not keep all of their digits.

    - `points` (N, k): the points of the file, as read.
    - `in_file`, `in_mesh`: take points (n, d) of the mesh to those of the file, and back.
    - `singles`: rows and columns of `points` that the file has in single precision.
    """

    points: np.ndarray
    in_file: Callable[[np.ndarray], np.ndarray]
    in_mesh: Callable[[np.ndarray], np.ndarray]
    singles: Sequence[tuple[slice, Any]] = ()

    def stored(self, points: np.ndarray) -> np.ndarray:
        """Computes the points (n, d) that reading the written file gives."""
        values = np.array(self.in_file(points), float)
        for place in self.singles:
            values[place] = values[place].astype(np.float32)
        return self.in_mesh(values)

    @functools.cached_property
    def base(self) -> np.ndarray:
        """The mesh's points as read (n, d)."""
        return self.in_mesh(self.points)


def warn_of_loss(path: pathlib.Path, cells: Mapping[str, Any], held: Held, points: np.ndarray) -> np.ndarray:
    """Computes what the file holds of moved points (n, d); warns where rounding takes much."""
    stored = held.stored(points)
    if not held.singles:
        return stored
    points = points.astype(float)
    off = np.linalg.norm(stored - points, axis=1)
    motion = np.linalg.norm(points - held.base, axis=1)
    most = motion.max(initial=0.0)
    losses = []
    # far from the origin nodes that hardly move are rounded more, and that changes nothing there
    if (off[motion >= most / 2] > SHARE * most).any():
        losses.append(f"more than a tenth of the motion, which is {most:.3g}")
    count, shortest, node = _changed_edges(cells, held.base, points, stored)
    if count:
        place = place_of(points[node])
        losses.append(f"more than a tenth of {count} edges of cells, the shortest {shortest:.3g} near ({place})")
    if losses:
        warn(
            f"{path}: the file holds single precision. Rounding moves nodes by up to {off.max():.3g}: {', and '.join(losses)}. "
            "Write another format, such as .vtu or .su2, or begin with a file in double precision."
        )
    return stored


def _changed_edges(
    cells: Mapping[str, Any], base: np.ndarray, points: np.ndarray, stored: np.ndarray
) -> tuple[int, float, int]:
    """Counts edges that rounding changes by much; also the least length, and a node there.

    Edges without a length in the file do not count.
    """
    shift, found = stored - points, [np.zeros((0, 2), int)]
    for kind, ids in cells.items():
        for edge in EDGES[SHAPES[kind]]:
            start, end = pairs = np.asarray(ids)[:, edge].T
            change = np.linalg.norm(shift[end] - shift[start], axis=1)
            length = np.linalg.norm(points[end] - points[start], axis=1)
            has_length = (base[start] != base[end]).any(axis=1)
            found.append(np.sort(pairs[:, has_length & (change > SHARE * length)].T, axis=1))
    start, end = np.unique(np.concatenate(found), axis=0).T
    if not len(start):
        return 0, 0.0, 0
    length = np.linalg.norm(points[end] - points[start], axis=1)
    return len(start), float(length.min()), int(start[length.argmin()])
