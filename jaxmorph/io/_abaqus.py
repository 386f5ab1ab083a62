"""Input decks of Abaqus and CalculiX, .inp, of one flat part: nodes, elements, sets, surfaces."""

import functools
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from jaxmorph._host.cells.lagrange import lagrange_types
from jaxmorph._host.cells.orders import VTK_ORDER, reordered
from jaxmorph._host.cells.topology import DIMENSION, FACES, SHAPES, numbers_by_name
from jaxmorph._host.rows import Rows, join_ids
from jaxmorph._mesh.exchange import Parts

from ._format import note_unread, of_grid
from ._places import KIND_BY_NODES, CoordinatePart, LabelledCells, PlacedPoints, make_labelled_grid
from ._text import Section, blank_out, decoded, parse, split_sections

NAME = "Abaqus"
ELEMENT_NAMES = {
    3: r"(?:[A-Z]*C3D|F3D|COH3D|SC)(\d+)[A-UW-Z]*",
    2: r"(?:CP[ES]G?|[A-Z]*C(?:G?AX|2D)|(?:SF)?M3D|R3D|D?S|STRI)(\d)[A-Z0-9]*",
    1: r"(?:T[23]D|R2D|RAX|[A-Z]*C1D|B[23]|PIPE[23]|[SM]AX)(\d)[A-Z]*",
}
"""Names of elements by their dimension; the number is that of their nodes, or of a beam's order."""
LOOSE_ELEMENTS = r"(?:MASS|ROTARYI|HEATCAP|SPRING|DASHPOT|CONN|GAP|DCOUP)\w*"
"""Elements that are no cells."""
ABAQUS_SIDES = numbers_by_name(
    {
        "tetra": "012 013 123 023",
        "pyramid": "0123 014 124 234 034",
        "wedge": "012 345 0143 1254 0253",
        "hexahedron": "0123 4567 0154 1265 2376 0374",
    }
)
"""Corners of the faces S1, S2, ... of each shape; cells in 2-D have those of `FACES`."""
CHANGING_KEYWORDS = "SYSTEM INCLUDE NGEN NFILL NCOPY NMAP ELGEN ELCOPY PARAMETER"
"""Keywords that make or move nodes and elements."""
QUIET_KEYWORDS = ("HEADING", "PREPRINT", "END PART", "END INSTANCE", "END ASSEMBLY", "END STEP")
LEVEL_NAMES = ("PART", "INSTANCE", "ASSEMBLY")

_CARD = rb"(?m)^[ \t]*\*(?!\*)((?:[^\n]*,[ \t\r]*\n(?=[ \t]*[A-Za-z]))*[^\n]*)"
_EMPTY = re.compile(rb",[ \t]*,|^[ \t]*,", re.MULTILINE)


class Card(NamedTuple):
    """A keyword, its options, and the numbers that follow, without commas; `text` has them."""

    name: str
    options: dict[str, str]
    section: Section
    text: bytes

    def rows(self) -> Iterator[list[str]]:
        """Yields the words of each line."""
        lines = self.text[self.section.start : self.section.stop].split(b"\n")
        for line in filter(bytes.strip, lines):
            words = [decoded(word).strip().strip('"') for word in line.split(b",")]
            yield words if words[-1] else words[:-1]


