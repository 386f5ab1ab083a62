"""XDMF meshes of FEniCS, dolfinx, PETSc and meshio: XML with arrays in it, or in HDF5 beside it."""

import dataclasses
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy import ndarray

from jaxmorph._host.cells.orders import VTK_ORDER, reordered
from jaxmorph._host.cells.topology import DIMENSION, NODES, codes, invert_table, pairs_of
from jaxmorph._host.ragged import heads_of
from jaxmorph._host.rows import first_of_equals
from jaxmorph._mesh.exchange import Grid, Parts, Patch, by_number, check_width, regions_note, sized

from ._format import FilePoints, MeshLike, faults_of, of_grid, own_source
from ._text import Pieces, blank_out, number_lines, parse, replace_numbers

NAME = "XDMF"
XDMF_SHAPES = pairs_of(
    "polyvertex vertex polyline line edge line interval line tri triangle triangle triangle "
    "quadrilateral quad quad quad tet tetra tetrahedron tetra pyramid pyramid wedge wedge "
    "hex hexahedron hexahedron hexahedron"
)
"""Shapes of cells by XDMF's words, which an underscore and the number of nodes may follow."""
XDMF_TYPES = invert_table(
    codes(
        "vertex 1 line 2 triangle 4 quad 5 tetra 6 pyramid 7 wedge 8 hexahedron 9 "
        "line3 34 quad9 35 triangle6 36 quad8 37 tetra10 38 pyramid13 39 wedge15 40 wedge18 41 "
        "hexahedron20 48 hexahedron27 50"
    )
)
"""Types of cells by their numbers in a topology of mixed cells."""
CENTERS = ("Node", "Cell", "Grid", "Face", "Edge", "Other")
COUNTED = (1, 2)
"""Numbers that a number of nodes follows."""
ITEM = re.compile(rb"<DataItem\b([^>]*)(?<!/)>([^<]*)</DataItem\s*>")


class XDMFBlock(NamedTuple):
    """Cells of one type, and the row of each among all cells of its grid."""

    kind: str
    corners: ndarray
    rows: ndarray


