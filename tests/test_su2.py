"""SU2 files and their free-form boxes: read as written, given back byte for byte."""

import dataclasses

import numpy as np
import pytest
from formats import rewritten
from meshes import unit_grid
from runs import all_refused
from su2 import BOX, CONTROL, PLAIN, written

import jaxmorph as jm
from jaxmorph import io, shapes
from jaxmorph.cli import main
from jaxmorph.io import _text

POINTS = np.array([[0, 0], [1.5, 0.25], [2, 0], [0, 1.0000000000000002], [1, 1], [2, 1]])
WORDS = [
    "0.0",
    "0.0",
    "1.5",
    "0.25",
    "2e0",
    "0.0",
    "0.0",
    "1.0000000000000002",
    "1.0",
    "1.0",
    "2.00",
    "1.0E+00",
]

VARIANTS = {
    "plain": PLAIN,
    "no spaces around =": PLAIN.replace("= ", "="),
    "spaces around =": PLAIN.replace("= ", "   =   "),
    "tabs and blank ends": PLAIN.replace(" ", " \t ").replace("\n", "  \n"),
    "carriage returns": PLAIN.replace("\n", "\r\n"),
    "no index columns": "\n".join(" ".join(line.split()[:-1]) if line[:1].isdigit() and "." in line else line
                                  for line in PLAIN.split("\n")),
    "halo count": PLAIN.replace("NPOIN= 6", "NPOIN= 6 4"),
    "comments": "% by hand, 1 = 1\n" + PLAIN.replace("1.5 0.25 1", "1.5 0.25 1 % a = 7 7 7\n% 9 9 9\n\n"),
    "no end of line": PLAIN.rstrip("\n"),
    "other sections": PLAIN + "NPERIODIC= 1\nPERIODIC_INDEX= 0\n0 0 0\nFFD_TAG= BOX\n1.5 2.5\n",
    "points first": "NDIME= 2\n" + PLAIN[PLAIN.index("NPOIN") :] + PLAIN[PLAIN.index("NELEM") : PLAIN.index("NPOIN")],
    "other spelling of markers": PLAIN.replace("MARKER_", "MARKER"),
    "one zone": "NZONE= 1\nIZONE= 1\n" + PLAIN,
}  # fmt: skip


@pytest.fixture(params=[1 << 24, 7], ids=["whole", "in pieces"])
def chunk(request, monkeypatch):
    monkeypatch.setattr(_text, "CHUNK", request.param)


@pytest.mark.usefixtures("chunk")
@pytest.mark.parametrize("variant", VARIANTS)
def test_every_way_to_write_a_file_is_read_and_given_back(tmp_path, variant):
    """Moved points read back bit for bit, and nothing else changes."""
    text = VARIANTS[variant]
    mesh = io.read(written(tmp_path / "in.su2", text))
    np.testing.assert_array_equal(mesh.points, POINTS)
    assert {kind: corners.tolist() for kind, corners in mesh.cells.items()} == {
        "quad": [[0, 1, 4, 3]],
        "triangle": [[1, 2, 4], [2, 5, 4]],
    }
    assert {name: nodes.tolist() for name, nodes in mesh.patches.items()} == {
        "lower": [0, 1, 2],
        "upper": [3, 4, 5],
    }
    points = np.random.default_rng(0).normal(size=(6, 2)) * 10.0 ** np.arange(-12, 0).reshape(6, 2)
    points[1] = mesh.points[1]
    at = text.index("NPOIN")
    expected = text[:at]
    for value, old, word in zip(
        points.ravel().tolist(), POINTS.ravel().tolist(), WORDS, strict=True
    ):
        start = text.index(word, at)
        expected += text[at:start] + (word if value == old else repr(value))
        at = start + len(word)
    for moved, right in ((mesh, text), (mesh.moved(points), expected + text[at:])):
        io.write(tmp_path / "out.su2", moved)
        assert (tmp_path / "out.su2").read_bytes() == right.encode()
    assert io.read(tmp_path / "out.su2").points.tobytes() == points.tobytes()


