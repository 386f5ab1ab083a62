"""A config file's options and design variables, as text and numbers: no JAX, no mesh."""

import dataclasses
import difflib
import pathlib
import re
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from jaxmorph.extend import PathLike, input_path, warn

Words = list[str]


class Kind(NamedTuple):
    """A kind of design variable.

    - `number`: its number in `DEFINITION_DV`.
    - `parameters`: how many it has, with the tag of a box; None for an unsupported kind.
    - `sort`: what it moves, a `wall`, a `box`, or the whole `mesh`. A `constant` kind moves the
      wall whatever its value is, `flow` and `nothing` move none.
    - `indices`: directions of the parameters that are numbers of control points.
    """

    number: int
    parameters: int | None = None
    sort: str = "wall"
    indices: str = ""


VARIABLE_KINDS = {
    "NO_DEFORMATION": Kind(0, 0, "nothing"),
    "TRANSLATION": Kind(1, 3),
    "ROTATION": Kind(2, 6),
    "SCALE": Kind(3, 0),
    "FFD_SETTING": Kind(10, 0, "nothing"),
    "FFD_CONTROL_POINT": Kind(11, 7, "box", "ijk"),
    "FFD_NACELLE": Kind(12, 6, "box", "ijk"),
    "FFD_GULL": Kind(13, 2, "box", "j"),
    "FFD_CAMBER": Kind(14, 3, "box", "ij"),
    "FFD_TWIST": Kind(15, 8, "box", "j"),
    "FFD_THICKNESS": Kind(16, 3, "box", "ij"),
    "FFD_ROTATION": Kind(18, 7, "box"),
    "FFD_CONTROL_POINT_2D": Kind(19, 5, "box", "ij"),
    "FFD_CAMBER_2D": Kind(20, 2, "box", "i"),
    "FFD_THICKNESS_2D": Kind(21, 2, "box", "i"),
    "FFD_TWIST_2D": Kind(22),
    "FFD_CONTROL_SURFACE": Kind(23, 7, "box"),
    "FFD_ANGLE_OF_ATTACK": Kind(24, 2, "flow"),
    "HICKS_HENNE": Kind(30, 2),
    "PARABOLIC": Kind(31, 2, "constant"),
    "NACA_4DIGITS": Kind(32, 3, "constant"),
    "AIRFOIL": Kind(33),
    "CST": Kind(34, 3),
    "SURFACE_BUMP": Kind(35, 3),
    "SURFACE_FILE": Kind(36, 0, "constant"),
    "HICKS_HENNE_CAMBER": Kind(37, 1),
    "TRANSLATE_GRID": Kind(50, 3, "mesh"),
    "ROTATE_GRID": Kind(51, 6, "mesh"),
    "SCALE_GRID": Kind(52, 0, "mesh"),
    "ANGLE_OF_ATTACK": Kind(101, 1, "flow"),
}
"""Kinds of design variables; `MOVES` has how they move a wall, `BoxPart` how control points."""

UPPER = 1
LOWER = 0
ONE_VALUE = 2
"""Sides of an airfoil, as the first parameter has them; for `ONE` SU2 moves the upper side."""

LEFT_OUT = {
    "FFD_INTPREV": ("NO",),
    "CONVEXITY_CHECK": ("NO",),
    "OPT_LINE_SEARCH_BOUND": ("1E6",),
    "HOLD_GRID_FIXED": ("NO",),
    "DEFORM_LIMIT": ("1E6",),
    "DEFORM_COEFF": ("1E6",),
    "DEFORM_KIND": ("ELASTIC",),
    "DEFORM_STIFFNESS_TYPE": ("SOLID_WALL_DISTANCE", "WALL_DISTANCE"),
    "DEFORM_STIFF_LAYER_SIZE": ("0",),
    "DEFORM_ELASTICITY_MODULUS": ("2E11",),
    "DEFORM_POISSONS_RATIO": ("0.3",),
    "MARKER_PERIODIC": (),
    "MARKER_DEFORM_MESH_SYM_PLANE": (),
    "CONFIG_LIST": (),
    "MESH_FORMAT": ("SU2", "CGNS"),
    "DV_SENSITIVITY_FORMAT": ("SU2_NATIVE",),
    "SMOOTH_GRADIENT": ("NO",),
}
"""Options of SU2_DEF or SU2_DOT that this package ignores, with SU2's defaults."""

