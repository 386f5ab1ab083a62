"""B-splines on clamped, equal knots over [0, 1], Bernstein polynomials at the highest degree."""

import functools
import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

SLAB = 8192  # points in a block: intermediate sums are larger than the result


def splines(t: Float[Array, " m"], count: int, degree: int) -> Float[Array, "m k"]:
    if degree == count - 1:
        return bernstein(t, degree)
    pieces = count - degree
    first = jnp.clip(jnp.floor(t * pieces), 0, pieces - 1)
    knot = lambda i: jnp.clip((first + i) / pieces, 0, 1)  # noqa: E731
    functions = [jnp.ones_like(t)]
    # Cox-de Boor: from one degree to the next, each function goes in two parts to its neighbours
    for p in range(1, degree + 1):
        raised = [jnp.zeros_like(t) for _ in range(p + 1)]
        for r, function in enumerate(functions):
            right, left = knot(r + 1), knot(r + 1 - p)
            part = function / (right - left)
            raised[r] += (right - t) * part
            raised[r + 1] += (t - left) * part
        functions = raised
    # selected by comparison: a gather would have a scatter as its transpose
    place = jnp.arange(count)[None, :] - first[:, None]
    return functools.reduce(jnp.add, (jnp.where(place == r, f[:, None], 0) for r, f in enumerate(functions)))


def bernstein(t: Float[Array, " m"], degree: int) -> Float[Array, "m k"]:
    powers, rest = [jnp.ones_like(t)], [jnp.ones_like(t)]
    for _ in range(degree):
        powers.append(powers[-1] * t)
        rest.append(rest[-1] * (1 - t))
    return jnp.stack([math.comb(degree, k) * powers[k] * rest[degree - k] for k in range(degree + 1)], axis=1)


@jax.jit
def sums(weights: Sequence[Float[Array, "m _"]], control: Float[Array, "*counts d"]) -> Float[Array, "m d"]:
    return jax.lax.map(functools.partial(_sum, control), tuple(weights), batch_size=SLAB)


def _sum(control: Float[Array, "*counts d"], weights: Sequence[Float[Array, " _"]]) -> Float[Array, " d"]:
    for along in weights:
        control = jnp.tensordot(along, control, 1)
    return control
