"""SU2's native mesh format, 2-D and 3-D (su2code.github.io/docs_v7/Mesh-File).

A mesh that came from an SU2 file goes back into a copy of its text, with new coordinates and
nothing else changed. A file of several zones is several meshes.
"""

import collections
import dataclasses
import os
import pathlib
from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from jaxmorph import Mesh
from jaxmorph._host.cells.pieces import boundary_faces
from jaxmorph._host.cells.topology import CORNERS, VTK
from jaxmorph._host.package.arguments import checked
from jaxmorph._host.package.files import complete, input_path
from jaxmorph._mesh.exchange import Parts, checked_parts

from ._format import Arrays, MeshLike, Source, patch_faces, source_of
from ._registry import check_nodes, check_output
from ._text import Rows, Section, blank_comments, decoded, replace

NAME = "SU2"
TYPES = {number: kind for kind, number in VTK.items()}
SIZES = {1: 1} | {number: CORNERS[kind] for kind, number in VTK.items()}
"""Corners of each of SU2's types of elements: VTK's numbers, corners in VTK's order.

Type 1 is the single node of a SEND_RECEIVE marker.
"""
DIALECT = {"MARKERTAG": "MARKER_TAG", "MARKERELEMS": "MARKER_ELEMS"}
"""Other spellings of keywords that files have."""
HALO = "SEND_RECEIVE"
"""The tag of all markers between the parts of a mesh in parts."""
ROWS = 1 << 16
"""Rows of a new file formatted together."""


@dataclasses.dataclass(frozen=True)
class Keyword:
    """Holds a line `NAME= value`, and the lines up to the next keyword."""

    name: str
    value: str
    section: Section

    def number(self, least: int = 0) -> int:
        """Reads the value's first whole number: `NPOIN= 9 6` counts with and without halos."""
        words = self.value.split()
        if not words or not words[0].isdecimal() or int(words[0]) < least:
            raise self.section.error(f"{self.name}= must be followed by a whole number, found {self.value[:40]!r}.")
        return int(words[0])


@dataclasses.dataclass(frozen=True)
class SU2Content:
    """Keeps the text of a file, and where its coordinates are."""

    text: bytes
    start: int
    stop: int
    shape: tuple[int, int]


def read(path: pathlib.Path) -> Parts:
    """Reads points in the order of the file; `patches` are the markers, joined by name.

    With `NMARK= 0` the patch is `boundary`. Markers of one tag are one boundary to SU2, too.

    Index columns after coordinates and corners are not looked at, as SU2 itself does not; all rows
    have them or none. `MARKERTAG=` and `MARKERELEMS=` are read as `MARKER_TAG=` and
    `MARKER_ELEMS=`.
    """
    text = path.read_bytes()
    zones = by_zones(path, text)
    if len(zones) > 1:
        raise ValueError(
            f"{path}: the file holds {len(zones)} zones, each a mesh of its own: io.read_zones reads them, and io.write_zones "
            "writes some of them, other zones as they are. On the command line --zone 1 is the first."
        )
    return mesh_of(path, text, zones[0])


def by_zones(path: pathlib.Path, text: bytes) -> list[list[Keyword]]:
    """Finds each zone's keywords, by its number: behind its `IZONE=`, and before all zones."""
    keywords = list(_keywords(path, blank_comments(text)))
    cuts = [number for number, keyword in enumerate(keywords) if keyword.name == "IZONE"]
    head, *zones = [keywords[a:b] for a, b in zip([0, *cuts], [*cuts, len(keywords)], strict=True)]
    stated = [keyword for keyword in head if keyword.name == "NZONE"]
    if stated and stated[0].number(least=1) != max(len(zones), 1):
        raise stated[0].section.error(f"NZONE= {stated[0].value}, but {len(zones)} zones are in the file.")
    numbers = [zone[0].number() for zone in zones]
    if sorted(numbers) != list(range(1, len(zones) + 1)):
        raise ValueError(f"{path}: IZONE= is {', '.join(map(str, numbers))}; 1 to {len(zones)} expected, each once.")
    parts = []
    for zone in sorted(zones, key=lambda zone: zone[0].number()) or [[]]:
        names = {keyword.name for keyword in zone}
        parts.append([*(keyword for keyword in head if keyword.name not in names), *zone])
    return parts