SEPARATORS = re.compile(r"[\s()\[\]{}:,]+")
"""Separators between the words of a value; a semicolon ends a group of them."""


class Options:
    """Options of a config file, `NAME= value`; `%` begins a comment, a backslash continues."""

    def __init__(self, path: pathlib.Path, values: Mapping[str, str]):
        self.path = path
        self.values = dict(values)

    def __contains__(self, name: str) -> bool:
        return bool(self.values.get(name)) and self.values[name].strip("() ").upper() != "NONE"

    def text(self, name: str, default: str = "") -> str:
        return self.values[name] if name in self else default

    def words(self, name: str) -> Words:
        return split_values(self.text(name))

    def groups(self, name: str) -> list[Words]:
        return [split_values(part) for part in self.text(name).split(";") if split_values(part)]

    def numbers(self, name: str) -> list[float]:
        return [self.number(name, word) for word in split_values(self.text(name).replace(";", " "))]

    def number(self, name: str, word: str | None = None) -> float:
        """Reads a word of an option as a number; by default its value, or 1 where it is not set."""
        word = self.text(name, "1") if word is None else word
        try:
            value = float(word)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise self.error(name, f"a number expected, found {word!r}")
        return value

    def whole(self, name: str, word: str | None = None) -> int:
        """Reads what `number` does as a whole number, 1 or more."""
        value = self.number(name, word)
        if value != int(value) or value < 1:
            raise self.error(name, f"a whole number, 1 or more, expected, found {value:g}")
        return int(value)

    def taken(self, name: str, what: str, words: Words, count: int) -> Words:
        """Takes the first `count` words; SU2's tutorials have more, which it warns of."""
        if len(words) < count:
            raise self.error(
                name, f"{what} has {count} parameters, found {len(words)}: {' '.join(words)}"
            )
        if len(words) > count:
            warn(
                f"{self.path}: {name}= {what} has {count} parameters, left out: "
                f"{' '.join(words[count:])}."
            )
        return words[:count]

    def choice(self, name: str, default: str, *known: str) -> str:
        word = self.text(name, default).upper()
        if word not in known:
            raise self.error(
                name,
                f"{word} is not taken; {', '.join(known)} {'is' if len(known) == 1 else 'are'}",
            )
        return word

    @property
    def relaxation(self) -> float:
        return self.number("OPT_RELAX_FACTOR")

    def left_out(self) -> Words:
        """Lists the options of `LEFT_OUT` with another value than SU2's default."""
        given = [(name, self.text(name)) for name in LEFT_OUT if name in self]
        return [
            f"{name}= {text}"
            for name, text in given
            if _normal_form(text) not in map(_normal_form, LEFT_OUT[name])
        ]

    @property
    def periodic(self) -> list[str]:
        """The markers of periodic pairs, one after the other; nine numbers follow each pair."""
        words = split_values(self.text("MARKER_PERIODIC").replace(";", " "))
        return [word for k, word in enumerate(words) if k % 11 < 2]

    def error(self, name: str, message: str) -> ValueError:
        return ValueError(f"{self.path}: {name}= {message}.")

    @property
    def mesh_file(self) -> pathlib.Path:
        """The file of the mesh; SU2 reads one without an ending where the file has `.su2`."""
        file = self.beside(self.text("MESH_FILENAME", "mesh.su2"))
        return file if file.exists() or file.suffix else file.with_suffix(".su2")

    @property
    def output(self) -> pathlib.Path:
        """The file of the moved mesh: with SU2's ending, whatever it read, unless it has one."""
        file = self.beside(self.text("MESH_OUT_FILENAME", "mesh_out.su2"))
        return file if file.suffix else file.with_name(f"{file.name}.su2")

    def beside(self, name: str) -> pathlib.Path:
        return self.path.parent / name


