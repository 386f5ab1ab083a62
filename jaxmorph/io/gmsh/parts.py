"""Nodes, elements, and the physical groups of entities, out of the sections of a .msh file."""

import dataclasses
from typing import NamedTuple

import numpy as np

from jaxmorph._host.cells.topology import DIMENSION, NODES

from .._meshio import meshio
from .sections import Stream, whole

TYPES = meshio.gmsh.common._gmsh_to_meshio_type | {118: "pyramid30", 119: "pyramid55"}
CORNERS_OF = NODES | {"vertex": 1}
RUN = 1 << 16
"""Rows of varying width that are looked at together."""

Groups = dict[tuple[int, int], list[int]]
"""Tags of the physical groups of an entity, by its dimension and tag."""


class Nodes(NamedTuple):
    """Tags (n,) of nodes, and places of their x (n,): numbers of a text, bytes of a binary file."""

    tags: np.ndarray
    places: np.ndarray


@dataclasses.dataclass(frozen=True)
class Elements:
    """Elements of one type: node tags (k, corners), rows by physical group; None is all rows."""

    kind: str
    corners: np.ndarray
    groups: dict[int, np.ndarray | None]


def entities(stream: Stream, *, is_partitioned: bool) -> Groups:
    """Reads the physical groups of entities, or of the pieces into which a partition cuts them."""
    groups: Groups = {}
    if is_partitioned:
        stream.one("n")
        stream.take("i", 2 * stream.one("n"))  # ghost entities
    for dimension, count in enumerate(stream.take("n", 4).tolist()):
        for _ in range(count):
            tag = stream.one("i")
            if is_partitioned:
                stream.take("i", 2)  # the entity that it is a piece of
                stream.take("i", stream.one("n"))
            stream.take("d", 3 if dimension == 0 and stream.form.version > 4 else 6)
            groups[dimension, tag] = np.abs(stream.take("i", stream.one("n"))).tolist()
            if dimension:
                stream.take("i", stream.one("n"))  # its boundary
    stream.end()
    return groups


def nodes(stream: Stream, *, is_parametric: bool) -> Nodes:
    """Reads the nodes of `$Nodes`, of version 2's `$ParametricNodes`, or of version 1's `$NOD`."""
    version = stream.form.version
    if version < 4:
        total = stream.announced()
        blocks = [_with_parameters(stream, total) if is_parametric else _records(stream, total, 3)]
    else:
        count, total, *_ = stream.take("n", 4 if version > 4 else 2).tolist()
        blocks = [_block(stream) for _ in range(count)]
    stream.end()
    empty = np.zeros(0, np.int64)
    tags, places = (np.concatenate([empty, *(block[k] for block in blocks)]) for k in (0, 1))
    if len(tags) != total:
        raise ValueError(f"{len(tags)} nodes, and {total} announced")
    if (np.diff(tags) <= 0).any() and (again := total - len(np.unique(tags))):
        raise ValueError(f"{again} tags of nodes come a second time")
    return Nodes(tags, places)


def _block(stream: Stream) -> Nodes:
    """Reads one entity's nodes; as many parameters as its dimension may follow each."""
    first, second, is_parametric = stream.take("i", 3).tolist()
    count, dimension = stream.one("n"), first if stream.form.version > 4 else second
    if dimension not in range(4) or is_parametric not in (0, 1):
        raise ValueError(f"a block of nodes of dimension {dimension}, parametric {is_parametric}")
    width = 3 + dimension * is_parametric
    if stream.form.version < 4.1:
        return _records(stream, count, width)
    tags, step = stream.take("n", count), width * stream.width("d")
    return Nodes(tags, stream.skip(count, step) + step * np.arange(count))


def _records(stream: Stream, count: int, width: int) -> Nodes:
    """Reads rows of a tag and `width` numbers."""
    step = stream.width("i") + width * stream.width("d")
    start = stream.skip(count, step)
    return Nodes(whole(_column(stream, start, count, step)), start + stream.width("i") + step * np.arange(count))


def _column(stream: Stream, start: int, count: int, step: int) -> np.ndarray:
    """Returns ints `step` apart unchanged; in a text file they are floats."""
    if stream.rows is not None:
        return stream.rows.values[start : start + count * step : step]
    return np.ndarray((count,), stream.form.dtype("i"), stream.data, start, (step,))


