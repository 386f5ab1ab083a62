"""Nodes that the processes of an MPI run share, and the boundary of their whole mesh."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from jaxmorph._boundary.outer_faces import outer_faces
from jaxmorph._host.cells.adjacency import parts_of as parts_of
from jaxmorph._host.cells.topology import CORNERS, solid
from jaxmorph._host.package.arguments import shown
from jaxmorph._host.package.ranks import together
from jaxmorph._mesh.mesh import Mesh

from .._host.cells.adjacency import sorted_columns
from .._host.package.rounding import rows_in
from .._host.surface.gaps import closest as closest
from .._host.surface.gaps import fans as fans


def check_comm(comm: Any) -> None:
    """Raises `ValueError` for anything that is no communicator of mpi4py."""
    if not hasattr(comm, "allgather"):
        raise ValueError(f"`comm` must be a communicator of mpi4py, MPI.COMM_WORLD for example, not {shown(comm)}.")


def faces_of(comm: Any, mesh: Mesh | None, nodes: np.ndarray, is_shared: np.ndarray) -> dict[str, np.ndarray] | None:
    """Finds a piece's faces (k, corners) of the whole mesh's boundary by type; or None.

    `nodes` (n,) are the whole mesh's ids of the piece's points, of which other pieces share some.
    Processes raise together.
    """

    def outer() -> dict[str, np.ndarray]:
        assert mesh is not None
        if mesh.polyhedra is None:
            faces = outer_faces(Mesh(mesh.points, cells))
        elif mesh.between is not None or comm.size == 1:
            faces = outer_faces(mesh)
        else:
            raise ValueError(
                "polyhedra do not tell which of their faces other pieces have: read the piece by `io.read`."
            )
        return {} if faces is None else faces.corners

    if len(set(comm.allgather(mesh is None))) > 1:
        raise ValueError("some processes give a Mesh and some points alone: give a Mesh in all, or points in all.")
    if mesh is None:
        return None
    # a ghost cell counts in the first piece that has it; a face that two pieces then have lies
    # between them
    cells = _filtered(
        comm, solid(mesh.linear.cells, mesh.points.shape[1]), nodes, is_shared, lambda is_first, _: is_first
    )
    return {
        kind: nodes[corners]
        for kind, corners in _filtered(
            comm, together(comm, outer), nodes, is_shared, lambda _, is_twice: ~is_twice
        ).items()
    }


def _filtered(
    comm: Any,
    cells: Mapping[str, Any],
    nodes: np.ndarray,
    is_shared: np.ndarray,
    chosen: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> dict[str, np.ndarray]:
    """Chooses cells or faces by two marks: this piece has them first, other pieces have them too.

    Other processes are asked only for cells or faces whose nodes are all shared.
    """
    chosen_of_kind = {}
    for kind in sorted(set().union(*comm.allgather(list(cells)))):
        corners = np.asarray(cells.get(kind, np.zeros((0, CORNERS[kind]), dtype=np.int64)))
        rows = np.flatnonzero(is_shared[corners].all(axis=1))
        keys = np.stack(sorted_columns(list(nodes[corners[rows]].T), CORNERS[kind]), axis=1)
        is_first, is_twice = np.ones(len(corners), dtype=bool), np.zeros(len(corners), dtype=bool)
        is_first[rows], is_twice[rows] = owned(comm, keys)
        chosen_of_kind[kind] = corners[chosen(is_first, is_twice)]
    return chosen_of_kind


def joined(shares: Sequence[Any], names: np.ndarray) -> dict[str, np.ndarray]:
    """Joins the faces of all pieces, as rows of `names`."""
    return {kind: rows_in(names, np.concatenate([share[kind] for share in shares])) for kind in shares[0]}


def owned(comm: Any, keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Marks keys, ids (k,) or rows (k, c), that this process has first, and keys that others have.

    Each id has a process that keeps its list, so that no process sees the nodes of all.
    """
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
