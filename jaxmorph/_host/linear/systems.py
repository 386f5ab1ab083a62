"""Sparse symmetric positive systems: a number, or a small block, for every pair of nodes."""

import functools
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy import ndarray
from scipy import sparse
from scipy.sparse import linalg

from ..cells.adjacency import parts_of
from ..package.rounding import distinct_places
from ..tolerances import ACCURACY
from .solves import Factors, Operator, conjugate_gradients, hierarchy, inner_product, is_factored

MOST_STEPS = 500  # most steps of conjugate gradients. A mesh of 65,000 nodes takes 50.
# unknowns up to which a 3-D system is factored if CG does not converge, as on thin layers
RESORT = 60_000
LATEST = 2  # number of the latest systems whose factors are cached


def solve(pairs, values, diagonal, masses, free, right, *, multigrid: bool = True) -> ndarray:
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
    system = tuple(
        (array.shape, array.dtype.str, array.tobytes())
        for array in (pairs, values, diagonal, masses, free)
    )
    return inverse_of(system, multigrid)(right.astype(float)).astype(right.dtype)


@functools.lru_cache(LATEST)
def inverse_of(system: tuple[tuple[tuple[int, ...], str, bytes], ...], multigrid: bool) -> Callable:
    """The solver of a system, whose arrays are given by their bytes."""
    pairs, values, diagonal, masses, free = (
        ndarray(shape, dtype, data) for shape, dtype, data in system
    )
    if not all(np.isfinite(array).all() for array in (values, diagonal, masses)):
        return lambda right: np.full_like(right, np.nan)
    values, diagonal, masses = (
        array.astype(float, copy=False) for array in (values, diagonal, masses)
    )
    return _make_inverse(pairs, values, diagonal, masses, free, multigrid)


def check_solver(unknowns: int, dimension: int) -> None:
    if not is_factored(unknowns, dimension) and find_spec("pyamg") is None:
        raise ImportError(
            f"{unknowns} unknowns in 3-D are solved by multigrid, which needs pyamg: pip install "
            "'jaxmorph[solvers]'."
        )


def _make_inverse(pairs, values, diagonal, masses, free, multigrid: bool) -> Operator:
    # Of blocks there is one system; of numbers one for all columns with the same free unknowns.
    n, d = free.shape
    kinds = free.any(axis=1)[:, None]
    kind = np.zeros(d, dtype=int)
    if values.ndim == 1:
        kinds, kind = np.unique(free, axis=1, return_inverse=True)
    parts = []
    for number, is_free in enumerate(kinds.T):
        rows = np.flatnonzero(is_free)
        columns = np.flatnonzero(np.ravel(kind) == number)
        if masses.size:
            root = sparse.diags(masses**-0.5) @ _select_matrix(
                pairs, values, diagonal, np.arange(n)
            )
            parts.append((rows, columns, _solve_square(root[:, rows])))
        elif len(rows):
            used = free[rows].ravel() if values.ndim == 3 else np.ones(len(rows), dtype=bool)
            parts.append(
                (
                    rows,
                    columns,
                    _solve_matrix(
                        _select_matrix(pairs, values, diagonal, rows), used, d, multigrid
                    ),
                )
            )

    def apply(right):
        x = np.zeros((n, d))
        for rows, columns, solver in parts:
            x[np.ix_(rows, columns)] = solver(right[np.ix_(rows, columns)])
        return x

    return apply


def _select_matrix(pairs, values, diagonal, rows) -> Any:
    """The matrix of the nodes `rows`, ascending: numbers in CSR, or blocks in BSR."""
    # SciPy sorts and selects the numbers of the entries, from 1 on.
    i, j = pairs.T
    node = np.arange(len(diagonal))
    turned = values.transpose(0, *range(values.ndim - 1, 0, -1))
    entries = np.concatenate([values, turned, diagonal])
    places = np.concatenate([i, j, node]), np.concatenate([j, i, node])
    chosen = sparse.csr_matrix((np.arange(1, 1 + len(entries)), places))[rows][:, rows]
    kind = sparse.csr_matrix if values.ndim == 1 else sparse.bsr_matrix
    return kind((entries[chosen.data - 1], chosen.indices, chosen.indptr))