@dataclasses.dataclass(frozen=True, eq=False)
class XDMFDocument:
    """The XML of a file, and the number of steps of its time series, 0 without one."""

    path: Path
    raw: bytes
    root: ElementTree.Element

    @property
    def grids(self) -> list[ElementTree.Element]:
        return [each for grid in self.root.iterfind("Domain/Grid") for each in _list_uniform(grid)]

    @property
    def steps(self) -> int:
        kind = "Domain/Grid[@CollectionType='Temporal']"
        return max((len(grid.findall("Grid")) for grid in self.root.iterfind(kind)), default=0)

    def item_of(self, element: ElementTree.Element, what: str) -> ElementTree.Element:
        """Returns the one array of an element, or the array that it refers to."""
        items = element.findall("DataItem")
        if len(items) != 1:
            raise ValueError(f"{what} with {len(items)} arrays; one is read.")
        reference = items[0].get("Reference")
        if not reference:
            return items[0]
        place = (items[0].text or "" if reference == "XML" else reference).strip()
        found = self.root.find(re.sub("^/+Xdmf", ".", place))
        if found is None:
            raise ValueError(f"{what} refers to {place[:80]}, which is not there.")
        return found

    def values(self, item: ElementTree.Element) -> ndarray:
        """Reads an array, of the shape that the XML gives it."""
        kind = item.get("ItemType", "Uniform")
        form = item.get("Format", "XML").upper()
        if kind != "Uniform" or form not in ("XML", "HDF"):
            raise ValueError(
                f"an array of the type {kind} in the format {form} is not read; whole arrays in "
                "XML or HDF are."
            )
        shape = tuple(map(int, item.get("Dimensions", "").split()))
        text = (item.text or "").strip()
        values = self._stored(text) if form == "HDF" else _parse_item(item, text)
        if values.size != np.prod(shape, dtype=float):
            raise ValueError(f"an array of {values.size} numbers, of the shape {shape} in the XML.")
        return values.reshape(shape)

    def _stored(self, text: str) -> ndarray:
        from ._tree import open_tree  # needs h5py, which files without HDF5 do not

        name, _, place = text.rpartition(":")
        file = self.path.parent / name
        if not file.is_file():
            raise ValueError(f"its arrays are in {name}, which is not beside it.")
        with open_tree(file, what="a file of arrays in HDF5") as tree:
            return tree[place][()]

    def part(self, grid: ElementTree.Element, name: str) -> tuple[ElementTree.Element, str]:
        """Finds a grid's Geometry or Topology, else that of the first grid; and its type.

        The type has one name in version 2 of XDMF, and another one in version 3.
        """
        found = next((part for each in (grid, self.grids[0]) for part in each.iterfind(name)), None)
        if found is None:
            raise ValueError(f"a grid without a {name}.")
        return found, found.get(f"{name}Type") or found.get("Type") or "XYZ"

    def geometry(self, grid: ElementTree.Element) -> ElementTree.Element:
        """Finds the array of a grid's points."""
        found, kind = self.part(grid, "Geometry")
        if kind not in ("XYZ", "XY"):
            raise ValueError(f"points of the type {kind} are not read; XYZ and XY are.")
        return self.item_of(found, "a Geometry")

    def points(self, grid: ElementTree.Element) -> ndarray:
        values = self.values(self.geometry(grid))
        if values.ndim != 2 or values.shape[1] not in (2, 3) or values.dtype.kind not in "fiu":
            raise ValueError(f"points of shape {values.shape}; (n, 2) or (n, 3) expected.")
        return values.astype(float)

    def blocks(self, grid: ElementTree.Element) -> list[XDMFBlock]:
        found, word = self.part(grid, "Topology")
        word = word.lower()
        ids = self.values(self.item_of(found, "a Topology")).astype(np.int64)
        return list(
            _read_mixed(ids.ravel()) if word == "mixed" else [_read_one_type(word, ids, found)]
        )

    def arrays(self, grid: ElementTree.Element, center: str) -> dict[str, ndarray]:
        """Reads the attributes of nodes or cells, a column as an array (n,)."""
        found = {}
        for each in grid.iterfind("Attribute"):
            own = each.get("Center", "Node")
            if own not in CENTERS:
                raise ValueError(f"an array of {own}; of {', '.join(CENTERS)} they are.")
            if own == center:
                values = self.values(self.item_of(each, "an Attribute"))
                is_column = values.ndim == 2 and values.shape[1] == 1
                found[each.get("Name", "array")] = values[:, 0] if is_column else values
        return found

    def moved(self, item: ElementTree.Element, old: ndarray, points: ndarray) -> Pieces:
        """Yields the XML with all arrays in it, and other points in place of the old ones."""
        leaves = [each for each in self.root.iter("DataItem") if not len(each)]
        at = 0
        for leaf, found in zip(leaves, self.places, strict=True):
            is_points = _is_same_array(leaf, item)
            if not (is_points or leaf.get("Format", "XML").upper() == "HDF"):
                continue
            yield self.raw[at : found.start(1)]
            yield _rewrite_tag(self.raw[found.start(1) : found.end(1)], is_points)
            inner = self.raw[found.end(1) : found.end(2)]
            if not is_points:
                yield b">" + _format_words(self.values(leaf))
            elif leaf.get("Format", "XML").upper() == "HDF":
                yield b">" + number_lines(points.ravel())
            else:
                whole = slice(1, len(inner))
                yield from replace_numbers(inner, whole, old.ravel(), points.ravel())
            at = found.end(2)
        yield self.raw[at:]

    @property
    def places(self) -> list[re.Match[bytes]]:
        return list(ITEM.finditer(blank_out(rb"(?s)<!--.*?-->", self.raw)))


@dataclasses.dataclass(frozen=True, eq=False)
class XDMFContent(FilePoints):
    document: XDMFDocument
    item: ElementTree.Element
    arrays: tuple[str, ...] = ()

    def moved(self, points: ndarray) -> Pieces:
        return self.document.moved(self.item, self.points, self.in_file(points))


def read(path: Path, tags: Path | None = None) -> Parts:
    """Reads points, cells and patches: numbers of facets in another grid of the file, or in `tags`.

    A patch has the name of the array and the number: `facet_tags_3`. Facets numbered 0 are none.
    """
    document = _read_document(path)
    grids = document.grids
    of_grids = [document.blocks(grid) for grid in grids]
    levels = list(map(_find_level, of_grids))
    first = int(np.argmax(levels))
    points = document.points(grids[first])
    grid = _read_grid(document, grids[first], of_grids[first], points)
    patches = list(_find_facets(document, levels[first], points))
    if tags is not None:
        patches += _read_tags(tags, levels[first], points)
    others = [each for k, each in enumerate(grids) if levels[k] == levels[first] and k != first]
    notes = list(regions_note(each.get("Name", "a grid") for each in others))
    if document.steps > 1:
        notes.append(f"a time series of {document.steps} steps, of which the first is read.")
    names = [str(array.get("Name")) for each in grids for array in each.iterfind("Attribute")]
    content = XDMFContent(
        points, document=document, item=document.geometry(grids[first]), arrays=tuple(names)
    )
    parts = of_grid(path, NAME, content, grid, patches, notes)
    if list(parts.patches) == ["boundary"] and not patches:
        source = dataclasses.replace(
            parts.source, notes=(*parts.source.notes, *_note_files_beside(path))
        )
        parts = parts._replace(source=source)
    return parts


