"""Signatures of classes that equinox makes: griffe reads the source and knows only the standard library's dataclasses."""

import griffe

UNSHOWN = {"Plan"}
"""Made by a function of the library; its fields are nobody's business."""


class Fields(griffe.Extension):
    """An `__init__` for each subclass of `equinox.Module` that has fields, as equinox would write it."""

    def on_class(self, *, cls: griffe.Class, **_) -> None:
        bases = {str(base).split(".")[-1] for base in cls.bases}
        if cls.name in UNSHOWN or "__init__" in cls.members or not (bases & {"Module"} or _abstract(bases)):
            return
        fields = [one for one in cls.members.values() if isinstance(one, griffe.Attribute) and _is_field(one)]
        if fields:
            parameters = [_parameter(one) for one in fields]
            cls.set_member("__init__", griffe.Function("__init__", parameters=griffe.Parameters(*parameters)))


def _abstract(bases: set[str]) -> bool:
    return any(base.startswith("Abstract") for base in bases)


def _is_field(attribute: griffe.Attribute) -> bool:
    return "instance-attribute" in attribute.labels and attribute.annotation is not None


def _parameter(attribute: griffe.Attribute) -> griffe.Parameter:
    kind = griffe.ParameterKind.positional_or_keyword
    return griffe.Parameter(
        attribute.name, annotation=attribute.annotation, kind=kind, default=_default(attribute.value)
    )


def _default(value: griffe.Expr | str | None) -> griffe.Expr | str | None:
    """What `eqx.field` is told, or the value itself."""
    if not isinstance(value, griffe.ExprCall) or str(value.function) != "eqx.field":
        return value
    told = {argument.name: argument.value for argument in value.arguments if isinstance(argument, griffe.ExprKeyword)}
    if "default_factory" in told:
        return f"{told['default_factory']}()"
    return told.get("default")
