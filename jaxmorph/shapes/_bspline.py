"""B-splines on clamped, equal knots over [0, 1].

Those of the highest degree are Bernstein polynomials.
"""

import math

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int


def greville(count: int, degree: int) -> Float[np.ndarray, " count"]:
    """Finds Greville's abscissae, means of `degree` knots: control points that give t itself."""
    knots = np.clip(np.arange(1 - degree, count) / (count - degree), 0, 1)
    return np.convolve(knots, np.full(degree, 1 / degree), mode="valid")


def spans(t: Float[Array, " m"], count: int, degree: int) -> Int[Array, " m"]:
    """Finds the first of the `degree + 1` functions that are not zero at each t."""
    pieces = count - degree
    return jnp.clip(jnp.floor(t * pieces), 0, pieces - 1).astype(jnp.int32)


def values(t: Float[Array, " m"], first: Int[Array, " m"], count: int, degree: int) -> Float[Array, "m k"]:
    """Evaluates the `degree + 1` functions that are not zero at each t, from `first` on."""
    if degree == count - 1:
        return bernstein(t, degree)
    pieces = count - degree
    knot = lambda i: jnp.clip((first.astype(t.dtype) + i) / pieces, 0, 1)  # noqa: E731
    functions = [jnp.ones_like(t)]
    # Cox-de Boor: from one degree to the next, each function goes in two parts to its neighbours
    for p in range(1, degree + 1):
        raised = [jnp.zeros_like(t) for _ in range(p + 1)]
        for r, function in enumerate(functions):
            right, left = knot(r + 1), knot(r + 1 - p)
            part = function / (right - left)
            raised[r] = raised[r] + (right - t) * part
            raised[r + 1] = raised[r + 1] + (t - left) * part
        functions = raised
    return jnp.stack(functions, axis=1)


def bernstein(t: Float[Array, " m"], degree: int) -> Float[Array, "m k"]:
    """Evaluates the Bernstein polynomials of a degree."""
    powers, rest = [jnp.ones_like(t)], [jnp.ones_like(t)]
    for _ in range(degree):
        powers.append(powers[-1] * t)
        rest.append(rest[-1] * (1 - t))
    return jnp.stack([math.comb(degree, k) * powers[k] * rest[degree - k] for k in range(degree + 1)], axis=1)
