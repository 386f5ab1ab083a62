"""Converters of the numbers of methods and bases to array leaves.

A concrete number is checked, a traced number passes.
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._host.package.arguments import between
from .._kernels.values import is_known


def number(name: str, low: float | int = -np.inf, high: float | int = np.inf, ends: str = "()") -> Callable[[Any], Any]:
    """Returns a converter to one real number in an interval; `ends` are as for `between`.

    The converter raises `ValueError` for anything else.
    """

    def convert(value: Any) -> Float[Array, ""]:
        if is_known(value):
            between(name, value, low, high, ends)
        value = jnp.asarray(float(value) if isinstance(value, int) else value)
        return value if jnp.issubdtype(value.dtype, jnp.floating) else value.astype(float)

    return convert


def length(name: str) -> Callable[[Any], Any]:
    """Returns a converter to a length, which is positive and finite."""
    return number(name, 0)


def length_or_none(name: str) -> Callable[[Any], Any]:
    """Returns a converter to a length that leaves None as it is."""
    convert = length(name)
    return lambda value: None if value is None else convert(value)
