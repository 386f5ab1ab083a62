"""A grid file in MPI processes: nodes of each, and arrays in the order of file or solver."""

import dataclasses
import pathlib
from typing import Any

import numpy as np
from jaxtyping import Inexact, Int
from numpy import ndarray

import jaxmorph as jm
from jaxmorph import io
from jaxmorph.extend import finite_array, rows_of, together

from .. import mpi
from .._pieces import check_comm

GridPoints = Inexact[ndarray, "k 3"]
GridCoordinates = Inexact[ndarray, " c"]
"""Three numbers of each point in turn."""


@dataclasses.dataclass(frozen=True, eq=False)
class DistributedGrid:
    """This process' part of a grid in 3-D; those of all processes in turn are the file's list.

    - `points` (n, 3), `nodes` (n,): coordinates, and ids in the whole mesh.
    - `rows` (k,): the row of `points` of each node in this process' part of the list, where blocks
      repeat nodes.
    - `mesh`: the whole mesh in the first process and None in others; or this process' part of a
      decomposed case.
    - `outside`: the mesh in the first process by whose patches the surface is prepared.
    - `case`: the decomposed case.
    """

    comm: Any
    points: Inexact[ndarray, "n 3"]
    nodes: Int[ndarray, " n"]
    rows: Int[ndarray, " k"]
    mesh: jm.Mesh | None
    outside: jm.Mesh | None
    case: io.Decomposed | None = None

    @staticmethod
    def read(comm: Any, path: str) -> "DistributedGrid":
        if comm.size > 1 and any(comm.allgather(bool([*pathlib.Path(path).glob("processor*")]))):
            return DistributedGrid._decomposed(comm, path)
        mesh = together(comm, lambda: None if comm.rank else _put_in_space(io.read(path), path))
        return DistributedGrid.shared(comm, mesh)

    @staticmethod
    def shared(comm: Any, mesh: jm.Mesh | None) -> "DistributedGrid":
        shares = None
        if mesh is not None:
            parts = (
                np.unique(part, return_inverse=True)
                for part in np.array_split(mesh.file_nodes, comm.size)
            )
            shares = [(np.asarray(mesh.points)[nodes], nodes, rows) for nodes, rows in parts]
        points, nodes, rows = comm.scatter(shares)
        return DistributedGrid(comm, points, nodes, rows, mesh, mesh)

    @staticmethod
    def _decomposed(comm: Any, path: str) -> "DistributedGrid":
        def part() -> tuple[io.Decomposed, jm.Mesh, Any]:
            case = io.Decomposed(path)
            if len(case) != comm.size:
                raise ValueError(
                    f"{path}: {len(case)} folders processor*, and {comm.size} processes: run as "
                    "many."
                )
            return case, _put_in_space(case.read(comm.rank), path), case.side(comm.rank)

        case, mesh, side = together(comm, part)
        sides = comm.gather(side)
        outside = together(comm, lambda: None if comm.rank else case.surface(sides))
        points = np.asarray(mesh.points)
        return DistributedGrid(
            comm, points, io.global_nodes(mesh), np.arange(len(points)), mesh, outside, case
        )

    @property
    def known(self) -> dict[str, Any]:
        """Keywords of `prepare_surface` for `outside`: nodes and faces of a decomposed case."""
        if self.case is None or self.outside is None:
            return {}
        return {"nodes": io.global_nodes(self.outside), "faces": self.outside.cells}

    def listed(self, points: GridPoints) -> GridCoordinates:
        return points[self.rows].ravel()

    def added(self, values: GridCoordinates) -> GridPoints:
        """Adds values of the file's list to its nodes: the transpose of `listed`."""
        total = np.zeros(self.points.shape)
        np.add.at(total, self.rows, values.reshape(-1, 3))
        return total

    def write(self, path: str, points: GridPoints) -> None:
        if self.case is not None and self.mesh is not None:
            with self.case.writing(path, self.comm) as writer:
                writer.add(self.comm.rank, self.mesh.moved(points))
            return
        shares = self.comm.gather((self.nodes, points))

        def whole() -> None:
            if self.mesh is not None:
                places = np.array(self.mesh.points)
                for nodes, values in shares:
                    places[nodes] = values
                io.write(path, self.mesh.moved(places))

        together(self.comm, whole)


