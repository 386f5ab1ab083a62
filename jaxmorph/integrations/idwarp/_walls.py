"""Patches by what becomes of their nodes: they move, slide in symmetry planes, or are fixed."""

import dataclasses
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.spatial import KDTree

import jaxmorph as jm
from jaxmorph import io

from ._definition import NEAR, Definition
from ._options import method

PART = 0.5
"""Share of a patch's nodes that lie on the surface, from which the patch belongs to it."""


@dataclasses.dataclass(frozen=True, eq=False)
class Walls:
    """Sorts the patches of a mesh for `prepare`, by options of IDWarp and what the file says.

    - `walls`: the patches that move where no surface is defined.
    - `symmetry`: names of patches, or planes. `flat` are the patches in them.
    - `free`: patches between overset grids.
    """

    mesh: jm.Mesh
    walls: tuple[str, ...]
    symmetry: tuple[Any, ...]
    flat: tuple[str, ...]
    free: tuple[str, ...]

    def moving(self, definition: Definition, is_own: bool) -> tuple[np.ndarray, Any]:
        """Finds the mesh's moving nodes (m,), ascending, and the surface's weights (m, s) of them.

        `is_own` says that the surface is the nodes of `walls`. Otherwise it is that of a solver.
        Patches with half of their nodes on its faces then belong to it, walls alone where there are
        such ones; their nodes on its faces move.
        """
        points = np.asarray(self.mesh.points, dtype=float)
        if is_own:
            nodes = self.mesh.patch(*self.walls)
            return nodes, definition.weights(points[nodes])[0]
        for names in (self.walls, [name for name in self.mesh.patches if name not in (*self.flat, *self.free)]):
            on = [nodes for nodes in (self._on(points, name, definition) for name in names) if len(nodes)]
            if on:
                nodes = np.unique(np.concatenate(on))
                return nodes, definition.weights(points[nodes])[0]
        low, high = (tuple(np.round(extreme(definition.points, axis=0), 6)) for extreme in (np.min, np.max))
        raise ValueError(
            f"no patch of the mesh lies on the surface that is defined, {len(definition.points)} points between {low} and {high}: "
            f"its unit, or its place, is not that of the mesh, whose patches are {', '.join(self.mesh.patches)}."
        )

    def _on(self, points: np.ndarray, name: str, definition: Definition) -> np.ndarray:
        nodes = np.asarray(self.mesh.patches[name])
        if len(nodes) < 2:
            return nodes[:0]
        _, away, limit = definition.weights(points[nodes])
        spacing = np.asarray(KDTree(points[nodes]).query(points[nodes], k=2)[0])[:, 1]
        is_on = away <= np.maximum(limit, NEAR * spacing)
        return nodes[is_on] if is_on.mean() >= PART else nodes[:0]

    def half(self, moving: np.ndarray, options: Mapping[str, Any], known: Mapping[str, Any]) -> jm.SurfaceHalf:
        """Prepares the surface; all patches but symmetry, periodic and overset are fixed."""
        periodic = io.periodic(self.mesh)
        loose = {*self.flat, *self.free, *(str(name) for pair in periodic for name in (pair.patch, pair.partner))}
        fixed = self.mesh.patch(*(name for name in self.mesh.patches if name not in loose))
        free = np.setdiff1d(self.mesh.patch(*self.free), np.concatenate([fixed, moving]))
        fixed = np.setdiff1d(fixed, moving)
        boundary = jm.Boundary(self.mesh, moving, fixed, symmetry=self.symmetry, periodic=periodic, free=free)
        return jm.prepare_surface(boundary, method=method(options, is_loose=len(free) > 0 and not len(fixed)), **known)


def walls_of(mesh: jm.Mesh, options: Mapping[str, Any]) -> Walls:
    """Sorts the patches of a mesh. Raises `ValueError`, with the names, for an unknown one."""
    kinds = _kinds(mesh)
    specified, flat = (_patches_of(mesh, options[name], name) for name in ("specifiedSurfaces", "symmetrySurfaces"))
    walls = tuple(name for name, kind in kinds.items() if kind == "wall") if specified is None else specified
    symmetry: tuple[Any, ...] = ()
    if options["symmetryPlanes"] is not None:
        planes = options["symmetryPlanes"]
        symmetry = tuple(_plane(mesh, origin, normal, options["symmTol"]) for origin, normal in planes)
        flat = _lie_in(mesh, symmetry)
    elif flat is None:
        flat = tuple(name for name, kind in kinds.items() if kind == "symmetry")
    flat = tuple(name for name in flat if name not in walls)
    free = tuple(name for name, kind in kinds.items() if kind == "overset" and name not in walls)
    return Walls(mesh, walls, symmetry or flat, flat, free)


def _kinds(mesh: jm.Mesh) -> dict[str, str]:
    """Sorts patches into overset, wall, symmetry, others: by kind in the file, else by name."""
    words = {"overset": "overset", "wall": "wall", r"(?<![a-z])(bc)?sym": "symmetry"}
    kinds = {}
    for name in mesh.patches:
        text = mesh.kinds.get(name, name).lower()
        kinds[name] = next((kind for word, kind in words.items() if re.search(word, text)), "")
        if not kinds[name] and "overset" in name.lower():  # no type of CGNS says so
            kinds[name] = "overset"
    return kinds


def _patches_of(mesh: jm.Mesh, names: Sequence[str] | None, option: str) -> tuple[str, ...] | None:
    """Finds patches by names in whatever case, as IDWarp does."""
    if names is None:
        return None
    wanted = {name.lower() for name in names}
    missing = sorted(wanted - {name.lower() for name in mesh.patches})
    if missing:
        raise ValueError(f"`{option}`: no patch {', '.join(missing)}; there are {', '.join(mesh.patches)}.")
    return tuple(name for name in mesh.patches if name.lower() in wanted)


def _plane(mesh: jm.Mesh, origin: Any, normal: Any, tolerance: float) -> jm.Plane:
    """Makes a plane, and lays it through the nodes that are within the tolerance of it."""
    plane, points = jm.Plane(normal, origin), np.asarray(mesh.points, dtype=float)
    near = np.flatnonzero(np.abs(plane.height(points)) <= tolerance)
    if plane.holds(points)[near].all():
        return plane
    through = jm.Plane.through(points, near)
    return through if abs(float(plane.normal @ through.normal)) > 0.99 else plane


def _lie_in(mesh: jm.Mesh, planes: Sequence[jm.Plane]) -> tuple[str, ...]:
    """Lists the patches that lie in planes."""
    points = np.asarray(mesh.points, dtype=float)
    on = np.any([np.zeros(len(points), dtype=bool), *(plane.holds(points) for plane in planes)], axis=0)
    return tuple(name for name, nodes in mesh.patches.items() if on[np.asarray(nodes)].all())
