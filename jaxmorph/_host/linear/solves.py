"""The two solvers of a sparse symmetric system: by factors, and by conjugate gradients.

SciPy's conjugate gradients stop at the residual alone. Their sums of products are computed by a
BLAS. Its threads wait in a loop for the next sum, at the cost of a second core. Here NumPy computes
the sums. `benchmarks/README.md` compares these solvers with SciPy's conjugate gradients and pyamg's
cycle.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.sparse import linalg

DIRECT = 12_000
"""Unknowns up to which a 3-D system is factored; 2-D systems always are: factors stay sparse."""


def is_factored(unknowns: int, dimension: int) -> bool:
    """Decides whether a system of a mesh is small enough to be factored."""
    return dimension == 2 or unknowns <= DIRECT


class Factors:
    """Factors of a sparse symmetric matrix, by pivots on the diagonal.

    Pivots are taken in an order of minimum degree, or, with `is_ordered`, in the order of the
    matrix.
    """

    def __init__(self, matrix: Any, *, is_ordered: bool = False):
        try:
            self._factors = linalg.splu(
                matrix.tocsc(),
                permc_spec="NATURAL" if is_ordered else "MMD_AT_PLUS_A",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )
        except RuntimeError:  # singular
            self._factors = None

    def __call__(self, right: np.ndarray) -> np.ndarray:
        """Solves for right sides (k,) or (k, c); NaN if the matrix is singular."""
        return np.full_like(right, np.nan) if self._factors is None else self._factors.solve(np.asarray(right, float))

    @property
    def is_positive(self) -> bool:
        """True for a positive matrix: pivots and eigenvalues have equal signs."""
        return self._factors is not None and bool((self._factors.U.diagonal() > 0).all())

    @property
    def order(self) -> np.ndarray:
        """The order (k,) of the pivots."""
        return np.argsort(self._factors.perm_c) if self._factors is not None else np.arange(0)


def conjugate_gradients(
    matrix: Any, right: np.ndarray, inverse: Callable, is_enough: Callable, limit: int
) -> tuple[np.ndarray, bool]:
    """Solves for a right side (k,), up to negative curvature (Nocedal and Wright, algorithm 7.1).

    **Arguments:**

    - `matrix`: has products `matrix @ x`.
    - `right`: the right side (k,).
    - `inverse`: the preconditioner, a symmetric positive map of (k,) to (k,).
    - `is_enough`: decides from the solution, the residual and the residual's image under `inverse`.
    - `limit`: most steps.

    **Returns:** x (k,), and True if it `is_enough`. If the first direction has negative curvature,
    x is the direction.
    """
    x, residual, along, before = np.zeros_like(right), right.copy(), np.zeros_like(right), 1.0
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


def inner_product(a: np.ndarray, b: np.ndarray) -> float:
    """Sums products without a BLAS."""
    return float(np.einsum("i,i->", a, b))
