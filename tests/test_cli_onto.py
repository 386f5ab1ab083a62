"""Onto a scan by the command line: each fault of a scan is cured by the flag that the message names."""

import json
import re

import numpy as np
import pytest
from meshes import ball, circle, ring, write_ring
from runs import all_refused, refused, runs

import jaxmorph as jm
from jaxmorph import cases, io, shapes
from jaxmorph.cli import main
from jaxmorph.cli._entry import request_of

RING = ["deform", "ring.su2", "out.su2", "--moving", "wall", "--fixed", "far", "--method", "graph"]
ONTO = [*RING, "--onto", "scan.npz"]


def polygon(count: int) -> np.ndarray:
    return np.stack([np.arange(count), np.roll(np.arange(count), -1)], axis=1)


def save_scan(file, points) -> None:
    np.savez(file, points=points, lines=polygon(len(points)))


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_ring(tmp_path / "ring.su2")
    save_scan("scan.npz", 1.1 * circle(60) + np.array([0.02, 0]))
    return tmp_path


@pytest.mark.parametrize("unit", runs([10, 1000], nightly=[25.4, 1 / 0.0254, 304.8, 1e-3]))
def test_a_target_in_another_unit_is_told_with_the_factor(unit):
    """In line with the wall, elsewhere, and a part of a body alone."""
    (points, faces), own = ball(200), jm.Facets(*ball(60))
    half = faces[points[faces].mean(axis=1)[:, 2] > -0.3]
    for target in (
        jm.Facets(unit * 1.04 * points, faces),
        jm.Facets(unit * (points + 3.0), faces),
        jm.Facets(unit * points, half),
    ):
        with pytest.raises(ValueError, match="seems to be in another unit") as caught:
            shapes.Onto(own, target)
        factor = float(re.search(r"Multiply its points by (\S+)\.$", str(caught.value))[1])
        assert factor * unit == pytest.approx(1, rel=1e-9)


def test_a_wall_on_a_far_larger_target_is_in_its_unit():
    wall = np.column_stack([np.linspace(0, 1, 6), np.zeros(6)])
    ids = np.column_stack([np.arange(5), np.arange(1, 6)])
    target = jm.Facets(np.array([[-5.0, 0.01], [5.0, 0.01]]), [[0, 1]])
    u = shapes.onto(jm.Facets(wall, ids), target)
    np.testing.assert_allclose(u, np.broadcast_to([0, 0.01], u.shape), atol=1e-9)


def test_nodes_beyond_the_border_of_a_scan_follow_the_rest():
    """They are not drawn to its end, along the scan or in a plane that it does not reach."""
    x = np.column_stack([np.linspace(0, 1, 21), np.zeros(21)])
    wall = jm.Facets(x, np.column_stack([np.arange(20), np.arange(1, 21)]))
    scan = jm.Facets(np.array([[-1.0, 0.03], [0.7, 0.03]]), [[0, 1]])
    short = jm.Facets(np.array([[0.0, 0.03], [0.7, 0.03]]), [[0, 1]])
    end = jm.Plane([1.0, 0.0], [1.0, 0.0])
    for planes in ((), end):
        u = shapes.onto(wall, scan, length=0.1, symmetry=planes)
        np.testing.assert_allclose(u[:, 1], 0.03, atol=2e-3)
        assert np.abs(u[:, 0]).max() < 0.01
    all_refused(
        (
            lambda: shapes.onto(wall, scan, symmetry=end),
            r"ends 0\.3 before the symmetry plane .* near it by `length=0\.085`",
        ),
        (lambda: shapes.onto(wall, short), r"fold over .* near it by `length=0\.05`"),
    )


