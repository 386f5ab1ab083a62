"""MFEM's .mesh, versions 1.0 to 1.3, of order 1 and 2 (mfem.org/mesh-formats)."""

import functools
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from jaxmorph._host.cells.lagrange import inner_places, lagrange_types, node_keys, of_order
from jaxmorph._host.cells.orders import NodeOrder, reordered
from jaxmorph._host.cells.topology import CORNERS, DIMENSION, EDGES, numbers_by_name
from jaxmorph._host.rows import first_of_equals
from jaxmorph._mesh.exchange import Parts, checked_parts, gathered, regions_note

from ._format import ArraysByName, Source
from ._places import CoordinatePart, PlacedPoints
from ._text import Section, blank_out, decoded, split_sections

MFEM_ORDER = NodeOrder(
    EDGES | numbers_by_name({"tetra": "01 02 03 12 13 23"}),
    numbers_by_name({"tetra": "123 032 013 021", "hexahedron": "3210 0154 1265 2376 3047 4567"}),
    inner_places,
)
"""The order in which MFEM numbers edges and faces; a face has its first cell's corners."""


class AttributedCells(NamedTuple):
    """Elements of one type: corners (k, c), their rows in the file, and their attributes."""

    kind: str
    corners: ndarray
    rows: ndarray
    attributes: ndarray


Elements = list[AttributedCells]


def number_nodes(
    cells: Elements, sides: Elements, order: int, count: int
) -> tuple[list[ndarray], int]:
    """Numbers the nodes as H1 does: vertices, edges, faces, inside of cells, in the file's order.

    `order` is 1 or 2, `count` the number of vertices. Returns the nodes of the cells and of the
    sides, and the number of all nodes.
    """
    elements = [*cells, *sides]
    if order == 1:
        return [each.corners for each in elements], count
    keys = [
        node_keys(each.corners, of_order(each.kind, 2))[:, each.corners.shape[1] :].reshape(-1, 16)
        for each in elements
    ]
    _, place = first_of_equals(np.concatenate(keys))
    ends = np.cumsum([len(key) for key in keys])[:-1]
    new = [
        part.reshape(len(each.corners), -1)
        for each, part in zip(elements, np.split(place, ends), strict=True)
    ]
    # MFEM lists new nodes cell by cell: those of all edges, then of faces, then inside of cells
    levels = [_list_levels(each, ids) for each, ids in zip(cells, new, strict=False)]
    listed = np.concatenate([_sort_as_file(cells, level) for level in zip(*levels, strict=True)])
    first = np.sort(np.unique(listed, return_index=True)[1])
    number = np.full(place.max() + 1, -1)
    number[listed[first]] = count + np.arange(len(first))
    nodes = [
        np.concatenate([each.corners, number[ids]], axis=1)
        for each, ids in zip(elements, new, strict=True)
    ]
    return nodes, count + len(first)


def _list_levels(cells: AttributedCells, new: ndarray) -> list[ndarray]:
    """Lists new nodes of order 2 in MFEM's order: on edges, on faces, inside."""
    size = cells.corners.shape[1]
    every = np.concatenate([cells.corners, new], axis=1)
    listed = reordered(of_order(cells.kind, 2).name, every, None, MFEM_ORDER)[:, size:]
    inside = len(inner_places(cells.kind, 2))
    edges = len(MFEM_ORDER.edges[cells.kind])
    return np.split(listed, [edges, listed.shape[1] - inside], axis=1)


def _sort_as_file(cells: Elements, tables: Iterable[ndarray]) -> ndarray:
    """Joins the rows (k, m) of several types, as these take turns in the file."""
    tables = list(tables)
    rows = [np.repeat(each.rows, table.shape[1]) for each, table in zip(cells, tables, strict=True)]
    ids = np.concatenate([table.ravel() for table in tables])
    return ids[np.argsort(np.concatenate(rows), kind="stable")]


