"""MFEM's .mesh, versions 1.0 to 1.3, straight or of order 1 to 4 (mfem.org/mesh-formats)."""

import dataclasses
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np
from numpy import ndarray
from numpy.polynomial import legendre

from jaxmorph._host.cells.lagrange import inner_places, lagrange_types, node_keys, of_order, values
from jaxmorph._host.cells.orders import NodeOrder, reordered
from jaxmorph._host.cells.topology import CORNERS, DIMENSION, EDGES, numbers
from jaxmorph._mesh.exchange import Parts, checked_parts, gathered, regions_note

from ._format import Arrays, Source
from ._text import Pieces, Section, blanked, replaced

ORDER = NodeOrder(
    EDGES | {"tetra": numbers("01 02 03 12 13 23")},
    {"tetra": numbers("123 032 013 021"), "hexahedron": numbers("3210 0154 1265 2376 3047 4567")},
    inner_places,
)
"""The order in which MFEM numbers edges and faces; a face has its first cell's corners."""
SIMPLEX = {"triangle": 2, "wedge": 2, "tetra": 3}
"""Reference coordinates whose sum is 1 at most."""


class AttributedCells(NamedTuple):
    """Elements of one type: corners (k, c), their rows in the file, and their attributes."""

    kind: str
    corners: ndarray
    rows: ndarray
    attributes: ndarray


def numbered(
    cells: list[AttributedCells], sides: list[AttributedCells], order: int, count: int
) -> tuple[list[ndarray], int]:
    """Numbers the nodes as H1 does: vertices, edges, faces, inside of cells, in the file's order.

    `order` is the order of the cells, `count` the number of vertices. Returns the nodes of the
    cells and of the sides, and the number of all nodes.
    """
    elements = [*cells, *sides]
    keys = [
        node_keys(each.corners, of_order(each.kind, order))[:, each.corners.shape[1] :]
        for each in elements
    ]
    same = np.unique(
        np.concatenate([key.reshape(-1, 16) for key in keys]), axis=0, return_inverse=True
    )[1].ravel()
    parts = np.split(same, np.cumsum([key[..., 0].size for key in keys])[:-1])
    new = [part.reshape(key.shape[:2]) for part, key in zip(parts, keys, strict=True)]
    levels = zip(
        *(_levels(each, order, ids) for each, ids in zip(cells, new, strict=False)), strict=True
    )
    listed = np.concatenate([_in_file_order(cells, level) for level in levels])
    first = np.sort(np.unique(listed, return_index=True)[1])
    number = np.full(same.max(initial=-1) + 1, -1)
    number[listed[first]] = count + np.arange(len(first))
    nodes = [
        np.concatenate([each.corners, number[ids]], axis=1)
        for each, ids in zip(elements, new, strict=True)
    ]
    return nodes, count + len(first)


def _levels(cells: AttributedCells, order: int, new: ndarray) -> list[ndarray]:
    """Lists new nodes as MFEM does: on edges, from the lower vertex on, on faces, inside."""
    corners, (first, second) = cells.corners, np.array(ORDER.edges[cells.kind]).T
    kind = of_order(cells.kind, order).name
    count = len(inner_places(cells.kind, order))
    new = reordered(kind, np.concatenate([corners, new], axis=1), None, ORDER)[
        :, corners.shape[1] :
    ]
    edges, faces, inside = np.split(new, [len(first) * (order - 1), new.shape[1] - count], axis=1)
    edges = edges.reshape(len(new), len(first), order - 1)
    turned = corners[:, first] > corners[:, second]
    return [
        np.where(turned[..., None], edges[..., ::-1], edges).reshape(len(new), -1),
        faces,
        inside,
    ]


def _in_file_order(cells: list[AttributedCells], tables: Iterable[ndarray]) -> ndarray:
    """Joins the rows (k, m) of several types, as these take turns in the file."""
    joined = [
        (np.repeat(each.rows, table.shape[1]), table.ravel())
        for each, table in zip(cells, tables, strict=True)
    ]
    rows, ids = map(np.concatenate, zip(*joined, strict=True))
    return ids[np.argsort(rows, kind="stable")]


def at_places(cells: Arrays, points: ndarray, *, are_lobatto: bool) -> ndarray:
    """Takes nodes at equal steps to MFEM's Gauss-Lobatto places (from order 3 on), or back."""
    moved = points.copy()
    for kind, ids in cells.items():
        matrix = np.linalg.inv(to_lobatto(kind)) if are_lobatto else to_lobatto(kind)
        moved[ids] = np.einsum("mn,knd->kmd", matrix, points[ids])
    return moved


