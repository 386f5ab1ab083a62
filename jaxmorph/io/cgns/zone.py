"""Zones of a CGNS file: cells, boundary conditions (cgns.github.io, SIDS, HDF5 mapping)."""

import dataclasses
import pathlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from jaxmorph._host.cells import topology
from jaxmorph._host.cells.orders import CGNS_ORDER, reordered
from jaxmorph._mesh.polyhedra import Polyhedra

from .._structured import block_cells, block_ids, block_sides
from .polyhedra import Block, Ragged, polyhedra

TYPES = {2: "vertex", 3: "line", 5: "triangle", 7: "quad", 10: "tetra", 12: "pyramid", 14: "wedge", 17: "hexahedron"}
TYPES |= {
    **{
        4: "line3",
        6: "triangle6",
        8: "quad8",
        9: "quad9",
        11: "tetra10",
        13: "pyramid14",
        15: "wedge15",
        16: "wedge18",
    },
    **{18: "hexahedron20", 19: "hexahedron27", 21: "pyramid13", 24: "line4", 26: "triangle10", 28: "quad16"},
    **{30: "tetra20", 33: "pyramid30", 36: "wedge40", 39: "hexahedron64", 40: "line5", 42: "triangle15"},
    **{44: "quad25", 47: "tetra35", 50: "pyramid55", 53: "wedge75", 56: "hexahedron125"},
}
PARTIAL = {25, 27, 29, 31, 32, 34, 35, 37, 38, 41, 43, 45, 46, 48, 49, 51, 52, 54, 55}
"""Elements of order 3 and 4 that lack nodes inside of the cell, or inside of faces too."""
NODES = {number: topology.NODES.get(kind, 1) for number, kind in TYPES.items()}
MIXED, NGON, NFACE = 20, 22, 23
DIMENSION = {number: topology.DIMENSION.get(kind, 0) for number, kind in TYPES.items()}
NORMAL = {"IFaceCenter": 0, "JFaceCenter": 1, "KFaceCenter": 2}


def children(group: Any, label: str) -> Iterator[tuple[str, Any]]:
    """Yields the nodes of a CGNS label below another one, in the order of the file."""
    for name in group:
        child = group[name]
        if hasattr(child, "keys") and text(child.attrs.get("label", b"")) == label:
            yield name, child


def text(value: Any) -> str:
    return bytes(value).split(b"\0")[0].decode(errors="replace").strip() if not isinstance(value, str) else value


def data(group: Any) -> np.ndarray:
    """Reads the array of a node."""
    return group[" data"][()]


def word(group: Any) -> str:
    """Reads the characters of a node."""
    return text(data(group).tobytes())


@dataclasses.dataclass(frozen=True, eq=False)
class Content:
    """Cells and boundary elements of a zone by type, known outer faces, and vertices of elements.

    The vertices stand by the number of their section's first element. `whole` has all polyhedral
    cells.
    """

    blocks: list[Block]
    sides: list[np.ndarray] = dataclasses.field(default_factory=list)
    elements: dict[int, Any] = dataclasses.field(default_factory=dict)
    whole: Polyhedra | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class Connection:
    """A periodic interface: its nodes, its donor's nodes, and a rotation's centre and angles.

    Centre and angles are zero for a translation.
    """

    name: str
    nodes: np.ndarray
    others: np.ndarray
    centre: np.ndarray
    angles: np.ndarray


