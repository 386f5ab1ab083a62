"""Zones of a CGNS file: nodes, cells, polyhedra (cgns.github.io, SIDS, HDF5 mapping)."""

import dataclasses
import functools
import pathlib
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from jaxmorph._host.cells import topology
from jaxmorph._host.cells.orders import CGNS_ORDER, reordered
from jaxmorph._host.ragged import Ragged
from jaxmorph._host.rows import Rows
from jaxmorph._mesh.faces import Faces
from jaxmorph._mesh.polyhedra import Polyhedra, cells_of_faces

from .._joined import join_rows, make_block_cells, make_block_sides, number_block
from .._text import decoded
from .._tree import Coordinates, read_text


class Block(NamedTuple):
    """Holds cells of one type by their corner ids (k, corners).

    `cell` (k,) is the number of the polyhedral cell that each is, or is a piece of; None for cells
    of other sections.
    """

    kind: str
    corners: ndarray
    cell: ndarray | None = None


def _find_cells_beside(numbers: ndarray, cells: list[Ragged]) -> ndarray:
    """Finds the cells (2, n) on both sides of faces by their `numbers`, -1 for none."""
    rows = join_rows(cells)
    used = rows.values
    face = Rows(numbers).of(np.abs(used))
    if (face < 0).any():
        raise ValueError("NFACE_n names faces that are in no section NGON_n")
    sides = np.full((2, len(numbers)), -1)
    sides[(used < 0).astype(int), face] = rows.row
    if (sides >= 0).sum() != len(used):
        raise ValueError("NFACE_n has faces on the same side of two cells")
    return sides


def _make_faces(corners: Ragged, sides: ndarray) -> Faces:
    """Makes faces of those that have a cell; one with a cell only behind it is turned round."""
    turned = (sides[0] < 0) & (sides[1] >= 0)
    has_cell = np.flatnonzero(sides.max(axis=0) >= 0)
    owner, neighbour = np.where(turned, sides[::-1], sides)[:, has_cell]
    rows = corners.turned(turned).take(has_cell)
    return Faces(rows.values, rows.starts, owner, neighbour)


CGNS_TYPES = topology.invert_table(
    topology.codes(
        "vertex 2 line 3 triangle 5 quad 7 tetra 10 pyramid 12 wedge 14 hexahedron 17 "
        "line3 4 triangle6 6 quad8 8 quad9 9 tetra10 11 pyramid14 13 wedge15 15 wedge18 16 "
        "hexahedron20 18 hexahedron27 19 pyramid13 21 "
        "line4 24 triangle10 26 quad16 28 tetra20 30 pyramid30 33 wedge40 36 hexahedron64 39 "
        "line5 40 triangle15 42 quad25 44 tetra35 47 pyramid55 50 wedge75 53 hexahedron125 56"
    )
)
"""Types of cells by CGNS's numbers."""
CGNS_SIZES = {number: topology.NODES.get(kind, 1) for number, kind in CGNS_TYPES.items()}
MIXED = 20
NGON = 22
NFACE = 23
CGNS_DIMENSIONS = {number: topology.DIMENSION.get(kind, 0) for number, kind in CGNS_TYPES.items()}


def find_children(group: Any, label: str, *inner: str) -> Iterator[tuple[str, Any]]:
    """Yields names and nodes of a label in a group, or of the last label in those of the others."""
    for name in group:
        child = group[name]
        if not hasattr(child, "keys") or read_text(child.attrs.get("label", b"")) != label:
            continue
        if inner:
            yield from find_children(child, *inner)
        else:
            # h5py: bytes unless UTF-8
            yield ((decoded(name) if isinstance(name, bytes) else name), child)


def find_first(group: Any, *labels: str) -> Any:
    return next((child for _, child in find_children(group, *labels)), None)


def read_data(group: Any) -> ndarray:
    return group[" data"][()]


def read_word(group: Any, default: str = "") -> str:
    return read_text(read_data(group)) if group is not None and " data" in group else default


class ElementSection(NamedTuple):
    section: str
    dimension: int
    vertices: Ragged
    is_of_faces: bool
    """True for polygons, and for polyhedra by their faces."""


class ZoneContent(NamedTuple):
    """Cells and boundary elements of a zone by type, all its elements, and known outer faces.

    `elements` stand by the number of their first one, `whole` has all polyhedral cells, and
    `dimension` is that of the base's cells.
    """

    blocks: list[Block]
    elements: dict[int, ElementSection]
    sides: Sequence[ndarray] = ()
    whole: Polyhedra | None = None
    dimension: int = 3


