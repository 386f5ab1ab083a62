"""The classes that a file may name: this package's own classes, and classes that a caller adds."""

import dataclasses
import enum
import sys
from collections.abc import Iterator, Sequence

import equinox as eqx

from .._host.sources.reduction import AbstractReduction, AbstractSearchPoints

ROOTS = (eqx.Module, AbstractReduction, AbstractSearchPoints)
"""Base classes of all parts of a plan."""


def known_classes(added: Sequence[type] = ()) -> dict[str, type]:
    """Lists by name the classes that a plan's file may name: the package's own classes and `added`.

    The package's own classes are subclasses of `ROOTS` in the loaded modules. Raises `ValueError`
    for an added class that is no dataclass or enum, or has the name of another class.
    """
    package = __name__.partition(".")[0]
    classes: dict[str, type] = {}
    for root in ROOTS:
        for kind in _below(root):
            is_own = kind.__module__.partition(".")[0] == package
            if is_own and getattr(sys.modules.get(kind.__module__), kind.__name__, None) is kind:
                classes[kind.__name__] = kind
    for kind in added:
        if not isinstance(kind, type) or not (dataclasses.is_dataclass(kind) or issubclass(kind, enum.Enum)):
            raise ValueError(f"`classes` are dataclasses (equinox modules among them) and enums; {kind!r} is neither.")
        if classes.get(kind.__name__, kind) is not kind:
            raise ValueError(f"two classes are called {kind.__name__}: {classes[kind.__name__]!r} and {kind!r}.")
        classes[kind.__name__] = kind
    return classes


def _below(kind: type) -> Iterator[type]:
    for subclass in kind.__subclasses__():
        yield subclass
        yield from _below(subclass)
