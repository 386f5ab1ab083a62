"""A multigrid cycle for large sparse positive matrices: pyamg's levels, swept by SciPy's products.

pyamg's Gauss-Seidel sweeps need as many steps, and two to three times as long: see
`benchmarks/README.md`. Its polynomials take their bounds from random vectors, so that no two runs
would agree.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from .solves import Factors

SPREAD = 10
"""Ratio of the largest to the smallest eigenvalue that the smoother reduces."""

STRONG = 0.3
"""Least entry, relative to the most negative entry of its row, by which unknowns are joined.

In a thin layer of hexahedra, a node's neighbour across the layer has the entry -16/36, the nodes
beside that neighbour -4/36, and the nodes beside the node itself a positive entry. So only lines
across the layer are joined.
"""

COARSEST = 90
"""Most unknowns of the last level, solved by a dense inverse: few enough for unthreaded BLAS."""


@dataclasses.dataclass(frozen=True)
class Level:
    """A matrix (k, k) of the cycle, and the way to the next matrix.

    - `prolongation` (k, coarse), `restriction` (coarse, k): the interpolation from the next level,
      and its transpose.
    - `inverse` (k,): one over the diagonal.
    - `top`: a bound of the eigenvalues of the matrix over its diagonal, by Gershgorin's circles.
    """

    matrix: Any
    prolongation: Any
    restriction: Any
    inverse: np.ndarray
    top: float

    def smoothed(self, right: np.ndarray) -> np.ndarray:
        """Solves roughly for (k,), by Chebyshev's second polynomial for upper eigenvalues."""
        middle, half = (1 + 1 / SPREAD) * self.top / 2, (1 - 1 / SPREAD) * self.top / 2
        first = self.inverse * right / middle
        rate = 1 / (2 * middle / half - half / middle)
        rest = self.inverse * (right - self.matrix @ first)
        return (1 + rate * half / middle) * first + 2 * rate / half * rest


@dataclasses.dataclass(frozen=True)
class Hierarchy:
    """A V-cycle of smoothed aggregation (Vanek, Mandel and Brezina 1996), and its `last` solver."""

    levels: Sequence[Level]
    last: Callable[[np.ndarray], np.ndarray]

    def __call__(self, right: np.ndarray, depth: int = 0) -> np.ndarray:
        """Solves roughly for one right side (k,)."""
        if depth == len(self.levels):
            return self.last(right)
        level = self.levels[depth]
        x = level.smoothed(right)
        x += level.prolongation @ self(level.restriction @ (right - level.matrix @ x), depth + 1)
        return x + level.smoothed(right - level.matrix @ x)


def hierarchy(matrix: Any, mode: np.ndarray) -> Hierarchy:
    """Makes the cycle of a positive CSR matrix (k, k), which takes `mode` (k,) nearly to zero."""
    import pyamg  # pyright: ignore[reportMissingImports]

    # Local weights are bounds; other weights come from random vectors.
    options: dict[str, Any] = {"strength": ("classical", {"theta": STRONG, "norm": "min"}), "max_coarse": COARSEST}
    options["smooth"] = ("jacobi", {"omega": 4 / 3, "weighting": "local", "filter_entries": True})
    options |= dict.fromkeys(("improve_candidates", "presmoother", "postsmoother"))
    levels = pyamg.smoothed_aggregation_solver(matrix, B=mode[:, None], **options).levels
    while len(levels) > 1 and levels[-1].A.shape[0] < 2:  # no unknowns were joined: an empty level
        levels.pop()
    *fine, last = levels
    return Hierarchy([_level(level) for level in fine], _last(last.A))


def _last(matrix: Any) -> Callable[[np.ndarray], np.ndarray]:
    """Makes the last level's solver: a dense inverse, or sparse factors if it is large."""
    if matrix.shape[0] <= COARSEST:
        return np.linalg.pinv(matrix.toarray(), hermitian=True).__matmul__
    return Factors(matrix)


def _level(level: Any) -> Level:
    matrix, prolongation = level.A.tocsr(), level.P.tocsr()
    inverse = 1 / matrix.diagonal()
    top = float((inverse * np.ravel(abs(matrix).sum(axis=1))).max())
    return Level(matrix, prolongation, prolongation.T.tocsr(), inverse, top)


def by_component(cycles: Sequence[Hierarchy]) -> Callable[[np.ndarray], np.ndarray]:
    """Joins the cycles of all components; unknowns (k d,) run over nodes, then components."""

    def cycle(right):
        columns = np.ascontiguousarray(right.reshape(-1, len(cycles)).T)
        return np.stack([one(column) for one, column in zip(cycles, columns, strict=True)], axis=1).ravel()

    return cycle