@pytest.mark.slow
def test_pairs_are_of_the_whole_target_and_of_its_places():
    """A plane cuts the target and numbers it anew; a soup has each point twice."""
    half = circle(24)[:13] * [1, 1]
    half[[0, -1], 1] = 0
    wall = jm.Facets(half, np.column_stack([np.arange(12), np.arange(1, 13)]))
    angles = np.linspace(-0.5, np.pi + 0.5, 40)
    arc = 1.2 * np.column_stack([np.cos(angles), np.sin(angles)])
    plane = jm.Plane([0.0, 1.0], [0.0, 0.0])
    segments = np.column_stack([np.arange(39), np.arange(1, 40)])
    soup = jm.Facets(arc[segments].reshape(-1, 2), np.arange(78).reshape(-1, 2))
    for target, point in ((jm.Facets(arc, segments), 18), (soup, 35)):
        u = shapes.onto(wall, target, symmetry=plane, features=[([6], [point])])
        np.testing.assert_allclose(half[6] + u[6], np.asarray(target.points)[point], atol=1e-12)
        assert float(target.distance(half + u).max()) < 1e-12


def test_messages_are_in_the_words_of_the_caller(here, capsys):
    save_scan("mm.npz", 1000 * circle(60))
    refused(
        capsys,
        [*RING, "--onto", "mm.npz"],
        r"--onto: the target is 2000 long, the wall 2: .* Give --onto-scale 0\.001\.\n",
    )
    refused(capsys, [*ONTO, "--onto-length", "-1"], "--onto-length must be a real number of 0")
    refused(capsys, [*ONTO, "--onto-scale", "0"], "--onto-scale 0: a factor above 0")
    refused(capsys, [*RING, "--rotate", "2", "--onto-scale", "2"], "--onto-scale without --onto")
    refused(capsys, [*ONTO, "--onto-features", "[[1, 2]]"], "pairs of lists of ids.* expected")
    refused(capsys, [*ONTO, "--onto-features", "[[[30], [2]]]"], "nodes 30 are not among those")
    refused(
        capsys,
        [*ONTO, "--onto-features", "[[[3], [99]]]"],
        r"1 ids in --onto-features are not in 0 to 59",
    )
    quarter = circle(60)[:16]
    np.savez("cut.npz", points=quarter, lines=polygon(16)[:-1])
    refused(capsys, [*RING, "--onto", "cut.npz"], r"stay near it by --onto-length 0\.1\.\n")
    words = [*RING, "--translate", "1", "0", "0"]
    refused(capsys, words, "--translate 1 0 0: 3 numbers, and this mesh is in 2-D: give X Y")
    refused(capsys, [*RING, "--rotate", "1", "--axis", "0", "1"], "--axis is for meshes in 3-D")
    words = [*RING[:-2], "--method", "elastic", "--rotate", "1"]
    refused(capsys, words, "there is no elastic; did you mean elasticity")


