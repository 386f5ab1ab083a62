"""Zones of a CGNS file: nodes, cells, polyhedra (cgns.github.io, SIDS, HDF5 mapping)."""

import dataclasses
import pathlib
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from jaxmorph._host.cells import topology
from jaxmorph._host.cells.orders import CGNS_ORDER, reordered
from jaxmorph._mesh.faces import Faces
from jaxmorph._mesh.polyhedra import Polyhedra, cells_of_faces, spread

from .._joined import block_cells, block_ids, block_sides
from .._text import decoded
from .._tree import Coordinates


@dataclasses.dataclass(frozen=True, eq=False)
class Ragged:
    """Rows of different lengths: all `values`, and where each row begins (one more `start`)."""

    values: np.ndarray
    starts: np.ndarray

    def __len__(self) -> int:
        return len(self.starts) - 1

    def __getitem__(self, rows: np.ndarray) -> np.ndarray:
        return self.values[spread(self.starts[rows], self.starts[rows + 1])[0]]


class Block(NamedTuple):
    """Holds cells of one type by their corner ids (k, corners).

    `cell` (k,) is the number of the polyhedral cell that each is, or is a piece of; None for cells
    of other sections.
    """

    kind: str
    corners: np.ndarray
    cell: np.ndarray | None = None


def polyhedra(
    polygons: dict[int, Ragged], cells: list[Ragged], points: np.ndarray, first: int
) -> tuple[list[Block], list[np.ndarray], Polyhedra]:
    """Makes cells by type, others as tetrahedra between own nodes; outer faces; and whole cells.

    `polygons` are faces by the number of the first, vertices from 0. `first` is the id of vertex 0,
    `points` are the zone's points.
    """
    cells_by_type, whole = cells_of_faces(_faces(polygons, cells), points)
    blocks = [Block(kind, corners + first, cell) for kind, corners, cell in cells_by_type]
    faces = dataclasses.replace(whole.faces, labels=whole.faces.labels + first)
    sizes = np.where(faces.neighbour < 0, np.diff(faces.starts), 0)
    outer = [faces.corners(np.flatnonzero(sizes == size), size) for size in np.unique(sizes[sizes > 0]).tolist()]
    return blocks, outer, Polyhedra(faces, whole.cut)


def _faces(polygons: dict[int, Ragged], cells: list[Ragged]) -> Faces:
    """Joins all sections' faces, with the cells on both sides; refuses missing and surplus ones."""
    begins = np.concatenate([begin + np.arange(len(rows)) for begin, rows in sorted(polygons.items())])
    parts = [rows for _, rows in sorted(polygons.items())]
    labels = np.concatenate([rows.values for rows in parts])
    starts = np.concatenate([[0], np.cumsum(np.concatenate([np.diff(rows.starts) for rows in parts]))])
    used = np.concatenate([rows.values for rows in cells])
    cell = np.repeat(np.arange(sum(map(len, cells))), np.concatenate([np.diff(rows.starts) for rows in cells]))
    face = np.searchsorted(begins, np.abs(used))
    if (face >= len(begins)).any() or (begins[np.minimum(face, len(begins) - 1)] != np.abs(used)).any():
        raise ValueError("NFACE_n names faces that are in no section NGON_n")
    sides = np.full((2, len(begins)), -1)
    sides[(used < 0).astype(int), face] = cell
    if (sides >= 0).sum() != len(used):
        raise ValueError("NFACE_n has faces on the same side of two cells")
    # a face that only a cell behind it has is turned round: its labels are gathered backwards
    turned = (sides[0] < 0) & (sides[1] >= 0)
    rows_of_cells = np.flatnonzero((sides >= 0).any(axis=0))
    rows, which = spread(starts[rows_of_cells], starts[rows_of_cells + 1])
    back = (starts[rows_of_cells] + starts[rows_of_cells + 1] - 1)[which] - rows
    rows = np.where(turned[rows_of_cells][which], back, rows)
    return Faces(
        labels[rows],
        np.concatenate([[0], np.cumsum(np.diff(starts)[rows_of_cells])]),
        np.where(turned, sides[1], sides[0])[rows_of_cells],
        np.where(turned, -1, sides[1])[rows_of_cells],
    )


TYPES = {2: "vertex", 3: "line", 5: "triangle", 7: "quad", 10: "tetra", 12: "pyramid", 14: "wedge", 17: "hexahedron"}
TYPES |= {
    **{4: "line3", 6: "triangle6", 8: "quad8", 9: "quad9", 11: "tetra10", 13: "pyramid14", 15: "wedge15"},
    16: "wedge18",
    **{18: "hexahedron20", 19: "hexahedron27", 21: "pyramid13", 24: "line4", 26: "triangle10", 28: "quad16"},
    **{30: "tetra20", 33: "pyramid30", 36: "wedge40", 39: "hexahedron64", 40: "line5", 42: "triangle15"},
    **{44: "quad25", 47: "tetra35", 50: "pyramid55", 53: "wedge75", 56: "hexahedron125"},
}
PARTIAL = {25, 27, 29, 31, 32, 34, 35, 37, 38, 41, 43, 45, 46, 48, 49, 51, 52, 54, 55}
"""Elements of order 3 and 4 that lack nodes inside of the cell, or inside of faces too."""
NODES = {number: topology.NODES.get(kind, 1) for number, kind in TYPES.items()}
MIXED, NGON, NFACE = 20, 22, 23
DIMENSION = {number: topology.DIMENSION.get(kind, 0) for number, kind in TYPES.items()}


