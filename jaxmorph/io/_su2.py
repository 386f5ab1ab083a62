"""SU2's native mesh format, 2-D and 3-D (su2code.github.io/docs_v7/Mesh-File)."""

import collections
import dataclasses
import functools
import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from jaxmorph import Mesh
from jaxmorph._host.cells.pieces import outer_pieces
from jaxmorph._host.cells.topology import CORNERS, VTK
from jaxmorph._host.package.arguments import checked
from jaxmorph._host.package.files import PathLike, complete, input_path
from jaxmorph._host.rows import join_ids
from jaxmorph._mesh.exchange import Parts, checked_parts, gathered

from ._format import ArraysByName, MeshLike, Source, faults_of, patch_faces, source_of
from ._places import CoordinatePart, PlacedPoints
from ._registry import check_nodes, check_output
from ._text import Pieces, Section, blank_out, decoded

NAME = "SU2"
SU2_TYPES = {number: kind for kind, number in VTK.items()}
SU2_SIZES = {1: 1} | {number: CORNERS[kind] for kind, number in VTK.items()}
"""Corners of SU2's types of elements, VTK's numbers; 1 is a SEND_RECEIVE marker's node."""
blank_comments = functools.partial(blank_out, rb"%[^\r\n]*")
DIALECT = {"MARKERTAG": "MARKER_TAG", "MARKERELEMS": "MARKER_ELEMS"}
"""Variants of keywords."""
ROWS_TOGETHER = 1 << 16
WANTED = (
    "`meshes` must be zones that io.read_zones has read, and the file end in .su2; io.write "
    "writes other meshes."
)


class Keyword(NamedTuple):
    name: str
    value: str
    section: Section

    def number(self, least: int = 0) -> int:
        """Reads the value's first whole number: `NPOIN= 9 6` counts with and without halos."""
        words = self.value.split()
        if not words or not words[0].isdecimal() or int(words[0]) < least:
            raise self.section.error(
                f"{self.name}= must be followed by a whole number, found {self.value[:40]!r}."
            )
        return int(words[0])


Keywords = list[Keyword]


def read(path: Path) -> Parts:
    """Reads points in the order of the file; `patches` are the markers, joined by name.

    With `NMARK= 0` the patch is `boundary`. Markers of one tag are one boundary to SU2, too. Index
    columns after coordinates and corners are ignored, as by SU2 itself; all rows have them or none.
    `MARKERTAG=` and `MARKERELEMS=` are read as `MARKER_TAG=` and `MARKER_ELEMS=`.
    """
    text = path.read_bytes()
    zones = split_zones(path, text)
    if len(zones) > 1:
        raise ValueError(
            f"the file holds {len(zones)} zones, each a mesh of its own: io.read_zones reads "
            "them, and io.write_zones "
            "writes some of them, other zones as they are. On the command line --zone 1 is the "
            "first."
        )
    return make_zone_mesh(path, text, zones[0])


def split_zones(path: Path, text: bytes) -> list[Keywords]:
    """Finds each zone's keywords, by its number: behind its `IZONE=`, and before all zones."""
    keywords = list(_read_keywords(path, blank_comments(text)))
    cuts = find_all(keywords, "IZONE")
    head, *zones = [keywords[a:b] for a, b in itertools.pairwise([0, *cuts, len(keywords)])]
    _check_zones(head, zones)
    zones = sorted(zones, key=lambda zone: zone[0].number())
    found = [
        [*(word for word in head if word.name not in [own.name for own in zone]), *zone]
        for zone in zones
    ]
    return found or [head]


def find_all(keywords: Sequence[Keyword], name: str) -> list[int]:
    return [place for place, keyword in enumerate(keywords) if keyword.name == name]


def _check_zones(head: Keywords, zones: list[Keywords]) -> None:
    for keyword in head:
        if keyword.name == "NZONE" and keyword.number(least=1) != max(len(zones), 1):
            raise keyword.section.error(
                f"NZONE= {keyword.value}, but {len(zones)} zones are in the file."
            )
    numbers = [zone[0].number() for zone in zones]
    if sorted(numbers) != list(range(1, len(zones) + 1)):
        raise ValueError(
            f"IZONE= is {', '.join(map(str, numbers))}; 1 to {len(zones)} expected, each once."
        )


