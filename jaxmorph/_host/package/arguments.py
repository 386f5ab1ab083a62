"""Checks of arguments: by their annotations, and by ranges and shapes that no annotation says.

A wrong argument raises `ValueError` with one sentence.
"""

import functools
import inspect
import itertools
import numbers
import os
import reprlib
import typing
from collections.abc import Callable
from typing import Any

import numpy as np

from .annotations import example_call, fits, has_type, says, words_of

Function = typing.TypeVar("Function", bound=Callable)


def checked(function: Function) -> Function:
    """Makes a function compare its arguments with its annotations at every call.

    The function then raises `ValueError` for a wrong argument, with its name, its value and the
    call to make. Numbers of another machine's byte order are turned: JAX reads them as they lie.
    """
    parameters = inspect.signature(function).parameters
    rules = {name: parameter.annotation for name, parameter in parameters.items() if says(parameter.annotation)}
    rest = [name for name, parameter in parameters.items() if parameter.kind is parameter.VAR_POSITIONAL]

    @functools.wraps(function)
    def call(*arguments, **keywords):
        arguments = tuple(map(native, arguments))
        keywords = {name: native(value) for name, value in keywords.items()}
        names = itertools.chain(parameters, itertools.cycle(rest))
        for name, value in itertools.chain(zip(names, arguments, strict=False), keywords.items()):
            if name in rules:
                check(name, value, rules[name], call)
        return function(*arguments, **keywords)

    return call  # pyright: ignore[reportReturnType]


def native(value: Any) -> Any:
    """Returns NumPy's arrays in this machine's byte order, and in float64 if they are longer."""
    if not isinstance(value, np.ndarray) or (value.dtype.isnative and value.dtype != np.longdouble):
        return value
    return value.astype(float if value.dtype == np.longdouble else value.dtype.newbyteorder("="))


def check_fields(instance: Any) -> None:
    """Compares a dataclass's fields with their annotations, as `checked` compares arguments."""
    for name, annotation in _rules(type(instance)).items():
        check(name, getattr(instance, name), annotation, type(instance))


@functools.cache
def _rules(cls: type) -> dict[str, Any]:
    fields = cls.__dataclass_fields__  # pyright: ignore[reportAttributeAccessIssue]
    return {name: field.type for name, field in fields.items() if field.init and says(field.type)}


def check(name: str, value: Any, annotation: Any, callee: Callable) -> None:
    """Raises `ValueError` for a value that does not fit its annotation."""
    if not fits(value, annotation):
        raise ValueError(f"`{name}` must be {words_of(annotation)}, not {shown(value)}. Call {example_call(callee)}.")


def shown(value: Any) -> str:
    """Describes a value for a message: a class by its name, an array by its shape and type."""
    if isinstance(value, type):
        return f"the class {value.__name__}"
    if np.ma.is_masked(value):
        return f"an array {value.shape} of which {np.ma.count_masked(value)} are masked"
    if has_type(value):
        return f"an array {tuple(value.shape)} of {value.dtype}" if value.shape else f"{value} ({value.dtype})"
    is_plain = value is None or isinstance(value, str | numbers.Number | list | tuple | dict | os.PathLike)
    return reprlib.repr(value) if is_plain else f"a {type(value).__name__}"


def whole(name: str, value: Any, least: int = 1) -> int:
    """Returns a whole number of at least `least`. Raises `ValueError` for other values."""
    if not fits(value, int) or value < least:
        raise ValueError(f"`{name}` must be a whole number of at least {least}, not {shown(value)}.")
    return int(value)


def between(name: str, value: Any, low: float | int = -np.inf, high: float | int = np.inf, ends: str = "()") -> None:
    """Raises `ValueError` unless a value is a real number in an interval, `ends` such as `"[)"`."""
    above = fits(value, float) and (value > low or (ends[0] == "[" and value == low))
    if not (above and (value < high or (ends[1] == "]" and value == high))):
        raise ValueError(f"`{name}` must be a real number{_range(low, high, ends)}, not {shown(value)}.")


def _range(low: float | int, high: float | int, ends: str) -> str:
    lower = "" if low == -np.inf else f"of {low:g} or more" if ends[0] == "[" else f"above {low:g}"
    upper = "finite" if high == np.inf else f"{'up to' if ends[1] == ']' else 'below'} {high:g}"
    words = [word for word in (lower, upper) if word and not (word == "finite" and ends[1] == "]")]
    return (" that is " if words == ["finite"] else " ") + " and ".join(words) if words else ""


def as_array(name: str, values: Any) -> np.ndarray:
    """Makes an array of values. Raises `ValueError` for rows of several lengths."""
    try:
        return np.asarray(values)
    except ValueError:
        raise ValueError(f"`{name}` has rows of several lengths; expected an array, not {shown(values)}.") from None


def rows_of(name: str, ids: Any, count: int) -> np.ndarray:
    """Returns ids. Raises `ValueError` unless they are whole numbers from 0 to `count` - 1."""
    array = as_array(name, ids) if isinstance(ids, list | tuple | range) or has_type(ids) else None
    if array is not None and array.size == 0:
        return np.zeros(0, dtype=np.int64)
    if array is None or array.dtype.kind not in "iu" or array.ndim != 1:
        hint = f"; for a mask use np.flatnonzero({name})" if array is not None and array.dtype == bool else ""
        raise ValueError(f"`{name}` must be a list of ids, not {shown(ids)}{hint}.")
    wrong = (array < 0) | (array >= count)
    if wrong.any():
        raise ValueError(f"{wrong.sum()} ids in `{name}` are not in 0 to {count - 1}, first {array[wrong][0]}.")
    return array.astype(np.int64)


def check_patch(name: str, patch: Any) -> None:
    """Raises `ValueError` unless a value is a patch name, several names, or node ids."""
    names = patch if isinstance(patch, list | tuple) else [patch]
    if not all(isinstance(entry, str) for entry in names):
        rows_of(name, patch, 2**62)


def real_array(name: str, values: Any, *shapes: tuple[int | None, ...]) -> np.ndarray:
    """Returns floats, in their precision, of one of the shapes, in which None is any length."""
    is_array = isinstance(values, list | tuple) or has_type(values)
    try:
        array = np.asarray(values) if is_array and not np.ma.is_masked(values) else None
    except ValueError:
        array = None  # rows of several lengths
    words = " or ".join(
        f"({', '.join('any' if n is None else str(n) for n in shape)}{',' * (len(shape) == 1)})" for shape in shapes
    )
    if array is None or array.dtype.kind not in "fiu":
        raise ValueError(f"`{name}` must be an array of real numbers {words}, not {shown(values)}.")
    if not any(
        len(shape) == array.ndim and all(n in (None, m) for n, m in zip(shape, array.shape, strict=True))
        for shape in shapes
    ):
        raise ValueError(f"`{name}` has shape {array.shape}; expected {words}.")
    return array if array.dtype.kind == "f" else array.astype(float)


def finite_array(name: str, values: Any, *shapes: tuple[int | None, ...]) -> np.ndarray:
    """Returns a `real_array`. Raises `ValueError` for numbers that are not finite."""
    array = real_array(name, values, *shapes)
    if not np.isfinite(array).all():
        raise ValueError(f"{(~np.isfinite(array)).sum()} of {array.size} numbers of `{name}` are not finite.")
    return array
