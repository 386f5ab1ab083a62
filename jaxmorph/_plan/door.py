"""The door of `prepare`: what a caller names becomes checked points, node ids, planes and faces."""

import dataclasses
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Int

from .._host.errors import MeshError
from .._host.skin import has_free_faces
from .._host.topology import solid
from .._mesh.mesh import Mesh
from .faces import FreeFaces, free_faces, outer_faces
from .symmetry import Plane

USE = 'prepare(mesh, "airfoil", "farfield") with a Mesh, or prepare(points, moving_ids, fixed_ids)'


@dataclasses.dataclass(frozen=True)
class Boundary:
    """A checked call of `prepare`.

    - `points` (n, d): base coordinates.
    - `moving` (m,), `fixed` (f,): node ids, no node twice.
    - `planes`: symmetry planes.
    - `faces`: the mesh's boundary faces (k, corners) by type, as node ids, or None if the cells are not known.
    - `left`: the faces that no list names, or None as well.
    - `is_open`: whether there are faces off the surface and the planes, free ones too, or None as well.
    - `cells`: node ids (k, corners) of the cells by type, or None as well, and for a part of a mesh.
    """

    points: np.ndarray
    moving: np.ndarray
    fixed: np.ndarray
    planes: tuple[Plane, ...]
    faces: Mapping[str, np.ndarray] | None
    left: FreeFaces | None
    is_open: bool | None
    cells: Mapping[str, np.ndarray] | None = None

    @property
    def nodes(self) -> np.ndarray:
        """Ids of the surface's nodes: moving, then fixed."""
        return np.concatenate([self.moving, self.fixed])

    @property
    def surface_faces(self) -> dict[str, np.ndarray] | None:
        """The faces all of whose nodes are moving or fixed, as rows of `nodes`; None where faces are not known."""
        if self.faces is None:
            return None
        rows = {kind: _rows(self.nodes, len(self.points))[corners] for kind, corners in self.faces.items()}
        return {kind: corners[(corners >= 0).all(axis=1)] for kind, corners in rows.items()}

    def warn_of_free_faces(self) -> None:
        """Warns about boundary faces that no list names."""
        if self.left:
            warnings.warn(f"{self.left} Name them in `fixed`, `moving`, `symmetry` or `free`.", stacklevel=4)

    def part(self, nodes: np.ndarray) -> "Boundary":
        """Returns the same of the mesh's nodes `nodes` alone, ascending ids that hold the whole surface."""
        moving, fixed = np.searchsorted(nodes, self.moving), np.searchsorted(nodes, self.fixed)
        faces, surface = self.surface_faces, np.concatenate([moving, fixed])
        faces = None if faces is None else {kind: surface[rows] for kind, rows in faces.items()}
        cells = self.cells if len(nodes) == len(self.points) else None
        return Boundary(self.points[nodes], moving, fixed, self.planes, faces, self.left, self.is_open, cells)


def boundary(mesh: Any, moving: Any, fixed: Any, symmetry: Any, free: Any = ()) -> Boundary:
    """Checks what `prepare` was given. Raises `ValueError` in one sentence that names the call to make."""
    points = checked_points(mesh.points if isinstance(mesh, Mesh) else mesh)
    patches = mesh if isinstance(mesh, Mesh) else None
    moving, fixed, free = (
        _nodes(ids, name, patches, len(points)) for ids, name in ((moving, "moving"), (fixed, "fixed"), (free, "free"))
    )
    unique, counts = np.unique(moving, return_counts=True)
    if len(unique) < len(moving):
        raise MeshError(
            f"{(counts > 1).sum()} nodes are named more than once in `moving`, first node {{node}}.", unique[counts > 1]
        )
    if len(moving) == 0:
        raise ValueError("`moving` is empty: name the nodes of the boundary that moves.")
    fixed = fixed[np.sort(np.unique(fixed, return_index=True)[1])]
    fixed = fixed[~np.isin(fixed, moving)]
    planes = _planes(symmetry, points, patches)
    outer = None if patches is None else outer_faces(patches)
    if patches is None or outer is None:
        return Boundary(points, moving, fixed, planes, None, None, None)
    is_held = _listed(points, np.concatenate([moving, fixed]), planes)
    is_open = has_free_faces(points, outer.corners, is_held)
    is_held[free] = True
    cells = {kind: np.asarray(corners) for kind, corners in solid(patches.cells, points.shape[1]).items()}
    return Boundary(points, moving, fixed, planes, outer.corners, free_faces(patches, outer, is_held), is_open, cells)


