"""Input decks of Abaqus and CalculiX, .inp, of one flat part: nodes, elements, sets, surfaces."""

import dataclasses
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from jaxmorph._host.cells.lagrange import lagrange_types
from jaxmorph._host.cells.orders import VTK_ORDER, reordered
from jaxmorph._host.cells.topology import DIMENSION, FACES, SHAPES, numbers
from jaxmorph._mesh.exchange import Grid, Parts, Patch

from ._format import Source, of_grid
from ._places import KINDS, CoordinatePart, Labels, PlacedPoints, members
from ._text import Section, blanked, decoded, parse

NAME = "Abaqus"
LEVELS = {
    3: r"(?:[A-Z]*C3D|F3D|COH3D|SC)(\d+)[A-UW-Z]*",
    2: r"(?:CP[ES]G?|[A-Z]*C(?:G?AX|2D)|(?:SF)?M3D|R3D|D?S|STRI)(\d)[A-Z0-9]*",
    1: r"(?:T[23]D|R2D|RAX|[A-Z]*C1D|B[23]|PIPE[23]|[SM]AX)(\d)[A-Z]*",
}
"""Names of elements by their dimension; the number is that of their nodes, or of a beam's order."""
LOOSE = r"(?:MASS|ROTARYI|HEATCAP|SPRING|DASHPOT|CONN|GAP|DCOUP)\w*"
"""Elements that are no cells."""
SIDES = {
    "tetra": numbers("012 013 123 023"),
    "pyramid": numbers("0123 014 124 234 034"),
    "wedge": numbers("012 345 0143 1254 0253"),
    "hexahedron": numbers("0123 4567 0154 1265 2376 0374"),
}
"""Corners of the faces S1, S2, ... of each shape; cells in 2-D have those of `FACES`."""
CHANGING = ("SYSTEM", "INCLUDE", "NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY", "PARAMETER")
"""Keywords that make or move nodes and elements."""
SILENT = ("HEADING", "PREPRINT", "END PART", "END INSTANCE", "END ASSEMBLY", "END STEP")
SHOWN = 12
"""Keywords that a note lists."""

_CARD = re.compile(
    rb"^[ \t]*\*(?!\*)((?:[^\n]*,[ \t\r]*\n(?=[ \t]*[A-Za-z]))*[^\n]*)", re.MULTILINE
)
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


class Elements(NamedTuple):
    kind: str
    labels: ndarray
    corners: ndarray


class Surface(NamedTuple):
    """Labels of elements and the name of their face, or labels of nodes without one."""

    name: str
    parts: list[tuple[ndarray, str | None]]


