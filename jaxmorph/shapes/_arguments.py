"""Checks of arguments: shapes always, values where they are known."""

import functools
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
Scalar = Float[Array, ""]
Column = Float[Array, " m"]
Vector = Float[Array, " d"]
Positions = Float[Array, "m d"]
Weights = Float[Array, "m k"]


def positions(x: Numbers, name: str = "x", like: tuple[int, ...] | None = None) -> Positions:
    is_array = isinstance(x, jax.Array) or not is_known(x)
    places = (
        jnp.asarray(x) if is_array else jax.device_put(np.array(x))
    )  # copied, and no program compiled
    if places.ndim != 2 or places.shape[1] not in (2, 3):
        raise ValueError(
            f"`{name}` has shape {places.shape}; positions have shape (m, 2) or (m, 3)."
        )
    if like is not None and places.shape != like:
        raise ValueError(f"`{name}` has shape {places.shape}; this shape is for positions {like}.")
    return (
        places
        if jnp.issubdtype(places.dtype, jnp.floating)
        else places.astype(jnp.result_type(float))
    )


def cast(module: M, x: Positions) -> M:
    return jax.tree.map(
        lambda leaf: leaf.astype(x.dtype) if jnp.issubdtype(leaf.dtype, jnp.inexact) else leaf,
        module,
    )


def known_positions(x: Numbers, name: str = "x") -> Float[np.ndarray, "m d"]:
    """Turns positions that can be read into a finite array (m, d) of NumPy."""
    known = np.asarray(positions(x, name))
    bad = np.flatnonzero(~np.isfinite(known).all(axis=1))
    if len(bad):
        raise ValueError(
            f"{len(bad)} of {len(known)} rows of `{name}` are not finite, first row {bad[0]}."
        )
    return known


def check_finite(**arrays: Any) -> None:
    for name, values in arrays.items():
        if (
            values is not None
            and is_known(values)
            and not (finite := np.isfinite(np.asarray(values, float))).all()
        ):
            raise ValueError(
                f"{(~finite).sum()} of {finite.size} numbers of `{name}` are not finite."
            )


def check_parameters(parameters: Any) -> None:
    for leaf in jax.tree.leaves(parameters):
        if not hasattr(leaf, "dtype") and np.asarray(leaf).dtype.kind not in "fiub":
            raise ValueError(
                f"`parameters` holds {reprlib.repr(leaf)}; design variables are real numbers."
            )


def rows_of(name: str, ids: Any, count: int) -> Int[np.ndarray, "..."]:
    try:
        array = np.asarray(ids)
    except ValueError:
        array = np.zeros((), object)  # rows of several lengths
    return listed_rows(name, array.ravel(), count).reshape(array.shape)


def number(name: str, value: Any, like: Array) -> Scalar:
    return _finite(name, value, like, (), "it is one number")


def vector(name: str, values: Any, like: Array) -> Vector:
    d = like.shape[1]
    return _finite(name, values, like, (d,), f"positions in {d}-D need ({d},)")


def _finite(
    name: str, values: Any, like: Array, shape: tuple[int, ...], expected: str
) -> Float[Array, "..."]:
    values = jnp.asarray(values, like.dtype)
    if values.shape != shape:
        raise ValueError(f"`{name}` has shape {values.shape}; {expected}.")
    if is_known(values) and not np.isfinite(values).all():
        raise ValueError(f"`{name}` is {np.asarray(values)}; it must be finite.")
    return values


def arms(x: Positions, about: Any) -> Positions:
    return x - vector("about", about, x)[None, :]


def direction(name: str, values: Any, like: Array) -> Vector:
    values = vector(name, values, like)
    if is_known(values) and not np.asarray(values).any():  # NumPy's, which no trace records
        raise ValueError(f"`{name}` has length 0; it must be a direction.")
    return values / jnp.linalg.norm(values)


def positive(name: str, value: Any, like: Array) -> Scalar:
    value = number(name, value, like)
    if is_known(value) and not value > 0:
        raise ValueError(f"`{name}` is {value}; it must be above 0.")
    return value


def axis_for(values: Any, like: Positions) -> Float[Array, " 3"]:
    """The direction (3,) about which positions turn; in 2-D that of the drawing."""
    if (values is None) != (like.shape[1] == 2):
        is_missing = "is missing: a rotation in 3-D needs (3,) numbers"
        raise ValueError(
            "`axis` "
            f"{is_missing if values is None else 'is for positions in 3-D; leave it out in 2-D'}."
        )
    return (
        jnp.array([0.0, 0.0, 1.0], like.dtype)
        if values is None
        else direction("axis", values, like)
    )


def piecewise(t: Column, breaks: Any, coefficients: Sequence[Any]) -> Weights:
    """Evaluates polynomials between breaks; coefficients (pieces, k) by rising power."""
    breaks = jnp.asarray(breaks, t.dtype)
    piece = jnp.clip(jnp.searchsorted(breaks, t, side="right") - 1, 0, len(breaks) - 2)
    terms = [jnp.asarray(term, t.dtype)[piece] for term in coefficients]
    from_break = (t - breaks[piece])[:, None]
    return functools.reduce(lambda total, term: total * from_break + term, reversed(terms))


def shown_place(point: Any) -> str:
    return f"({', '.join(f'{x:.6g}' for x in point)})"


def slack(dtype: Any) -> float:
    """The share beyond an interval's ends that counts as inside: more than round-off."""
    return float(jnp.finfo(dtype).eps) ** 0.75


def clipped(values: Float[Array, "*shape"], low: Any, high: Any) -> Float[Array, "*shape"]:
    """Clips values to an interval, ends inside, where `jnp.clip` halves the derivative."""
    beyond = slack(values.dtype) * (high - low)
    return jnp.where(values < low - beyond, low, jnp.where(values > high + beyond, high, values))
