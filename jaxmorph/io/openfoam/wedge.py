"""OpenFOAM's axisymmetric cases: one layer of cells between `wedge` planes, as (x, r)."""

import dataclasses
from typing import ClassVar

import numpy as np

from jaxmorph._mesh.faces import Faces

from .front import Front, behind

TOLERANCE = 1e-6
"""Distance that a node may be off its plane, as a share of the mesh's extent."""
APART = 1e-3
"""Distance that the places of two partners may be apart, as a share of the mesh's extent."""
ROUNDING = 1e-12
"""Distance of a node off its axis, relative to the mesh's extent: it is written on the axis."""


@dataclasses.dataclass(frozen=True, eq=False)
class Sector(Front):
    """Pairs of nodes of two wedge planes: `front` and `back`, row by row, equal on the axis.

    Node i of the 2-D mesh is `front[i]`, at its place along the `axis` and its distance from it,
    along `out` in front and `out_behind` behind, from the point `origin`. Ids ascend, so nodes keep
    the order of the file. `is_first` tells that the front is the first of the file's two planes.
    """

    front: np.ndarray
    back: np.ndarray
    axis: np.ndarray
    origin: np.ndarray
    out: np.ndarray
    out_behind: np.ndarray
    is_first: bool
    patch_type: ClassVar[str] = "wedge"

    def in_plane(self, points: np.ndarray) -> np.ndarray:
        arms = points[self.front] - self.origin
        return np.stack([arms @ self.axis, np.where(self.on_axis, 0, arms @ self.out)], axis=1)

    def fitted(self, points: np.ndarray) -> "Sector":
        """Finds the axis and both planes in other points (N, 3), as reading them does."""
        front, back = self.front, np.unique(self.back)
        axis, origin, outward = _frame((front, back) if self.is_first else (back, front), points)
        out, out_behind = outward if self.is_first else outward[::-1]
        return dataclasses.replace(self, axis=axis, origin=origin, out=out, out_behind=out_behind)

    @property
    def on_axis(self) -> np.ndarray:
        """Marks the nodes (n,) of the axis."""
        return self.front == self.back

    def in_space(self, old: np.ndarray, plane: np.ndarray) -> np.ndarray:
        """Moves both planes of `old` as `plane` has moved.

        Raises `ValueError` where the axis does not stay.
        """
        along, outward = (plane - self.in_plane(old)).T[:, :, None]
        limit = ROUNDING * np.ptp(old, axis=0).max()
        off = np.flatnonzero(self.on_axis & ~(np.abs(outward[:, 0]) <= limit))
        if off.size:
            raise ValueError(
                f"{off.size} nodes of the axis have left it, first node {off[0]}: name it, symmetry='axis' or --symmetry axis."
            )
        outward = np.where(self.on_axis[:, None], 0, outward)
        new = old.copy()
        new[self.front] = old[self.front] + along * self.axis + outward * self.out
        behind = self.back[~self.on_axis]
        new[behind] = old[behind] + (along * self.axis + outward * self.out_behind)[~self.on_axis]
        return new

    def added(self, values: np.ndarray) -> np.ndarray:
        """Adds values (N, 3) of both planes to (n, 2): the transpose of `in_space`."""
        front, back = values[self.front], np.where(self.on_axis[:, None], 0, values[self.back])
        return np.stack([(front + back) @ self.axis, front @ self.out + back @ self.out_behind], axis=1)


def sector(faces: Faces, first: np.ndarray, second: np.ndarray, points: np.ndarray) -> Sector:
    """Finds the planes of two wedge patches by their nodes.

    It raises `ValueError` where they are not planes at an angle, or their nodes are not pairs that
    edges join.
    """
    size = np.ptp(points, axis=0).max()
    first, second = np.unique(first), np.unique(second)
    if len(np.union1d(first, second)) < len(points):
        raise ValueError("patches of type wedge, but there are nodes off both: there is more than one layer of cells.")
    axis, origin, outward = _frame((first, second), points)
    # the plane farther around the axis is in front: seen from outside, (x, r) is right-handed
    is_first = np.cross(outward[1], outward[0]) @ axis > 0
    front, back = (first, second) if is_first else (second, first)
    out, out_behind = outward if is_first else outward[::-1]
    on = np.zeros((2, len(points)), dtype=bool)
    on[0, front], on[1, back] = True, True
    partner = np.where(on.all(axis=0), np.arange(len(points)), behind(faces, on[0] & ~on[1], on[1] & ~on[0]))[front]
    if (partner < 0).any() or len(np.unique(partner)) < len(back):
        raise ValueError(
            f"patches of type wedge, but their {len(front)} and {len(back)} nodes are not pairs joined by edges: there is more "
            "than one layer of cells."
        )
    places = [
        np.stack([(points[nodes] - origin) @ axis, (points[nodes] - origin) @ away], axis=1)
        for nodes, away in ((front, out), (partner, out_behind))
    ]
    distance = np.linalg.norm(places[0] - places[1], axis=1).max()
    if distance > APART * size:
        raise ValueError(f"patches of type wedge, but nodes of their planes are up to {distance:.3g} apart along them.")
    return Sector(front, partner, axis, origin, out, out_behind, bool(is_first))


def _frame(
    patches: tuple[np.ndarray, np.ndarray], points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """Finds the axis of two patches, a point on it, and the direction in which each leaves it."""
    axis, origin = _axis(patches, points, np.ptp(points, axis=0).max())
    outward = []
    for nodes in patches:
        arm = points[nodes].mean(axis=0) - origin
        arm = arm - (arm @ axis) * axis
        outward.append(arm / np.linalg.norm(arm))
    return axis, origin, outward


def _axis(patches: tuple[np.ndarray, np.ndarray], points: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Finds the line in which the planes of two patches meet: its direction, and a point on it."""
    normals = []
    for nodes in patches:
        middle = points[nodes].mean(axis=0)
        normals.append(np.linalg.svd(points[nodes] - middle, full_matrices=False)[2][-1])
        if np.abs((points[nodes] - middle) @ normals[-1]).max() > TOLERANCE * size:
            raise ValueError("a patch of type wedge does not lie in a plane.")
    axis = np.cross(*normals)
    if not np.linalg.norm(axis) > 1e-9:
        raise ValueError("two patches of type wedge are parallel; a case in two dimensions has patches of type empty.")
    axis = axis / np.linalg.norm(axis) * np.sign(axis[np.abs(axis).argmax()])
    sharp = np.round(axis)
    axis = sharp if np.abs(axis - sharp).max() < TOLERANCE else axis
    heights = [normal @ points[nodes].mean(axis=0) for normal, nodes in zip(normals, patches, strict=True)]
    origin = np.linalg.lstsq(np.stack([*normals, axis]), np.array([*heights, 0.0]), rcond=None)[0]
    return axis, np.where(np.abs(origin) < TOLERANCE * size, 0, origin)