@dataclasses.dataclass
class _Deck:
    """What the keywords say: nodes and where they stand, elements, sets by kind, level and name."""

    labels: list[ndarray] = dataclasses.field(default_factory=list)
    points: list[ndarray] = dataclasses.field(default_factory=list)
    parts: list[CoordinatePart] = dataclasses.field(default_factory=list)
    blocks: list[Elements] = dataclasses.field(default_factory=list)
    sets: dict[tuple[str, bool, str], ndarray] = dataclasses.field(default_factory=dict)
    names: dict[tuple[str, bool, str], str] = dataclasses.field(default_factory=dict)
    surfaces: list[Surface] = dataclasses.field(default_factory=list)
    seen: dict[str, None] = dataclasses.field(default_factory=dict)
    left: dict[str, None] = dataclasses.field(default_factory=dict)
    in_assembly: bool = False

    def take(self, card: Card) -> None:
        readers = {"NODE": self._nodes, "ELEMENT": self._elements, "SURFACE": self._surface}
        readers |= {"NSET": self._set, "ELSET": self._set}
        if card.name in CHANGING or (card.name in readers and "INPUT" in card.options):
            raise card.section.error(
                f"*{card.name} changes the mesh, and is not read: write nodes and elements in one "
                "file, in the global system of coordinates."
            )
        if card.name in ("PART", "INSTANCE", "ASSEMBLY", "END INSTANCE"):
            self._level(card)
        elif self.in_assembly and card.name in ("NODE", "ELEMENT"):
            raise card.section.error("nodes and elements of an *ASSEMBLY are not read, of a part.")
        elif card.name in readers:
            readers[card.name](card)
        elif card.name not in SILENT:
            self.left[f"*{card.name}"] = None

    def _level(self, card: Card) -> None:
        name = card.name
        if name in self.seen and not name.startswith("END"):
            raise card.section.error(f"a second *{name}: decks of one part and instance are read.")
        if name == "INSTANCE" and card.section.content.strip():
            raise card.section.error("an *INSTANCE that is moved: write the part where it stands.")
        self.in_assembly = name in ("ASSEMBLY", "END INSTANCE")
        self.seen[name] = None

    def _nodes(self, card: Card) -> None:
        section = card.section
        if card.options.get("SYSTEM", "R").upper() != "R":
            raise section.error("*NODE, SYSTEM: nodes in polar coordinates; write Cartesian ones.")
        rows = section.rows(np.float64)
        width = int(rows.counts[:1].sum())
        is_bad = (rows.counts != width) | (width < 3)
        rows.refuse(is_bad, "a node's number and 2 or 3 coordinates on all rows expected.")
        if _EMPTY.search(card.text, section.start, section.stop):
            raise section.error("a coordinate without a number between commas.")
        table = rows.values.reshape(-1, max(width, 3))
        rows.refuse(table[:, 0] != np.floor(table[:, 0]), "a whole number of a node expected.")
        d = min(max(width, 3) - 1, 3)
        first = sum(map(len, self.labels))
        at = (width * np.arange(len(table))[:, None] + np.arange(1, d + 1)).ravel()
        here = slice(first, first + len(table))
        self.parts.append(CoordinatePart(section.start, section.stop, here, at))
        self.labels.append(table[:, 0].astype(np.int64))
        self.points.append(table[:, 1 : d + 1])
        self._add("NSET", card, self.labels[-1])

    def _elements(self, card: Card) -> None:
        section = card.section
        name = card.options.get("TYPE", "").upper()
        if re.fullmatch(LOOSE, name):
            self.left[f"elements {name}"] = None
            return
        rows = section.rows(np.int64)
        kind, size = _kind_of(section, name)
        width = int(rows.counts[:1].sum()) if DIMENSION[kind] == 1 else 1 + size
        ends = np.cumsum(rows.counts)
        whole = np.arange(width, len(rows.values) + width, max(width, 1))
        broken = whole[~np.isin(whole, ends)]
        if len(broken) or width < 1 + size:
            row = int(np.searchsorted(ends, broken[0])) if len(broken) else 0
            message = f"an element of type {name}: its number and {size} nodes expected."
            raise section.error(message, min(row, len(ends) - 1))
        table = rows.values.reshape(-1, width)
        corners = reordered(kind, table[:, 1 : 1 + size], VTK_ORDER, None)
        self.blocks.append(Elements(kind, table[:, 0], corners))
        self._add("ELSET", card, table[:, 0])

    def _set(self, card: Card) -> None:
        what = card.name
        if not card.options.get(what):
            raise card.section.error(f"*{what} without a name ({what}=...).")
        if "GENERATE" in card.options:
            known = self._known(what)
            rows = [[*map(_whole, row), 1] for row in card.rows()]
            found = [
                known[(a <= known) & (known <= b) & ((known - a) % max(step, 1) == 0)]
                for a, b, step, *_ in rows
            ]
        elif what == "NSET" and "ELSET" in card.options:
            rows = self._labels(card, "ELSET", card.options["ELSET"])
            found = [block.corners[np.isin(block.labels, rows)].ravel() for block in self.blocks]
        else:
            values = parse(card.section.content, np.int64)
            words = card.section.content.split()
            found = [values]
            if len(values) != len(words):
                found = [self._labels(card, what, word) for row in card.rows() for word in row]
        self._add(what, card, np.concatenate([np.zeros(0, np.int64), *found]))

    def _surface(self, card: Card) -> None:
        name = card.options.get("NAME", "")
        kind = card.options.get("TYPE", "ELEMENT").upper()
        what = {"ELEMENT": "ELSET", "NODE": "NSET"}.get(kind)
        rows = list(card.rows())
        if what is None or "COMBINE" in card.options:
            self.left[f"the surface {name}"] = None
            return
        words = [(*row, "")[:2] for row in rows]
        parts = [
            (self._labels(card, what, who), face.upper() if what == "ELSET" else None)
            for who, face in words
        ]
        self.surfaces.append(Surface(name, parts))

    def _known(self, what: str) -> ndarray:
        labels = self.labels if what == "NSET" else [block.labels for block in self.blocks]
        return np.concatenate([np.zeros(0, np.int64), *labels])

    def _add(self, what: str, card: Card, labels: ndarray) -> None:
        name = card.options.get(what)
        if name:
            key = (what, self.in_assembly, name.upper())
            hidden = self.in_assembly and (what, False, name.upper()) in self.sets
            self.names.setdefault(key, f"{name}_assembly" if hidden else name)
            self.sets[key] = np.concatenate([self.sets.get(key, labels[:0]), labels])

    def _labels(self, card: Card, what: str, word: str) -> ndarray:
        """Finds the members of a set, or takes a label; an instance's name may stand before."""
        for name in (word, word.rpartition(".")[2]):
            if name.isdecimal():
                return np.array([int(name)])
            for level in (self.in_assembly, False):
                if (what, level, name.upper()) in self.sets:
                    return self.sets[what, level, name.upper()]
        raise card.section.error(f"{word!r} is no number, and no *{what} before this line.")


