"""Quality gates of the command line: what they judge, what they say, what they advise."""

import json
import re

import numpy as np
import pytest
from meshes import write_ring

import jaxmorph as jm
from jaxmorph import io
from jaxmorph._host.cells.topology import FACES
from jaxmorph.cli import main


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("gates")
    write_ring(folder / "ring.su2")
    return folder


def deform(out: str, *flags: str) -> int:
    return main(["deform", "ring.su2", out, "--moving", "wall", "--fixed", "far", *flags])


def test_a_gate_fails_names_its_cells_and_holds_the_file_back(here, capsys):
    motion = ("--rotate", "40", "--method", "rbf")
    assert deform("good.su2", *motion) == 0
    mesh, points = io.read("ring.su2"), io.read("good.su2").points
    skewness = np.asarray(jm.quality(mesh, points).skewness)
    ordered = np.sort(skewness)  # each ring of 24 cells has one skewness
    limit = float(ordered[-25:-23].mean())
    gate = ("--max-skewness", repr(limit), "--no-dry-run")
    capsys.readouterr()
    assert deform("bad.su2", *motion, *gate) == 1
    assert not (here / "bad.su2").exists()
    said = capsys.readouterr()
    assert max(map(len, said.out.split("\n"))) <= 80
    row = re.search(r"max skewness +(\S+) +(\S+) +(\S+)   24 of 192\n", said.out)
    assert row
    before = float(np.max(np.asarray(jm.quality(mesh).skewness)))
    np.testing.assert_allclose(
        [float(x) for x in row.groups()], [limit, before, skewness.max()], rtol=1e-4, atol=1e-12
    )
    named = re.findall(r"^  (\d+) +(\S+)   near \((\S+), (\S+)\)$", said.out, re.MULTILINE)
    assert len(named) == 5
    for cell, value, x, y in named:
        assert float(value) == pytest.approx(skewness[int(cell)], rel=1e-4)
        assert skewness[int(cell)] >= np.sort(skewness)[-5]
        np.testing.assert_allclose(
            [float(x), float(y)], points[mesh.cells["quad"][int(cell)]].mean(axis=0), rtol=1e-2
        )
    assert re.search(
        r"24 of 192 cells are beyond --max-skewness \S+, the worst is cell \d+\. No other", said.err
    )
    assert deform("bad.su2", *motion, *gate, "--allow-inverted") == 1
    np.testing.assert_array_equal(io.read("bad.su2").points, points)
    assert main(["quality", "ring.su2", "bad.su2", *gate[:2]]) == 1
    assert "24 of 192 cells are beyond --max-skewness" in capsys.readouterr().err
    assert main(["quality", "ring.su2", "bad.su2", "--max-skewness", "1"]) == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("motion", "kind"),
    [
        (["--rotate", "100", "--min-jacobian-ratio", "0.05", "--method", "graph"], "--sliding"),
        (["--rotate", "75", "--translate", "0.5", "0", "--method", "graph"], "--method"),
        (["--rotate", "130", "--translate", "1", "0.3"], "--steps"),
    ],
)
def test_the_advice_is_one_that_works(here, capsys, motion, kind):
    (here / "advised.su2").unlink(missing_ok=True)
    assert deform("advised.su2", *motion) == 1
    advice = re.search(r"(?<=\. )([^.]*) works\.", capsys.readouterr().err)
    assert advice
    assert advice[1].startswith(kind)
    assert not (here / "advised.su2").exists()
    flags = ["--fixed", "far"] if kind != "--sliding" else []
    command = ["deform", "ring.su2", "advised.su2", "--moving", "wall", *flags, *motion]
    assert main([*command, *advice[1].removesuffix(" in place of --fixed").split()]) == 0


@pytest.mark.slow
def test_no_advice_where_none_works(here, capsys):
    assert deform("never.su2", "--translate", "3.9", "0") == 1
    said = capsys.readouterr().err
    flags = "--steps 2, --steps 4, --steps 8, --method elasticity, --method torsional"
    assert f"A dry run with each of {flags} does" in said
    assert deform("never.su2", "--translate", "3.9", "0", "--no-dry-run") == 1
    assert "No other flags were tried." in capsys.readouterr().err


@pytest.mark.slow
def test_a_mesh_that_was_bad_before_is_told_and_gets_no_advice(here, capsys):
    assert deform("was.su2", "--translate", "0.1", "0", "--max-aspect-ratio", "1.1") == 1
    said = capsys.readouterr().err
    assert (
        "192 of 192 cells are beyond --max-aspect-ratio 1.1 (192 before the motion), the worst is cell"
        in said
    )
    assert "Try" not in said
    assert "With" not in said


@pytest.mark.nightly
def test_the_preset_is_that_of_checkmesh_and_single_limits_win(here, capsys):
    assert (
        deform(
            "a.su2", "--rotate", "1", "--preset", "checkmesh", "--max-face-skewness", "3", "--json"
        )
        == 0
    )
    gates = {gate["gate"]: gate for gate in json.loads(capsys.readouterr().out)["gates"]}
    limits = {name: gate["limit"] for name, gate in gates.items()}
    assert limits == {
        "max_face_aspect_ratio": 1000,
        "max_non_orthogonality": 70,
        "max_face_skewness": 3,
    }
    assert all(gate["beyond"] == 0 for gate in gates.values())


