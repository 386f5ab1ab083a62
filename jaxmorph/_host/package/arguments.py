"""Checks of arguments by their annotations, ranges and shapes: a `ValueError` of one sentence."""

import contextlib
import functools
import inspect
import itertools
import numbers
import os
import reprlib
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

NOTHING = np.zeros((), object)  # placeholder for a value that is no array

Function = typing.TypeVar("Function", bound=Callable)


def checked(function: Function) -> Function:
    """Makes a function compare its arguments with its annotations at every call.

    It then raises `ValueError` for a wrong argument, with its name, its value and the call to make.
    Arrays of jaxtyping are compared by the kind of their numbers, not by their shape. Numbers of
    another machine's byte order are turned: JAX reads them as they lie.
    """
    parameters = inspect.signature(function).parameters
    rest = [
        name for name, parameter in parameters.items() if parameter.kind is parameter.VAR_POSITIONAL
    ]

    @functools.wraps(function)
    def call(*arguments, **keywords):
        arguments = tuple(map(native, arguments))
        keywords = {name: native(value) for name, value in keywords.items()}
        names = itertools.chain(parameters, itertools.cycle(rest))
        for name, value in (*zip(names, arguments, strict=False), *keywords.items()):
            if name in parameters:
                check(name, value, parameters[name].annotation, call)
        return function(*arguments, **keywords)

    return call  # pyright: ignore[reportReturnType]


def native(value: Any) -> Any:
    """NumPy's arrays in this machine's byte order, and in float64 if they are longer."""
    if not isinstance(value, np.ndarray) or (value.dtype.isnative and value.dtype != np.longdouble):
        return value
    return value.astype(float if value.dtype == np.longdouble else value.dtype.newbyteorder("="))


def freeze(array: Any) -> Any:
    """Returns a read-only array: itself if nobody can write into it, else a copy; others as is."""
    base = array
    while isinstance(base, np.ndarray):
        if base.flags.writeable:
            array = array.copy()
            array.flags.writeable = False
            return array
        base = base.base
    return array


def check_fields(instance: Any) -> None:
    for name, field in instance.__dataclass_fields__.items():
        if field.init:
            check(name, getattr(instance, name), field.type, type(instance))


def check(name: str, value: Any, annotation: Any, callee: Callable) -> None:
    rule = _rule(annotation)
    if not rule.fits(value):
        parameters = inspect.signature(callee).parameters.values()
        places = [
            each.name
            for each in parameters
            if each.kind is not each.KEYWORD_ONLY and each.name != "self"
        ]
        example = f"{callee.__qualname__.removesuffix('.__init__')}({', '.join(places)})"
        raise ValueError(f"`{name}` must be {rule.words}, not {shown(value)}. Call {example}.")


def shown(value: Any) -> str:
    if isinstance(value, type):
        return f"the class {value.__name__}"
    if np.ma.is_masked(value):
        return f"an array {value.shape} of which {np.ma.count_masked(value)} are masked"
    if has_type(value):
        return (
            f"an array {tuple(value.shape)} of {value.dtype}"
            if value.shape
            else f"{value} ({value.dtype})"
        )
    is_plain = value is None or isinstance(
        value, str | numbers.Number | list | tuple | dict | os.PathLike
    )
    return reprlib.repr(value) if is_plain else f"a {type(value).__name__}"


def whole(name: str, value: Any, least: int = 1) -> int:
    """Returns a whole number; raises `ValueError` for another value, or one below `least`."""
    if not _is_whole(value) or value < least:
        raise ValueError(
            f"`{name}` must be a whole number of at least {least}, not {shown(value)}."
        )
    return int(value)


def between(
    name: str, value: Any, low: float | int = -np.inf, high: float | int = np.inf, ends: str = "()"
) -> None:
    """Raises `ValueError` unless a value is a real number in an interval, `ends` such as `"[)"`."""
    allowed = [end for end, sign in zip((low, high), ends, strict=True) if sign in "[]"]
    if _is_real(value) and (low < value < high or value in allowed):
        return
    least = (
        {"[": f"of {low:g} or more and", "(": f"above {low:g} and"}[ends[0]]
        if low > -np.inf
        else "that is"
    )
    most = {"]": f"up to {high:g}", ")": f"below {high:g}"}[ends[1]] if high < np.inf else "finite"
    raise ValueError(f"`{name}` must be a real number {least} {most}, not {shown(value)}.")


