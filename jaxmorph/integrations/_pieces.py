"""Pieces of a mesh in the processes of an MPI run: shared nodes, and the boundary of the whole."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy import ndarray

import jaxmorph as jm
from jaxmorph.extend import join_ids, solid, together


def check_comm(comm: Any) -> None:
    if not hasattr(comm, "allgather"):
        raise ValueError(
            "`comm` must be a communicator of mpi4py, MPI.COMM_WORLD for example, not a "
            f"{type(comm).__name__}."
        )


def faces_of_piece(
    comm: Any, mesh: jm.Mesh | None, nodes: ndarray, is_shared: ndarray
) -> dict[str, ndarray] | None:
    """Finds a piece's boundary faces (k, corners) by type, from whole ids (n,); or None."""
    if len(set(comm.allgather(mesh is None))) > 1:
        raise ValueError(
            "some processes give a Mesh and some points alone: give a Mesh in all, or points in "
            "all."
        )
    if mesh is None:
        return None
    # a ghost cell counts in the first piece that has it; a face that two pieces then have lies
    # between them
    marked = _mark_ids(comm, solid(mesh.linear.cells, mesh.points.shape[1]), nodes, is_shared)
    cells = {kind: ids[is_first] for kind, ids, is_first, _ in marked}

    def outer() -> dict[str, ndarray]:
        if mesh.polyhedra is not None and mesh.between is None and comm.size > 1:
            raise ValueError(
                "polyhedra do not tell which of their faces other pieces have: read the piece by "
                "`io.read`."
            )
        if mesh.polyhedra is not None:
            return jm.boundary_faces(mesh)
        return (
            jm.boundary_faces(jm.Mesh(mesh.points, cells)) if any(map(len, cells.values())) else {}
        )

    marked = _mark_ids(comm, together(comm, outer), nodes, is_shared)
    return {kind: nodes[ids[~is_twice]] for kind, ids, _, is_twice in marked}


def _mark_ids(
    comm: Any, cells: Mapping[str, Any], nodes: ndarray, is_shared: ndarray
) -> Iterator[tuple[str, ndarray, ndarray, ndarray]]:
    """Yields cells or faces by type with two marks: first in this piece, also in others."""
    widths = comm.allgather({kind: np.shape(ids)[1] for kind, ids in cells.items()})
    for kind, width in sorted({pair for share in widths for pair in share.items()}):
        corners = np.asarray(cells.get(kind, np.zeros((0, width), dtype=np.int64)))
        rows = np.flatnonzero(is_shared[corners].all(axis=1))
        is_first = np.ones(len(corners), dtype=bool)
        is_twice = np.zeros(len(corners), dtype=bool)
        is_first[rows], is_twice[rows] = mark_owned(comm, np.sort(nodes[corners[rows]], axis=1))
        yield kind, corners, is_first, is_twice


def mark_owned(comm: Any, keys: ndarray) -> tuple[ndarray, ndarray]:
    """Marks keys, ids (k,) or rows (k, c), that this process has first, or others have too."""
    # Keys go to their keeper, which finds the first of equal keys in the order of the processes.
    # Its answers go back in the order in which it was asked.
    keeper = (keys if keys.ndim == 1 else keys[:, 0]) % comm.size
    asked = comm.alltoall([keys[keeper == rank] for rank in range(comm.size)])
    _, first, back, count = np.unique(
        np.concatenate(asked), axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    flags = np.zeros((sum(map(len, asked)), 2), dtype=bool)
    flags[first, 0] = True
    flags[:, 1] = count[np.ravel(back)] > 1
    answers = comm.alltoall(np.split(flags, np.cumsum([len(keys) for keys in asked])[:-1]))
    marks = np.zeros((len(keys), 2), dtype=bool)
    for rank, answer in enumerate(answers):
        marks[keeper == rank] = answer
    return marks[:, 0], marks[:, 1]


@dataclasses.dataclass(frozen=True)
class WholeSurface:
    """The points (k, d) that the surface's half needs, and their `names`, ids in the whole mesh.

    The first `moving` points move, those up to `listed` are fixed, those up to `known` are on
    parallel planes or on boundary faces. The outermost points, with id -1, are last.
    """

    points: ndarray
    names: ndarray
    moving: int
    listed: int
    known: int

    def half(
        self,
        planes: Sequence[jm.Plane],
        shares: Sequence[Any],
        method: jm.AbstractMethod | None,
        is_open: bool,
    ) -> jm.SurfaceHalf:
        """Prepares the surface; `shares` has the boundary faces of each piece, or None of each."""
        free = np.arange(self.listed, self.known if is_open else self.listed)
        moving, fixed = np.split(np.arange(self.listed), [self.moving])
        known: dict[str, Any] = {"is_open": is_open}
        if shares[0] is not None:
            faces = {kind: np.concatenate([own[kind] for own in shares]) for kind in shares[0]}
            known = {"faces": {kind: self.rows(ids) for kind, ids in faces.items()}}
        try:
            boundary = jm.Boundary(self.points, moving, fixed, symmetry=planes, free=free)
            return jm.prepare_surface(boundary, nodes=self.names, method=method, **known)
        except jm.MeshError as error:
            raise error.renumbered(self.names) from None

    def rows(self, ids: ndarray) -> ndarray:
        order = np.argsort(self.names, kind="stable")
        return order[np.searchsorted(self.names, ids, sorter=order)]


def gather_surface(
    comm: Any,
    boundary: jm.Boundary,
    ids: ndarray,
    faces: dict[str, ndarray] | None,
    planes: Sequence[jm.Plane],
) -> WholeSurface:
    """Gathers the surface of all pieces; of this one `boundary`, whose points have the `ids` (n,).

    All processes get equal results, and raise together.
    """
    x = boundary.points
    ends = np.unique([x.argmin(axis=0), x.argmax(axis=0)])
    # a plane holds nodes to a share of the whole mesh's size
    extent = np.concatenate([x, *comm.allgather(x[ends])])
    guided = np.isin(ids, join_ids((faces or {}).values()))
    for plane in _parallel(planes):
        guided |= plane.holds(extent)[: len(x)]
    shares = comm.allgather(
        [(ids[rows], x[rows]) for rows in (boundary.moving, boundary.fixed, guided)]
    )
    # A node that several lists have belongs to the first: what moves, what is fixed, the rest.
    lists = [share[role] for role in range(3) for share in shares]
    role = np.repeat(np.repeat(np.arange(3), comm.size), [len(own) for own, _ in lists])
    everyone = np.concatenate([own for own, _ in lists])
    places = np.concatenate([own for _, own in lists])
    names, first, back = np.unique(everyone, return_index=True, return_inverse=True)
    torn = everyone[(places != places[first][back]).any(axis=1)]
    if torn.size:
        raise ValueError(
            f"{torn.size} nodes lie at different places in different processes, first {torn[0]}."
        )
    order = np.lexsort((names, role[first]))
    counts = np.cumsum(np.bincount(role[first], minlength=3))
    outermost = np.concatenate(comm.allgather(x[ends[~guided[ends]]]))
    points = np.concatenate([places[first[order]], outermost])
    return WholeSurface(
        points, np.append(names[order], np.full(len(outermost), -1)), *counts.tolist()
    )


def _parallel(planes: Sequence[jm.Plane]) -> list[jm.Plane]:
    """Selects the planes that are not the only one of their direction."""
    cosines = np.abs([[plane.normal @ other.normal for other in planes] for plane in planes])
    return [plane for plane, row in zip(planes, cosines, strict=True) if (row > 1 - 1e-9).sum() > 1]
