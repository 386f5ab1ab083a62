"""I-deas's universal files, .unv, of Salome, gmsh and FEMAP: nodes, elements and their groups.

A dataset stands between lines of -1, its number first. Nodes are in 2411 and 781, elements in 2412,
groups in eight datasets, systems of coordinates in 2420 (SDRC's "Universal Dataset Number ...").
"""

import collections
import dataclasses
import functools
import itertools
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy import ndarray

from jaxmorph._host.cells.orders import VTK_ORDER, reordered
from jaxmorph._host.cells.topology import digits
from jaxmorph._host.ragged import heads_of
from jaxmorph._mesh.exchange import Parts, gathered

from ._format import note_unread, of_grid
from ._places import KIND_BY_NODES, CoordinatePart, LabelledCells, PlacedPoints, make_labelled_grid
from ._text import Section, decoded, parse

NAME = "I-deas"
GROUP_DATASETS = {2417: 2, 2429: 2, 2430: 2, 2432: 2, 2435: 4, 2452: 4, 2467: 4, 2477: 4}
"""Datasets of groups, and how many numbers each of their members has."""
OLD_DATASETS = {15: "nodes", 18: "systems of coordinates", 71: "elements", 780: "elements"}
"""Older datasets of what changes the mesh."""
QUIET_DATASETS = (151, 164)
"""Datasets of the file's author and units."""
IDEAS_PLACES = {
    "line3": "021",
    "triangle6": "024135",
    "quad8": "02461357",
    "tetra10": "0249135678",
    "wedge15": "0249bd135ace678",
    "hexahedron20": "0246cegi1357dfhj89ab",
}
"""The places of I-deas's nodes in VTK's order: I-deas goes around, from corner to middle."""
ELEMENT_RANGES = ((11, 39, 1), (41, 109, 2), (111, 118, 3))
"""First and last type of the elements of each dimension; others are springs, masses and rods."""
IDEAS_COLUMNS = 25
"""Columns of a coordinate, 1P3D25.16."""

_DATASET_END = re.compile(rb"^[ \t]{0,4}-1[ \t]*\r?$", re.MULTILINE)

_NUMBER = re.compile(rb"\s*(\d{1,6})(?:b[^\n]*)?[ \t\r]*\n")


def read(path: Path) -> Parts:
    """Reads points, cells and patches: groups of nodes and of elements of lower dimension.

    Without groups the numbers of properties name patches, `patch_3`.
    """
    text = path.read_bytes()
    sections: dict[int, list[Section]] = collections.defaultdict(list)
    for n, section in _read_datasets(path, text):
        sections[n].append(section)
    old = [f"{OLD_DATASETS[n]} of dataset {n}" for n in sections if n in OLD_DATASETS]
    if old:
        raise ValueError(f"{', '.join(old)} are not read; those of 2411, 2412 and 2420 are.")
    content, nodes = _read_node_tables(text, sections[2411] + sections[781])
    _check_systems(nodes[:, 1], sections[2420])
    elements = [*itertools.chain(*map(_read_element_blocks, sections[2412]))]
    groups = [
        each for n in GROUP_DATASETS for section in sections[n] for each in _read_groups(section, n)
    ]
    sets = {
        what: gathered((name, ids[ids[:, 0] == code, 1]) for name, ids in groups)
        for code, what in ((7, "nodes"), (8, "elements"))
    }
    sets["nodes"] = {name: ids for name, ids in sets["nodes"].items() if len(ids)}
    grid, notes = make_labelled_grid(
        content.points, nodes[:, 0], [cells for cells, _ in elements], sets
    )
    if not groups:
        grid = dataclasses.replace(
            grid, cell_data={"patch": [properties for _, properties in elements]}
        )
    known = (2411, 781, 2412, 2420, *GROUP_DATASETS, *QUIET_DATASETS)
    notes += note_unread("datasets ", (str(n) for n in sections if n not in known))
    if others := sum(int((~np.isin(ids[:, 0], (7, 8))).sum()) for _, ids in groups):
        notes += (f"{others} members of groups are no nodes or elements, and are not read.",)
    return of_grid(path, NAME, content, grid, notes=notes, labels=nodes[:, 0])


def _read_datasets(path: Path, text: bytes) -> Iterator[tuple[int, Section]]:
    """Yields number and rows of each dataset; nothing but blanks may stand between two of them."""
    ends = list(_DATASET_END.finditer(text))
    between = [text[a.end() : b.start()] for a, b in zip(ends[1::2], ends[2::2], strict=False)]
    between += [text[: ends[0].start()], text[ends[-1].end() :]] if ends else [text]
    if len(ends) % 2 or b"".join(between).strip():
        raise ValueError("lines of -1 around each dataset expected; it is cut short or damaged.")
    for begin, end in zip(ends[::2], ends[1::2], strict=True):
        number = _NUMBER.match(text, begin.end(), end.start())
        if number is None:
            raise Section(path, text, begin.end(), end.start()).error("no number of a dataset.", 0)
        yield int(number[1]), Section(path, text, number.end(), end.start())