def as_array(name: str, values: Any) -> np.ndarray:
    try:
        return np.asarray(values)
    except ValueError:
        raise ValueError(
            f"`{name}` has rows of several lengths; expected an array, not {shown(values)}."
        ) from None


def rows_of(name: str, ids: Any, count: int) -> np.ndarray:
    """Returns ids (k,), such as a caller's list of nodes. Raises `ValueError` for what is no list
    of whole numbers, with a hint for a mask, and for ids that are not in 0 to `count` - 1.
    """
    array = _array(ids)
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


def real_array(name: str, values: Any, *shapes: tuple[int | None, ...]) -> np.ndarray:
    """Returns floats, in their precision, of one of the shapes, in which None is any length. Raises
    `ValueError` for other shapes, and for what are no real numbers.
    """
    array = _array(values)
    words = " or ".join(str(shape).replace("None", "any") for shape in shapes)
    if array.dtype.kind not in "fiu":
        raise ValueError(f"`{name}` must be an array of real numbers {words}, not {shown(values)}.")
    fitting = [shape for shape in shapes if len(shape) == array.ndim]
    if not any(
        all(n in (None, m) for n, m in zip(shape, array.shape, strict=True)) for shape in fitting
    ):
        raise ValueError(f"`{name}` has shape {array.shape}; expected {words}.")
    return array if array.dtype.kind == "f" else array.astype(float)


def _array(values: Any) -> np.ndarray:
    """An array or a list as an array; `NOTHING` for other values, masks, rows of many lengths."""
    with contextlib.suppress(ValueError):
        if (isinstance(values, list | tuple | range) or has_type(values)) and not np.ma.is_masked(
            values
        ):
            return np.asarray(values)
    return NOTHING


def finite_array(name: str, values: Any, *shapes: tuple[int | None, ...]) -> np.ndarray:
    """Returns what `real_array` does; raises `ValueError` also for numbers that are not finite."""
    array = real_array(name, values, *shapes)
    if not np.isfinite(array).all():
        raise ValueError(
            f"{(~np.isfinite(array)).sum()} of {array.size} numbers of `{name}` are not finite."
        )
    return array


class Rule(NamedTuple):
    words: str
    fits: Callable[[Any], bool]


def has_type(value: Any) -> bool:
    return hasattr(value, "dtype") and not isinstance(value, type)


def _rank(value: Any) -> int:
    return len(value.shape) if has_type(value) else 0


def _is_real(value: Any) -> bool:
    if isinstance(value, bool) or (isinstance(value, float | np.floating) and value != value):
        return False
    is_number = isinstance(value, int | float)
    return is_number or (has_type(value) and value.shape == () and value.dtype.kind in "fiuV")


def _is_whole(value: Any) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


REAL = Rule("a real number", _is_real)
WHOLE = Rule("a whole number", _is_whole)
FUNCTION = Rule("a function", lambda value: callable(value) and not isinstance(value, type))
TRUTH = Rule("True or False", lambda value: isinstance(value, bool | np.bool_))
SIMPLE = {
    bool: TRUTH,
    int: WHOLE,
    np.integer: WHOLE,
    float: REAL,
    np.number: REAL,
    Callable: FUNCTION,
}

WORDS = {str: "a word", os.PathLike: "a path", types.NoneType: "None", type: "a class"}
"""What a value of a class is called, if not after the class."""

KINDS = {
    "Float": "fiuV",
    "Real": "fiuV",
    "Int": "iu",
    "Integer": "iu",
    "Bool": "b",
    "Shaped": "fiubcV",
}
"""NumPy's letters for the numbers of an annotated array. V is bfloat16 and similar types."""