def test_what_older_programs_write(tmp_path):
    """Fortran's exponents, names in Latin-1, and no markers at all."""
    text = PLAIN.replace("1.5 0.25", "1.5D0 2.5d-1").replace("lower", "sous la fl\xe8che")
    (tmp_path / "a.su2").write_bytes(text.encode("latin-1"))
    mesh = io.read(tmp_path / "a.su2")
    np.testing.assert_array_equal(mesh.points, POINTS)
    assert list(mesh.patches) == ["sous la fl\xe8che", "upper"]
    io.write(tmp_path / "b.su2", mesh.moved(np.where(POINTS[:, :1] == 0, 7.5, POINTS)))
    assert b"1.5D0 2.5d-1 1" in (tmp_path / "b.su2").read_bytes()
    assert io.read(tmp_path / "b.su2").points[[0, 3]].tolist() == [[7.5, 7.5]] * 2
    mesh = io.read(written(tmp_path / "c.su2", PLAIN[: PLAIN.index("NMARK")] + "NMARK= 0\n"))
    np.testing.assert_array_equal(mesh.patch("boundary"), np.arange(6))


SOLIDS = """NDIME=3
NELEM=4
12 0 1 2 3 4 5 6 7
13 1 8 2 5 9 6
14 4 5 6 7 10
10 5 9 6 10
NPOIN=11
0 0 0
1 0 0
1 1 0
0 1 0
0 0 1
1 0 1
1 1 1
0 1 1
2 .5 0
2 .5 1
.5 .5 2
NMARK=3
MARKER_TAG=floor
MARKER_ELEMS=2
9 0 1 2 3
5 1 8 2
MARKER_TAG=SEND_RECEIVE
MARKER_ELEMS=2
SEND_TO= 1
1 4 0
1 5 0
MARKER_TAG=SEND_RECEIVE
MARKER_ELEMS=1
SEND_TO= -1
1 9 0
"""


def test_every_element_type_and_send_receive(tmp_path):
    mesh = io.read(written(tmp_path / "in.su2", SOLIDS))
    assert {kind: corners.tolist() for kind, corners in mesh.cells.items()} == {
        "hexahedron": [[0, 1, 2, 3, 4, 5, 6, 7]],
        "wedge": [[1, 8, 2, 5, 9, 6]],
        "pyramid": [[4, 5, 6, 7, 10]],
        "tetra": [[5, 9, 6, 10]],
    }
    assert mesh.patch("floor").tolist() == [0, 1, 2, 3, 8]
    assert mesh.patch("SEND_RECEIVE").tolist() == [4, 5, 9]
    io.write(tmp_path / "out.su2", mesh)
    assert (tmp_path / "out.su2").read_text() == SOLIDS


def test_a_mesh_of_no_file_gets_markers_from_its_patches(tmp_path):
    mesh = io.read(written(tmp_path / "in.su2", SOLIDS))
    generated = jm.Mesh(
        mesh.points, mesh.cells, {"floor": mesh.patch("floor"), "roof": [4, 5, 6, 7, 9, 10]}
    )
    io.write(tmp_path / "out.su2", generated)
    text = (tmp_path / "out.su2").read_text()
    # the sides inside, between pyramid, tetrahedron, hexahedron and wedge, are no boundary although the roof has their nodes
    roof = text[text.index("roof") :].split("\n")[2:-1]
    assert sorted(tuple(sorted(map(int, line.split()[1:]))) for line in roof) == [
        *[(4, 5, 10), (4, 7, 10), (5, 9, 10), (6, 7, 10), (6, 9, 10)]
    ]
    again = io.read(tmp_path / "out.su2")
    assert again.points.tobytes() == mesh.points.tobytes()
    for name, nodes in generated.patches.items():
        np.testing.assert_array_equal(again.patch(name), nodes)
    for kind, corners in mesh.cells.items():
        np.testing.assert_array_equal(again.cells[kind], corners)