def to_lobatto(kind: str) -> ndarray:
    cell = lagrange_types()[kind]
    p = cell.order
    at = cell.lattice
    simplex = SIMPLEX.get(cell.shape, 0)
    inner = legendre.legroots(legendre.legder(np.eye(p + 1)[p]))
    line = np.concatenate([[0], (np.sort(inner) + 1) / 2, [1]])
    places = line[at]
    if simplex:
        rest = line[p - at[:, :simplex].sum(axis=1)]
        places[:, :simplex] /= (places[:, :simplex].sum(axis=1) + rest)[:, None]
    return values(kind, places)


NAME = "MFEM"
GEOMETRIES = ("point", "line", "triangle", "quad", "tetra", "hexahedron", "wedge", "pyramid")
"""Types by MFEM's numbers, whose corners are in VTK's order."""
SIZES = {number: CORNERS.get(kind, 1) for number, kind in enumerate(GEOMETRIES)}
SAME = 1e-8
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

    def values(self, node: ndarray, total: int) -> tuple[ndarray, ndarray]:
        """Reads the coordinates of each `node` (m,), and of the first place of all nodes."""
        numbers = self.section.rows(np.float64).values[self.skipped :]
        first = np.unique(node, return_index=True)[1]
        if self.d not in (2, 3) or len(numbers) != len(node) * self.d or len(first) < total:
            raise self.section.error(
                f"{len(node)} nodes of 2 or 3 coordinates expected, found {len(numbers)} numbers "
                f"for {self.d}."
            )
        rows = numbers.reshape(self.d, -1).T if self.by_nodes else numbers.reshape(-1, self.d)
        distance = np.abs(rows - rows[first][node]).max()
        if not distance <= SAME * np.ptp(rows, axis=0).max():
            raise self.section.error(
                f"nodes of cells that meet are {distance:.3g} apart; periodic meshes are not read."
            )
        return rows, rows[first]


@dataclasses.dataclass(frozen=True, eq=False)
class MFEMContent:
    """A file's text, and what makes its coordinates of the mesh's points.

    - `values`: the coordinates (m, d) of the file; `node` (m,): the mesh's node of each.
    - `points`: the mesh's points as read; `cells`: curved cells from order 3 on, else none.
    """

    singles: ClassVar = ()

    text: bytes
    space: Space
    values: ndarray
    node: ndarray
    points: ndarray
    cells: Arrays

    def in_file(self, points: ndarray) -> ndarray:
        """Computes the file's coordinates (m, d); unchanged where points have not changed."""
        new, old = (
            at_places(self.cells, places, are_lobatto=False) for places in (points, self.points)
        )
        rows = self.values.copy()
        d = points.shape[1]
        rows[:, :d] = np.where(
            (new != old.astype(new.dtype))[self.node], new[self.node], rows[:, :d]
        )
        return rows

    def in_mesh(self, values: ndarray) -> ndarray:
        lobatto = values[np.unique(self.node, return_index=True)[1], : self.points.shape[1]]
        return at_places(self.cells, lobatto, are_lobatto=True)

    def moved(self, points: ndarray) -> Pieces:
        rows = self.in_file(points)
        section = self.space.section
        words = (rows.T if self.space.by_nodes else rows).ravel()
        at = np.arange(len(words)) + self.space.skipped
        return replaced(self.text, slice(section.start, section.stop), words, at=at, plain=_plain)


def read(path: Path) -> Parts:
    """Reads cells, nodes, and patches: attributes of boundary elements, `boundary_3`, and sets."""
    text = path.read_bytes()
    parts = _sections(path, text)
    space = _space_of(parts)
    cells, sides = (_elements(parts[name], space.vertices) for name in ("elements", "boundary"))
    if {DIMENSION[each.kind] for each in cells} not in ({2}, {3}):
        raise parts["elements"].error("cells of 2-D alone, or of 3-D alone, expected.")
    if space.order > 1 and "pyramid" in [each.kind for each in cells]:
        raise space.section.error("pyramids of order 2 and more are not read.")
    ids, total = numbered(cells, sides, space.order, space.vertices)
    nodes = {
        of_order(each.kind, space.order).name: rows for each, rows in zip(cells, ids, strict=False)
    }
    content = _content(text, space, cells, nodes, total)
    patches = _patches(sides, ids[len(cells) :])
    source = Source(
        path,
        NAME,
        content,
        cell_ids=np.concatenate([each.rows for each in cells]),
        groups=_groups(parts.get("boundary_attribute_sets"), patches),
        held=content if content.cells else None,
        notes=tuple(_notes(cells, parts)),
    )
    # a caller may change the mesh's points in place, and the file's must stay
    return checked_parts(content.points.copy(), nodes, patches, source)


