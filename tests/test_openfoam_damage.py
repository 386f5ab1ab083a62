"""OpenFOAM cases with damage: each is told by its file, none is misread, none costs memory."""

import gzip
import re

import foam
import numpy as np
import pytest
from foam import PATCHES, mixed

from jaxmorph import io
from jaxmorph.io.openfoam.file import FoamPatch, load_file, read_patches

FILES = ("points", "faces", "owner", "neighbour", "boundary")


@pytest.fixture
def case(tmp_path):
    foam.write_case(tmp_path / "a", *mixed(), PATCHES)
    return tmp_path / "a"


def changed(case, name, old, new, count=1):
    file = case / "constant" / "polyMesh" / name
    text = file.read_text()
    head, body = re.split(r"(?<=\})\n", text, maxsplit=1)
    assert re.search(old, body), body[:300]
    file.write_text(head + "\n" + re.sub(old, new, body, count=count))


NO_GOOD = "has no good type, nFaces and startFace"
COUNT = r"\d+(?=\s*\()"
REFUSED = [
    ("neighbour", r"(?<=\(\n)\d+", "-1", "neighbour: face 0 is of cell -1, which is none"),
    ("neighbour", r"(?<=\(\n)\d+", "-7", "is of cell -7"),
    (
        "neighbour",
        r"(?<=\(\n)\d+",
        f"{2**31 - 1}",
        "neighbour: face 0 is of cell 2147483647, which is none",
    ),
    ("neighbour", "3\n\\(", "4\n(", "4 elements of 1 labels expected, found 3 numbers"),
    ("owner", r"(?<=\(\n)\d+", f"{2**62}", "owner: face 0 is of cell 4611686018427387904, which"),
    ("owner", r"\d+(?=\n\))", "-1", "owner: face .* is of cell -1"),
    ("owner", "\n0\n", "\n0.5\n", "elements of 1 labels expected"),
    ("points", "12\n\\(", "13\n(", "13 elements of 3 scalars expected, found 36 numbers"),
    (
        "points",
        r"12\n((?:.*\n){11}).*\n.*\n",
        r"10\n\1",
        "a face names node 11, but there are points 0 to 9",
    ),
    ("points", r"12\n\([\s\S]*", "60000000{(0 0 0)}\n", "60000000 elements that are all equal"),
    ("faces", r"4\(", "3(", "or other numbers of labels"),
    ("faces", r"(?<=\()\d+(?= \d+ \d+)", "2147483000", "faces: a face names node 2147483000"),
    (
        "boundary",
        r"startFace\s+3;",
        "startFace 2;",
        "faces are in the wrong number of patches; face",
    ),
    ("boundary", r"\"floor\"\s*\{[^{}]*\}", "", r"boundary: \d patches announced, \d read"),
    (
        "boundary",
        r"\d+\s*\(\s*\"floor\"\s*\{[^{}]*\}",
        "(",
        "1 faces are in the wrong .* face 3, an outer face, is in",
    ),
    ("boundary", "nFaces", "nFacets", f'patch "floor" {NO_GOOD}'),
    *(("boundary", key + r"\s+\w+", f"{key} ", NO_GOOD) for key in ("type", "nFaces", "startFace")),
    *((name, COUNT, "9" * 100_000, f"{name}: a list.* expected") for name in FILES),
]
"""A file, what in its body is replaced by what, and the message."""


@pytest.mark.parametrize(("name", "old", "new", "message"), REFUSED)
def test_what_cannot_be_is_told(case, name, old, new, message):
    changed(case, name, old, new)
    with pytest.raises(ValueError, match=message):
        io.read(case)


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("form", ["ascii", "binary", "binary-separate-faces"])
def test_damaged_files_are_named(tmp_path, name, form):
    foam.write_case(tmp_path / "a", *mixed(), PATCHES, foam.FORMS[form])
    file = tmp_path / "a" / "constant" / "polyMesh" / name
    whole = file.read_bytes()
    for content in (b"", whole[:-60], b"a text"):
        file.write_bytes(content)
        if name != "boundary" or len(content) < 10:
            with pytest.raises(ValueError, match=name):
                io.read(tmp_path / "a")


@pytest.mark.parametrize(
    ("width", "message"),
    [(b"80", "scalars of 80 bits are not known"), (b"32", "cut short, or its header's arch")],
)
def test_another_width_is_told(tmp_path, width, message):
    foam.write_case(tmp_path / "a", *mixed(), PATCHES, foam.FORMS["binary"])
    file = tmp_path / "a" / "constant" / "polyMesh" / "points"
    file.write_bytes(file.read_bytes().replace(b"scalar=64", b"scalar=" + width))
    with pytest.raises(ValueError, match=message):
        io.read(tmp_path / "a")


