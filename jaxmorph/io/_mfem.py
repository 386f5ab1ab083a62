"""MFEM's .mesh, versions 1.0 to 1.3, straight or of order 1 to 4 (mfem.org/mesh-formats)."""

import dataclasses
import pathlib
import re
from collections.abc import Iterable, Iterator
from typing import Any, ClassVar

import numpy as np
from numpy.polynomial import legendre

from jaxmorph._host.cells.lagrange import lagrange_types, node_keys, of_order, values
from jaxmorph._host.cells.topology import CORNERS, DIMENSION
from jaxmorph._mesh.exchange import Parts, checked_parts, gathered, regions_note

from ._format import MeshLike, Source, faults_of, own_source
from ._text import Section, blanked, replaced

EDGES = {
    "triangle": ((0, 1), (1, 2), (2, 0)),
    "quad": ((0, 1), (1, 2), (2, 3), (3, 0)),
    "tetra": ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)),
    "hexahedron": ((0, 1), (1, 2), (3, 2), (0, 3), (4, 5), (5, 6), (7, 6), (4, 7), (0, 4), (1, 5), (2, 6), (3, 7)),
    "wedge": ((0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)),
}
FACES = {
    "tetra": ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)),
    "hexahedron": ((3, 2, 1, 0), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7), (4, 5, 6, 7)),
    "wedge": ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
}
"""Edges and faces in the order in which MFEM numbers them; a face has its first cell's corners."""
SIMPLEX = {"triangle": 2, "wedge": 2, "tetra": 3}
"""Reference coordinates whose sum is 1 at most."""


@dataclasses.dataclass(frozen=True, eq=False)
class Elements:
    """Elements of one type: corners (k, c), their rows in the file, and their attributes."""

    kind: str
    corners: np.ndarray
    rows: np.ndarray
    attributes: Any = None


def numbered(
    cells: list[Elements], sides: list[Elements], order: int, count: int
) -> tuple[dict[str, np.ndarray], list[np.ndarray], int]:
    """Numbers the nodes as H1 does: vertices, edges, faces, inside of cells, in the file's order.

    `order` is the order of the cells, `count` the number of vertices. Returns the nodes of the
    cells by type, the nodes of the sides, and the number of all nodes.
    """
    edges, faces = np.sort(_sides(cells, EDGES)[:, :2], axis=1), _sides(cells, FACES)
    is_triangle = faces[:, 3] < 0
    groups = [
        [Elements("line", edges, np.arange(len(edges)))],
        [
            Elements("triangle", faces[is_triangle, :3], np.flatnonzero(is_triangle)),
            Elements("quad", faces[~is_triangle], np.flatnonzero(~is_triangle)),
        ],
        cells,
    ]
    known = np.concatenate([_in_file_order(group, [_inner(each, order) for each in group]) for group in groups])
    elements = [*cells, *sides]
    keys = [node_keys(each.corners, of_order(each.kind, order)) for each in elements]
    same = np.unique(np.concatenate([known, *(each.reshape(-1, 16) for each in keys)]), axis=0, return_inverse=True)[1]
    number = np.full(same.max(initial=-1) + 1, -1)
    number[same.ravel()[: len(known)]] = count + np.arange(len(known))
    new = np.split(number[same.ravel()], np.cumsum([len(known), *(each[..., 0].size for each in keys)]))[1:-1]
    nodes = [
        np.concatenate([each.corners, ids.reshape(len(each.corners), -1)], axis=1)
        for each, ids in zip(elements, new, strict=True)
    ]
    by_type = {of_order(each.kind, order).name: ids for each, ids in zip(cells, nodes, strict=False)}
    return by_type, nodes[len(cells) :], count + len(known)


def _in_file_order(elements: list[Elements], tables: list[np.ndarray]) -> np.ndarray:
    """Joins the rows (k, m, ...) of several types, as these take turns in the file."""
    places = np.concatenate(
        [np.repeat(each.rows, table.shape[1]) for each, table in zip(elements, tables, strict=True)]
    )
    joined = np.concatenate([table.reshape(-1, *table.shape[2:]) for table in tables])
    return joined[np.argsort(places, kind="stable")]


