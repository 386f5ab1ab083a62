"""IDWarp's mesh object for a file of several grids that overlap, each moved by itself."""

import dataclasses
import pathlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float, Inexact

import jaxmorph as jm
from jaxmorph import io
from jaxmorph.extend import rows_of, together
from jaxmorph.io.cgns.file import open_zones, opened

from ._grid import DistributedGrid, SolverOrder, communicator, faces, numbers, reals, solver_order
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
            raise ValueError(f"`dtype` is {dtype!r}; {expected!r} is taken: complex steps have a class, MultiUSMesh_C.")
        read = (None, None) if self.comm.rank else None
        mesh, zones = together(self.comm, lambda: read or _read(CGNSFile, optionsDict))
        names, self._counts, self._grid = self.comm.bcast(zones)
        self._whole = DistributedGrid.shared(self.comm, mesh)
        self.meshes = []
        for k, name in enumerate(names):
            part = None if mesh is None else _part(mesh, np.repeat(self._grid, self._counts) == k)
            options = {**optionsDict[name], "gridFile": CGNSFile}
            self.meshes.append(self._mesh_class._of(self.comm, options, DistributedGrid.shared(self.comm, part)))
        self._order: SolverOrder | None = None
        self._chosen: list[np.ndarray] = []
        self._rows: list[np.ndarray] | None = None
        self._coordinates = np.zeros((0, 3))

    def setExternalMeshIndices(self, ind: Any) -> None:
        """Sets the file's coordinates that this process' solver has, three a node, from 0."""
        self._order = solver_order(self.comm, 3 * len(self._whole.rows), ind)
        indices, self._chosen = np.asarray(ind, dtype=np.int64).ravel(), []
        first = np.cumsum(self._counts) - self._counts
        zone = np.searchsorted(first, indices // 3, side="right") - 1
        for k, mesh in enumerate(self.meshes):
            # A grid's nodes are counted through its own zones: the shift is a zone's first node in
            # the file less that in the grid.
            counts = np.where(self._grid == k, self._counts, 0)
            shift = first - (np.cumsum(counts) - counts)
            chosen = np.flatnonzero(self._grid[zone] == k)
            self._chosen.append(chosen)
            mesh.setExternalMeshIndices(indices[chosen] - 3 * shift[zone[chosen]])

    def setSurfaceDefinition(
        self, pts: Any, conn: Any = None, faceSizes: Any = None, cgnsBlockIDs: Any = None, distTol: float = 1e-6
    ) -> None:
        """Defines the surface as `USMesh` does; IDWarp's `distTol` changes nothing here.

        `cgnsBlockIDs` is the zone of each face, counted from 0. Faces of grids that stay do not
        move.
        """
        points, corners, sizes = together(self.comm, lambda: faces(pts, conn, faceSizes))
        zones = together(self.comm, lambda: self._zones_of_faces(cgnsBlockIDs, sizes.shape))
        self._coordinates, self._rows = points.astype(self._number), []
        for k, mesh in enumerate(self.meshes):
            is_own = self._grid[zones] == k
            own = corners[np.repeat(is_own, sizes)]
            self._rows.append(np.unique(own))
            mesh.setSurfaceDefinition(points[self._rows[k]], np.searchsorted(self._rows[k], own), sizes[is_own])

    def getSurfaceCoordinates(self) -> Inexact[np.ndarray, "k 3"]:
        """Returns the surface's points that this process has, as they were set last."""
        for rows, mesh in self._parts():
            self._coordinates[rows] = mesh.getSurfaceCoordinates()
        return self._coordinates.copy()

    def setSurfaceCoordinates(self, pts: Any) -> None:
        """Sets the surface's points, as `getSurfaceCoordinates` orders them; `warpMesh` moves."""
        parts = self._parts()
        points = together(self.comm, lambda: numbers("pts", pts, self._coordinates.shape, self._number))
        for rows, mesh in parts:
            mesh.setSurfaceCoordinates(points[rows])

    def warpMesh(self) -> None:
        """Moves the grids from their first places to where the surface is."""
        for mesh in self.meshes:
            mesh.warpMesh()

    def getSolverGrid(self) -> Inexact[np.ndarray, " c"]:
        """Returns the coordinates of the moved grids, in the order of `setExternalMeshIndices`."""
        grid = self._solver().to_solver(self._whole.listed(self._whole.points)).astype(self._number)
        for chosen, mesh in zip(self._chosen, self.meshes, strict=True):
            grid[chosen] = mesh.getSolverGrid()
        return grid

    def getWarpGrid(self) -> tuple[list[Inexact[np.ndarray, " c"]], int]:
        """Returns `getCommonGrid` of each moving grid, and the count of all coordinates."""
        grids = [mesh.getCommonGrid() for mesh in self.meshes]
        return grids, self.comm.allreduce(sum(map(len, grids)))

    def warpDeriv(self, dXv: Any, solverVec: bool = True) -> Float[np.ndarray, "k 3"]:
        """Pulls the derivative by the solver's coordinates back to the surface's points (k, 3)."""
        if not solverVec:
            raise ValueError("`solverVec` must be True here; `meshes` have an order of their own each.")
        values = together(self.comm, lambda: reals("dXv", dXv, (self._solver().size,)))
        for chosen, mesh in zip(self._chosen, self.meshes, strict=True):
            mesh.warpDeriv(values[chosen])
        return self.getdXs()

    def getdXs(self) -> Float[np.ndarray, "k 3"]:
        """Returns the derivative by the surface's points that `warpDeriv` computed."""
        total = np.zeros(self._coordinates.shape)
        for rows, mesh in self._parts():
            total[rows] += mesh.getdXs()
        return total

    def warpDerivFwd(self, dXs: Any) -> Float[np.ndarray, " c"]:
        """Pushes a change of the surface's points (k, 3) forward to the solver's coordinates."""
        parts = self._parts()
        tangent = together(self.comm, lambda: reals("dXs", dXs, self._coordinates.shape))
        change = np.zeros(self._solver().size)
        for (rows, mesh), chosen in zip(parts, self._chosen, strict=True):
            change[chosen] = mesh.warpDerivFwd(tangent[rows])
        return change

    def writeGrid(self, baseName: str | None = None) -> None:
        """Writes all grids as they moved to `baseName`.cgns, IDWarpMulti.cgns by default."""
        shares = [self.comm.gather(np.real(mesh.getCommonGrid()).reshape(-1, 3)) for mesh in self.meshes]

        def write() -> None:
            mesh = self._whole.mesh
            if mesh is not None:
                points, grid = np.array(mesh.points), np.repeat(self._grid, self._counts)
                for k, parts in enumerate(shares):
                    points[mesh.file_nodes[grid == k]] = np.concatenate(parts or [])
                io.write(f"{baseName or 'IDWarpMulti'}.cgns", mesh.moved(points))

        together(self.comm, write)

    def _zones_of_faces(self, zones: Any, shape: tuple[int, ...]) -> np.ndarray:
        found = reals("cgnsBlockIDs", np.ravel(zones), shape).astype(int)
        return rows_of("cgnsBlockIDs", found, len(self._grid))

    def _solver(self) -> SolverOrder:
        if self._order is None:
            raise ValueError("the solver's order is not known: call setExternalMeshIndices.")
        return self._order

    def _parts(self) -> list[tuple[np.ndarray, USMesh]]:
        if self._rows is None:
            raise ValueError("the surface is not known: call setSurfaceDefinition.")
        return list(zip(self._rows, self.meshes, strict=True))


class MultiUSMesh_C(MultiUSMesh):
    """`MultiUSMesh` with complex coordinates, called as `idwarp.MultiUSMesh_C`: see `USMesh_C`."""

    _mesh_class = USMesh_C
    _number = complex

    def __init__(
        self, CGNSFile: str, optionsDict: Mapping[str, Mapping[str, Any]], comm: Any = None, debug: bool = False
    ):
        super().__init__(CGNSFile, optionsDict, comm, "D", debug)


def _read(path: str, options: Any) -> tuple[jm.Mesh, tuple[list[str], np.ndarray, np.ndarray]]:
    """Reads a mesh and its grids: names, and by zone its number of nodes and its grid, or -1."""
    mesh = io.read(path)
    with opened(pathlib.Path(path)) as file:
        zones = open_zones(pathlib.Path(path), file)[0]
        sizes = [(zone.name.rsplit(".", 1)[0], zone.count) for zone in zones]
    grids, counts = zip(*sizes, strict=True)
    numbers = {name: k for k, name in enumerate(name for name in dict.fromkeys(grids) if name in options)}
    missing = [name for name in options if name not in numbers]
    if missing or not numbers:
        known = ", ".join(dict.fromkeys(grids))
        raise ValueError(f"`optionsDict`: {path} has no grid {', '.join(missing)}; it has {known}.")
    return mesh, (list(numbers), np.array(counts), np.array([numbers.get(name, -1) for name in grids]))


def _part(mesh: jm.Mesh, is_own: np.ndarray) -> jm.Mesh:
    nodes, listed = np.unique(mesh.file_nodes[is_own], return_inverse=True)
    inside = {kind: ids[np.isin(ids, nodes).all(axis=1)] for kind, ids in mesh.cells.items()}
    inside |= {name: ids[np.isin(ids, nodes)] for name, ids in mesh.patches.items()}
    own = {name: np.searchsorted(nodes, ids) for name, ids in inside.items() if len(ids)}
    cells, patches = ({name: own[name] for name in names if name in own} for names in (mesh.cells, mesh.patches))
    periodic = tuple(pair for pair in io.periodic(mesh) if str(pair.patch) in patches)
    rest = {"content": None, "polyhedra": None, "cell_ids": None, "in_file": None}
    source = dataclasses.replace(mesh.source, file_nodes=listed, periodic=periodic, **rest)
    return jm.Mesh(np.asarray(mesh.points)[nodes], cells, patches, source=source)
