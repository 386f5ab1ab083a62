"""Exodus files of Cubit and MOOSE, netCDF-4 or classic: copies with other coordinates."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from jaxmorph._host.cells.lagrange import inner_places, lagrange_types
from jaxmorph._host.cells.orders import CGNS_ORDER, NodeOrder, reordered
from jaxmorph._host.cells.topology import (
    CORNERS,
    FACES,
    NODES,
    SHAPES,
    digits,
    numbers_by_name,
    pairs_of,
)
from jaxmorph._host.ragged import Ragged
from jaxmorph._host.rows import join_ids
from jaxmorph._mesh.exchange import Grid, Parts, Patch, regions_note

from ._format import of_grid
from ._tree import Coordinates, TreePoints, open_tree, read_labels, read_text

NAME = "Exodus"
EXODUS_FILE = "an Exodus file"
Tree = Mapping[str, Any]
"""The file's arrays by name."""
EXODUS_TYPES = pairs_of(
    "TRI triangle QUA quad TET tetra PYR pyramid WED wedge HEX hexahedron "
    "BAR line BEA line TRU line EDG line ROD line SPH vertex CIR vertex POI vertex NOD vertex"
)
_SHELLS = {1: "vertex", 2: "line", 3: "triangle", 4: "quad", 6: "triangle", 8: "quad", 9: "quad"}
"""Shapes of cells by first letters of Exodus's types; of shells by their number of nodes."""

EXODUS_SIDES = numbers_by_name(
    {
        "tetra": "013 123 023 012",
        "pyramid": "014 124 234 034 0123",
        "wedge": "0143 1254 0253 012 345",
        "hexahedron": "0154 1265 2376 0374 0123 4567",
    }
)
"""Corners of each side, by the shape; cells in 2-D have those of `FACES`."""

EXODUS_ORDER = NodeOrder(
    CGNS_ORDER.edges,
    {**CGNS_ORDER.faces, "hexahedron": digits("0321 4567 0374 1265 0154 2376")},
    inner_places,
)
"""The manual's order; of hexahedra of 27 nodes the middle one comes before those of the faces."""

_SETS = (
    (("ss", "elem_ss", "sides"), "num_side_sets"),
    (("ns", "node_ns", "nodes"), "num_node_sets"),
)
"""Of side sets and node sets: their prefix, the array of members, our word; and their number."""
UNREAD_SETS = {
    "num_edge_sets": "edge sets",
    "num_face_sets": "face sets",
    "num_elem_sets": "element sets",
    "num_ed_blk": "blocks of edges",
    "num_fa_blk": "blocks of faces",
}


class _Block(NamedTuple):
    """Elements of one type between `corners`, called `name` (else `own`); nodes of their sides."""

    name: str
    own: str
    kind: str
    corners: ndarray
    sides: list[ndarray]


def read(path: Path) -> Parts:
    """Reads points, cells and patches: side sets, node sets, blocks of lower dimension.

    An unnamed set is called by its kind and number; so is a duplicate name, but the first.
    """
    with open_tree(path, what=EXODUS_FILE) as file:
        content = TreePoints.of(path, file, _find_coordinates, EXODUS_FILE)
        n, d = content.points.shape
        _check_length(file, "num_dim", d)
        _check_length(file, "num_nodes", n)
        blocks = list(_read_blocks(path, file, d))
        _check_length(file, "num_elem", sum(len(block.corners) for block in blocks))
        grid = Grid(content.points, [(block.kind, block.corners) for block in blocks], {}, {})
        patches = [
            Patch(block.name, block.own, block.corners) for *_, block in grid.of_blocks(blocks)
        ]
        patches += [
            patch for what, number in _SETS for patch in _read_sets(file, what, number, blocks)
        ]
        notes = _note_unread_sets(file, [block for *_, block in grid.of_blocks(blocks, full=True)])
        labels = read_labels(file, "node_num_map", n)
        return of_grid(path, NAME, content, grid, patches, notes, labels=labels)


def _find_coordinates(file: Tree) -> Iterator[Coordinates]:
    if "coord" in file:
        d, n = file["coord"].shape
        yield Coordinates(file["coord"], slice(0, n), slice(0, d))
        return
    names = [name for name in ("coordx", "coordy", "coordz") if name in file]
    for axis, name in enumerate(names):
        yield Coordinates(file[name], slice(0, file[name].size), slice(axis, axis + 1))


def _check_length(file: Tree, name: str, count: int) -> None:
    if file[name].shape != (count,):
        raise ValueError(f"{name} is {file[name].shape[0]}, and {count} are found")