def _solve_matrix(matrix: Any, used: ndarray, d: int, multigrid: bool) -> Operator:
    """The solver of the `used` unknowns for right sides; other unknowns are zero."""
    diagonal = np.where(used, matrix.diagonal(), 1)
    if not (diagonal > 0).all():
        return lambda right: np.full_like(right, np.nan)
    scale = used / np.sqrt(diagonal)
    _scale_in_place(matrix, scale)
    factors = functools.cache(lambda: Factors(matrix))
    multigrid &= not (is_direct := is_factored(len(scale), d))
    cycle = _make_cycle(matrix, 1 / np.where(used, scale, 1)) if multigrid else None
    may_factor = is_direct or (multigrid and len(scale) <= RESORT)

    def apply(right):
        columns = right.reshape(len(scale), -1) * scale[:, None]
        x = np.full_like(columns, np.nan)
        if not (is_direct or factors.cache_info().currsize):
            x = np.apply_along_axis(
                lambda column: iterate_to_accuracy(matrix, column, cycle, scale), 0, columns
            )
        if may_factor and np.isfinite(right).all() and not np.isfinite(x).all():
            x = factors()(columns)
        return (x * scale[:, None]).reshape(right.shape)

    return apply


def _scale_in_place(matrix: Any, scale: ndarray) -> None:
    """Multiplies rows and columns by `scale`, in place; where it is 0, the diagonal becomes 1."""
    factor = scale.reshape(len(matrix.indptr) - 1, -1)
    data = matrix.data.reshape(-1, factor.shape[1], factor.shape[1])
    owner = np.repeat(np.arange(len(factor)), np.diff(matrix.indptr))
    data *= factor[owner][:, :, None]
    data *= factor[matrix.indices][:, None]
    data[owner == matrix.indices] += (factor == 0)[:, :, None] * np.eye(factor.shape[1])


def iterate_to_accuracy(
    matrix: Any, right: ndarray, cycle: Operator | None, scale: ndarray
) -> ndarray:
    """Solves for a right side (k,); NaN if CG does not converge, or the matrix is not positive. The
    wanted unknowns are `scale` (k,) times x. The cycle's image of the residual is as large as the
    error: a residual that is small beside stiff cells moves soft cells far.
    """
    enough = ACCURACY**2 * inner_product(right, right)

    def is_enough(x, residual, steep):
        is_small = inner_product(residual, residual) <= enough
        return is_small and (
            cycle is None
            or np.abs(scale * steep).max(initial=0) <= ACCURACY * np.abs(scale * x).max(initial=0)
        )

    # Without a cycle, twice as many steps are allowed.
    inverse, limit = (cycle, MOST_STEPS) if cycle else (lambda residual: residual, 2 * MOST_STEPS)
    x, is_solved = conjugate_gradients(matrix, right, inverse, is_enough, limit)
    return x if is_solved else np.full_like(right, np.nan)


def _make_cycle(matrix: Any, mode: ndarray) -> Operator:
    """A matrix's multigrid cycle; for blocks, one a component, by Korn's inequality."""
    d = len(mode) // (len(matrix.indptr) - 1)
    cycles = []
    for k, data in enumerate(matrix.data.reshape(-1, d, d).diagonal(axis1=1, axis2=2).T):
        part = sparse.csr_matrix((data, matrix.indices, matrix.indptr), copy=True)
        part.eliminate_zeros()
        cycles.append(hierarchy(part, mode[k::d]))

    def cycle(right):
        columns = np.ascontiguousarray(right.reshape(-1, d).T)
        return np.stack(
            [one(column) for one, column in zip(cycles, columns, strict=True)], axis=1
        ).ravel()

    return cycle


def _solve_square(root: Any) -> Operator:
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


def reached(pairs: ndarray, known: ndarray) -> ndarray:
    """Marks the nodes (n,) that pairs (e, 2) connect to a node that is `known` (n,)."""
    part = parts_of(pairs[:, 0], pairs[:, 1], len(known))
    return np.bincount(part, known)[part] > 0


def coincident(points: ndarray, first: ndarray) -> ndarray:
    """The point that represents each point's place (n,); one of `first` if there is any."""
    order = np.concatenate([first, np.setdiff1d(np.arange(len(points)), first)])
    index, inverse = distinct_places(points[order])
    stands = np.empty(len(points), dtype=np.int64)
    stands[order] = order[index[inverse]]
    stands[first] = first
    return stands
