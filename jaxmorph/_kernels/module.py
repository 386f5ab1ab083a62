"""The base of public classes: modules that `jax.jit` accepts."""

import dataclasses
from typing import Any

import equinox as eqx


class Module(eqx.Module):
    """An Equinox module with a hash, also with arrays, by which `jax.jit` looks functions up. A
    module with arrays is equal only to itself; a module without is compared by its fields.
    `equinox.tree_equal` compares arrays.
    """

    def __hash__(self) -> int:
        try:
            return hash((type(self), *_field_values(self)))
        except TypeError:
            return object.__hash__(self)

    def __eq__(self, other: object) -> bool:
        return self is other or (
            type(self) is type(other)
            and _has_value(self, other)
            and _field_values(self) == _field_values(other)
        )


def _field_values(module: Any) -> tuple[Any, ...]:
    return tuple(getattr(module, field.name) for field in dataclasses.fields(module))


def _has_value(*modules: Any) -> bool:
    try:
        return isinstance(hash(tuple(map(_field_values, modules))), int)
    except TypeError:
        return False
