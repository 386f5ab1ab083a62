"""Sparse symmetric systems with one small block for each pair of nodes that share a cell."""

from typing import Any, NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse import linalg

DIRECT = 3000
"""Nodes up to which a system in space is factored; in the plane every one is, since its factors hardly fill."""


class Pattern(NamedTuple):
    """Which blocks there are, in compressed rows, and to which of them each pair of a cell's corners adds."""

    starts: np.ndarray
    columns: np.ndarray
    block: np.ndarray


def pattern(cells: list[np.ndarray], n: int) -> Pattern:
    """From the corner ids (k, c) of each type; pairs run over cells, then corners, then corners again."""
    rows = [np.repeat(ids, ids.shape[1], axis=1).ravel() for ids in cells]
    columns = [np.tile(ids, (1, ids.shape[1])).ravel() for ids in cells]
    keys = np.concatenate(rows).astype(np.int64) * n + np.concatenate(columns)
    found, block = np.unique(keys, return_inverse=True)
    starts = np.searchsorted(found // n, np.arange(n + 1))
    return Pattern(starts.astype(np.int32), (found % n).astype(np.int32), block.astype(np.int32))


def solve(starts, columns, block, blocks, shift, right) -> np.ndarray:
    """(H + diag(shift)) x = right, for `right` (n, d); H is the sum of `blocks` (pairs, d, d), which is not negative.

    Factored where that is cheap, else by conjugate gradients with the diagonal blocks as preconditioner, to 1 % of the right
    side. Zeros where the system has no finite solution.
    """
    starts, columns, block, blocks, shift, right = map(np.asarray, (starts, columns, block, blocks, shift, right))
    n, d = right.shape
    parts = [np.bincount(block, blocks[:, a, b], len(columns)) for a in range(d) for b in range(d)]
    data = np.stack(parts, axis=1).reshape(-1, d, d)
    matrix = sparse.bsr_matrix((data, columns, starts), shape=(n * d, n * d)) + sparse.diags(np.repeat(shift, d))
    if not np.isfinite(data).all():
        return np.zeros_like(right)
    found = _factored(matrix, right) if d == 2 or n <= DIRECT else _iterated(matrix.tobsr((d, d)), right)
    return found.reshape(n, d).astype(right.dtype)


def _factored(matrix: Any, right: np.ndarray) -> np.ndarray:
    options = {"SymmetricMode": True}
    factors = linalg.splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    return factors.solve(right.ravel().astype(float))


def _iterated(matrix: Any, right: np.ndarray) -> np.ndarray:
    n, d = right.shape
    rows = np.repeat(np.arange(n), np.diff(matrix.indptr))
    diagonal = matrix.indices == rows
    inverse = np.zeros((n, d, d))
    inverse[rows[diagonal]] = np.linalg.inv(matrix.data[diagonal])

    preconditioner = linalg.aslinearoperator(_Preconditioner(matrix.shape, inverse))
    return linalg.cg(matrix.tocsr(), right.ravel(), rtol=1e-2, maxiter=500, M=preconditioner)[0]


class _Preconditioner:
    """The inverses of the diagonal blocks, as what SciPy takes for a linear operator."""

    def __init__(self, shape: tuple[int, int], inverse: np.ndarray):
        self.shape, self.inverse, self.dtype = shape, inverse, inverse.dtype

    def matvec(self, x: np.ndarray) -> np.ndarray:
        n, d, _ = self.inverse.shape
        return np.einsum("nab,nb->na", self.inverse, x.reshape(n, d)).ravel()
