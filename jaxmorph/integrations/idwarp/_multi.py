"""IDWarp's mesh object for a file of several grids that overlap, each moved by itself."""

import dataclasses
import pathlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy import ndarray

import jaxmorph as jm
from jaxmorph import io
from jaxmorph.extend import rows_of, together
from jaxmorph.io.cgns.file import open_tree, open_zones

from ._grid import (
    DistributedGrid,
    GridCoordinates,
    GridPoints,
    SolverOrder,
    agree,
    communicator,
    faces,
    solver_order,
)
from ._mesh import USMesh, USMesh_C


class MultiUSMesh:
    """Moves overlapping grids in one CGNS file, called as `idwarp.MultiUSMesh`, without cgns_utils.

    A grid is the zones `wing.00000`, `wing.00001`, ... of one name before the last dot. Each grid
    of `optionsDict` is a `USMesh`, and moves with the part of the surface in its zones. The others
    stay.

    **Arguments:**

    - `CGNSFile`: the file.
    - `optionsDict`: options of `USMesh` by the name of a grid, but `gridFile`.
    - `comm`, `debug`: as `USMesh` takes them.
    - `dtype`: "d"; `MultiUSMesh_C` is for complex steps.

    **Raises:** `ValueError`, in every process, for names of no grid, and as `USMesh` does.
    """

    _mesh_class = USMesh
    _number: type = float

    def __init__(
        self,
        CGNSFile: str,
        optionsDict: Mapping[str, Mapping[str, Any]],
        comm: Any = None,
        dtype: str = "d",
        debug: bool = False,
    ):
        self.comm = communicator(comm)
        expected = "d" if self._number is float else "D"
        if dtype != expected:
            raise ValueError(
                f"`dtype` is {dtype!r}; {expected!r} is taken: complex steps have a class, "
                "MultiUSMesh_C."
            )
        mesh, grids = together(
            self.comm,
            lambda: (None, None) if self.comm.rank else _read_grids(CGNSFile, optionsDict),
        )
        names, self._zones, counts = self.comm.bcast(grids)
        self._grid = np.repeat(self._zones, counts)
        self._whole = DistributedGrid.shared(self.comm, mesh)
        self.meshes = []
        for k, name in enumerate(names):
            part = DistributedGrid.shared(
                self.comm, None if mesh is None else _part_of(mesh, self._grid == k)
            )
            options = {**optionsDict[name], "gridFile": CGNSFile}
            self.meshes.append(self._mesh_class._of(self.comm, options, part))
        self._order: SolverOrder | None = None
        self._chosen: list[ndarray] = []
        self._rows: list[ndarray] | None = None
        self._coordinates = np.zeros((0, 3))

    def setExternalMeshIndices(self, ind: Any) -> None:
        """Sets the file's coordinates that this process' solver has, three a node, from 0."""
        self._order = solver_order(self.comm, 3 * len(self._whole.rows), ind)
        nodes, axis = np.divmod(np.asarray(ind, dtype=np.int64).ravel(), 3)
        self._chosen = [np.flatnonzero(self._grid[nodes] == k) for k in range(len(self.meshes))]
        for k, (chosen, mesh) in enumerate(zip(self._chosen, self.meshes, strict=True)):
            place = np.cumsum(self._grid == k) - 1  # of a node of the file in the grid's own list
            mesh.setExternalMeshIndices(3 * place[nodes[chosen]] + axis[chosen])

    def setSurfaceDefinition(
        self,
        pts: Any,
        conn: Any = None,
        faceSizes: Any = None,
        cgnsBlockIDs: Any = None,
        distTol: float = 1e-6,
    ) -> None:
        """Defines the surface as `USMesh` does; IDWarp's `distTol` changes nothing here.

        `cgnsBlockIDs` is the zone of each face, counted from 0. Faces of grids that stay do not
        move.
        """
        points, corners, sizes = together(self.comm, lambda: faces(pts, conn, faceSizes))
        zones = agree(self.comm, "cgnsBlockIDs", np.ravel(cgnsBlockIDs), sizes.shape).astype(int)
        zones = together(self.comm, lambda: rows_of("cgnsBlockIDs", zones, len(self._zones)))
        self._coordinates = points.astype(self._number)
        self._rows = []
        for k, mesh in enumerate(self.meshes):
            is_own = self._zones[zones] == k
            own = corners[np.repeat(is_own, sizes)]
            self._rows.append(np.unique(own))
            mesh.setSurfaceDefinition(
                points[self._rows[k]], np.searchsorted(self._rows[k], own), sizes[is_own]
            )

    def getSurfaceCoordinates(self) -> GridPoints:
        """Returns the surface's points that this process has, as they were set last."""
        for rows, mesh in self._parts():
            self._coordinates[rows] = mesh.getSurfaceCoordinates()
        return self._coordinates.copy()

    def setSurfaceCoordinates(self, pts: Any) -> None:
        """Sets the surface's points, as `getSurfaceCoordinates` orders them; `warpMesh` moves."""
        parts = self._parts()
        shape = self._coordinates.shape
        is_real = self._number is float
        points = agree(self.comm, "pts", pts if is_real else np.real(pts), shape)
        points = points if is_real else points + 1j * agree(self.comm, "pts", np.imag(pts), shape)
        for rows, mesh in parts:
            mesh.setSurfaceCoordinates(points[rows])

    def warpMesh(self) -> None:
        """Moves the grids from their first places to where the surface is."""
        for mesh in self.meshes:
            mesh.warpMesh()

    def getSolverGrid(self) -> GridCoordinates:
        """Returns the coordinates of the moved grids, in the order of `setExternalMeshIndices`."""
        grid = self._solver().to_solver(self._whole.listed(self._whole.points)).astype(self._number)
        for chosen, mesh in zip(self._chosen, self.meshes, strict=True):
            grid[chosen] = mesh.getSolverGrid()
        return grid

    def getWarpGrid(self) -> tuple[list[GridCoordinates], int]:
        """Returns `getCommonGrid` of each moving grid, and the count of all coordinates."""
        grids = [mesh.getCommonGrid() for mesh in self.meshes]
        return grids, self.comm.allreduce(sum(map(len, grids)))

    def warpDeriv(self, dXv: Any, solverVec: bool = True) -> GridPoints:
        """Pulls the derivative by the solver's coordinates back to the surface's points (k, 3)."""
        if not solverVec:
            raise ValueError(
                "`solverVec` must be True here; `meshes` have an order of their own each."
            )
        values = agree(self.comm, "dXv", dXv, (self._solver().size,))
        for chosen, mesh in zip(self._chosen, self.meshes, strict=True):
            mesh.warpDeriv(values[chosen])
        return self.getdXs()

    def getdXs(self) -> GridPoints:
        """Returns the derivative by the surface's points that `warpDeriv` computed."""
        total = np.zeros(self._coordinates.shape)
        for rows, mesh in self._parts():
            total[rows] += mesh.getdXs()
        return total

    def warpDerivFwd(self, dXs: Any) -> GridCoordinates:
        """Pushes a change of the surface's points (k, 3) forward to the solver's coordinates."""
        parts = self._parts()
        tangent = agree(self.comm, "dXs", dXs, self._coordinates.shape)
        change = np.zeros(self._solver().size)
        for (rows, mesh), chosen in zip(parts, self._chosen, strict=True):
            change[chosen] = mesh.warpDerivFwd(tangent[rows])
        return change

    def writeGrid(self, baseName: str | None = None) -> None:
        """Writes all grids as they moved to `baseName`.cgns, IDWarpMulti.cgns by default."""
        shares = [
            self.comm.gather(np.real(mesh.getCommonGrid()).reshape(-1, 3)) for mesh in self.meshes
        ]

        def write() -> None:
            mesh = self._whole.mesh
            if mesh is not None:
                points = np.array(mesh.points)
                for k, parts in enumerate(shares):
                    points[mesh.file_nodes[self._grid == k]] = np.concatenate(parts or [])
                io.write(f"{baseName or 'IDWarpMulti'}.cgns", mesh.moved(points))

        together(self.comm, write)

    def _solver(self) -> SolverOrder:
        if self._order is None:
            raise ValueError("the solver's order is not known: call setExternalMeshIndices.")
        return self._order

    def _parts(self) -> list[tuple[ndarray, USMesh]]:
        if self._rows is None:
            raise ValueError("the surface is not known: call setSurfaceDefinition.")
        return list(zip(self._rows, self.meshes, strict=True))


