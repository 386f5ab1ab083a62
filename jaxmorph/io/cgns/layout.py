"""CGNS files of one unstructured zone, some rows at a time."""

import contextlib
import pathlib
import shutil
from collections.abc import Iterator

import h5py
import numpy as np

import jaxmorph as jm

from .file import LEVEL, NAME, open_zones, pairs_of, periodic_of, refuse_foreign_data, stamp_of
from .zone import CORNERS, MIXED, NFACE, NGON, TYPES, Content, Zone, children, data

ROWS = 1 << 18
"""Points, or elements, read together."""


class Layout:
    """Knows where a file's points, cells and boundary conditions stand, and reads them some rows at a time. `d` is the dimension.

    Raises `ValueError` for several zones, structured ones, and polyhedra.
    """

    def __init__(self, path: pathlib.Path):
        path.open("rb").close()
        self.path, self.name, self._stamp = path, NAME, stamp_of(path)
        with self._zone() as (zone, level):
            coordinates = zone.coordinates()
            is_flat = level == 2 and (len(coordinates) == 2 or _is_constant(coordinates[2]))
            self.d, self._level = 2 if is_flat else 3, level
            if self.d != level:
                raise zone.error(f"cells of {level} dimensions in 3-D are not read by ranges")
            self.periodic: tuple[jm.Periodic, ...] = ()

    def points(self) -> Iterator[np.ndarray]:
        """Yields points (k, d)."""
        with self._zone() as (zone, _):
            first = 0
            for parts in zip(*map(_slices, zone.coordinates()[: self.d]), strict=True):
                points = np.stack(parts, axis=1).astype(float)
                bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
                if bad.size:
                    raise zone.error(f"node {first + bad[0]} is not finite: {points[bad[0]].tolist()}")
                yield points
                first += len(points)

    def cells(self, n: int) -> Iterator[dict[str, np.ndarray]]:
        """Yields corners (k, corners) by type, of cells between `n` points."""
        with self._zone() as (zone, level):
            for name, _, kind, section in _sections(zone):
                for number, corners in _elements(zone, name, kind, section):
                    if LEVEL.get(TYPES[number]) == level:
                        yield {TYPES[number]: corners - 1}

    def markers(self, n: int) -> dict[str, np.ndarray]:
        """Reads the nodes of each boundary condition, by family, and of each side of a periodic interface."""
        with self._zone() as (zone, level):
            elements: dict[int, np.ndarray] = {}
            for name, start, kind, section in _sections(zone):
                for number, corners in _elements(zone, name, kind, section):
                    if LEVEL.get(TYPES[number], 0) < level:
                        elements[start] = corners - 1
                    start += len(corners)
            patches: dict[str, list[np.ndarray]] = {}
            for name, nodes in zone.patches(elements):
                patches.setdefault(name, []).append(nodes)
            self.periodic = periodic_of(pairs_of([zone], [Content([], elements=elements)], patches), self.d == 2)
            return {name: np.concatenate(parts) for name, parts in patches.items()}

    def write(self, partial: pathlib.Path, before: np.ndarray, after: np.ndarray) -> None:
        """Writes a copy of the file with the points `after` (n, d) where they differ from those `before`."""
        if stamp_of(self.path) != self._stamp:
            raise ValueError(f"{self.path} has changed since the mesh was read from it; read it again.")
        with self._zone():
            pass  # data of other files are refused before anything is opened for writing
        shutil.copyfile(self.path, partial)
        with h5py.File(partial, "r+") as file:
            (zone,) = open_zones(partial, file)[0]
            for axis, values in enumerate(zone.coordinates()[: self.d]):
                for start in range(0, len(before), ROWS):
                    rows = slice(start, start + ROWS)
                    if not np.array_equal(before[rows, axis], after[rows, axis]):
                        values[rows] = np.where(
                            before[rows, axis] == after[rows, axis], values[rows], after[rows, axis]
                        )

    @contextlib.contextmanager
    def _zone(self) -> Iterator[tuple[Zone, int]]:
        """Opens the file, and yields its zone and the dimension of its cells."""
        try:
            with h5py.File(self.path, "r") as file:
                refuse_foreign_data(self.path, file)
                zones, level = open_zones(self.path, file)
                if len(zones) > 1 or zones[0].is_structured:
                    raise ValueError(
                        f"{self.path}: {len(zones)} zones, the first {'structured' if zones[0].is_structured else 'unstructured'}; "
                        "one unstructured zone is read by ranges. Take --chunk for others."
                    )
                if zones[0].coordinates()[0].ndim != 1:
                    raise zones[0].error("coordinates of an unstructured zone stand in one row")
                yield zones[0], level
        except Exception as error:  # HDF5 answers damage by a dozen classes
            if isinstance(error, ValueError) and str(self.path) in str(error):
                raise
            detail = " ".join(str(error).split())[:120]
            raise ValueError(f"{self.path}: not a CGNS file in HDF5, or a damaged one ({detail}).") from error


def _is_constant(values: h5py.Dataset) -> bool:
    return all((each == values[0]).all() for each in _slices(values))


def _slices(values: h5py.Dataset) -> Iterator[np.ndarray]:
    for start in range(0, len(values), ROWS):
        yield values[start : start + ROWS]


def _sections(zone: Zone) -> Iterator[tuple[str, int, int, h5py.Dataset]]:
    """Yields name, number of the first element, type and vertices of each section. Raises `ValueError` for polyhedra."""
    for name, section in children(zone.group, "Elements_t"):
        kind, parts = int(data(section)[0]), dict(section.items())
        if kind in (NGON, NFACE):
            raise zone.error("polyhedra are not read by ranges; take --chunk")
        if kind != MIXED and kind not in CORNERS:
            raise zone.error(f"section {name} has elements of type {kind}; linear elements are read, not curved ones")
        yield name, int(data(parts["ElementRange"])[0]), kind, parts["ElementConnectivity"][" data"]


def _elements(zone: Zone, name: str, kind: int, values: h5py.Dataset) -> Iterator[tuple[int, np.ndarray]]:
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
