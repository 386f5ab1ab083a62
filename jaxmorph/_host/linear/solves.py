"""Solvers of a sparse symmetric system: factors, conjugate gradients, and a multigrid cycle.

SciPy's conjugate gradients stop at the residual alone, and sum by a BLAS whose threads cost a
second core. The cycle has pyamg's levels, swept by SciPy's products: pyamg's Gauss-Seidel sweeps
take two to three times as long, and its polynomials take bounds from random vectors.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy import ndarray
from scipy.sparse import linalg

Operator = Callable[[ndarray], ndarray]

# unknowns up to which a 3-D system is factored; 2-D systems always are: factors stay sparse
DIRECT = 12_000


def is_factored(unknowns: int, dimension: int) -> bool:
    return dimension == 2 or unknowns <= DIRECT


class Factors:
    """Factors of a sparse symmetric matrix; minimum degree orders them unless `is_ordered`."""

    def __init__(self, matrix: Any, *, is_ordered: bool = False):
        order = "NATURAL" if is_ordered else "MMD_AT_PLUS_A"
        try:
            self._factors = linalg.splu(
                matrix.tocsc(), order, diag_pivot_thresh=0.0, options={"SymmetricMode": True}
            )
        except RuntimeError:  # singular
            self._factors = None

    def __call__(self, right: ndarray) -> ndarray:
        """Solves for right sides (k,) or (k, c); NaN if the matrix is singular."""
        return (
            np.full_like(right, np.nan)
            if self._factors is None
            else self._factors.solve(np.asarray(right, float))
        )

    @property
    def is_positive(self) -> bool:
        """True for a positive matrix: pivots and eigenvalues have equal signs."""
        return self._factors is not None and bool((self._factors.U.diagonal() > 0).all())

    @property
    def order(self) -> ndarray:
        return np.argsort(self._factors.perm_c) if self._factors is not None else np.arange(0)


def conjugate_gradients(
    matrix: Any, right: ndarray, inverse: Callable, is_enough: Callable, limit: int
) -> tuple[ndarray, bool]:
    """Solves for a right side (k,), up to negative curvature (Nocedal and Wright, algorithm 7.1).
    `inverse` is the preconditioner. `is_enough` decides from the solution, the residual and the
    residual's image under `inverse`. Returns x (k,), and whether it `is_enough` within `limit`
    steps. If the first direction has negative curvature, x is the direction.
    """
    x = np.zeros_like(right)
    residual = right.copy()
    along = np.zeros_like(right)
    before = 1.0
    for _ in range(limit):
        steep = inverse(residual)
        if is_enough(x, residual, steep):
            return x, True
        share = inner_product(residual, steep)
        along = steep + share / before * along
        image = matrix @ along
        curvature = inner_product(along, image)
        if not curvature > 0:
            return (x if x.any() else steep), False
        x += share / curvature * along
        residual -= share / curvature * image
        before = share
    return x, False


def inner_product(a: ndarray, b: ndarray) -> float:
    return float(np.einsum("i,i->", a, b))


SPREAD = 10  # ratio of the largest to the smallest eigenvalue that the smoother reduces

STRONG = 0.3
"""Least entry, relative to the most negative of its row, that joins unknowns. In a thin layer of
hexahedra the neighbour across has -16/36, nodes beside it -4/36, others a positive entry: only
lines across the layer are joined.
"""

# most unknowns of the last level, solved by a dense inverse: few enough for unthreaded BLAS
COARSEST = 90


@dataclasses.dataclass(frozen=True)
class Level:
    """A matrix (k, k) of the cycle, and the way to the next matrix."""

    matrix: Any
    prolongation: Any  # (k, coarse) from the next level
    restriction: Any  # its transpose
    inverse: ndarray  # (k,) one over the diagonal
    top: (
        float  # a bound of the eigenvalues of the matrix over its diagonal, by Gershgorin's circles
    )

    def smoothed(self, right: ndarray) -> ndarray:
        """Solves roughly for (k,), by Chebyshev's second polynomial for upper eigenvalues."""
        middle = (1 + 1 / SPREAD) * self.top / 2
        half = (1 - 1 / SPREAD) * self.top / 2
        first = self.inverse * right / middle
        rate = 1 / (2 * middle / half - half / middle)
        rest = self.inverse * (right - self.matrix @ first)
        return (1 + rate * half / middle) * first + 2 * rate / half * rest


@dataclasses.dataclass(frozen=True)
class Multigrid:
    """A V-cycle of smoothed aggregation (Vanek, Mandel and Brezina 1996), and its `last` solver."""

    levels: Sequence[Level]
    last: Operator

    def __call__(self, right: ndarray, depth: int = 0) -> ndarray:
        if depth == len(self.levels):
            return self.last(right)
        level = self.levels[depth]
        x = level.smoothed(right)
        x += level.prolongation @ self(level.restriction @ (right - level.matrix @ x), depth + 1)
        return x + level.smoothed(right - level.matrix @ x)


def hierarchy(matrix: Any, mode: ndarray) -> Multigrid:
    """Makes the cycle of a positive CSR matrix (k, k), which takes `mode` (k,) nearly to zero."""
    import pyamg  # pyright: ignore[reportMissingImports]

    # Local weights are bounds; other weights come from random vectors.
    options: dict[str, Any] = {
        "strength": ("classical", {"theta": STRONG, "norm": "min"}),
        "max_coarse": COARSEST,
    }
    options["smooth"] = ("jacobi", {"omega": 4 / 3, "weighting": "local", "filter_entries": True})
    options |= dict.fromkeys(("improve_candidates", "presmoother", "postsmoother"))
    levels = pyamg.smoothed_aggregation_solver(matrix, B=mode[:, None], **options).levels
    while len(levels) > 1 and levels[-1].A.shape[0] < 2:  # no unknowns were joined: an empty level
        levels.pop()
    *fine, last = [level.A.tocsr() for level in levels]
    made = []
    for matrix, prolongation in zip(fine, [level.P.tocsr() for level in levels[:-1]], strict=True):
        inverse = 1 / matrix.diagonal()
        top = float((inverse * np.ravel(abs(matrix).sum(axis=1))).max())
        made.append(Level(matrix, prolongation, prolongation.T.tocsr(), inverse, top))
    if last.shape[0] > COARSEST:
        return Multigrid(made, Factors(last))
    return Multigrid(made, np.linalg.pinv(last.toarray(), hermitian=True).__matmul__)
