"""gmsh's .msh, versions 1, 2, 4.0, 4.1, text and binary: written back by replacing coordinates."""

import codecs
import collections
import contextlib
import itertools
import pathlib
import re
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from jaxmorph._boundary.periodic import Periodic
from jaxmorph._host.cells.orders import GMSH, reordered
from jaxmorph._host.cells.topology import DIMENSION, Pair, codes, invert_table
from jaxmorph._host.cells.topology import NODES as CORNERS
from jaxmorph._host.rows import Rows, first_of_equals, join_ids
from jaxmorph._mesh.exchange import GMSH_LEVELS, Grid, Parts, Patch, gathered, regions_note

from ._format import MeshLike, content_of, faults_of, note_unread, of_grid, patch_faces
from ._places import Labels, Stream
from ._text import Section, blank_out, decoded

NAME = "gmsh"
NODE_SECTIONS = ("Nodes", "ParametricNodes", "NOD")
ELEMENT_SECTIONS = ("Elements", "ELM")
"""Sections of nodes and of elements; the last name of each is from version 1."""
GMSH_NUMBERS = codes(
    "line 1 triangle 2 quad 3 tetra 4 hexahedron 5 wedge 6 pyramid 7 vertex 15 "
    "line3 8 triangle6 9 quad9 10 tetra10 11 hexahedron27 12 wedge18 13 pyramid14 14 "
    "quad8 16 hexahedron20 17 wedge15 18 pyramid13 19 "
    "line4 26 triangle10 21 quad16 36 tetra20 29 wedge40 90 hexahedron64 92 pyramid30 118 "
    "line5 27 triangle15 23 quad25 37 tetra35 30 wedge75 91 hexahedron125 93 pyramid55 119"
)
GMSH_TYPES = invert_table(GMSH_NUMBERS)
"""Types of cells by gmsh's numbers."""
BYTE_ORDERS = {b"\x01\0\0\0": "<", b"\0\0\0\x01": ">"}
"""Byte orders, and the number 1 in four bytes."""

_GROUP_NAME = re.compile(rb'\s*(?:(\d+)\s+)?(\d+)\s+(?:"(.*)"(?:\s[^"]*)?|(\S+))\s*')
_VERSION_LINE = re.compile(rb"\s*(2(?:\.\d+)?|4(?:\.[01])?)\s+([01])\s+([48])\s*$")
_COMMENTS = re.compile(
    rb"(?:[ \t]*\$Comments[ \t\r]*\n(?s:.*?)^[ \t]*\$EndComments[ \t\r]*(?:\n|\Z))*", re.MULTILINE
)

GroupNames = dict[tuple[int | None, int], str]
"""Names of physical groups by dimension and tag; None: of any dimension."""
EntityGroups = dict[tuple[int, int], list[int]]
"""Tags of the physical groups of an entity, by its dimension and tag."""
TaggedNodes = Pair
"""Tags of nodes, and the place of each one's x."""


class MeshFormat(NamedTuple):
    """A file's version (1, 2, 4.0, 4.1), text or binary, byte order and bytes of a size.

    In version 2.0 itself, without `has_levels`, names of groups may come without a dimension.
    """

    version: float
    is_text: bool
    order: str = "<"
    size: int = 8
    has_levels: bool = True

    def stream(self, section: Section, dtype: type) -> Stream:
        kinds = {"i": "i4", "n": f"u{self.size}", "d": "f8"}
        types = {letter: self.order + kind for letter, kind in kinds.items()}
        return Stream(section, None if self.is_text else types, dtype, self.version)


class ElementBlock(NamedTuple):
    """Elements of one type: node tags (k, corners), and the rows of each physical group."""

    kind: str
    corners: ndarray
    groups: dict[int, Any]


