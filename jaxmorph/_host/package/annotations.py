"""Rules of annotations: which values fit, and the words for them in a message."""

import functools
import os
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

NOTHING = np.zeros((), object)  # placeholder for a value that is no array


class Rule(NamedTuple):
    words: str
    fits: Callable[[Any], bool]


def has_type(value: Any) -> bool:
    return hasattr(value, "dtype") and not isinstance(value, type)


def array_of(values: Any) -> Any:
    """An array or a list as an array; `NOTHING` for other values, masks, rows of many lengths."""
    if np.ma.is_masked(values) or not (
        isinstance(values, list | tuple | range) or has_type(values)
    ):
        return NOTHING
    try:
        return values if has_type(values) else np.asarray(values)
    except ValueError:
        return NOTHING


def is_real(value: Any) -> bool:
    if isinstance(value, bool) or (isinstance(value, float | np.floating) and value != value):
        return False
    if isinstance(value, int | float):
        return True
    return has_type(value) and value.shape == () and value.dtype.kind in "fiuV"


def is_whole(value: Any) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


REAL = Rule("a real number", is_real)
SINGLE = {
    bool: Rule("True or False", lambda value: isinstance(value, bool | np.bool_)),
    int: Rule("a whole number", is_whole),
    float: REAL,
    np.number: REAL,
    Callable: Rule("a function", lambda value: callable(value) and not isinstance(value, type)),
    str: Rule("a word", lambda value: isinstance(value, str)),
    os.PathLike: Rule("a path", lambda value: isinstance(value, os.PathLike)),
    types.NoneType: Rule("None", lambda value: value is None),
    type: Rule("a class", lambda value: isinstance(value, type)),
}
COLLECTIONS = {
    tuple: ("a tuple", (tuple, list)),
    Sequence: ("a list", (list, tuple, range, set, frozenset)),
    Mapping: ("a dict", (Mapping,)),
}
"""What a collection is called, and the classes that are taken; arrays are lists and tuples too."""
ARRAY_KINDS = {
    "Float": ("real numbers", "fiuV"),
    "Real": ("real numbers", "fiuV"),
    "Shaped": ("real numbers", "fiubcV"),
    "Int": ("whole numbers", "iu"),
    "Integer": ("whole numbers", "iu"),
    "Bool": ("True and False", "b"),
}
"""What an annotated array holds, and NumPy's letters for it. V is bfloat16 and similar types."""
SILENT = ("Any", "PyTree", "_empty", "object")  # classes that restrict nothing
PLAIN_MEMBERS = ((Any,), (int,))  # members of lists that are arrays where an array may stand


@functools.cache
def rule_of(annotation: Any) -> Rule:
    members = typing.get_args(annotation)
    cls = typing.get_origin(annotation) or annotation
    if cls in (typing.Union, types.UnionType):
        return _of_union(members)
    if hasattr(annotation, "dim_str"):
        return _of_array(annotation)
    if cls in SINGLE:
        return SINGLE[cls]
    if not isinstance(cls, type) or cls.__name__ in SILENT:
        return Rule("", lambda value: True)
    for kind in COLLECTIONS if members else ():
        if issubclass(cls, kind):
            return _of_members(kind, members)
    return Rule(f"a {cls.__name__}", lambda value: isinstance(value, cls))


def _of_union(members: Sequence[Any]) -> Rule:
    is_array = {member: hasattr(member, "dim_str") for member in members}
    arrays = [rule_of(member) for member in members if is_array[member]]
    rules = arrays + [
        rule_of(member)
        for member in members
        if not (is_array[member] or (member is int and float in members))
        and not (arrays and typing.get_args(member) in PLAIN_MEMBERS)
    ]

    def fits(value: Any) -> bool:
        return any(rule.fits(value) for rule in (arrays if has_type(value) else ()) or rules)

    return Rule(" or ".join(dict.fromkeys(rule.words for rule in rules)), fits)


def _of_array(annotation: Any) -> Rule:
    numbers, letters = ARRAY_KINDS[annotation.__name__.partition("[")[0]]
    dims = annotation.dim_str.split()
    shape = f" ({', '.join(dims)}{',' * (len(dims) == 1)})" if dims and "..." not in dims else ""

    def fits(value: Any) -> bool:
        try:
            array = array_of(value)
        except TypeError:
            return True  # a list of traced numbers, which JAX stacks
        is_empty = array is not value and array.size == 0
        return is_empty or getattr(array.dtype, "kind", "") in letters

    return Rule(f"an array of {numbers}{shape}", fits)


def _of_members(kind: type, members: Sequence[Any]) -> Rule:
    """Of a tuple of as many members; else of any number of one member, of a dict its values."""
    words, classes = COLLECTIONS[kind]
    rules = [rule_of(member) for member in members if member is not ...]
    is_row = kind is tuple and ... not in members

    def fits(value: Any) -> bool:
        is_array = kind is not Mapping and has_type(value) and len(value.shape) > 0
        if not (is_array or isinstance(value, classes)):
            return False
        entries = list(value.values() if kind is Mapping else value)
        own = rules if is_row else rules[-1:] * len(entries)
        return len(own) == len(entries) and all(
            rule.fits(entry) for rule, entry in zip(own, entries, strict=True)
        )

    if is_row:
        return Rule(f"({', '.join(rule.words for rule in rules)})", fits)
    entry = "each value" if kind is Mapping else "each"
    return Rule(f"{words}, {entry} {rules[-1].words}" if rules[-1].words else words, fits)