def _normal_form(text: str) -> str | float:
    """Returns a value as a number, or as a word in capitals; TRUE is YES, FALSE is NO."""
    try:
        return float(text)
    except ValueError:
        return {"FALSE": "NO", "TRUE": "YES"}.get(text.upper(), text.upper())


def split_values(text: str) -> Words:
    return [word for word in SEPARATORS.split(text) if word]


def read_options(path: PathLike) -> Options:
    """Reads a config file alone, without the mesh that it names.

    **Raises:** `ValueError` for a line that is no option, and for duplicates.
    """
    path = pathlib.Path(path)
    values: dict[str, str] = {}
    text = input_path(path).read_text(encoding="utf-8", errors="replace").removeprefix("\ufeff")
    lines = iter(enumerate(text.splitlines(), start=1))
    for number, line in lines:
        content = line.partition("%")[0].rstrip()
        while content.endswith("\\"):
            content = content[:-1] + " " + next(lines, (0, ""))[1].partition("%")[0].rstrip()
        if not content.strip():
            continue
        name, equals, value = content.partition("=")
        name = name.strip().upper()  # SU2 takes names in any case
        if not equals or not re.fullmatch(r"\w+", name):
            raise ValueError(
                f"{path}, line {number}: an option NAME= value expected, found "
                f"{content.strip()[:40]!r}."
            )
        if name in values:
            raise ValueError(f"{path}, line {number}: {name}= comes a second time.")
        values[name] = value.strip()
    return Options(path, values)


@dataclasses.dataclass(frozen=True)
class Variable:
    """A design variable: kind, box tag, parameters, number of values, factor and first row."""

    kind: str
    box: str = ""
    numbers: tuple[float, ...] = ()
    size: int = 1
    scale: float = 1.0
    first: int = 0

    @property
    def rows(self) -> tuple[int, ...]:
        return tuple(range(self.first, self.first + self.size))

    @property
    def sort(self) -> str:
        return VARIABLE_KINDS[self.kind].sort

    @property
    def index(self) -> tuple[int, ...]:
        """The numbers of control points among the parameters."""
        return tuple(map(int, self.numbers[: len(VARIABLE_KINDS[self.kind].indices)]))


Listed = tuple[list[Variable], Words]
"""Design variables, and names of their markers."""


def read_variables(options: Options, definition: bool) -> Listed:
    """Lists the design variables and their markers, and reads every number.

    `definition` takes the variables of `DEFINITION_DV`. Raises `ValueError` for unsupported kinds
    or combinations, and for wrong parameters.
    """
    listed, markers = _read_definition(options) if definition else _read_kinds(options)
    _check_alone(options, listed)
    for variable in listed:
        if fault := _fault(variable.kind, variable.numbers):
            raise ValueError(f"{options.path}: {fault}")
    options.number("OPT_RELAX_FACTOR")
    options.numbers("DV_VALUE_NEW" if definition else "DV_VALUE")
    options.whole("DEFORM_NONLINEAR_ITER")
    ends = np.cumsum([variable.size for variable in listed]).tolist()
    listed = [
        dataclasses.replace(own, first=end - own.size)
        for own, end in zip(listed, ends, strict=True)
    ]
    return listed, markers


def _read_kinds(options: Options) -> Listed:
    kinds = [word.upper() for word in options.words("DV_KIND")]
    groups = options.groups("DV_PARAM")
    if not kinds:
        raise ValueError(
            f"{options.path}: DV_KIND= is missing: it says what kind of design variables there are."
        )
    _check_words(options, "DV_KIND", kinds)
    if not any(VARIABLE_KINDS[kind].parameters for kind in kinds):
        groups = [[]] * len(kinds)
    if len(groups) != len(kinds):
        raise options.error(
            "DV_PARAM", f"{len(groups)} groups of parameters for {len(kinds)} of DV_KIND"
        )
    listed = [_variable(options, "DV_PARAM", *entry) for entry in zip(kinds, groups, strict=True)]
    return listed, options.words("DV_MARKER")