class _Found:
    def __init__(self, form: MeshFormat):
        self.form = form
        self.content = None
        self.labels = None
        self.names = {}
        self.groups = {}
        self.blocks = []
        self.others = {}
        self.links: list[tuple[int, ndarray]] = []

    def take(self, name: str, section: Section) -> None:
        if name == "PhysicalNames":
            self.names = read_names(section, self.form)
        elif name in ("Entities", "PartitionedEntities") and self.form.version >= 4:
            self.groups |= read_entities(self.form.stream(section, np.float64), name != "Entities")
        elif name in NODE_SECTIONS:
            if self.content is not None:
                raise ValueError(
                    "a second one; gmsh adds a view without the mesh if PostProcessing.SaveMesh "
                    "is 0"
                )
            stream = self.form.stream(section, np.float64)
            tags, places = read_nodes(stream, name == "ParametricNodes")
            self.content = stream.content(places)
            self.labels = Labels(tags, "nodes") if len(tags) else None
        elif name in ELEMENT_SECTIONS:
            self.blocks = read_elements(self.form.stream(section, np.int64), self.groups)
        elif name not in ("MeshFormat", "Comments"):
            if name == "Periodic":
                with contextlib.suppress(ValueError):
                    self.links = list(read_links(section, self.form))
            self.others[f"${name[:40]}"] = None


def read(path: pathlib.Path) -> Parts:
    """Reads points, cells and patches: the physical groups of lower dimension than the mesh.

    A group without a name is `physical_` and its tag. Of duplicate names the first of the highest
    dimension stays, others add their dimension and tag.
    """
    data = path.read_bytes()
    start = _COMMENTS.match(data).end()  # pyright: ignore[reportOptionalMemberAccess]
    found = _Found(_read_format(path, data, start))
    for name, section in cut_sections(path, data, start):
        try:
            found.take(name, section)
        except (ValueError, IndexError, OverflowError) as error:
            if str(path) in str(error):
                raise
            raise ValueError(
                f"{path}: not a .msh file, or a damaged one, in ${name[:40]} ({error})."
            ) from error
    content = found.content
    labels = found.labels
    if content is None or labels is None or not found.blocks:
        raise ValueError(
            f"{path}: no mesh, the file holds no $Nodes or no $Elements, or none in them."
        )
    with faults_of(path):
        blocks = [
            block._replace(corners=labels.find(block.corners, f"a {block.kind}"))
            for block in found.blocks
        ]
    grid, patches, notes = make_grid(content.points, blocks, found.names)
    top = max(DIMENSION.get(kind, 0) for kind, _ in grid.blocks)
    sides = [pairs for level, pairs in found.links if level == top - 1]
    periodic = tuple(_pair_patches(sides, labels.rows.ids, patches))
    unread = [name for name in found.others if name != "$Periodic" or not periodic]
    notes += note_unread("sections ", unread)
    known = {"labels": labels.rows.ids, "periodic": periodic}
    return of_grid(path, NAME, content, grid, patches, notes, **known)


def read_links(section: Section, form: MeshFormat) -> Iterator[tuple[int, ndarray]]:
    """Yields the dimension of each periodic pair of entities, and tags (k, 2): node, its origin."""
    if form.version <= 4:  # of the transform there are words
        text = blank_out(rb"(?m)^[ \t]*Affine[^\n]*", section.content)
        section = section._replace(text=text, start=0, stop=len(text))
    # before version 4 the section is text in a binary file, too
    form = form._replace(is_text=form.is_text or form.version < 4)
    stream = form.stream(section, np.float64)
    for _ in range(stream.one("n")):
        level = int(stream.take("i", 3)[0])
        if form.version > 4:
            stream.skip(stream.one("n"), "d")
        yield level, stream.take("n", 2 * stream.one("n")).reshape(-1, 2)
    stream.end()


