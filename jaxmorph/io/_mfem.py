"""MFEM's .mesh, versions 1.0 to 1.3, straight or of order 1 to 4 (mfem.org/mesh-formats).

Nodes are the coordinates of a finite element space: H1, continuous, or L2_T1, whose cells have
nodes of their own. From order 3 on MFEM's nodes are at Gauss-Lobatto places, and the mesh has nodes
at equal steps: the coordinates of the file are computed anew where cells have changed.
"""

import dataclasses
import functools
import pathlib
import re
from collections.abc import Callable, Iterable, Iterator

import numpy as np
from numpy.polynomial import legendre

from jaxmorph._host.cells.lagrange import Lagrange, lagrange_types, node_keys, of_order, values
from jaxmorph._host.cells.topology import CORNERS, DIMENSION
from jaxmorph._mesh.exchange import Parts, checked_parts, regions_note

from ._format import Arrays, Held, MeshLike, Source, faults_of, own_source
from ._text import Section, blanked, replace_numbers

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


@dataclasses.dataclass(frozen=True, eq=False)
class Elements:
    """Elements of one type: corners (k, c), their rows in the file, and their attributes."""

    kind: str
    corners: np.ndarray
    rows: np.ndarray
    attributes: np.ndarray


def numbered(
    cells: list[Elements], sides: list[Elements], order: int, count: int
) -> tuple[dict[str, np.ndarray], list[np.ndarray], int]:
    """Numbers the nodes as H1 does: vertices, edges, faces, inside of cells, in the file's order.

    `order` is the order of the cells, `count` the number of vertices. Returns the nodes of the
    cells by type, the nodes of the sides, and the number of all nodes.
    """
    edges, faces = np.sort(_sides(cells, EDGES)[:, :2], axis=1), _sides(cells, FACES)
    is_triangle = faces[:, 3:].ravel() < 0
    groups = [
        [("line", edges, np.arange(len(edges)))],
        [
            ("triangle", faces[is_triangle, :3], np.flatnonzero(is_triangle)),
            ("quad", faces[~is_triangle], np.flatnonzero(~is_triangle)),
        ],
        [(element.kind, element.corners, element.rows) for element in cells],
    ]
    keys = [np.zeros((0, 16), np.int64)]
    for group in groups:  # an entity's nodes are consecutive, and entities of several types take turns
        inner = [_inner(corners, of_order(kind, order)) for kind, corners, _ in group]
        places = [np.repeat(rows, part.shape[1]) for (_, _, rows), part in zip(group, inner, strict=True)]
        joined = np.concatenate([part.reshape(-1, 16) for part in inner])
        keys.append(joined[np.argsort(np.concatenate(places), kind="stable")])
    known = np.concatenate(keys)
    all_keys = [node_keys(element.corners, of_order(element.kind, order)) for element in (*cells, *sides)]
    same = np.unique(
        np.concatenate([known, *(keys.reshape(-1, 16) for keys in all_keys)]), axis=0, return_inverse=True
    )[1]
    number = np.full(same.max(initial=-1) + 1, -1)
    number[same.ravel()[: len(known)]] = count + np.arange(len(known))
    nodes, first = [], len(known)
    for element, own in zip((*cells, *sides), all_keys, strict=True):
        new = number[same.ravel()[first : first + own.shape[0] * own.shape[1]]].reshape(own.shape[:2])
        nodes.append(np.concatenate([element.corners, new], axis=1))
        first += new.size
    by_type = {of_order(element.kind, order).name: ids for element, ids in zip(cells, nodes, strict=False)}
    return by_type, nodes[len(cells) :], count + len(known)


def _sides(cells: list[Elements], table: dict[str, tuple[tuple[int, ...], ...]]) -> np.ndarray:
    """Lists edges or faces (k, 4), -1 behind the last corner, in the order of first appearance."""
    parts, places = [np.zeros((0, 4), np.int64)], [np.zeros(0, np.int64)]
    for element in cells:
        for local, side in enumerate(table.get(element.kind, ())):
            part = np.full((len(element.rows), 4), -1)
            part[:, : len(side)] = element.corners[:, side]
            parts.append(part)
            places.append(16 * element.rows + local)
    sides = np.concatenate(parts)[np.argsort(np.concatenate(places))]
    return sides[np.sort(np.unique(np.sort(sides, axis=1), axis=0, return_index=True)[1])]