def children(group: Any, label: str) -> Iterator[tuple[str, Any]]:
    for name in group:
        child = group[name]
        if hasattr(child, "keys") and text(child.attrs.get("label", b"")) == label:
            yield (decoded(name) if isinstance(name, bytes) else name), child  # h5py: bytes unless UTF-8


def text(value: Any) -> str:
    return decoded(bytes(value).split(b"\0")[0]).strip() if not isinstance(value, str) else value


def data(group: Any) -> np.ndarray:
    return group[" data"][()]


def word(group: Any, default: str = "") -> str:
    """Reads the text of a node, if there is one with data."""
    return text(data(group).tobytes()) if group is not None and " data" in group else default


@dataclasses.dataclass(frozen=True, eq=False)
class Elements:
    section: str
    dimension: int
    vertices: Any


@dataclasses.dataclass(frozen=True, eq=False)
class Content:
    """Cells and boundary elements of a zone by type, known outer faces, and all its elements.

    `elements` stand by the number of their first one, `whole` has all polyhedral cells, and
    `dimension` is that of the base's cells.
    """

    blocks: list[Block]
    sides: list[np.ndarray] = dataclasses.field(default_factory=list)
    elements: dict[int, Elements] = dataclasses.field(default_factory=dict)
    whole: Polyhedra | None = None
    dimension: int = 3


@dataclasses.dataclass(eq=False)
class Condition:
    zone: str
    name: str
    node: Any
    family: str
    patch: str = ""

    @property
    def kind(self) -> str:
        return word(self.node)


@dataclasses.dataclass(eq=False)
class Zone:
    """A zone: its node in the file, sizes of vertices (one if unstructured), first node's id."""

    path: pathlib.Path
    name: str
    group: Any
    shape: tuple[int, ...]
    is_structured: bool
    first: int
    content: Content = dataclasses.field(default_factory=lambda: Content([]))
    conditions: list[Condition] = dataclasses.field(default_factory=list)

    @property
    def count(self) -> int:
        return int(np.prod(self.shape))

    @property
    def rows(self) -> slice:
        return slice(self.first, self.first + self.count)

    def outer_sections(self) -> list[Elements]:
        """Lists sections of faces of the zone's cells."""
        elements = self.content.elements.values()
        return [section for section in elements if section.dimension == self.content.dimension - 1]

    def error(self, message: str) -> ValueError:
        return ValueError(f"{self.path}, zone {self.name}: {message}.")

    def coordinates(self) -> list[Coordinates]:
        """Finds x, y[, z]. Raises `ValueError` for other coordinates, and for rind planes."""
        grids = dict(children(self.group, "GridCoordinates_t"))
        if not grids:
            raise self.error("no GridCoordinates")
        grid = grids.get("GridCoordinates", next(iter(grids.values())))
        names = dict(children(grid, "DataArray_t"))
        sets = [names[f"Coordinate{axis}"][" data"] for axis in "XYZ" if f"Coordinate{axis}" in names]
        if len(sets) < 2 or any(data(rind).any() for _, rind in children(grid, "Rind_t")):
            raise self.error(f"Cartesian coordinates without rind planes expected, found {', '.join(names) or 'none'}")
        for values in sets:
            if values.size != self.count:
                raise self.error(f"{values.size} coordinates for {self.count} vertices")
        return [Coordinates(values, self.rows, slice(axis, axis + 1)) for axis, values in enumerate(sets)]

    def cells(self, points: np.ndarray) -> Content:
        if self.is_structured:
            ids = block_ids(self.shape, self.first)
            if ids.ndim < 2:
                raise self.error(f"a block of {' x '.join(map(str, self.shape))} vertices has no cells")
            return Content([Block(*block_cells(ids))], block_sides(ids))
        blocks, elements, polygons, volumes, parents = [], {}, {}, [], []
        for name, node in children(self.group, "Elements_t"):
            section = _Section(self, name, node)
            if section.kind == NFACE:
                volumes.append(section.ragged(least=4))
                elements[section.start] = Elements(name, 3, volumes[-1])
            elif section.kind == NGON:
                faces = section.ragged(least=3)
                section.check(faces.values)
                polygons[section.start] = Ragged(faces.values - 1, faces.starts)
                elements[section.start] = Elements(name, 2, Ragged(faces.values - 1 + self.first, faces.starts))
                parents += section.parents(len(faces))
            else:
                for begin, number, corners in section.runs():
                    ids = reordered(TYPES[number], corners, CGNS_ORDER, None) - 1 + self.first
                    elements[begin] = Elements(name, DIMENSION[number], ids)
                    blocks.append(Block(TYPES[number], ids))
        volumes = volumes or _cells_of(parents)
        if not volumes or not polygons:
            return Content(blocks, elements=elements)
        try:
            more, outer, whole = polyhedra(polygons, volumes, points, self.first)
        except ValueError as error:
            raise self.error(str(error)) from error
        return Content(blocks + more, outer, elements, whole)


