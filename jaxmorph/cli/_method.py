"""The boundary and the method that the command line asks for."""

import contextlib
import dataclasses
import functools
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

import jaxmorph as jm
from jaxmorph import io
from jaxmorph._advice.methods import Lengths, entry
from jaxmorph._boundary.names import planes_of
from jaxmorph._boundary.symmetry import check_planes
from jaxmorph._plan.prepare import default_for

from ._output import count
from ._requests import Deform, Method, Modes, Sensitivity


def mesh_of(path: Path, zone: int | None) -> jm.Mesh:
    """Reads a file's mesh, or an SU2 file's zone `zone`. Raises `ValueError` for an absent zone."""
    if zone is None:
        return io.read(path)
    meshes = io.read_zones(path)
    if not 1 <= zone <= len(meshes):
        raise ValueError(f"--zone {zone}: {path} has {count(len(meshes), 'zone')}.")
    return meshes[zone - 1]


@dataclasses.dataclass(frozen=True)
class NamedMethod:
    """A method, its sentence, and its number of sources on the wall."""

    method: jm.AbstractMethod
    name: str
    sources: int


def named_method(request: Method, wall: Float[np.ndarray, "m d"], fixed: Float[np.ndarray, "f d"]) -> NamedMethod:
    """Makes the requested method for the points of the moving and of the fixed nodes.

    It raises `ValueError` for a number of sources that the method cannot take.
    """
    listed, d = entry(request.method), wall.shape[1]
    if request.sources is not None and request.sources <= d:
        raise ValueError(f"--sources must be {d + 1} or more in {d}-D, found {request.sources}.")
    method = listed.make(Lengths(wall, fixed))
    if listed.sources != "some":
        return NamedMethod(method, listed.sentence, len(wall) * (listed.sources == "all"))
    assert isinstance(method, jm.SurfaceReconstruction)
    is_fitted, coarse = isinstance(method.coarse, jm.FittedRBF), method.coarse
    rbf = coarse.rbf if isinstance(coarse, jm.FittedRBF) else coarse
    if request.sources is not None:
        is_all = request.sources >= len(wall)
        rbf = jm.RBF(reduction=jm.AllPoints() if is_all else jm.KDTree.with_sources(request.sources, wall))
        method = jm.SurfaceReconstruction(jm.FittedRBF(rbf) if is_fitted else rbf, method.correction)
    sources = len(rbf.reduction(wall)) if isinstance(rbf, jm.RBF) else 0
    number = "" if request.sources is None else f", {sources} wall sources"
    return NamedMethod(method, listed.sentence + number, sources)


@dataclasses.dataclass(frozen=True, eq=False)
class Patches:
    """A mesh and the names of its patches by what they do: move, stay, lie in a plane, slide."""

    mesh: jm.Mesh
    dtype: str
    moving: tuple[str, ...]
    fixed: tuple[str, ...]
    symmetry: tuple[str, ...]
    free: tuple[str, ...]
    planes: tuple[jm.Plane, ...]
    sliding: tuple[str, ...]
    periodic: tuple[jm.Periodic, ...]

    @property
    def nodes(self) -> Int[np.ndarray, " m"]:
        """Ids of the moving nodes."""
        return self.mesh.patch(*self.moving)

    @property
    def fixed_nodes(self) -> Int[np.ndarray, " f"]:
        """Ids of the nodes that stay, without those that move."""
        return np.setdiff1d(self.mesh.patch(*self.fixed), self.nodes)

    @functools.cached_property
    def boundary(self) -> jm.Boundary:
        """The boundary in the precision of the calculation.

        It raises `ValueError` for boundary faces of patches that no flag names.
        """
        mesh = self.mesh.moved(np.asarray(self.mesh.points).astype(self.dtype, copy=False))
        slides = {"symmetry": self.planes, "periodic": self.periodic, "sliding": self.sliding}
        with self._explaining():
            boundary = jm.Boundary(mesh, self.moving, self.fixed, free=self.free, **slides)
        if boundary.left is not None and boundary.left.patches:
            names = "--fixed, --moving, --symmetry, --sliding or --periodic, or by --free"
            raise ValueError(f"{boundary.left} Name them by {names}.")
        return boundary

    @contextlib.contextmanager
    def _explaining(self) -> Iterator[None]:
        """Adds to an error the patches in no list that hold the nodes at fault."""
        try:
            yield
        except jm.MeshError as error:
            lists = {*self.moving, *self.fixed, *self.symmetry, *self.sliding}
            left = [name for name in self.mesh.patches if name not in lists]
            left = [name for name in left if np.isin(error.nodes, self.mesh.patch(name)).any()]
            others = f" Patches there that neither move nor stay: {', '.join(left)}." if left else ""
            raise ValueError(f"{error}{others}") from None

    def method(self, request: Method) -> NamedMethod:
        """Makes the requested method. Raises what `named_method` does."""
        points = np.asarray(self.mesh.points)
        walls = points[self.nodes], points[self.fixed_nodes]
        if request.method == "default" and request.sources is None and not len(walls[1]):
            with self._explaining():
                if isinstance(default_for(self.boundary), jm.InverseDistance):
                    request = dataclasses.replace(request, method="turning")
        return named_method(request, *walls)

    def chunks(
        self, method: jm.AbstractMethod, size: int | None = None
    ) -> Iterator[tuple[Int[np.ndarray, " c"], jm.Plan]]:
        """Cuts the mesh into chunks of `size` inner nodes; yields the nodes and plan of each chunk.

        It raises `ValueError` for nodes at fault, with the patches that hold them; faults of the
        boundary at once.
        """
        boundary = self.boundary

        def plans() -> Iterator[tuple[np.ndarray, jm.Plan]]:
            with self._explaining():
                yield from jm.prepare_in_chunks(boundary, method=method, size=size)

        return plans()

    def half(self, method: jm.AbstractMethod) -> jm.SurfaceHalf:
        """Prepares the surface of a mesh in parts, which `mesh` is. Raises as `chunks` does."""
        with self._explaining():
            known = {"nodes": io.global_nodes(self.mesh), "faces": self.mesh.cells}
            return jm.prepare_surface(self.boundary, method=method, **known)


