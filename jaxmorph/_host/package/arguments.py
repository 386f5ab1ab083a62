"""Checks of arguments: by their annotations, and by ranges and shapes that no annotation says.

A wrong argument raises `ValueError` with one sentence.
"""

import collections.abc
import functools
import inspect
import itertools
import numbers
import os
import reprlib
import types
import typing
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

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


WORDS = {
    bool: "True or False",
    int: "a whole number",
    float: "a real number",
    np.number: "a real number",
    np.integer: "a whole number",
    str: "a word",
    os.PathLike: "a path",
    types.NoneType: "None",
    type: "a class",
}
KINDS = {"Float": "fiuV", "Real": "fiuV", "Int": "iu", "Integer": "iu", "Bool": "b", "Shaped": "fiubcV"}
"""NumPy's letters for the numbers of an annotated array.

Whole numbers count as real numbers. V is bfloat16 and similar types.
"""


def says(annotation: Any) -> bool:
    """Checks whether an annotation restricts a value.

    Annotations of trees, and names of classes that are defined later, do not.
    """
    is_silent = annotation in (Any, inspect.Parameter.empty, object) or isinstance(annotation, str | typing.TypeVar)
    return not is_silent and getattr(annotation, "__name__", "") != "PyTree"


@functools.cache
def _members(annotation: Any) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """Lists the members of a union: array types first, then all other types."""
    is_union = typing.get_origin(annotation) in (typing.Union, types.UnionType)
    members = typing.get_args(annotation) if is_union else (annotation,)
    return tuple(filter(_is_array, members)), tuple(member for member in members if not _is_array(member))


def _is_array(annotation: Any) -> bool:
    return hasattr(annotation, "dim_str") and hasattr(annotation, "array_type")


def fits(value: Any, annotation: Any) -> bool:
    arrays, others = _members(annotation)
    if arrays and has_type(value):
        return _fits_array(value, arrays[0])
    if arrays and isinstance(value, list | tuple) and _fits_array(value, arrays[0]):
        return True
    return any(_fits_one(value, member, bool(arrays)) for member in others)


def _fits_array(value: Any, annotation: Any) -> bool:
    """Checks whether a value is an unmasked array of the annotated numbers, of any shape."""
    try:
        array = value if has_type(value) else np.asarray(value)
    except ValueError:
        return False  # rows of several lengths
    except TypeError:
        return _holds_traced(value)  # JAX stacks them
    kind = np.dtype(array.dtype).kind if not hasattr(array.dtype, "kind") else array.dtype.kind
    is_empty = not has_type(value) and array.size == 0
    return (is_empty or kind in KINDS.get(_kind_of(annotation), kind)) and not np.ma.is_masked(array)


def _holds_traced(value: Any) -> bool:
    """Checks whether nested lists hold a number that JAX traces."""
    return any(map(_holds_traced, value)) if isinstance(value, list | tuple) else hasattr(value, "aval")


def has_type(value: Any) -> bool:
    return hasattr(value, "dtype") and not isinstance(value, type)


def _fits_one(value: Any, annotation: Any, beside_array: bool) -> bool:
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if not says(annotation):
        return True
    if annotation is None or annotation is types.NoneType:
        return value is None
    if annotation in (float, np.number):
        kind = value.dtype.kind if has_type(value) else "f"
        is_one = isinstance(value, int | float) or (has_type(value) and value.shape == ())
        is_nan = isinstance(value, float | np.floating) and value != value
        return is_one and kind in "fiuV" and not isinstance(value, bool) and not is_nan
    if annotation in (int, np.integer):
        return isinstance(value, int | np.integer) and not isinstance(value, bool)
    if annotation is bool:
        return isinstance(value, bool | np.bool_)
    if origin is type:
        return isinstance(value, type)
    if origin is tuple:
        is_tuple = isinstance(value, tuple | list) or (has_type(value) and len(value.shape) == 1)
        of_members = _of_members(arguments, len(value)) if is_tuple else ()
        return is_tuple and len(value) == len(of_members) and all(map(fits, value, of_members))
    if collections.abc.Callable in (origin, annotation):
        return callable(value) and not isinstance(value, type)
    if origin in (collections.abc.Sequence, list):
        if beside_array and arguments in ((Any,), (int,), (list[float],)):
            return False  # a list is an array of numbers there
        is_list = isinstance(value, list | tuple | range | set | frozenset) or (has_type(value) and value.shape != ())
        return is_list and all(fits(member, arguments[0]) for member in value)
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return isinstance(value, Mapping) and all(fits(member, arguments[1]) for member in value.values())
    cls = origin or annotation
    return not isinstance(cls, type) or isinstance(value, cls)


def _of_members(arguments: tuple[Any, ...], count: int) -> tuple[Any, ...]:
    """Lists the annotations of a tuple's members; `tuple[int, ...]` has any number of them."""
    return arguments[:1] * count if arguments[1:] == (...,) else arguments


def words_of(annotation: Any) -> str:
    """Describes the values that fit an annotation."""
    arrays, others = _members(annotation)
    others = [other for other in others if not (arrays and typing.get_origin(other) is collections.abc.Sequence)]
    words = dict.fromkeys(map(_word, (*arrays[:1], *others)))
    if WORDS[float] in words:
        words.pop(WORDS[int], None)
    return " or ".join(words)


def _word(annotation: Any) -> str:
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if _is_array(annotation):
        letter = KINDS.get(_kind_of(annotation), "f")[0]
        what = {"i": "whole numbers", "b": "True and False"}.get(letter, "real numbers")
        dims = annotation.dim_str.replace("...", "any").split()
        shape = f" ({', '.join(dims)}{',' * (len(dims) == 1)})" if dims and "any" not in dims else ""
        return f"an array of {what}{shape}"
    if origin is collections.abc.Callable:
        return "a function"
    if origin is collections.abc.Sequence:
        return "a list" if arguments == (Any,) else f"a list, each {words_of(arguments[0])}"
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return "a dict" if not says(arguments[1]) else f"a dict, each value {words_of(arguments[1])}"
    if origin is tuple and arguments[1:] == (...,):
        return f"a tuple, each {words_of(arguments[0])}"
    if origin is tuple:
        return f"({', '.join(map(words_of, arguments))})"
    cls = origin or annotation
    return WORDS.get(cls, f"a {getattr(cls, '__name__', cls)}")


def _kind_of(annotation: Any) -> str:
    return annotation.__name__.partition("[")[0]


def example_call(callee: Callable) -> str:
    """Writes an example call, with the names of the positional arguments."""
    parameters = inspect.signature(callee).parameters.values()
    words = [
        parameter.name
        for parameter in parameters
        if parameter.name not in ("self", "cls") and parameter.kind is not parameter.KEYWORD_ONLY
    ]
    return f"{callee.__qualname__.removesuffix('.__init__')}({', '.join(words)})"