def check(path: Path, mesh: MeshLike) -> None:
    """Refuses a time series, and a file of which some points would stay."""
    document = (content := own_source(mesh, NAME).content).document
    if document.steps > 1:
        raise ValueError(f"a time series of {document.steps} steps is not written; write .vtu.")
    items = map(document.geometry, document.grids)
    if not all(_is_same_array(item, content.item) for item in items):
        raise ValueError("the grids of the file have points of their own; write .vtu or .msh.")
    if len(document.places) != sum(not len(each) for each in document.root.iter("DataItem")):
        raise ValueError("arrays in parts of XML are not written; write .vtu or .msh.")


def _read_document(path: Path) -> XDMFDocument:
    raw = path.read_bytes()
    try:
        root = ElementTree.fromstring(raw)
    except ElementTree.ParseError as error:
        raise ValueError(f"not an XDMF file, or a damaged one ({error}).") from None
    document = XDMFDocument(path, raw, root)
    if root.tag != "Xdmf" or not document.grids:
        raise ValueError("not an XDMF file with a Grid in its Domain.")
    return document


def _list_uniform(grid: ElementTree.Element) -> list[ElementTree.Element]:
    """Lists the grids of a grid: itself, or what is in a collection, of a time series the first."""
    kind = grid.get("GridType", "Uniform")
    inner = grid.findall("Grid")
    if kind == "Uniform":
        return [grid]
    if kind != "Collection" or not inner:
        raise ValueError(f"a grid of the type {kind} is not read.")
    if len(inner) > 1 and grid.get("CollectionType") != "Temporal":
        raise ValueError(f"a collection of {len(inner)} grids in space is not read; join them.")
    return _list_uniform(inner[0])


def _find_level(blocks: Sequence[XDMFBlock]) -> int:
    return max((DIMENSION.get(block.kind, 0) for block in blocks), default=0)


def _read_one_type(word: str, ids: ndarray, topology: ElementTree.Element) -> XDMFBlock:
    name, _, size = word.partition("_")
    if name not in XDMF_SHAPES or not (size or "2").isdecimal():
        raise ValueError(f"cells of the type {word} are not read.")
    shape = XDMF_SHAPES[name]
    kind = sized(shape, int(size)) if size and shape in NODES else shape
    width = ids.shape[-1] if ids.ndim == 2 else int(topology.get("NodesPerElement") or 0)
    corners = ids.reshape(-1, width or NODES.get(kind, 1))
    return _make_xdmf_block(kind, corners, np.arange(len(corners)))


def _make_xdmf_block(kind: str, corners: ndarray, rows: ndarray) -> XDMFBlock:
    if kind not in (*NODES, "vertex"):
        raise ValueError(f"cells of type {kind} are not read.")
    check_width(kind, corners.shape[1])
    return XDMFBlock(kind, reordered(kind, corners, VTK_ORDER, None), rows)


def _read_mixed(stream: ndarray) -> Iterator[XDMFBlock]:
    """Yields the cells of each type: a number of the type, perhaps that of its nodes, the nodes."""
    heads = {code: 1 + (code in COUNTED) for code in XDMF_TYPES}
    steps = {code: heads[code] + NODES.get(kind, 1) for code, kind in XDMF_TYPES.items()}

    def step(code: int) -> int:
        if code not in steps:
            raise ValueError(f"cells of the number {code} are not read.")
        return steps[code]

    first = heads_of(stream, step)
    if len(first) and first[-1] + steps[stream[first[-1]]] != len(stream):
        raise ValueError("the last of the mixed cells is cut short.")
    codes = stream[first]
    for code in dict.fromkeys(codes.tolist()):
        rows = np.flatnonzero(codes == code)
        table = stream[first[rows, None] + np.arange(steps[code])]
        if code in COUNTED and (table[:, 1] != NODES.get(XDMF_TYPES[code], 1)).any():
            raise ValueError(f"cells of type {XDMF_TYPES[code]} of other than two nodes.")
        yield _make_xdmf_block(XDMF_TYPES[code], table[:, heads[code] :], rows)


def _read_grid(
    document: XDMFDocument, grid: ElementTree.Element, blocks: list[XDMFBlock], points: ndarray
) -> Grid:
    arrays = {name: rows for name, rows in document.arrays(grid, "Cell").items() if rows.ndim}
    count = sum(len(block.rows) for block in blocks)
    for name, values in arrays.items():
        if len(values) != count:
            raise ValueError(f"the array {name} has {len(values)} rows for {count} cells.")
    maps = {
        entry.get("key", ""): np.array([int(entry.text or 0), int(entry.get("dim", 0))])
        for information in grid.iterfind("Information")
        for entry in ElementTree.fromstring(information.text or "<none/>")
    }
    return Grid(
        points,
        [(block.kind, block.corners) for block in blocks],
        document.arrays(grid, "Node"),
        {name: [values[block.rows] for block in blocks] for name, values in arrays.items()},
        field_data=maps,
    )


