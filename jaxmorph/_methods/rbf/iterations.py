"""Conjugate gradients for the interpolation system (eq. 3), and their preconditioner."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.sparse.linalg import cg
from jaxtyping import Array, Float, Int

from ..base import Scalar, matmul, or_one
from .basis import Columns, Sources
from .system import polynomial, squared_distances

MOST_PRODUCTS = 150  # most products of a solve. A sound matrix takes 10 to 20.
MEAN = 0.1  # residual at which steps end, as a mean over the sources, in tolerances

MISSED, NOTICEABLE = (
    1e3,
    1e-3,
)  # tolerances, or share of the displacement: a field that misses by more is NaN
ROUNDINGS = 100  # units of rounding below which no tolerance goes: what single precision can reach
# corner of a small system, relative to its kernel, for neighbours that lie in one plane
GIVE = 1e-10

Product = Callable[[Columns], Columns]


class OrderedIds(eqx.Module):
    """Sources in the order from far apart to close, and neighbours of all but the first ones. A row
    of `earlier` has the source's own place first, then places of sources before it.
    """

    sources: Int[Array, " s"]
    earlier: Int[Array, "r q"]


class Cardinals(eqx.Module):
    earlier: Int[Array, "r q"]
    weights: Float[Array, "r q"]
    tolerance: Scalar


def local_weights(
    phi: Callable, sources: Sources, earlier: Int[Array, "r q"], degree: int | None, sign: int
) -> Float[Array, "r q"]:
    """Coefficients of functions that are 1 at one source, 0 at the nearest sources before it;
    `sign` is that of `phi` as a definite function.
    """
    count = earlier.shape[1]

    def of_one(ids):
        is_there = (jnp.arange(count) == 0) | (ids != ids[0])
        places = sources[ids] - sources[ids[0]][None]
        extent = jnp.abs(places).max()
        tail = polynomial(places / or_one(extent), degree) * is_there[:, None]
        kernel = phi(squared_distances(places, places))
        size = jnp.abs(kernel).max()
        kernel = jnp.where(
            is_there[:, None] & is_there[None],
            kernel / size,
            sign * jnp.eye(count, dtype=size.dtype),
        )
        corner = -sign * GIVE * jnp.eye(tail.shape[1], dtype=size.dtype)
        matrix = jnp.block([[kernel, tail], [tail.T, corner]])
        solved = jnp.linalg.solve(matrix, jnp.eye(len(matrix), 1, dtype=size.dtype))[:count, 0]
        return jnp.where(is_there, solved, 0) / size

    if not len(earlier):
        return jnp.zeros(earlier.shape, sources.dtype)
    # one by one: a batch of factorisations in a loop has come to a standstill in XLA's threads on
    # the CPU
    return jax.lax.map(of_one, earlier)


def precondition(rows: Cardinals, solve_first: Callable, residual: Columns) -> Columns:
    """Applies sum_l w_l (w_l . r) / w_ll, and the dense inverse for the first sources."""
    first = len(residual) - len(rows.earlier)
    columns = rows.earlier.T, rows.weights.T

    def gather(total, column):
        ids, weights = column
        return total + weights[:, None] * residual[ids], None

    def scatter(total, column):
        ids, weights = column
        return total.at[ids].add(weights[:, None] * values), None

    values = (
        jax.lax.scan(gather, jnp.zeros_like(residual[first:]), columns)[0] / rows.weights[:, :1]
    )
    start = jnp.zeros_like(residual).at[:first].set(solve_first(residual[:first]))
    return jax.lax.scan(scatter, start, columns)[0]


def iterated(
    product: Product,
    inverse: Product,
    tail: Float[Array, "s p"],
    tolerance: Scalar,
    right: Float[Array, "t k"],
) -> Float[Array, "t k"]:
    """Solves K beta + T alpha = v, T' beta = g, on weights that the polynomial does not see.
    `product` multiplies by K, `inverse` by the preconditioner; `tail` is T, `right` v and g. The
    result is NaN where the steps do not converge.
    """
    values = right[: len(tail)]
    moments = right[len(tail) :]
    lower = jnp.linalg.cholesky(matmul(tail.T, tail)), True

    def coefficients(moments):
        return jax.scipy.linalg.cho_solve(lower, moments)

    def unseen(values):
        return values - matmul(tail, coefficients(matmul(tail.T, values)))

    def improved(state, left):
        beta, rest = state
        steps = {
            "tol": 0.0,
            "atol": left,
            "maxiter": MOST_PRODUCTS,
            "M": lambda x: unseen(inverse(x)),
        }
        beta = beta + cg(lambda x: unseen(product(x)), unseen(rest), **steps)[0]
        return beta, values - product(beta)

    def missed(rest):
        return jnp.abs(unseen(rest)).max()

    beta = matmul(tail, coefficients(moments))
    rest = jax.lax.cond((moments != 0).any(), lambda: values - product(beta), lambda: values)
    size = jnp.abs(rest).max()
    goal = tolerance * size
    state = improved((beta, rest), MEAN * rest.size**0.5 * goal)
    beta, rest = jax.lax.cond(
        missed(state[1]) > goal, lambda state: improved(state, goal), lambda state: state, state
    )
    allowed = jnp.minimum(MISSED * tolerance, jnp.maximum(tolerance, NOTICEABLE))
    solved = jnp.concatenate([beta, coefficients(matmul(tail.T, rest))])
    return jnp.where(missed(rest) <= allowed * size, solved, jnp.nan)