def _with_parameters(stream: Stream, total: int) -> Nodes:
    """Reads rows of tag, coordinates, entity (dimension, tag), and parameters (curve 1, surface 2).

    Rows of one width are read together.
    """
    head, double = 3 * stream.width("i") + 3 * stream.width("d"), stream.width("d")
    before = stream.width("i") + 3 * double
    tags, places = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    while total > 0:
        stream.skip(1, head)
        stream.at -= head
        dimension = int(whole(_column(stream, stream.at + before, 1, 1))[0])
        if dimension not in range(4):
            raise ValueError(f"a node on an entity of dimension {dimension}")
        step = head + dimension % 3 * double
        count = min(total, RUN, (stream.stop - stream.at) // step)
        others = np.flatnonzero(_column(stream, stream.at + before, count, step) != dimension) if count else np.zeros(0)
        count = int(others[0]) if len(others) else count
        start = stream.skip(max(count, 1), step)
        tags.append(whole(_column(stream, start, count, step)))
        places.append(start + stream.width("i") + step * np.arange(count))
        total -= count
    return Nodes(np.concatenate(tags), np.concatenate(places))


def elements(stream: Stream, groups: Groups) -> list[Elements]:
    """Reads the elements."""
    if stream.form.version < 4:
        return _numbered(stream) if stream.rows is None else _lines(stream)
    blocks, total, *_ = stream.take("n", 4 if stream.form.version > 4 else 2).tolist()
    result, kind_of_number = [], "n" if stream.form.version > 4 else "i"
    for _ in range(blocks):
        first, second, number = stream.take("i", 3).tolist()
        count, kind = stream.one("n"), _kind(number)
        entity = (first, second) if stream.form.version > 4 else (second, first)
        if (0 if kind == "vertex" else DIMENSION.get(kind, entity[0])) != entity[0]:
            raise ValueError(f"elements of type {kind} on an entity of dimension {entity[0]}")
        width = 1 + CORNERS_OF[kind]
        stream.skip(count, width * stream.width(kind_of_number))
        stream.at -= count * width * stream.width(kind_of_number)
        rows = stream.take(kind_of_number, count * width).reshape(count, width)
        result.append(Elements(kind, rows[:, 1:], dict.fromkeys(groups.get(entity, ()))))
    stream.end()
    if sum(len(block.corners) for block in result) != total:
        raise ValueError(f"not the {total} elements that $Elements announces")
    return result


def _kind(number: int) -> str:
    kind = TYPES.get(number, "")
    if kind != "vertex" and kind not in NODES:
        name = f"type {number}, {kind}" if kind else f"type {number}"
        raise ValueError(
            f"elements of {name}; elements of order 1 to 4 are read, from order 3 on with all inner nodes: "
            "Mesh.SecondOrderIncomplete=0 makes them"
        )
    return kind


def _lines(stream: Stream) -> list[Elements]:
    """Reads lines of number, type, tags and nodes: version 2 in text, and version 1.

    In version 2 the number of tags comes before them, in version 1 that of nodes behind two tags.
    """
    assert stream.rows is not None
    values, counts, first = stream.rows.values, stream.rows.counts, stream.rows.first
    if not len(counts) or counts[0] != 1 or values[0] != len(counts) - 1:
        raise stream.section.error(f"{len(counts) - 1} lines of elements, not as many as announced.", 0)
    counts, first, is_first = counts[1:], first[1:], stream.form.version < 2
    head = 5 if is_first else 3
    if (counts < head).any():
        line = 1 + int((counts < head).argmax())
        raise stream.section.error("an element has a number, a type, and numbers of tags or of nodes.", line)
    numbers, tags = values[first + 1], np.zeros_like(first) if is_first else values[first + 2]
    known, place = np.unique(numbers, return_inverse=True)
    corners = np.array([CORNERS_OF[_kind(number)] for number in known.tolist()], np.int64)[place]
    wanted = head + tags + corners
    wrong = np.flatnonzero((counts != wanted) | (tags < 0) | (is_first & (values[first + head - 1] != corners)))
    if len(wrong):
        raise stream.section.error(f"{counts[wrong[0]]} numbers, {wanted[wrong[0]]} expected.", 1 + int(wrong[0]))
    result = []
    for number in dict.fromkeys(numbers.tolist()):
        rows = np.flatnonzero(numbers == number)
        corners = (first + head + tags)[rows][:, None] + np.arange(CORNERS_OF[TYPES[number]])
        table = [np.where(tags[rows] > k, values[first[rows] + 3 + np.minimum(k, tags[rows])], 0) for k in (0, 1)]
        table = [values[first[rows] + 2 + k] for k in (0, 1)] if is_first else table
        result.append(_of_version_2(TYPES[number], values[corners], np.stack(table)))
    return result


def _numbered(stream: Stream) -> list[Elements]:
    """Reads blocks of a type, a number of elements and one of tags: version 2, binary."""
    left, blocks = stream.announced(), []
    while left > 0:
        number, count, tags = stream.take("i", 3).tolist()
        if count < 0 or tags < 0:
            raise ValueError(f"{count} elements with {tags} tags")
        width = 1 + tags + CORNERS_OF[_kind(number)]
        rows = stream.take("i", count * width).reshape(count, width)
        table = np.zeros((2, count), np.int64)
        table[: min(tags, 2)] = rows[:, 1 : 1 + min(tags, 2)].T
        blocks.append((TYPES[number], rows[:, 1 + tags :], table))
        left -= count
    stream.end()
    if left:
        raise ValueError("more elements than announced")
    result = []
    for kind in dict.fromkeys(kind for kind, _, _ in blocks):
        of_kind = [(corners, table) for other, corners, table in blocks if other == kind]
        corners, table = np.concatenate([rows for rows, _ in of_kind]), np.hstack([tags for _, tags in of_kind])
        result.append(_of_version_2(kind, corners, table))
    return result


def _of_version_2(kind: str, corners: np.ndarray, table: np.ndarray) -> Elements:
    """Finds groups of elements: `table` (2, k) has tags of physical group (0: none) and entity.

    In version 2 an element of two groups stands twice, with the second group: it is read once.
    """
    physical, entity = np.abs(table[0]), table[1]
    tags = np.unique(physical[physical > 0]).tolist()
    groups: dict[int, np.ndarray | None] = {tag: np.flatnonzero(physical == tag) for tag in tags}
    if len(tags) < 2:
        return Elements(kind, corners, groups)
    # An element's key is its entity and corners. Equal keys are one element, kept where it comes
    # first; `new` is the row of each old element among the kept ones.
    keys = np.column_stack([entity, corners, physical])
    first, which = np.unique(keys[:, :-1], axis=0, return_index=True, return_inverse=True)[1:]
    if len(first) == len(keys) or len(np.unique(keys, axis=0)) < len(keys):
        return Elements(kind, corners, groups)  # what stands twice in one group is told as a fault
    order = np.sort(first)
    new = np.searchsorted(order, first)[which.ravel()]
    return Elements(kind, corners[order], {tag: new[rows] for tag, rows in groups.items()})