def make_zone_mesh(path: Path, text: bytes, keywords: Keywords) -> Parts:
    dimension, rows = (_find_only(keywords, name) for name in ("NDIME", "NPOIN"))
    if (d := dimension.number()) not in (2, 3):
        raise dimension.section.error(f"NDIME= must be 2 or 3, found {d}.")
    table = _read_points(rows, d)
    points = np.ascontiguousarray(table[:, :d])
    elements = _find_only(keywords, "NELEM")
    tables = gathered(_read_element_tables(elements, elements.section, len(points), "elements"))
    if 1 in tables:
        raise elements.section.error(
            "NELEM= holds elements of type 1 (a single node); these are no cells."
        )
    cells = {SU2_TYPES[number]: corners for number, corners in tables.items()}
    part = CoordinatePart.in_columns(rows.section, table.shape, slice(d))
    content = PlacedPoints(points.copy(), text, [part], blank_comments)
    patches = _read_marker_nodes(keywords, len(points))
    if not patches:
        patches = {"boundary": join_ids(outer_pieces(cells, len(points)).values())}
    return checked_parts(
        points,
        cells,
        patches,
        Source(path, NAME, content, notes=tuple(_note_shared_tags(keywords))),
    )


def _note_shared_tags(keywords: Keywords) -> Iterator[str]:
    tags = collections.Counter(
        keyword.value for keyword in keywords if keyword.name == "MARKER_TAG"
    )
    for tag, count in tags.items():
        if count > 1 and tag != "SEND_RECEIVE":  # the tag of all markers between parts of a mesh
            yield f"the {count} markers {tag} are one patch, as they are to SU2."


def check(path: Path, mesh: MeshLike) -> None:
    """Refuses patches that boundary faces cannot express, or whose name is no tag of a marker."""
    if source_of(mesh, NAME) is not None:
        return
    curved = [kind for kind in mesh.cells if kind not in VTK]
    if curved:
        raise ValueError(
            f"SU2's files hold linear cells, not {', '.join(curved)}; write .msh or .vtu."
        )
    for name in mesh.patches:
        if name != name.strip() or not name or any(mark in name for mark in "%=\r\n"):
            raise ValueError(
                f"{name!r} cannot be the tag of an SU2 marker: blank ends, '%', '=' or a line "
                "break."
            )
    patch_faces(mesh)


def _read_keywords(path: Path, text: bytes) -> Iterator[Keyword]:
    lines = []
    at = text.find(b"=")
    while at >= 0:
        start = text.rfind(b"\n", 0, at) + 1
        end = text.find(b"\n", at) + 1 or len(text)
        name, _, value = text[start:end].partition(b"=")
        name = decoded(name.removeprefix(b"\xef\xbb\xbf").strip())
        name = DIALECT.get(name, name)
        lines.append((name, decoded(value.strip()), start, end))
        at = text.find(b"=", end)
    for number, (name, value, _, end) in enumerate(lines, start=1):
        stop = lines[number][2] if number < len(lines) else len(text)
        yield Keyword(name, value, Section(path, text, end, stop))


def _find_only(keywords: Keywords, name: str) -> Keyword:
    matches = [keyword for keyword in keywords if keyword.name == name]
    if not matches:
        small = any(keyword.name.upper() == name for keyword in keywords)
        cause = (
            "SU2's keywords are in capitals"
            if small
            else "it is not an SU2 mesh, or it is cut short"
        )
        raise ValueError(f"no {name}= in this file; {cause}.")
    if len(matches) > 1:
        raise matches[1].section.error(f"a second {name}=; zones of a file begin with IZONE=.")
    return matches[0]


def _read_points(keyword: Keyword, d: int) -> ndarray:
    n = keyword.number(least=1)
    rows = keyword.section.rows(np.float64)
    counts = rows.counts
    width = int(counts[:1].sum()) or d
    expected = f"a point of {d} coordinates, and on all rows or none up to 2 indices, expected"
    is_wrong = (counts < d) | (counts > d + 2) | (counts != width)
    rows.refuse(is_wrong, lambda k: f"{expected}, found {counts[k]} numbers.")
    table = rows.values.reshape(-1, width)
    is_good = np.isfinite(table).all(axis=1) & (table[:, d:] == np.floor(table[:, d:])).all(axis=1)
    rows.refuse(~is_good, lambda k: f"{expected}, found point {k} at {table[k].tolist()}.")
    _check_rows(keyword, n, len(table), "points")
    return table


def _read_marker_nodes(keywords: Keywords, n: int) -> ArraysByName:
    tags = find_all(keywords, "MARKER_TAG")
    found = []
    for at in tags:
        tag, *rest = keywords[at : at + 3]
        if not rest or rest[0].name != "MARKER_ELEMS":
            raise tag.section.error(f"MARKER_ELEMS= expected after the tag {tag.value!r}.")
        # SEND_TO of SEND_RECEIVE stands before the rows
        section = rest[-1 if rest[-1].name == "SEND_TO" else 0].section
        tables = _read_element_tables(rest[0], section, n, f"elements of marker {tag.value!r}")
        found.append((tag.value, join_ids(corners for _, corners in tables)))
    stated = _find_only(keywords, "NMARK")
    if stated.number() != len(tags):
        raise stated.section.error(
            f"NMARK= {stated.number()}, but {len(tags)} markers are in the file."
        )
    return gathered(found)


