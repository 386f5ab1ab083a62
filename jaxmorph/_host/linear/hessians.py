"""Sparse symmetric systems with a small block for every pair of nodes that share a cell."""

import functools
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray
from scipy import sparse

from ..tolerances import LEAST_CURVATURE, ROUGH, SOLVED, SOLVED_EXACTLY
from .solves import Factors, conjugate_gradients, inner_product, is_factored

# damping terms of the diagonal, tried in turn until a matrix is positive
DAMPING = (1e-2, 1e-1, 1.0, 10.0)


class Pattern(NamedTuple):
    """The blocks of a matrix in compressed rows."""

    starts: ndarray  # where rows begin
    columns: ndarray  # column of every block
    block: ndarray  # the block to which a pair of a cell's corners adds
    order: ndarray  # row i belongs to node `order[i]`


def pattern(cells: list[ndarray], n: int, dimension: int) -> Pattern:
    """Makes the pattern of cells, given by corner ids (k, c), type by type. Pairs of a type run
    over first corners, then over second corners, then, fastest, over cells.
    """
    starts, columns, block = _compressed_rows(cells, n)
    order = np.arange(n)
    # ordering nodes takes half the time of ordering components
    if is_factored(n * dimension, dimension):
        graph = sparse.csr_matrix((np.ones(len(columns)), columns, starts), shape=(n, n))
        order = Factors(graph + sparse.diags(np.diff(starts) + 1.0)).order
        rank = np.argsort(order)
        starts, columns, block = _compressed_rows([rank[ids] for ids in cells], n)
    return Pattern(*(part.astype(np.int32) for part in (starts, columns, block, order)))


def _compressed_rows(cells: list[ndarray], n: int) -> tuple[ndarray, ndarray, ndarray]:
    # Each pair of corners of a cell adds a block at (row, column). The key row * n + column is one
    # integer: unique keys are the matrix in CSR order, and their inverse the blocks' places.
    rows = [np.repeat(ids.T, ids.shape[1], axis=0).ravel() for ids in cells]
    columns = [np.tile(ids.T, (ids.shape[1], 1)).ravel() for ids in cells]
    keys = np.concatenate(rows).astype(np.int64) * n + np.concatenate(columns)
    unique, block = np.unique(keys, return_inverse=True)
    return np.searchsorted(unique // n, np.arange(n + 1)), unique % n, block


def _solve_blocks(
    accuracy: float | None, starts, columns, block, order, blocks, shift, right
) -> ndarray:
    # The entries (a, b) of all blocks that fall on one place of the matrix are summed, then lie as
    # (d, d) blocks in CSR order; rows of nodes stand in `order`, and the solution is put back.
    n, d = right.shape
    parts = [np.bincount(block, part, len(columns)) for part in blocks.reshape(d * d, -1)]
    data = np.stack(parts, axis=1).reshape(-1, d, d)
    if not right.any():
        return np.zeros_like(right)
    if not np.isfinite(data).all():
        return np.full_like(right, 0 if accuracy is None else np.nan)
    matrix = sparse.bsr_matrix((data, columns, starts), shape=(n * d, n * d)) + sparse.diags(
        np.repeat(shift[order], d)
    )
    wanted = right[order].astype(float).ravel()
    if is_factored(n * d, d):
        solved = _solve_by_factors(matrix, wanted, (0.0,) if accuracy else (0.0, *DAMPING))
    else:
        solved = _solve_by_iterations(matrix.tobsr((d, d)), wanted, accuracy or ROUGH)
    if accuracy and not np.linalg.norm(matrix @ solved - wanted) <= SOLVED * np.linalg.norm(wanted):
        solved = np.full_like(solved, np.nan)
    solution = np.empty_like(right)
    solution[order] = solved.reshape(n, d)
    return solution


solve = functools.partial(_solve_blocks, None)
"""Solves (H + diag(shift)) x = right (n, d) for a step that descends, with the sum H of `blocks`
(d, d, pairs), after the four fields of a `Pattern`. A small matrix is factored, and damped if it is
not positive. For a large one, conjugate gradients run to 1 % of the right side. The result is zero
if H is not finite.
"""

solve_exactly = functools.partial(_solve_blocks, SOLVED_EXACTLY)
"""Solves as `solve`, to round-off or `SOLVED_EXACTLY`; NaN if not positive, or not converged."""


def _solve_by_factors(matrix: Any, right: ndarray, damping: tuple[float, ...]) -> ndarray:
    """Solves by pivots on the diagonal, with the first `damping` term that makes it positive."""
    for added in damping:
        factors = Factors(matrix + added * sparse.identity(len(right)), is_ordered=True)
        if factors.is_positive:
            return factors(right)
    return np.full_like(right, np.nan) if len(damping) == 1 else right / damping[-1]


def _solve_by_iterations(matrix: Any, right: ndarray, accuracy: float) -> ndarray:
    """Solves by conjugate gradients, with the inverses of the blocks on the diagonal."""
    d = matrix.blocksize[0]
    rows = np.repeat(np.arange(len(right) // d), np.diff(matrix.indptr))
    values, vectors = np.linalg.eigh(matrix.data[matrix.indices == rows])
    inverses = np.einsum(
        "nip,np,njp->nij", vectors, 1 / np.maximum(np.abs(values), LEAST_CURVATURE), vectors
    )
    enough = accuracy**2 * inner_product(right, right)

    def inverse(residual):
        return np.einsum("nab,nb->na", inverses, residual.reshape(-1, d)).ravel()

    def is_enough(_, residual, __):
        return inner_product(residual, residual) <= enough

    return conjugate_gradients(
        matrix.tocsr(), right, inverse, is_enough, 500 if accuracy == ROUGH else 20_000
    )[0]