def _inner(corners: np.ndarray, cell: Lagrange) -> np.ndarray:
    """Returns the keys of the nodes inside of a line, a face or a cell, not on its sides."""
    p, at = cell.order, cell.lattice[cell.corners :]
    if cell.shape in ("triangle", "tetra"):
        inside = (at > 0).all(axis=1) & (at.sum(axis=1) < p)
    elif cell.shape == "wedge":
        inside = (at > 0).all(axis=1) & (at[:, :2].sum(axis=1) < p) & (at[:, 2] < p)
    else:
        inside = ((at > 0) & (at < p)).all(axis=1)
    return node_keys(corners, cell)[:, inside]


def lexicographic(cells: list[Elements], nodes: dict[str, np.ndarray]) -> np.ndarray:
    """Lists the nodes of L2's coordinates: cell by cell, the first reference coordinate fastest."""
    parts, places = [], []
    for element, (name, ids) in zip(cells, nodes.items(), strict=True):
        order = np.lexsort(lagrange_types()[name].lattice.T)
        parts.append(ids[:, order].ravel())
        places.append(np.repeat(element.rows, ids.shape[1]))
    return np.concatenate(parts)[np.argsort(np.concatenate(places), kind="stable")]


def at_places(cells: dict[str, np.ndarray], points: np.ndarray, matrix: Callable[[str], np.ndarray]) -> np.ndarray:
    """Computes the nodes of cells at other places, cell by cell."""
    moved = points.copy()
    for kind, ids in cells.items():
        moved[ids] = np.einsum("mn,knd->kmd", matrix(kind), points[ids])
    return moved


@functools.cache
def to_lobatto(kind: str) -> np.ndarray:
    """Returns the matrix from nodes at equal steps to nodes at Gauss-Lobatto places."""
    cell = lagrange_types()[kind]
    p, at = cell.order, cell.lattice
    inner = legendre.legroots(legendre.legder(np.eye(p + 1)[p]))
    line = np.concatenate([[0], (np.sort(inner) + 1) / 2, [1]])
    places = line[at]
    simplex = {"triangle": 2, "wedge": 2, "tetra": 3}.get(cell.shape, 0)
    if simplex:
        rest = line[p - at[:, :simplex].sum(axis=1)]
        places[:, :simplex] /= (places[:, :simplex].sum(axis=1) + rest)[:, None]
    return values(kind, places)


@functools.cache
def from_lobatto(kind: str) -> np.ndarray:
    return np.linalg.inv(to_lobatto(kind))


NAME = "MFEM"
GEOMETRIES = (None, "line", "triangle", "quad", "tetra", "hexahedron", "wedge", "pyramid")
"""Types by MFEM's numbers, whose corners are in VTK's order."""
SAME = 1e-8
"""Distance of two nodes of L2 that are one, as a share of the mesh's extent."""


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

    def coordinates(self, node: np.ndarray, total: int) -> tuple[np.ndarray, np.ndarray]:
        """Reads the file's coordinates (m, d), and from them the nodes' coordinates (total, d)."""
        numbers = self.section.rows(np.float64).values[self.skipped :]
        if self.d not in (2, 3) or len(numbers) != len(node) * self.d:
            raise self.section.error(
                f"{len(node)} nodes of 2 or 3 coordinates expected, found {len(numbers)} numbers for {self.d}."
            )
        values = numbers.reshape(self.d, -1).T if self.by_nodes else numbers.reshape(-1, self.d)
        points = np.empty((total, self.d))
        points[node[::-1]] = values[::-1]  # the first of several
        distance = np.abs(values - points[node]).max()
        if not distance <= SAME * np.ptp(values, axis=0).max():
            raise self.section.error(
                f"nodes of cells that meet are {distance:.3g} apart; periodic meshes are not read."
            )
        return values, points


