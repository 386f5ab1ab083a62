"""SU2 files of several zones: each a mesh, moved alone or together, the others byte for byte."""

import json

import numpy as np
import pytest
from meshes import bricks, unit_grid
from runs import all_refused, printed, refused

import jaxmorph as jm
from jaxmorph import io
from jaxmorph.cli import main


def square(n, at=0.0):
    """A square of n x n quads from x = `at`, with a marker on each side."""
    mesh, ids = unit_grid(n), np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    patches = {"left": ids[0], "right": ids[-1], "low": ids[:, 0], "high": ids[:, -1]}
    return jm.Mesh(mesh.points + np.array([at, 0]), mesh.cells, patches)


@pytest.fixture
def path(tmp_path):
    """Two squares side by side, with comments and indices that stay; their zones meet at x = 1."""
    texts = []
    for k, mesh in enumerate((square(4), square(6, 1.0)), start=1):
        io.write(tmp_path / "one.su2", mesh)
        text = (tmp_path / "one.su2").read_text().replace("MARKER_TAG= ", f"MARKER_TAG= zone{k}_")
        texts.append(f"% zone {k}\nIZONE= {k}\n{text}")
    (tmp_path / "one.su2").unlink()
    (tmp_path / "a.su2").write_text("NZONE= 2\n" + "".join(texts))
    return tmp_path / "a.su2"


def halves(path):
    """The lines of each zone."""
    head, first, second = path.read_text().split("% zone ")
    return head, first, second


def test_each_zone_is_a_mesh(path):
    first, second = io.read_zones(path)
    for mesh, right, k in ((first, square(4), 1), (second, square(6, 1.0), 2)):
        np.testing.assert_array_equal(mesh.points, right.points)
        np.testing.assert_array_equal(mesh.cells["quad"], right.cells["quad"])
        assert set(mesh.patches) == {f"zone{k}_{side}" for side in right.patches}
        np.testing.assert_array_equal(mesh.patches[f"zone{k}_low"], right.patches["low"])


@pytest.mark.parametrize("which", [0, 1])
def test_one_zone_moves_alone(path, which):
    zones = io.read_zones(path)
    moved = zones[which].moved(zones[which].points * np.pi)
    io.write(path.with_name("b.su2"), moved)
    again = io.read_zones(path.with_name("b.su2"))
    np.testing.assert_array_equal(again[which].points, moved.points)
    before, after = halves(path), halves(path.with_name("b.su2"))
    assert [a == b for a, b in zip(before, after, strict=True)] == [True, which == 1, which == 0]
    io.write_zones(path.with_name("c.su2"), [moved])
    assert path.with_name("c.su2").read_bytes() == path.with_name("b.su2").read_bytes()
    io.write_zones(path.with_name("same.su2"), zones)
    assert path.with_name("same.su2").read_bytes() == path.read_bytes()


@pytest.mark.nightly
def test_a_wall_between_zones_moves_in_both(path):
    """Their nodes are where the motion of the wall takes them, which two zones have at x = 1."""
    zones, moved = io.read_zones(path), []
    for mesh, wall in zip(zones, ("zone1_right", "zone2_left"), strict=True):
        rest = [name for name in mesh.patches if name != wall]
        plan = jm.prepare(mesh, wall, rest, method=jm.Laplacian())
        y = mesh.points[plan.moving, 1]
        u = np.stack([0.1 * np.sin(np.pi * y), 0 * y], axis=1)
        moved.append(mesh.moved(jm.deform(plan, u)))
    io.write_zones(path.with_name("b.su2"), moved[::-1])
    first, second = io.read_zones(path.with_name("b.su2"))
    for mesh, wall in ((first, "zone1_right"), (second, "zone2_left")):
        at = mesh.points[mesh.patch(wall)]
        ends = np.isin(at[:, 1], (0, 1))
        np.testing.assert_allclose(at[:, 0], 1 + 0.1 * np.sin(np.pi * at[:, 1]), atol=1e-9)
        assert ends.sum() == 2
        assert int(jm.quality(mesh).inverted) == 0


