"""Memory of moving and judging a mesh, foreseen before the work starts."""

import dataclasses
import os
from collections.abc import Sequence

import numpy as np
from jaxtyping import ArrayLike, Int

from .._boundary.names import node_ids
from .._host.cells.topology import FACES
from .._host.package.arguments import checked, whole
from .._mesh.mesh import Mesh
from .._methods.base import AbstractMethod
from .._methods.rbf.fitted import FittedRBF
from .._methods.rbf.rbf import RBF, Iterative
from .._methods.reconstruction import SurfaceReconstruction

START = 0.3e9
"""Bytes of the process before it has read anything."""

FACE = 200
"""Bytes for each face of each cell while cells are judged: neighbours are found by sorting them."""


@dataclasses.dataclass(frozen=True)
class Estimate:
    """Memory of moving and judging a mesh, to the order of magnitude.

    - `points`, `surface`, `sources`: numbers of points, of nodes of the surface, and of sources.
    - `memory`: in bytes, at the most.

    `str` gives all numbers in a line.
    """

    points: int
    surface: int
    sources: int
    memory: float

    @property
    def is_too_large(self) -> bool:
        """True where this machine has less memory."""
        return self.memory > _physical_memory()

    def __str__(self) -> str:
        return (
            f"estimate {self.points} points, {self.surface} surface nodes, {self.sources} sources: about "
            f"{self.memory / 1e9:.2g} GB"
        )


@checked
def estimate(
    mesh: Mesh,
    moving: Int[ArrayLike, " m"] | Sequence[int],
    fixed: Int[ArrayLike, " f"] | Sequence[int] = (),
    *,
    method: AbstractMethod | None = None,
    chunk: int | None = None,
) -> Estimate:
    """Estimates the memory that moving and judging a mesh will take.

    **Arguments:**

    - `mesh`: the precision of its points is that of the calculation.
    - `moving`, `fixed`, `method`: as `prepare` takes them.
    - `chunk`: the `size` of `prepare_in_chunks`; None for the mesh as a whole.

    **Returns:** an `Estimate`.

    **Raises:** `ValueError` for ids that are no nodes, and for chunks of less than one node.
    """
    n = len(mesh.points)
    moving, fixed = node_ids(moving, "moving", n), node_ids(fixed, "fixed", n)
    if chunk is not None:
        whole("chunk", chunk)
    b = len(np.union1d(moving, fixed))
    method = SurfaceReconstruction() if method is None else method
    s = _sources(method, np.asarray(mesh.points), moving, fixed)
    planned = n if chunk is None else min(n, b + chunk)
    size = np.dtype(mesh.points.dtype).itemsize / 8
    quality = FACE * sum(len(ids) * len(FACES[kind]) for kind, ids in mesh.cells.items())
    solver = _iterative(method, s)
    system = 24 * s**2 if solver is None else 5000 * s + 24 * solver.dense_count(s) ** 2
    return Estimate(n, b, s, START + size * (500 * (n + planned) + system) + quality)


def _sources(method: AbstractMethod, points: np.ndarray, moving: np.ndarray, fixed: np.ndarray) -> int:
    """Counts the sources that the reductions choose, without symmetry planes.

    A `FittedRBF` adds some sources of its own.
    """
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