def mesh_of(path: pathlib.Path, text: bytes, keywords: list[Keyword]) -> Parts:
    """Reads the points, cells and markers of a zone, or of a file without zones."""
    dimension = _only(path, keywords, "NDIME")
    if (d := dimension.number()) not in (2, 3):
        raise dimension.section.error(f"NDIME= must be 2 or 3, found {d}.")
    rows = _only(path, keywords, "NPOIN")
    points = np.concatenate(list(_points(rows, d)))
    cells = _joined(_elements(_only(path, keywords, "NELEM"), len(points)))
    content = SU2Content(text, rows.section.start, rows.section.stop, points.shape)
    patches = _markers(path, keywords, len(points))
    tags = collections.Counter(keyword.value for keyword in keywords if keyword.name == "MARKER_TAG")
    again = {tag: count for tag, count in tags.items() if count > 1 and tag != HALO}
    notes = tuple(f"the {count} markers {tag} are one patch, as they are to SU2." for tag, count in again.items())
    if not patches:
        outer = boundary_faces(cells, len(points)).values()
        patches = {"boundary": np.concatenate([corners.ravel() for corners in outer])}
    return checked_parts(points, cells, patches, Source(path, NAME, content, notes=notes))


def check(path: pathlib.Path, mesh: MeshLike) -> None:
    """Raises `ValueError` for patches that a new file cannot have.

    Boundary faces cannot express them, or their name is no tag of a marker.
    """
    if source_of(mesh, NAME) is not None:
        return
    curved = [kind for kind in mesh.cells if kind not in VTK]
    if curved:
        raise ValueError(f"{path}: SU2's files hold linear cells, not {', '.join(curved)}; write .msh or .vtu.")
    for name in mesh.patches:
        if name != name.strip() or not name or any(mark in name for mark in "%=\r\n"):
            raise ValueError(
                f"{path}: {name!r} cannot be the tag of an SU2 marker: blank ends, '%', '=' or a line break."
            )
    patch_faces(mesh)


def write(path: pathlib.Path, mesh: MeshLike, point_data: Arrays, cell_data: Arrays) -> None:
    """Writes the mesh's own text with new coordinates; else a new file, see `_new_text`."""
    source = source_of(mesh, NAME)
    points = np.asarray(mesh.points)
    with path.open("wb") as file:
        if source is None:
            file.writelines(_new_text(mesh))
            return
        content: SU2Content = source.content
        if points.shape != content.shape:
            raise ValueError(f"the mesh has points of shape {points.shape}; {source.path} has {content.shape}.")
        file.writelines(with_points(content.text, content.start, content.stop, points))


def with_points(text: bytes, start: int, stop: int, points: np.ndarray) -> Iterator[bytes | memoryview]:
    """Yields the text with `points` (n, d) in place of the points from `start` to `stop`."""
    d = points.shape[1]
    return replace(text, slice(start, stop), points, lambda counts: counts >= d)


def _keywords(path: pathlib.Path, text: bytes) -> Iterator[Keyword]:
    lines = []
    at = text.find(b"=")
    while at >= 0:
        start = text.rfind(b"\n", 0, at) + 1
        end = text.find(b"\n", at) + 1 or len(text)
        name, _, value = text[start:end].partition(b"=")
        name = name.removeprefix(b"\xef\xbb\xbf").strip().decode(errors="replace")
        name = DIALECT.get(name, name)
        lines.append((name, decoded(value.strip()), start, end))
        at = text.find(b"=", end)
    for number, (name, value, _, end) in enumerate(lines, start=1):
        stop = lines[number][2] if number < len(lines) else len(text)
        yield Keyword(name, value, Section(path, text, end, stop))


def _only(path: pathlib.Path, keywords: list[Keyword], name: str) -> Keyword:
    matches = [keyword for keyword in keywords if keyword.name == name]
    if not matches:
        small = any(keyword.name.upper() == name for keyword in keywords)
        cause = "SU2's keywords are in capitals" if small else "it is not an SU2 mesh, or it is cut short"
        raise ValueError(f"{path}: no {name}= in this file; {cause}.")
    if len(matches) > 1:
        raise matches[1].section.error(f"a second {name}=; zones of a file begin with IZONE=.")
    return matches[0]


def _points(keyword: Keyword, d: int) -> Iterator[np.ndarray]:
    n, section = keyword.number(least=1), keyword.section
    row, width = 0, 0
    for block in section.blocks(np.float64):
        width = width or int(block.counts[0])
        wrong = np.flatnonzero((block.counts < d) | (block.counts > d + 2) | (block.counts != width))
        if wrong.size:
            count = block.counts[wrong[0]]
            others = f", {width} on the rows before" if count != width else ""
            message = f"a point of {d} coordinates expected, found {_numbers(int(count))}{others}."
            raise section.error(message, row + int(wrong[0]))
        indices = block.columns(slice(None), d, width)
        if (indices != np.floor(indices)).any():
            bad = int(np.argmax((indices != np.floor(indices)).any(axis=1)))
            message = f"a point of {d} coordinates and its index expected, found {indices[bad].tolist()} as index."
            raise section.error(message, row + bad)
        points = block.columns(slice(None), 0, d)
        finite = np.isfinite(points).all(axis=1)
        if not finite.all():
            bad = int(np.argmin(finite))
            raise section.error(f"point {row + bad} is not finite: {points[bad].tolist()}.", row + bad)
        yield points.copy()
        row += len(points)
    _check_count(keyword, n, row, "points")


