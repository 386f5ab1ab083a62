"""Design variables as a config file lists them, and derivatives by them as SU2_DOT writes them."""

import dataclasses
import os
import pathlib
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxmorph._host.package.arguments import checked, finite_array
from jaxmorph._host.package.errors import warn
from jaxmorph._host.package.files import complete, output_path

from ..._host.package.text import similar
from ._options import Options, read_options, split

NUMBERS = {
    **{1: "TRANSLATION", 2: "ROTATION", 3: "SCALE", 10: "FFD_SETTING", 11: "FFD_CONTROL_POINT", 12: "FFD_NACELLE"},
    **{13: "FFD_GULL", 14: "FFD_CAMBER", 15: "FFD_TWIST", 16: "FFD_THICKNESS", 18: "FFD_ROTATION"},
    **{19: "FFD_CONTROL_POINT_2D", 20: "FFD_CAMBER_2D", 21: "FFD_THICKNESS_2D", 22: "FFD_TWIST_2D"},
    **{23: "FFD_CONTROL_SURFACE", 24: "FFD_ANGLE_OF_ATTACK", 30: "HICKS_HENNE", 31: "PARABOLIC", 32: "NACA_4DIGITS"},
    **{33: "AIRFOIL", 34: "CST", 35: "SURFACE_BUMP", 36: "SURFACE_FILE", 37: "HICKS_HENNE_CAMBER"},
    **{50: "TRANSLATE_GRID", 51: "ROTATE_GRID", 52: "SCALE_GRID", 101: "ANGLE_OF_ATTACK"},
}
"""Kinds of design variables by the numbers that `DEFINITION_DV` has for them."""

COUNTS = {
    **{"TRANSLATION": 3, "ROTATION": 6, "SCALE": 0, "SURFACE_FILE": 0},
    **{"TRANSLATE_GRID": 3, "ROTATE_GRID": 6, "SCALE_GRID": 0},
    **{"HICKS_HENNE": 2, "HICKS_HENNE_CAMBER": 1, "SURFACE_BUMP": 3, "CST": 3, "NACA_4DIGITS": 3, "PARABOLIC": 2},
    **{"FFD_SETTING": 0, "FFD_CONTROL_POINT": 7, "FFD_CAMBER": 3, "FFD_TWIST": 8, "FFD_THICKNESS": 3},
    **{"FFD_ROTATION": 7, "FFD_CONTROL_SURFACE": 7, "FFD_GULL": 2, "FFD_NACELLE": 6},
    **{"FFD_CONTROL_POINT_2D": 5, "FFD_CAMBER_2D": 2, "FFD_THICKNESS_2D": 2},
    **{"ANGLE_OF_ATTACK": 1, "FFD_ANGLE_OF_ATTACK": 2},
}
"""Kinds that are taken, and how many parameters each has; the tag of a box is one of them."""

LEFT = ("ANGLE_OF_ATTACK", "FFD_ANGLE_OF_ATTACK")
"""Kinds that move no wall: they are the flow solver's."""

NOTHING = ("NO_DEFORMATION", "FFD_SETTING")
"""Words of `DV_KIND` where nothing is to be deformed."""

CONSTANT = ("NACA_4DIGITS", "PARABOLIC", "SURFACE_FILE")
"""Kinds that move a wall whatever the value is."""

WHOLE = ("TRANSLATE_GRID", "ROTATE_GRID", "SCALE_GRID")
"""Kinds that move the whole mesh, whatever `DV_MARKER` is."""

DIRECTIONS = {"FFD_CONTROL_POINT": (4, 3), "FFD_CONTROL_POINT_2D": (3, 2)}
"""Place and length of the direction in a control point's parameters.

Where the length is zero, the variable has as many values.
"""


@dataclasses.dataclass(frozen=True)
class Variable:
    """A design variable: kind, box tag, parameters, number of values, and their factor."""

    kind: str
    box: str
    numbers: tuple[float, ...]
    size: int = 1
    scale: float = 1.0


def variables(options: Options, definition: bool) -> tuple[list[Variable], list[str]]:
    """Lists the design variables, and the markers that they move.

    `definition` takes the variables of `DEFINITION_DV`. Raises `ValueError` for kinds that are not
    taken, each by its name, and for wrong numbers of parameters.
    """
    if definition:
        return _definition(options)
    kinds, groups = [word.upper() for word in options.words("DV_KIND")], options.groups("DV_PARAM")
    if not kinds:
        raise ValueError(f"{options.path}: DV_KIND= is missing: it says what kind of design variables there are.")
    _check_kinds(options, "DV_KIND", kinds)
    if not any(COUNTS.get(kind) for kind in kinds):
        groups = [[]] * len(kinds)
    if len(groups) != len(kinds):
        raise options.error("DV_PARAM", f"{len(groups)} groups of parameters for {len(kinds)} of DV_KIND")
    listed = [_variable(options, "DV_PARAM", *entry) for entry in zip(kinds, groups, strict=True)]
    return listed, options.words("DV_MARKER")


