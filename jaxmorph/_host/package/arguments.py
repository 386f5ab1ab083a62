"""Checks of arguments by their annotations, ranges and shapes: a `ValueError` of one sentence."""

import functools
import inspect
import itertools
import numbers
import os
import reprlib
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy import ndarray

from .annotations import array_of, has_type, is_real, is_whole, rule_of

Function = TypeVar("Function", bound=Callable)


def checked(function: Function) -> Function:
    """Makes a function compare its arguments with its annotations at every call.

    It then raises `ValueError` for a wrong argument, with its name, its value and the call to make.
    Arrays of jaxtyping are compared by the kind of their numbers, not by their shape. Numbers of
    another machine's byte order are turned: JAX reads them as they lie.
    """
    parameters = inspect.signature(function).parameters
    placed = [name for name, each in parameters.items() if each.kind is not each.KEYWORD_ONLY]
    rest = [name for name, each in parameters.items() if each.kind is each.VAR_POSITIONAL]

    @functools.wraps(function)
    def call(*arguments, **keywords):
        arguments = [native_order(value) for value in arguments]
        keywords = {name: native_order(value) for name, value in keywords.items()}
        names = itertools.chain(placed, itertools.cycle(rest))
        for name, value in (*zip(names, arguments, strict=False), *keywords.items()):
            if name in parameters:
                check_value(name, value, parameters[name].annotation, call)
        return function(*arguments, **keywords)

    return call  # pyright: ignore[reportReturnType]


def native_order(value: Any) -> Any:
    """NumPy's arrays in this machine's byte order, and in float64 if they are longer."""
    if not isinstance(value, ndarray) or (value.dtype.isnative and value.dtype != np.longdouble):
        return value
    return value.astype(float if value.dtype == np.longdouble else value.dtype.newbyteorder("="))


def freeze(array: Any) -> Any:
    """Returns a read-only array: itself if nobody can write into it, else a copy; others as is."""
    base = array
    while isinstance(base, ndarray):
        if base.flags.writeable:
            array = array.copy()
            array.flags.writeable = False
            return array
        base = base.base
    return array


def check_fields(instance: Any) -> None:
    for name, field in instance.__dataclass_fields__.items():
        if field.init:
            check_value(name, getattr(instance, name), field.type, type(instance))


def check_value(name: str, value: Any, annotation: Any, callee: Callable) -> None:
    rule = rule_of(annotation)
    if rule.fits(value):
        return
    places = [
        each.name
        for each in inspect.signature(callee).parameters.values()
        if each.kind is not each.KEYWORD_ONLY and each.name != "self"
    ]
    example = f"{callee.__qualname__.removesuffix('.__init__')}({', '.join(places)})"
    raise ValueError(f"`{name}` must be {rule.words}, not {shown(value)}. Call {example}.")


def shown(value: Any) -> str:
    if isinstance(value, type):
        return f"the class {value.__name__}"
    if np.ma.is_masked(value):
        return f"an array {value.shape} of which {np.ma.count_masked(value)} are masked"
    if has_type(value) and value.shape:
        return f"an array {tuple(value.shape)} of {value.dtype}"
    if has_type(value):
        return f"{value} ({value.dtype})"
    is_plain = value is None or isinstance(
        value, str | numbers.Number | list | tuple | dict | os.PathLike
    )
    return reprlib.repr(value) if is_plain else f"a {type(value).__name__}"


def whole(name: str, value: Any, least: int = 1) -> int:
    """Returns a whole number; raises `ValueError` for another value, or one below `least`."""
    if not is_whole(value) or value < least:
        raise ValueError(
            f"`{name}` must be a whole number of at least {least}, not {shown(value)}."
        )
    return int(value)


def between(
    name: str, value: Any, low: float | int = -np.inf, high: float | int = np.inf, ends: str = "()"
) -> None:
    """Raises `ValueError` unless a value is a real number in an interval, `ends` such as `"[)"`."""
    allowed = [end for end, sign in zip((low, high), ends, strict=True) if sign in "[]"]
    if is_real(value) and (low < value < high or value in allowed):
        return
    least = f"of {low:g} or more and" if low in allowed else f"above {low:g} and"
    most = f"up to {high:g}" if high in allowed else f"below {high:g}"
    words = f"{least if low > -np.inf else 'that is'} {most if high < np.inf else 'finite'}"
    raise ValueError(f"`{name}` must be a real number {words}, not {shown(value)}.")


def as_array(name: str, values: Any) -> ndarray:
    try:
        return np.asarray(values)
    except ValueError:
        raise ValueError(
            f"`{name}` has rows of several lengths; expected an array, not {shown(values)}."
        ) from None


def rows_of(name: str, ids: Any, count: int) -> ndarray:
    """Returns ids (k,), such as a caller's list of nodes. Raises `ValueError` for what is no list
    of whole numbers, with a hint for a mask, and for ids that are not in 0 to `count` - 1.
    """
    array = np.asarray(array_of(ids))
    if array.size == 0:
        return np.zeros(0, dtype=np.int64)
    if array.dtype.kind not in "iu" or array.ndim != 1:
        hint = f"; for a mask use np.flatnonzero({name})" if array.dtype == bool else ""
        raise ValueError(f"`{name}` must be a list of ids, not {shown(ids)}{hint}.")
    wrong = (array < 0) | (array >= count)
    if wrong.any():
        raise ValueError(
            f"{wrong.sum()} ids in `{name}` are not in 0 to {count - 1}, first {array[wrong][0]}."
        )
    return array.astype(np.int64)


def check_patch(name: str, patch: Any) -> None:
    names = patch if isinstance(patch, list | tuple) else [patch]
    if not all(isinstance(entry, str) for entry in names):
        rows_of(name, patch, 2**62)


def real_array(name: str, values: Any, *shapes: tuple[int | None, ...]) -> ndarray:
    """Returns floats, in their precision, of one of the shapes, in which None is any length. Raises
    `ValueError` for other shapes, and for what are no real numbers.
    """
    try:
        array = native_order(np.asarray(array_of(values)))
    except TypeError as error:
        if not type(error).__name__.startswith("Tracer"):  # JAX's, which is not imported here
            raise
        raise ValueError(
            f"`{name}` is traced, inside of jit, grad or vmap, but its numbers are needed on the "
            "host: make this call outside."
        ) from error
    words = " or ".join(str(shape).replace("None", "any") for shape in shapes)
    if array.dtype.kind not in "fiu":
        raise ValueError(f"`{name}` must be an array of real numbers {words}, not {shown(values)}.")
    lengths = [zip(shape, array.shape, strict=True) for shape in shapes if len(shape) == array.ndim]
    if not any(all(n in (None, m) for n, m in pairs) for pairs in lengths):
        raise ValueError(f"`{name}` has shape {array.shape}; expected {words}.")
    return array if array.dtype.kind == "f" else array.astype(float)


def finite_array(name: str, values: Any, *shapes: tuple[int | None, ...]) -> ndarray:
    """Returns what `real_array` does; raises `ValueError` also for numbers that are not finite."""
    array = real_array(name, values, *shapes)
    if not np.isfinite(array).all():
        raise ValueError(
            f"{(~np.isfinite(array)).sum()} of {array.size} numbers of `{name}` are not finite."
        )
    return array