def _read_blocks(path: Path, file: Tree, dimension: int) -> Iterator[_Block]:
    """Yields the blocks of elements. A block that the file has no array of is empty."""
    for _, name, own, array in _read_entries(file, ("eb", "connect", "block"), "num_el_blk"):
        if array is None:
            continue
        kind = read_text(array.attrs["elem_type"])
        corners = array[()].astype(np.int64) - 1
        width = corners.shape[-1] if corners.ndim == 2 else 0
        letters = kind.upper()[:3]
        shape = (EXODUS_TYPES | {"SHE": _SHELLS.get(width, "")}).get(letters, "")
        ours = shape if width == CORNERS.get(shape, 1) else f"{shape}{width}"
        if ours not in (*NODES, "vertex"):
            what = f"elements of type {kind[:40]} with {width} nodes"
            raise ValueError(
                f"{path}: {what} are not read; of order 1 and 2 are (HEX8, HEX20, ...)."
            )
        if ours == "hexahedron27":
            corners = np.concatenate([corners[:, :20], corners[:, 21:], corners[:, 20:21]], axis=1)
        # triangles of a mesh in space have sides as shells have, quads have not
        is_shell = letters == "SHE" or (letters == "TRI" and dimension == 3)
        sides = [] if ours == "vertex" else _list_sides(ours, is_shell)
        yield _Block(name, own, ours, reordered(ours, corners, EXODUS_ORDER, None), sides)


def _list_sides(kind: str, is_shell: bool) -> list[ndarray]:
    """Lists the nodes of each side in a cell; a shell has two faces before its edges."""
    cell = lagrange_types()[kind]
    shape = SHAPES[kind]
    whole = np.arange(len(cell.lattice))
    if shape == "line":
        return [whole, whole]
    return [whole, whole] * is_shell + [
        cell.side(corners) for corners in EXODUS_SIDES.get(shape, FACES[shape])
    ]


def _note_unread_sets(file: Tree, solid: list[_Block]) -> Iterator[str]:
    if len(solid) > 1 or any(block.name != block.own for block in solid):
        yield from regions_note(block.name for block in solid)
    for dimension, what in UNREAD_SETS.items():
        if dimension in file:
            yield f"{file[dimension].shape[0]} {what} are not read, and stay in the file."


def _read_sets(
    file: Tree, what: tuple[str, str, str], number: str, blocks: list[_Block]
) -> Iterator[Patch]:
    for at, name, own, members in _read_entries(file, what, number):
        rows = join_ids([] if members is None else [members[()]]).astype(np.int64) - 1
        if what[0] == "ss" and len(rows):
            rows = _nodes_of_sides(blocks, rows, file[f"side_ss{at}"][()].astype(np.int64) - 1)
        yield Patch(name, own, rows)


def _read_entries(
    file: Tree, what: tuple[str, str, str], number: str
) -> Iterator[tuple[int, str, str, Any]]:
    """Yields place, name, own name, array of blocks or sets; None for empty ones, of status 0."""
    prefix, array, word = what
    count = file[number].shape[0] if number in file else 0
    defaults = {"prop1": np.arange(1, count + 1), "names": [""] * count, "status": np.zeros(count)}
    numbers, names, status = (
        file[f"{prefix}_{name}"][()] if f"{prefix}_{name}" in file else default
        for name, default in defaults.items()
    )
    if not len(numbers) == len(names) == len(status) == count:
        raise ValueError(
            f"{len(numbers)} numbers and {len(names)} names of {word}, {count} expected"
        )
    for at in range(count):
        own = f"{word}_{numbers[at]}"
        values = file.get(f"{array}{at + 1}")
        if values is None and status[at]:
            raise ValueError(f"there is no {array}{at + 1}")
        yield at + 1, read_text(names[at]) or own, own, values


def _nodes_of_sides(blocks: list[_Block], cells: ndarray, sides: ndarray) -> ndarray:
    sizes = [len(block.corners) for block in blocks]
    elements = Ragged.of(np.arange(sum(sizes)), sizes)
    starts = elements.starts
    if cells.shape != sides.shape or cells.min() < 0 or cells.max() >= starts[-1]:
        raise ValueError(
            f"a set of sides of elements {cells.min() + 1} to {cells.max() + 1} of {starts[-1]}"
        )
    found = []
    of_block = elements.row[cells]
    for at, side in np.unique(np.column_stack([of_block, sides]), axis=0).tolist():
        block = blocks[at]
        if not 0 <= side < len(block.sides):
            raise ValueError(f"side {side + 1} of a {block.kind} in a set of sides")
        rows = cells[(of_block == at) & (sides == side)] - starts[at]
        found.append(block.corners[rows][:, block.sides[side]].ravel())
    return np.concatenate(found)