NAME = "MFEM"
GEOMETRIES = ("point", "line", "triangle", "quad", "tetra", "hexahedron", "wedge", "pyramid")
"""Types by MFEM's numbers, whose corners are in VTK's order."""
MFEM_SIZES = {number: CORNERS.get(kind, 1) for number, kind in enumerate(GEOMETRIES)}
SAME_NODE = 1e-8
"""Distance of duplicates in L2, as a share of the mesh's extent."""
_SPACE = (
    rb"\s*FiniteElementSpace\s+FiniteElementCollection:\s*(\S+)"
    rb"\s+VDim:\s*(\d{1,9})\s+Ordering:\s*([01])\b"
)


class Space(NamedTuple):
    """The finite element space of the coordinates: order, and dimension `d` of its values.

    - `section`: where the numbers are, behind `skipped` others; `by_nodes`: all x come first.
    - `vertices`: how many the mesh has. `is_torn`: cells have nodes of their own (L2_T1).
    """

    section: Section
    vertices: int
    order: int
    d: int
    by_nodes: bool = False
    is_torn: bool = False
    skipped: int = 0

    def content(self, text: bytes, node: ndarray, total: int) -> PlacedPoints:
        """Reads the coordinates, of which each is one of the mesh's `total` nodes: `node` (m,)."""
        numbers = self.section.rows(np.float64).values[self.skipped :]
        first = np.unique(node, return_index=True)[1]
        if self.d not in (2, 3) or len(numbers) != len(node) * self.d or len(first) < total:
            raise self.section.error(
                f"{len(node)} nodes of 2 or 3 coordinates expected, found {len(numbers)} numbers "
                f"for {self.d}."
            )
        rows = numbers.reshape(self.d, -1).T if self.by_nodes else numbers.reshape(-1, self.d)
        distance = np.abs(rows - rows[first][node]).max()
        if not distance <= SAME_NODE * np.ptp(rows, axis=0).max():
            raise self.section.error(
                f"nodes of cells that meet are {distance:.3g} apart; periodic meshes are not read."
            )
        section = self.section
        at = np.arange(len(numbers)) + self.skipped
        part = CoordinatePart(section.start, section.stop, at=at, by_columns=self.by_nodes)
        return PlacedPoints(rows, text, [part], _blank_hash_lines, node=node)


def read(path: Path) -> Parts:
    """Reads cells, nodes, and patches: attributes of boundary elements, `boundary_3`, and sets."""
    text = path.read_bytes()
    parts = _name_sections(path, text)
    space = _read_space(parts)
    cells, sides = (
        _read_attributed(parts[name], space.vertices) for name in ("elements", "boundary")
    )
    if {DIMENSION[each.kind] for each in cells} not in ({2}, {3}):
        raise parts["elements"].error("cells of 2-D alone, or of 3-D alone, expected.")
    if space.order > 1 and "pyramid" in [each.kind for each in cells]:
        raise space.section.error("pyramids of order 2 and more are not read.")
    ids, total = number_nodes(cells, sides, space.order, space.vertices)
    nodes = {
        of_order(each.kind, space.order).name: rows for each, rows in zip(cells, ids, strict=False)
    }
    node = np.arange(total)
    if space.is_torn:  # cell by cell, the first coordinate fastest
        tables = [
            rows[:, np.lexsort(lagrange_types()[kind].lattice.T)] for kind, rows in nodes.items()
        ]
        node = _sort_as_file(cells, tables)
    content = space.content(text, node, total)
    is_flat = content.is_flat and DIMENSION[cells[0].kind] == 2
    points = content.points[np.unique(node, return_index=True)[1], : 2 if is_flat else 3]
    patches = _gather_attributes(sides, ids[len(cells) :])
    source = Source(
        path,
        NAME,
        content,
        cell_ids=np.concatenate([each.rows for each in cells]),
        groups=_group_patches(parts.get("boundary_attribute_sets"), patches),
        notes=tuple(_note_regions(cells, parts)),
    )
    return checked_parts(points, nodes, patches, source)


_blank_hash_lines = functools.partial(blank_out, rb"(?m)^[ \t]*#[^\r\n]*")