class MultiUSMesh_C(MultiUSMesh):
    """`MultiUSMesh` with complex coordinates, called as `idwarp.MultiUSMesh_C`: see `USMesh_C`."""

    _mesh_class = USMesh_C
    _number = complex

    def __init__(
        self,
        CGNSFile: str,
        optionsDict: Mapping[str, Mapping[str, Any]],
        comm: Any = None,
        debug: bool = False,
    ):
        super().__init__(CGNSFile, optionsDict, comm, "D", debug)


def _read_grids(path: str, options: Any) -> tuple[jm.Mesh, tuple[list[str], ndarray, ndarray]]:
    """Reads a mesh and its grids: names, and by zone its grid, or -1, and its number of nodes."""
    with open_tree(pathlib.Path(path)) as file:
        zones = open_zones(pathlib.Path(path), file)[0]
        counts = [zone.count for zone in zones]
        grids = [zone.name.rsplit(".", 1)[0] for zone in zones]
    names = [name for name in dict.fromkeys(grids) if name in options]
    if len(names) < max(len(options), 1):
        known = ", ".join(dict.fromkeys(grids))
        missing = ", ".join(name for name in options if name not in names)
        raise ValueError(f"`optionsDict`: {path} has no grid {missing}; it has {known}.")
    numbers = [names.index(name) if name in names else -1 for name in grids]
    return io.read(path), (names, np.array(numbers), np.array(counts))


def _part_of(mesh: jm.Mesh, is_own: ndarray) -> jm.Mesh:
    nodes, listed = np.unique(mesh.file_nodes[is_own], return_inverse=True)

    def own(lists: Mapping[str, Any]) -> dict[str, ndarray]:
        inside = {
            name: ids[np.isin(ids, nodes).reshape(len(ids), -1).all(axis=1)]
            for name, ids in lists.items()
        }
        return {name: np.searchsorted(nodes, ids) for name, ids in inside.items() if len(ids)}

    cells = own(mesh.cells)
    patches = own(mesh.patches)
    periodic = tuple(pair for pair in io.periodic(mesh) if str(pair.patch) in patches)
    rest = {"content": None, "polyhedra": None, "cell_ids": None, "in_file": None}
    source = dataclasses.replace(mesh.source, file_nodes=listed, periodic=periodic, **rest)
    return jm.Mesh(np.asarray(mesh.points)[nodes], cells, patches, source=source)
