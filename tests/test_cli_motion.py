"""Motions of the command line against closed forms."""

import json

import numpy as np
import pytest
from meshes import lattice, ring, tetrahedra
from runs import over, refused
from scipy.integrate import trapezoid
from scipy.spatial.transform import Rotation

import jaxmorph as jm
from jaxmorph import io
from jaxmorph.cli import main
from jaxmorph.cli._entry import request_of
from jaxmorph.cli._motion import motion


@pytest.fixture(scope="module")
def brick(tmp_path_factory):
    """Tetrahedra between -2 and 2 with the two patches `low` (x = -2) and `high` (x = 2); all other sides are `rest`."""
    axis = np.linspace(-2, 2, 6)
    points = lattice(axis, axis, axis)
    side = np.abs(points).max(axis=1) == 2
    low, high = np.flatnonzero(points[:, 0] == -2), np.flatnonzero(points[:, 0] == 2)
    rest = np.setdiff1d(np.flatnonzero(side), np.concatenate([low, high]))
    file = tmp_path_factory.mktemp("motion") / "brick.su2"
    cells = {"tetra": tetrahedra(np.arange(216).reshape(6, 6, 6))}
    io.write(file, jm.Mesh(points, cells, {"low": low, "high": high, "rest": rest}))
    return file


def moved(brick, *flags) -> tuple[np.ndarray, np.ndarray, jm.Mesh]:
    """Old and new points, and the mesh; nothing said of the quality."""
    out = brick.with_name("out.su2")
    fixed = ["rest"] if "low" in flags else ["rest", "low"]
    words = [
        "deform",
        str(brick),
        str(out),
        "--fixed",
        *fixed,
        *flags,
        "--allow-inverted",
        "--no-dry-run",
    ]
    assert main([*words, "--method", "graph"]) in (0, 1)
    mesh = io.read(brick)
    return np.asarray(mesh.points), np.asarray(io.read(out).points), mesh


def test_each_patch_has_its_own_motion(brick):
    turn = ("--rotate", "20", "--about", "0", "0.5", "0", "--axis", "1", "0", "0")
    x, y, mesh = moved(
        brick, "--moving", "high", *turn, "--moving", "low", "--translate", "-0.2", "0", "0.1"
    )
    high, low = mesh.patch("high"), mesh.patch("low")
    centre = np.array([0, 0.5, 0])
    expected = centre + Rotation.from_euler("x", 20, degrees=True).apply(x[high] - centre)
    np.testing.assert_allclose(y[high], expected, atol=1e-14)
    np.testing.assert_allclose(y[low], x[low] + [-0.2, 0, 0.1], atol=1e-14)
    np.testing.assert_array_equal(y[mesh.patch("rest")], x[mesh.patch("rest")])


def petals() -> jm.Mesh:
    """A ring whose wall is three patches: neighbours share nodes, and one node is in all of them."""
    mesh = ring(24, [1, 2, 5])
    wall = mesh.patch("wall")
    patches = {"one": wall[:10], "two": wall[8:17], "three": np.append(wall[16:], wall[[0, 8]])}
    patches |= {"far": mesh.patch("far")}
    return jm.Mesh(mesh.points, mesh.cells, patches)


def path_of(mesh, words) -> np.ndarray:
    """Displacements of the moving nodes, by node."""
    request = request_of(["deform", "in.su2", "out.su2", "--fixed", "far", *words])
    nodes = mesh.patch(*request.moving)
    u = np.zeros(mesh.points.shape)
    u[nodes] = motion(request, mesh, nodes).path(np.asarray(mesh.points)[nodes], 1)[-1]
    return u


MOTIONS = {
    "rotate": "--rotate 5 --about 2 1",
    "translate": "--translate 0 0.05",
    "scale": "--scale 1.5 0.5 --about 1 1",
    "bend": "--bend 20 --along 1 0 --about -1 0 --length 3",
    "displacement": "--displacement FILE --displacement-is displacement",
    "mode": "--mode FILE 2.5",
    "box": '--box {"low":[-2,-2],"high":[2,2],"points":[2,2],"moved":[{"at":[1,1],"by":[0.1,0.2]}]}',
    "several": "--mode FILE 0.5 --scale 1.1 --rotate 30",
}