def _sides(cells: list[Elements], table: dict[str, tuple[tuple[int, ...], ...]]) -> np.ndarray:
    """Lists edges or faces (k, 4), -1 behind the last corner, in the order of first appearance."""
    parts = []
    for each in cells:
        columns = np.array([(*side, -1, -1)[:4] for side in table.get(each.kind, ())], int).reshape(-1, 4)
        parts.append(np.column_stack([each.corners, np.full(len(each.corners), -1)])[:, columns])
    sides = _in_file_order(cells, parts)
    return sides[np.sort(np.unique(np.sort(sides, axis=1), axis=0, return_index=True)[1])]


def _inner(element: Elements, order: int) -> np.ndarray:
    cell = of_order(element.kind, order)
    at = cell.lattice[cell.corners :]
    simplex = at[:, : SIMPLEX.get(cell.shape, 0)]
    inside = ((at > 0) & (at < order)).all(axis=1) & (simplex.sum(axis=1) < order)
    return node_keys(element.corners, cell)[:, inside]


def at_places(cells: dict[str, np.ndarray], points: np.ndarray, *, are_lobatto: bool) -> np.ndarray:
    """Takes nodes at equal steps to MFEM's Gauss-Lobatto places (from order 3 on), or back."""
    moved = points.copy()
    for kind, ids in cells.items():
        matrix = np.linalg.inv(to_lobatto(kind)) if are_lobatto else to_lobatto(kind)
        moved[ids] = np.einsum("mn,knd->kmd", matrix, points[ids])
    return moved


def to_lobatto(kind: str) -> np.ndarray:
    cell = lagrange_types()[kind]
    p, at, simplex = cell.order, cell.lattice, SIMPLEX.get(cell.shape, 0)
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
SAME = 1e-8
"""Distance of duplicates in L2, as a share of the mesh's extent."""


@dataclasses.dataclass(frozen=True, eq=False)
class _Space:
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

    def values(self, count: int) -> np.ndarray:
        numbers = self.section.rows(np.float64).values[self.skipped :]
        if self.d not in (2, 3) or len(numbers) != count * self.d:
            raise self.section.error(
                f"{count} nodes of 2 or 3 coordinates expected, found {len(numbers)} numbers for {self.d}."
            )
        return numbers.reshape(self.d, -1).T if self.by_nodes else numbers.reshape(-1, self.d)

    def check(self, cells: list[Elements], sides: list[Elements], parts: dict[str, Section]) -> None:
        if self.order > 1 and any(each.kind == "pyramid" for each in cells):
            raise self.section.error("pyramids of order 2 and more are not read.")
        for name, group in (("elements", cells), ("boundary", sides)):
            for each in group:
                if each.corners.min() < 0 or each.corners.max() >= self.vertices:
                    raise parts[name].error(f"a {each.kind} has a vertex that is none of 0 to {self.vertices - 1}.")
        size = len(self.section.text)
        if self.vertices > size:
            raise parts["vertices"].error(f"{self.vertices:.6g} vertices do not fit into a file of {size} bytes.")


@dataclasses.dataclass(frozen=True, eq=False)
class _Content:
    """A file's text, and what makes its coordinates of the mesh's points.

    - `values`: the coordinates (m, d) of the file; `node` (m,): the mesh's node of each.
    - `points`: the mesh's points as read; `cells`: curved cells from order 3 on, else none.
    """

    singles: ClassVar = ()

    text: bytes
    space: _Space
    values: np.ndarray
    node: np.ndarray
    points: np.ndarray
    cells: dict[str, np.ndarray]

    def in_file(self, points: np.ndarray) -> np.ndarray:
        """Computes the file's coordinates (m, d); unchanged where points have not changed."""
        new, old = (at_places(self.cells, places, are_lobatto=False) for places in (points, self.points))
        rows, d = self.values.copy(), points.shape[1]
        rows[:, :d] = np.where((new != old.astype(new.dtype))[self.node], new[self.node], rows[:, :d])
        return rows

    def in_mesh(self, values: np.ndarray) -> np.ndarray:
        lobatto = _first_of(values, self.node, len(self.points))[:, : self.points.shape[1]]
        return at_places(self.cells, lobatto, are_lobatto=True)