def _pair_patches(sides: list[ndarray], tags: ndarray, patches: list[Patch]) -> Iterator[Periodic]:
    """Yields pairs of patches: for each pair of entities the smallest patches that hold them."""
    names = collections.Counter(patch.name for patch in patches)
    own = sorted((p for p in patches if names[p.name] == 1), key=lambda patch: len(patch.nodes))
    pairs = {}
    for side in sides:
        found = [
            next((patch.name for patch in own if Rows(tags[patch.nodes]).mask(nodes).all()), None)
            for nodes in side.T
        ]
        if None not in found and found[0] != found[1]:
            pairs[found[1], found[0]] = None
    return itertools.starmap(Periodic, pairs)


def make_grid(
    points: ndarray, blocks: list[ElementBlock], names: GroupNames
) -> tuple[Grid, list[Patch], tuple[str, ...]]:
    """Makes a grid, patches of the groups of lower dimension, and a note on the others."""
    groups = list(_gather_groups(blocks, names))
    cells = [(block.kind, reordered(block.kind, block.corners, GMSH, None)) for block in blocks]
    top = max(DIMENSION.get(kind, 0) for kind, _ in cells)
    notes = tuple(regions_note(patch.name for level, patch in groups if level == top))
    return Grid(points, cells, {}, {}), [patch for level, patch in groups if level < top], notes


def _gather_groups(blocks: list[ElementBlock], names: GroupNames) -> Iterator[tuple[int, Patch]]:
    """Yields dimension and nodes of each group, of the highest dimension first."""
    own = (
        ((DIMENSION.get(block.kind, 0), tag), block, rows)
        for block in blocks
        for tag, rows in block.groups.items()
    )
    nodes = gathered((key, block.corners[rows].ravel()) for key, block, rows in own)
    for (level, tag), members in sorted(nodes.items(), key=lambda item: -item[0][0]):
        name = names.get((level, tag)) or names.get((None, tag)) or f"physical_{tag}"
        yield level, Patch(name, f"{GMSH_LEVELS[level]}_{tag}", members)


