"""Symmetry planes: where they may stand, and which nodes lie on them."""

import contextlib
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from .._host.linear.products import dot_rows, normals, unit_rows
from .._host.package.arguments import checked, finite_array, freeze, rows_of
from .._host.package.errors import MeshError, check_none, worst_first
from .._host.package.rounding import extent_of, roundoff
from .._host.rows import mark
from .._host.tolerances import (
    ALIGNED,
    ALONG_AXIS,
    NEAR_PLANE,
    ON_PLANE,
    SAME_NORMAL,
    SAME_TRANSFORM,
)
from .._kernels.module import Module
from .._mesh.mesh import Mesh
from .outer_faces import Ids, Points


class Plane(Module):
    """A symmetry plane: nodes on the plane stay in the plane.

    Nodes within 1e-8 of the mesh's extent, or within the round-off of float32 coordinates, lie on
    the plane. All other nodes are on one side. The `normal` (d,) has any length but zero; `origin`
    is a point (d,) of the plane. `Plane.through` finds a patch's plane.

    **Raises:** `ValueError` for a normal that is zero, and for different dimensions of both.
    """

    normal: np.ndarray
    origin: np.ndarray

    def __init__(self, normal, origin):
        normal = finite_array("normal", normal, (2,), (3,)).astype(float)
        origin = finite_array("origin", origin, (2,), (3,)).astype(float)
        length = np.linalg.norm(normal)
        if normal.shape != origin.shape or not length > 0:
            raise ValueError(
                "`Plane(normal, origin)`: the normal comes first, and is not zero; the origin has "
                f"as many components, got {normal}, {origin}."
            )
        self.normal = freeze(normal / length)
        self.origin = freeze(origin)

    @staticmethod
    def through(points: Points, nodes: Ids) -> "Plane":
        """Finds the plane through nodes (k,), ids of `points` (n, d), all points of a mesh.

        **Raises:** `ValueError`, with the worst node, if the nodes do not lie in one plane.
        """
        points = finite_array("points", points, (None, 2), (None, 3))
        nodes = rows_of("nodes", nodes, len(points))
        patch = points[nodes].astype(float)
        if len(patch) < points.shape[1]:
            raise ValueError(
                f"{len(patch)} nodes do not determine a plane in {points.shape[1]} dimensions."
            )
        origin = patch.mean(axis=0)
        normal = np.linalg.svd(patch - origin, full_matrices=False)[2][-1]
        axis = np.abs(normal).argmax()
        if (
            np.abs(np.delete(normal, axis)).max() < ALONG_AXIS
        ):  # the usual case: keep the coordinate bit for bit
            normal = np.eye(len(normal))[axis]
            origin[axis] = np.median(patch[:, axis])
        deviation = np.abs((patch - origin) @ normal)
        check_none(
            nodes[worst_first(deviation, tolerance(points))],
            f"these {len(nodes)} nodes do not lie in one plane: node {{node}} at ({{place}}) is "
            f"{deviation.max():.3g} off.",
            points,
        )
        return Plane(normal, origin)

    @staticmethod
    @checked
    def of_patch(mesh: Mesh, patch: str) -> tuple["Plane", ...]:
        """Finds the planes of a patch by its faces: one, or several such as front and back.

        **Raises:** `ValueError` for a patch that is bent, and for a name without a patch.
        """
        points = np.asarray(mesh.points)
        nodes = mesh.patch(patch)
        outer = mesh.outer_faces
        faces = (
            mesh.cells if outer is None else outer.corners
        )  # the cells of a surface mesh are faces
        try:
            return (Plane.through(points, nodes),)
        except MeshError as error:
            planes = _of_most_nodes(points, nodes, map(np.asarray, faces.values()))
            if not planes:
                raise MeshError(f"the patch {patch!r}: {error.message}", error.nodes) from None
            return planes

    def equals(self, other: "Plane", points: np.ndarray) -> bool:
        if (
            self.normal.shape != other.normal.shape
            or abs(float(self.normal @ other.normal)) < 1 - SAME_NORMAL
        ):
            return False
        return abs(float(self.height(other.origin[None])[0])) <= tolerance(points)

    def holds(self, points: np.ndarray) -> np.ndarray:
        """Marks the points on the plane: booleans (n,)."""
        return np.abs(self.height(points)) <= tolerance(points)

    def height(self, points: np.ndarray) -> np.ndarray:
        """Computes signed distances (n,) of points from the plane, positive along the normal."""
        return (points - self.origin) @ self.normal