NO_CELLS = ZoneContent([], {})


@dataclasses.dataclass(eq=False)
class Condition:
    zone: str
    name: str
    node: Any
    family: str
    patch: str = ""

    @property
    def kind(self) -> str:
        return read_word(self.node)


@dataclasses.dataclass(eq=False)
class Zone:
    """A zone: its node in the file, sizes of vertices (one if unstructured), first node's id."""

    path: pathlib.Path
    name: str
    group: Any
    shape: tuple[int, ...]
    is_structured: bool
    first: int
    content: ZoneContent = NO_CELLS

    @functools.cached_property
    def conditions(self) -> list[Condition]:
        found = []
        for name, node in find_children(self.group, "ZoneBC_t", "BC_t"):
            family = read_word(find_first(node, "FamilyName_t"))
            found.append(Condition(self.name, name, node, family, family or name))
        return found

    @property
    def count(self) -> int:
        return int(np.prod(self.shape))

    @property
    def rows(self) -> slice:
        return slice(self.first, self.first + self.count)

    def outer_sections(self) -> list[ElementSection]:
        """Lists sections of faces of the zone's cells."""
        elements = self.content.elements.values()
        return [section for section in elements if section.dimension == self.content.dimension - 1]

    def error(self, message: str) -> ValueError:
        return ValueError(f"{self.path}, zone {self.name}: {message}.")

    def coordinates(self) -> list[Coordinates]:
        """Finds x, y[, z]. Raises `ValueError` for other coordinates, and for rind planes."""
        grids = dict(find_children(self.group, "GridCoordinates_t"))
        grid = grids.get("GridCoordinates", next(iter(grids.values()), None))
        if grid is None:
            raise self.error("no GridCoordinates")
        names = dict(find_children(grid, "DataArray_t"))
        sets = [
            names[f"Coordinate{axis}"][" data"] for axis in "XYZ" if f"Coordinate{axis}" in names
        ]
        if len(sets) < 2 or any(read_data(rind).any() for _, rind in find_children(grid, "Rind_t")):
            raise self.error(
                f"Cartesian coordinates without rind planes expected, found {', '.join(names)}"
            )
        wrong = {values.size for values in sets} - {self.count}
        if wrong:
            raise self.error(f"{min(wrong)} coordinates for {self.count} vertices")
        return [
            Coordinates(values, self.rows, slice(axis, axis + 1))
            for axis, values in enumerate(sets)
        ]

    def cells(self, points: ndarray) -> ZoneContent:
        if self.is_structured:
            ids = number_block(self.shape, self.first)
            if ids.ndim < 2:
                raise self.error(
                    f"a block of {' x '.join(map(str, self.shape))} vertices has no cells"
                )
            return ZoneContent([Block(*make_block_cells(ids))], {}, make_block_sides(ids))
        blocks = []
        elements = {}
        polygons: dict[int, tuple[Ragged, ndarray]] = {}
        volumes = []
        for name, node in find_children(self.group, "Elements_t"):
            section = _Section(self, name, node)
            if section.kind == NFACE:
                volumes.append(section.ragged(least=4))
                elements[section.start] = ElementSection(name, 3, volumes[-1], True)
            elif section.kind == NGON:
                rows = section.ragged(least=3)
                section.check(rows.values)
                polygons[section.start] = rows, section.parents(len(rows))
                nodes = Ragged(rows.values - 1 + self.first, rows.starts)
                elements[section.start] = ElementSection(name, 2, nodes, True)
            else:
                for begin, number, corners in section.runs():
                    ids = reordered(CGNS_TYPES[number], corners, CGNS_ORDER, None) - 1 + self.first
                    nodes = Ragged.of(ids.ravel(), np.full(len(ids), ids.shape[1]))
                    elements[begin] = ElementSection(name, CGNS_DIMENSIONS[number], nodes, False)
                    blocks.append(Block(CGNS_TYPES[number], ids))
        return self._with_polyhedra(ZoneContent(blocks, elements), polygons, volumes, points)

    def _with_polyhedra(
        self,
        content: ZoneContent,
        polygons: dict[int, tuple[Ragged, ndarray]],
        volumes: list[Ragged],
        points: ndarray,
    ) -> ZoneContent:
        """Adds the cells of NFACE_n, or else of the parents of faces, 0 for none.

        `polygons` are faces and their parents by the number of the first face.
        """
        if not polygons:
            return content
        corners, parents = zip(*polygons.values(), strict=True)
        parents = np.concatenate(parents)
        if not volumes and not parents.any():
            return content
        rows = join_rows(corners)
        rows = Ragged(rows.values - 1, rows.starts)
        numbers = [first + np.arange(len(own)) for first, (own, _) in polygons.items()]
        try:
            if volumes:
                sides = _find_cells_beside(np.concatenate(numbers), volumes)
            else:  # cells are numbered from 0 on, the number 0 of none becomes -1
                place = np.unique(np.append(0, parents), return_inverse=True)[1][1:]
                sides = place.reshape(parents.shape).T - 1
            faces = _make_faces(rows, sides)
            cells_by_type, whole = cells_of_faces(faces, points)
        except ValueError as error:
            raise self.error(str(error)) from error
        blocks = [Block(kind, corners + self.first, cell) for kind, corners, cell in cells_by_type]
        faces = dataclasses.replace(faces, labels=faces.labels + self.first)
        sizes = np.where(faces.neighbour < 0, faces.sizes, 0)
        outer = [
            faces.corners(np.flatnonzero(sizes == size), size)
            for size in np.unique(sizes[sizes > 0]).tolist()
        ]
        return content._replace(
            blocks=content.blocks + blocks, sides=outer, whole=Polyhedra(faces, whole.cut)
        )


