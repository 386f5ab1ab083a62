"""Conjugate gradients for the interpolation system (eq. 3), and their preconditioner."""

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .system import polynomial, squared_distances

LIMIT = 150  # most products of a solve. A sound matrix takes 10 to 20.
ROUNDS = 3  # solves for what rounding leaves of the residual
STALLED = 0.5  # least share of the residual that another solve takes away: the rest is the product's rounding

MISSED, NOTICEABLE = 1e3, 1e-3
"""A field is NaN that misses its sources by this many tolerances, and share of the displacement."""

ROUNDINGS = 100  # units of rounding below which no tolerance goes: what single precision can reach
GIVE = 1e-10  # corner of a small system, relative to its kernel, for neighbours that lie in one plane

Product = Callable[[Float[Array, "s k"]], Float[Array, "s k"]]


class OrderedIds(eqx.Module):
    """Sources in the order from far apart to close, and neighbours of all but the first ones. A row
    of `earlier` has the source's own place first, then places of sources before it.
    """

    sources: Int[Array, " s"]
    earlier: Int[Array, "r q"]


class Cardinals(eqx.Module):
    earlier: Int[Array, "r q"]
    weights: Float[Array, "r q"]
    tolerance: Float[Array, ""]


def local_weights(
    phi: Callable, sources: Float[Array, "s d"], earlier: Int[Array, "r q"], degree: int | None, sign: int
) -> Float[Array, "r q"]:
    """Coefficients of functions that are 1 at one source, 0 at the nearest sources before it;
    `sign` is that of `phi` as a definite function.
    """
    count = earlier.shape[1]

    def of_one(ids):
        is_there = jnp.arange(count) * (ids != ids[0]) > 0
        is_there = is_there.at[0].set(True)
        places = sources[ids] - sources[ids[0]][None]
        extent = jnp.abs(places).max()
        tail = polynomial(places / jnp.where(extent > 0, extent, 1), degree) * is_there[:, None]
        kernel = phi(squared_distances(places, places))
        size = jnp.abs(kernel).max()
        kernel = jnp.where(is_there[:, None] & is_there[None], kernel / size, sign * jnp.eye(count, dtype=size.dtype))
        corner = -sign * GIVE * jnp.eye(tail.shape[1], dtype=size.dtype)
        matrix = jnp.block([[kernel, tail], [tail.T, corner]])
        solved = jnp.linalg.solve(matrix, jnp.eye(len(matrix), 1, dtype=size.dtype))[:count, 0]
        return jnp.where(is_there, solved, 0) / size

    if not len(earlier):
        return jnp.zeros(earlier.shape, sources.dtype)
    # one by one: a batch of factorisations in a loop has come to a standstill in XLA's threads on
    # the CPU
    return jax.lax.map(of_one, earlier)


def precondition(rows: Cardinals, solve_first: Callable, residual: Float[Array, "s k"]) -> Float[Array, "s k"]:
    """Applies sum_l w_l (w_l . r) / w_ll, and the dense inverse for the first sources."""
    first = len(residual) - len(rows.earlier)
    columns = rows.earlier.T, rows.weights.T

    def gather(total, column):
        ids, weights = column
        return total + weights[:, None] * residual[ids], None

    def scatter(total, column):
        ids, weights = column
        return total.at[ids].add(weights[:, None] * values), None

    values = jax.lax.scan(gather, jnp.zeros_like(residual[first:]), columns)[0] / rows.weights[:, :1]
    start = jnp.zeros_like(residual).at[:first].set(solve_first(residual[:first]))
    return jax.lax.scan(scatter, start, columns)[0]


class Progress(eqx.Module):
    beta: Float[Array, "s k"]
    residual: Float[Array, "s k"]
    direction: Float[Array, "s k"]
    left: Float[Array, " k"]
    energy: Float[Array, " k"]
    count: Int[Array, ""]


