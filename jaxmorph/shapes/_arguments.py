"""Checks of arguments: shapes always, values where they are known."""

import reprlib
from collections.abc import Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int, Real

from jaxmorph.extend import Module, is_known
from jaxmorph.extend import rows_of as listed_rows

M = TypeVar("M", bound=Module)
Number = Real[ArrayLike, ""]
Numbers = Real[ArrayLike, "..."] | Sequence[Any]


def positions(x: Numbers, name: str = "x") -> Float[Array, "m d"]:
    is_array = isinstance(x, jax.Array) or not is_known(x)
    places = jnp.asarray(x) if is_array else jax.device_put(np.array(x))  # copied, and no program compiled
    if places.ndim != 2 or places.shape[1] not in (2, 3):
        raise ValueError(f"`{name}` has shape {places.shape}; positions have shape (m, 2) or (m, 3).")
    return places if jnp.issubdtype(places.dtype, jnp.floating) else places.astype(jnp.result_type(float))


def positions_in(x: Numbers, counts: tuple[int, ...]) -> Float[Array, "m d"]:
    """Turns positions into an array (m, d) for a box of control points with d counts."""
    places = positions(x)
    if places.shape[1] != len(counts):
        raise ValueError(f"`x` has shape {places.shape}; this box is in {len(counts)}-D.")
    return places


def cast(module: M, x: Float[Array, "m d"]) -> M:
    return jax.tree.map(lambda leaf: leaf.astype(x.dtype) if jnp.issubdtype(leaf.dtype, jnp.inexact) else leaf, module)


def known_positions(x: Numbers, name: str = "x") -> Float[np.ndarray, "m d"]:
    """Turns positions that can be read into a finite array (m, d) of NumPy."""
    known = np.asarray(positions(x, name))
    bad = np.flatnonzero(~np.isfinite(known).all(axis=1))
    if len(bad):
        raise ValueError(f"{len(bad)} of {len(known)} rows of `{name}` are not finite, first row {bad[0]}.")
    return known


def check_finite(**arrays: Any) -> None:
    for name, values in arrays.items():
        if values is not None and is_known(values) and not (finite := np.isfinite(np.asarray(values, float))).all():
            raise ValueError(f"{(~finite).sum()} of {finite.size} numbers of `{name}` are not finite.")


def check_parameters(parameters: Any) -> None:
    for leaf in jax.tree.leaves(parameters):
        if not hasattr(leaf, "dtype") and np.asarray(leaf).dtype.kind not in "fiub":
            raise ValueError(f"`parameters` holds {reprlib.repr(leaf)}; design variables are real numbers.")


def rows_of(name: str, ids: Any, count: int) -> Int[np.ndarray, "..."]:
    try:
        array = np.asarray(ids)
    except ValueError:
        array = np.zeros((), object)  # rows of several lengths
    return listed_rows(name, array.ravel(), count).reshape(array.shape)


def number(name: str, value: Any, like: Array) -> Float[Array, ""]:
    return _finite(name, value, like, (), "it is one number")


def vector(name: str, values: Any, like: Array) -> Float[Array, " d"]:
    d = like.shape[1]
    return _finite(name, values, like, (d,), f"positions in {d}-D need ({d},)")


def _finite(name: str, values: Any, like: Array, shape: tuple[int, ...], expected: str) -> Float[Array, "..."]:
    values = jnp.asarray(values, like.dtype)
    if values.shape != shape:
        raise ValueError(f"`{name}` has shape {values.shape}; {expected}.")
    if is_known(values) and not np.isfinite(values).all():
        raise ValueError(f"`{name}` is {np.asarray(values)}; it must be finite.")
    return values


def direction(name: str, values: Any, like: Array) -> Float[Array, " d"]:
    values = vector(name, values, like)
    if is_known(values) and not np.asarray(values).any():  # NumPy's, which no trace records
        raise ValueError(f"`{name}` has length 0; it must be a direction.")
    return values / jnp.linalg.norm(values)


def positive(name: str, value: Any, like: Array) -> Float[Array, ""]:
    value = number(name, value, like)
    if is_known(value) and not value > 0:
        raise ValueError(f"`{name}` is {value}; it must be above 0.")
    return value


def axis_for(values: Any, like: Array) -> Float[Array, " 3"] | None:
    if like.shape[1] == 3 and values is None:
        raise ValueError("`axis` is missing: a rotation in 3-D needs (3,) numbers.")
    if like.shape[1] == 2 and values is not None:
        raise ValueError("`axis` is for positions in 3-D; leave it out in 2-D.")
    return None if values is None else direction("axis", values, like)


def slack(dtype: Any) -> float:
    """The share beyond an interval's ends that counts as inside: more than round-off."""
    return float(jnp.finfo(dtype).eps) ** 0.75


def clipped(values: Float[Array, "*shape"], low: Any, high: Any) -> Float[Array, "*shape"]:
    """Clips values to an interval, ends inside, where `jnp.clip` halves the derivative."""
    beyond = slack(values.dtype) * (high - low)
    return jnp.where(values < low - beyond, low, jnp.where(values > high + beyond, high, values))
