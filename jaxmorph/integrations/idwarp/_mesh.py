"""IDWarp's mesh object in one grid, with its options."""

import types
import warnings
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Complex
from numpy import ndarray

import jaxmorph as jm
from jaxmorph.extend import float64_mode, join_ids, together

from .. import mpi
from ._grid import (
    DistributedGrid,
    GridCoordinates,
    GridPoints,
    SolverOrder,
    agree,
    communicator,
    faces,
    solver_order,
    surface_blocks,
)
from ._surface import Definition, Follower, boundary_of, patches_by_kind

IDWARP_OPTIONS: dict[str, tuple[tuple[type, ...], Any]] = {
    "gridFile": ((str,), None),
    "fileType": ((str,), "CGNS"),
    "specifiedSurfaces": ((list, tuple), None),
    "symmetrySurfaces": ((list, tuple), None),
    "symmetryPlanes": ((list, tuple, ndarray), None),
    "symmTol": ((int, float), 1e-6),
    "useRotations": ((bool,), None),
    "aExp": ((int, float), 3.0),
    "bExp": ((int, float), 5.0),
    "alpha": ((int, float), 0.25),
    "LdefFact": ((int, float), 1.0),
    "errTol": ((int, float), 5e-4),
    "evalMode": ((str,), "fast"),
    "zeroCornerRotations": ((bool,), True),
    "cornerAngle": ((int, float), 30.0),
    "restartFile": ((str,), None),
    "bucketSize": ((int,), 8),
}
"""IDWarp's options: the types that each takes beside None, and its default."""
WEIGHTS = ("aExp", "bExp", "alpha")
WITHOUT = (
    "LdefFact",
    "errTol",
    "evalMode",
    "zeroCornerRotations",
    "cornerAngle",
    "restartFile",
    "bucketSize",
)
"""Options without a counterpart here."""
FILE = ("gridFile", "fileType")


def complete_options(options: Any) -> dict[str, Any]:
    """Completes options by IDWarp's defaults, and adds a list of those that were given."""
    if not isinstance(options, Mapping):
        raise ValueError(
            f"`options` must be a dictionary of options by name, such as gridFile, not {options!r}."
        )
    values = {name_of(name): value for name, value in options.items()}
    for name, value in values.items():
        if value is not None:
            _check_option(name, value)
    if values.get("gridFile") is None:
        raise ValueError("`gridFile` must be the name of a grid; its ending tells what it is.")
    return {name: values.get(name, default) for name, (_, default) in IDWARP_OPTIONS.items()} | {
        "told": tuple(values)
    }


def name_of(name: str) -> str:
    known = {option.lower(): option for option in IDWARP_OPTIONS}
    if str(name).lower() not in known:
        raise ValueError(
            f"`options`: IDWarp has no option {name}; it has {', '.join(IDWARP_OPTIONS)}."
        )
    return known[name.lower()]


def _check_option(name: str, value: Any) -> None:
    kinds: Any = IDWARP_OPTIONS[name][0]
    expected = EXPECTED.get(name, " or ".join(kind.__name__ for kind in kinds))
    try:
        if not isinstance(value, kinds) or (type(value) is bool and bool not in kinds):
            raise TypeError
        entries: Any = value
        if name.endswith("Surfaces"):
            "".join(entries)  # refuses what is no name
        if name == "symmetryPlanes":
            np.asarray(entries, dtype=float).reshape(len(entries), 2, 3)
    except (TypeError, ValueError):
        raise ValueError(f"`{name}` is {value!r}; expected {expected}.") from None


EXPECTED = {
    "specifiedSurfaces": "names of patches",
    "symmetrySurfaces": "names of patches",
    "symmetryPlanes": "a point and a normal for each: [[[0, 0, 0], [0, 1, 0]]]",
}
"""What list options hold."""


def warn_of(options: Mapping[str, Any]) -> None:
    without = WITHOUT if options["useRotations"] is not None else (*WEIGHTS, *WITHOUT)
    told = [name for name in without if name in options["told"] and options[name] is not None]
    if told:
        by = (
            "IDWarp's, not approximated"
            if without is WITHOUT
            else "the default of jaxmorph.prepare"
        )
        warnings.warn(
            f"options of IDWarp that nothing corresponds to here: {', '.join(told)}. The method "
            f"is {by}.",
            stacklevel=3,
        )


def method(options: Mapping[str, Any], is_loose: bool) -> jm.AbstractMethod | None:
    turns = options["useRotations"]
    if turns is None and not is_loose:
        return None
    far, near, alpha = (options[name] for name in WEIGHTS)
    return jm.InverseDistance(far=far, near=near, alpha=alpha, rotations=turns is not False)