def test_an_edge_that_two_patches_could_have_goes_to_the_smaller(tmp_path):
    points = np.array([[0.0, 0], [1, 0], [2, 0], [0, 1], [1, 1], [2, 1]])
    walls = {"walls": range(6), "inlet": [0, 3], "outlet": [2, 5]}
    mesh = jm.Mesh(
        points,
        {"quad": [[0, 1, 4, 3], [1, 2, 5, 4]]},
        {name: list(ids) for name, ids in walls.items()},
    )
    io.write(tmp_path / "out.su2", mesh)
    text = (tmp_path / "out.su2").read_text()
    assert "MARKER_TAG= walls\nMARKER_ELEMS= 4\n" in text
    assert "MARKER_TAG= inlet\nMARKER_ELEMS= 1\n3 3 0\n" in text
    again = io.read(tmp_path / "out.su2")
    assert {name: nodes.tolist() for name, nodes in again.patches.items()} == {
        name: list(ids) for name, ids in walls.items()
    }


ONE = "NDIME= 2\nNELEM= 0\nNPOIN= 1\n{}\nNMARK= 0\n"
BAD = {
    "no mesh": ("", "no NDIME="),
    "small letters": (
        PLAIN.replace("NDIME", "ndime"),
        "no NDIME= in this file; SU2's keywords are in capitals",
    ),
    "dimension": (PLAIN.replace("NDIME= 2", "NDIME= 4"), "line 1: NDIME= must be 2 or 3, found 4"),
    "count is no number": (
        PLAIN.replace("NELEM= 3", "NELEM= many"),
        "line 2: NELEM= must be .* found 'many'",
    ),
    "zones": ("NZONE= 2\n" + PLAIN, "line 1: NZONE= 2, but 0 zones are in the file"),
    "unmarked zones": (PLAIN + PLAIN, "line 22: a second NDIME="),
    "too few points": (PLAIN.replace("2e0 0.0 2\n", ""), "line 6: NPOIN= 6, but 5 rows of points"),
    "too few elements": (
        PLAIN.replace("NELEM= 3", "NELEM= 4"),
        "line 2: NELEM= 4, but 3 rows of elements",
    ),
    "cut short": (PLAIN[: PLAIN.index("3 3 4 0")], "line 19: MARKER_ELEMS= 2, but 0 rows"),
    "markers missing": (
        PLAIN[: PLAIN.index("MARKER_TAG= upper")],
        "line 13: NMARK= 2, but 1 markers",
    ),
    "tag without elements": (
        PLAIN.replace("MARKER_ELEMS= 2\n3 0 1\n3 1 2\n", ""),
        "line 14: MARKER_ELEMS= expected",
    ),
    "missing coordinate": (
        PLAIN.replace("2e0 0.0 2", "2e0"),
        "line 9: a point of 2 coordinates, .* found 1 numbers",
    ),
    "word": (PLAIN.replace("2e0 0.0 2", "2e0 abc 2"), "line 9: found 'abc' in place of a number"),
    "glued numbers": (
        PLAIN.replace("2e0 0.0 2", "2e0 0.0-2 2"),
        "line 9: found '0.0-2' in place of a number",
    ),
    "not finite": (
        PLAIN.replace("2e0 0.0 2", "2e0 nan 2"),
        r"line 9: .* found point 2 at \[2.0, nan",
    ),
    "real as id": (
        PLAIN.replace("5 1 2 4 1", "5 1 2.5 4 1"),
        "line 4: found '2.5' in place of an integer",
    ),
    "type": (PLAIN.replace("5 1 2 4 1", "6 1 2 4 1"), "line 4: element type 6 is not known"),
    "corner missing": (
        PLAIN.replace("5 1 2 4 1", "5 1 2"),
        "line 4: an element of type 5 has 3 nodes: 4 numbers and an index",
    ),
    "node out of range": (
        PLAIN.replace("5 1 2 4 1", "5 1 2 6 1"),
        "line 4: there are nodes 0 to 5, and others here",
    ),
    "one coordinate more": (
        PLAIN.replace("2e0 0.0 2", "2e0 0.0 7 2"),
        "line 9: .* found 4 numbers",
    ),
    "three coordinates": (
        PLAIN.replace("1.5 0.25 1", "1.5 0.25 1.5"),
        r"found point 1 at \[1.5, 0.25, 1.5\]",
    ),
    "one node more": (
        PLAIN.replace("5 1 2 4 1", "5 1 2 4 3 1"),
        "line 4: an element of type 5 has 3 nodes: 4 numbers and an index",
    ),
    "one node more without index": (
        PLAIN.replace("3 0 1\n", "3 0 1 2\n"),
        "a.* element of type 3 has 2 nodes",
    ),
    "three numbers more": (
        ONE.format("0.0 0.0 0 0 0"),
        "line 4: a point of 2 coordinates, .* found 5 numbers",
    ),
    "a coordinate alone": (ONE.format("0.0"), "2 coordinates, .* found 1 numbers"),
    "two numbers more on all elements": (
        PLAIN.replace("9 0 1 4 3 0", "9 0 1 4 3 7 0").replace(
            "4 1\n5 2 5 4 2", "4 7 1\n5 2 5 4 7 2"
        ),
        "line 3: an element of type 9 has 4 nodes: 5 numbers and an index",
    ),
    "more markers": (PLAIN.replace("NMARK= 2", "NMARK= 1"), "line 13: NMARK= 1, but 2 markers"),
    "fewer markers": (PLAIN.replace("NMARK= 2", "NMARK= 3"), "NMARK= 3, but 2 markers"),
    "cut before the markers": (PLAIN[: PLAIN.index("NMARK")], "no NMARK= in this file"),
    "no points": (
        ONE.replace("1\n{}", "0"),
        "line 3: NPOIN= must be followed by a whole number, found '0'",
    ),
    "bytes": ("\x00\x01\x02" * 100, "no NDIME="),
}