@pytest.mark.nightly
def test_a_config_moves_one_zone_and_draws_it(path, capsys):
    config = path.with_name("def.cfg")
    config.write_text(
        "MESH_FILENAME= a.su2\nMESH_OUT_FILENAME= b.su2\nDV_KIND= TRANSLATION\nDV_PARAM= (1, 0, 0)\nDV_VALUE= -0.125\n"
        "DV_MARKER= ( zone2_right )\nMARKER_SYM= ( zone2_low, zone2_high )\n"
    )
    refused(
        capsys,
        ["su2", "def", str(config)],
        "a.su2: the file holds 2 zones, .* --zone 1 is the first",
    )
    refused(
        capsys,
        ["su2", "def", str(config), "--zone", "3"],
        "MESH_FILENAME= .*a.su2 has 2 zones, not the zone 3",
    )
    refused(capsys, ["su2", "dot", str(config), "--picture", "b.png"], "--picture is for su2 def")
    picture = path.with_name("b.png")
    said = printed(capsys, ["su2", "def", str(config), "--zone", "2", "--picture", str(picture)])
    assert f"picture  {picture}" in said
    assert picture.read_bytes().startswith(b"\x89PNG")
    before, after = halves(path), halves(path.with_name("b.su2"))
    assert [a == b for a, b in zip(before, after, strict=True)] == [True, True, False]
    second = io.read_zones(path.with_name("b.su2"))[1]
    np.testing.assert_allclose(second.points[second.patch("zone2_right"), 0], 2 - 0.125)
    refused(
        capsys,
        ["info", str(path), "--picture", "a.png"],
        "--picture is of one zone, .* has 2: quality --zone 1",
    )
    for words in (["info", str(path.with_name("one.su2"))], ["quality", str(path), "--zone", "1"]):
        io.write(path.with_name("one.su2"), square(3))
        picture.unlink()
        assert f"picture  {picture}" in printed(capsys, [*words, "--picture", str(picture)])
        assert picture.exists()


def test_what_is_refused(path):
    zones, target = io.read_zones(path), path.with_name("b.su2")
    all_refused(
        (lambda: io.read(path), r"holds 2 zones, each a mesh of its own: io\.read_zones"),
        (lambda: io.write_zones(target, [zones[0], io.read_zones(path)[1]]), "not of one reading"),
        (lambda: io.write_zones(target, [zones[0], zones[0]]), "one zone is twice"),
        (lambda: io.write_zones(target, []), r"zones that io\.read_zones has read"),
        (lambda: io.write_zones(target, [bricks(2)]), r"zones that io\.read_zones has read"),
        (lambda: io.write_zones(path, zones), "read from this file"),
        (lambda: io.write_zones(target, [zones[0].moved(zones[0].points * np.nan)]), "not finite"),
        (
            lambda: io.read_zones(path.with_suffix(".vtu")),
            "have zones that are meshes of their own",
        ),
    )
    text = path.read_text()
    for old, new, message in (
        ("NZONE= 2", "NZONE= 3", "NZONE= 3, but 2 zones are in the file"),
        ("IZONE= 2", "IZONE= 1", "IZONE= is 1, 1; 1 to 2 expected"),
        ("IZONE= 2\n", "", "NZONE= 2, but 1 zones are in the file"),
    ):
        path.write_text(text.replace(old, new))
        with pytest.raises(ValueError, match=message):
            io.read_zones(path)
    assert not target.exists()


def test_a_file_of_one_zone_is_read_either_way(tmp_path):
    io.write(tmp_path / "a.su2", square(2))
    (tmp_path / "b.su2").write_text("NZONE= 1\nIZONE= 1\n" + (tmp_path / "a.su2").read_text())
    for name in "ab":
        (mesh,) = io.read_zones(tmp_path / f"{name}.su2")
        np.testing.assert_array_equal(mesh.points, io.read(tmp_path / f"{name}.su2").points)


@pytest.mark.slow
def test_zones_on_the_command_line(path, capsys):
    """`info` shows each zone; `deform --zone 2` moves the second alone, as io.write does, and `quality` judges it."""
    out = path.with_name("b.su2")
    text = printed(capsys, ["info", str(path)])
    assert "a.su2 zone 1: 2-D, 25 points" in text
    assert "a.su2 zone 2: 2-D, 49 points" in text
    assert [
        zone["points"]
        for zone in json.loads(printed(capsys, ["info", str(path), "--json"]))["zones"]
    ] == [25, 49]
    words = [
        "deform",
        str(path),
        str(out),
        "--moving",
        "zone2_low",
        "--fixed",
        "zone2_.*",
        "--translate",
        "0",
        "0.01",
    ]
    assert main([*words, "--zone", "2"]) == 0
    before, after = halves(path), halves(out)
    assert [a == b for a, b in zip(before, after, strict=True)] == [True, True, False]
    first, second = io.read_zones(path)[1], io.read_zones(out)[1]
    low = first.patches["zone2_low"]
    np.testing.assert_allclose(second.points[low], first.points[low] + [0, 0.01], atol=1e-12)
    assert main(["quality", str(path), str(out), "--zone", "2"]) == 0
    refused(capsys, words, "--zone 1 is the first")
    refused(capsys, [*words, "--zone", "3"], "--zone 3: ")


def test_numbers_of_zones_are_those_of_the_file(path):
    """Zones are listed by their numbers, wherever they stand."""
    head, first, second = path.read_text().split("% zone ")
    path.write_text(f"{head}% zone {second}\n% zone {first}")
    assert [len(mesh.points) for mesh in io.read_zones(path)] == [25, 49]