def _name_sections(path: Path, text: bytes) -> dict[str, Section]:
    head = decoded(text[:64].split(b"\n")[0].strip())
    if not re.fullmatch(r"MFEM mesh v1\.[0-3]", head):
        raise ValueError(f"MFEM mesh v1.0 to v1.3 expected in the first line, found {head[:40]!r}.")
    words = rb"(?m)^[ \t]*([a-z_]+)[ \t]*\r?$"
    parts = {
        word[1].decode(): section
        for word, section in split_sections(path, _blank_hash_lines(text), words)
    }
    missing = [name for name in ("elements", "boundary", "vertices") if name not in parts]
    missing += ["line mfem_mesh_end"] * (
        head[-1] in "23" and [*parts][-1:] in (["vertices"], ["nodes"])
    )
    if missing:
        raise ValueError(f"no {', '.join(missing)} in this file; it is cut short.")
    return parts


def _read_attributed(section: Section, count: int) -> Elements:
    """Reads rows of attribute, type and corners, type by type; points of a boundary are none."""
    message = "a number of elements expected, and as many rows of attribute, type and corners."
    rows = section.rows(np.int64).behind_count(message)
    found = sorted(rows.by_kind(1, MFEM_SIZES, count), key=lambda kind: kind[0])
    return [
        AttributedCells(GEOMETRIES[kind], each[:, 2:], at, each[:, 0])
        for kind, at, each in found
        if kind
    ]


def _read_space(parts: dict[str, Section]) -> Space:
    vertices = parts["vertices"]
    section = parts.get("nodes")
    count, *rest = [*map(int, vertices.rows(np.float64).values[:2])] or [-1]
    if not 0 <= count <= len(vertices.text):
        raise vertices.error(
            f"{count:.6g} vertices do not fit into a file of {len(vertices.text)} bytes."
        )
    if section is None:
        return Space(vertices, count, 1, sum(rest), skipped=2)
    head = re.match(_SPACE, section.content)
    if head is None:
        raise section.error(
            "FiniteElementSpace with its FiniteElementCollection, VDim and Ordering expected."
        )
    name = {b"Linear": "H1_P1", b"Quadratic": "H1_P2"}.get(head[1], decoded(head[1]))
    known = re.fullmatch(r"(H1|L2_T1)_(?:[23]D_)?P([12])", name)
    if known is None:
        raise section.error(
            f"nodes of {name[:40]} are not read; H1 and L2_T1 of order 1 and 2 are."
        )
    numbers = section._replace(start=section.start + head.end())
    by_nodes = head[3] == b"0"
    is_torn = known[1] != "H1"
    return Space(numbers, count, int(known[2]), int(head[2]), by_nodes=by_nodes, is_torn=is_torn)


def _gather_attributes(sides: Elements, nodes: list[ndarray]) -> ArraysByName:
    found = gathered(
        (attribute, ids[each.attributes == attribute].ravel())
        for each, ids in zip(sides, nodes, strict=True)
        for attribute in np.unique(each.attributes).tolist()
    )
    return {f"boundary_{attribute}": found[attribute] for attribute in sorted(found)}


def _group_patches(section: Section | None, patches: Iterable[str]) -> dict[str, tuple[str, ...]]:
    sets = _read_named_sets(section)
    names = [name for name, _ in sets]
    again = next((name for name in names if names.count(name) > 1), None)
    if again is not None:
        raise ValueError(f"two sets of boundary attributes are called {again!r}.")
    members = {
        name: tuple(patch for patch in patches if patch[9:] in numbers) for name, numbers in sets
    }
    return {name: listed for name, listed in members.items() if listed}


def _read_named_sets(section: Section | None) -> list[tuple[str, list[str]]]:
    text = "" if section is None else decoded(section.content)
    return [(name, words.split()[1:]) for name, words in re.findall(r'"([^"]*)"([\s\d]*)', text)]


def _note_regions(cells: Elements, parts: dict[str, Section]) -> Iterator[str]:
    attributes = np.unique(np.concatenate([each.attributes for each in cells])).tolist()
    names = [name for name, _ in _read_named_sets(parts.get("attribute_sets"))]
    if len(attributes) > 1 or names:
        yield from regions_note([*(f"attribute {number}" for number in attributes), *names])