@checked
def checked_options(path: str | os.PathLike[str], *, definition: bool = False) -> Options:
    """Reads the options of a config file, and checks what needs no mesh.

    **Arguments:**

    - `path`, `definition`: as for `read_config`.

    **Returns:** the options, with `mesh_file` and `output`.

    **Raises:** `ValueError` for kinds, words and numbers that are not taken, each with its option.
    """
    options = read_options(pathlib.Path(path))
    checked_variables(options, definition)
    return options


def checked_variables(options: Options, definition: bool) -> tuple[list[Variable], list[str]]:
    """Lists design variables and markers as `variables` does, and reads every number beside them.

    Raises `ValueError` also for kinds that SU2 does not combine.
    """
    listed, markers = variables(options, definition)
    try:
        check_alone(listed)
    except ValueError as error:
        raise ValueError(f"{options.path}: {error}") from None
    options.number("OPT_RELAX_FACTOR", options.text("OPT_RELAX_FACTOR", "1"))
    options.numbers("DV_VALUE_NEW" if definition else "DV_VALUE")
    options.whole("DEFORM_NONLINEAR_ITER", options.text("DEFORM_NONLINEAR_ITER", "1"))
    return listed, markers


def check_alone(listed: Sequence[Variable]) -> None:
    """Raises `ValueError` for kinds that stand alone in SU2, and boxes beside other kinds."""
    kinds = {variable.kind for variable in listed if variable.kind not in LEFT}
    for kind in (*CONSTANT, *WHOLE):
        if kind in kinds and len(listed) > 1:
            raise ValueError(f"{kind} is taken alone; found {len(listed)} design variables.")
    for sort in ({kind for kind in kinds if kind.startswith("FFD_")}, kinds & {"HICKS_HENNE_CAMBER"}):
        if sort and sort != kinds:
            raise ValueError(
                f"{', '.join(sorted(sort))} beside {', '.join(sorted(kinds - sort))}: SU2 moves by one sort."
            )


def _definition(options: Options) -> tuple[list[Variable], list[str]]:
    name, listed, markers = "DEFINITION_DV", [], []
    for text in options.text(name).split(";"):
        if not split(text):
            continue
        head, *rest = [split(part) for part in text.split("|")]
        if not 1 <= len(head) <= 2 or len(rest) not in (1, 2):
            raise options.error(name, f"( kind, scale | markers | parameters ) expected, found {text.strip()[:60]!r}")
        kind = NUMBERS.get(int(head[0]), head[0]) if head[0].isdecimal() else head[0].upper()
        _check_kinds(options, name, [kind])
        scale = options.number(name, head[1]) if len(head) == 2 else 1.0
        listed.append(_variable(options, name, kind, rest[1] if len(rest) == 2 else [], scale))
        markers.append(rest[0])
    if not listed:
        raise ValueError(f"{options.path}: DEFINITION_DV= is missing.")
    if any(marker != markers[0] for marker in markers):
        other = next(marker for marker in markers if marker != markers[0])
        raise options.error(name, f"variables of different markers, {' '.join(markers[0])} and {' '.join(other)}")
    return listed, markers[0]


def _check_kinds(options: Options, name: str, kinds: list[str]) -> None:
    wrong = [kind for kind in dict.fromkeys(kinds) if kind not in COUNTS and kind != "NO_DEFORMATION"]
    if wrong:
        near = similar(wrong[0], COUNTS)
        hint = f" (did you mean {near}?)" if near and wrong[0] not in NUMBERS.values() else ""
        raise options.error(name, f"{', '.join(wrong)} is not taken{hint}; {', '.join(COUNTS)} are")


def _variable(options: Options, name: str, kind: str, words: list[str], scale: float = 1.0) -> Variable:
    box, count = "", COUNTS.get(kind, 0)
    if kind in (*NOTHING, *LEFT) or not count:
        return Variable(kind, "", (), scale=scale)
    if len(words) < count:
        raise options.error(name, f"{kind} has {count} parameters, found {len(words)}: {' '.join(words)}")
    if len(words) > count:
        warn(f"{options.path}: {name}= {kind} has {count} parameters, left out: {' '.join(words[count:])}.")
        words = words[:count]
    if kind.startswith("FFD_"):
        box, *words = words
    numbers = tuple(options.number(name, word) for word in words)
    first, length = DIRECTIONS.get(kind, (0, 0))
    is_free = length > 0 and not any(numbers[first - 1 : first - 1 + length])
    return Variable(kind, box, numbers, length if is_free else 1, scale)


@checked
def write_gradient(path: str | os.PathLike[str], gradient: Float[np.ndarray, " n"], objective: str = "DRAG") -> None:
    """Writes a derivative a line below a line with the name of the objective: `of_grad.dat`.

    **Arguments:**

    - `path`: the file.
    - `gradient`: (n,), in the order of the design variables.
    - `objective`: its name, as `OBJECTIVE_FUNCTION` has it.

    **Raises:** `ValueError` for values that are not finite, and a folder that is not there.
    """
    values = finite_array("gradient", gradient, (None,))
    lines = [f"{objective} gradient ", *map(repr, values.astype(float).tolist()), ""]
    with complete(output_path(path)) as partial:
        partial.write_text("\n".join(lines), encoding="utf-8")
