"""The surface of a mesh as methods see it on the host."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, TypeVar

import numpy as np

from .._host.package.rounding import Tree, nearest_of
from .._host.sources.reduction import AbstractReduction, AllPoints, drop_close, drop_near
from .._host.surface.skin import chords, has_free_sides
from .._host.surface.walls import walls
from .._host.tolerances import SAME

T = TypeVar("T")
ByKind = Mapping[str, np.ndarray]  # corners (k, c) of cells or faces, by their type


@dataclasses.dataclass(frozen=True)
class Cells:
    """The cells of a mesh of n points, and the planes in which nodes slide."""

    corners: ByKind  # node ids (k, corners) by type, of the cells of highest dimension
    normals: np.ndarray  # (p, d) unit normals of the symmetry planes, parallel or at right angles
    on_plane: np.ndarray  # (n, p) whether a node lies on a plane


class WallsOfRows(NamedTuple):
    """The number of each row's wall (b,), two distant rows of each wall (w, 2), its chord (w,)."""

    number: np.ndarray
    ends: np.ndarray
    chord: np.ndarray


@dataclasses.dataclass(frozen=True)
class Surface:
    """The moving and fixed nodes as `AbstractMethod.connect` sees them, on the host: b rows.

    - `points` (b, d): coordinates. The first `moving` rows move; then come fixed and guided rows.
    - `nodes` (b,): each row's id among the points of `connect`, or -1.
    - `images` (b,): the row of which each row is an image, by mirrors or periods, or itself.
    - `matched`: rows whose displacement vanishes: a coarse field's sources, as its correction sees
      them.
    - `faces`: the boundary faces between rows, (k, corners) by type (`line` in 2-D), or None
      without cells.
    - `is_open`: whether boundary faces of the mesh are neither moving, fixed nor on a symmetry
      plane, or None without cells.
    - `cells`: the mesh's cells and symmetry planes, or None for points alone, or a part of a mesh.
    - `in_planes` (b,): the rows that lie in a symmetry plane and are neither moving nor fixed.
    - `listed` (b,): for each row its place among the nodes as the caller lists them. A reduction
      sees points so: `motions` of `Greedy` have a row for each.
    - `hidden` (b,): mask of moving rows inside a body.
    - `values`: what was made `once`, by key.
    """

    points: np.ndarray
    nodes: np.ndarray
    moving: int
    images: np.ndarray
    faces: ByKind | None
    is_open: bool | None
    cells: Cells | None
    in_planes: np.ndarray
    listed: np.ndarray
    hidden: np.ndarray
    matched: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=np.int32))
    values: dict[Any, Any] = dataclasses.field(default_factory=dict, repr=False)

    @property
    def walls(self) -> WallsOfRows:
        def found():
            wall = walls(self.points, self.moving, self.faces, self.in_planes)
            return WallsOfRows(wall, *chords(self.points, wall, self.faces))

        return self.once("walls", found)

    def once(self, key: Any, make: Callable[[], T]) -> T:
        """Caches a value for all surfaces that are `altered` from this one. `key` names it, with
        all that it depends on beside the surface.
        """
        if key not in self.values:
            self.values[key] = make()
        return self.values[key]

    def altered(self, **fields: Any) -> "Surface":
        """Returns the surface with other `nodes` or `matched` rows, and the same cache."""
        return dataclasses.replace(self, **fields)

    @property
    def seen(self) -> np.ndarray:
        """Moving rows that are not inside a body."""
        return np.flatnonzero(~self.hidden[: self.moving])

    def reduced(self, moving: AbstractReduction, fixed: AbstractReduction) -> np.ndarray:
        """Chooses sources among moving, then fixed nodes, with images; no two are too close."""
        among = np.arange(self.moving) if isinstance(moving, AllPoints) else self.seen
        first, closest = self._choose(moving, among, self.points[self.moving :])
        rows = np.arange(self.moving, len(self.points))
        second, closest_fixed = self._choose(fixed, rows, self.points[first])
        return np.concatenate(
            [first, drop_near(self.points, second, first, min(closest, closest_fixed))]
        )

    def _choose(
        self, reduction: AbstractReduction, rows: np.ndarray, others: np.ndarray
    ) -> tuple[np.ndarray, float]:
        """Chooses rows by a reduction, with images; also returns the least distance of two."""
        # A source too close to its own image gives way to the nearest node that is not too close,
        # one on the plane if there is any. Two sources that are not too close are farther from each
        # other's images: all nodes lie on one side of a plane.
        originals = rows[self.images[rows] == rows]
        closest = reduction.closest(self.points[originals])
        listed = originals[np.argsort(self.listed[originals])]
        chosen = np.sort(listed[reduction.beside(self.points[listed], others)])
        far = self._on_far_walls(reduction, originals, others)
        chosen = drop_close(self.points, np.append(chosen, far), closest) if len(far) else chosen
        images = np.flatnonzero(self.images != np.arange(len(self.points)))
        to_image = np.full(len(self.points), np.inf)
        lengths = np.linalg.norm(np.subtract(*self.points[[images, self.images[images]]]), axis=1)
        np.minimum.at(to_image, self.images[images], lengths)
        is_near = to_image <= closest * (1 + SAME)
        near = chosen[is_near[chosen]]
        free = originals[~is_near[originals]]
        if near.size:
            moved = (
                nearest_of(self.points[near], self.points[free], free) if free.size else near[:0]
            )
            chosen = drop_close(
                self.points, np.concatenate([moved, chosen[~is_near[chosen]]]), closest
            )
        return rows[np.isin(self.images[rows], chosen)], closest

    def _on_far_walls(
        self, reduction: AbstractReduction, rows: np.ndarray, others: np.ndarray
    ) -> np.ndarray:
        """Chooses rows of walls farther from the `others` (s, d) than they are long."""
        chosen = [rows[:0]]
        if not reduction.most_on_far_walls or self.faces is None or not len(rows):
            return chosen[0]
        wall = self.walls.number[rows]
        distance = Tree(others).query(self.points[rows])[0]
        for label in np.unique(wall):
            members = np.flatnonzero(wall == label)
            corners = self.points[rows[members]]
            if distance[members].min() > (1 + SAME) * np.linalg.norm(np.ptp(corners, axis=0)) > 0:
                chosen.append(rows[members[reduction(corners)]])
        return (
            np.concatenate(chosen)
            if sum(map(len, chosen)) <= reduction.most_on_far_walls
            else chosen[0]
        )

    def among(self, points: np.ndarray) -> tuple["Surface", np.ndarray]:
        """Returns the surface with all of its rows among the points: images are added to them."""
        absent = np.flatnonzero(self.nodes < 0)
        nodes = self.nodes.copy()
        nodes[absent] = len(points) + np.arange(len(absent))
        return self.altered(nodes=nodes), np.concatenate([points, self.points[absent]])

    def has_free_sides(self, points: np.ndarray) -> bool:
        """Checks whether a side of the mesh is free: by its faces, or if unknown by its points."""
        if self.is_open is not None:
            return bool(self.is_open)
        is_inner = self.rows(len(points)) == len(self.points)
        return has_free_sides(self.points, is_inner, points)

    def rows(self, n: int) -> np.ndarray:
        rows = np.full(n, len(self.points), dtype=np.int32)
        present = np.flatnonzero(self.nodes >= 0)
        rows[self.nodes[present]] = present
        return rows