class _Section:
    def __init__(self, zone: Zone, name: str, node: Any):
        self.zone, self.name, self.node, self.kind = zone, name, node, int(data(node)[0])
        ends = data(node["ElementRange"]).astype(np.int64).ravel()
        self.start, self.count = int(ends[0]), int(ends[-1] - ends[0]) + 1
        self.values = data(node["ElementConnectivity"]).astype(np.int64).ravel()

    def error(self, message: str) -> ValueError:
        return self.zone.error(f"section {self.name} {message}")

    def check(self, vertices: np.ndarray) -> None:
        if vertices.size and (vertices.min() < 1 or vertices.max() > self.zone.count):
            raise self.error(f"names vertices beyond 1 to {self.zone.count}")

    def ragged(self, least: int) -> Ragged:
        """Cuts the numbers into faces or cells, of `least` numbers or more each.

        Before version 4 of CGNS each row begins with its count, later offsets cut the numbers.
        """
        count = len(self.values)
        if "ElementStartOffset" in self.node:
            rows = Ragged(self.values, data(self.node["ElementStartOffset"]).astype(np.int64).ravel())
            is_good = rows.starts[0] == 0 and rows.starts[-1] == count
            fault = f"the offsets of section {self.name} do not cut its {count} numbers into rows of {least} or more"
        else:
            rows = _counted(self.values)
            is_good, rest = len(rows) == self.count, f"rows of a count, {least} or more, and so many numbers"
            fault = (
                f"section {self.name} has no ElementStartOffset, and its {count} numbers are not {self.count} {rest}"
            )
        if not is_good or (np.diff(rows.starts) < least).any():
            raise self.zone.error(fault)
        return rows

    def parents(self, count: int) -> list[np.ndarray]:
        """Lists pairs (k, 2) of cell and face, the face negative where it points into the cell."""
        if "ParentElements" not in self.node:
            return []
        cells = data(self.node["ParentElements"])
        if cells.shape != (2, count):
            raise self.error(f"has ParentElements for {cells.size // 2} of its {count} faces")
        number = self.start + np.arange(count)
        pairs = np.stack([cells.astype(np.int64).ravel(), np.concatenate([number, -number])], axis=1)
        return [pairs[pairs[:, 0] > 0]]

    def runs(self) -> Iterator[tuple[int, int, np.ndarray]]:
        """Yields elements of one type after another: number of the first, type, vertices."""
        start, at, values = self.start, 0, self.values
        head = int(self.kind == MIXED)  # each element begins with its type
        while at < len(values):
            number = int(values[at]) if head else self.kind
            width = head + self._size(number)
            rows = values[at : at + (len(values) - at) // width * width].reshape(-1, width)
            other = np.flatnonzero(rows[:, 0] != number) if head else rows[:0, 0]
            rows = rows[: other[0]] if other.size else rows
            if not len(rows):
                break
            self.check(rows[:, head:])
            yield start, number, rows[:, head:]
            at, start = at + rows.size, start + len(rows)
        if at != len(values):
            raise self.error(f"has {len(values)} numbers, of which the last {len(values) - at} are no whole element")
        if start != self.start + self.count:
            raise self.error(f"has {start - self.start} elements, and the range of {self.count}")

    def _size(self, number: int) -> int:
        if number in NODES:
            return NODES[number]
        what = f"has elements of type {number}"
        if number in PARTIAL:
            raise self.error(
                f"{what}, of order 3 or 4 without all inner nodes; of these orders complete elements are read"
            )
        raise self.error(f"{what}; linear elements, elements of order 2 to 4 and polyhedra are read")


def _counted(values: np.ndarray) -> Ragged:
    """Cuts numbers into rows that begin with their count; none where the counts do not fit."""
    counts, at, numbers = [], 0, values.tolist()
    while 0 <= at < len(numbers):
        counts.append(at)
        at += numbers[at] + 1 if numbers[at] >= 0 else len(numbers) + 1
    if at != len(numbers):
        return Ragged(values, np.zeros(1, np.int64))
    return Ragged(np.delete(values, counts), np.concatenate([[0], np.cumsum(values[counts])]))


def _cells_of(sides: list[np.ndarray]) -> list[Ragged]:
    if not sides:
        return []
    pairs = np.concatenate(sides)
    pairs = pairs[np.argsort(pairs[:, 0], kind="stable")]
    starts = np.concatenate([np.flatnonzero(np.diff(pairs[:, 0], prepend=-1)), [len(pairs)]])
    return [Ragged(pairs[:, 1], starts)]
