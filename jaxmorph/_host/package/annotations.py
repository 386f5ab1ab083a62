"""Annotations: the values that fit them, and their description in words."""

import collections.abc
import functools
import inspect
import os
import types
import typing
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

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
