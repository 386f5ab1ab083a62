"""Adds the signatures of classes that equinox makes: griffe reads the source and knows only the standard library's dataclasses."""

import griffe

UNSHOWN = {"Plan"}
"""Classes that a function of the library makes; users never write their fields."""


class Fields(griffe.Extension):
    """Adds an `__init__` to each subclass of `equinox.Module` that has fields, as equinox would write it."""

    def on_class(self, *, cls: griffe.Class, **_) -> None:
        bases = {str(base).split(".")[-1] for base in cls.bases}
        if (
            cls.name in UNSHOWN
            or "__init__" in cls.members
            or not (bases & {"Module"} or _abstract(bases))
        ):
            return
        fields = [
            member
            for member in cls.members.values()
            if isinstance(member, griffe.Attribute) and _is_field(member)
        ]
        if fields:
            parameters = [_parameter(field) for field in fields]
            cls.set_member(
                "__init__", griffe.Function("__init__", parameters=griffe.Parameters(*parameters))
            )


def _abstract(bases: set[str]) -> bool:
    return any(base.startswith("Abstract") for base in bases)


def _is_field(attribute: griffe.Attribute) -> bool:
    return "instance-attribute" in attribute.labels and attribute.annotation is not None


def _parameter(attribute: griffe.Attribute) -> griffe.Parameter:
    kind = griffe.ParameterKind.positional_or_keyword
    return griffe.Parameter(
        attribute.name,
        annotation=attribute.annotation,
        kind=kind,
        default=_default(attribute.value),
    )


def _default(value: griffe.Expr | str | None) -> griffe.Expr | str | None:
    """Returns the default that `eqx.field` is given, or the value itself."""
    if not isinstance(value, griffe.ExprCall) or str(value.function) != "eqx.field":
        return value
    given = {
        argument.name: argument.value
        for argument in value.arguments
        if isinstance(argument, griffe.ExprKeyword)
    }
    if "default_factory" in given:
        return f"{given['default_factory']}()"
    return given.get("default")
