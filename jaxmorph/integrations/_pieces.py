"""Pieces of a mesh in the processes of an MPI run: shared nodes, and the boundary of the whole."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

import jaxmorph as jm
from jaxmorph._host.cells.topology import CORNERS, solid
from jaxmorph._host.package.arguments import finite_array as finite_array
from jaxmorph._host.package.arguments import real_array as real_array
from jaxmorph._host.package.arguments import rows_of as rows_of
from jaxmorph._host.package.arguments import shown
from jaxmorph._host.package.ranks import Agreement as Agreement
from jaxmorph._host.package.ranks import together as together
from jaxmorph._host.package.rounding import rows_in as rows_in
from jaxmorph._host.package.rounding import spacing as spacing
from jaxmorph._host.surface.gaps import closest as closest
from jaxmorph._host.surface.gaps import fans as fans
from jaxmorph._kernels.compile import float64_mode as float64_mode


def check_comm(comm: Any) -> None:
    if not hasattr(comm, "allgather"):
        raise ValueError(f"`comm` must be a communicator of mpi4py, MPI.COMM_WORLD for example, not {shown(comm)}.")


def faces_of(comm: Any, mesh: jm.Mesh | None, nodes: np.ndarray, is_shared: np.ndarray) -> dict[str, np.ndarray] | None:
    """Finds a piece's boundary faces (k, corners) by type, from whole ids (n,); or None."""
    if len(set(comm.allgather(mesh is None))) > 1:
        raise ValueError("some processes give a Mesh and some points alone: give a Mesh in all, or points in all.")
    if mesh is None:
        return None
    # a ghost cell counts in the first piece that has it; a face that two pieces then have lies
    # between them
    cells = {}
    for kind, ids, is_first, _ in _marked(comm, solid(mesh.linear.cells, mesh.points.shape[1]), nodes, is_shared):
        cells[kind] = ids[is_first]

    def outer() -> dict[str, np.ndarray]:
        if mesh.polyhedra is not None and mesh.between is None and comm.size > 1:
            raise ValueError(
                "polyhedra do not tell which of their faces other pieces have: read the piece by `io.read`."
            )
        if mesh.polyhedra is not None:
            return jm.boundary_faces(mesh)
        return jm.boundary_faces(jm.Mesh(mesh.points, cells)) if any(map(len, cells.values())) else {}

    marked = _marked(comm, together(comm, outer), nodes, is_shared)
    return {kind: nodes[ids[~is_twice]] for kind, ids, _, is_twice in marked}


def _marked(
    comm: Any, cells: Mapping[str, Any], nodes: np.ndarray, is_shared: np.ndarray
) -> Iterator[tuple[str, np.ndarray, np.ndarray, np.ndarray]]:
    """Yields cells or faces by type with two marks: first in this piece, also in others."""
    for kind in sorted(set().union(*comm.allgather(list(cells)))):
        corners = np.asarray(cells.get(kind, np.zeros((0, CORNERS[kind]), dtype=np.int64)))
        rows = np.flatnonzero(is_shared[corners].all(axis=1))
        is_first, is_twice = np.ones(len(corners), dtype=bool), np.zeros(len(corners), dtype=bool)
        is_first[rows], is_twice[rows] = owned(comm, np.sort(nodes[corners[rows]], axis=1))
        yield kind, corners, is_first, is_twice


def owned(comm: Any, keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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


def surface_of(
    comm: Any, boundary: jm.Boundary, ids: np.ndarray, faces: dict[str, np.ndarray] | None
) -> tuple[np.ndarray, np.ndarray, int, int, int]:
    """Gathers the points that the surface's half needs, and their ids.

    `boundary` is that of this piece, whose points have the `ids` (n,). The first m points move,
    those up to `count` are fixed, those up to `total` are on parallel planes or on the boundary's
    `faces`. The outermost points, with id -1, are last. All processes get equal results, and raise
    together.
    """
    x, planes = boundary.points, boundary.planes
    ends = np.unique([x.argmin(axis=0), x.argmax(axis=0)])
    extent = np.concatenate([x, *comm.allgather(x[ends])])  # a plane holds nodes to a share of the whole mesh's size
    guided = np.zeros(len(x), bool)
    for plane in planes:
        if sum(abs(plane.normal @ other.normal) > 0.5 for other in planes) > 1:
            guided |= plane.holds(extent)[: len(x)]
    guided |= np.isin(ids, np.concatenate([ids[:0], *(corners.ravel() for corners in (faces or {}).values())]))
    shares = comm.allgather([(ids[rows], x[rows]) for rows in (boundary.moving, boundary.fixed, guided)])
    (moving, at_moving), (fixed, at_fixed), (further, at_further) = (
        _union(parts) for parts in zip(*shares, strict=True)
    )
    rest = ~np.isin(fixed, moving)
    others = ~np.isin(further, np.concatenate([moving, fixed]))
    outermost = np.concatenate(comm.allgather(x[ends[~guided[ends]]]))
    everything = np.concatenate([at_moving, at_fixed[rest], at_further[others], outermost])
    names = np.concatenate([moving, fixed[rest], further[others], np.full(len(outermost), -1)])
    count = len(moving) + int(rest.sum())
    return everything, names, len(moving), count, count + int(others.sum())


def _union(shares: Sequence[Any]) -> tuple[np.ndarray, np.ndarray]:
    ids, points = (np.concatenate([share[k] for share in shares]) for k in range(2))
    unique, first, back = np.unique(ids, return_index=True, return_inverse=True)
    mismatched = np.flatnonzero((points != points[first][back]).any(axis=1))
    if mismatched.size:
        raise ValueError(
            f"{mismatched.size} nodes lie at different places in different processes, first {ids[mismatched[0]]}."
        )
    return unique, points[first]