def _read_definition(options: Options) -> Listed:
    entries = [
        _read_defined(options, text)
        for text in filter(split_values, options.text("DEFINITION_DV").split(";"))
    ]
    if not entries:
        raise ValueError(f"{options.path}: DEFINITION_DV= is missing.")
    markers = dict.fromkeys(" ".join(words) for _, words in entries)
    if len(markers) > 1:
        raise options.error(
            "DEFINITION_DV", f"variables of different markers, {' and '.join(markers)}"
        )
    return [variable for variable, _ in entries], entries[0][1]


def _read_defined(options: Options, text: str) -> tuple[Variable, Words]:
    """Reads one variable and its markers: ( kind, scale | markers | parameters )."""
    name = "DEFINITION_DV"
    head, *rest = [split_values(part) for part in text.split("|")]
    if not 1 <= len(head) <= 2 or len(rest) not in (1, 2):
        raise options.error(
            name, f"( kind, scale | markers | parameters ) expected, found {text.strip()[:60]!r}"
        )
    by_number = {str(kind.number): word for word, kind in VARIABLE_KINDS.items()}
    kind = by_number.get(head[0], head[0].upper())
    _check_words(options, name, [kind])
    scale = options.number(name, head[1]) if len(head) == 2 else 1.0
    return _variable(options, name, kind, rest[1] if len(rest) == 2 else [], scale), rest[0]


def _check_words(options: Options, name: str, kinds: Words) -> None:
    taken = [word for word, kind in VARIABLE_KINDS.items() if kind.parameters is not None]
    wrong = [kind for kind in dict.fromkeys(kinds) if kind not in taken]
    if wrong:
        near = difflib.get_close_matches(wrong[0].upper(), taken, n=1)
        hint = f" (did you mean {near[0]}?)" if near and wrong[0] not in VARIABLE_KINDS else ""
        raise options.error(name, f"{', '.join(wrong)} is not taken{hint}; {', '.join(taken)} are")


def _check_alone(options: Options, listed: list[Variable]) -> None:
    """Raises `ValueError` for kinds that stand alone in SU2, and boxes beside other kinds."""
    for variable in listed:
        if variable.sort in ("constant", "mesh") and len(listed) > 1:
            raise ValueError(
                f"{options.path}: {variable.kind} is taken alone; found {len(listed)} design "
                "variables."
            )
    kinds = sorted({variable.kind for variable in listed if variable.sort != "flow"})
    for start in ("FFD_", "HICKS_HENNE_CAMBER"):
        own = [kind for kind in kinds if kind.startswith(start)]
        others = [kind for kind in kinds if kind not in own]
        if own and others:
            raise ValueError(
                f"{options.path}: {', '.join(own)} beside {', '.join(others)}: SU2 moves by one "
                "sort."
            )


def _fault(kind: str, numbers: tuple[float, ...]) -> str | None:
    match kind, numbers:
        case "HICKS_HENNE" | "CST", (side, *_) if side not in (LOWER, UPPER, ONE_VALUE):
            return f"{kind} has the side {side:g}; 0 is the lower one, 1 the upper one."
        case ("HICKS_HENNE", (_, top)) | ("HICKS_HENNE_CAMBER", (top,)) if not 0 < top < 1:
            return f"a bump has its top at {top:g} of the chord; expected between 0 and 1."
        case "CST", (_, number, most) if number % 1 or most % 1 or not 1 <= number <= most:
            return f"CST has the function {number:g} of {most:g}: whole numbers from 1 expected."
        case "SURFACE_BUMP", (start, end, top) if not start < top < end:
            return (
                f"SURFACE_BUMP from {start:g} to {end:g} with its top at {top:g}: it must lie "
                "between."
            )
    return None


def _variable(options: Options, name: str, kind: str, words: Words, scale: float = 1.0) -> Variable:
    _, count, sort, indices = VARIABLE_KINDS[kind]
    if not count or sort == "flow":
        return Variable(kind, size=0 if sort == "nothing" else 1, scale=scale)
    words = options.taken(name, kind, words, count)
    box, start = (words[0], 1) if sort == "box" else ("", 0)
    numbers = tuple(options.number(name, word) for word in words[start:])
    # a value for each direction
    is_free = kind.startswith("FFD_CONTROL_POINT") and not any(numbers[len(indices) :])
    return Variable(kind, box, numbers, len(indices) if is_free else 1, scale)