def _read_element_tables(
    keyword: Keyword, section: Section, n: int, what: str
) -> Iterator[tuple[int, ndarray]]:
    """Yields types by SU2's number and corners (k, corners), in order of first appearance."""
    count = 0
    more = None
    for block in section.blocks(np.int64):
        if more is None:  # all rows have an index behind the nodes, or none
            more = min(max(int(block.counts[0]) - 1 - SU2_SIZES.get(int(block.values[0]), 0), 0), 1)
        for kind, rows, table in block.by_kind(0, SU2_SIZES, n, more):
            yield kind, table[:, 1:].astype(np.int32 if n < 2**31 else np.int64)
            count += len(rows)
    _check_rows(keyword, keyword.number(), count, what)


def _check_rows(keyword: Keyword, stated: int, count: int, what: str) -> None:
    if count != stated:
        raise keyword.section.error(f"{keyword.name}= {stated}, but {count} rows of {what} follow.")


def new(mesh: MeshLike) -> Pieces:
    points = np.asarray(mesh.points)
    markers = patch_faces(mesh)
    n, d = points.shape
    yield f"NDIME= {d}\nNELEM= {sum(map(len, mesh.cells.values()))}\n".encode()
    yield from _format_elements(mesh.cells)
    yield f"NPOIN= {n}\n".encode()
    yield from _format_rows(" ".join(["%r"] * d), points)
    yield f"NMARK= {len(markers)}\n".encode()
    for name, faces in markers.items():
        yield f"MARKER_TAG= {name}\nMARKER_ELEMS= {sum(map(len, faces.values()))}\n".encode()
        yield from _format_elements(faces)


def _format_elements(cells: Mapping[str, Any]) -> Pieces:
    for kind, corners in cells.items():
        yield from _format_rows(
            " ".join([str(VTK[kind]), *["%d"] * corners.shape[1]]), np.asarray(corners)
        )


def _format_rows(form: str, table: ndarray) -> Pieces:
    for start in range(0, len(table), ROWS_TOGETHER):
        block = table[start : start + ROWS_TOGETHER]
        yield (f"{form}\n" * len(block) % tuple(block.ravel().tolist())).encode()


@checked
def read_zones(path: PathLike) -> tuple[Mesh, ...]:
    """Reads each zone of an SU2 file (`NZONE= 2`) as a mesh, in the order of `IZONE=`.

    Zones are moved alone or together: a wall that two zones have moves in both where each is given
    its displacement. `write` writes the file with one zone moved, `write_zones` with several.

    **Arguments:**

    - `path`: the file, .su2.

    **Returns:** the meshes; one for a file without zones.

    **Raises:** `ValueError` as `read`, and for other formats, whose zones `read` joins to one mesh.
    """
    path = input_path(path)
    if path.suffix.lower() != ".su2":
        raise ValueError(
            f"{path}: SU2 files have zones that are meshes of their own; io.read joins zones of "
            "others."
        )
    text = path.read_bytes()
    with faults_of(path):
        meshes = [make_zone_mesh(path, text, zone) for zone in split_zones(path, text)]
    for mesh in meshes:
        check_nodes(path, mesh)
    return tuple(itertools.starmap(Mesh, meshes))


@checked
def write_zones(path: PathLike, meshes: Sequence[Mesh]) -> None:
    """Writes the zones' SU2 file with the coordinates of some of them, all else byte for byte.

    The file appears when it is complete.

    **Arguments:**

    - `path`: the file to write, .su2; its folder must exist.
    - `meshes`: zones from one call of `read_zones`, then moved. Those left out stay as they are.

    **Raises:** `ValueError` for no meshes, meshes of several calls, a duplicate zone, and what
    `write` refuses.
    """
    zones = []
    for mesh in meshes:
        source = source_of(mesh, NAME)
        check_output(path, mesh)
        if source is None:
            raise ValueError(f"{path}: {WANTED}")
        zones.append((source.content, mesh))
    if Path(path).suffix.lower() != ".su2" or not zones:
        raise ValueError(f"{path}: {WANTED}")
    text = zones[0][0].raw
    if any(content.raw is not text for content, _ in zones):
        raise ValueError(
            f"{path}: `meshes` are not of one reading of one file: read its zones together, "
            "io.read_zones."
        )
    if len({content.parts[0].start for content, _ in zones}) < len(zones):
        raise ValueError(f"{path}: one zone is twice in `meshes`.")
    # from the last zone to the first, so that places of earlier zones stay
    for content, mesh in sorted(zones, key=lambda zone: -zone[0].parts[0].start):
        text = b"".join(dataclasses.replace(content, raw=text).moved(np.asarray(mesh.points)))
    with complete(Path(path)) as partial:
        partial.write_bytes(text)
