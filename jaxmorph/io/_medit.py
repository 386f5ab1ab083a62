"""Medit's .mesh and .meshb, which gmsh, MMG and INRIA's programs write: text or binary (GMF)."""

import functools
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from jaxmorph._host.cells.topology import CORNERS, Pair, codes, invert_table, pairs_of
from jaxmorph._mesh.exchange import Grid, Parts

from ._format import EVERYTHING, MeshLike, check_form, note_unread, of_grid
from ._gmsh import BYTE_ORDERS
from ._places import PlacedPoints, Stream
from ._text import Section, blank_out, decoded, split_sections
from .kinds import ending

NAME = "Medit"
MEDIT_CELLS = pairs_of(
    "Edges line Triangles triangle Quadrilaterals quad Tetrahedra tetra Pyramids pyramid "
    "Prisms wedge Hexahedra hexahedron Hexaedra hexahedron"
)
MEDIT_KEYWORDS = invert_table(
    codes(
        "Dimension 3 Vertices 4 Edges 5 Triangles 6 Quadrilaterals 7 Tetrahedra 8 Prisms 9 "
        "Hexahedra 10 Pyramids 49 End 54"
    )
)
"""Keywords by their numbers in binary files; others are told by number."""
CURVED_KEYWORDS = {f"Keyword{code}" for code in (24, 25, 27, 30, 33, 86, 87)}
"""Cells of order 2 in binary files; in a text their keywords end in P2, Q2, P3 ..."""
READ_KEYWORDS = {*MEDIT_CELLS, *MEDIT_KEYWORDS.values(), "MeshVersionFormatted"}


class MeditFile(NamedTuple):
    """A file's bytes, what follows each keyword, and types of binary numbers (`Stream`)."""

    raw: bytes
    sections: dict[str, Section]
    types: Mapping[str, str] | None = None

    def vertices(self) -> tuple[PlacedPoints, ndarray]:
        """Reads points, and the reference of each."""
        d = Stream(self.sections["Dimension"], self.types).one("i")
        if d not in (2, 3):
            raise ValueError(f"Dimension is {d}; 2 or 3 expected.")
        stream = Stream(self.sections["Vertices"], self.types)
        count = stream.one("n")
        start = stream.at
        numbers = stream.take("n", count, after="d" * d)
        stream.check_end("Vertices")
        places = start + stream.width("d" * d + "n") * np.arange(count)
        plain = _blank_medit_comments if self.types is None else bytes
        is_single = self.types is not None and self.types["d"].endswith("4")
        singles = EVERYTHING if is_single else ()
        return stream.content(places, d, raw=self.raw, plain=plain, singles=singles), numbers

    def elements(self, name: str) -> Pair:
        """Reads ids of corners (k, c), and the reference of each element."""
        stream = Stream(self.sections[name], self.types)
        rows = stream.table(stream.one("n"), CORNERS[MEDIT_CELLS[name]] + 1)
        stream.check_end(name)
        return rows[:, :-1] - 1, rows[:, -1]


def read(path: Path) -> Parts:
    """Reads points, cells and patches: references of faces, `medit:ref_3`."""
    raw = path.read_bytes()
    order = BYTE_ORDERS.get(raw[:4])
    file = _split_text(path, raw) if order is None else _split_binary(path, raw, order)
    missing = [name for name in ("Dimension", "Vertices", "End") if name not in file.sections]
    if missing:
        raise ValueError(f"no {', '.join(missing)}: no mesh of Medit, or one that is cut short.")
    curved = [
        name for name in file.sections if re.search("[PQ][2-9]$", name) or name in CURVED_KEYWORDS
    ]
    if curved:
        raise ValueError(f"curved cells ({', '.join(curved)}) are not read; gmsh makes a .msh.")
    content, of_nodes = file.vertices()
    names = [name for name in file.sections if name in MEDIT_CELLS]
    tables = [file.elements(name) for name in names]
    blocks = [
        (MEDIT_CELLS[name], corners) for name, (corners, _) in zip(names, tables, strict=True)
    ]
    arrays = {"medit:ref": [numbers for _, numbers in tables]}
    notes = note_unread("sections ", (name for name in file.sections if name not in READ_KEYWORDS))
    grid = Grid(content.points, blocks, {"medit:ref": of_nodes}, arrays)
    return of_grid(path, NAME, content, grid, notes=notes)


def check(path: Path, mesh: MeshLike) -> None:
    check_form(path, mesh, NAME, ending)


_blank_medit_comments = functools.partial(blank_out, rb"#[^\r\n]*")


def _split_text(path: Path, raw: bytes) -> MeditFile:
    found = split_sections(path, _blank_medit_comments(raw), rb"(?<!\S)[A-Za-z]\w*")
    return _collect_once(raw, ((decoded(word[0]), section) for word, section in found))


def _split_binary(path: Path, raw: bytes, order: str) -> MeditFile:
    """Follows the places of keywords: of 8 bytes from version 3 on, of which 4 has long numbers."""
    version = int.from_bytes(raw[4:8], "little" if order == "<" else "big")
    if version not in (1, 2, 3, 4):
        raise ValueError(f"version {version} of Medit's binary files; 1 to 4 are read.")
    types = {
        "i": f"{order}i4",
        "n": f"{order}i{8 if version > 3 else 4}",
        "p": f"{order}i{8 if version > 2 else 4}",
        "d": f"{order}f{8 if version > 1 else 4}",
    }
    stream = Stream(Section(path, raw, 8, len(raw)), types)
    found = []
    while not found or found[-1][0] != "End":
        code = stream.one("i")
        stop = stream.one("p")
        name = MEDIT_KEYWORDS.get(code, f"Keyword{code}")
        stop = stream.at if name == "End" else stop
        if not stream.at <= stop <= len(raw):
            raise ValueError(f"{name} ends at byte {stop} of {len(raw)}: a damaged file.")
        found.append((name, Section(path, raw, stream.at, stop)))
        stream.at = stop
    return _collect_once(raw, found)._replace(types=types)


def _collect_once(raw: bytes, found: Iterable[tuple[str, Section]]) -> MeditFile:
    sections = {}
    for name, section in found:
        if name in sections:
            raise section.error(f"a second {name}; each keyword is read once.")
        sections[name] = section
    return MeditFile(raw, sections)
