"""Smooth stand-ins for functions with kinks."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Real

from .._host.package.arguments import checked
from .._methods.base import number


@checked
def soft_maximum(
    values: Real[ArrayLike, "..."] | Sequence[Any], sharpness: Any = 50.0, axis: int | None = None
) -> Float[Array, "..."]:
    """Computes a smooth stand-in for the largest value.

    It is log(mean(exp(sharpness values))) / sharpness.

    It is below the largest value by log(count) / sharpness at most. Its derivative is spread over
    the values near the largest. The mean instead of the sum keeps the soft maximum of equal values
    equal to them.

    **Arguments:**

    - `values`: an array.
    - `sharpness`: positive, in the inverse unit of `values`, default 50. A larger value comes
      closer to the maximum.
    - `axis`: the axis along which to take it. Default: all values.

    **Returns:** a number, or an array without that axis.

    **Raises:** `ValueError` for a sharpness that is not positive and finite, and an axis that is
    not there.
    """
    values, sharpness = jnp.asarray(values), number("sharpness", 0)(sharpness)
    if axis is not None and not -values.ndim <= axis < values.ndim:
        raise ValueError(f"`axis` is {axis}; `values` have {values.ndim} axes, 0 to {values.ndim - 1}.")
    count = values.size if axis is None else values.shape[axis]
    largest = jax.scipy.special.logsumexp(sharpness * values, axis=axis)
    return (largest - jnp.log(jnp.asarray(count, values.dtype))) / sharpness


def positive_part(x: Float[Array, "..."], softness: Any) -> Float[Array, "..."]:
    """Computes a smooth positive part: positive and increasing everywhere.

    It is (x + sqrt(x^2 + softness^2)) / 2, close to x for x far above `softness`.

    It is the regularised determinant of Garanzha et al., Foldover-free maps in 50 lines of code,
    ACM Trans. Graph. 40, 2021.
    """
    root = jnp.sqrt(x**2 + softness**2)
    return jnp.where(x >= 0, (x + root) / 2, softness**2 / (2 * (root + jnp.abs(x))))