def patches_of(request: Deform | Modes | Sensitivity, mesh: jm.Mesh) -> Patches:
    """Looks up the patches that the names mean. A pattern never fixes a moving or sliding patch.

    Symmetry patches and periodic pairs of the file are taken where no name says otherwise.

    Raises `ValueError` for patches that are missing, empty, both moving and fixed, or not flat
    where they slide.
    """
    surface, file = request.boundary, request.file
    known = ", ".join(mesh.patches) or "none"
    if not request.moving:
        raise ValueError(f"--moving is missing: name the patches that move; this mesh has: {known}.")
    for option, names in (("--moving", request.moving), ("--fixed", surface.fixed)):
        if names and not len(mesh.patch(*names)):
            raise ValueError(f"{option} {' '.join(names)}: there are no nodes in it.")
    moving, symmetry = mesh.patch_names(*request.moving), mesh.patch_names(*surface.symmetry)
    sliding, free = mesh.patch_names(*surface.sliding), mesh.patch_names(*surface.free)
    both = sorted(set(moving) & set(surface.fixed))
    if both:
        raise ValueError(f"{', '.join(both)} cannot be both --moving and --fixed.")
    fixed = mesh.patch_names(*surface.fixed)
    periodic = _periodic(surface.periodic, mesh, {*moving, *surface.fixed, *symmetry, *sliding, *free})
    repeating = {str(patch) for pair in periodic for patch in (pair.patch, pair.partner)}
    elsewhere = {*moving, *symmetry, *sliding, *repeating}
    fixed = tuple(name for name in fixed if name in surface.fixed or name not in elsewhere)
    if not len(mesh.cells):
        raise ValueError(f"{file}: the mesh has no cells.")
    planes = []
    for name in symmetry:
        try:
            planes += planes_of(mesh, name)
        except ValueError as error:
            raise ValueError(f"--symmetry {name}: {error}") from None
    names, more = _symmetry(mesh, {*elsewhere, *fixed, *free}, planes, file)
    symmetry, planes = (*symmetry, *names), [*planes, *more]
    lists = {*elsewhere, *symmetry, *fixed, *free}
    if not fixed and not sliding and any(len(nodes) for name, nodes in mesh.patches.items() if name not in lists):
        raise ValueError(f"--fixed is missing: name the patches that stay; this mesh has: {known}.")
    return Patches(mesh, request.method.dtype, moving, fixed, symmetry, free, tuple(planes), sliding, periodic)


def _symmetry(mesh: jm.Mesh, lists: set[str], planes: list[jm.Plane], file: object) -> tuple[list[str], list[jm.Plane]]:
    """Lists the file's symmetry patches that are in no other list, and their planes."""
    names, lying = [], []
    for name in io.symmetry(mesh):
        with contextlib.suppress(ValueError):  # a bent patch has no plane: its nodes do not slide
            if name not in lists:
                lying += planes_of(mesh, name)
                names.append(name)
    if names:
        try:
            check_planes([*planes, *lying], np.asarray(mesh.points))
        except ValueError as error:
            patches = " ".join(names)
            raise ValueError(
                f"{file} has the symmetry patches {patches}: {error} Hold them by --fixed {patches}."
            ) from None
    return names, lying


def _periodic(names: tuple[str, ...], mesh: jm.Mesh, lists: set[str]) -> tuple[jm.Periodic, ...]:
    """Lists the pairs of flags, and the file's pairs of which no patch is in another list."""
    pairs = list(zip(names[::2], names[1::2], strict=True))
    known = {*lists, *names}
    of_file = [pair for pair in io.periodic(mesh) if not {str(pair.patch), str(pair.partner)} & known]
    return (*(jm.Periodic(*(mesh.patch_names(name)[0] for name in pair)) for pair in pairs), *of_file)
