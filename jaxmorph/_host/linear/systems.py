"""Sparse symmetric positive systems: a number, or a small block, for every pair of nodes."""

import functools
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse import linalg

from ..cells.adjacency import parts_of
from ..package.rounding import distinct
from .solves import Factors, by_component, conjugate_gradients, hierarchy, inner_product, is_factored

ACCURACY = 1e-9  # residual relative to the right side, and error relative to the solution, that end CG
LIMIT = 500  # most steps of conjugate gradients. A mesh of 65,000 nodes takes 50.
RESORT = 60_000  # unknowns up to which a 3-D system is factored if CG does not converge, as on thin layers
LATEST = 2  # number of the latest systems whose factors are cached


def solve(pairs, values, diagonal, masses, free, right, *, multigrid: bool = True) -> np.ndarray:
    """Solves A x = right for the free unknowns; x is zero for all other unknowns.

    - `pairs` (e, 2): nodes i and j of each pair, no pair twice.
    - `values` (e,) or (e, d, d): entries in row i and column j; those in row j and column i are
      their transposes.
    - `diagonal` (n,) or (n, d, d): entries of a node with itself.
    - `masses` (n,) or (0,): with masses M, the matrix is K M^-1 K of the matrix K above.
    - `free` (n, d): unknowns to solve for.
    - `right` (n, k): k = d columns.
    - `multigrid`: whether conjugate gradients use it, for equations on cells.

    Returns x (n, d), in the precision of `right`; NaN if a system is not finite, not positive, or
    not solved.
    """
    system = tuple((array.shape, array.dtype.str, array.tobytes()) for array in (pairs, values, diagonal, masses, free))
    return inverse_of(system, multigrid)(right.astype(float)).astype(right.dtype)


@functools.lru_cache(LATEST)
def inverse_of(system: tuple[tuple[tuple[int, ...], str, bytes], ...], multigrid: bool) -> Callable:
    """The solver of a system, whose arrays are given by their bytes."""
    pairs, values, diagonal, masses, free = (np.ndarray(shape, dtype, data) for shape, dtype, data in system)
    if not all(np.isfinite(array).all() for array in (values, diagonal, masses)):
        return lambda right: np.full_like(right, np.nan)
    values, diagonal, masses = (array.astype(float, copy=False) for array in (values, diagonal, masses))
    return _inverse(pairs, values, diagonal, masses, free, multigrid)


def check_solver(unknowns: int, dimension: int) -> None:
    if not is_factored(unknowns, dimension) and find_spec("pyamg") is None:
        raise ImportError(
            f"{unknowns} unknowns in 3-D are solved by multigrid, which needs pyamg: pip install 'jaxmorph[solvers]'."
        )


def _inverse(pairs, values, diagonal, masses, free, multigrid: bool) -> Callable[[np.ndarray], np.ndarray]:
    n, d = free.shape
    if values.ndim == 3:
        rows, used = np.flatnonzero(free.any(axis=1)), free[free.any(axis=1)]
        one = _of_matrix(_blocks(pairs, values, diagonal, rows, used), d, multigrid)

        def apply_blocks(right):
            x = np.zeros((n, d))
            x[rows] = one((right[rows] * used).ravel()).reshape(-1, d)
            return x

        return apply_blocks
    matrix = _scalar(pairs, values, diagonal, n)
    kinds, column_kind = np.unique(free, axis=1, return_inverse=True)
    column_kind = np.ravel(column_kind)
    rows = [np.flatnonzero(kind) for kind in kinds.T]
    if masses.size:
        root = sparse.diags(masses**-0.5) @ matrix
        solvers = [_of_square(root[:, row]) for row in rows]
    else:
        solvers = [_of_matrix(matrix[row][:, row], d, multigrid) for row in rows]

    def apply(right):
        x = np.zeros((n, d))
        for kind, (row, one) in enumerate(zip(rows, solvers, strict=True)):
            columns = np.flatnonzero(column_kind == kind)
            x[np.ix_(row, columns)] = one(right[np.ix_(row, columns)])
        return x

    return apply


def _scalar(pairs, values, diagonal, n) -> sparse.csr_matrix:
    i, j = pairs.T
    node = np.arange(n)
    rows, columns = np.concatenate([i, j, node]), np.concatenate([j, i, node])
    return sparse.csr_matrix((np.concatenate([values, values, diagonal]), (rows, columns)), shape=(n, n))


def _blocks(pairs, values, diagonal, rows, used) -> sparse.bsr_matrix:
    """The matrix of the nodes `rows` by blocks; the diagonal of others is one."""
    # The blocks of pairs, of their transposes and of the diagonal are listed in turn, and sorted by
    # row and column. Rows and columns of unused unknowns are cleared.
    d = used.shape[1]
    number = np.full(len(diagonal), -1)
    number[rows] = np.arange(len(rows))
    both = (number[pairs] >= 0).all(axis=1)
    i, j = number[pairs[both]].T
    node = np.arange(len(rows))
    owner, columns = np.concatenate([i, j, node]), np.concatenate([j, i, node])
    order = np.lexsort((columns, owner))
    owner, columns = owner[order], columns[order]
    data = np.concatenate([values[both], values[both].transpose(0, 2, 1), diagonal[rows]])[order]
    data *= used[owner][:, :, None] & used[columns][:, None]
    data[owner == columns] += ~used[:, :, None] * np.eye(d)
    starts = np.searchsorted(owner, np.arange(len(rows) + 1))
    return sparse.bsr_matrix((data, columns, starts), shape=(len(rows) * d,) * 2)


