"""Checks of arguments: shapes always, values where they are known."""

import functools
import reprlib
from collections.abc import Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int, Real
from numpy import ndarray

from jaxmorph.extend import Module, finite_array, is_known
from jaxmorph.extend import rows_of as listed_rows

M = TypeVar("M", bound=Module)
ShapeNumber = Real[ArrayLike, ""]
Numbers = Real[ArrayLike, "..."] | Sequence[Any]
Scalar = Float[Array, ""]
Column = Float[Array, " m"]
Vector = Float[Array, " d"]
Positions = Float[Array, "m d"]
ShapeWeights = Float[Array, "m k"]


def positions(x: Numbers, name: str = "x", like: tuple[int, ...] | None = None) -> Positions:
    if not isinstance(x, jax.Array) and is_known(x):
        x = jax.device_put(np.array(x))  # copied, and no program compiled
    places = jnp.asarray(x)
    if places.ndim != 2 or places.shape[1] not in (2, 3):
        raise ValueError(
            f"`{name}` has shape {places.shape}; positions have shape (m, 2) or (m, 3)."
        )
    if like is not None and places.shape != like:
        raise ValueError(f"`{name}` has shape {places.shape}; this shape is for positions {like}.")
    is_float = jnp.issubdtype(places.dtype, jnp.floating)
    return places if is_float else places.astype(jnp.result_type(float))


def cast(module: M, x: Positions) -> M:
    return jax.tree.map(
        lambda leaf: leaf.astype(x.dtype) if jnp.issubdtype(leaf.dtype, jnp.inexact) else leaf,
        module,
    )


def known_positions(x: Numbers, name: str = "x") -> Float[ndarray, "m d"]:
    """Turns positions that can be read into a finite array (m, d) of NumPy."""
    places = positions(x, name)
    check_known(**{name: places})
    return np.asarray(places)


def check_known(**arrays: Any) -> None:
    """Raises `ValueError` for numbers that are not finite, where they are known."""
    for name, values in arrays.items():
        if is_known(values):
            finite_array(name, np.asarray(values), np.shape(values))


def check_parameters(parameters: Any) -> None:
    for leaf in jax.tree.leaves(parameters):
        if not hasattr(leaf, "dtype") and np.asarray(leaf).dtype.kind not in "fiub":
            raise ValueError(
                f"`parameters` holds {reprlib.repr(leaf)}; design variables are real numbers."
            )


def rows_like(name: str, ids: Any, count: int) -> Int[ndarray, "..."]:
    try:
        array = np.asarray(ids)
    except ValueError:
        array = np.zeros((), object)  # rows of several lengths
    return listed_rows(name, array.ravel(), count).reshape(array.shape)


def one_number(name: str, value: Any, like: Array) -> Scalar:
    return vector(name, value, like, ())


def vector(
    name: str, values: Any, like: Array, shape: tuple[int, ...] | None = None
) -> Float[Array, "..."]:
    return jnp.asarray(_readable(name, values, like, shape))


def _readable(name: str, values: Any, like: Array, shape: tuple[int, ...] | None = None) -> Any:
    """Checks numbers of a shape; those that are known stay NumPy's, also while JAX traces."""
    needed = like.shape[1:] if shape is None else shape
    known = is_known(values)
    values = (np if known else jnp).asarray(values, like.dtype)
    if values.shape != needed:
        what = f"expected {needed or 'one number'}"
        if shape is None:
            what = f"positions in {needed[0]}-D need {needed}"
        raise ValueError(f"`{name}` has shape {values.shape}; {what}.")
    check_known(**{name: values})
    return values


def arms_from(x: Positions, about: Any) -> Positions:
    return x - vector("about", about, x)[None, :]


def direction(name: str, values: Any, like: Array, shape: tuple[int, ...] | None = None) -> Vector:
    values = _readable(name, values, like, shape)
    if is_known(values) and not values.any():
        raise ValueError(f"`{name}` has length 0; it must be a direction.")
    values = jnp.asarray(values)
    return values / jnp.linalg.norm(values)


def above_zero(name: str, value: Any, like: Array) -> Scalar:
    value = _readable(name, value, like, ())
    if is_known(value) and not value > 0:
        raise ValueError(f"`{name}` is {value}; it must be above 0.")
    return jnp.asarray(value)


def axis_for(values: Any, like: Positions) -> Float[Array, " 3"]:
    """The direction (3,) about which positions turn; in 2-D that of the drawing."""
    is_flat = like.shape[1] == 2
    if values is None:
        if not is_flat:
            raise ValueError("`axis` is missing: a rotation in 3-D needs (3,) numbers.")
        return jnp.array([0.0, 0.0, 1.0], like.dtype)
    if is_flat:
        raise ValueError("`axis` is for positions in 3-D; leave it out in 2-D.")
    return direction("axis", values, like)


def piecewise(t: Column, breaks: Any, coefficients: Sequence[Any]) -> ShapeWeights:
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


def clamp(values: Float[Array, "*shape"], low: Any, high: Any) -> Float[Array, "*shape"]:
    """Clips values to an interval, ends inside, where `jnp.clip` halves the derivative."""
    beyond = slack(values.dtype) * (high - low)
    return jnp.where(values < low - beyond, low, jnp.where(values > high + beyond, high, values))