@dataclasses.dataclass(frozen=True, eq=False)
class SolverOrder:
    """Takes coordinates from the list of all processes to the solver's list of each, and back.

    - `count`: numbers of the list in this process.
    - `sent`: their places, for each process in that process' order.
    - `places`: the places in this process' solver of the numbers from each process.
    """

    comm: Any
    count: int
    sent: list[ndarray]
    places: list[ndarray]

    @property
    def size(self) -> int:
        return sum(map(len, self.places))

    def to_solver(self, values: ndarray) -> ndarray:
        return self._sent(values, self.sent, self.places, self.size)

    def from_solver(self, values: ndarray) -> ndarray:
        """Adds up the solvers' numbers: the transpose of `to_solver`."""
        return self._sent(values, self.places, self.sent, self.count)

    def _sent(
        self, values: ndarray, sent: list[ndarray], places: list[ndarray], size: int
    ) -> ndarray:
        result = np.zeros(size, values.dtype)
        for rows, answer in zip(
            places, self.comm.alltoall([values[rows] for rows in sent]), strict=True
        ):
            np.add.at(result, rows, answer)
        return result


def solver_order(comm: Any, count: int, indices: Any) -> SolverOrder:
    """Finds who has what. `indices` (k,) count the numbers of all processes from 0."""
    firsts = np.cumsum([0, *comm.allgather(count)])
    wanted = together(
        comm, lambda: rows_of("indices", whole_numbers("indices", indices), int(firsts[-1]))
    )
    keeper = np.searchsorted(firsts, wanted, side="right") - 1
    places = [np.flatnonzero(keeper == rank) for rank in range(comm.size)]
    sent = comm.alltoall([wanted[rows] - firsts[rank] for rank, rows in enumerate(places)])
    return SolverOrder(comm, count, sent, places)


def _put_in_space(mesh: jm.Mesh, path: str) -> jm.Mesh:
    if mesh.points.shape[1] != 3:
        raise ValueError(
            f"{path}: this mesh is in 2-D, and IDWarp's coordinates are in 3-D: take "
            "`jaxmorph.prepare`."
        )
    return mesh


def communicator(comm: Any) -> Any:
    comm = mpi.MPI.COMM_WORLD if comm is None else comm
    check_comm(comm)
    return comm


def surface_blocks(comm: Any, path: str) -> tuple[ndarray, ndarray]:
    """Reads a PLOT3D surface's points (k, 3) and quadrilaterals (q, 4); in the first process."""
    if comm.rank:
        return np.zeros((0, 3)), np.zeros((0, 4), int)
    mesh = io.read(path)
    points = mesh.in_file_order(mesh.points)
    if points.shape[1] != 3 or list(mesh.cells) != ["quad"]:
        raise ValueError(
            f"{path}: a surface in 3-D of blocks with one layer of nodes is expected, not {mesh}."
        )
    first = np.unique(mesh.file_nodes, return_index=True)[1]
    return points, first[np.asarray(mesh.cells["quad"])]


def faces(points: Any, conn: Any, sizes: Any) -> tuple[ndarray, ndarray, ndarray]:
    points = reals("pts", points if np.size(points) else np.zeros((0, 3)), (None, 3))
    corners = whole_numbers("conn", conn)
    counts = whole_numbers("faceSizes", sizes)
    if (counts < 3).any() or counts.sum() != len(corners):
        raise ValueError(
            f"`faceSizes` adds up to {counts.sum()}, and `conn` has {len(corners)} corners; a "
            "face has 3 or more."
        )
    return points, rows_of("conn", corners, len(points)), counts


def whole_numbers(name: str, values: Any) -> ndarray:
    array = reals(name, np.ravel(values), (None,))
    if not (array == np.floor(array)).all():
        raise ValueError(f"`{name}` must be whole numbers.")
    return array.astype(np.int64)


def reals(name: str, values: Any, shape: tuple[int | None, ...]) -> ndarray:
    return finite_array(name, values, shape).astype(float)


def agree(comm: Any, name: str, values: Any, shape: tuple[int, ...]) -> ndarray:
    """Checks numbers in each process; all raise together."""
    return together(comm, lambda: reals(name, values, shape))
