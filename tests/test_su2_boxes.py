"""SU2's free-form boxes in its mesh files: read, changed, written back."""

import dataclasses

import numpy as np
import pytest
from formats import rewritten
from meshes import unit_grid
from runs import all_refused
from su2 import BOX, CONTROL, PLAIN, written

from jaxmorph import io, shapes
from jaxmorph.cli import main


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_box_is_read_and_goes_back_with_its_control_points_moved(tmp_path, end):
    text = (PLAIN + BOX.format(control=CONTROL)).replace("\n", end)
    mesh = io.read(written(tmp_path / "in.su2", text))
    (box,) = io.boxes(mesh)
    assert (box.name, box.shape.counts, box.shape.box.degrees) == ("MAIN_BOX", (3, 2), (2, 1))
    np.testing.assert_array_equal(box.shape.given_corners, [[-0.5, -0.5], [2.5, -0.5], [2.5, 1.5], [-0.5, 1.25]])
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
    assert (tmp_path / "out.su2").read_bytes().count(b"\r\n") == (text.count("\n") if end == "\r\n" else 0)
    io.write(tmp_path / "none.su2", io.with_boxes(mesh, []))
    assert (tmp_path / "none.su2").read_bytes() == PLAIN.replace("\n", end).encode()


def test_a_box_ahead_of_the_points_leaves_them_in_their_place(tmp_path):
    box = BOX.format(control=CONTROL)
    mesh = io.read(written(tmp_path / "in.su2", PLAIN[: PLAIN.index("NELEM")] + box + PLAIN[PLAIN.index("NELEM") :]))
    (box,) = io.boxes(mesh)
    pair = [box, dataclasses.replace(box, name="B")]
    io.write(tmp_path / "out.su2", io.with_boxes(mesh.moved(mesh.points * 2), pair))
    again = io.read(tmp_path / "out.su2")
    np.testing.assert_array_equal(again.points, mesh.points * 2)
    assert [each.name for each in io.boxes(again)] == ["MAIN_BOX", "B"]


@pytest.mark.slow
def test_splines_and_boxes_in_3d(tmp_path):
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1.2, 1], [0, 1, 1.0]])
    cube = "NDIME= 3\nNELEM= 1\n12 0 1 2 3 4 5 6 7\nNPOIN= 8\n" + "".join("{} {} {}\n".format(*at) for at in corners)
    mesh = io.read(written(tmp_path / "in.su2", cube + "NMARK= 0\n"))
    shape = shapes.Hexahedron(corners, (4, 3, 2), degree=(2, 1, 1))
    control = np.random.default_rng(0).normal(size=(4, 3, 2, 3))
    (box,) = io.boxes(rewritten(tmp_path / "out.su2", io.with_boxes(mesh, [io.Box("WING", shape, control)])))
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
        (lambda: io.with_boxes(dataclasses.replace(mesh, source=None), [box]), "not read from an SU2 file"),
        (lambda: io.with_boxes(mesh, [box, box]), "name of another"),
        (lambda: io.with_boxes(mesh, [dataclasses.replace(box, control=box.control[:2])]), r"\(3, 2, 2\)"),
    )


def test_info_shows_boxes(tmp_path, capsys):
    assert main(["info", str(written(tmp_path / "box.su2", PLAIN + BOX.format(control=CONTROL)))]) == 0
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