MANY = {
    tuple: ("a tuple, each", lambda value: isinstance(value, tuple | list) or _rank(value) == 1),
    Sequence: (
        "a list, each",
        lambda value: isinstance(value, list | tuple | range | set | frozenset) or _rank(value) > 0,
    ),
    Mapping: ("a dict, each value", lambda value: isinstance(value, Mapping)),
}

SILENT = (
    "Any",
    "PyTree",
    "_empty",
    "object",
)  # restrict nothing, like names of classes that are defined later
LISTS_OF_NUMBERS = (
    (Any,),
    (int,),
    (list[float],),
)  # members of lists that are arrays where an array may stand


@functools.cache
def _rule(annotation: Any) -> Rule:
    members = typing.get_args(annotation)
    cls = typing.get_origin(annotation) or annotation
    if cls in (typing.Union, types.UnionType):
        return _of_union(members)
    if hasattr(annotation, "dim_str"):
        return _of_array(annotation)
    if cls in SIMPLE:
        return SIMPLE[cls]
    if not isinstance(cls, type) or cls.__name__ in SILENT:
        return Rule("", lambda value: True)
    for kind in MANY:
        if members and issubclass(cls, kind):
            return _of_members(kind, members)
    return Rule(WORDS.get(cls, f"a {cls.__name__}"), lambda value: isinstance(value, cls))


def _of_union(members: tuple[Any, ...]) -> Rule:
    arrays = [member for member in members if hasattr(member, "dim_str")]
    lists = LISTS_OF_NUMBERS if arrays else ()
    others = [
        member
        for member in members
        if member not in arrays and typing.get_args(member) not in lists
    ]
    rules = list(map(_rule, (*arrays[:1], *others)))
    words, _ = zip(*rules, strict=True)

    def fits(value):
        possible = rules[:1] if arrays and has_type(value) else rules
        return any(rule.fits(value) for rule in possible)

    return Rule(
        " or ".join(dict.fromkeys(words)).replace(f"{REAL.words} or {WHOLE.words}", REAL.words),
        fits,
    )


def _of_array(annotation: Any) -> Rule:
    kinds = KINDS.get(annotation.__name__.partition("[")[0], "f")
    what = {"i": "whole numbers", "b": "True and False"}.get(kinds[0], "real numbers")
    dims = annotation.dim_str.split()
    shape = (
        f" ({', '.join(dims)}{',' * (len(dims) == 1)})"
        if dims and "..." not in annotation.dim_str
        else ""
    )

    def fits(value):
        if has_type(value):
            return getattr(value.dtype, "kind", "") in kinds and not np.ma.is_masked(value)
        try:
            array = np.asarray(value) if isinstance(value, list | tuple) else NOTHING
        except ValueError:
            return False  # rows of several lengths
        except TypeError:
            return _holds_traced(value)  # JAX stacks them
        return array.size == 0 or array.dtype.kind in kinds

    return Rule(f"an array of {what}{shape}", fits)


def _holds_traced(value: Any) -> bool:
    return (
        any(map(_holds_traced, value))
        if isinstance(value, list | tuple)
        else hasattr(value, "aval")
    )


def _of_members(kind: type, members: tuple[Any, ...]) -> Rule:
    """Of a tuple of as many members; else of any number of one member, of a dict its values."""
    is_row, (words, is_kind) = kind is tuple and ... not in members, MANY[kind]
    rules = [_rule(member) for member in members if member is not ...]

    def fits(value):
        if not is_kind(value):
            return False
        entries = list(value.values() if kind is Mapping else value)
        return _fit(rules if is_row else rules[-1:] * len(entries), entries)

    if is_row:
        return Rule(f"({', '.join(rule.words for rule in rules)})", fits)
    return Rule(f"{words} {rules[-1].words}" if rules[-1].words else words.partition(",")[0], fits)


def _fit(rules: list[Rule], entries: list[Any]) -> bool:
    return len(rules) == len(entries) and all(
        rule.fits(entry) for rule, entry in zip(rules, entries, strict=True)
    )
