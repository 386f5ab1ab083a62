"""The boundary and the method that the command line asks for."""

import contextlib
import dataclasses
import functools
from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Int

import jaxmorph as jm
from jaxmorph import io

from ._requests import Deform, MethodFlags, Names, Planned

Chunks = Iterator[tuple[Int[np.ndarray, " c"], jm.Plan]]
PlanRequest = Deform | Planned


def describe_method(request: MethodFlags, plan: jm.Plan) -> tuple[str, int]:
    is_carrying = request.method == "default" and isinstance(plan.method, jm.InverseDistance)
    listed = jm.METHODS["turning" if is_carrying else request.method]
    sources = plan.n_moving * (listed.sources == "all")
    if listed.sources == "some":
        sources = int(np.isin(plan.sources, plan.moving).sum())
    return listed.sentence + (
        f", {sources} wall sources" if request.sources is not None else ""
    ), sources


@dataclasses.dataclass(frozen=True, eq=False)
class Patches:
    mesh: jm.Mesh
    request: MethodFlags
    moving: Names
    fixed: Names
    symmetry: Names = ()
    sliding: Names = ()
    periodic: tuple[jm.Periodic, ...] = ()
    free: Names = ()

    @property
    def nodes(self) -> Int[np.ndarray, " m"]:
        return self.mesh.patch(*self.moving)

    @functools.cached_property
    def boundary(self) -> jm.Boundary:
        """The boundary in working precision; `ValueError` for faces that no flag names."""
        mesh = self.mesh.moved(np.asarray(self.mesh.points).astype(self.request.dtype, copy=False))
        slides = {"symmetry": self.symmetry, "periodic": self.periodic, "sliding": self.sliding}
        boundary = jm.Boundary(mesh, self.moving, self.fixed, free=self.free, **slides)
        if boundary.left is not None and boundary.left.patches:
            names = "--fixed, --moving, --symmetry, --sliding or --periodic, or by --free"
            raise ValueError(f"{boundary.left} Name them by {names}.")
        return boundary

    @property
    def method(self) -> jm.AbstractMethod | None:
        """The method for the moving points; None for the default."""
        request = self.request
        wall = np.asarray(self.mesh.points)[self.nodes]
        if request.method == "default" and request.sources is None:
            return None
        method = jm.METHODS[request.method].make(float(np.ptp(wall, axis=0).max()))
        if request.sources is None or not isinstance(method, jm.SurfaceReconstruction):
            return method
        is_all = request.sources >= len(wall)
        rbf = jm.RBF(
            reduction=jm.AllPoints() if is_all else jm.KDTree.with_sources(request.sources, wall)
        )
        coarse = jm.FittedRBF(rbf) if isinstance(method.coarse, jm.FittedRBF) else rbf
        return jm.SurfaceReconstruction(coarse, method.correction)

    def chunks(self, size: int | None = None) -> Chunks:
        """Yields nodes and plan of each chunk of `size` inner nodes, or of the whole mesh."""
        return jm.prepare_in_chunks(self.boundary, method=self.method, size=size)

    def half(self) -> jm.SurfaceHalf:
        """Prepares the surface of a mesh in parts, which `mesh` is."""
        faces: Any = self.mesh.cells
        return jm.prepare_surface(
            self.boundary, method=self.method, nodes=io.global_nodes(self.mesh), faces=faces
        )


def patches_of(request: PlanRequest, mesh: jm.Mesh) -> Patches:
    """Looks up the patches that the names mean. A pattern never fixes a moving or sliding patch.

    Without names, symmetry patches and periodic pairs are those of the file. Raises `ValueError`
    for patches that are missing, empty, or both moving and fixed.
    """
    flags = request.boundary
    _check_names(request, mesh)
    lists = (request.moving, flags.symmetry, flags.sliding, flags.free)
    moving, symmetry, sliding, free = (mesh.patch_names(*names) for names in lists)
    periodic = _pair_periodic(
        flags.periodic, mesh, {*moving, *flags.fixed, *symmetry, *sliding, *free}
    )
    repeating = [str(side) for pair in periodic for side in (pair.patch, pair.partner)]
    elsewhere = {*moving, *symmetry, *sliding, *repeating}
    fixed = tuple(
        name
        for name in mesh.patch_names(*flags.fixed)
        if name in flags.fixed or name not in elsewhere
    )
    known = {*elsewhere, *fixed, *free}
    for name in (name for name in io.symmetry(mesh) if name not in known):
        with contextlib.suppress(ValueError):  # a bent patch has no plane: its nodes do not slide
            jm.Plane.of_patch(mesh, name)
            symmetry += (name,)
    return Patches(
        mesh,
        request.method,
        moving=moving,
        fixed=fixed,
        symmetry=symmetry,
        sliding=sliding,
        periodic=periodic,
        free=free,
    )


def _check_names(request: PlanRequest, mesh: jm.Mesh) -> None:
    if not request.moving:
        has = ", ".join(mesh.patches) or "none"
        raise ValueError(f"--moving is missing: name the patches that move; this mesh has: {has}.")
    for option, names in (("--moving", request.moving), ("--fixed", request.boundary.fixed)):
        if names and not len(mesh.patch(*names)):
            raise ValueError(f"{option} {' '.join(names)}: there are no nodes in it.")
    both = sorted({*mesh.patch_names(*request.moving)} & {*request.boundary.fixed})
    if both:
        raise ValueError(f"{', '.join(both)} cannot be both --moving and --fixed.")


def _pair_periodic(names: Names, mesh: jm.Mesh, lists: set[str]) -> tuple[jm.Periodic, ...]:
    """Lists the pairs of flags, and the file's pairs of which no patch is in another list."""
    if len(names) % 2:
        raise ValueError(
            f"--periodic {' '.join(names)}: name pairs of patches, one after the other."
        )
    sides = [mesh.patch_names(name)[0] for name in names]
    known = {*lists, *names}
    of_file = [
        pair for pair in io.periodic(mesh) if not {str(pair.patch), str(pair.partner)} & known
    ]
    return (*map(jm.Periodic, sides[::2], sides[1::2]), *of_file)
