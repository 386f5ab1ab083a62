"""Values of NumPy and JAX: roots and maxima with safe derivatives, formulas for both arrays."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer  # pyright: ignore[reportAttributeAccessIssue]
from jaxtyping import Float

Either = Any  # an array of JAX or NumPy, for formulas with `namespace`


def namespace(array: Any) -> Any:
    """NumPy for its arrays, whose formulas need no compilation; else `jax.numpy`."""
    # A formula has two forms only where a first call gains a tenth of a process's time: `quality`,
    # `inverted` and `wall_quality` gain 0.4 to 0.9 CPU seconds of 3.5 in 2-D, 0.9 to 3.6 in 3-D;
    # the layer's width in `prepare` gains 1.1 of 4.2. See "First calls" in benchmarks/README.md.
    return np if isinstance(array, np.ndarray | np.generic) else jnp


def constant(values: Either) -> Either:
    return values if isinstance(values, np.ndarray) else jax.lax.stop_gradient(values)


def as_jax(tree: Any) -> Any:
    """Copies the NumPy arrays of a tree into arrays of JAX, without a program for a new shape."""
    return jax.tree.map(
        lambda leaf: leaf if isinstance(leaf, jax.Array) else jax.device_put(np.array(leaf)), tree
    )


def jax_arrays(**arrays: Any) -> dict[str, Any]:
    """Copies trees of NumPy arrays by name, as `as_jax`; whole numbers become ids of four bytes."""

    def narrowed(leaf: Any) -> Any:
        return np.asarray(leaf, np.int32) if np.asarray(leaf).dtype.kind == "i" else leaf

    return as_jax(jax.tree.map(narrowed, arrays))


def array(values: Any) -> Any:
    """Makes an array of JAX as `jnp.asarray` does, but compiles nothing, and copies the memory."""
    if isinstance(values, jax.Array) or not is_known(values):
        return jnp.asarray(values)
    return as_jax(np.asarray(values))


def on_host(*values: Any) -> bool:
    """Checks whether values are readable in the host's memory: NumPy can compute with them."""
    arrays = (leaf for leaf in jax.tree.leaves(values) if isinstance(leaf, jax.Array))
    return is_readable(values) and all(
        device.platform == "cpu" for leaf in arrays for device in leaf.devices()
    )


def taken(values: Any, rows: Any) -> Any:
    """Some rows of an array; without a program where the array is in the host's memory."""
    if not (isinstance(values, jax.Array) and on_host(values, rows) and len(values.devices()) == 1):
        return values[rows]
    return jax.device_put(np.asarray(values)[rows], values.sharding if values.committed else None)


def is_readable(*values: Any) -> bool:
    """Checks whether this process can read values: nothing is traced or in another process."""
    arrays = (leaf for leaf in jax.tree.leaves(values) if isinstance(leaf, jax.Array))
    return is_known(values) and all(leaf.sharding.is_fully_addressable for leaf in arrays)


def root(squared: Float[Either, "*shape"]) -> Float[Either, "*shape"]:
    """The square root; its derivative at zero is zero."""
    xp = namespace(squared)
    positive = squared > 0
    return xp.where(positive, xp.sqrt(xp.where(positive, squared, 1)), 0)


def norm(vectors: Float[Either, "*shape d"]) -> Float[Either, "*shape"]:
    """Euclidean lengths; their derivative at zero is zero."""
    return root(namespace(vectors).sum(vectors**2, axis=-1))


def at_rows(array: Either, rows: Either) -> Either:
    """Picks rows that are known to be there: traced code then checks and wraps no index."""
    if namespace(array) is np:
        return array[rows]
    return array.at[rows].get(mode="promise_in_bounds", wrap_negative_indices=False)


def add_at(total: Either, rows: Any, values: Either) -> Either:
    """Adds values to rows of `total`, also several to one row."""
    if namespace(total) is not np:
        return total.at[rows].add(values)
    total = total.copy()
    np.add.at(total, rows, values)
    return total


def put_at(array: Either, rows: Any, values: Either) -> Either:
    """Replaces rows, of which none comes twice."""
    if namespace(array) is not np:
        return array.at[rows].set(values)
    array = array.copy()
    array[rows] = values
    return array


def iterate(function: Callable[[Either], Either], start: Either, count: int) -> Either:
    """Applies a function `count` times to an array, in traced code in one loop."""
    if namespace(start) is not np:
        return jax.lax.scan(lambda value, _: (function(value), None), start, length=count)[0]
    for _ in range(count):
        start = function(start)
    return start


def area_vectors(corners: Float[Either, "f c d"]) -> Float[Either, "f d"]:
    """Computes area vectors of faces: of triangles or quads, in 2-D of edges, as long as these."""
    xp = namespace(corners)
    if corners.shape[1] == 2:
        edge = corners[:, 1] - corners[:, 0]
        return xp.stack([edge[:, 1], -edge[:, 0]], axis=1)
    return xp.cross(corners[:, 2] - corners[:, 0], corners[:, -1] - corners[:, 1]) / 2


def largest(values: Float[Either, "*shape"], axis: int = 0) -> Float[Either, "*rest"]:
    """The largest value along an axis; the derivative is the mean over equal ones."""
    return np.max(values, axis=axis) if namespace(values) is np else _largest(values, axis)


def smallest(values: Float[Either, "*shape"], axis: int = 0) -> Float[Either, "*rest"]:
    return -largest(-values, axis)


@functools.partial(jax.custom_jvp, nondiff_argnums=(1,))
def _largest(values, axis):
    return jnp.max(values, axis=axis)


@_largest.defjvp
def _largest_jvp(axis, primals, tangents):
    # JAX's own rule compares the values with their maximum. If XLA computes the values anew, none
    # may be equal. The place of the maximum is always found.
    (values,), (tangent,) = primals, tangents
    top = _largest(values, axis)
    index = jnp.argmax(values, axis=axis, keepdims=True)
    rows = jax.lax.broadcasted_iota(index.dtype, values.shape, axis % values.ndim)
    chosen = (rows == index) | (values == jnp.expand_dims(top, axis))
    share = jnp.where(chosen, tangent, 0) / jnp.sum(chosen, axis=axis, keepdims=True).astype(
        tangent.dtype
    )
    return top, jnp.sum(share, axis=axis)


def is_known(*values: Any) -> bool:
    """Checks whether values are known now: none is traced, so that Python may look at them."""
    return not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values))
