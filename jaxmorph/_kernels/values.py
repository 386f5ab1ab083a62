"""Gives what JAX leaves to its callers: roots with a finite derivative at zero, and whether a value can be read."""

from typing import Any

import jax
import jax.numpy as jnp
from jax.core import Tracer  # pyright: ignore[reportAttributeAccessIssue]
from jaxtyping import Array, Float


def root(squared: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Computes the square root; its derivative at zero is zero."""
    positive = squared > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, squared, 1)), 0)


def norm(vectors: Float[Array, "*shape d"]) -> Float[Array, "*shape"]:
    """Computes Euclidean lengths; their derivative at zero is zero."""
    return root(jnp.sum(vectors**2, axis=-1))


def is_known(*values: Any) -> bool:
    """Tells whether values can be read: nothing in them is traced."""
    return not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values))
