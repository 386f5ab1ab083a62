"""Exodus files of Cubit and MOOSE, netCDF-4 or classic: copies with other coordinates."""

import dataclasses
import pathlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from jaxmorph._mesh.exchange import Grid, Parts, Patch, regions_note

from ._format import MeshLike
from ._text import decoded
from ._tree import Coordinates, of_tree, opened, points_of, write_points

NAME = "Exodus"
WHAT = "an Exodus file"
_EDGES = {n: [[i, (i + 1) % n] for i in range(n)] for n in (3, 4)}
_SHELLS = {n: [list(range(n)), list(range(n)), *_EDGES[n]] for n in (3, 4)}
TYPES = {
    ("TRI", 3): ("triangle", _EDGES[3]),
    ("QUA", 4): ("quad", _EDGES[4]),
    ("SHE", 3): ("triangle", _SHELLS[3]),
    ("SHE", 4): ("quad", _SHELLS[4]),
    ("TET", 4): ("tetra", [[0, 1, 3], [1, 2, 3], [0, 2, 3], [0, 1, 2]]),
    ("PYR", 5): ("pyramid", [[0, 1, 4], [1, 2, 4], [2, 3, 4], [0, 3, 4], [0, 1, 2, 3]]),
    ("WED", 6): ("wedge", [[0, 1, 4, 3], [1, 2, 5, 4], [0, 2, 5, 3], [0, 1, 2], [3, 4, 5]]),
    ("HEX", 8): (
        "hexahedron",
        [[0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [0, 3, 7, 4], [0, 1, 2, 3], [4, 5, 6, 7]],
    ),
} | {(name, 2): ("line", [[0, 1]] * 2) for name in ("BAR", "BEA", "TRU", "EDG", "ROD", "SHE")}
TYPES |= {(name, 1): ("vertex", []) for name in ("SPH", "CIR", "POI", "NOD")}
"""Types of cells by first letters and node counts of Exodus's types, and corners of each side."""

_SETS = (("ss", "num_side_sets", "elem_ss", "sides"), ("ns", "num_node_sets", "node_ns", "nodes"))
"""Of side sets and node sets: their prefix, their number, the array of members, and our word."""
_UNREAD = {"num_edge_sets": "edge sets", "num_face_sets": "face sets", "num_elem_sets": "element sets"}
_UNREAD |= {"num_ed_blk": "blocks of edges", "num_fa_blk": "blocks of faces"}


@dataclasses.dataclass(frozen=True, eq=False)
class _Block:
    """Elements of one type between `corners`, called `name`, and the corners of their sides.

    Without a name it is called `own`.
    """

    name: str
    own: str
    kind: str
    corners: np.ndarray
    sides: list[list[int]]


def read(path: pathlib.Path) -> Parts:
    """Reads points, cells and patches: side sets, node sets, blocks of lower dimension.

    A set without a name is called by its kind and its number. Of several sets and blocks of one
    name the first one has it, others add their kind and number.
    """
    with opened(path, what=WHAT) as file:
        coordinates = list(_coordinates(file))
        d = file["num_dim"].shape[0]
        points = points_of(coordinates, file["num_nodes"].shape[0], d)
        blocks = list(_blocks(path, file, d))
        _check_count(file, "num_elem", sum(len(block.corners) for block in blocks))
        grid = Grid(points, [(block.kind, block.corners) for block in blocks], {}, {})
        patches = [Patch(block.name, block.own, block.corners) for *_, block in grid.of_blocks(blocks)]
        patches += [*_sets(file, _SETS[0], blocks), *_sets(file, _SETS[1], blocks)]
        for name, _, nodes in patches:
            if len(nodes) and not 0 <= nodes.min() <= nodes.max() < len(points):
                raise ValueError(f"{name} has nodes {nodes.min() + 1} to {nodes.max() + 1} of {len(points)}")
        notes = _notes(file, [block for *_, block in grid.of_blocks(blocks, full=True)])
        return of_tree(path, NAME, coordinates, grid, patches, notes)


def write(path: pathlib.Path, mesh: MeshLike) -> None:
    """Writes a copy of the file that the mesh was read from."""
    write_points(path, mesh, NAME, _coordinates, WHAT)


def _coordinates(file: Mapping[str, Any]) -> Iterator[Coordinates]:
    """Finds the coordinates of each direction: arrays of their own, or the rows of one."""
    if "coord" in file:
        yield Coordinates(file["coord"], slice(None), slice(None))
        return
    names = [name for name in ("coordx", "coordy", "coordz") if name in file]
    _check_count(file, "num_dim", len(names))
    for axis, name in enumerate(names):
        yield Coordinates(file[name], slice(None), slice(axis, axis + 1))


def _check_count(file: Mapping[str, Any], name: str, count: int) -> None:
    if file[name].shape != (count,):
        raise ValueError(f"{name} is {file[name].shape[0]}, and {count} are found")


def _blocks(path: pathlib.Path, file: Mapping[str, Any], dimension: int) -> Iterator[_Block]:
    """Yields the blocks of elements. A block that the file has no array of is empty."""
    numbers, names = _names(file, "eb", file["num_el_blk"].shape[0])
    if len(numbers) > len(names):
        raise ValueError(f"{len(numbers)} numbers of blocks, {len(names)} expected")
    for at, name in enumerate(names, start=1):
        array = _array(file, "connect", at, "eb")
        if array is None:
            continue
        kind, corners = _text(array.attrs["elem_type"]), array[()].astype(np.int64) - 1
        width = corners.shape[1] if corners.ndim == 2 else 0
        if (kind.upper()[:3], width) not in TYPES:
            size = f" with {width} nodes" if width else ""
            raise ValueError(f"{path}: elements of type {kind[:40]}{size}; linear ones are read (HEX8, WEDGE6, ...).")
        ours, sides = TYPES[kind.upper()[:3], width]
        # triangles of a mesh in space have sides as shells have, quads have not
        is_shell = ours == "triangle" and dimension == 3
        own = f"block_{_number(numbers, at)}"
        yield _Block(name or own, own, ours, corners, _SHELLS[3] if is_shell else sides)


def _notes(file: Mapping[str, Any], solid: list[_Block]) -> Iterator[str]:
    if len(solid) > 1 or any(block.name != block.own for block in solid):
        yield from regions_note(block.name for block in solid)
    for dimension, what in _UNREAD.items():
        if dimension in file:
            yield f"{file[dimension].shape[0]} {what} are not read, and stay in the file."


def _sets(file: Mapping[str, Any], kind: tuple[str, str, str, str], blocks: list[_Block]) -> Iterator[Patch]:
    what, dimension, array, own = kind
    numbers, names = _names(file, what, file[dimension].shape[0] if dimension in file else 0)
    for at, name in enumerate(names, start=1):
        members = _array(file, array, at, what)
        rows = np.zeros(0, np.int64) if members is None else members[()].astype(np.int64) - 1
        if what == "ss" and len(rows):
            rows = _nodes(blocks, rows, file[f"side_ss{at}"][()].astype(np.int64) - 1)
        own_name = f"{own}_{_number(numbers, at)}"
        yield Patch(name or own_name, own_name, rows)


def _array(file: Mapping[str, Any], name: str, at: int, what: str) -> Any:
    """Finds a block's or set's array; None if it is empty: its status, if given, is 0."""
    array, status = file.get(f"{name}{at}"), file.get(f"{what}_status")
    if array is None and status is not None and status[()][at - 1]:
        raise ValueError(f"there is no {name}{at}")
    return array


def _names(file: Mapping[str, Any], what: str, count: int) -> tuple[np.ndarray, list[str]]:
    numbers = file[f"{what}_prop1"][()] if f"{what}_prop1" in file else np.zeros(0, int)
    names = [_text(row) for row in file[f"{what}_names"][()]] if f"{what}_names" in file else [""] * count
    if len(names) != count:
        raise ValueError(f"{len(names)} names in {what}_names, {count} expected")
    return numbers, names


def _number(numbers: np.ndarray, at: int) -> int:
    return int(numbers[at - 1]) if at <= len(numbers) else at


def _nodes(blocks: list[_Block], cells: np.ndarray, sides: np.ndarray) -> np.ndarray:
    starts = np.cumsum([0, *(len(block.corners) for block in blocks)])
    if cells.shape != sides.shape or cells.min() < 0 or cells.max() >= starts[-1]:
        raise ValueError(f"a set of sides of elements {cells.min() + 1} to {cells.max() + 1} of {starts[-1]}")
    found = []
    for block, start in zip(blocks, starts, strict=False):
        inside = (cells >= start) & (cells < start + len(block.corners))
        for side in np.unique(sides[inside]):
            if not 0 <= side < len(block.sides):
                raise ValueError(f"side {side + 1} of a {block.kind} in a set of sides")
            found.append(block.corners[cells[inside & (sides == side)] - start][:, block.sides[side]].ravel())
    return np.unique(np.concatenate(found))


def _text(value: Any) -> str:
    """Reads text from bytes, or from an array of characters that ends with zeros."""
    if isinstance(value, str):
        return value
    return decoded(np.asarray(value).tobytes().split(b"\0")[0]).strip()