@over("name", ["several"], nightly=[name for name in MOTIONS if name != "several"])
def test_a_node_of_several_patches_moves_once(tmp_path, monkeypatch, name):
    """Patches that move alike, by one --moving or by one each, in whichever order: one motion."""
    monkeypatch.chdir(tmp_path)
    mesh = petals()

    def group(*patches):
        u = np.sin(np.arange(2 * len(mesh.points))).reshape(-1, 2)
        rows = [
            f"{node},{x},{y}"
            for node, (x, y) in zip(mesh.patch(*patches), u[mesh.patch(*patches)], strict=True)
        ]
        (tmp_path / f"{patches[0]}.csv").write_text("\n".join(["id,x,y", *rows]))
        return ["--moving", *patches, *MOTIONS[name].replace("FILE", f"{patches[0]}.csv").split()]

    together = path_of(mesh, group(".n.", "t.*"))
    assert np.abs(together).max() > 0.01
    for order in (("one", "two", "three"), ("three", "one", "two"), ("t.*", "o.*")):
        apart = path_of(mesh, [word for patch in order for word in group(patch)])
        np.testing.assert_allclose(apart, together, rtol=1e-13, atol=1e-15)
    again = path_of(mesh, [*group(".n.", "t.*"), "--moving", "t.*", "one", "--translate", "1", "2"])
    moving = np.isin(np.arange(len(mesh.points)), mesh.patch("one", "two", "three"))
    np.testing.assert_allclose(again, together + np.outer(moving, [1, 2]), atol=1e-14)


def test_patches_that_move_a_common_node_differently_are_told():
    mesh = petals()
    up, down = ("--translate", "0", "0.05"), ("--translate", "0", "-0.05")
    with pytest.raises(
        ValueError, match=r"one and two move 2 common nodes differently, by up to 0.1: nodes 8, 9,"
    ):
        path_of(mesh, ["--moving", "one", *up, "--moving", "two", *down])
    with pytest.raises(
        ValueError, match=r"one\+three and one\+three then three move \d+ common nodes differently"
    ):
        path_of(mesh, ["--moving", "one", "three", *up, "--moving", "three", "--rotate", "5"])


@pytest.mark.nightly
def test_twist_grows_along_the_line_and_stops_at_its_ends(brick):
    line = ("--along", "0", "2", "0", "--about", "1", "-1", "0", "--length", "2")
    x, y, mesh = moved(brick, "--moving", "high", "--twist", "30", *line)
    centre = np.array([1, -1, 0])
    for node in mesh.patch("high"):
        share = np.clip((x[node, 1] + 1) / 2, 0, 1)
        expected = centre + Rotation.from_euler("y", 30 * share, degrees=True).apply(
            x[node] - centre
        )
        np.testing.assert_allclose(y[node], expected, atol=1e-14)


def test_bend_makes_an_arc_of_the_same_length(brick):
    """By integrating the tangent along the line: numbers that the closed form of the library does not use."""
    line = (
        "--axis",
        "1",
        "0",
        "0",
        "--along",
        "0",
        "1",
        "0",
        "--about",
        "0",
        "-1",
        "0",
        "--length",
        "2",
    )
    x, y, mesh = moved(brick, "--moving", "high", "--bend", "60", *line)
    for node in mesh.patch("high"):
        s = x[node, 1] + 1
        t = np.linspace(0, np.clip(s, 0, 2), 20001)
        angle = np.radians(60) * t / 2
        tangent = np.column_stack([np.cos(angle), np.sin(angle)])
        middle = trapezoid(tangent, t, axis=0) + (s - t[-1]) * tangent[-1]
        normal = np.array([-tangent[-1, 1], tangent[-1, 0]])
        expected = np.append(x[node, 0], [-1, 0] + middle + x[node, 2] * normal)
        np.testing.assert_allclose(y[node], expected, atol=1e-8)