@pytest.mark.usefixtures("chunk")
@pytest.mark.parametrize("what", BAD)
def test_bad_files_say_where_and_what(tmp_path, what):
    text, message = BAD[what]
    with pytest.raises(ValueError, match=message) as caught:
        io.read(written(tmp_path / "bad.su2", text))
    assert str(caught.value).startswith(str(tmp_path / "bad.su2"))


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_box_is_read_and_goes_back_with_its_control_points_moved(tmp_path, end):
    text = (PLAIN + BOX.format(control=CONTROL)).replace("\n", end)
    mesh = io.read(written(tmp_path / "in.su2", text))
    (box,) = io.boxes(mesh)
    assert (box.name, box.shape.counts, box.shape.box.degrees) == ("MAIN_BOX", (3, 2), (2, 1))
    np.testing.assert_array_equal(
        box.shape.given_corners, [[-0.5, -0.5], [2.5, -0.5], [2.5, 1.5], [-0.5, 1.25]]
    )
    np.testing.assert_allclose(box.control[2, 1], [0.21, 1.0], atol=1e-15)
    assert box.surface["lower"][0].tolist() == [0, 1]
    np.testing.assert_array_equal(box.surface["upper"][1], [[0.5, 0.7]])
    io.write(tmp_path / "same.su2", mesh)
    assert (tmp_path / "same.su2").read_bytes() == text.encode()
    moved = dataclasses.replace(box, control=box.control + np.array([0.5, -0.25]))
    again = rewritten(tmp_path / "out.su2", io.with_boxes(mesh.moved(mesh.points + 1), [moved]))
    np.testing.assert_array_equal(again.points, mesh.points + 1)
    (after,) = io.boxes(again)
    np.testing.assert_array_equal(after.control, moved.control)
    assert all(np.array_equal(a, b) for key in box.surface
               for a, b in zip(after.surface[key], box.surface[key], strict=True))  # fmt: skip
    assert (tmp_path / "out.su2").read_bytes().count(b"\r\n") == (
        text.count("\n") if end == "\r\n" else 0
    )
    io.write(tmp_path / "none.su2", io.with_boxes(mesh, []))
    assert (tmp_path / "none.su2").read_bytes() == PLAIN.replace("\n", end).encode()


def test_a_box_ahead_of_the_points_leaves_them_in_their_place(tmp_path):
    box = BOX.format(control=CONTROL)
    mesh = io.read(
        written(
            tmp_path / "in.su2", PLAIN[: PLAIN.index("NELEM")] + box + PLAIN[PLAIN.index("NELEM") :]
        )
    )
    (box,) = io.boxes(mesh)
    pair = [box, dataclasses.replace(box, name="B")]
    io.write(tmp_path / "out.su2", io.with_boxes(mesh.moved(mesh.points * 2), pair))
    again = io.read(tmp_path / "out.su2")
    np.testing.assert_array_equal(again.points, mesh.points * 2)
    assert [each.name for each in io.boxes(again)] == ["MAIN_BOX", "B"]


