"""SU2 files by ranges: moved, judged and written as they are whole, whatever the size of a range."""

import json
import re

import numpy as np
import pytest
from small import bricks

import jaxmorph as jm
from jaxmorph import io
from jaxmorph.cli import main

PATCHES = ["--moving", "floor", "--fixed", "rest"]
TURN, LIFT = [*PATCHES, "--rotate", "6"], [*PATCHES, "--translate", "0", "0", "0.1", "--free", "sides"]


def box(folder):
    """A box of 27 hexahedra in an SU2 file, with a comment that looks like a keyword in front of each section."""
    mesh = bricks()
    points = np.asarray(mesh.points)
    sides = np.flatnonzero((points[:, :2] == 0).any(axis=1) | (points[:, :2] == 1).any(axis=1))
    patches = mesh.patches | {"rest": np.flatnonzero(points[:, 2] == 1), "sides": sides}
    io.write(folder / "plain.su2", jm.Mesh(points, mesh.cells, patches))
    text = (folder / "plain.su2").read_text()
    text = re.sub("^(NELEM|NPOIN|NMARK)=", r"% NPOIN= 3 here\n\1=", text, flags=re.M)
    (folder / "box.su2").write_text(text.replace("NPOIN= 64\n", "NPOIN= 64 % n= 64\n % x= 1\n"))
    return folder / "box.su2"


def ring(folder):
    """An O-grid of quads and, in its outer layer, triangles."""
    angle, radius = np.meshgrid(np.arange(24) * np.pi / 12, [1.0, 1.1, 1.4, 2.5, 4.0])
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1).reshape(-1, 2)
    ids = np.arange(len(points)).reshape(angle.shape)
    beside = np.roll(ids, -1, axis=1)
    quads = np.stack([ids[:-1], ids[1:], beside[1:], beside[:-1]], axis=-1)
    outer = quads[-1]
    cells = {"quad": quads[:-1].reshape(-1, 4), "triangle": np.concatenate([outer[:, [0, 1, 2]], outer[:, [0, 2, 3]]])}
    io.write(folder / "ring.su2", jm.Mesh(points, cells, {"floor": ids[0], "rest": ids[-1]}))
    return folder / "ring.su2"


def facts(capsys, *arguments):
    """The exit status, and what the command says as JSON."""
    capsys.readouterr()
    status = main([*map(str, arguments), "--json"])
    return status, json.loads(capsys.readouterr().out)


def numbers(said):
    names = ("cells", "inverted", "mean_skewness", "max_skewness", "max_aspect_ratio")
    return [said[when][name] for when in ("before", "after") for name in names] + [said["after"]["min_volume_ratio"]]


@pytest.mark.slow
@pytest.mark.parametrize("make", [ring, box])
def test_ranges_move_and_judge_as_the_whole_does(tmp_path, capsys, make):
    file = make(tmp_path)
    turn = TURN if make is ring else LIFT
    status, whole = facts(capsys, "deform", file, tmp_path / "whole.su2", *turn)
    assert status == 0
    expected, old = io.read(tmp_path / "whole.su2").points, io.read(file).points
    assert np.abs(expected - old).max() > 0.05
    for rows in (17, 1000):
        status, said = facts(capsys, "deform", file, tmp_path / f"{rows}.su2", *turn, "--ranges", rows)
        assert status == 0
        np.testing.assert_allclose(io.read(tmp_path / f"{rows}.su2").points, expected, rtol=0, atol=1e-12)
        np.testing.assert_allclose(numbers(said), numbers(whole), rtol=1e-9)
        a, b = (re.sub(rb"[-+.\de]+(?=[ \n])", b"", path.read_bytes()) for path in (file, tmp_path / f"{rows}.su2"))
        assert a == b
    assert {path.name for path in tmp_path.iterdir()} == {file.name, "whole.su2", "17.su2", "1000.su2"} | (
        {"plain.su2"} if make is box else set()
    )


def test_the_surface_is_that_of_the_whole_mesh(tmp_path):
    whole, mesh = io.read(box(tmp_path)), io.Ranges(tmp_path / "box.su2", 10)
    surface, ids = mesh.surface(), io.global_nodes(mesh.surface())
    np.testing.assert_array_equal(whole.points[ids], surface.points)
    assert {name: ids[each].tolist() for name, each in surface.patches.items()} == {
        name: each.tolist() for name, each in whole.patches.items()
    }
    plan = jm.prepare(whole, "floor", "rest", free="sides")
    u = 0.05 * np.ones((len(plan.moving), 3))
    half = jm.prepare_surface(surface, "floor", "rest", free="sides", nodes=ids, faces=dict(surface.cells))  # pyright: ignore[reportArgumentType]
    for k in range(len(mesh)):
        nodes = np.where(np.isin(mesh.nodes(k), half.surface_nodes), mesh.nodes(k), -1)
        mesh.put(k, np.asarray(jm.deform(half.attach(mesh.read(k), nodes), u)))
    np.testing.assert_allclose(mesh.after, np.asarray(jm.deform(plan, u)), rtol=0, atol=1e-12)
    assert sum(len(part.cells["hexahedron"]) for part, _ in mesh.cells()) == 27
    mesh.write(tmp_path / "ranges.su2")
    io.write(tmp_path / "whole.su2", whole.moved(mesh.after))
    assert (tmp_path / "ranges.su2").read_bytes() == (tmp_path / "whole.su2").read_bytes()


def test_faces_between_ranges_are_counted(tmp_path):
    """27 cubes, 9 a range, in the order of the file: a plane of 9 faces between each two."""
    mesh = io.Ranges(box(tmp_path), 9)
    between = [np.asarray(part.between) for part, _ in mesh.cells()]
    assert sorted(map(len, between)) == [9, 9, 18]


def test_bad_cells_are_not_written(tmp_path, capsys):
    status, said = facts(
        capsys, "deform", ring(tmp_path), tmp_path / "out.su2", *PATCHES, "--translate", "3.5", "0", "--ranges", 20
    )
    assert status == 1
    assert said["after"]["inverted"] > 0
    assert [path.name for path in tmp_path.iterdir()] == ["ring.su2"]


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (["--ranges", "0"], "--ranges must be 1 or more"),
        (["--ranges", "9", "--chunk", "5"], "--chunk is not for --ranges"),
        (["--ranges", "9", "--decomposed"], "--ranges is not for --decomposed"),
        (["--ranges", "9", "--method", "elasticity"], "--ranges is not for elasticity"),
    ],
)
def test_what_needs_the_whole_mesh_is_refused(tmp_path, capsys, flags, says):
    assert (
        main(["deform", str(ring(tmp_path)), str(tmp_path / "out.su2"), *PATCHES, "--translate", "0", "0.1", *flags])
        == 2
    )
    assert says in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["ring.su2"]


def test_files_that_ranges_cannot_take(tmp_path):
    file = ring(tmp_path)
    text = file.read_text()
    file.write_text(text.replace("NMARK= 2", "NMARK= 1")[: text.index("MARKER_TAG= rest")])
    with pytest.raises(ValueError, match="leave out a part of the boundary"):
        io.Ranges(file, 9).surface()
    file.write_text(text.replace("NPOIN= 120", "NPOIN= 121"))
    with pytest.raises(ValueError, match="NPOIN= 121, but 120 rows of points follow"):
        io.Ranges(file, 9)
    file.write_bytes(b"")
    with pytest.raises(ValueError, match="the file is empty"):
        io.Ranges(file, 9)
    with pytest.raises(ValueError, match=r"SU2 files \(.su2\)"):
        io.Ranges(tmp_path / "a.vtu", 9)