@dataclasses.dataclass(frozen=True, eq=False)
class _Content:
    """A file's text in its section of coordinates, and what makes them of the mesh's points.

    - `values`: the coordinates (m, d) of the file; `node` (m,): the mesh's node of each.
    - `points`: the mesh's points as read; `cells`: curved cells from order 3 on, else none.
    """

    section: Section
    space: _Space
    values: np.ndarray
    node: np.ndarray
    points: np.ndarray
    cells: dict[str, np.ndarray]

    def in_file(self, points: np.ndarray) -> np.ndarray:
        """Computes the file's coordinates (m, d); unchanged where points have not changed."""
        new, old = (at_places(self.cells, coordinates, to_lobatto) for coordinates in (points, self.points))
        rows, d = self.values.copy(), points.shape[1]
        rows[:, :d] = np.where((new != old.astype(new.dtype))[self.node], new[self.node], rows[:, :d])
        return rows

    def in_mesh(self, values: np.ndarray) -> np.ndarray:
        """Computes the mesh's points of the file's coordinates, the first of several."""
        lobatto = np.empty((len(self.points), self.values.shape[1]))
        lobatto[self.node[::-1]] = values[::-1]
        return at_places(self.cells, lobatto[:, : self.points.shape[1]], from_lobatto)


def read(path: pathlib.Path) -> Parts:
    """Reads cells, nodes, and patches: the attributes of boundary elements.

    The patch of attribute 3 is `boundary_3`; named sets of attributes are groups of patches.
    """
    text = path.read_bytes()
    parts = _sections(path, text)
    cells, sides = _elements(parts["elements"]), _elements(parts["boundary"])
    if {DIMENSION[element.kind] for element in cells} not in ({2}, {3}):
        raise parts["elements"].error("cells of 2-D alone, or of 3-D alone, expected.")
    space = _space_of(parts)
    if space.order > 1 and any(element.kind == "pyramid" for element in cells):
        raise space.section.error("pyramids of order 2 and more are not read.")
    for name, group in (("elements", cells), ("boundary", sides)):
        for element in group:
            if element.corners.min() < 0 or element.corners.max() >= space.vertices:
                raise parts[name].error(f"a {element.kind} has a vertex that is none of 0 to {space.vertices - 1}.")
    if space.vertices > len(text):
        raise parts["vertices"].error(f"{space.vertices:.6g} vertices do not fit into a file of {len(text)} bytes.")
    nodes, of_sides, total = numbered(cells, sides, space.order, space.vertices)
    node = lexicographic(cells, nodes) if space.is_torn else np.arange(total)
    values, lobatto = space.coordinates(node, total)
    flat = lobatto.shape[1] > DIMENSION[cells[0].kind] and not np.ptp(lobatto[:, 2])
    curved = nodes if space.order > 2 else {}
    points = at_places(curved, lobatto[:, :2] if flat else lobatto, from_lobatto)
    section = dataclasses.replace(space.section, text=text)
    content = _Content(section, space, values, node, points, curved)
    ids = np.concatenate([element.rows for element in cells])
    patches = _patches(sides, of_sides)
    with faults_of(path):
        groups = _groups(parts.get("boundary_attribute_sets"), patches)
    notes = tuple(_notes(cells, parts))
    ids = None if (np.diff(ids) == 1).all() else ids
    held = Held(values, content.in_file, content.in_mesh) if curved else None
    source = Source(path, NAME, content, groups=groups, cell_ids=ids, held=held, notes=notes)
    with faults_of(path):  # a caller may change the mesh's points in place, and the file's must stay
        return checked_parts(points.copy(), nodes, patches, source)


def write(path: pathlib.Path, mesh: MeshLike, point_data: Arrays, cell_data: Arrays) -> None:
    """Writes the mesh's own file with new coordinates."""
    content: _Content = own_source(path, mesh, NAME).content
    section, rows = content.section, content.in_file(np.asarray(mesh.points))
    words = rows.T.ravel() if content.space.by_nodes else rows.ravel()
    at = np.arange(len(words)) + content.space.skipped
    with path.open("wb") as file:
        part = slice(section.start, section.stop)
        file.writelines(replace_numbers(section.text, _plain(section.text), part, at, words))


def _plain(text: bytes) -> bytes:
    """Overwrites every line of comment by spaces: what remains stands where it stood."""
    return blanked(text, rb"(?m)^[ \t]*#[^\r\n]*")