def _first_of(values: np.ndarray, node: np.ndarray, count: int) -> np.ndarray:
    first = np.empty((count, values.shape[1]))
    first[node[::-1]] = values[::-1]
    return first


def read(path: pathlib.Path) -> Parts:
    """Reads cells, nodes, and patches: attributes of boundary elements, `boundary_3`, and sets."""
    text = path.read_bytes()
    parts = _sections(path, text)
    cells, sides = _elements(parts["elements"]), _elements(parts["boundary"])
    if {DIMENSION[each.kind] for each in cells} not in ({2}, {3}):
        raise parts["elements"].error("cells of 2-D alone, or of 3-D alone, expected.")
    space = _space_of(parts)
    space.check(cells, sides, parts)
    nodes, of_sides, total = numbered(cells, sides, space.order, space.vertices)
    node = _nodes_in_file(space, cells, nodes, total)
    values = space.values(len(node))
    lobatto = _first_of(values, node, total)
    distance = np.abs(values - lobatto[node]).max()
    if not distance <= SAME * np.ptp(values, axis=0).max():
        raise space.section.error(f"nodes of cells that meet are {distance:.3g} apart; periodic meshes are not read.")
    is_flat = lobatto.shape[1] > DIMENSION[cells[0].kind] and not np.ptp(lobatto[:, 2])
    curved = nodes if space.order > 2 else {}
    points = at_places(curved, lobatto[:, :2] if is_flat else lobatto, are_lobatto=True)
    content = _Content(text, space, values, node, points, curved)
    ids = np.concatenate([each.rows for each in cells])
    patches = _patches(sides, of_sides)
    with faults_of(path):  # a caller may change the mesh's points in place, and the file's must stay
        known = {"groups": _groups(parts.get("boundary_attribute_sets"), patches), "notes": tuple(_notes(cells, parts))}
        known |= {"held": content if curved else None}
        source = Source(path, NAME, content, cell_ids=None if (np.diff(ids) == 1).all() else ids, **known)
        return checked_parts(points.copy(), nodes, patches, source)


def _nodes_in_file(space: _Space, cells: list[Elements], nodes: dict[str, np.ndarray], total: int) -> np.ndarray:
    """Lists nodes as the file does: by number, or cell by cell, the first coordinate fastest."""
    if not space.is_torn:
        return np.arange(total)
    return _in_file_order(cells, [ids[:, np.lexsort(lagrange_types()[name].lattice.T)] for name, ids in nodes.items()])


def write(path: pathlib.Path, mesh: MeshLike) -> None:
    content: _Content = own_source(path, mesh, NAME).content
    space, rows = content.space, content.in_file(np.asarray(mesh.points))
    words = rows.T.ravel() if space.by_nodes else rows.ravel()
    at, part = np.arange(len(words)) + space.skipped, slice(space.section.start, space.section.stop)
    with path.open("wb") as file:
        file.writelines(replaced(content.text, part, words, at=at, plain=_plain))


def _plain(text: bytes) -> bytes:
    return blanked(text, rb"(?m)^[ \t]*#[^\r\n]*")


def _sections(path: pathlib.Path, text: bytes) -> dict[str, Section]:
    head = text[:64].split(b"\n")[0].strip().decode(errors="replace")
    if not re.fullmatch(r"MFEM mesh v1\.[0-3]", head):
        raise ValueError(f"{path}: MFEM mesh v1.0 to v1.3 expected in the first line, found {head[:40]!r}.")
    plain = _plain(text)
    words = list(re.finditer(rb"(?m)^[ \t]*([a-z_]+)[ \t]*\r?$", plain))
    ends = [*(word.start() for word in words[1:]), len(plain)]
    parts = {word[1].decode(): Section(path, plain, word.end(), end) for word, end in zip(words, ends, strict=False)}
    missing = [name for name in ("elements", "boundary", "vertices") if name not in parts]
    if missing:
        raise ValueError(f"{path}: no {', '.join(missing)} in this file; it is cut short.")
    if head[-1] in "23" and words[-1][1] in (b"vertices", b"nodes"):
        raise ValueError(f"{path}: no line mfem_mesh_end at the end of this file; it is cut short.")
    return parts