def _find_facets(document: XDMFDocument, level: int, points: ndarray) -> Iterator[Patch]:
    """Yields the facets of each number of each array, in grids below the dimension of the mesh."""
    for grid in document.grids:
        blocks = document.blocks(grid)
        if _find_level(blocks) != level - 1:
            continue
        nodes = _find_nodes(document.points(grid), points)
        _check_corners(blocks, nodes)
        for name, values in document.arrays(grid, "Cell").items():
            # the largest number of 64 bits, and 0, are what FEniCS gives to facets without one
            values = np.where(values > np.iinfo(np.int64).max, 0, values)
            tables = [(1, nodes[block.corners], values[block.rows]) for block in blocks]
            for _, number, members in by_number(tables):
                if number:
                    yield Patch(f"{name}_{number}", "facets", members)


def _find_nodes(found: ndarray, points: ndarray) -> ndarray:
    """Finds the mesh's node at each of some points; -1 where there is none, or more than one."""
    if found.shape == points.shape and np.array_equal(found, points):
        return np.arange(len(points))
    # Each place gets a number; `first` is the first point there, so a node of the mesh if there is
    # one. Two nodes at one place (a cut) cannot be told apart.
    n = len(points)
    both = np.zeros((n + len(found), 3))
    both[:n, : points.shape[1]] = points
    both[n:, : found.shape[1]] = found
    first, place = first_of_equals(both)
    node = first[place[n:]]
    is_one = (node < n) & (np.bincount(place[:n], minlength=len(first))[place[n:]] == 1)
    return np.where(is_one, node, -1)


def _check_corners(blocks: Sequence[XDMFBlock], nodes: ndarray) -> None:
    for block in blocks:
        is_point = (block.corners >= 0) & (block.corners < len(nodes))
        lost = ~is_point | (nodes[np.where(is_point, block.corners, 0)] < 0)
        if lost.any():
            raise ValueError(
                f"{lost.sum()} corners of {len(lost)} facets are not each at one node of the mesh."
            )


def _read_tags(path: Path, level: int, points: ndarray) -> list[Patch]:
    with faults_of(path):
        found = list(_find_facets(_read_document(path), level, points))
        if not found:
            raise ValueError("no grid of facets with numbers.")
    return found


def _note_files_beside(path: Path) -> Iterator[str]:
    """Names other XDMF files of the folder, where the numbers of facets may be."""
    files = (file for file in path.parent.iterdir() if file.suffix.lower() in (".xdmf", ".xmf"))
    names = sorted(file.name for file in files if file.name != path.name)
    names.sort(key=lambda name: not name.startswith(path.stem))
    if names:
        more = " and others" if len(names) > 3 else ""
        yield (
            "the file numbers no facets. Where another one does, --tags FILE reads it (in Python "
            f"`tags`); beside it: {', '.join(names[:3])}{more}."
        )


def _parse_item(item: ElementTree.Element, text: str) -> ndarray:
    kind = item.get("NumberType") or item.get("DataType") or "Float"
    known: dict[str, type] = {"Float": np.float64, "UInt": np.uint64, "UChar": np.uint8}
    values = parse(text.encode(), known.get(kind, np.int64))
    if len(values) != len(text.split()):
        raise ValueError(f"an array of {kind} with something that is none.")
    return values


def _format_words(values: ndarray) -> bytes:
    if values.dtype.kind == "f":
        return number_lines(values.ravel())
    return "\n".join(map(str, values.ravel().tolist())).encode()


def _is_same_array(item: ElementTree.Element, other: ElementTree.Element) -> bool:
    """Checks whether two elements are one array, or name one of a file."""
    is_stored = item.get("Format", "XML").upper() == other.get("Format", "XML").upper() == "HDF"
    return item is other or (is_stored and (item.text or "").strip() == (other.text or "").strip())


def _rewrite_tag(attributes: bytes, is_points: bool) -> bytes:
    """Returns the attributes of an array that is in the XML; of points in double precision."""
    tag = re.sub(rb"\bFormat\s*=\s*([\"'])\w+\1", b'Format="XML"', attributes)
    if not is_points or re.search(rb"\bPrecision\s*=\s*[\"']8", tag):
        return tag
    return re.sub(rb"\s+Precision\s*=\s*([\"'])\w*\1", b"", tag) + b' Precision="8"'