@pytest.mark.slow
def test_a_job_has_two_walls_each_with_its_target_and_its_pairs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    boxes = {"main": [-4.0, -2.0, -1.0, 1.0], "flap": [1.0, 2.0, -1.0, 1.0]}
    mesh = cases.bodies(boxes, spacing=0.5)
    io.write("bodies.su2", mesh)
    targets = {}
    for name, unit in (("main", 1.0), ("flap", 1e3)):
        facets = jm.Facets.of(mesh, name)
        targets[name] = 1.1 * np.asarray(facets.points)
        np.savez(f"{name}.npz", points=unit * targets[name], lines=np.asarray(facets.faces))
    node = int(mesh.patch("main")[3])
    (tmp_path / "job.toml").write_text(
        'file = "bodies.su2"\noutput = "out.su2"\nfixed = ["farfield"]\nmethod = "graph"\n'
        f'[[moving]]\npatches = ["main"]\nonto = "main.npz"\nonto_features = [[[{node}], [3]]]\n'
        '[[moving]]\npatches = ["flap"]\nonto = "flap.npz"\nonto_scale = 0.001\n'
    )
    words = ["deform", "--job", "job.toml", "--json", "--picture", "out.png"]
    assert main([*words, "--save-job", "saved.toml"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert {*said["distance"]} == {"main.npz", "flap.npz"}
    assert max(row["after"] for row in said["distance"].values()) < 1e-12
    assert {*tmp_path.glob("out_distance_*.png")} == {
        tmp_path / f"out_distance_{name}.png" for name in boxes
    }
    moved = io.read("out.su2")
    np.testing.assert_allclose(moved.points[node], targets["main"][3], atol=1e-12)
    group = request_of(["deform", "--job", "saved.toml"]).groups[0]
    assert group.onto_features == (((node,), (3,)),)


@pytest.mark.nightly
def test_one_file_for_two_walls_is_told_for_each(here, capsys):
    mesh = ring()
    left = mesh.points[mesh.patch("wall"), 0] < -1e-9
    wall = mesh.patch("wall")
    sides = {"left": wall[left], "right": wall[~left], "far": mesh.patch("far")}
    io.write("two.su2", jm.Mesh(mesh.points, mesh.cells, sides))
    words = ["deform", "two.su2", "out.su2", "--fixed", "far", "--method", "graph", "--json"]
    for name in ("left", "right"):
        words += ["--moving", name, "--onto", "scan.npz", "--onto-length", "0.3"]
    assert main(words) in (0, 1)
    said = json.loads(capsys.readouterr().out)
    assert {*said["distance"]} == {"scan.npz (left)", "scan.npz (right)"}


def write_stl(file, points, faces) -> None:
    facets = np.zeros(len(faces), np.dtype([("n", "<f4", 3), ("x", "<f4", (3, 3)), ("a", "<u2")]))
    facets["x"] = points[faces]
    file.write_bytes(bytes(80) + len(faces).to_bytes(4, "little") + facets.tobytes())


def scans(folder) -> list[str]:
    """A wing's surface, thicker by 8 %, twisted by 2 degrees: as it is, in mm and inches, with .2 % of noise, cut off."""
    fine = jm.Facets.of(cases.wing(points=1500, stations=11), "wing")
    x, faces = np.array(fine.points) * [1, 1, 1.08], np.asarray(fine.faces)
    turn = np.radians(2)
    x[:, [0, 2]] = np.stack(
        [
            0.25 + np.cos(turn) * (x[:, 0] - 0.25) + np.sin(turn) * x[:, 2],
            np.cos(turn) * x[:, 2] - np.sin(turn) * (x[:, 0] - 0.25),
        ],
        axis=1,
    )
    noise = 0.002 * np.random.default_rng(0).standard_normal(x.shape)
    made = {"m": x, "mm": 1000 * x, "inch": x / 0.0254, "noisy": x + noise}
    for name, points in made.items():
        write_stl(folder / f"{name}.stl", points, faces)
    write_stl(folder / "cut.stl", x, faces[x[faces].mean(axis=1)[:, 1] < 1.6])
    return [*made, "cut"]


@pytest.mark.slow
def test_five_scans_work_or_their_message_names_the_flag_that_cures(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    io.write("wing.su2", cases.wing(points=600, stations=7))
    words = ["deform", "wing.su2", "out.su2", "--moving", "wing", "--fixed", "farfield"]
    words += ["--symmetry", "root", "tip", "--json"]
    cured = {}
    for name in scans(tmp_path):
        now = [*words, "--onto", f"{name}.stl"]
        for _ in range(3):
            capsys.readouterr()
            status = main(now)
            said = capsys.readouterr()
            if status != 2:
                break
            now += re.search(r"(--onto-\w+) ([\d.]+\d)", said.err).groups()
        assert status == 0, said.err
        told = json.loads(said.out)["distance"][f"{name}.stl"]
        off = told["after"]
        assert told["median_after"] <= min(off, 0.2 * told["median_before"])
        cured[name] = (now[len(words) + 2 :], off)
    assert [flags[:1] for flags, _ in cured.values()] == [
        [],
        ["--onto-scale"],
        ["--onto-scale"],
        ["--onto-length"],
        ["--onto-length"],
    ]
    assert max(cured[name][1] for name in ("m", "mm", "inch")) < 1e-7  # an STL is in single
    assert cured["noisy"][1] < 0.02
    assert cured["cut"][1] == pytest.approx(0.4, abs=0.02)  # of the tip, which the scan lacks
