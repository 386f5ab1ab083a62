"""Nonsense for each argument of each public callable, and an answer that names it."""

import re
import warnings

import pytest
from nonsense import MODULES, arguments, callable_of, made, public

SAYS = {
    "before": "before|moving|no cells|nonsense|nowhere|surface",
    "by": "`by`|measure",
    "cells": "cells|cell type",
    "control": "control|parameters",
    "cell_data": "cell_data|array 'a'",
    "point_data": "point_data|array 'a'",
    "centres": "centres|bumps",
    "direction": "direction|lines miss",
    "dimensions": "dimensions|mesh in .-D",
    "fixed": "fixed|no patch",
    "fixed_leaves": "leaves",
    "frames": "frames|points",
    "gradient": "gradient|parameters",
    "keep": "keep|no patch",
    "kind": "kind|expected one of",
    "mesh": "mesh|nodes|points|no cells|cells|expected one row",
    "moving": "moving|no patch",
    "name": "name|measure",
    "nose": "nose|chord from",
    "tail": "tail|chord from|node",
    "around": "around|nodes on each side",
    "parameters": "parameters|control displacements",
    "patches": "patches|no patch",
    "reductions": "reductions|radial basis functions",
    "shapes": "shapes|one shape",
    "sliding": "sliding|no patch",
    "source": "source|--box",
    "surface": "surface|points",
    "step": "step|no model at x",
    "symmetry": "symmetry|no patch",
    "u": "`u`|displacements",
    "x0": "x0|parameters|no model at x",
    "file": "file|nonsense",
    "path": "path|nonsense|nowhere",
    "*": "",
}
"""What an answer says of an argument, where that is not only its name."""

CRYPTIC = re.compile(
    r"NoneType|has no attribute|truth value|jnp\.|broadcast|unsupported operand|zip\(\)|argm(in|ax)|empty sequence|concatenate|"
    r"inhomogeneous|could not convert|did not converge|out of bounds|dictionary update|a and b|not iterable|not callable"
)
"""Words of Python, NumPy and JAX, which speak of what happened inside and not of what was given."""


def faults(name):
    """Lists what is wrong with the answers to nonsense in place of each argument of one callable."""
    called, wrong = callable_of(name), []
    table = list(arguments(name))
    good = {key: made(value) for key, value, _ in table}
    good = {key: value for key, value in good.items() if value is not None and key != "*"}
    for key, _, cases in table:
        for kind, value in cases.items():
            value = made(value)
            try:
                called(value) if key == "*" else called(**(good | {key: value}))
                answer = "was accepted"
            except ValueError as error:
                text = str(error)
                is_told = (
                    re.search(SAYS.get(key, key), text)
                    and len(text) > 20
                    and not CRYPTIC.search(text)
                )
                answer = "" if is_told else text
            except FileNotFoundError:
                answer = "" if kind in ("ending", "folder") else "no such file"
            except Exception as error:
                answer = repr(error)
            if answer:
                wrong.append(f"{name}({key}={kind}): {answer[:200]}")
    return wrong


def test_every_public_callable_has_arguments():
    assert sum(bool(list(arguments(name))) for name in public()) > 150


@pytest.mark.parametrize("module", MODULES)
def test_nonsense_is_refused_by_name(module):
    with pytest.raises(ValueError, match=r"^0 faults"):  # annotations are not checked within
        tell(module)


def tell(module):
    """Raises `ValueError` with all faults of a module."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "A JAX array is being set as static")
        wrong = [
            each for name in public() if name.startswith(f"{module}.") for each in faults(name)
        ]
    raise ValueError("\n".join([f"{len(wrong)} faults", *wrong]))