def _read_format(path: pathlib.Path, data: bytes, start: int) -> MeshFormat:
    """Reads `$MeshFormat`; version 1 begins with `$NOD` in its place."""
    head, words, rest = (data[start : start + 400] + b"\n\n").split(b"\n", 2)
    if head.strip() == b"$NOD":
        return MeshFormat(1.0, True)
    if head.strip() != b"$MeshFormat":
        remedy = ""
        if data.startswith(codecs.BOM_UTF8):
            remedy = " The file begins with a byte order mark: save it without."
        first = decoded(head).strip()[:40]
        message = f"not a .msh file; $MeshFormat is expected here, not {first!r}.{remedy}"
        raise Section(path, data, start + len(head) + 1, len(data)).error(message)
    found = _VERSION_LINE.match(words)
    if found is None:
        said = decoded(words).strip()[:40]
        raise ValueError(
            f"{path}: .msh of version {said!r}; 1, 2, 4.0 and 4.1 are read, then 0 or 1, and 4 or "
            "8."
        )
    version, binary, size = (float(word) for word in found.groups())
    order = BYTE_ORDERS.get(rest[:4]) if binary else "<"
    if order is None:
        raise ValueError(
            f"{path}: a binary .msh file without the number 1 that tells its byte order."
        )
    if version > 4:
        return MeshFormat(version, not binary, order, int(size))
    return MeshFormat(version // 1, not binary, order, has_levels=version > 2)


def cut_sections(path: pathlib.Path, data: bytes, at: int) -> Iterator[tuple[str, Section]]:
    while (at := data.find(b"$", at)) >= 0:
        start = data.find(b"\n", at) + 1
        name = data[at + 1 : start].strip()
        stop = data.find((b"$END" if name in (b"NOD", b"ELM") else b"$End") + name, start)
        if start == 0 or stop < 0:
            raise ValueError(
                f"{path}: ${name.decode(errors='replace')[:40]} has no end: the file is cut short."
            )
        yield decoded(name), Section(path, data, start, stop)
        at = stop + 4 + len(name)


def read_names(section: Section, form: MeshFormat) -> GroupNames:
    count, *rows = list(filter(bytes.strip, section.content.split(b"\n"))) or [b""]
    if count.strip() != b"%d" % len(rows):
        raise section.error(
            f"{len(rows)} lines of names in $PhysicalNames; as many as announced expected."
        )
    names: GroupNames = {}
    for k, row in enumerate(rows, start=1):
        match = _GROUP_NAME.fullmatch(row)
        if match is None or (form.has_levels and match[1] is None):
            raise section.error("a dimension, a tag and a name expected.", k)
        names[int(match[1]) if match[1] else None, int(match[2])] = decoded(match[4] or match[3])
    return names


def read_entities(stream: Stream, is_partitioned: bool) -> EntityGroups:
    """Reads the physical groups of entities, or of the pieces into which a partition cuts them."""
    groups: EntityGroups = {}
    if is_partitioned:
        stream.one("n")
        stream.skip(2 * stream.one("n"), "i")  # ghost entities
    for dimension, count in enumerate(stream.take("n", 4).tolist()):
        for _ in range(count):
            tag = stream.one("i")
            if is_partitioned:
                stream.skip(2, "i")  # the entity that it is a piece of
                stream.skip(stream.one("n"), "i")
            stream.skip(3 if dimension == 0 and stream.version > 4 else 6, "d")
            groups[dimension, tag] = np.abs(stream.take("i", stream.one("n"))).tolist()
            if dimension:
                stream.skip(stream.one("n"), "i")  # its boundary
    stream.end()
    return groups


def read_nodes(stream: Stream, is_parametric: bool) -> TaggedNodes:
    """Reads the nodes of `$Nodes`, of version 2's `$ParametricNodes`, or of version 1's `$NOD`."""
    if stream.version < 4:
        total = stream.announced()
        blocks = (
            [_read_parametric(stream) for _ in range(total)]
            if is_parametric
            else [_read_records(stream, total)]
        )
    else:
        count, total = _take_counts(stream)
        blocks = [_read_nodes_of_entity(stream) for _ in range(count)]
    stream.end()
    tags = join_ids(tags for tags, _ in blocks)
    places = join_ids(places for _, places in blocks)
    if len(tags) != total:
        raise ValueError(f"{len(tags)} nodes, and {total} announced")
    return tags, places


def _take_counts(stream: Stream) -> list[int]:
    """Reads how many blocks and entries there are; in version 4.1 two tags follow."""
    return stream.take("n", 4 if stream.version > 4 else 2)[:2].tolist()


def _read_entity(stream: Stream) -> tuple[int, int, int]:
    """Reads an entity's dimension and tag (in version 4.0 swapped), and a number."""
    first, second, third = stream.take("i", 3).tolist()
    return (first, second, third) if stream.version > 4 else (second, first, third)


def _read_nodes_of_entity(stream: Stream) -> TaggedNodes:
    """Reads one entity's nodes; as many parameters as its dimension may follow each."""
    dimension, _, is_parametric = _read_entity(stream)
    count = stream.one("n")
    if dimension not in range(4) or is_parametric not in (0, 1):
        raise ValueError(f"a block of nodes of dimension {dimension}, parametric {is_parametric}")
    parameters = "d" * dimension * is_parametric
    if stream.version < 4.1:
        return _read_records(stream, count, parameters)
    tags = stream.take("n", count)
    return tags, stream.places(count, f"ddd{parameters}")


def _read_records(stream: Stream, count: int, parameters: str = "") -> TaggedNodes:
    """Reads nodes of which each has its tag before its coordinates."""
    kinds = f"iddd{parameters}"
    start = stream.at
    return stream.take("i", count, kinds), start + stream.width("i") + stream.width(
        kinds
    ) * np.arange(count)


def _read_parametric(stream: Stream) -> TaggedNodes:
    """Reads a node: tag, coordinates, entity (dimension, tag), parameters (curve 1, surface 2)."""
    node = _read_records(stream, 1)
    dimension = int(stream.take("i", 2)[0])
    if dimension not in range(4):
        raise ValueError(f"a node on an entity of dimension {dimension}")
    stream.skip(dimension % 3, "d")
    return node


def read_elements(stream: Stream, groups: EntityGroups) -> list[ElementBlock]:
    if stream.version < 4:
        tables = gathered(_read_element_lines(stream) if stream.rows else _read_old_blocks(stream))
        return [_group_by_tags(kind, table[:, 2:], table[:, :2]) for kind, table in tables.items()]
    count, total = _take_counts(stream)
    blocks = []
    for _ in range(count):
        dimension, tag, number = _read_entity(stream)
        size = stream.one("n")
        kind, corners = _find_kind(number)
        if DIMENSION.get(kind, 0) != dimension:
            raise ValueError(f"elements of type {kind} on an entity of dimension {dimension}")
        rows = stream.take("n" if stream.version > 4 else "i", size * (1 + corners)).reshape(
            size, 1 + corners
        )
        blocks.append(
            ElementBlock(
                kind, rows[:, 1:], dict.fromkeys(groups.get((dimension, tag), ()), slice(None))
            )
        )
    stream.end()
    if sum(len(block.corners) for block in blocks) != total:
        raise ValueError(f"not the {total} elements that $Elements announces")
    return blocks


def _find_kind(number: int) -> tuple[str, int]:
    """Finds the type of a number, and how many nodes it has."""
    if number not in GMSH_TYPES:
        raise ValueError(
            f"elements of type {number}; elements of order 1 to 4 are read, from order 3 on with "
            "all inner nodes: "
            "Mesh.SecondOrderIncomplete=0 makes them"
        )
    return GMSH_TYPES[number], CORNERS.get(GMSH_TYPES[number], 1)


def _read_element_lines(stream: Stream) -> Iterator[tuple[str, ndarray]]:
    """Yields types, and two tags and nodes (k, 2 + c): of version 2 in text, and of version 1.

    Lines are number, type, tags and nodes. In version 2 the number of tags comes before them, in
    version 1 that of nodes behind two tags.
    """
    assert stream.rows is not None
    count = len(stream.rows.counts) - 1
    rows = stream.rows.behind_count(f"{count} lines of elements, not as many as announced.")
    values = rows.values
    counts = rows.counts
    first = rows.first
    message = "an element has a number, a type, and numbers of tags or of nodes."
    rows.refuse(counts < (5 if stream.version < 2 else 4), message)
    # two tags and the number of nodes become the number of tags and two tags
    if stream.version < 2:
        places = first[:, None] + np.arange(2, 5)
        values[places] = np.insert(values[places[:, :2]], 0, 2, axis=1)
    types = values[first + 1]
    for number in dict.fromkeys(types.tolist()):
        kind, corners = _find_kind(number)
        chosen = np.flatnonzero(types == number)
        start = first[chosen, None]
        tags = values[start + 2]
        stop = (first + counts)[chosen, None]
        wrong = ((tags < 0) | (stop - start != 3 + tags + corners)).ravel()
        rows.refuse(
            chosen[wrong], lambda k: f"{counts[k]} numbers, not those of its type and tags."
        )
        table = values[np.minimum(start + np.arange(3, 5), len(values) - 1)] * (np.arange(2) < tags)
        yield kind, np.concatenate([table, values[stop + np.arange(-corners, 0)]], axis=1)


def _read_old_blocks(stream: Stream) -> Iterator[tuple[str, ndarray]]:
    """Yields types, and two tags and nodes (k, 2 + c), of the blocks of version 2, binary."""
    left = stream.announced()
    numbers = []
    while left > 0:
        number, count, tags = stream.take("i", 3).tolist()
        if count < 0 or tags < 0:
            raise ValueError(f"{count} elements with {tags} tags")
        kind, corners = _find_kind(number)
        rows = stream.take("i", count * (1 + tags + corners)).reshape(count, 1 + tags + corners)
        numbers.append(rows[:, 0])
        padded = np.pad(rows[:, 1 : 1 + tags], ((0, 0), (0, 2)))
        yield kind, np.concatenate([padded[:, :2], rows[:, 1 + tags :]], axis=1)
        left -= count
    stream.end()
    if left:
        raise ValueError("more elements than announced")
    if numbers:  # bytes that were put in or lost are mostly seen by a number that comes twice
        Labels(np.concatenate(numbers), "elements")


def _group_by_tags(kind: str, corners: ndarray, table: ndarray) -> ElementBlock:
    """Finds groups by tags of group (0: none) and entity; elements of two groups are read once."""
    physical = np.abs(table[:, 0])
    tags = np.unique(physical[physical > 0]).tolist()
    groups = {tag: np.flatnonzero(physical == tag) for tag in tags}
    if len(tags) < 2:
        return ElementBlock(kind, corners, groups)
    # An element's key is its entity and corners. Equal keys are one element, kept where it comes
    # first; `new_rows` is the row of each old element among the kept ones.
    keys = np.column_stack([table[:, 1], corners, physical])
    first, which = first_of_equals(keys[:, :-1])
    if len(first) == len(keys) or len(np.unique(keys, axis=0)) < len(keys):
        # what stands twice in one group is told as a fault
        return ElementBlock(kind, corners, groups)
    order = np.sort(first)
    new_rows = Rows(order).of(first)[which]
    return ElementBlock(kind, corners[order], {tag: new_rows[at] for tag, at in groups.items()})


def check(path: pathlib.Path, mesh: MeshLike) -> None:
    """Refuses patches that boundary faces cannot express, or whose name ends before its end."""
    if content_of(mesh, NAME) is not None:
        return
    for name in mesh.patches:
        if any(mark in name for mark in '"\r\n') or not name:
            raise ValueError(
                f"{path}: {name!r} cannot be the name of a physical group: empty, or with '\"' or "
                "a line break."
            )
    patch_faces(mesh)


def new(mesh: MeshLike) -> Iterator[bytes]:
    """Yields a binary file of version 2.2. A patch is a group of faces of a tag and an entity."""
    points = np.asarray(mesh.points, float)
    markers = patch_faces(mesh)
    blocks = [(kind, 0, np.asarray(ids)) for kind, ids in mesh.cells.items()]
    level = DIMENSION[blocks[0][0]] - 1
    names = [f'{level} {tag} "{name}"\n' for tag, name in enumerate(markers, start=1)]
    for tag, faces in enumerate(markers.values(), start=1):
        blocks += [(kind, tag, corners) for kind, corners in faces.items() if len(corners)]
    yield b"$MeshFormat\n2.2 1 8\n" + np.array(1, "<i4").tobytes() + b"\n$EndMeshFormat\n"
    if names:
        yield f"$PhysicalNames\n{len(names)}\n{''.join(names)}$EndPhysicalNames\n".encode()
    rows = np.zeros(len(points), [("tag", "<i4"), ("x", "<f8", 3)])
    rows["tag"] = 1 + np.arange(len(points))
    rows["x"][:, : points.shape[1]] = points
    yield f"$Nodes\n{len(points)}\n".encode() + rows.tobytes() + b"\n$EndNodes\n"
    yield f"$Elements\n{sum(len(corners) for *_, corners in blocks)}\n".encode()
    first = 1
    for kind, tag, corners in blocks:
        table = np.full((len(corners), 3 + corners.shape[1]), tag, "<i4")
        table[:, 0] = first + np.arange(len(corners))
        table[:, 3:] = 1 + reordered(kind, corners, None, GMSH)
        yield np.array([GMSH_NUMBERS[kind], len(corners), 2], "<i4").tobytes() + table.tobytes()
        first += len(corners)
    yield b"\n$EndElements\n"
