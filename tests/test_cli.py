"""The command line, as a user calls it: what it writes, what it says, how it ends."""

import json
import os
import re
import subprocess
import sys
import time

import foam
import numpy as np
import pytest
from foam import PATCHES, mixed
from meshes import bricks, lattice, ring, sides, tetrahedra, write_ring
from runs import printed, refused, runs

import jaxmorph as jm
from jaxmorph import io
from jaxmorph._mesh.vtk import data_of
from jaxmorph.cli import _output, main


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A ring of quads between a wall of 24 nodes and a far field, as SU2 file; ids of the wall are 0 to 23."""
    folder = tmp_path_factory.mktemp("cli")
    mesh = write_ring(folder / "ring.su2")
    wall = mesh.points[:24] * [1.0, 1.25]
    rows = np.random.default_rng(0).permutation(24)
    lines = "".join(f"{k} {float(wall[k, 0])!r} {float(wall[k, 1])!r}\n" for k in rows)
    (folder / "wall.dat").write_text(lines)
    shift = "".join(f"{k},0.125,-0.25\n" for k in range(24))
    (folder / "shift.csv").write_text("id,dx,dy\n" + shift)
    (folder / "far.dat").write_text("".join(f"{k} 0 0\n" for k in mesh.patch("far")))
    (folder / "text.su2").write_text("This is about = nothing.\n")
    return folder


@pytest.mark.parametrize("words", [["info", "ring.su2"], ["deform", "--help-all"]])
def test_a_reader_that_has_enough_is_no_fault(folder, words):
    """As `head -1`: the command ends with its own status, and says nothing of the pipe."""
    command = [sys.executable, "-m", "jaxmorph", *words]
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    process.stdout.close()
    with process.stderr:
        assert process.stderr.read() == b""
    assert process.wait() == 0


def deform(out: str, *motion: str) -> int:
    return main(["deform", "ring.su2", out, "--moving", "wall", "--fixed", "far", *motion])


def test_rotation_about_a_point_and_what_is_said(here, capsys):
    assert deform("rotated.su2", "--rotate", "30", "--about", "0.5", "-1e-1") == 0
    before, after = io.read("ring.su2"), io.read("rotated.su2")
    c, s = np.sqrt(3) / 2, 0.5
    expected = (before.points[:24] - [0.5, -0.1]) @ np.array([[c, s], [-s, c]]) + [0.5, -0.1]
    np.testing.assert_allclose(after.points[:24], expected, atol=1e-14)
    np.testing.assert_array_equal(after.points[-24:], before.points[-24:])
    said = capsys.readouterr()
    assert said.err == ""
    assert max(map(len, said.out.split("\n"))) <= 80
    report = jm.quality(before, after.points)
    row = re.search(r"max skewness +(\S+) +(\S+)   (\d+) near", said.out)
    assert row
    assert float(row[1]) == pytest.approx(float(jm.quality(before).max_skewness), rel=1e-4)
    assert float(row[2]) == pytest.approx(float(report.max_skewness), rel=1e-4)
    assert int(row[3]) == int(np.argmax(report.skewness))
    assert "inverted cells                    0           0\n" in said.out
    text, original = (here / "rotated.su2").read_text(), (here / "ring.su2").read_text()
    assert text[: text.index("NPOIN")] == original[: original.index("NPOIN")]
    assert text[text.index("NMARK") :] == original[original.index("NMARK") :]


@pytest.mark.slow
def test_the_wall_and_the_overshoot_stand_in_the_table(here, capsys):
    """A camber shears the first grid lines; what Python measures of the written mesh is what was printed."""
    assert deform("wall.su2", "--displacement", "wall.dat", "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    mesh, after = io.read("ring.su2"), io.read("wall.su2")
    wall = jm.wall_quality(mesh, "wall", after.points)
    plan = jm.prepare(mesh, "wall", "far")
    u = after.points[:24] - mesh.points[:24]
    inspection = jm.inspect(plan, u)
    assert float(wall.max_angle) > 1
    values = float(wall.mean_angle), float(wall.max_angle), float(wall.min_height)
    names = ("mean_wall_angle", "max_wall_angle", "min_first_cell_height")
    np.testing.assert_allclose([facts["after"][name] for name in names], values, rtol=1e-9)
    assert [facts["before"][name] for name in names] == [0, 0, 1]
    for name in ("overshoot", "overshoot_behind"):
        assert facts[name] == pytest.approx(getattr(inspection, name), rel=1e-9, abs=1e-9)
    assert deform("wall.su2", "--displacement", "wall.dat") == 0
    text = capsys.readouterr().out
    pattern = r" +\d (.*)   node (\d+) near \("
    row, low = (
        re.search(name + pattern, text) for name in ("max wall angle", "min first-cell height")
    )
    np.testing.assert_allclose([float(row[1]), float(low[1])], values[1:], rtol=1e-4)
    assert (
        float(wall.angle[int(np.flatnonzero(np.asarray(wall.nodes) == int(row[2]))[0])])
        == values[1]
    )
    farther = "   farther than the wall moves" * (inspection.overshoot > 1)
    assert re.search(rf"overshoot +- +\S+{farther}\novershoot behind", text)
    assert max(map(len, text.split("\n"))) <= 80


def test_what_is_done_to_files_and_units_is_said(here, capsys):
    """A file that is replaced, and a motion that has another unit than the mesh."""
    commands = [
        ["deform", "ring.su2", "twice.su2", "--moving", "wall", "--fixed", "far", "--rotate", "5"],
        ["convert", "ring.su2", "twice.vtu"],
    ]
    for words in commands:
        for is_old in (False, True):
            assert ("in place of an older file" in printed(capsys, words)) == is_old
    for way, status in (("1e-5", 0), ("1", 0), ("25", 1)):
        assert deform(f"{way}.su2", "--translate", way, "0", "--no-dry-run") == status
        said = " ".join(capsys.readouterr().err.split())
        ratio = f"moves by {float(way) / 2:.3g} times the length of what moves"
        assert (ratio in said and "(m or mm)" in said) == (way != "1")


BY_NAME = {
    "elasticity": jm.LinearElasticity(),
    "inverse-distance": jm.InverseDistance(),
    "turning": jm.InverseDistance(rotations=True),
    "multiscale": jm.Multiscale.whole(4.0, 0.1),
}
"""Methods for the ring, whose wall has the radius 1 and the far field 5."""


@pytest.mark.parametrize("name", runs(slow=list(BY_NAME)))
def test_methods_by_name(here, name):
    assert deform("by_name.su2", "--rotate", "20", "--method", name) == 0
    before, after = io.read("ring.su2"), io.read("by_name.su2")
    plan = jm.prepare(before, "wall", "far", method=BY_NAME[name])
    expected = jm.deform(plan, (after.points - before.points)[plan.moving])
    np.testing.assert_allclose(after.points, expected, rtol=0, atol=1e-12)


def test_how_many_nodes_of_the_wall_are_sources_is_told(here, capsys):
    """All of them, none, or those that the plan has chosen; never nodes of the far field."""
    mesh = io.read("ring.su2")
    wall = mesh.patch("wall")
    few = jm.RBF(reduction=jm.KDTree.with_sources(9, np.asarray(mesh.points)[wall]))
    method = jm.SurfaceReconstruction(jm.FittedRBF(few))
    chosen = jm.prepare(mesh, "wall", "far", method=method).sources
    count = int(np.isin(chosen, wall).sum())
    assert 0 < count < min(len(wall), len(chosen))
    words = ["export", "ring.su2", "a.plan", *SURFACE.split()]
    assert f", {count} wall sources\n" in printed(capsys, [*words, "--sources", "9"])
    for name, sources in (("rbf", len(wall)), ("graph", 0)):
        facts = json.loads(printed(capsys, [*words, "--method", name, "--json"]))
        assert facts["sources"] == sources


@pytest.mark.nightly
def test_order_of_the_motions(here):
    motion = (
        "--scale",
        "2",
        "1",
        "--rotate",
        "90",
        "--translate",
        "0.25",
        "0",
        "--displacement",
        "shift.csv",
    )
    assert (
        deform(
            "a.su2", *motion, "--displacement-is", "displacement", "--steps", "3", "--sources", "8"
        )
        == 0
    )
    before = io.read("ring.su2")
    shifted = (before.points[:24] + np.array([0.125, -0.25])) * [2, 1]
    expected = np.column_stack([-shifted[:, 1], shifted[:, 0]]) + np.array([0.25, 0])
    np.testing.assert_allclose(io.read("a.su2").points[:24], expected, atol=1e-14)


def test_new_positions_from_a_file_in_any_order_and_arrays_for_paraview(here):
    assert deform("bump.vtu", "--displacement", "wall.dat", "--method", "rbf") == 0
    before, after = io.read("ring.su2"), io.read("bump.vtu")
    np.testing.assert_allclose(after.points[:24], before.points[:24] * [1, 1.25], atol=1e-12)
    data = after.source.content.data
    at_points, at_cells = data_of(data.GetPointData()), data_of(data.GetCellData())
    np.testing.assert_allclose(
        at_points["displacement"][:, :2], after.points - before.points, atol=1e-15
    )
    expected = jm.quality(before, after.points)
    np.testing.assert_allclose(at_cells["skewness"], expected.skewness, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(at_cells["volume_ratio"], expected.volume_ratio, rtol=1e-12)


@pytest.mark.slow
def test_inverted_cells_end_with_1_and_no_file_unless_allowed(here, capsys):
    motion = ("--translate", "4.5", "0", "--method", "graph")
    assert deform("inverted.su2", *motion) == 1
    assert not (here / "inverted.su2").exists()
    said = capsys.readouterr().err
    told = r"^jaxmorph deform: \d+ of 192 cells are inverted, the worst is cell \d+ near \("
    assert re.search(told, said, re.MULTILINE)
    assert "inverted.su2 is not written; --allow-inverted" in said
    assert deform("inverted.su2", *motion, "--allow-inverted") == 1
    assert main(["quality", "ring.su2", "inverted.su2"]) == 1
    said = capsys.readouterr()
    bad = int(jm.quality(io.read("ring.su2"), io.read("inverted.su2").points).inverted)
    assert bad > 0
    assert f"jaxmorph quality: {bad} of 192 cells are inverted" in said.err
    assert re.search(rf"inverted cells +0 +{bad}\n", said.out)
    (here / "inverted.su2").unlink()


def test_one_inverted_cell_and_a_skewness_of_zero_are_written_as_they_are_said(tmp_path, capsys):
    mesh = bricks(2)
    io.write(tmp_path / "a.su2", mesh)
    said = printed(capsys, ["quality", str(tmp_path / "a.su2")])
    assert re.search(r"max skewness +0 ", said)
    assert re.search(r"inverted cells +0\n", said)
    points = np.array(mesh.points)
    points[0] = 0.9
    io.write(tmp_path / "b.su2", mesh.moved(points))
    assert main(["quality", str(tmp_path / "a.su2"), str(tmp_path / "b.su2")]) == 1
    assert "1 of 8 cells is inverted" in capsys.readouterr().err


SURFACE = "--moving wall --fixed far"
WRONG = {
    "--moving wing --fixed far --rotate 1": "no patch is called 'wing'.*'wall', 'far'",
    "--moving wall --rotate 1": "in patch 'far' .24.: their nodes follow.* Name them by --fixed",
    "--fixed far --rotate 1": "--moving is missing.*this mesh has: wall, far",
    "--moving wall --fixed wall --rotate 1": "wall cannot be both",
    f"{SURFACE} --displacement far.dat": "far.dat: 24 of its 24 node ids are not of the moving patches",
    f"{SURFACE} --displacement ring.su2": "ring.su2, line",
    f"{SURFACE} --translate 1 2 3": "--translate 1 2 3: 3 numbers, and this mesh is in 2-D: give X Y",
    f"{SURFACE} --rotate 1 --axis 0 0 1": "--axis is for meshes in 3-D, and this one is in 2-D",
    f"{SURFACE} --rotate 1 --sources 2": "`count` must be 3 or more in 2-D, not 2",
}
WRONG = {
    f"deform ring.su2 out.su2 {flags}": f"^jaxmorph deform: .*{message}"
    for flags, message in WRONG.items()
}
WRONG |= {
    "info text.su2": "^jaxmorph info: text.su2: no NDIME=",
    "quality wall.dat": "^jaxmorph quality: wall.dat: unknown file ending '.dat'; known are SU2",
    **dict.fromkeys(
        ("dance", "deform ring.su2", "quality a b c", "--dance"), r"^jaxmorph.*--help\)$"
    ),
    "defrom": r"there is no command defrom; did you mean deform\?",
    "deform ring.su2 a.su2 --movng wall": r"there is no flag --movng; did you mean --moving\?",
    "quality ring.su2 --max-skewnes=1": r"there is no flag --max-skewnes; did you mean --max-skewness\?",
    "deform ring.su2 a.su2 --method elastic": "there is no elastic; did you mean elasticity",
    "deform ring.su2 a.su2 --moving wall --fixed --qqq": "flag --qqq; a patch of this name .* =, as in --moving=--qqq",
    "deform ring.su2 a.su2 --center 0 0": r"there is no flag --center \(see jaxmorph deform --help\)$",
    "deform ring.su2 a.su2 --moving wall -fixed far": r"there is no flag -fixed; did you mean --fixed\?",
}


@pytest.mark.parametrize("words", WRONG)
def test_what_cannot_be_is_answered_in_one_line(here, capsys, words):
    refused(capsys, words.split(), WRONG[words])
    assert not (here / "out.su2").exists()


def test_no_input_is_overwritten(here, capsys):
    original, table = (here / "ring.su2").read_bytes(), (here / "wall.dat").read_bytes()
    (here / "wall.su2").write_bytes(table)
    for name, flag in (("ring.su2", "IN"), ("wall.su2", "--displacement")):
        for out, *more in ((name,), ("out.su2", "--save-job", name)):
            words = [
                "deform",
                "ring.su2",
                out,
                *SURFACE.split(),
                "--displacement",
                "wall.su2",
                *more,
            ]
            refused(
                capsys,
                words,
                f"{more[0] if more else 'OUT'} {name} is the file of {flag}. Write to another file.",
            )
    same = ["--save-job", "a.png", "--picture", "a.png"]
    refused(capsys, [*words[:-2], *same], "--picture a.png is the file of --save-job")
    assert (here / "ring.su2").read_bytes() == original
    assert (here / "wall.su2").read_bytes() == table
    assert not (here / "out.su2").exists()


def test_info(here, capsys):
    said = printed(capsys, ["info", "ring.su2"])
    for expected in ("2-D, 216 points", "192 quad", "x        -5 to 5", "wall         24 nodes"):
        assert expected in said
    assert "no cell" not in said
    mesh = io.read("ring.su2")
    io.write("loose.su2", jm.Mesh([*mesh.points, [50.0, 50.0]], mesh.cells, mesh.patches))
    assert "no cell  1 node, at rest: 216" in printed(capsys, ["info", "loose.su2"])


@pytest.mark.nightly
@pytest.mark.parametrize("name", runs(["."], nightly=["../case"]))
def test_a_case_is_called_by_the_name_of_its_folder(tmp_path, monkeypatch, capsys, name):
    foam.write_case(tmp_path / "case", *mixed(), PATCHES)
    monkeypatch.chdir(tmp_path / "case")
    assert printed(capsys, ["info", name]).startswith("case: 3-D, ")
    motion = "--moving floor --fixed rest --translate 0 0 1e-3"
    assert "case: " in printed(capsys, ["deform", name, "../out", *motion.split()])


@pytest.mark.slow
def test_a_process_of_its_own_computes_in_double_precision(here):
    command = [
        sys.executable,
        "-m",
        "jaxmorph",
        "deform",
        "ring.su2",
        "own.su2",
        "--moving",
        "wall",
        "--fixed",
        "far",
    ]
    command += ["--translate", "1e-9", "0", "--method", "graph"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0
    (line,) = done.stderr.splitlines()
    assert "has the motion the unit of the mesh" in line
    moved = io.read("own.su2").points[:24] - io.read("ring.su2").points[:24]
    np.testing.assert_allclose(moved[:, 0], 1e-9, rtol=1e-5)


def test_progress_speaks_on_a_terminal_alone_and_only_of_long_work(capsys, monkeypatch):
    monkeypatch.setattr(_output, "ANNOUNCED_AFTER", 0.01)
    progress = _output.Output("test").progress
    with progress("sleeping"):
        time.sleep(0.1)
    assert capsys.readouterr().err == ""
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    with progress("sleeping"):
        time.sleep(0.1)
    said = capsys.readouterr().err
    assert "jaxmorph test: sleeping ... 0 s" in said
    assert said.endswith("\r\033[K")
    monkeypatch.setattr(_output, "ANNOUNCED_AFTER", 60)
    with progress("being quick"):
        pass
    assert capsys.readouterr().err == ""


def _box(tmp_path):
    """A brick of tetrahedra with its six sides as patches."""
    points = lattice(*[np.linspace(0, 1, 5)] * 3)
    file = tmp_path / "box.su2"
    patches = sides(points)
    io.write(file, jm.Mesh(points, {"tetra": tetrahedra(np.arange(125).reshape(5, 5, 5))}, patches))
    return file, points, patches


@pytest.mark.slow
def test_sliding_and_periodic_patches_on_the_command_line(tmp_path, capsys):
    file, points, sides = _box(tmp_path)
    flags = "--moving z0 --translate 0.01 0.02 0.1 --fixed z1 --sliding x0 x1 --periodic y0 y1 --method rbf"
    job = tmp_path / "job.toml"
    said = printed(
        capsys,
        ["deform", str(file), str(tmp_path / "out.su2"), *flags.split(), "--save-job", str(job)],
    )
    assert "sliding  x0, x1: 50 nodes" in said
    assert "periodic y0, y1: 25 pairs" in said
    moved = io.read(tmp_path / "out.su2").points
    for name, level in (("x0", 0), ("x1", 1)):
        np.testing.assert_allclose(moved[sides[name], 0], level, rtol=0, atol=1e-13)
    first, second = (np.lexsort(points[sides[name]].T[[0, 2]]) for name in ("y0", "y1"))
    along = moved[sides["y1"][second]] - moved[sides["y0"][first]]
    np.testing.assert_allclose(along, np.broadcast_to([0, 1, 0], along.shape), rtol=0, atol=1e-13)
    assert np.abs(moved - points)[sides["y0"]].max() > 0.01
    (tmp_path / "out.su2").unlink()
    assert main(["deform", "--job", str(job)]) == 0
    np.testing.assert_array_equal(io.read(tmp_path / "out.su2").points, moved)
    odd = ["deform", str(file), str(tmp_path / "no.su2"), *flags.split()[:-2], "--periodic", "x0"]
    refused(capsys, odd, "name pairs of patches")


def test_nodes_out_of_the_hull_are_told(tmp_path, capsys):
    file, _, _ = _box(tmp_path)
    arguments = [
        "--moving",
        "z0",
        "--fixed",
        "x0",
        "--free",
        "[xyz]1",
        "y0",
        "--translate",
        "0",
        "0",
        "0.1",
    ]
    words = ["deform", str(file), str(tmp_path / "out.su2"), *arguments, "--method", "graph"]
    refused(capsys, words, "outside of the convex hull")


def test_a_symmetry_patch_that_is_not_plane(tmp_path, capsys):
    file, _, _ = _box(tmp_path)
    text = file.read_text()
    mesh = io.read(file)
    bent = np.array(mesh.points)
    bent[np.flatnonzero((bent[:, 0] == 0) & (bent[:, 1] == 0.5))[2], 0] = 0.01
    io.write(tmp_path / "bent.su2", mesh.moved(bent))
    arguments = [
        "--moving",
        "z0",
        "--fixed",
        "z1",
        "--symmetry",
        "x0",
        "--translate",
        "0",
        "0",
        "0.1",
    ]
    words = ["deform", str(tmp_path / "bent.su2"), str(tmp_path / "out.su2"), *arguments]
    refused(capsys, words, "the patch 'x0': these 25 nodes do not lie in one plane: node")
    assert file.read_text() == text


@pytest.fixture
def ranked(tmp_path):
    """The box with patches of other names: two walls, and the rest."""
    file, _, sides = _box(tmp_path)
    mesh = io.read(file)
    names = {
        "z0": "wall.low",
        "z1": "wall.high",
        "x0": "in",
        "x1": "out",
        "y0": "left",
        "y1": "right",
    }
    named = jm.Mesh(mesh.points, mesh.cells, {names[side]: nodes for side, nodes in sides.items()})
    io.write(tmp_path / "ranked.su2", named)
    return tmp_path / "ranked.su2", named


def test_patches_by_pattern(ranked, capsys):
    """Of a pattern for fixed patches those that move are left out; what is written is what the names give."""
    file, mesh = ranked
    motion = ["--translate", "0", "0", "0.1", "--json", "--method", "graph"]
    for name, flags in (
        ("patterns", ["--moving", r"wall\.l.*", "--fixed", ".*"]),
        ("names", ["--moving", "wall.low", "--fixed", "wall.high", "in", "out", "left", "right"]),
    ):
        assert main(["deform", str(file), str(file.with_name(f"{name}.su2")), *flags, *motion]) == 0
        assert json.loads(capsys.readouterr().out)["moving"] == {"wall.low": 25}
    assert file.with_name("patterns.su2").read_bytes() == file.with_name("names.su2").read_bytes()
    assert mesh.patch_names("wall.*", "in", "wall.low") == ("wall.low", "wall.high", "in")
    np.testing.assert_array_equal(mesh.patch("wall.*"), mesh.patch("wall.low", "wall.high"))


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "wall.hihg",
            r"no patch is called 'wall.hihg' (did you mean 'wall.high'?); this mesh has: '",
        ),
        (
            "wall*",
            r"no patch is called 'wall*' (patterns are regular expressions: 'wall.*'); this mesh has",
        ),
        ("(wing", r"no patch is called '(wing'; this mesh has"),
        ("q+", r"no patch is called 'q+'; this mesh has"),
    ],
)
def test_a_name_that_no_patch_has(ranked, name, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        ranked[1].patch(name)
    many = jm.Mesh(np.eye(3), {}, {f"part{k}": [0] for k in range(30)})
    with pytest.raises(ValueError, match=r"has: 'part0', .*'part11' and 18 more\.$"):
        many.patch("wing")


def test_help_and_version_without_a_command(capsys):
    text = printed(capsys, [])
    assert text.startswith("usage: jaxmorph")
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert ended.value.code == 0
    assert re.fullmatch(
        r"jaxmorph \d\S* \(jax .*, numpy .*, scipy .*, Python .*\)\n", capsys.readouterr().out
    )


MOVE = "--moving wall --fixed far --translate 1 0"
AT_ONCE = {
    f"deform none.su2 out.su2 {MOVE}": "none.su2: No such file",
    f"deform in.su2 in.su2 {MOVE}": "OUT in.su2 is the file of IN",
    f"deform in.su2 out.xyzzy {MOVE}": "unknown file ending '.xyzzy'",
    f"deform in.su2 none/out.su2 {MOVE}": "there is no folder none",
    f"deform in.su2 folder.su2 {MOVE}": "is a folder, which a file cannot replace",
    f"deform nocase out {MOVE}": "nocase: No such file or directory",
    f"deform in.su2 out.su2 {MOVE} --steps 0": "--steps: a whole number of 1 or more expected, found '0'",
    f"deform in.su2 out.su2 {MOVE} --chunk 0": "--chunk: a whole number of 1 or more",
    f"deform in.su2 out.su2 {MOVE} --zone 0": "--zone: a whole number of 1 or more",
    f"deform in.su2 out.su2 {MOVE} --sources 9 --method graph": "graph has no sources to choose",
    f"deform in.su2 out.su2 {MOVE} --picture a.gif": "--picture a.gif: the name should end in .png",
    f"deform in.su2 out.su2 {MOVE} --picture none/a.png": "--picture none/a.png: there is no folder none",
    f"deform in.su2 out.su2 {MOVE} --save-job out.su2": "--save-job out.su2 is the file of OUT",
    f"deform in.su2 out.su2 {MOVE} --save-job no/a.toml": "--save-job no/a.toml: there is no folder no.",
    f"deform in.su2 out.su2 {MOVE} --save-job case": "--save-job case: is a folder, which a file cannot replace",
    f"deform in.su2 out.su2 {MOVE} --decomposed --zone 1": "--zone and --decomposed cannot be combined",
    "deform in.su2 out.su2 --moving wall": "no motion: give one of",
    "deform in.su2 out.su2 --moving wall --rotate nan": "argument --rotate: invalid number value: 'nan'",
    "deform in.su2 out.su2 --moving wall --rotate": "argument --rotate: expected one argument",
    "deform in.su2 out.su2 --moving wall --translate 1 0 --axis 0 0 1": "--axis without --rotate or --bend",
    "deform in.su2 out.su2 --moving wall --displacement none.csv": "none.csv: No such file",
    "deform in.su2 out.su2 --moving wall --mode in.su2 inf": "the amplitude of in.su2 is a number, found 'inf'",
    "deform in.su2 out.su2 --moving wall --mode in.su2 x": "the amplitude of in.su2 is a number",
    "deform in.su2 out.su2 --moving wall --box {": "--box: not a table in JSON",
    "deform in.su2 out.su2 --moving wall --box none.toml": "none.toml: No such file",
    "deform in.su2 out.su2 --job bad.toml": "bad.toml: not TOML",
    "deform in.su2 out.su2 --job none.toml": "none.toml: No such file",
    "modes in.su2 out.xyzzy --moving wall --mode in.su2": "unknown file ending",
    "modes in.su2 out.vtu --moving wall --mode none.csv": "none.csv: No such file",
    "modes in.su2 out.vtu --moving wall --mode in.su2 --amplitude inf": "--amplitude: invalid number value: 'inf'",
    "sensitivity in.su2 none.csv out.csv --moving wall": "none.csv: No such file",
    "sensitivity in.su2 in.su2 out.su2 --moving wall": "should end in .csv or .npz",
    "sensitivity in.su2 bad.toml out.csv --moving wall --set a=1": "--set without --job",
    "su2 def none.cfg": "none.cfg: No such file",
    "su2 def good.cfg --sensitivity bad.toml": "--sensitivity is for su2 dot",
    "su2 dot good.cfg --sensitivity none.csv": "none.csv: No such file",
    "quality none.su2": "none.su2: No such file",
    "quality in.su2 none.su2": "none.su2: No such file",
    "quality in.su2 --min-jacobian-ratio 0.1": "give FILE2",
    "quality in.su2 --max-skewness nan": "--max-skewness: invalid number value: 'nan'",
    "info none.su2": "none.su2: No such file",
    "info in.xyzzy": "unknown file ending",
    "demo nothing": "argument CASE: there is no nothing; there are naca0015",
    "demo -o in.su2": "in.su2: is a file",
}
"""Requests that no mesh can fulfil, and what is told; `in.su2` is no mesh."""

RUN = """
import contextlib, io, json, sys
from jaxmorph.cli import main
told = []
for words in json.load(sys.stdin):
    with contextlib.redirect_stderr(io.StringIO()) as stream:
        try:
            status = main(words.split())
        except SystemExit as end:
            status = end.code
    told.append([status, stream.getvalue(), "jax" in sys.modules])