@dataclasses.dataclass(frozen=True, eq=False)
class Zone:
    """A zone: its node in the file, sizes of vertices (one if unstructured), first node's id."""

    path: pathlib.Path
    name: str
    group: Any
    shape: tuple[int, ...]
    is_structured: bool
    first: int

    @property
    def count(self) -> int:
        return int(np.prod(self.shape))

    def error(self, message: str) -> ValueError:
        return ValueError(f"{self.path}, zone {self.name}: {message}.")

    def coordinates(self) -> list[Any]:
        """Returns the data sets of x, y[, z].

        It raises `ValueError` for other coordinates, rind planes, and those of another file.
        """
        grids = dict(children(self.group, "GridCoordinates_t"))
        if not grids:
            raise self.error("no GridCoordinates")
        grid = grids.get("GridCoordinates", next(iter(grids.values())))
        names = dict(children(grid, "DataArray_t"))
        wanted = [name for name in ("CoordinateX", "CoordinateY", "CoordinateZ") if name in names]
        if len(wanted) < 2 or any(data(rind).any() for _, rind in children(grid, "Rind_t")):
            raise self.error(f"Cartesian coordinates without rind planes expected, found {', '.join(names) or 'none'}")
        sets = [names[name][" data"] for name in wanted]
        for values in sets:
            if values.size != self.count:
                raise self.error(f"{values.size} coordinates for {self.count} vertices")
        return sets

    def cells(self, points: np.ndarray) -> Content:
        """Reads what the zone holds; `points` are its own."""
        if self.is_structured:
            ids = block_ids(self.shape, self.first)
            if ids.ndim < 2:
                raise self.error(f"a block of {' x '.join(map(str, self.shape))} vertices has no cells")
            return Content([Block(*block_cells(ids))], block_sides(ids))
        blocks, elements, polygons, volumes = [], {}, {}, []
        for name, section in children(self.group, "Elements_t"):
            parts = dict(section.items())
            kind, start = int(data(section)[0]), int(data(parts["ElementRange"])[0])
            connectivity = data(parts["ElementConnectivity"]).astype(np.int64)
            if kind in (NGON, NFACE):
                rows = self._ragged(name, parts, connectivity, least=3 if kind == NGON else 4)
                if kind == NFACE:
                    volumes.append(rows)
                    continue
                self._check(name, connectivity)
                polygons[start] = Ragged(connectivity - 1, rows.starts)
                elements[start] = Ragged(connectivity - 1 + self.first, rows.starts)
                continue
            for begin, number, corners in self._section(name, kind, connectivity, start):
                self._check(name, corners)
                corners = reordered(TYPES[number], corners, CGNS_ORDER, None)
                elements[begin] = corners - 1 + self.first
                blocks.append(Block(TYPES[number], elements[begin]))
        if not volumes or not polygons:
            return Content(blocks, elements=elements)
        try:
            more, sides, whole = polyhedra(polygons, volumes, points, self.first)
        except ValueError as error:
            raise self.error(str(error)) from error
        return Content(blocks + more, sides, elements, whole)

    def _ragged(self, name: str, parts: dict[str, Any], connectivity: np.ndarray, least: int) -> Ragged:
        """Cuts a section's numbers into its faces or cells, of `least` numbers or more each."""
        if "ElementStartOffset" not in parts:
            raise self.error(f"section {name} has no ElementStartOffset; cgnsupdate brings the file to version 4")
        rows = Ragged(connectivity, data(parts["ElementStartOffset"]).astype(np.int64))
        if rows.starts[0] != 0 or rows.starts[-1] != len(connectivity) or (np.diff(rows.starts) < least).any():
            raise self.error(
                f"the offsets of section {name} do not cut its {len(connectivity)} numbers into rows of {least} or more"
            )
        return rows

    def _check(self, name: str, vertices: np.ndarray) -> None:
        if vertices.size and (vertices.min() < 1 or vertices.max() > self.count):
            raise self.error(f"section {name} names vertices beyond 1 to {self.count}")

    def _known(self, name: str, number: int) -> None:
        if number in NODES:
            return
        what = f"section {name} has elements of type {number}"
        if number in PARTIAL:
            raise self.error(
                f"{what}, of order 3 or 4 without all inner nodes; of these orders complete elements are read"
            )
        raise self.error(f"{what}; linear elements, elements of order 2 to 4 and polyhedra are read")

    def _section(self, name: str, kind: int, values: np.ndarray, start: int):
        """Yields elements of one type after another: number of the first, type, vertices."""
        if kind != MIXED:
            self._known(name, kind)
            if len(values) % NODES[kind]:
                raise self.error(f"section {name} has {len(values)} vertices for elements of {NODES[kind]} each")
            yield start, kind, values.reshape(-1, NODES[kind])
            return
        at = 0
        while at < len(values):
            number = int(values[at])
            self._known(name, number)
            width = 1 + NODES[number]
            rows = values[at : at + (len(values) - at) // width * width].reshape(-1, width)
            other = np.flatnonzero(rows[:, 0] != number)
            count = int(other[0]) if other.size else len(rows)
            yield start, number, rows[:count, 1:]
            at, start = at + count * width, start + count

    def connections(
        self, elements: dict[int, Any], donors: Mapping[str, tuple["Zone", dict[int, Any]]]
    ) -> Iterator[Connection]:
        """Yields the periodic interfaces of the zone whose nodes are named on both sides."""
        for _, connectivity in children(self.group, "ZoneGridConnectivity_t"):
            for label in ("GridConnectivity1to1_t", "GridConnectivity_t"):
                for name, interface in children(connectivity, label):
                    groups = [group for _, group in children(interface, "GridConnectivityProperty_t")]
                    turns = [turn for group in groups for _, turn in children(group, "Periodic_t")]
                    parts, donor = dict(interface.items()), donors.get(word(interface).rpartition("/")[2])
                    what = [kind for kind in ("PointRange", "PointList") if {kind, f"{kind}Donor"} <= parts.keys()]
                    if not turns or not what or donor is None:
                        continue
                    place = word(parts["GridLocation"]) if "GridLocation" in parts else "Vertex"
                    sides = []
                    for part, (zone, corners) in zip(
                        (what[0], f"{what[0]}Donor"), ((self, elements), donor), strict=True
                    ):
                        chosen = np.atleast_2d(data(parts[part])).astype(np.int64)
                        sides.append(np.unique(zone._nodes(name, place, chosen, what[0] == "PointRange", corners)))
                    values = {
                        key: data(array).astype(float).ravel() for key, array in children(turns[0], "DataArray_t")
                    }
                    centre, angles = (values.get(key, np.zeros(3)) for key in ("RotationCenter", "RotationAngle"))
                    yield Connection(name, sides[0], sides[1], centre, angles)

    def conditions(self) -> Iterator[tuple[str, str, Any]]:
        """Yields each boundary condition's patch (its family, if any), its name and its node."""
        for _, zone_bc in children(self.group, "ZoneBC_t"):
            for name, condition in children(zone_bc, "BC_t"):
                family = [word(child) for _, child in children(condition, "FamilyName_t")]
                yield (family[0] if family else name), name, condition

    def patches(self, elements: dict[int, Any]) -> Iterator[tuple[str, np.ndarray]]:
        """Yields the patch and the nodes of each boundary condition."""
        for patch, name, condition in self.conditions():
            parts = dict(condition.items())
            places = [part for part in ("PointRange", "PointList", "ElementRange", "ElementList") if part in parts]
            if not places:
                raise self.error(f"boundary condition {name} says neither a range nor a list of points")
            place = word(parts["GridLocation"]) if "GridLocation" in parts else "Vertex"
            place = "FaceCenter" if places[0].startswith("Element") else place
            chosen = np.atleast_2d(data(parts[places[0]])).astype(np.int64)
            nodes = self._nodes(name, place, chosen, places[0].endswith("Range"), elements)
            yield patch, nodes

    def _nodes(self, name: str, place: str, chosen: np.ndarray, is_range: bool, elements) -> np.ndarray:
        # ranges may run backwards; one that ends before the first node, or a list without entries,
        # is empty
        first, last = chosen.reshape(2, -1) if is_range else (chosen, chosen)
        if not chosen.size or ((last < first) & (last < 1)).any():
            return np.zeros(0, np.int64)
        if self.is_structured:
            low, high = chosen.min(axis=0) - 1, chosen.max(axis=0) - 1
            if not is_range and place != "Vertex":
                raise self.error(f"boundary condition {name}: a list of faces of a structured zone is not read")
            if place != "Vertex":
                constant = NORMAL.get(place, int(np.argmax((low == high) & (np.array(self.shape) > 1))))
                high = high + (np.arange(len(high)) != constant)
            if (low < 0).any() or (high >= self.shape).any():
                raise self.error(f"boundary condition {name} goes beyond {' x '.join(map(str, self.shape))} vertices")
            ids = self.first + np.arange(self.count).reshape(self.shape, order="F")
            if is_range:
                return ids[tuple(slice(a, b + 1) for a, b in zip(low, high, strict=True))].ravel()
            return ids[tuple(chosen.T - 1)]
        chosen = chosen.ravel()
        numbers = np.arange(chosen.min(), chosen.max() + 1) if is_range else chosen
        if place == "Vertex":
            if numbers.min() < 1 or numbers.max() > self.count:
                raise self.error(f"boundary condition {name} names vertices beyond 1 to {self.count}")
            return numbers - 1 + self.first
        nodes, count = [np.zeros(0, np.int64)], 0
        for begin, corners in elements.items():
            rows = numbers[(numbers >= begin) & (numbers < begin + len(corners))] - begin
            count += len(rows)
            nodes.append(corners[rows].ravel())
        if count < len(numbers):
            raise self.error(
                f"boundary condition {name}: {len(numbers) - count} of its {len(numbers)} elements are not there"
            )
        return np.concatenate(nodes)