@pytest.mark.nightly
def test_modes_and_displacements_add(brick):
    mesh = io.read(brick)
    high, rng = mesh.patch("high"), np.random.default_rng(0)
    shapes = 0.1 * rng.normal(size=(3, len(high), 3))
    np.savez(brick.with_name("a.npz"), ids=high[::-1], displacement=shapes[0, ::-1])
    for name, shape in (("b.csv", shapes[1]), ("c.csv", shapes[2])):
        rows = [
            f"{node},{','.join(map(repr, row))}"
            for node, row in zip(high.tolist(), shape.tolist(), strict=True)
        ]
        brick.with_name(name).write_text("id,dx,dy,dz\n" + "\n".join(rows))
    a, b, c = (str(brick.with_name(name)) for name in ("a.npz", "b.csv", "c.csv"))
    flags = (
        "--mode",
        a,
        "0.5",
        "--mode",
        b,
        "-2e0",
        "--displacement",
        c,
        "--displacement-is",
        "displacement",
    )
    x, y, _ = moved(brick, "--moving", "high", *flags, "--steps", "2")
    np.testing.assert_allclose(
        y[high], x[high] + 0.5 * shapes[0] - 2 * shapes[1] + shapes[2], atol=1e-14
    )


def test_a_box_moves_what_is_inside_by_bernstein_polynomials(brick):
    box = {"low": [1, -1.5, -3], "high": [3, 2.5, 3], "points": [2, 4, 3]}
    control = np.zeros((2, 4, 3, 3))
    control[1, 2, 1], control[0, 1, 2] = [0.1, 0.2, -0.3], [0.3, 0, 0.1]
    box["moved"] = [
        {"at": [1, 2, 1], "by": [0.1, 0.2, -0.3]},
        {"at": [0, 1, 2], "by": [0.3, 0, 0.1]},
    ]
    x, y, mesh = moved(brick, "--moving", "high", "--box", json.dumps(box))
    high = mesh.patch("high")
    t = (x[high] - [1, -1.5, -3]) / [2, 4, 6]
    inside = ((t >= 0) & (t <= 1)).all(axis=1)
    assert 0 < inside.sum() < len(high)
    # de Casteljau: interpolating linearly between control points, again and again, with no polynomial in sight
    for node, where, is_inside in zip(high, t, inside, strict=True):
        values = control
        for share in where:
            while len(values) > 1:
                values = (1 - share) * values[:-1] + share * values[1:]
            values = values[0]
        np.testing.assert_allclose(y[node] - x[node], values if is_inside else 0, atol=1e-14)
    brick.with_name("box.toml").write_text(
        "low = [1, -1.5, -3]\nhigh = [3, 2.5, 3]\npoints = [2, 4, 3]\n[[moved]]\nat = [1, 2, 1]\n"
        "by = [0.1, 0.2, -0.3]\n[[moved]]\nat = [0, 1, 2]\nby = [0.3, 0, 0.1]\n"
    )
    np.testing.assert_array_equal(
        moved(brick, "--moving", "high", "--box", str(brick.with_name("box.toml")))[1], y
    )


BOX = '--box {{"low":[0,0,0],"high":[1,1,{}],"points":[2,2,2],"moved":[{}]}}'
WRONG = {
    "--translate 1 0": "--translate 1 0: 2 numbers, and this mesh is in 3-D: give X Y Z",
    "--rotate 1 --axis 0 0 0": "--rotate: `axis` has length 0; it must be a direction",
    "--rotate 1": "--rotate: `axis` is missing: a rotation in 3-D needs",
    "--bend 5 --along 0 1 0": "--bend: `axis` is missing",
    "--translate 1 0 0 --translate 1 0 0": "--translate twice for one --moving",
    "--twist 5": "--twist: the direction --along X Y Z is missing",
    "--bend 5 --axis 1 0 0 --along 1 1 0": "--bend: `axis` and `along` must be at right angles",
    "--twist 5 --along 1 0 0 --about 3 0 0": "--twist: `length` is -1.0; it must be above 0",
    '--box {"low":[0,0,0]}': "--box: low and high or corners, points and a list moved expected, found low",
    BOX.format(0, ""): "--box: low must be below high",
    BOX.format(
        1, '{"at":[2,0,0],"by":[0,0,1]}'
    ): r"--box: at = \[2, 0, 0\]: whole numbers from 0 to \[1, 1, 1\]",
}


@pytest.mark.parametrize("flags", WRONG)
def test_motions_that_make_no_sense(brick, capsys, flags):
    out = brick.with_name("wrong.su2")
    words = [
        "deform",
        str(brick),
        str(out),
        "--moving",
        "high",
        *flags.split(),
        "--fixed",
        "rest",
        "low",
    ]
    refused(capsys, words, WRONG[flags])
    assert not out.exists()