MOST_PLANES = 6  # most planes of one patch: the sides of a box


def _of_most_nodes(points: Points, nodes: Ids, faces: Iterable[np.ndarray]) -> tuple[Plane, ...]:
    """Finds the planes of a patch, such as front and back, by boundary faces (e, corners). The
    plane with most of the nodes comes first, then the plane with most of the remaining nodes. There
    are none if `MOST_PLANES` planes do not hold all nodes, or if other planes hold as many nodes.
    In a duct one cell wide and high, nodes do not decide which sides are meant.
    """
    planes = _list_candidates(points, nodes, faces)
    on = np.array([plane.holds(points)[nodes] for plane in planes], dtype=bool).reshape(
        -1, len(nodes)
    )
    left = np.ones(len(nodes), dtype=bool)
    chosen = []
    while (
        left.any()
        and len(chosen) < MOST_PLANES
        and (on & left).sum(axis=1).max(initial=0) >= points.shape[1]
    ):
        chosen.append(int((on & left).sum(axis=1).argmax()))
        left &= ~on[chosen[-1]]
    largest = np.flatnonzero(on.sum(axis=1) == on.sum(axis=1).max(initial=0))
    is_decided = not left.any() and np.isin(largest, chosen).all()
    return tuple(planes[k] for k in chosen) if is_decided else ()


def _list_candidates(points: Points, nodes: Ids, faces: Iterable[np.ndarray]) -> list[Plane]:
    """Different planes of faces between nodes, those of most faces first."""
    # A face has a key: its unit normal and its height, rounded to four digits, equal for faces of
    # one plane. Equal keys are counted. The plane of one face is tilted by the digits of its
    # corners: it is fitted to all nodes nearby.
    inside = mark(len(points), nodes)
    sides = [ids[inside[ids].all(axis=1)][:, : points.shape[1]] for ids in faces]
    corners = points[
        np.concatenate([np.zeros((0, points.shape[1]), dtype=np.int64), *sides])
    ].astype(float)
    area = normals(corners)
    extent = extent_of(points)
    corners = corners[area.any(axis=1), 0]
    normal = unit_rows(area[area.any(axis=1)])
    height = dot_rows(normal, corners - points.mean(axis=0)) / extent
    keys = np.round(np.column_stack([normal, height]), 4) + 0.0
    _, first, count = np.unique(keys, axis=0, return_index=True, return_counts=True)
    planes: list[Plane] = []
    for k in first[np.argsort(-count, kind="stable")[: 4 * MOST_PLANES]]:
        plane = Plane(normal[k], corners[k])
        near = nodes[np.abs(plane.height(points[nodes])) <= NEAR_PLANE * extent]
        with contextlib.suppress(ValueError):
            plane = Plane.through(points, near)
        if not any(plane.equals(other, points) for other in planes):
            planes.append(plane)
    return planes


def optional(name: str, value: Any, *shapes: tuple[int | None, ...]) -> np.ndarray | None:
    return None if value is None else freeze(finite_array(name, value, *shapes).astype(float))


def tolerance(points: np.ndarray) -> float:
    return max(ON_PLANE * float(extent_of(points)), roundoff(points))


NARROWEST = 180  # mirrors at an angle of 180 / n degrees have 2 n images