@dataclasses.dataclass(frozen=True, eq=False)
class ConjugateGradients:
    """Solves K beta + T alpha = v, T' beta = g, on weights that the polynomial does not see.
    `product` multiplies by K, `inverse` by the preconditioner; `tail` is T.
    """

    product: Product
    inverse: Product
    tail: Float[Array, "s p"]
    tolerance: Float[Array, ""]

    def coefficients(self, values: Float[Array, "s k"]) -> Float[Array, "p k"]:
        return self._moments(times(self.tail.T, values))

    def _moments(self, moments):
        if not self.tail.shape[1]:
            return moments
        lower = jnp.linalg.cholesky(times(self.tail.T, self.tail))
        return jax.scipy.linalg.cho_solve((lower, True), moments)

    def without_polynomial(self, values: Float[Array, "s k"]) -> Float[Array, "s k"]:
        return values - times(self.tail, self.coefficients(values))

    def step(self, now: Progress) -> Progress:
        product = self.product(now.direction)
        share = _ratio(now.left, jnp.sum(now.direction * product, axis=0))[None]
        residual = self.without_polynomial(now.residual - share * product)
        inverse = self.without_polynomial(self.inverse(residual))
        left = jnp.sum(residual * inverse, axis=0)
        direction = inverse + _ratio(left, now.left)[None] * now.direction
        energy = now.energy + share[0] * now.left
        return Progress(now.beta + share * now.direction, residual, direction, left, energy, now.count + 1)

    def is_far(self, now: Progress, size: Float[Array, ""]) -> Array:
        beyond = jnp.abs(now.left) > self.tolerance**2 * jnp.abs(now.energy)
        return (jnp.abs(now.residual).max() > self.tolerance * size) | beyond.any()

    def improve(self, residual: Float[Array, "s k"], size: Float[Array, ""], energy: Float[Array, " k"]) -> Progress:
        """Takes steps from zero; the error is relative to the `energy` so far."""

        def is_unfinished(now):
            return (now.count < LIMIT) & ((now.count == 0) | self.is_far(now, size))

        direction = self.without_polynomial(self.inverse(residual))
        left = jnp.sum(residual * direction, axis=0)
        start = Progress(jnp.zeros_like(residual), residual, direction, left, energy, jnp.zeros((), int))
        return jax.lax.while_loop(is_unfinished, self.step, start)

    def solve(self, right: Float[Array, "t k"]) -> Float[Array, "t k"]:
        """Solves for the weights of functions and polynomial; NaN where it does not converge."""
        count = len(self.tail)
        values, moments = right[:count], right[count:]
        beta = times(self.tail, self._moments(moments))
        rest = jax.lax.cond((moments != 0).any(), lambda: values - self.product(beta), lambda: values)
        size = jnp.abs(rest).max()

        def missed(rest):
            return jnp.abs(self.without_polynomial(rest)).max()

        def is_unfinished(state):
            _, rest, _, rounds, before = state
            now = missed(rest)
            return (rounds < ROUNDS) & (now > self.tolerance * size) & (now < STALLED * before)

        def once_more(state):
            beta, rest, energy, rounds, _ = state
            more = self.improve(self.without_polynomial(rest), size, energy)
            beta = beta + more.beta
            return beta, values - self.product(beta), more.energy, rounds + 1, missed(rest)

        start = beta, rest, jnp.zeros_like(beta[0]), 0, jnp.full_like(size, jnp.inf)
        beta, rest, *_ = jax.lax.while_loop(is_unfinished, once_more, start)
        solved = jnp.concatenate([beta, self.coefficients(rest)])
        allowed = jnp.minimum(MISSED * self.tolerance, jnp.maximum(self.tolerance, NOTICEABLE))
        return jnp.where(missed(rest) <= allowed * size, solved, jnp.nan)


def _ratio(a, b):
    return jnp.where(b == 0, 0, a / jnp.where(b == 0, 1, b))


def times(a: Float[Array, "m k"], b: Float[Array, "k *n"]) -> Float[Array, "m *n"]:
    return jnp.matmul(a, b, precision="highest")