@pytest.mark.slow
def test_splines_and_boxes_in_3d(tmp_path):
    corners = np.array(
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1.2, 1], [0, 1, 1.0]]
    )
    cube = "NDIME= 3\nNELEM= 1\n12 0 1 2 3 4 5 6 7\nNPOIN= 8\n" + "".join(
        "{} {} {}\n".format(*at) for at in corners
    )
    mesh = io.read(written(tmp_path / "in.su2", cube + "NMARK= 0\n"))
    shape = shapes.Hexahedron(corners, (4, 3, 2), degree=(2, 1, 1))
    control = np.random.default_rng(0).normal(size=(4, 3, 2, 3))
    (box,) = io.boxes(
        rewritten(tmp_path / "out.su2", io.with_boxes(mesh, [io.Box("WING", shape, control)]))
    )
    assert box.shape.box.degrees == (2, 1, 1)
    np.testing.assert_array_equal(box.control, control)
    np.testing.assert_array_equal(box.shape.given_corners, corners)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("FFD_CORNER_POINTS= 4", "FFD_CORNER_POINTS= 3", "as many rows"),
        ("2.5	1.5\n", "", "as many rows"),
        ("FFD_DEGREE_I= 2\n", "", "no FFD_DEGREE_I"),
        ("lower	0	", "lower	9	", "a node and three coordinates"),
        ("0	0	1	", "0	0	0	", "do not make a lattice"),
        ("2.5	1.5", "2.5	-0.5", "flat or turned"),
    ],
)
def test_a_damaged_box_is_told_with_file_and_line(tmp_path, old, new, says):
    text = BOX.format(control=CONTROL)
    assert old in text
    mesh = io.read(written(tmp_path / "in.su2", PLAIN + text.replace(old, new)))
    with pytest.raises(ValueError, match=rf"in\.su2, line \d+: .*{says}"):
        io.boxes(mesh)


def test_boxes_of_other_meshes(tmp_path):
    mesh = io.read(written(tmp_path / "in.su2", PLAIN))
    assert io.boxes(mesh) == ()
    (box,) = io.boxes(io.read(written(tmp_path / "box.su2", PLAIN + BOX.format(control=CONTROL))))
    all_refused(
        (
            lambda: io.with_boxes(dataclasses.replace(mesh, source=None), [box]),
            "not read from an SU2 file",
        ),
        (lambda: io.with_boxes(mesh, [box, box]), "name of another"),
        (
            lambda: io.with_boxes(mesh, [dataclasses.replace(box, control=box.control[:2])]),
            r"\(3, 2, 2\)",
        ),
    )


def test_info_shows_boxes(tmp_path, capsys):
    assert (
        main(["info", str(written(tmp_path / "box.su2", PLAIN + BOX.format(control=CONTROL)))]) == 0
    )
    assert "MAIN_BOX  degrees 2 x 1," in capsys.readouterr().out


def test_zones_have_boxes_of_their_own(tmp_path):
    one = (tmp_path / "one.su2", tmp_path / "two.su2")
    io.write(one[0], unit_grid(2))
    text = one[0].read_text()
    one[1].write_text(f"NZONE= 2\nIZONE= 1\n{text}IZONE= 2\n{text}")
    corners = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]])
    for k, other in ((0, 1), (1, 0)):
        shape = shapes.Hexahedron(corners, (3, 2))
        box = io.Box("BOX", shape, np.asarray(shape.lattice()))
        mesh = io.with_boxes(io.read_zones(one[1])[k], [box])
        assert [found.name for found in io.boxes(mesh)] == ["BOX"]
        io.write(tmp_path / "out.su2", mesh)
        zones = io.read_zones(tmp_path / "out.su2")
        assert not io.boxes(zones[other])
        np.testing.assert_array_equal(io.boxes(zones[k])[0].shape.given_corners, corners)
        for zone in zones:
            np.testing.assert_array_equal(zone.points, unit_grid(2).points)
        io.write(tmp_path / "back.su2", io.with_boxes(zones[k], []))
        assert (tmp_path / "back.su2").read_text() == one[1].read_text()