def test_skewness_of_faces_in_2d():
    """A square and a parallelogram beside it that rises by 0.8: their centres are 1 apart and 0.4 in height.

    At the common edge the line of centres passes 0.2 above its middle, whose reach is 0.5. Of the parallelogram's edge at the
    right the normal from the centre meets it 0.4 below its middle; of its lower edge, see the cosine and sine of its slope.
    """
    points = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [2, 0.8], [2, 1.8]], float)
    mesh = jm.Mesh(points, {"quad": [[0, 1, 2, 3], [1, 4, 5, 2]]})
    length = np.sqrt(1 + 0.8**2)
    lower = 0.5 * 0.8 / length / (0.5 * length)
    np.testing.assert_allclose(
        jm.face_quality(mesh).skewness, [0.2 / 0.5, max(0.4 / 0.5, lower)], rtol=1e-12
    )


CUBE = [[x, y, z] for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
TWINS = {
    "hexahedron": (
        [*CUBE, [2, 0.4, 0.2], [2, 1.4, 0.2], [2, 0.4, 1.2], [2, 1.4, 1.2]],
        [[0, 1, 2, 3, 4, 5, 6, 7], [1, 8, 9, 2, 5, 10, 11, 6]],
    ),
    "tetra": (
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [2, 1.5, 1.1]],
        [[0, 1, 2, 3], [1, 4, 2, 3]],
    ),
    "wedge": (
        [
            [0, 0, 0],
            [1, 0, 0],
            [0, 1, 0],
            [0, 0, 1],
            [1, 0, 1],
            [0, 1, 1],
            [1.9, 1.2, 0],
            [1.9, 1.2, 1],
        ],
        [[0, 1, 2, 3, 4, 5], [1, 6, 2, 4, 7, 5]],
    ),
}
"""Two cells with one face in common, all of their faces triangles or parallelograms: every centre is the mean of corners."""


@pytest.mark.parametrize("kind", TWINS)
def test_skewness_of_faces_in_3d(kind):
    """One face after the other, as OpenFOAM's primitiveMeshTools says it."""
    points, cells = TWINS[kind]
    points = (
        np.asarray(points, float)
        @ (np.eye(3) + 0.3 * np.random.default_rng(0).normal(size=(3, 3))).T
    )
    expected = []
    for cell, other in (cells, cells[::-1]):
        centre, beyond = points[cell].mean(axis=0), points[other].mean(axis=0)
        worst = 0.0
        for corners in FACES[kind]:
            face = points[np.array(cell)[list(corners)]]
            middle = face.mean(axis=0)
            normal = np.cross(face[1] - face[0], face[2] - face[0])
            normal /= np.linalg.norm(normal)
            common = {cell[k] for k in corners} <= set(other)
            across = beyond - centre if common else normal * (normal @ (middle - centre))
            by = middle - centre - across * (normal @ (middle - centre)) / (normal @ across)
            reach = max(abs((face - middle) @ by)) / np.linalg.norm(by)
            worst = max(
                worst,
                np.linalg.norm(by) / max(reach, (0.2 if common else 0.4) * np.linalg.norm(across)),
            )
        expected.append(worst)
    np.testing.assert_allclose(
        jm.face_quality(jm.Mesh(points, {kind: cells})).skewness, expected, rtol=1e-10
    )


@pytest.mark.slow
def test_as_many_steps_as_it_takes(here, capsys):
    """By an angle, and by a file of new positions alone: the surface turns on its way, in as many steps as by hand."""
    motion = ("--rotate", "150", "--about", "0.3", "0")
    assert deform("one.su2", *motion, "--no-dry-run") == 1
    assert deform("turned.su2", *motion, "--steps", "auto", "--save-job", "auto.toml") == 0
    said = capsys.readouterr().out
    count = int(re.search(r"^steps    (\d+) keep the cells$", said, flags=re.MULTILINE)[1])
    assert count > 1
    assert deform("fewer.su2", *motion, "--steps", str(count - 1), "--no-dry-run") == 1
    assert main(["deform", "ring.su2", "again.su2", "--job", "auto.toml"]) == 0
    wall, points = np.arange(24), io.read("turned.su2").points
    np.savetxt("turned.dat", np.column_stack([wall, points[:24]]), fmt="%.17g")
    assert deform("file.su2", "--displacement", "turned.dat", "--steps", "auto", "--json") == 0
    facts = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (facts["steps"], facts["reached"]) == (count, 1)
    for other in ("again.su2", "file.su2"):
        np.testing.assert_allclose(io.read(other).points, points, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_where_steps_do_not_suffice_the_share_and_a_cure_are_told(here, capsys):
    motion = (
        "--rotate",
        "130",
        "--method",
        "graph",
        "--min-jacobian-ratio",
        "0.05",
        "--steps",
        "auto",
    )
    assert deform("far.su2", *motion) == 1
    said = capsys.readouterr()
    told = r"^steps    16 keep the cells for \d\d\.\d% of the motion, and not for all of it$"
    assert re.search(told, said.out, flags=re.MULTILINE)
    assert "--sliding far in place of --fixed --steps 1 works." in said.err


def test_seeking_steps_wants_the_whole_mesh(here, capsys):
    assert deform("chunks.su2", "--rotate", "5", "--steps", "auto", "--chunk", "50") == 2
    assert "--chunk needs a number of --steps" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        deform("word.su2", "--rotate", "5", "--steps", "few")
    assert "--steps: a whole number of 1 or more expected, found 'few'" in capsys.readouterr().err