def _sections(path: pathlib.Path, text: bytes) -> dict[str, Section]:
    """Finds what stands behind each of the file's keywords; comments are blanked."""
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
    """Reads rows of attribute, type and corners, type by type."""
    table = section.rows(np.int64)
    counts, first = table.counts[1:], table.first[1:]
    if not len(table.counts) or table.counts[0] != 1 or table.values[0] != len(counts) or (counts < 2).any():
        raise section.error("a number of elements expected, and as many rows of attribute, type and corners.")
    numbers, found = table.values[first + 1], []
    for number in np.unique(numbers).tolist():
        kind = GEOMETRIES[number] if 0 < number < len(GEOMETRIES) else None
        if kind is None and number != 0:
            row = 1 + int(np.argmax(numbers == number))
            raise section.error(f"type {number} is not known; MFEM's are 0 to {len(GEOMETRIES) - 1}.", row)
        rows = np.flatnonzero(numbers == number)
        size = 1 if kind is None else CORNERS[kind]
        if (counts[rows] != size + 2).any():
            raise section.error(f"an element of type {number} has {size} corners.", 1 + int(rows[0]))
        if kind is not None:
            corners = table.values[first[rows, None] + 2 + np.arange(size)]
            found.append(Elements(kind, corners, rows, table.values[first[rows]]))
    return found


def _space_of(parts: dict[str, Section]) -> _Space:
    """Reads the head of the nodes, or of the vertices of a straight mesh."""
    words = parts["vertices"].rows(np.float64).values
    if not len(words):
        raise parts["vertices"].error("a number of vertices expected.")
    if "nodes" not in parts:
        return _Space(parts["vertices"], int(words[0]), 1, int(words[1]) if len(words) > 1 else 0, skipped=2)
    section = parts["nodes"]
    text = section.text[section.start : section.stop]
    words_of = rb"\s*FiniteElementSpace\s+FiniteElementCollection:\s*(\S+)\s+VDim:\s*(\d{1,9})\s+Ordering:\s*([01])\b"
    head = re.match(words_of, text)
    if head is None:
        raise section.error("FiniteElementSpace with its FiniteElementCollection, VDim and Ordering expected.")
    name = {b"Linear": "H1_P1", b"Quadratic": "H1_P2"}.get(head[1], head[1].decode(errors="replace"))
    known = re.fullmatch(r"(H1|L2_T1)_(?:[23]D_)?P([1-4])", name)
    if known is None:
        raise section.error(f"nodes of {name[:40]} are not read; H1 and L2_T1 of order 1 to 4 are.")
    numbers = Section(section.path, section.text, section.start + head.end(), section.stop)
    return _Space(numbers, int(words[0]), int(known[2]), int(head[2]), head[3] == b"0", known[1] != "H1")


def _patches(sides: list[Elements], nodes: list[np.ndarray]) -> dict[str, np.ndarray]:
    """Collects the nodes of boundary elements by their attribute."""
    found: dict[int, list[np.ndarray]] = {}
    for element, ids in zip(sides, nodes, strict=True):
        for attribute in np.unique(element.attributes).tolist():
            found.setdefault(attribute, []).append(ids[element.attributes == attribute].ravel())
    return {f"boundary_{attribute}": np.concatenate(found[attribute]) for attribute in sorted(found)}


def _groups(section: Section | None, patches: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Makes groups of the patches of named sets of attributes; `ValueError` for a name twice."""
    groups: dict[str, tuple[str, ...]] = {}
    for name, numbers in _named_sets(section):
        attributes = {f"boundary_{number}" for number in numbers}
        if name in groups:
            raise ValueError(f"two sets of boundary attributes are called {name!r}.")
        groups[name] = tuple(patch for patch in patches if patch in attributes)
    return {name: members for name, members in groups.items() if members}


def _named_sets(section: Section | None) -> list[tuple[str, list[str]]]:
    """Reads named sets: a name in quotes, a number, and as many attributes."""
    text = "" if section is None else section.text[section.start : section.stop].decode(errors="replace")
    return [(name, words.split()[1:]) for name, words in re.findall(r'"([^"]*)"([\s\d]*)', text)]


def _notes(cells: list[Elements], parts: dict[str, Section]) -> Iterator[str]:
    """Yields a sentence on the attributes of cells, and on their named sets."""
    attributes = np.unique(np.concatenate([element.attributes for element in cells])).tolist()
    names = [name for name, _ in _named_sets(parts.get("attribute_sets"))]
    if len(attributes) > 1 or names:
        yield from regions_note([*(f"attribute {number}" for number in attributes), *names])