def test_a_wrong_node_of_a_face_leaves_cells_open(case):
    """Every corner of every face, tetrahedra and hexahedra alike: with another node, its cells do not close."""
    file = case / "constant" / "polyMesh" / "faces"
    head, text = re.split(r"(?<=17\n)", file.read_text())
    places = list(re.finditer(r"(?<=[( ])\d+", text))
    assert len(places) == 8 * 4 + 9 * 3
    for place in places:
        file.write_text(
            head + text[: place.start()] + str((int(place[0]) + 3) % 9) + text[place.end() :]
        )
        with pytest.raises(ValueError, match=r"[12] cells do not close, first cell \d"):
            io.read(case)


def test_a_list_of_patches_that_is_cut_short(case):
    """Wherever the list of patches ends too soon, also after an empty patch, it is told."""
    file = case / "constant" / "polyMesh" / "boundary"
    text = file.read_text().rstrip()
    end = text.rindex(")")
    for stop in range(text.index("}") + 2, end):
        file.write_text(text[:stop])
        with pytest.raises(ValueError, match="boundary"):
            io.read(case)


def test_patches_with_comments_dictionaries_and_groups(case):
    file = case / "constant" / "polyMesh" / "boundary"
    file.write_text(
        """FoamFile { class polyBoundaryMesh; note "a; b"; }
        // 7
        2 ( /* a wall */ "the wall" { type wall; coupling { type none; nFaces 9; } inGroups List<word> 2(wall all);
        nFaces 3; startFace 8; } outlet { inGroups (all); startFace 11; type patch; nFaces 0; } ) // end"""
    )
    wall, outlet = read_patches(load_file(file.parent, "boundary"))
    assert wall == FoamPatch("the wall", "wall", 8, 3, ("wall", "all"))
    assert outlet == FoamPatch("outlet", "patch", 11, 0, ("all",))


DIRECTIVES = [(r"\d+\s*\(", '#include "patches"\n3 ('), (r"\d+\s*\(", '3 ( #include "patches"\n')]
DIRECTIVES += [
    (r"nFaces\s+\d+", 'nFaces #calc "1 + 1"'),
    (r"type\s+\w+", "type $kind"),
    (r"type\s+\w+", "$all; type patch"),
]


@pytest.mark.parametrize(("pattern", "text"), DIRECTIVES)
def test_directives_and_variables_are_refused_by_name(case, pattern, text):
    """What a solver would put in their place is not known. In a dictionary of a patch they do no harm."""
    changed(case, "boundary", r"type\s+patch;", 'type patch; coupling { value #calc "2"; }')
    assert "rest" in io.read(case).patches
    changed(case, "boundary", pattern, text)
    with pytest.raises(
        ValueError, match=r"boundary: [#$]\w+ is not read, nor are other directives"
    ):
        io.read(case)


@pytest.mark.parametrize(
    "text", ["a" * 100_000, "/*" * 50_000, "{" * 50_000, "a{" * 50_000, '"' * 50_000]
)
def test_long_words_take_no_longer_than_others(case, text):
    """A pattern that is tried from each letter to the end would take minutes."""
    file = case / "constant" / "polyMesh" / "boundary"
    file.write_text(f"FoamFile {{ class polyBoundaryMesh; }}\n1\n({text}\n")
    with pytest.raises(ValueError, match="boundary: "):
        io.read(case)


def test_a_damaged_gz_file(case):
    file = case / "constant" / "polyMesh" / "points"
    packed = bytearray(gzip.compress(file.read_bytes()))
    file.unlink()
    rng = np.random.default_rng(0)
    for place in rng.integers(10, len(packed) - 8, 40):
        packed[place] ^= 0xFF
        file.with_name("points.gz").write_bytes(bytes(packed))
        with pytest.raises(ValueError, match=r"points\.gz|points"):
            io.read(case)
        packed[place] ^= 0xFF


def test_lists_without_their_counts_are_read(tmp_path):
    """Of faces with four corners each, and of others."""
    brick = np.array([(x, y, z) for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))])
    whole = (brick, foam.hexahedra([range(8)]), [("all", "wall", lambda face: True)])
    shapes = {"hexahedron": whole, "mixed": (*mixed(), PATCHES)}
    for shape, case in shapes.items():
        foam.write_case(tmp_path / shape, *case)
        right = io.read(tmp_path / shape)
        for name in FILES:
            changed(tmp_path / shape, name, COUNT, "")
        found = io.read(tmp_path / shape)
        np.testing.assert_array_equal(found.points, right.points)
        assert repr(found) == repr(right)


def test_a_packed_file_that_grows_without_end(case, monkeypatch):
    monkeypatch.setattr("jaxmorph._host.package.files.UNPACKED", (1000, 100))
    file = case / "constant" / "polyMesh" / "points"
    head = file.read_text().split("}", 1)[0] + "}\n"
    file.unlink()
    file.with_name("points.gz").write_bytes(gzip.compress(head.encode() + b" " * 10**6))
    with pytest.raises(ValueError, match=r"points\.gz: .* MB are in it, and more"):
        io.read(case)