def checked_points(points: Any) -> np.ndarray:
    """Returns coordinates as a NumPy array (n, d) of float32 or float64. Raises `ValueError` for anything else."""
    if isinstance(points, str | bytes) or points is None:
        raise ValueError(f"`prepare` takes a mesh or points first, not {points!r}. Call {USE}.")
    try:
        array = np.asarray(points)
    except ValueError as error:
        raise ValueError(f"`points` is no array of numbers ({error}). Call {USE}.") from error
    if array.dtype.kind not in "fiu":
        raise ValueError(f"`points` holds {array.dtype}, not real numbers. Call {USE}.")
    if array.dtype not in (np.float32, np.float64):
        array = array.astype(np.float64)
    if array.ndim != 2 or array.shape[1] not in (2, 3):
        raise ValueError(f"`points` has shape {array.shape}; expected (n, 2) or (n, 3).")
    finite = np.isfinite(array).all(axis=1)
    if not finite.all():
        raise MeshError(
            f"{(~finite).sum()} of {len(array)} points are not finite, first node {{node}}.", np.flatnonzero(~finite)
        )
    return array


def _names(values: Any) -> tuple[str, ...] | None:
    """Returns the names of patches, if `values` is one or several; None for anything else."""
    if isinstance(values, str):
        return (values,)
    is_list = isinstance(values, list | tuple | set | frozenset)
    return tuple(values) if is_list and values and all(isinstance(each, str) for each in values) else None


def _nodes(values: Any, name: str, mesh: Mesh | None, n: int) -> Int[np.ndarray, " k"]:
    names = _names(values)
    if names is None:
        return node_ids(values, name, n)
    if mesh is None:
        raise ValueError(
            f"`{name}` names patches ({', '.join(map(repr, names))}), but points alone have none: pass the mesh, "
            f"prepare(mesh, ...), or node ids, mesh.patch({names[0]!r})."
        )
    return mesh.patch(*names).astype(np.int64)


def node_ids(values: Any, name: str, n: int) -> Int[np.ndarray, " k"]:
    """Returns node ids as an array. Raises `ValueError` for what is no list of ids of a mesh of `n` points."""
    if values is None or isinstance(values, Mesh | Plane):
        raise ValueError(f"`{name}` must be node ids or names of patches, not {type(values).__name__}. Call {USE}.")
    ids = np.asarray(values)
    if ids.size == 0:
        return np.zeros(0, dtype=np.int64)
    if ids.ndim != 1 or ids.dtype.kind not in "iu":
        hint = f"; for a mask use np.flatnonzero({name})" if ids.dtype == bool else ""
        raise ValueError(f"`{name}` must be a list of node ids, not {ids.dtype} of shape {ids.shape}{hint}.")
    wrong = (ids < 0) | (ids >= n)
    if wrong.any():
        raise ValueError(
            f"{wrong.sum()} ids in `{name}` are not nodes of the mesh (0 to {n - 1}), first {ids[wrong][0]}."
        )
    return ids.astype(np.int64)


def _planes(symmetry: Any, points: np.ndarray, mesh: Mesh | None) -> tuple[Plane, ...]:
    """Returns the planes, each once: patches are named where there is a mesh."""
    several = [symmetry] if isinstance(symmetry, Plane | str) else symmetry
    if not isinstance(several, Sequence | set | frozenset):
        raise ValueError(f"`symmetry` must be a Plane or several, not {type(symmetry).__name__}.")
    planes: list[Plane] = []
    for each in several:
        if isinstance(each, str) and mesh is not None:
            each = Plane.through(points, mesh.patch(each))
        if not isinstance(each, Plane):
            raise ValueError(
                f"`symmetry` holds {each!r}, which is no plane: pass jm.Plane(normal=(0, 1), origin=(0, 0)), "
                "jm.Plane.through(points, nodes), or the name of a patch where the first argument is a mesh."
            )
        if not any(each.equals(plane, points) for plane in planes):
            planes.append(each)
    return tuple(planes)


def _listed(points: np.ndarray, listed: np.ndarray, planes: tuple[Plane, ...]) -> np.ndarray:
    """Marks (n,) nodes that are listed, or lie on a symmetry plane."""
    is_listed = np.zeros(len(points), dtype=bool)
    is_listed[listed] = True
    for plane in planes:
        is_listed |= plane.holds(points)
    return is_listed


def _rows(nodes: np.ndarray, n: int) -> np.ndarray:
    """Numbers (n,) the nodes by their rows, others by -1."""
    row = np.full(n, -1, dtype=np.int32)
    row[nodes] = np.arange(len(nodes))
    return row
