"""Fluent's meshes and cases (.msh, .cas), text or binary: the nodes alone are replaced.

Sections are `(number (head)(body))`, of which nodes (10), cells (12), faces (13) and zones (45, 39)
are read; 2010 and 3010 are nodes in binary, of 4 and 8 bytes. Numbers of heads and faces are
hexadecimal. A face is its nodes and the cells on its two sides, 0 for none.
"""

import dataclasses
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from jaxmorph._host.cells.topology import SIDE_TYPES, codes, invert_table
from jaxmorph._host.ragged import Ragged
from jaxmorph._mesh.exchange import Parts, Patch, checked_parts, distinct, gathered, regions_note
from jaxmorph._mesh.faces import Faces, following
from jaxmorph._mesh.polyhedra import Polyhedra, cells_of_faces

from ._format import Source
from ._joined import join_rows
from ._places import CoordinatePart, PlacedPoints
from ._text import Section, decoded

NAME = "Fluent"
INTERIOR = 2
PARENT = 31
ZONE_KINDS = invert_table(
    codes(
        "interior 2 wall 3 pressure-inlet 4 pressure-outlet 5 symmetry 7 periodic-shadow 8 "
        "pressure-far-field 9 velocity-inlet 10 periodic 12 fan 14 mass-flow-inlet 20 "
        "interface 24 parent 31 outflow 36 axis 37"
    )
)
"""Kinds of zones of faces by Fluent's numbers."""

_BEGIN = re.compile(rb"\(\s*(\d+)\b")
_MARK = re.compile(rb'[()]|"(?:[^"\\]|\\.)*"')
_SECTION_HEAD = re.compile(rb"\s*\(([0-9a-fA-F\s]*)\)\s*\(?")
_ZONE_HEAD = re.compile(rb"\s*\(\s*(\d+)\s+(\S+)\s+([^\s()]+)")


class FaceZone(NamedTuple):
    """A zone of faces: its number, name and kind, and its faces by their places in the file."""

    number: int
    name: str
    kind: str
    rows: ndarray


class FaceTable(NamedTuple):
    """Faces: ids of nodes from 1, and cells (k, 2) from 1."""

    nodes: Ragged
    cells: ndarray


class NodeSection(NamedTuple):
    """The coordinates of nodes, the first one's number, and where they stand in the file.

    `kind` is the type of binary numbers, None for a text.
    """

    first: int
    points: ndarray
    section: Section
    kind: np.dtype | None

    @property
    def rows(self) -> slice:
        return slice(self.first - 1, self.first - 1 + len(self.points))


