"""`jaxmorph deform --picture`."""

import itertools
import tomllib

import foam
import matplotlib

matplotlib.use("Agg")

import numpy as np
import pytest
from meshes import bricks, grid, write_ring
from meshes import ring as ring_mesh
from PIL import Image
from runs import runs

import jaxmorph as jm
from jaxmorph import io, plot
from jaxmorph.cli import main


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A ring in 2-D, and a block of bricks whose floor and roof are patches."""
    monkeypatch.chdir(tmp_path)
    write_ring(tmp_path / "ring.su2")
    block = bricks(2)
    sides = {
        name: np.flatnonzero(block.points[:, 2] == z) for name, z in (("floor", 0), ("roof", 1))
    }
    io.write(tmp_path / "block.su2", jm.Mesh(block.points, block.cells, sides))
    return tmp_path


def ring(*more):
    return main(
        [
            "deform",
            "ring.su2",
            "out.su2",
            "--moving",
            "wall",
            "--fixed",
            "far",
            "--method",
            "graph",
            *more,
        ]
    )


def block(*more):
    motion = [
        "--moving",
        "roof",
        "--fixed",
        "floor",
        "--method",
        "graph",
        "--translate",
        "0",
        "0",
        "0.5",
    ]
    return main(["deform", "block.su2", "out.su2", *motion, *more])


@pytest.mark.nightly
def test_in_2d_before_and_after_side_by_side(here, capsys):
    assert ring("--rotate", "20", "--picture", "ring.png", "--save-job", "job.toml") == 0
    assert "picture  ring.png\n" in capsys.readouterr().out
    picture = np.asarray(Image.open("ring.png").convert("RGB")).astype(int)
    height, width, _ = picture.shape
    halves = picture[: int(0.8 * height), : width // 2], picture[: int(0.8 * height), width // 2 :]
    body = [196, 202, 211]
    hollow = [(half == body).all(axis=2).sum() for half in halves]
    assert min(hollow) > 20_000  # the wall's inside
    assert hollow[0] == pytest.approx(hollow[1], rel=0.02)
    dark = [
        half[(half[..., 0] - half[..., 2]) > 60].sum() for half in halves
    ]  # skewed by the rotation
    assert dark[1] > 10 * dark[0]
    assert tomllib.loads((here / "job.toml").read_text())["picture"] == "ring.png"


@pytest.mark.slow
@pytest.mark.filterwarnings("default:.*boundary faces")
def test_in_3d_both_states_are_drawn(here):
    assert block("--picture", "block.png") == 0
    picture = np.asarray(Image.open("block.png").convert("RGB")).astype(int)
    blue = (picture[..., 2] - picture[..., 0] > 60).sum()
    orange = (picture[..., 0] - picture[..., 2] > 60).sum()
    assert min(blue, orange) > 10_000


@pytest.mark.parametrize("lift", runs([0.0], nightly=[0.1]))
def test_a_mesh_one_cell_wide_is_drawn_in_2d(tmp_path, lift):
    """Unless it moves out of its plane. Its numbers are those of the 2-D mesh that it was made of."""
    flat = ring_mesh()
    flat = flat.moved(flat.points + 0.02 * flat.points**2)  # one cell is the worst
    n, moved = len(flat.points), np.array(flat.points)
    moved[flat.patch("wall")] += [0.1, 0.05]
    slab = np.concatenate([np.insert(flat.points, 1, y, axis=1) for y in (0, 0.2)])
    after = np.concatenate(
        [np.insert(moved, 1, y + lift * (moved[:, 0] > 0), axis=1) for y in (0, 0.2)]
    )
    cells = np.concatenate([flat.cells["quad"] + n, flat.cells["quad"]], axis=1)
    mesh = jm.Mesh(
        slab, {"hexahedron": cells}, {"wall": np.append(flat.patch("wall"), flat.patch("wall") + n)}
    )
    plot.picture(tmp_path / "slab.png", mesh, after, moving=mesh.patch("wall"))
    plot.picture(tmp_path / "flat.png", flat, moved, moving=flat.patch("wall"))
    pictures = [np.asarray(Image.open(tmp_path / f"{name}.png")) for name in ("slab", "flat")]
    assert np.array_equal(*pictures) == (lift == 0)


def channel(columns=30):
    """Triangles in a channel ten times as long as high, of several sizes, whose floor has a bump to move."""
    places = 10 * np.linspace(0, 1, columns + 1) ** 1.2
    x, y = (grid.ravel() for grid in np.meshgrid(places, np.linspace(0, 1, 5)))
    corner = (np.arange(4)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    a, b, c, d = corner, corner + 1, corner + columns + 2, corner + columns + 1
    cells = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    floor = np.flatnonzero(y == 0)
    patches = {"bump": floor[(x[floor] > 4) & (x[floor] < 6)], "roof": np.flatnonzero(y == 1)}
    return jm.Mesh(np.column_stack([x, y]), {"triangle": cells}, patches)


def test_of_internal_flow_the_whole_mesh_is_in_view_and_the_numbers_are_those_of_the_table(
    tmp_path, figures
):
    """The channel fills the width, its two states one above the other; each cell has a mean of its neighbours."""
    mesh = channel()
    moved = np.array(mesh.points)
    moved[mesh.patch("bump"), 1] += 0.1
    verdict = jm.judge(mesh, moved)
    plot.picture(tmp_path / "channel.png", mesh, moved)
    first, second = figures[0].axes[:2]
    assert (first.get_xlim(), first.get_ylim()) == ((0, 10), (0, 1))
    assert first.get_position().x1 - first.get_position().x0 > 0.8
    assert second.get_position().y1 < first.get_position().y0
    for axis, own in ((first, verdict.before), (second, verdict)):
        worst = own.rows["max", "skewness"]
        assert axis.get_title().endswith(f"largest skewness {worst.value:.3g} (×)")
        np.testing.assert_allclose(np.ravel(axis.lines[-1].get_data()), worst.near)
    ids, skewness = mesh.cells["triangle"], np.asarray(verdict.corners.skewness)
    at_nodes = np.array([skewness[(ids == k).any(axis=1)].mean() for k in range(len(mesh.points))])
    np.testing.assert_allclose(second.collections[0].get_array(), at_nodes[ids].mean(axis=1))
    assert figures[0].axes[2].get_xlabel() == "skewness, mean of the cells at each node"


def test_a_picture_has_no_blank_no_minus_zero_and_whole_crosses(tmp_path, figures):
    """Of a rectangle of ideal cells, whose worst cell afterwards is at the frame."""
    mesh = grid(np.linspace(0, 1, 9), np.linspace(0, 0.5, 5))
    moved = np.array(mesh.points)
    moved[np.abs(moved).sum(axis=1) == 0.125, 1] += 0.05
    plot.picture(tmp_path / "plain.png", mesh, moved, moving=np.arange(9))
    figure = figures[0]
    first, second = figure.axes[:2]
    assert first.get_title().endswith("largest skewness 0")
    assert not first.lines
    assert second.get_title().endswith("(×)")
    assert not second.lines[-1].get_clip_on()
    assert figure.get_tightbbox().height > 0.93 * figure.get_figheight()


def test_of_polyhedra_one_layer_thick_the_measure_is_that_of_the_table(tmp_path, figures):
    """A pentagon and a triangle in a case: they are judged by faces, and so they are named and drawn in 2-D."""
    plane = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [1, 1.7, 0], [0, 1, 0], [2.2, 2, 0]])
    cells = []
    for rim in ([0, 1, 2, 3, 4], [2, 5, 3]):
        walls = [[a, b, b + 6, a + 6] for a, b in itertools.pairwise([*rim, rim[0]])]
        cells.append([rim[::-1], [node + 6 for node in rim], *walls])
    mesh = io.read(
        foam.write_case(
            tmp_path / "case",
            np.concatenate([plane, plane + np.array([0, 0, 0.1])]),
            cells,
            foam.PATCHES,
        )
    )
    worst = jm.judge(mesh).rows["max", "face_skewness"]
    plot.picture(tmp_path / "two.png", mesh)
    axis, bar = figures[0].axes
    assert axis.get_title() == f"largest face skewness {worst.value:.3g} (×)"
    assert bar.get_xlabel().startswith("face skewness")
    np.testing.assert_allclose(np.ravel(axis.lines[-1].get_data()), worst.near[:2])
    assert (axis.get_xlim(), axis.get_ylim()) == ((0, 2.2), (0, 2))
    drawn, own = (
        np.asarray(axis.collections[0].get_array()),
        np.asarray(jm.face_quality(mesh).skewness),
    )
    assert own.min() <= drawn.min() < drawn.max() <= own.max() == worst.value


@pytest.mark.nightly
def test_a_bad_mesh_is_drawn_though_not_written(here, capsys):
    assert ring("--scale", "7", "7", "--picture", "bad.png", "--no-dry-run") == 1
    assert (here / "bad.png").exists()
    assert not (here / "out.su2").exists()