def _of_matrix(matrix: Any, d: int, multigrid: bool) -> Callable[[np.ndarray], np.ndarray]:
    if matrix.shape[0] == 0:
        return lambda right: right
    if not (matrix.diagonal() > 0).all():
        return lambda right: np.full_like(right, np.nan)
    scale = 1 / np.sqrt(matrix.diagonal())
    scaled = _scaled(matrix, scale)
    if is_factored(matrix.shape[0], d):
        return _factored(scaled, scale)
    return _iterative(scaled, scale, _cycle(scaled, scale) if multigrid else None)


def _iterative(scaled: Any, scale: np.ndarray, cycle: Callable | None) -> Callable[[np.ndarray], np.ndarray]:
    factors: list[Callable[[np.ndarray], np.ndarray]] = []

    def apply(right):
        if not np.isfinite(right).all():
            return np.full_like(right, np.nan)
        if not factors:
            columns = right.reshape(len(scale), -1).T
            parts = [iterated(scaled, column * scale, cycle, scale) * scale for column in columns]
            x = np.stack(parts, axis=1).reshape(right.shape)
            if np.isfinite(x).all() or len(scale) > RESORT or cycle is None:
                return x
            factors.append(_factored(scaled, scale))
        return factors[0](right)

    return apply


def _factored(scaled: Any, scale: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    factors = Factors(scaled)
    return lambda right: (factors((right.T * scale).T).T * scale).T


def iterated(
    matrix: Any, right: np.ndarray, cycle: Callable[[np.ndarray], np.ndarray] | None, scale: np.ndarray
) -> np.ndarray:
    """Solves for a right side (k,); NaN if CG does not converge, or the matrix is not positive. The
    wanted unknowns are `scale` (k,) times x. The cycle's image of the residual is as large as the
    error: a residual that is small beside stiff cells moves soft cells far.
    """
    enough = ACCURACY**2 * inner_product(right, right)

    def is_enough(x, residual, steep):
        is_small = inner_product(residual, residual) <= enough
        return is_small and (cycle is None or _largest(scale * steep) <= ACCURACY * _largest(scale * x))

    # Without a cycle, twice as many steps are allowed.
    inverse, limit = (cycle, LIMIT) if cycle else (lambda residual: residual, 2 * LIMIT)
    x, is_solved = conjugate_gradients(matrix, right, inverse, is_enough, limit)
    return x if is_solved else np.full_like(right, np.nan)


def _largest(x: np.ndarray) -> float:
    return max(float(x.max(initial=0)), -float(x.min(initial=0)))


def _cycle(scaled: Any, scale: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """A matrix's multigrid cycle; for blocks, one a component, by Korn's inequality."""
    if scaled.format != "bsr":
        return hierarchy(scaled, 1 / scale)
    d, cycles = scaled.blocksize[0], []
    for k in range(d):
        part = sparse.csr_matrix((scaled.data[:, k, k], scaled.indices, scaled.indptr), copy=True)
        part.eliminate_zeros()
        cycles.append(hierarchy(part, 1 / scale[k::d]))
    return by_component(cycles)


def _of_square(root: Any) -> Callable[[np.ndarray], np.ndarray]:
    """The solver of B^T B x = right for a sparse B (n, k), without squaring its condition."""
    n = root.shape[0]
    scale = 1 / np.sqrt(np.ravel(root.power(2).sum(axis=0)))
    scaled = root @ sparse.diags(scale)
    both = sparse.bmat([[-sparse.identity(n), scaled], [scaled.T, None]], format="csc")
    try:
        factors = linalg.splu(both, permc_spec="COLAMD")
    except RuntimeError:  # singular
        return lambda right: np.full_like(right, np.nan)

    def apply(right):
        both_rights = np.concatenate([np.zeros((n, *right.shape[1:])), (right.T * scale).T])
        x = factors.solve(both_rights)
        x = x + factors.solve(both_rights - both @ x)  # a step of refinement
        return (x[n:].T * scale).T

    return apply


def _scaled(matrix: Any, scale: np.ndarray) -> Any:
    """Multiplies rows and columns of a matrix by `scale`; blocks stay blocks, changed in place."""
    if matrix.format != "bsr":
        return (sparse.diags(scale) @ matrix @ sparse.diags(scale)).tocsr()
    scale = scale.reshape(-1, matrix.blocksize[0])
    owner = np.repeat(np.arange(len(scale)), np.diff(matrix.indptr))
    matrix.data *= scale[owner][:, :, None]
    matrix.data *= scale[matrix.indices][:, None]
    return matrix


def reached(pairs: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Marks the nodes (n,) that pairs (e, 2) connect to a node that is `known` (n,)."""
    part = parts_of(pairs[:, 0], pairs[:, 1], len(known))
    return np.bincount(part, known)[part] > 0


def coincident(points: np.ndarray, first: np.ndarray) -> np.ndarray:
    """The point that represents each point's place (n,); one of `first` if there is any."""
    order = np.concatenate([first, np.setdiff1d(np.arange(len(points)), first)])
    index, inverse = distinct(points[order])
    stands = np.empty(len(points), dtype=np.int64)
    stands[order] = order[index[inverse]]
    stands[first] = first
    return stands