def _read_node_tables(text: bytes, sections: list[Section]) -> tuple[PlacedPoints, ndarray]:
    """Reads points, and labels and systems of coordinates (n, 2)."""
    parts = []
    tables = [np.zeros((0, 7))]
    first = 0
    for section in sections:
        rows = section.rows(np.float64)
        k = np.arange(len(rows.counts))
        rows.refuse(rows.counts != np.where(k % 2, 3, 4), "a node: 4 numbers, then x, y and z.")
        if len(k) % 2:
            raise section.error("a node without coordinates.", len(k) - 1)
        table = rows.values.reshape(-1, 7)
        parts.append(CoordinatePart.in_columns(section, table.shape, slice(4, 7), first))
        tables.append(table)
        first += len(table)
    table = np.concatenate(tables)
    letter = "E" if any(b"E" in section.content[:200] for section in sections) else "D"
    form = {}
    if all(map(_is_fixed, sections)):
        form = {"form": functools.partial(_format_columns, letter), "columns": IDEAS_COLUMNS}
    return PlacedPoints(table[:, 4:].copy(), text, parts, **form), table[:, :2].astype(np.int64)


def _is_fixed(section: Section) -> bool:
    """Finds whether coordinates fill their columns, which programs read by place."""
    rows = [row.rstrip() for row in section.content.split(b"\n")][1::2]
    return all(len(row) == 3 * IDEAS_COLUMNS and row[24:25].isdigit() for row in rows)


def _format_columns(letter: str, values: ndarray) -> bytes:
    rows = "\n".join([f"{value:{IDEAS_COLUMNS}.16E}" for value in values.tolist()])
    return rows.replace("E", letter).encode()


def _check_systems(used: ndarray, sections: list[Section]) -> None:
    """Refuses nodes in a system of coordinates that is not the global Cartesian one, 0 or 1."""
    good = {0, 1}
    for section in sections:
        lines = section.content.rstrip().split(b"\n")[2:]  # behind number and name of the part
        for at in range(0, len(lines), 6):
            label, kind, *_ = parse(lines[at], np.int64).tolist() or [0, -1]
            matrix = parse(b" ".join(lines[at + 2 : at + 6]), np.float64)
            is_global = kind == 0 and np.array_equal(matrix, np.eye(4, 3).ravel())
            good = good | {label} if is_global else good - {label}
    wrong = used[~np.isin(used, [*good])]
    if len(wrong):
        raise ValueError(
            f"{len(wrong)} nodes are in the system of coordinates {wrong[0]} (dataset 2420), which "
            "is not the global Cartesian one: write them in that one."
        )


def _read_element_blocks(section: Section) -> Iterator[tuple[LabelledCells, ndarray]]:
    """Yields the elements of each type, and their numbers of properties.

    An element is a row of label, type, property, material, colour and its number of nodes. Of a
    beam a row of three numbers follows. Then come the nodes, eight a row.
    """
    rows = section.rows(np.int64)
    total = len(rows.counts)
    if not total:
        return
    counts = np.append(rows.counts, [0, 0])
    head = rows.values[np.minimum(rows.first[:, None] + np.arange(6), len(rows.values) - 1)]
    size = np.clip(head[:, 5], 1, len(rows.values))
    level = np.zeros(total, np.int64)
    for first, last, dimension in ELEMENT_RANGES:
        level[(first <= head[:, 1]) & (head[:, 1] <= last)] = dimension
    has_axis = (level == 1) & (counts[1:-1] == 3) & ((size == 2) | (counts[2:] == 3))
    # Each row, taken for an element's first, tells how many rows the element has: from the first
    # row on one goes from element to element.
    steps = (1 + has_axis - (-size // 8)).tolist()
    which = heads_of(np.arange(total), steps.__getitem__)
    start = rows.first[which] + 6 + 3 * has_axis[which]
    words = np.append(rows.first, len(rows.values))[np.append(which, total)][1:] - start
    is_bad = (counts[which] != 6) | (words != size[which]) | (head[which, 5] < 1)
    rows.refuse(which[is_bad], "an element of 6 numbers, and its nodes, eight a row, expected.")
    for dimension, n in np.unique(np.stack([level[which], size[which]]), axis=1).T.tolist():
        chosen = (level[which] == dimension) & (size[which] == n)
        table = head[which[chosen]]
        kind = KIND_BY_NODES.get((dimension, n))
        if kind is None:
            raise section.error(f"elements of type {table[0, 1]} with {n} nodes are not read.")
        corners = rows.values[start[chosen, None] + np.arange(n)]
        if kind in IDEAS_PLACES:
            corners = reordered(kind, corners[:, *digits(IDEAS_PLACES[kind])], VTK_ORDER, None)
        yield LabelledCells(kind, table[:, 0], corners), table[:, 2]


def _read_groups(section: Section, dataset: int) -> Iterator[tuple[str, ndarray]]:
    """Yields name, and kinds (7: node, 8: element) and labels (k, 2) of members of each group."""
    lines = section.content.rstrip().split(b"\n")
    width = GROUP_DATASETS[dataset]
    at = 0
    while at < len(lines):
        head = parse(lines[at], np.int64).tolist()
        count = head[-1] if len(head) in (7, 8) else -1
        stop = at + 2 - (-max(count, 0) * width // 8)
        ids = parse(b" ".join(lines[at + 2 : stop]), np.int64)
        if count < 0 or len(ids) < count * width or stop > len(lines):
            raise section.error(f"a group of {count} members expected, found {len(ids)} numbers.")
        name = decoded(lines[at + 1].strip()) or f"group_{head[0]}"
        yield name, ids[: count * width].reshape(-1, width)[:, :2]
        at = stop