def _content(
    text: bytes, space: Space, cells: list[AttributedCells], nodes: Arrays, total: int
) -> MFEMContent:
    node = np.arange(total)
    curved = nodes if space.order > 2 else {}
    if space.is_torn:  # cell by cell, the first coordinate fastest
        tables = [
            ids[:, np.lexsort(lagrange_types()[kind].lattice.T)] for kind, ids in nodes.items()
        ]
        node = _in_file_order(cells, tables)
    values, lobatto = space.values(node, total)
    if lobatto.shape[1] > DIMENSION[cells[0].kind] and not np.ptp(lobatto[:, 2]):
        lobatto = lobatto[:, :2]
    return MFEMContent(
        text, space, values, node, at_places(curved, lobatto, are_lobatto=True), curved
    )


def _plain(text: bytes) -> bytes:
    return blanked(text, rb"(?m)^[ \t]*#[^\r\n]*")


def _sections(path: Path, text: bytes) -> dict[str, Section]:
    head = text[:64].split(b"\n")[0].strip().decode(errors="replace")
    if not re.fullmatch(r"MFEM mesh v1\.[0-3]", head):
        raise ValueError(f"MFEM mesh v1.0 to v1.3 expected in the first line, found {head[:40]!r}.")
    plain = _plain(text)
    words = list(re.finditer(rb"(?m)^[ \t]*([a-z_]+)[ \t]*\r?$", plain))
    ends = [*(word.start() for word in words[1:]), len(plain)]
    parts = {
        word[1].decode(): Section(path, plain, word.end(), end)
        for word, end in zip(words, ends, strict=False)
    }
    missing = [name for name in ("elements", "boundary", "vertices") if name not in parts]
    missing += ["line mfem_mesh_end"] * (
        head[-1] in "23" and [*parts][-1:] in (["vertices"], ["nodes"])
    )
    if missing:
        raise ValueError(f"no {', '.join(missing)} in this file; it is cut short.")
    return parts


def _elements(section: Section, count: int) -> list[AttributedCells]:
    """Reads rows of attribute, type and corners, type by type; points of a boundary are none."""
    table = section.rows(np.int64)
    if not len(table.counts) or table.counts[0] != 1 or table.values[0] != len(table.counts) - 1:
        raise section.error(
            "a number of elements expected, and as many rows of attribute, type and corners."
        )
    rows = table._replace(values=table.values[1:], counts=table.counts[1:], row=1)
    found = sorted(rows.by_kind(1, SIZES, count), key=lambda kind: kind[0])
    return [
        AttributedCells(GEOMETRIES[kind], each[:, 2:], at, each[:, 0])
        for kind, at, each in found
        if kind
    ]


def _space_of(parts: dict[str, Section]) -> Space:
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
    name = {b"Linear": "H1_P1", b"Quadratic": "H1_P2"}.get(
        head[1], head[1].decode(errors="replace")
    )
    known = re.fullmatch(r"(H1|L2_T1)_(?:[23]D_)?P([1-4])", name)
    if known is None:
        raise section.error(f"nodes of {name[:40]} are not read; H1 and L2_T1 of order 1 to 4 are.")
    numbers = section._replace(start=section.start + head.end())
    return Space(numbers, count, int(known[2]), int(head[2]), head[3] == b"0", known[1] != "H1")


def _patches(sides: list[AttributedCells], nodes: list[ndarray]) -> Arrays:
    found = gathered(
        (attribute, ids[each.attributes == attribute].ravel())
        for each, ids in zip(sides, nodes, strict=True)
        for attribute in np.unique(each.attributes).tolist()
    )
    return {f"boundary_{attribute}": found[attribute] for attribute in sorted(found)}


def _groups(section: Section | None, patches: Iterable[str]) -> dict[str, tuple[str, ...]]:
    sets = _named_sets(section)
    names = [name for name, _ in sets]
    again = next((name for name in names if names.count(name) > 1), None)
    if again is not None:
        raise ValueError(f"two sets of boundary attributes are called {again!r}.")
    members = {
        name: tuple(patch for patch in patches if patch[9:] in numbers) for name, numbers in sets
    }
    return {name: listed for name, listed in members.items() if listed}


def _named_sets(section: Section | None) -> list[tuple[str, list[str]]]:
    text = "" if section is None else section.content.decode(errors="replace")
    return [(name, words.split()[1:]) for name, words in re.findall(r'"([^"]*)"([\s\d]*)', text)]


def _notes(cells: list[AttributedCells], parts: dict[str, Section]) -> Iterator[str]:
    attributes = np.unique(np.concatenate([each.attributes for each in cells])).tolist()
    names = [name for name, _ in _named_sets(parts.get("attribute_sets"))]
    if len(attributes) > 1 or names:
        yield from regions_note([*(f"attribute {number}" for number in attributes), *names])