class _Deck:
    """What the keywords say: nodes and where they stand, elements, sets by kind and name.

    `part` are the sets from before an *ASSEMBLY, which may have others of their names.
    """

    def __init__(self):
        self.labels = []
        self.points = []
        self.parts = []
        self.cells = []
        self.sets = {}
        self.part = set()
        self.level = ""
        self.seen = set()
        self.left = {}

    def take(self, card: Card) -> None:
        name = card.name
        readers = {"NODE": self._nodes, "ELEMENT": self._elements, "SURFACE": self._surface}
        readers |= {"NSET": self._set, "ELSET": self._set}
        wrong = ""
        if name in CHANGING_KEYWORDS.split() or (name in readers and "INPUT" in card.options):
            wrong = f"*{name} changes the mesh, and is not read: write all of it in one file."
        elif name in LEVEL_NAMES and name in self.seen:
            wrong = f"a second *{name}: decks of one part and instance are read."
        elif name == "INSTANCE" and card.section.content.strip():
            wrong = "an *INSTANCE that is moved: write the part where it stands."
        elif name in ("NODE", "ELEMENT") and self.level == "ASSEMBLY":
            wrong = f"a *{name} of an *ASSEMBLY: decks of one part are read."
        if wrong:
            raise card.section.error(wrong)
        self.seen.add(name)
        if name in (*LEVEL_NAMES, "END INSTANCE"):
            self.level = name.replace("END INSTANCE", "ASSEMBLY")
        if name == "ASSEMBLY":
            self.part = {*self.sets}
        if name in readers:
            readers[name](card)
        elif name not in (*LEVEL_NAMES, *QUIET_KEYWORDS):
            self.left[f"*{name}"] = None

    def _nodes(self, card: Card) -> None:
        section = card.section
        if card.options.get("SYSTEM", "R").upper() != "R":
            raise section.error("*NODE, SYSTEM: polar coordinates; write Cartesian ones.")
        rows = section.rows(np.float64)
        width = max(int(rows.counts[:1].sum()), 3)
        rows.refuse(rows.counts != width, "a node's number and 2 or 3 coordinates expected.")
        if _EMPTY.search(card.text, section.start, section.stop):
            raise section.error("a coordinate without a number between commas.")
        table = rows.values.reshape(-1, width)
        rows.refuse(table[:, 0] != np.floor(table[:, 0]), "a whole number of a node expected.")
        d = min(width - 1, 3)
        first = sum(map(len, self.labels))
        columns = slice(1, d + 1)
        self.parts.append(CoordinatePart.in_columns(section, table.shape, columns, first))
        self.labels.append(table[:, 0].astype(np.int64))
        self.points.append(table[:, columns])
        self._add("NSET", card.options.get("NSET"), self.labels[-1])

    def _elements(self, card: Card) -> None:
        name = card.options.get("TYPE", "").upper()
        if re.fullmatch(LOOSE_ELEMENTS, name):
            self.left[f"elements {name}"] = None
            return
        rows = card.section.rows(np.int64)
        kind, size = _element_kind(card.section, name)
        width = int(rows.counts[:1].sum()) if DIMENSION[kind] == 1 else 1 + size
        # rows of a long element go on in the next line: each element ends where a line ends
        ends = np.arange(width, len(rows.values) + width, max(width, 1))
        if width < 1 + size or not np.isin(ends, np.cumsum(rows.counts)).all():
            raise card.section.error(f"elements {name}: a number and {size} nodes expected.")
        table = rows.values.reshape(-1, width)
        corners = reordered(kind, table[:, 1 : 1 + size], VTK_ORDER, None)
        self.cells.append(LabelledCells(kind, table[:, 0], corners))
        self._add("ELSET", card.options.get("ELSET"), table[:, 0])

    def _set(self, card: Card) -> None:
        what = card.name
        name = card.options.get(what)
        if not name:
            raise card.section.error(f"*{what} without a name ({what}=...).")
        values = parse(card.section.content, np.int64)
        if "GENERATE" in card.options:
            labels = self.labels if what == "NSET" else [block.labels for block in self.cells]
            known = join_ids(labels)
            found = []
            for first, last, *step in (map(int, row) for row in card.rows()):
                inside = known[(first <= known) & (known <= last)]
                found.append(inside[(inside - first) % max([1, *step]) == 0])
        elif what == "NSET" and "ELSET" in card.options:
            elements = Rows(self._labels(card, "ELSET", card.options["ELSET"]))
            found = [block.corners[elements.mask(block.labels)] for block in self.cells]
        elif len(values) == len(card.section.content.split()):
            found = [values]
        else:
            found = [self._labels(card, what, word) for row in card.rows() for word in row]
        self._add(what, name, *found)

    def _surface(self, card: Card) -> None:
        """Adds the nodes of a surface. One without faces by number, or of surfaces, is left."""
        name = card.options.get("NAME", "")
        kind = card.options.get("TYPE", "ELEMENT").upper()
        found = None
        if "COMBINE" not in card.options and kind == "NODE":
            found = [self._labels(card, "NSET", row[0]) for row in card.rows()]
        elif "COMBINE" not in card.options and kind == "ELEMENT":
            found = [
                self._of_faces(self._labels(card, "ELSET", row[0]), "".join(row[1:2]).upper())
                for row in card.rows()
            ]
        known = [ids for ids in found or [] if ids is not None]
        if found is None or len(known) < len(found):
            self.left[f"the surface {name}"] = None
        else:
            self._add("SURFACE", name, *known)

    def _of_faces(self, elements: ndarray, face: str) -> ndarray | None:
        """Finds the nodes of faces S1, S2, ..., or of whole shells; None for others."""
        rows = Rows(elements)
        top = max(DIMENSION[block.kind] for block in self.cells)
        found = []
        for block in self.cells:
            corners = block.corners[rows.mask(block.labels)]
            sides = ABAQUS_SIDES.get(SHAPES[block.kind], FACES[SHAPES[block.kind]])
            if re.fullmatch("[SE][1-6]", face) and int(face[1]) <= len(sides):
                corners = corners[:, lagrange_types()[block.kind].side(sides[int(face[1]) - 1])]
            elif len(corners) and (
                face not in ("", "SPOS", "SNEG") or DIMENSION[block.kind] == top
            ):
                return None
            found.append(corners.ravel())
        return np.concatenate(found)

    def _add(self, what: str, name: str | None, *labels: ndarray) -> None:
        if name:
            shown = f"{name}_assembly" if (what, name.upper()) in self.part else name
            shown, *old = self.sets.get((what, shown.upper()), (shown,))
            self.sets[what, shown.upper()] = shown, join_ids([*old, *labels])

    def _labels(self, card: Card, what: str, word: str) -> ndarray:
        """Finds the members of a set, or takes a label; an instance's name may stand before."""
        last = word.rpartition(".")[2]
        if last.isdecimal():
            return np.array([int(last)])
        for name in (f"{last}_assembly", word, last):
            if (what, name.upper()) in self.sets:
                return self.sets[what, name.upper()][1]
        raise card.section.error(f"{word!r} is no number, and no *{what} before this line.")