def read(path: Path) -> Parts:
    """Reads points, cells and patches: sets of nodes, of elements of lower dimension, surfaces."""
    raw = path.read_bytes()
    deck = _Deck()
    for card in _cards(path, raw):
        deck.take(card)
    if not deck.labels or not deck.blocks:
        raise ValueError("no *NODE or no *ELEMENT in this deck.")
    if len({points.shape[1] for points in deck.points}) > 1:
        raise ValueError("nodes of 2 and of 3 coordinates in one deck.")
    content = PlacedPoints(np.concatenate(deck.points), raw, deck.parts, _plain)
    nodes = Labels(np.concatenate(deck.labels), "nodes")
    elements = Labels(np.concatenate([block.labels for block in deck.blocks]), "elements")
    blocks = [
        block._replace(corners=nodes.find(block.corners, f"a {block.kind}"))
        for block in deck.blocks
    ]
    sets = {"NSET": {}, "ELSET": {}}
    for key, labels in deck.sets.items():
        sets[key[0]][deck.names[key]] = labels
    of_nodes = {name: _among(nodes, labels) for name, labels in sets["NSET"].items()}
    grid = Grid(
        content.points,
        [(block.kind, block.corners) for block in blocks],
        {},
        {},
        members(sets["ELSET"], [block.labels for block in blocks]),
        point_sets=of_nodes,
        own=("elements", "nodes"),
    )
    patches = []
    for surface in deck.surfaces:
        found = [_nodes_of(part, nodes, blocks) for part in surface.parts]
        if any(ids is None for ids in found):
            deck.left[f"the surface {surface.name}"] = None
        else:
            ids = np.concatenate([np.zeros(0, np.int64), *found])
            patches.append(Patch(surface.name, "surface", ids))
    notes = tuple(_notes(deck, nodes, elements))
    source = Source(path, NAME, content, notes=notes, **content.known)
    return of_grid(path, grid, source, patches)


def _plain(text: bytes) -> bytes:
    return _uncommented(text).replace(b",", b" ")


def _uncommented(text: bytes) -> bytes:
    return blanked(text, rb"(?m)^[ \t]*\*\*[^\r\n]*") if b"**" in text else text


def _whole(word: str) -> int:
    if not word.isdecimal():
        raise ValueError(f"GENERATE: first, last and step expected, found {word[:40]!r}.")
    return int(word)


def _cards(path: Path, raw: bytes) -> Iterator[Card]:
    text = _uncommented(raw)
    plain = text.replace(b",", b" ")
    heads = list(_CARD.finditer(text))
    stops = [*(head.start() for head in heads[1:]), len(text)]
    if text[: heads[0].start() if heads else None].strip():
        raise ValueError("line 1: * expected: no input deck of Abaqus (AVS's .inp is not read).")
    for head, stop in zip(heads, stops, strict=True):
        name, *words = decoded(head[1]).split(",")
        pairs = [word.partition("=") for word in words]
        options = {key.strip().upper(): value.strip().strip('"') for key, _, value in pairs}
        section = Section(path, plain, min(head.end() + 1, stop), stop)
        yield Card(" ".join(name.upper().split()), options, section, text)


def _kind_of(section: Section, name: str) -> tuple[str, int]:
    """Finds the type of cells of an element's name, and how many nodes it has."""
    for level, pattern in LEVELS.items():
        if match := re.fullmatch(pattern, name):
            size = int(match[1])
            if level == 1 and re.match("B|P|SAX|MAX", name):  # the number is the order of a beam
                size = {2: 3}.get(size, 2)
            if (level, size) in KINDS:
                return KINDS[level, size], size
    raise section.error(
        f"elements of type {name[:40]!r} are not read; C3D4 to C3D20, plane, axisymmetric, shell, "
        "membrane and line elements are."
    )


def _nodes_of(
    part: tuple[ndarray, str | None], nodes: Labels, blocks: list[Elements]
) -> ndarray | None:
    """Finds the nodes of a part of a surface; None for a face that is not told by its number."""
    labels, face = part
    if face is None:
        return _among(nodes, labels)
    top = max(DIMENSION[block.kind] for block in blocks)
    found = [np.zeros(0, np.int64)]
    for block in blocks:
        corners = block.corners[np.isin(block.labels, labels)]
        sides = SIDES.get(SHAPES[block.kind], FACES[SHAPES[block.kind]])
        if re.fullmatch("[SE][1-6]", face) and int(face[1]) <= len(sides):
            corners = corners[:, lagrange_types()[block.kind].side(sides[int(face[1]) - 1])]
        elif len(corners) and (face not in ("", "SPOS", "SNEG") or DIMENSION[block.kind] == top):
            return None
        found.append(corners.ravel())
    return np.concatenate(found)


def _among(labels: Labels, ids: ndarray) -> ndarray:
    rows = labels.rows(ids)
    return rows[rows >= 0]


def _notes(deck: _Deck, nodes: Labels, elements: Labels) -> Iterator[str]:
    left = [*deck.left]
    if left:
        more = f" and {len(left) - SHOWN} more" if len(left) > SHOWN else ""
        yield f"{', '.join(left[:SHOWN])}{more} are not read, and stay in the file."
    for (what, *_), ids in deck.sets.items():
        lost = int(((nodes if what == "NSET" else elements).rows(ids) < 0).sum())
        if lost:
            yield f"{lost} members of a set (*{what}) are not in the mesh."