class Mirrors(NamedTuple):
    """Symmetry planes, the signed heights (n, p) of all nodes above them, and the nodes on them."""

    planes: tuple[Plane, ...]
    heights: Float[np.ndarray, "n p"]
    on: Bool[np.ndarray, "n p"]

    @classmethod
    def of(cls, planes: tuple[Plane, ...], points: np.ndarray) -> "Mirrors":
        n, dimension = points.shape
        for plane in planes:
            if len(plane.normal) != dimension:
                raise ValueError(
                    f"a symmetry plane's normal has {len(plane.normal)} components; the mesh has "
                    f"{dimension} dimensions."
                )
        heights = np.reshape([plane.height(points) for plane in planes], (len(planes), n)).T
        return cls(planes, heights, np.abs(heights) <= tolerance(points))

    def check(self, points: np.ndarray, loose: Ids) -> None:
        """Refuses planes that do not bound the mesh, whose nodes but the `loose` count, and angles
        between planes that mirrors do not have.
        """
        of_cells = np.ones(len(points), bool)
        of_cells[loose] = False
        edges = oblique_pairs(self.planes)
        for edge in edges:
            inward = []
            for k in edge:
                height = self.heights[of_cells, k]
                inward.append(np.sign(height[np.abs(height).argmax()]) * self.planes[k].normal)
            angle = np.arccos(-inward[0] @ inward[1])  # of the mesh between the planes
            sectors = round(np.pi / angle)
            is_mirror = sectors <= NARROWEST and abs(angle - np.pi / sectors) < SAME_TRANSFORM
            if len(edges) > 1 or not is_mirror:
                raise ValueError(
                    f"{len(self.planes)} symmetry planes are not all parallel or at right angles, "
                    f"two meet at {np.rad2deg(angle):.6g} degrees: one pair may meet at 180 / n "
                    f"degrees, n up to {NARROWEST}. Hold the nodes of other planes in `fixed`."
                )
        for plane, height, is_on in zip(self.planes, self.heights.T, self.on.T, strict=True):
            _check_bounds(plane, np.where(of_cells, height, 0), is_on & of_cells, points)


def _check_bounds(plane: Plane, height: np.ndarray, is_on: np.ndarray, points: np.ndarray) -> None:
    name = f"the symmetry plane with normal {plane.normal.tolist()} through {plane.origin.tolist()}"
    if not is_on.any():
        nearest = np.abs(height).argmin()
        raise MeshError(
            f"{name} holds no node of the mesh: the nearest, node {{node}}, is "
            f"{abs(height[nearest]):.3g} away (tolerance "
            f"{tolerance(points):.3g}). `Plane.through(points, nodes)` finds the plane of a patch.",
            np.array([nearest]),
        )
    above = ~is_on & (height > 0)
    below = ~is_on & (height < 0)
    off = np.abs(height) * (above if above.sum() < below.sum() else below)
    check_none(
        worst_first(off, 0),
        f"{name} has nodes on both sides: {{count}} of {len(points)} lie beyond it, the farthest "
        f"is node {{node}} at ({{place}}), "
        f"{off.max():.3g} away. A symmetry plane bounds the mesh: pass one half of the mesh, or "
        "no plane.",
        points,
    )


def _cosines(planes: Sequence[Plane]) -> Float[np.ndarray, "p p"]:
    cosines = [[abs(one.normal @ other.normal) for other in planes] for one in planes]
    return np.reshape(cosines, (len(planes), len(planes)))


def facing(planes: Sequence[Plane]) -> Bool[np.ndarray, " p"]:
    return (_cosines(planes) > 1 - ALIGNED).sum(axis=1) > 1


def oblique_pairs(planes: Sequence[Plane]) -> tuple[tuple[int, int], ...]:
    """Lists pairs of planes that are neither parallel nor at right angles: they meet in an edge."""
    cosines = np.triu(_cosines(planes), 1)
    first, second = np.nonzero((cosines > ALIGNED) & (cosines < 1 - ALIGNED))
    return tuple(zip(first.tolist(), second.tolist(), strict=True))