class USMesh:
    """Moves a volume mesh as its surface moves, called as `idwarp.USMesh`: one import changes.

    Processes of an MPI run call it together. Arrays are NumPy's and float64, whatever JAX's mode
    is.

    - `setSurfaceDefinition` may define a surface of other points than the wall's nodes, which
      follow by a linear map. Without a definition the surface is the nodes of the wall patches, or
      of `specifiedSurfaces`, each once, in the file's order. The first process has all of a file;
      with folders `processor*` each has its own.
    - Nodes of patches that are neither walls nor symmetry planes are fixed. IDWarp lets them
      follow.

    **Arguments:**

    - `options`: IDWarp's options by name, in any case. `useRotations` chooses IDWarp's method,
      `InverseDistance(rotations=...)`, with `aExp`, `bExp` and `alpha`. Without it the method is
      `prepare`'s default, or IDWarp's where patches are overset and none is fixed. `symmTol` is the
      tolerance of nodes on `symmetryPlanes`; without planes the file tells symmetry.
    - `comm`: the communicator. Default: that of all processes.
    - `debug`: changes nothing.

    **Warns:** of options without a counterpart.

    **Raises:** `ValueError`, in every process, for an unknown option, values of another type, a
    mesh in 2-D, and what `jaxmorph.io.read` refuses.
    """

    def __init__(
        self, options: Mapping[str, Any] | None = None, comm: Any = None, debug: bool = False
    ):
        comm = communicator(comm)
        self._begin(comm, options, lambda path: DistributedGrid.read(comm, path))

    @classmethod
    def _of(cls, comm: Any, options: Mapping[str, Any], grid: DistributedGrid) -> "USMesh":
        mesh = cls.__new__(cls)
        mesh._begin(comm, options, lambda path: grid)
        return mesh

    def _begin(self, comm: Any, options: Any, read: Callable[[str], DistributedGrid]) -> None:
        self.comm = comm
        self._options = together(comm, lambda: complete_options(options))
        if comm.rank == 0:
            warn_of(self._options)
        self._grid = read(self._options["gridFile"])
        self._moved = self._grid.points
        self._order: SolverOrder | None = None
        self._surface: Follower | None = None
        self._coordinates = self._dXs = np.zeros((0, 3))

    def getSurfaceCoordinates(self) -> GridPoints:
        """Returns the surface's points that this process has, as they were set last."""
        self._defined()
        return self._coordinates.copy()

    def setSurfaceCoordinates(self, coordinates: Any) -> None:
        """Sets the surface's points, as `getSurfaceCoordinates` orders them; `warpMesh` moves."""
        self._coordinates = self._rows("coordinates", coordinates)

    def setSurfaceDefinition(
        self, pts: Any, conn: Any, faceSizes: Any, cgnsBlockID: Any = None
    ) -> None:
        """Defines the surface by this process' points (k, 3) and faces; equal points are one.

        Wall nodes move as the closest point of its faces, or as the three nearest points where
        there are none.

        **Arguments:**

        - `pts`: coordinates (k, 3), none where this process has no part of the surface.
        - `conn`, `faceSizes`: the corners of all faces in one list, counted from 0 in `pts`, and
          how many each face has.
        - `cgnsBlockID`: changes nothing.

        **Raises:** `ValueError`, in every process, for other shapes, and for a surface without a
        patch of the mesh.
        """
        self._define(*together(self.comm, lambda: faces(pts, conn, faceSizes)), is_own=False)

    def setSurfaceDefinitionFromFile(self, surfFile: str) -> None:
        """Defines the surface by the blocks of a PLOT3D file, which the first process has."""
        points, corners = together(self.comm, lambda: surface_blocks(self.comm, surfFile))
        self.setSurfaceDefinition(points, corners.ravel(), np.full(len(corners), 4))

    def setSurfaceFromFile(self, surfFile: str) -> None:
        """Sets the surface's points from a file in blocks as `setSurfaceDefinitionFromFile`'s."""
        self.setSurfaceCoordinates(
            together(self.comm, lambda: surface_blocks(self.comm, surfFile))[0]
        )

    def setExternalMeshIndices(self, ind: Any) -> None:
        """Sets the file's coordinates that this process' solver has, three a node, counted from 0.

        The list is that of `getCommonGrid` of all processes, one after the other.
        """
        self._order = solver_order(self.comm, 3 * len(self._grid.rows), ind)

    def getSolverGrid(self) -> GridCoordinates:
        """Returns the coordinates of the moved mesh, in the order of `setExternalMeshIndices`."""
        return self._solver().to_solver(self.getCommonGrid())

    def getCommonGrid(self) -> GridCoordinates:
        """Returns this process' coordinates of the moved mesh in the file's order."""
        return self._grid.listed(self._moved)

    def getWarpGrid(self) -> GridCoordinates:
        """Returns what `getCommonGrid` does: no other order is used here."""
        return self.getCommonGrid()

    def warpMesh(self) -> None:
        """Moves the mesh from its first place to where the surface is."""
        self._moved = self._defined().deform(self._coordinates)

    def warpDeriv(self, dXv: Any, solverVec: bool = True) -> None:
        """Pulls the derivative by mesh coordinates back to the surface's points; see `getdXs`.

        `dXv` is in the order of `getSolverGrid`, or of `getCommonGrid` where `solverVec` is False.
        Contributions of processes add up.
        """
        seed = self._grid.added(self._volume(dXv, solverVec))
        self._dXs = self._defined().pullback(self._coordinates, seed)

    def getdXs(self) -> GridPoints:
        """Returns the derivative by the surface's points that `warpDeriv` computed."""
        return self._dXs.copy()

    def warpDerivFwd(self, dXs: Any, solverVec: bool = True) -> GridCoordinates:
        """Moves the mesh, and pushes a change of the surface's points (k, 3) forward to it.

        The result is in the order of `getSolverGrid`, or of `getCommonGrid` without `solverVec`.
        """
        tangent = self._rows("dXs", np.reshape(np.asarray(dXs, float), (-1, 3)))
        self.warpMesh()
        change = self._grid.listed(self._defined().pushforward(self._coordinates, tangent))
        return self._solver().to_solver(change) if solverVec else change

    def verifyWarpDeriv(
        self,
        dXv: Any = None,
        solverVec: bool = True,
        dofStart: int = 0,
        dofEnd: int = 10,
        h: float = 1e-6,
        randomSeed: int = 314,
    ) -> float:
        """Compares `warpDeriv` with central differences, and prints a line for each coordinate.

        `dXv`, random by default, and `solverVec` are as `warpDeriv` takes them. Coordinates from
        `dofStart` to before `dofEnd` count over the points of all processes. The step `h` has the
        mesh's unit. Returns the largest difference, relative to the largest derivative.
        """
        surface = self._defined()
        if dXv is None:
            random = np.random.default_rng([randomSeed, self.comm.rank])
            dXv = random.random(3 * len(self._grid.rows))
            solverVec = False
        seed = self._volume(dXv, solverVec)
        self.warpDeriv(seed, solverVec=False)
        slopes = np.concatenate(self.comm.allgather(self._dXs)).ravel()
        worst = 0.0
        for dof in range(dofStart, min(dofEnd, len(slopes))):
            step = h * (np.arange(len(slopes)) == dof).reshape(-1, 3)[surface.own]
            ahead, behind = (surface.deform(self._coordinates + change) for change in (step, -step))
            slope = self.comm.allreduce(float(seed @ self._grid.listed(ahead - behind))) / (2 * h)
            worst = max(worst, abs(slope - float(slopes[dof])))
            if self.comm.rank == 0:
                print(
                    f"surface coordinate {dof}: derivative {slopes[dof]:.12e}, difference "
                    f"{slope:.12e}"
                )
        return worst / (float(np.abs(slopes).max(initial=0.0)) or 1.0)

    def writeGrid(self, fileName: str | None = None) -> None:
        """Writes the moved mesh: a file in `gridFile`'s format, or an OpenFOAM case or time.

        Raises `ValueError` without a name: the input is never overwritten.
        """
        if fileName is None:
            raise ValueError(
                "`fileName` is missing: name a new file or folder; what the mesh was read from "
                "is kept."
            )
        self._grid.write(fileName, np.real(self._moved))

    def getOption(self, name: str) -> Any:
        """Returns an option, whose name may be in any case."""
        return self._options[name_of(name)]

    def setOption(self, name: str, value: Any) -> None:
        """Sets an option, which holds for the surface that is defined next.

        Raises `ValueError` for options of a grid, and of a defined surface.
        """
        name = name_of(name)
        if name in FILE or (name not in WITHOUT and self._surface is not None):
            what = "the grid is read" if name in FILE else "the surface is defined"
            raise ValueError(f"`{name}` is taken when {what}: give it to USMesh.")
        given = {key: self._options[key] for key in self._options["told"]}
        self._options = complete_options(given | {name: value})

    def printOptions(self) -> None:
        """Prints the options and their values, in the first process."""
        if self.comm.rank == 0:
            print(
                "\n".join(
                    f"{name}: {self.getOption(name)!r}" for name in self._options if name != "told"
                )
            )

    @property
    def warp(self) -> Any:
        """Numbers of this process' coordinates, called as `warp.griddata.warpmeshdof` in IDWarp."""
        count = 3 * len(self._grid.rows)
        solvers = 0 if self._order is None else self._order.size
        sizes = types.SimpleNamespace(commonmeshdof=count, warpmeshdof=count, solvermeshdof=solvers)
        return types.SimpleNamespace(griddata=sizes)

    def _defined(self) -> Follower:
        """Returns the surface; where no solver has defined one, that of the wall patches."""
        if self._surface is None:
            outside = self._grid.outside
            names = together(self.comm, lambda: None if outside is None else self._walls(outside))
            names = self.comm.bcast(names)
            mesh = self._grid.mesh
            patches = {} if mesh is None else mesh.patches
            rows = np.unique(join_ids(patches[name] for name in names if name in patches))
            points = np.zeros((0, 3)) if mesh is None else np.asarray(mesh.points, float)[rows]
            self._define(points, np.zeros(0, int), np.zeros(0, int), is_own=True)
        assert self._surface is not None
        return self._surface

    def _walls(self, mesh: jm.Mesh) -> tuple[str, ...]:
        walls = patches_by_kind(mesh, self._options)["wall"]
        if not walls:
            raise ValueError(
                "no patch is a wall: name the moving patches in the option `specifiedSurfaces`, "
                "or call setSurfaceDefinition. "
                f"There are {', '.join(mesh.patches)}."
            )
        return walls

    def _define(self, points: ndarray, corners: ndarray, sizes: ndarray, is_own: bool) -> None:
        definition = Definition.gathered(self.comm, points, corners, sizes)
        grid = self._grid

        def prepared() -> tuple[jm.SurfaceHalf, Any] | None:
            if grid.outside is None:
                return None
            if not len(definition.points):
                raise ValueError("the surface has no points: no process defines any.")
            boundary, weights = boundary_of(grid.outside, self._options, definition, is_own)
            is_loose = len(boundary.free) > 0 and not len(boundary.fixed)
            half = jm.prepare_surface(
                boundary, method=method(self._options, is_loose), **grid.known
            )
            ids = grid.known.get("nodes", np.arange(len(grid.outside.points)))[boundary.moving]
            return half, weights[np.argsort(half.rows(ids))]

        with float64_mode():
            half, weights = self.comm.bcast(together(self.comm, prepared))
            piece = mpi.attach(self.comm, half, grid.points, grid.nodes)
        self._surface = Follower(piece, weights, points)
        self._coordinates = points
        self._dXs = np.zeros_like(points)

    def _solver(self) -> SolverOrder:
        if self._order is None:
            raise ValueError(
                "the solver's order is not known: call setExternalMeshIndices, or take the order "
                "of the file, by getCommonGrid "
                "and solverVec=False."
            )
        return self._order

    def _rows(self, name: str, values: Any) -> ndarray:
        return agree(self.comm, name, values, self._defined().points.shape)

    def _volume(self, values: Any, is_solvers: bool) -> ndarray:
        if not is_solvers:
            return agree(self.comm, "dXv", values, (3 * len(self._grid.rows),))
        order = self._solver()
        return order.from_solver(agree(self.comm, "dXv", values, (order.size,)))


class USMesh_C(USMesh):
    """`USMesh` with complex coordinates, called as `idwarp.USMesh_C`.

    The real parts move the mesh as `USMesh` does. The imaginary parts come from the derivative, as
    in `warpDerivFwd`, so a step may be as small as 1e-200.
    """

    _step: ndarray | None = None

    def getSurfaceCoordinates(self) -> Complex[ndarray, "k 3"]:
        """Returns the surface's points that this process has, with their steps."""
        points = super().getSurfaceCoordinates()
        return points + 1j * (0 if self._step is None else self._step)

    def setSurfaceCoordinates(self, coordinates: Any) -> None:
        """Sets the surface's points and steps, as `getSurfaceCoordinates` orders them."""
        values = np.asarray(coordinates, complex)
        super().setSurfaceCoordinates(np.real(values))
        self._step = self._rows("coordinates", np.imag(values))

    def warpMesh(self) -> None:
        """Moves the mesh from its first place to where the surface is, with the steps."""
        super().warpMesh()
        if self._step is not None:
            self._moved = self._moved + 1j * self._defined().pushforward(
                self._coordinates, self._step
            )