class _FluentText:
    """What sections say: counts by kind, nodes, faces behind their heads, and zones by number."""

    def __init__(self):
        self.dimension = 0
        self.counts = {}
        self.nodes = []
        self.faces = []
        self.regions = []
        self.names = {}

    def take(self, number: int, section: Section) -> None:
        kind = number % 1000
        width = {2: 4, 3: 8}.get(number // 1000, 0)
        if number == 2:
            self.dimension = int(section.content)
        elif kind in (45, 39) and (zone := _ZONE_HEAD.match(section.text, section.start)):
            self.names[int(zone[1])] = decoded(zone[3]), decoded(zone[2])
        elif kind in (58, 59):
            raise section.error("a mesh that was adapted, with parents of cells, is not read.")
        elif kind in (10, 12, 13) and (head := _SECTION_HEAD.match(section.text, section.start)):
            stop = section.stop if width else section.text.rfind(b")", head.end(), section.stop)
            body = section._replace(start=head.end(), stop=max(stop, head.end()))
            self._mesh(kind, [int(word, 16) for word in head[1].split()], body, width)

    def _mesh(self, kind: int, head: list[int], body: Section, width: int) -> None:
        if head[0] == 0:
            self.counts[kind] = head[2]
        elif kind == 12:
            self.regions.append(head[0])
        elif kind == 10:
            self.nodes.append(self._nodes(head, body, width))
        else:
            words = (
                np.frombuffer(body.content, "<i4")
                if width
                else [int(word, 16) for word in body.content.split()]
            )
            table = _cut_table(np.asarray(words, np.int64), head[4] if len(head) > 4 else 0)
            if len(table.cells) != head[2] - head[1] + 1:
                raise body.error(f"{len(table.cells)} faces, {head[2] - head[1] + 1} expected")
            self.faces.append((head, table))

    def _nodes(self, head: list[int], body: Section, width: int) -> NodeSection:
        count = head[2] - head[1] + 1
        d = head[4] if len(head) > 4 else self.dimension
        kind = np.dtype(f"<f{width}") if width else None
        values = body.rows(np.float64).values if kind is None else np.frombuffer(body.content, kind)
        if d not in (2, 3) or len(values) != count * d:
            raise body.error(f"{len(values)} coordinates of nodes, {count} times {d} expected")
        return NodeSection(head[1], values.reshape(count, d).astype(float), body, kind)

    def content(self, text: bytes) -> PlacedPoints:
        parts = sorted(self.nodes, key=lambda part: part.first)
        ends = np.cumsum([0, *(len(part.points) for part in parts)])
        if not parts or not self.faces or [part.rows.start for part in parts] != ends[:-1].tolist():
            raise ValueError(
                "not a Fluent mesh, or a damaged one: no nodes or faces, or some are missing."
            )
        points = np.concatenate([part.points for part in parts])
        found = [len(points), len(self.table().cells)]
        announced = [self.counts.get(10, found[0]), self.counts.get(13, found[1])]
        if announced != found:
            raise ValueError(
                f"{found} nodes and faces, and {announced} announced: the file is cut short."
            )
        singles = [(part.rows, slice(None)) for part in parts if part.kind == "<f4"]
        places = [
            CoordinatePart(part.section.start, part.section.stop, part.rows, dtype=part.kind)
            for part in parts
        ]
        return PlacedPoints(points, text, places, singles=singles)

    def table(self) -> FaceTable:
        tables = [table for _, table in self.faces]
        nodes = join_rows([table.nodes for table in tables])
        return FaceTable(nodes, np.concatenate([table.cells for table in tables]))

    def zones(self) -> Iterator[FaceZone]:
        first = 0
        for (number, _, _, kind, *_), table in self.faces:
            name, word = self.names.get(
                number, (f"zone_{number}", ZONE_KINDS.get(kind, f"kind_{kind}"))
            )
            word = ZONE_KINDS[kind] if kind in (INTERIOR, PARENT) else word
            yield FaceZone(number, name, word, np.arange(first, first + len(table.cells)))
            first += len(table.cells)


def read(path: Path) -> Parts:
    """Reads points, cells and patches: the zones of faces, but inner ones, with their kinds."""
    text = path.read_bytes()
    found = _FluentText()
    for number, section in _find_sections(path, text):
        try:
            found.take(number, section)
        except (ValueError, IndexError, OverflowError) as error:
            if str(path) in str(error):
                raise
            raise section.error(f"a damaged section {number} ({error}).") from error
    regions = [found.names.get(number, (f"zone_{number}", ""))[0] for number in found.regions]
    source = Source(path, NAME, found.content(text))
    return make_mesh_of_faces(
        source, found.table(), list(found.zones()), found.counts.get(12), regions
    )


def _find_sections(path: Path, text: bytes) -> Iterator[tuple[int, Section]]:
    at = 0
    while begin := _BEGIN.search(text, at):
        number = int(begin[1])
        if number >= 2000:
            end = re.compile(rb"\)\s*End of Binary Section\s+%d\s*\)" % number).search(
                text, begin.end()
            )
            stop, at = (end.start(), end.end()) if end else (-1, -1)
        else:
            stop = _find_closing(text, begin.end())
            at = stop + 1
        if stop < 0:
            raise ValueError(f"the section {number} has no end: the file is cut short.")
        yield number, Section(path, text, begin.end(), stop)


def _find_closing(text: bytes, at: int) -> int:
    depth = 1
    for mark in _MARK.finditer(text, at):
        depth += {b"(": 1, b")": -1}.get(mark[0], 0)
        if not depth:
            return mark.start()
    return -1


def _cut_table(words: ndarray, kind: int) -> FaceTable:
    # a row is a face: its nodes, behind their count where faces differ in size, and its two cells
    if kind in (0, 5):
        rows = Ragged.counted(words, more=2)
    elif kind < 2 or len(words) % (kind + 2):
        raise ValueError(f"{len(words)} numbers are no faces of {kind} nodes")
    else:
        rows = Ragged.of(words, np.full(len(words) // (kind + 2), kind + 2))
    if rows.sizes.min(initial=4) < 4:
        raise ValueError(f"a face of {rows.sizes.min() - 2} nodes")
    if rows.starts[-1] != len(rows.values):
        raise ValueError("faces that are cut short")
    last = rows.starts[1:, None] - np.array([2, 1])
    nodes = Ragged.of(np.delete(rows.values, last), rows.sizes - 2)
    return FaceTable(nodes, rows.values[last])


def make_mesh_of_faces(
    source: Source, table: FaceTable, zones: list[FaceZone], count: int | None, regions: list[str]
) -> Parts:
    """Makes the mesh of all faces; `count` is the number of cells, None if it is not announced."""
    points = source.content.points
    _check_faces(table, zones, len(points), count)
    faces = _orient_faces(table, points)
    blocks, whole = cells_of_faces(faces, points) if points.shape[1] == 3 else _join_edges(faces)
    blocks = sorted(blocks, key=lambda block: block[0])  # as JAX sorts types
    outer = [zone for zone in zones if zone.kind != ZONE_KINDS[INTERIOR]]
    patches, notes = distinct(
        Patch(zone.name, f"zone_{zone.number}", faces.rows.take(zone.rows).values) for zone in outer
    )
    kinds = {zone.name: zone.kind for zone in outer}
    source = dataclasses.replace(
        source,
        polyhedra=whole if len(whole.cut) else None,
        cell_ids=np.concatenate([ids for *_, ids in blocks]),
        kinds=kinds,
        symmetry=tuple(name for name, kind in kinds.items() if kind in ("symmetry", "axis")),
        notes=(*notes, *_note_unpaired(kinds, regions)),
        **source.content.known,
    )
    cells = gathered(block[:2] for block in blocks)
    return checked_parts(points.copy(), cells, patches, source)


def _note_unpaired(kinds: dict[str, str], regions: list[str]) -> Iterator[str]:
    periodic = [name for name, kind in kinds.items() if kind.startswith("periodic")]
    if periodic:
        yield f"the periodic zones {', '.join(periodic)} are patches, and are not paired."
    yield from regions_note(regions if len(regions) > 1 else ())


def _check_faces(table: FaceTable, zones: list[FaceZone], n: int, count: int | None) -> None:
    if ZONE_KINDS[PARENT] in [zone.kind for zone in zones]:
        raise ValueError("a mesh that was adapted, with parents of faces, is not read.")
    labels = table.nodes.values
    cells = table.cells
    most = len(cells) if count is None else count
    if labels.min() < 1 or labels.max() > n:
        raise ValueError(f"a face names node {labels.max()}, but there are {n}.")
    if cells.min() < 0 or not 0 < cells.max(axis=1).min() <= cells.max() <= min(most, len(cells)):
        raise ValueError(
            f"a face is between cells {cells.min()} to {cells.max()}, but there are {most}; 0 is "
            "none."
        )
    found = len(np.unique(cells[cells > 0]))
    most = cells.max() if count is None else count
    if found != most:
        raise ValueError(f"{found} of {most} cells have faces: a damaged file.")


def _orient_faces(table: FaceTable, points: ndarray) -> Faces:
    """Makes faces that point out of their owner, the first cell unless there is none.

    Programs differ in the sense of faces: the signed size of the whole mesh tells it.
    """
    first, second = table.cells.T - 1
    rows = Ragged(table.nodes.values - 1, table.nodes.starts).turned(first < 0)
    labels = rows.values
    starts = rows.starts
    owner = np.where(first < 0, second, first)
    faces = Faces(labels, starts, owner, np.where(first < 0, -1, second))
    if points.shape[1] == 2 and (faces.sizes != 2).any():
        raise ValueError("faces of more than two nodes in a mesh of two dimensions.")
    here = points[labels]
    there = points[following(labels, starts)]
    is_outer = faces.neighbour < 0
    if points.shape[1] == 2:
        size = (here[::2, 0] * there[::2, 1] - here[::2, 1] * there[::2, 0])[is_outer].sum()
    else:
        areas = np.add.reduceat(np.cross(here, there), starts[:-1])
        size = np.einsum("fi,fi->f", areas, here[starts[:-1]])[is_outer].sum()
    if not np.isfinite(size):
        raise ValueError("coordinates of its nodes are not finite.")
    turned = faces.rows.turned(np.full(len(first), size < 0))
    return dataclasses.replace(faces, labels=turned.values)


def _join_edges(faces: Faces) -> tuple[list[tuple[str, ndarray, ndarray]], Polyhedra]:
    """Makes triangles and quads of edges that have their cell on the left."""
    ordered, begins = faces.of_cells()
    ends = faces.corners(ordered, 2)
    blocks = []
    for size in np.unique(np.diff(begins)).tolist():
        cells = np.flatnonzero(np.diff(begins) == size)
        edges = ends[begins[cells][:, None] + np.arange(size)]
        corners = np.repeat(edges[:, :1, 0], size, axis=1)
        for k in range(1, size):
            at = edges[:, :, 0] == corners[:, k - 1, None]
            corners[:, k] = edges[np.arange(len(cells)), at.argmax(axis=1), 1]
        ascending = np.sort(corners, axis=1)
        is_open = (ascending != np.sort(edges[:, :, 0], axis=1)) | (
            np.diff(ascending, prepend=-1) == 0
        )
        is_open = is_open.any(axis=1)
        if size not in (3, 4) or is_open.any():
            raise ValueError(
                f"{len(cells)} cells of {size} edges (first cell {cells[is_open.argmax()]}) are "
                "not read."
            )
        blocks.append((SIDE_TYPES[size], corners, cells))
    return blocks, Polyhedra(faces, np.zeros(0, np.int64))
