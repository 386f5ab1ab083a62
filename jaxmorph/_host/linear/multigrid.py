"""Conjugate gradients with multigrid for large sparse positive matrices.

Sums of products are NumPy's own here. The threads of a BLAS would wait for each next one in a loop, at the cost of a
second core.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.sparse import linalg

ACCURACY = 1e-9
"""Residual, relative to the right side, and error, relative to the solution, at which conjugate gradients stop."""

LIMIT = 500
"""Most steps. A mesh of 65,000 nodes takes 50."""

SPREAD = 10
"""Largest eigenvalue over the smallest one that the smoother is made for."""

STRONG = 0.3
"""Least entry, relative to the most negative one of its row, by which unknowns are joined.

In a thin layer of hexahedra a node's neighbour across it has -16/36, the nodes beside that one -4/36, and those beside
the node itself a positive entry. Only lines across the layer are joined.
"""

COARSEST = 90
"""Unknowns of the last level that are solved by a dense inverse: few enough for a BLAS to take no threads."""


@dataclasses.dataclass(frozen=True)
class Level:
    """A matrix (k, k), the interpolation (k, coarse) from the next one, its transpose, and the inverse of the diagonal (k,).

    `top` bounds the eigenvalues of the matrix over its diagonal, by Gershgorin's circles.
    """

    matrix: Any
    prolongation: Any
    restriction: Any
    inverse: np.ndarray
    top: float

    def smoothed(self, right: np.ndarray) -> np.ndarray:
        """Solves roughly for right sides (k,): the second of Chebyshev's polynomials for the upper eigenvalues."""
        middle, half = (1 + 1 / SPREAD) * self.top / 2, (1 - 1 / SPREAD) * self.top / 2
        first = self.inverse * right / middle
        rate = 1 / (2 * middle / half - half / middle)
        rest = self.inverse * (right - self.matrix @ first)
        return (1 + rate * half / middle) * first + 2 * rate / half * rest


@dataclasses.dataclass(frozen=True)
class Hierarchy:
    """A V-cycle of smoothed aggregation (Vanek, Mandel and Brezina 1996): levels, and the solver of the last matrix."""

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
    """Makes the cycle for a positive matrix (k, k) in CSR form; `mode` (k,) is what it nearly takes to zero."""
    import pyamg  # pyright: ignore[reportMissingImports]

    # local weights are a bound, too: others come from random vectors
    options: dict[str, Any] = {"strength": ("classical", {"theta": STRONG, "norm": "min"}), "max_coarse": COARSEST}
    options["smooth"] = ("jacobi", {"omega": 4 / 3, "weighting": "local", "filter_entries": True})
    options |= dict.fromkeys(("improve_candidates", "presmoother", "postsmoother"))
    levels = pyamg.smoothed_aggregation_solver(matrix, B=mode[:, None], **options).levels
    while len(levels) > 1 and levels[-1].A.shape[0] < 2:  # no unknowns were joined: an empty level
        levels.pop()
    *fine, last = levels
    return Hierarchy([_level(each) for each in fine], _last(last.A))


def _last(matrix: Any) -> Callable[[np.ndarray], np.ndarray]:
    """Makes the solver of the last level: by sparse factors where unknowns that nothing joins have left it large."""
    if matrix.shape[0] <= COARSEST:
        return np.linalg.pinv(matrix.toarray(), hermitian=True).__matmul__
    try:
        return linalg.splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A").solve
    except RuntimeError:  # singular
        return lambda right: np.full_like(right, np.nan)


def _level(given: Any) -> Level:
    matrix, prolongation = given.A.tocsr(), given.P.tocsr()
    inverse = 1 / matrix.diagonal()
    top = float((inverse * np.ravel(abs(matrix).sum(axis=1))).max())
    return Level(matrix, prolongation, prolongation.T.tocsr(), inverse, top)


def by_component(cycles: Sequence[Hierarchy]) -> Callable[[np.ndarray], np.ndarray]:
    """Joins a cycle for each component of the nodes, whose unknowns (k d,) stand together."""

    def cycle(right):
        columns = np.ascontiguousarray(right.reshape(-1, len(cycles)).T)
        return np.stack([one(column) for one, column in zip(cycles, columns, strict=True)], axis=1).ravel()

    return cycle


def conjugate_gradients(
    matrix: Any,
    right: np.ndarray,
    cycle: Callable[[np.ndarray], np.ndarray] | None,
    scale: np.ndarray,
) -> np.ndarray:
    """Solves for one right side (k,); NaN where that does not converge, or the matrix is not positive.

    `scale` (k,) times the unknowns are those that are wanted. What the cycle makes of the residual is as large as their
    error. The residual alone is not enough: one small beside that of stiff cells moves soft ones far. Without a cycle it has to do.
    """
    x, residual, along, before = np.zeros_like(right), right.copy(), np.zeros_like(right), 1.0
    enough = ACCURACY**2 * _dot(right, right)
    for _ in range(LIMIT if cycle else 2 * LIMIT):
        steep = cycle(residual) if cycle else residual
        is_small = _dot(residual, residual) <= enough
        if is_small and (cycle is None or _largest(scale * steep) <= ACCURACY * _largest(scale * x)):
            return x
        share = _dot(residual, steep)
        along = steep + share / before * along
        image = matrix @ along
        curvature = _dot(along, image)
        if not curvature > 0:
            break
        x += share / curvature * along
        residual -= share / curvature * image
        before = share
    return np.full_like(right, np.nan)


def _largest(x: np.ndarray) -> float:
    return max(float(x.max(initial=0)), -float(x.min(initial=0)))


def _dot(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.einsum("i,i->", a, b))
