"""Memory and time, foreseen before the work starts."""

import dataclasses
import os
from collections.abc import Sequence

import numpy as np
from jaxtyping import ArrayLike, Int

from .._boundary.boundary import node_ids
from .._host.cells.topology import FACES
from .._host.package.arguments import checked, whole
from .._mesh.mesh import Mesh
from .._methods.base import AbstractMethod
from .._methods.rbf.fitted import FittedRBF
from .._methods.rbf.rbf import RBF
from .._methods.rbf.solvers import Iterative
from .._methods.reconstruction import SurfaceReconstruction

START = 0.3e9
"""Bytes of the process before it has read anything."""

PAIR, POINT, CELL, SOURCES = 1.8e-9, {2: 5e-6, 3: 15e-6}, 8e-6, 1e-10
"""Seconds: of the sum for a pair of point and source, of preparing a point in 2-D and 3-D, of judging a cell; for sources cubed."""

FACE = 200
"""Bytes for each face of each cell while cells are judged: neighbours are found by sorting them."""

PRODUCTS = 14
"""Products with the kernel in a solve by iterations."""

COMPILING = 2.0
"""Seconds that each stage takes on the smallest mesh."""


@dataclasses.dataclass(frozen=True)
class Estimate:
    """Memory and time of moving and judging a mesh, to the order of magnitude.

    - `points`, `surface`, `sources`: numbers of points, of nodes of the surface, and of sources.
    - `memory`: in bytes, at the most.
    - `preparing`, `deforming`, `judging`: in seconds.

    `str` gives all of it in a line.
    """

    points: int
    surface: int
    sources: int
    memory: float
    preparing: float
    deforming: float
    judging: float

    @property
    def seconds(self) -> float:
        """The three stages together."""
        return self.preparing + self.deforming + self.judging

    @property
    def is_too_large(self) -> bool:
        """True where this machine has less memory."""
        return self.memory > _physical_memory()

    def __str__(self) -> str:
        return (
            f"estimate {self.points} points, {self.surface} surface nodes, {self.sources} sources: about "
            f"{self.memory / 1e9:.2g} GB, {self.seconds:.2g} s"
        )


@checked
def estimate(
    mesh: Mesh,
    moving: Int[ArrayLike, " m"] | Sequence[int],
    fixed: Int[ArrayLike, " f"] | Sequence[int] = (),
    *,
    method: AbstractMethod | None = None,
    steps: int = 1,
    chunk: int | None = None,
) -> Estimate:
    """Estimates the memory and the time that moving and judging a mesh will take, from measurements on one core of a server.

    **Arguments:**

    - `mesh`: the precision of its points is that of the calculation.
    - `moving`, `fixed`, `method`: as `prepare` takes them.
    - `steps`: of `march`.
    - `chunk`: the `size` of `prepare_in_chunks`; None for the mesh as a whole.

    **Returns:** an `Estimate`.

    **Raises:** `ValueError` for ids that are no nodes, and for less than one step or one node a chunk.
    """
    n, d = mesh.points.shape
    moving, fixed = node_ids(moving, "moving", n), node_ids(fixed, "fixed", n)
    whole("steps", steps)
    if chunk is not None:
        whole("chunk", chunk)
    b = len(np.union1d(moving, fixed))
    method = SurfaceReconstruction() if method is None else method
    s = _sources(method, np.asarray(mesh.points), moving, fixed)
    planned = n if chunk is None else min(n, b + chunk)
    parts = 1 if chunk is None else max(1, -(-(n - b) // chunk))
    size = np.dtype(mesh.points.dtype).itemsize / 8
    quality = FACE * sum(len(ids) * len(FACES[kind]) for kind, ids in mesh.cells.items())
    solver = _iterative(method, s)
    if solver is not None:
        system, solve = 5000 * s + 24 * solver.dense_count(s) ** 2, PRODUCTS * s**2 * PAIR
    else:
        system, solve = 24 * s**2, SOURCES * s**3
    memory = START + size * (500 * (n + planned) + system) + quality
    fit = solve if solver is None else solve / 4  # a few of its steps
    located = 0 if isinstance(method, RBF) else n + (parts - 1) * b  # points to be found in a graph or near a wall
    return Estimate(
        *(n, b, s, memory),
        preparing=COMPILING + located * POINT[d] + parts * fit,
        deforming=COMPILING + steps * (n * s * PAIR + parts * solve),
        judging=COMPILING + 2 * CELL * sum(len(ids) for ids in mesh.cells.values()),
    )


def _sources(method: AbstractMethod, points: np.ndarray, moving: np.ndarray, fixed: np.ndarray) -> int:
    """Counts the sources that the reductions choose, without symmetry planes; a `FittedRBF` adds some of its own."""
    coarse = method.coarse if isinstance(method, SurfaceReconstruction) else method
    rbf = coarse.rbf if isinstance(coarse, FittedRBF) else coarse
    if not isinstance(rbf, RBF):
        return 0
    fixed = np.setdiff1d(fixed, moving)
    on_wall = rbf.reduction.beside(points[moving], points[fixed])
    return len(on_wall) + (len(rbf.fixed_reduction.beside(points[fixed], points[moving][on_wall])) if len(fixed) else 0)


def _iterative(method: AbstractMethod, count: int) -> Iterative | None:
    """Returns the solver of the method's system by iterations, None where there is none."""
    rbf = method.coarse if isinstance(method, SurfaceReconstruction) else method
    return rbf.iterative(count) if isinstance(rbf, RBF) else None


def _physical_memory() -> float:
    try:
        return float(os.sysconf("SC_PAGE_SIZE")) * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return float("inf")