class _Section:
    def __init__(self, zone: Zone, name: str, node: Any):
        self.zone = zone
        self.name = name
        self.node = node
        self.kind = int(read_data(node)[0])
        ends = read_data(node["ElementRange"]).astype(np.int64).ravel()
        self.start = int(ends[0])
        self.count = int(ends[-1] - ends[0]) + 1
        self.values = read_data(node["ElementConnectivity"]).astype(np.int64).ravel()

    def error(self, message: str) -> ValueError:
        return self.zone.error(f"section {self.name} {message}")

    def check(self, vertices: ndarray) -> None:
        if vertices.size and (vertices.min() < 1 or vertices.max() > self.zone.count):
            raise self.error(f"names vertices beyond 1 to {self.zone.count}")

    def ragged(self, least: int) -> Ragged:
        """Cuts the numbers into faces or cells, of `least` numbers or more each.

        Before version 4 of CGNS each row begins with its count, later offsets cut the numbers.
        """
        values = self.values
        if "ElementStartOffset" in self.node:
            rows = Ragged(
                values, read_data(self.node["ElementStartOffset"]).astype(np.int64).ravel()
            )
            fault = (
                f"the offsets of section {self.name} do not cut its {len(values)} numbers into "
                f"{self.count} rows"
            )
        else:
            rows = Ragged.counted(values)
            fault = (
                f"section {self.name} has no ElementStartOffset, and its {len(values)} numbers "
                f"are not {self.count} rows"
            )
        ends = rows.starts[[0, -1]].tolist()
        if len(rows) != self.count or ends != [0, len(rows.values)] or (rows.sizes < least).any():
            raise self.zone.error(
                f"{fault} of {least} numbers or more, each behind its count before version 4 of "
                "CGNS"
            )
        return rows

    def parents(self, count: int) -> ndarray:
        """Reads the numbers (count, 2) of the cells on both sides of each face, 0 for none."""
        cells = (
            read_data(self.node["ParentElements"])
            if "ParentElements" in self.node
            else np.zeros((2, count), np.int64)
        )
        if cells.shape != (2, count):
            raise self.error(f"has ParentElements for {cells.size // 2} of its {count} faces")
        return cells.T

    def runs(self) -> Iterator[tuple[int, int, ndarray]]:
        """Yields elements of one type after another: number of the first, type, vertices."""
        start = self.start
        at = 0
        values = self.values
        head = int(self.kind == MIXED)  # each element begins with its type
        while at < len(values):
            number = int(values[at]) if head else self.kind
            if number not in CGNS_SIZES:
                raise self.error(
                    f"has elements of type {number}; linear elements, those of order 2, of order "
                    "3 and 4 with all inner nodes, "
                    "and polyhedra are read"
                )
            width = head + CGNS_SIZES[number]
            rows = values[at : at + (len(values) - at) // width * width].reshape(-1, width)
            rows = rows[: np.argmax(np.append(rows[:, 0] != number, True))] if head else rows
            if not len(rows):
                break
            self.check(rows[:, head:])
            yield start, number, rows[:, head:]
            at = at + rows.size
            start = start + len(rows)
        if at != len(values):
            raise self.error(
                f"has {len(values)} numbers, of which the last {len(values) - at} are no whole "
                "element"
            )
        if start != self.start + self.count:
            raise self.error(f"has {start - self.start} elements, and the range of {self.count}")
