"""CGNS files, some rows at a time."""

import contextlib
import pathlib
import shutil
from collections.abc import Iterator
from typing import Any

import numpy as np

import jaxmorph as jm
from jaxmorph._host.cells.pairs import columns_of, is_single, sorted_columns
from jaxmorph._host.cells.topology import SIDE_TYPES

from .._joined import Zones, join_nodes
from .._outer import outer_faces
from .._structured import block_cells, block_ids, block_sides
from .file import LEVEL, NAME, open_zones, pairs_of, periodic_of, stamp_of
from .kinds import kinds_of, symmetry_of
from .tree import opened
from .zone import CORNERS, MIXED, NFACE, NGON, TYPES, Content, Zone, children, data

ROWS = 1 << 18
"""Points, or elements, read together."""


class Layout:
    """Knows where a file's points, cells and boundary conditions stand, and reads them some rows at a time. `d` is the dimension.

    Nodes are those of the mesh that `read` makes, where zones are joined. Raises `ValueError` for polyhedra.
    """

    def __init__(self, path: pathlib.Path):
        path.open("rb").close()
        self.path, self.name, self._stamp = path, NAME, stamp_of(path)
        with self._zones() as (zones, level, kinds):
            self.d, self._level = 2 if level == 2 and _is_flat(zones) else 3, level
            if self.d != level:
                raise zones[0].error(f"cells of {level} dimensions in 3-D are not read by ranges")
            elements = [self._elements(zone) for zone in zones]
            patches: dict[str, list[np.ndarray]] = {}
            for zone, each in zip(zones, elements, strict=True):
                for name, nodes in zone.patches(each):
                    patches.setdefault(name, []).append(nodes)
            pairs = pairs_of(zones, [Content([], elements=each) for each in elements], patches)
            self.periodic: tuple[jm.Periodic, ...] = periodic_of(pairs, self.d == 2)
            self.kinds = kinds
            self.symmetry = symmetry_of(kinds)
            faces = [each for zone in zones for each in self._outer(zone, patches)]
            self._join(zones, patches, faces)

    def points(self) -> Iterator[np.ndarray]:
        """Yields points (k, d)."""
        with self._zones() as (zones, *_):
            for first, points in self._rows(zones):
                here = slice(*np.searchsorted(self._copies, [first, first + len(points)]))
                yield np.delete(points, self._copies[here] - first, axis=0) if len(self._copies) else points

    def cells(self, n: int) -> Iterator[dict[str, np.ndarray]]:
        """Yields corners (k, corners) by type, of cells between `n` points."""
        with self._zones() as (zones, *_):
            for zone in zones:
                for block in self._cells(zone):
                    yield {kind: self._in_mesh(corners + zone.first) for kind, corners in block.items()}

    def markers(self, n: int) -> dict[str, np.ndarray]:
        """Returns the nodes of each boundary condition, by family, of each side of a periodic interface, and of other faces."""
        return self._patches

    def outer(self, n: int, patches: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Returns the outer faces of the mesh by type."""
        return self._faces

    def write(self, partial: pathlib.Path, before: np.ndarray, after: np.ndarray) -> None:
        """Writes a copy of the file with the points `after` (n, d) where they differ from those `before`."""
        if stamp_of(self.path) != self._stamp:
            raise ValueError(f"{self.path} has changed since the mesh was read from it; read it again.")
        with self._zones():
            pass  # data of other files are refused before anything is opened for writing
        shutil.copyfile(self.path, partial)
        with opened(partial, writes=True) as file:
            for zone in open_zones(partial, file)[0]:
                for axis, values in enumerate(zone.coordinates()[: self.d]):
                    for rows, first, old in _slabs(values):
                        nodes = self._in_mesh(zone.first + first + np.arange(old.size))
                        a, b = (each[nodes, axis].reshape(old.shape) for each in (before, after))
                        if not np.array_equal(a, b):
                            values[rows] = np.where(a == b, old, b)

    @contextlib.contextmanager
    def _zones(self) -> Iterator[tuple[list[Zone], int, dict[str, str]]]:
        """Opens the file, and yields its zones, the dimension of their cells, and the kinds of its patches."""
        with opened(self.path) as file:
            zones, level = open_zones(self.path, file)
            yield zones, level, kinds_of(file, zones)

    def _rows(self, zones: list[Zone]) -> Iterator[tuple[int, np.ndarray]]:
        """Yields the points (k, d) of the file, and the number of the first of them."""
        for zone in zones:
            for parts in zip(*map(_slabs, zone.coordinates()[: self.d]), strict=True):
                first = zone.first + parts[0][1]
                points = np.stack([values.ravel() for _, _, values in parts], axis=1).astype(float)
                bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
                if bad.size:
                    raise zone.error(f"node {first + bad[0]} is not finite: {points[bad[0]].tolist()}")
                yield first, points

    def _elements(self, zone: Zone) -> dict[int, np.ndarray]:
        """Reads the boundary elements of a zone: nodes of the file by the number of the first."""
        elements: dict[int, np.ndarray] = {}
        for name, start, kind, section in _sections(zone):
            for number, corners in _elements(zone, name, kind, section):
                if LEVEL.get(TYPES[number], 0) < self._level:
                    elements[start] = corners - 1 + zone.first
                start += len(corners)
        return elements

    def _cells(self, zone: Zone) -> Iterator[dict[str, np.ndarray]]:
        """Yields the cells of a zone between its own nodes."""
        if zone.is_structured:
            *sizes, last = (size for size in zone.shape if size > 1)
            layer = int(np.prod(sizes))
            step = max(ROWS // layer, 1)
            for start in range(0, last - 1, step):
                stop = min(start + step + 1, last)
                kind, corners = block_cells(block_ids((*sizes, stop - start), start * layer))
                yield {kind: corners}
        for name, _, kind, section in _sections(zone):
            for number, corners in _elements(zone, name, kind, section):
                if LEVEL.get(TYPES[number]) == self._level:
                    yield {TYPES[number]: corners - 1}

    def _outer(self, zone: Zone, patches: dict[str, list[np.ndarray]]) -> list[np.ndarray]:
        """Finds the outer faces of a zone. Raises `ValueError` for one without cells."""
        if zone.is_structured:
            ids = block_ids(zone.shape, zone.first)
            sides = block_sides(ids) if ids.ndim == self._level else []
            # every other one is seen from inside
            faces = [side if (number + 1) // 2 % 2 else side[:, ::-1] for number, side in enumerate(sides)]
        else:
            local = {name: np.concatenate(parts) - zone.first for name, parts in patches.items()}
            here = {name: nodes[(nodes >= 0) & (nodes < zone.count)] for name, nodes in local.items()}
            faces = [each + zone.first for each in outer_faces(lambda: self._cells(zone), zone.count, here).values()]
        if not any(map(len, faces)):
            raise zone.error(f"no cells of {self._level} dimensions")
        return faces

    def _join(self, zones: list[Zone], patches: dict[str, list[np.ndarray]], faces: list[np.ndarray]) -> None:
        """Keeps patches, outer faces, and which nodes of the file are `_copies` of others, their `_originals`."""
        named = [each for parts in patches.values() for each in parts]
        nodes = np.unique(np.concatenate([each.ravel() for each in (*named, *faces)]))
        points = np.zeros((len(nodes), self.d))
        for first, block in self._rows(zones):
            here = slice(*np.searchsorted(nodes, [first, first + len(block)]))
            points[here] = block[nodes[here] - first]
        local = {name: [np.searchsorted(nodes, each) for each in parts] for name, parts in patches.items()}
        sides = [np.searchsorted(nodes, each) for each in faces]
        kept, node, joined = join_nodes(Zones(points, [], local, sides))
        original = nodes[kept[node]]
        self._copies, self._originals = nodes[original != nodes], original[original != nodes]
        self._patches = {name: self._in_mesh(nodes[kept[each]]) for name, each in joined.items()}
        self._faces = {}
        for size in sorted({corners.shape[1] for corners in faces}):
            corners = self._in_mesh(np.concatenate([each for each in faces if each.shape[1] == size]))
            alone = is_single(sorted_columns(columns_of(corners), size))
            self._faces[SIDE_TYPES[size]] = corners[alone]

    def _in_mesh(self, ids: np.ndarray) -> np.ndarray:
        """Numbers nodes of the file as those of the mesh."""
        if not len(self._copies):
            return ids
        at = np.minimum(np.searchsorted(self._copies, ids), len(self._copies) - 1)
        ids = np.where(self._copies[at] == ids, self._originals[at], ids)
        return ids - np.searchsorted(self._copies, ids)


def _is_flat(zones: list[Zone]) -> bool:
    """Tells whether z is the same everywhere, or there is none."""
    heights = [zone.coordinates()[2] for zone in zones if len(zone.coordinates()) > 2]
    return all((part == heights[0][(0,) * heights[0].ndim]).all() for each in heights for _, _, part in _slabs(each))


def _slabs(values: Any) -> Iterator[tuple[slice, int, np.ndarray]]:
    """Yields rows of an array, the number of their first entry, and the entries."""
    width = int(np.prod(values.shape[1:]))
    step = max(ROWS // width, 1)
    for start in range(0, len(values), step):
        rows = slice(start, start + step)
        yield rows, start * width, values[rows]


def _sections(zone: Zone) -> Iterator[tuple[str, int, int, Any]]:
    """Yields name, number of the first element, type and vertices of each section. Raises `ValueError` for polyhedra."""
    for name, section in children(zone.group, "Elements_t"):
        kind, parts = int(data(section)[0]), dict(section.items())
        if kind in (NGON, NFACE):
            raise zone.error("polyhedra are not read by ranges; take --chunk")
        if kind != MIXED and kind not in CORNERS:
            raise zone.error(f"section {name} has elements of type {kind}; linear elements are read, not curved ones")
        yield name, int(data(parts["ElementRange"])[0]), kind, parts["ElementConnectivity"][" data"]


def _elements(zone: Zone, name: str, kind: int, values: Any) -> Iterator[tuple[int, np.ndarray]]:
    """Yields the type and the vertices (k, corners), from 1, of elements of a section, in its order."""
    width = 8 if kind == MIXED else CORNERS[kind]
    rest = np.zeros(0, np.int64)
    for start in range(0, len(values), ROWS * width):
        numbers = np.concatenate([rest, values[start : start + ROWS * width].astype(np.int64)])
        done = 0
        while done < len(numbers):
            number = int(numbers[done]) if kind == MIXED else kind
            if number not in CORNERS:
                raise zone.error(f"section {name} has elements of type {number} among MIXED ones")
            step = CORNERS[number] + (kind == MIXED)
            rows = numbers[done : done + (len(numbers) - done) // step * step].reshape(-1, step)
            if not len(rows):
                break
            other = np.flatnonzero(rows[:, 0] != number) if kind == MIXED else rows[:0]
            count = int(other[0]) if len(other) else len(rows)
            corners = rows[:count, step - CORNERS[number] :]
            if corners.min() < 1 or corners.max() > zone.count:
                raise zone.error(f"section {name} names vertices beyond 1 to {zone.count}")
            yield number, corners
            done += count * step
        rest = numbers[done:]
    if len(rest):
        raise zone.error(f"section {name} ends within an element")