print(json.dumps(told))
"""


def test_what_no_mesh_can_fulfil_is_told_at_once(tmp_path):
    """Before JAX is imported and the mesh is read, whatever the command."""
    files = {"in.su2": "no mesh", "good.cfg": "", "bad.toml": "[", "case/a": "", "folder.su2/a": ""}
    for name, content in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(content)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    words = json.dumps(list(AT_ONCE))
    options = {"env": environment, "cwd": tmp_path, "capture_output": True, "text": True}
    run = subprocess.run([sys.executable, "-c", RUN], input=words, check=False, **options)
    assert not run.stderr
    for (words, expected), (status, told, has_jax) in zip(
        AT_ONCE.items(), json.loads(run.stdout), strict=True
    ):
        assert status == 2, words
        assert expected in told, words
        assert told.count("\n") == 1, words
        assert not has_jax, words


@pytest.mark.parametrize("words", [["--moving=-[wh].*"], ["--moving=-wall", "--moving=-heat"]])
def test_names_that_begin_with_a_dash(tmp_path, words):
    mesh = ring(names=("-wall", "--far"))
    both = {
        "-wall": mesh.patch("-wall")[:12],
        "-heat": mesh.patch("-wall")[12:],
        "--far": mesh.patch("--far"),
    }
    io.write(tmp_path / "in.su2", jm.Mesh(mesh.points, mesh.cells, both))
    job = ["--save-job", str(tmp_path / "job.toml"), "--method", "graph"]
    paths = [str(tmp_path / name) for name in ("in.su2", "out.su2")]
    words = [word for name in words for word in (name, "--rotate", "-5e0")]
    assert main(["deform", *paths, *words, "--fixed=--far", *job]) == 0
    assert main(["deform", *paths, "--job", job[1]]) == 0
    wall = mesh.patch("-wall")
    angle = np.radians(-5)
    turned = np.asarray(mesh.points)[wall] @ [
        [np.cos(angle), np.sin(angle)],
        [-np.sin(angle), np.cos(angle)],
    ]
    np.testing.assert_allclose(io.read(tmp_path / "out.su2").points[wall], turned, atol=1e-14)
