"""The options of a config file as text: comments, continued lines, lists in brackets."""

import pathlib
import re
from collections.abc import Mapping

import numpy as np

from jaxmorph._host.package.files import input_path

LEFT_OUT = {
    **{"FFD_INTPREV": ("NO",), "CONVEXITY_CHECK": ("NO",), "OPT_LINE_SEARCH_BOUND": ("1E6",)},
    **{"HOLD_GRID_FIXED": ("NO",), "DEFORM_LIMIT": ("1E6",), "DEFORM_COEFF": ("1E6",)},
    **{"DEFORM_KIND": ("ELASTIC",), "DEFORM_STIFFNESS_TYPE": ("SOLID_WALL_DISTANCE", "WALL_DISTANCE")},
    **{"DEFORM_STIFF_LAYER_SIZE": ("0",), "DEFORM_ELASTICITY_MODULUS": ("2E11",), "DEFORM_POISSONS_RATIO": ("0.3",)},
    **{"MARKER_PERIODIC": (), "MARKER_DEFORM_MESH_SYM_PLANE": (), "CONFIG_LIST": ()},
    **{"MESH_FORMAT": ("SU2", "CGNS"), "DV_SENSITIVITY_FORMAT": ("SU2_NATIVE",), "SMOOTH_GRADIENT": ("NO",)},
}
"""Options that SU2_DEF or SU2_DOT honour and this package does not, with SU2's defaults."""

SEPARATORS = re.compile(r"[\s()\[\]{}:,]+")
"""Separators between the words of a value; a semicolon ends a group of them."""


class Options:
    """Options of a config file by name: `NAME= value`.

    A `%` begins a comment, a backslash at the end of a line continues it.
    """

    def __init__(self, path: pathlib.Path, values: Mapping[str, str]):
        self.path, self.values = path, dict(values)

    def __contains__(self, name: str) -> bool:
        return bool(self.values.get(name)) and self.values[name].strip("() ").upper() != "NONE"

    def text(self, name: str, default: str = "") -> str:
        """Returns a value as it stands, without blanks around it."""
        return self.values[name] if name in self else default

    def words(self, name: str) -> list[str]:
        """Splits a value into its words, brackets and commas left out."""
        return split(self.text(name))

    def groups(self, name: str) -> list[list[str]]:
        """Splits a value at its semicolons, and each part into words."""
        return [split(part) for part in self.text(name).split(";") if split(part)]

    def numbers(self, name: str) -> list[float]:
        """Reads a list of numbers. Raises `ValueError` for anything else."""
        return [self.number(name, word) for word in split(self.text(name).replace(";", " "))]

    def number(self, name: str, word: str) -> float:
        """Reads one word of an option as a number. Raises `ValueError` for anything else."""
        try:
            value = float(word)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise self.error(name, f"a number expected, found {word!r}")
        return value

    def whole(self, name: str, word: str) -> int:
        """Reads one word of an option as a whole number, 1 or more. Raises as `number` does."""
        value = self.number(name, word)
        if value != int(value) or value < 1:
            raise self.error(name, f"a whole number, 1 or more, expected, found {word}")
        return int(value)

    def choice(self, name: str, default: str, *known: str) -> str:
        """Reads one of the words that are known. Raises `ValueError` for another one."""
        word = self.text(name, default).upper()
        if word not in known:
            raise self.error(name, f"{word} is not taken; {', '.join(known)} are")
        return word

    @property
    def relaxation(self) -> float:
        """The factor `OPT_RELAX_FACTOR` of the values, as SU2 has it."""
        return self.number("OPT_RELAX_FACTOR", self.text("OPT_RELAX_FACTOR", "1"))

    def left_out(self) -> list[str]:
        """Lists the options of `LEFT_OUT` that are set to something else than SU2's default."""
        given = [(name, self.text(name)) for name in LEFT_OUT if name in self]
        return [f"{name}= {text}" for name, text in given if _plain(text) not in map(_plain, LEFT_OUT[name])]

    def error(self, name: str, message: str) -> ValueError:
        """Makes a `ValueError` that names the file and the option."""
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
        """Returns a path relative to the folder of the config file."""
        return self.path.parent / name


def _plain(text: str) -> str | float:
    """Returns a value as a number, or as a word in capitals; TRUE is YES, FALSE is NO."""
    try:
        return float(text)
    except ValueError:
        return {"FALSE": "NO", "TRUE": "YES"}.get(text.upper(), text.upper())


def split(text: str) -> list[str]:
    """Splits a text into words."""
    return [word for word in SEPARATORS.split(text) if word]


def read_options(path: pathlib.Path) -> Options:
    """Reads a config file.

    Raises `ValueError` for a line that is no option, and for an option that comes twice.
    """
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
            raise ValueError(f"{path}, line {number}: an option NAME= value expected, found {content.strip()[:40]!r}.")
        if name in values:
            raise ValueError(f"{path}, line {number}: {name}= comes a second time.")
        values[name] = value.strip()
    return Options(path, values)