def read(path: Path) -> Parts:
    """Reads points, cells and patches: sets of nodes, of elements of lower dimension, surfaces."""
    raw = path.read_bytes()
    deck = _Deck()
    for card in _read_cards(path, raw):
        deck.take(card)
    if len({points.shape[1] for points in deck.points}) != 1:
        raise ValueError("nodes of 2 or of 3 coordinates (*NODE) expected.")
    content = PlacedPoints(np.concatenate(deck.points), raw, deck.parts, _blank_commas_and_comments)
    words = {"NSET": "nodes", "ELSET": "elements"}
    sets = {"nodes": {}, "elements": {}}
    for (what, _), (name, labels) in deck.sets.items():
        while name in sets[words.get(what, "nodes")]:
            name += "_surface"
        sets[words.get(what, "nodes")][name] = labels
    labels = np.concatenate(deck.labels)
    grid, notes = make_labelled_grid(content.points, labels, deck.cells, sets)
    notes += note_unread("", deck.left)
    return of_grid(path, NAME, content, grid, notes=notes, labels=labels)


def _blank_commas_and_comments(text: bytes) -> bytes:
    return _uncommented(text).replace(b",", b" ")


_uncommented = functools.partial(blank_out, rb"(?m)^[ \t]*\*\*[^\r\n]*")


def _read_cards(path: Path, raw: bytes) -> Iterator[Card]:
    text = _uncommented(raw)
    plain = text.replace(b",", b" ")
    cards = list(split_sections(path, text, _CARD))
    if text[: cards[0][0].start() if cards else None].strip():
        raise ValueError("line 1: * expected: no input deck of Abaqus (AVS's .inp is not read).")
    for head, section in cards:
        name, *words = decoded(head[1]).split(",")
        pairs = [word.partition("=") for word in words]
        options = {key.strip().upper(): value.strip().strip('"') for key, _, value in pairs}
        start = min(section.start + 1, section.stop)
        section = section._replace(text=plain, start=start)
        yield Card(" ".join(name.upper().split()), options, section, text)


def _element_kind(section: Section, name: str) -> tuple[str, int]:
    """Finds the type of cells of an element's name, and how many nodes it has."""
    for level, pattern in ELEMENT_NAMES.items():
        if match := re.fullmatch(pattern, name):
            size = int(match[1])
            if level == 1 and re.match("B|P|SAX|MAX", name):  # the number is the order of a beam
                size = {2: 3}.get(size, 2)
            if (level, size) in KIND_BY_NODES:
                return KIND_BY_NODES[level, size], size
    raise section.error(
        f"elements of type {name[:40]!r} are not read; C3D4 to C3D20, plane, axisymmetric, shell, "
        "membrane and line elements are."
    )