def _elements(keyword: Keyword, n: int) -> Iterator[dict[str, np.ndarray]]:
    for tables in _tables(keyword, keyword.section, n, "elements"):
        if 1 in tables:
            raise keyword.section.error("NELEM= holds elements of type 1 (a single node); these are no cells.")
        yield {TYPES[kind]: corners for kind, corners in tables.items()}


def _joined(tables: Iterable[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    parts: dict[str, list[np.ndarray]] = {}
    for table in tables:
        for kind, corners in table.items():
            parts.setdefault(kind, []).append(corners)
    return {kind: np.concatenate(parts.pop(kind)) for kind in list(parts)}


def _markers(path: pathlib.Path, keywords: list[Keyword], n: int) -> dict[str, np.ndarray]:
    patches: dict[str, list[np.ndarray]] = {}
    tags = [number for number, keyword in enumerate(keywords) if keyword.name == "MARKER_TAG"]
    for at in tags:
        tag, rest = keywords[at], keywords[at + 1 : at + 3]
        if not rest or rest[0].name != "MARKER_ELEMS":
            raise tag.section.error(f"MARKER_ELEMS= expected after the tag {tag.value!r}.")
        # a SEND_RECEIVE marker has one more keyword, SEND_TO=, before its rows
        section = rest[1].section if len(rest) > 1 and rest[1].name == "SEND_TO" else rest[0].section
        nodes = patches.setdefault(tag.value, [])
        for table in _tables(rest[0], section, n, f"elements of marker {tag.value!r}"):
            nodes.extend(corners.ravel() for corners in table.values())
    stated = _only(path, keywords, "NMARK")
    if stated.number() != len(tags):
        raise stated.section.error(f"NMARK= {stated.number()}, but {len(tags)} markers are in the file.")
    return {name: np.concatenate([*nodes, np.zeros(0, np.int64)]) for name, nodes in patches.items()}


def _tables(keyword: Keyword, section: Section, n: int, what: str) -> Iterator[dict[int, np.ndarray]]:
    """Yields corners (k, corners) by SU2's number of the type, in order of first appearance."""
    row, extra = 0, None
    for block in section.blocks(np.int64):
        table: dict[int, np.ndarray] = {}
        kinds = block.columns(slice(None), 0, 1).ravel()
        for kind in dict.fromkeys(kinds[np.sort(np.unique(kinds, return_index=True)[1])].tolist()):
            rows = np.flatnonzero(kinds == kind)
            extra = block.counts[rows[0]] - 1 - SIZES.get(kind, 0) if extra is None else extra
            corners = _corners(section, block, rows, kind, (row, int(extra)))
            if ((corners < 0) | (corners >= n)).any():
                outside = int(np.argmax(((corners < 0) | (corners >= n)).any(axis=1)))
                nodes = corners[outside].tolist()
                raise section.error(f"nodes {nodes}, but there are points 0 to {n - 1}.", row + int(rows[outside]))
            table[kind] = corners.astype(np.int32 if n < 2**31 else np.int64)
        row += len(kinds)
        yield table
    _check_count(keyword, keyword.number(), row, what)


def _corners(section: Section, block: Rows, rows: np.ndarray, kind: int, place: tuple[int, int]) -> np.ndarray:
    """Reads corners of elements of one kind, the `rows` of a block from row `place` on.

    Also returns the columns after corners.
    """
    row, extra = place
    if kind not in SIZES:
        known = ", ".join(map(str, SIZES))
        raise section.error(f"element type {kind} is not known; SU2's are {known}.", row + int(rows[0]))
    corners = SIZES[kind]
    counts = block.counts[rows] - 1 - corners
    wrong = rows[(counts < 0) | (counts > 1) | (counts != extra)]
    if wrong.size:
        alone = counts[wrong[0] == rows][0] in (0, 1)  # right by itself
        others = "" if not alone else ", and an index as the rows before have" if extra else ", and no index before it"
        message = (
            f"an element of type {kind} has {corners} nodes{others}, found {_numbers(int(block.counts[wrong[0]]))}."
        )
        raise section.error(message, row + int(wrong[0]))
    return block.columns(slice(None) if len(rows) == len(block.counts) else rows, 1, 1 + corners)


def _numbers(count: int) -> str:
    return f"{count} {'number' if count == 1 else 'numbers'}"


def _check_count(keyword: Keyword, stated: int, count: int, what: str) -> None:
    if count != stated:
        raise keyword.section.error(f"{keyword.name}= {stated}, but {count} rows of {what} follow.")


def _new_text(mesh: MeshLike) -> Iterator[bytes]:
    """Yields a new file in pieces; patches become markers, of faces between their nodes."""
    points = np.asarray(mesh.points)
    n, d = points.shape
    markers = patch_faces(mesh)
    yield f"NDIME= {d}\nNELEM= {sum(len(corners) for corners in mesh.cells.values())}\n".encode()
    for kind, corners in mesh.cells.items():
        yield from _element_rows(kind, np.asarray(corners))
    yield f"NPOIN= {n}\n".encode()
    row = " ".join(["%r"] * d) + "\n"
    for start in range(0, n, ROWS):
        block = points[start : start + ROWS]
        yield ((row * len(block)) % tuple(block.ravel().tolist())).encode()
    yield f"NMARK= {len(markers)}\n".encode()
    for name, faces in markers.items():
        yield f"MARKER_TAG= {name}\nMARKER_ELEMS= {sum(map(len, faces.values()))}\n".encode()
        for kind, corners in faces.items():
            yield from _element_rows(kind, corners)


def _element_rows(kind: str, corners: np.ndarray) -> Iterator[bytes]:
    row = f"{VTK[kind]} " + " ".join(["%d"] * corners.shape[1]) + "\n"
    for start in range(0, len(corners), ROWS):
        block = corners[start : start + ROWS]
        yield ((row * len(block)) % tuple(block.ravel().tolist())).encode()


@checked
def read_zones(path: str | os.PathLike[str]) -> tuple[Mesh, ...]:
    """Reads each zone of an SU2 file (`NZONE= 2`) as a mesh, in the order of `IZONE=`.

    Zones are moved alone or together: a wall that two zones have moves in both where each is given
    its displacement. `write` writes the file with one zone moved, `write_zones` with several. All
    else stays byte for byte.

    **Arguments:**

    - `path`: the file, .su2.

    **Returns:** the meshes; one for a file without zones.

    **Raises:** `ValueError` for what `read` refuses, and for other formats, whose zones `read`
    joins to one mesh.
    """
    path = input_path(path)
    if path.suffix.lower() != ".su2":
        raise ValueError(
            f"{path}: SU2 files (.su2) have zones that are meshes of their own; io.read joins the zones of other formats."
        )
    text = path.read_bytes()
    meshes = [mesh_of(path, text, zone) for zone in by_zones(path, text)]
    for mesh in meshes:
        check_nodes(path, mesh)
    return tuple(Mesh(*mesh) for mesh in meshes)


@checked
def write_zones(path: str | os.PathLike[str], meshes: Sequence[Mesh]) -> None:
    """Writes the zones' SU2 file with the coordinates of some of them, all else byte for byte.

    The file appears when it is complete.

    **Arguments:**

    - `path`: the file to write, .su2; its folder must exist.
    - `meshes`: zones that `read_zones` has read from one file together, then moved. Those left out
      stay as they are.

    **Raises:** `ValueError` for none, for meshes of several files, or of several readings, one zone
    twice, and what `write` refuses.
    """
    contents = []
    for mesh in meshes:
        source = source_of(mesh, NAME)
        contents.append(None if source is None else source.content)
        check_output(path, mesh)
        bad = np.flatnonzero(~np.isfinite(np.asarray(mesh.points)).all(axis=1))
        if len(bad):
            raise ValueError(f"{path}: {len(bad)} points are not finite, first node {bad[0]}.")
    if pathlib.Path(path).suffix.lower() != ".su2" or not contents or None in contents:
        raise ValueError(
            f"{path}: `meshes` must be zones that io.read_zones has read, and the file end in .su2; io.write writes other meshes."
        )
    if any(content.text is not contents[0].text for content in contents):
        raise ValueError(
            f"{path}: `meshes` are not of one reading of one file: read its zones together, io.read_zones."
        )
    if len({content.start for content in contents}) < len(contents):
        raise ValueError(f"{path}: one zone is twice in `meshes`.")
    text = contents[0].text
    # from the last zone to the first, so that places of earlier zones stay
    for content, mesh in sorted(zip(contents, meshes, strict=True), key=lambda pair: -pair[0].start):
        text = b"".join(with_points(text, content.start, content.stop, np.asarray(mesh.points)))
    with complete(pathlib.Path(path)) as partial:
        partial.write_bytes(text)