def _elements(section: Section) -> list[Elements]:
    """Reads rows of attribute, type and corners, type by type; points of a boundary are none."""
    table = section.rows(np.int64)
    counts, first = table.counts[1:], table.first[1:]
    if not len(table.counts) or table.counts[0] != 1 or table.values[0] != len(counts) or (counts < 2).any():
        raise section.error("a number of elements expected, and as many rows of attribute, type and corners.")
    numbers, found = table.values[first + 1], []
    for number in np.unique(numbers).tolist():
        rows = np.flatnonzero(numbers == number)
        if not 0 <= number < len(GEOMETRIES):
            raise section.error(f"type {number} is not known; MFEM's are 0 to {len(GEOMETRIES) - 1}.", 1 + int(rows[0]))
        kind, size = GEOMETRIES[number], CORNERS.get(GEOMETRIES[number], 1)
        if (counts[rows] != size + 2).any():
            raise section.error(f"an element of type {number} has {size} corners.", 1 + int(rows[0]))
        corners = table.values[first[rows, None] + 2 + np.arange(size)]
        found.append(Elements(kind, corners, rows, table.values[first[rows]]))
    return [each for each in found if each.kind != "point"]


def _space_of(parts: dict[str, Section]) -> _Space:
    words = parts["vertices"].rows(np.float64).values
    if not len(words):
        raise parts["vertices"].error("a number of vertices expected.")
    if "nodes" not in parts:
        return _Space(parts["vertices"], int(words[0]), 1, int(words[1]) if len(words) > 1 else 0, skipped=2)
    section = parts["nodes"]
    words_of = rb"\s*FiniteElementSpace\s+FiniteElementCollection:\s*(\S+)\s+VDim:\s*(\d{1,9})\s+Ordering:\s*([01])\b"
    head = re.match(words_of, section.content)
    if head is None:
        raise section.error("FiniteElementSpace with its FiniteElementCollection, VDim and Ordering expected.")
    name = {b"Linear": "H1_P1", b"Quadratic": "H1_P2"}.get(head[1], head[1].decode(errors="replace"))
    known = re.fullmatch(r"(H1|L2_T1)_(?:[23]D_)?P([1-4])", name)
    if known is None:
        raise section.error(f"nodes of {name[:40]} are not read; H1 and L2_T1 of order 1 to 4 are.")
    numbers = dataclasses.replace(section, start=section.start + head.end())
    return _Space(numbers, int(words[0]), int(known[2]), int(head[2]), head[3] == b"0", known[1] != "H1")


def _patches(sides: list[Elements], nodes: list[np.ndarray]) -> dict[str, np.ndarray]:
    found = gathered(
        (attribute, ids[each.attributes == attribute].ravel())
        for each, ids in zip(sides, nodes, strict=True)
        for attribute in np.unique(each.attributes).tolist()
    )
    return {f"boundary_{attribute}": found[attribute] for attribute in sorted(found)}


def _groups(section: Section | None, patches: Iterable[str]) -> dict[str, tuple[str, ...]]:
    groups: dict[str, tuple[str, ...]] = {}
    for name, numbers in _named_sets(section):
        if name in groups:
            raise ValueError(f"two sets of boundary attributes are called {name!r}.")
        groups[name] = tuple(patch for patch in patches if patch.removeprefix("boundary_") in numbers)
    return {name: members for name, members in groups.items() if members}


def _named_sets(section: Section | None) -> list[tuple[str, list[str]]]:
    text = "" if section is None else section.content.decode(errors="replace")
    return [(name, words.split()[1:]) for name, words in re.findall(r'"([^"]*)"([\s\d]*)', text)]


def _notes(cells: list[Elements], parts: dict[str, Section]) -> Iterator[str]:
    attributes = np.unique(np.concatenate([each.attributes for each in cells])).tolist()
    names = [name for name, _ in _named_sets(parts.get("attribute_sets"))]
    if len(attributes) > 1 or names:
        yield from regions_note([*(f"attribute {number}" for number in attributes), *names])
