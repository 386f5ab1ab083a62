"""`jaxmorph deform --picture`."""

import tomllib

import matplotlib

matplotlib.use("Agg")

import numpy as np
import pytest
from meshes import bricks, write_ring
from meshes import ring as ring_mesh
from PIL import Image
from runs import refused, runs

import jaxmorph as jm
from jaxmorph import io, plot
from jaxmorph.cli import main


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A ring in 2-D, and a block of bricks whose floor and roof are patches."""
    monkeypatch.chdir(tmp_path)
    write_ring(tmp_path / "ring.su2")
    block = bricks(2)
    sides = {name: np.flatnonzero(block.points[:, 2] == z) for name, z in (("floor", 0), ("roof", 1))}
    io.write(tmp_path / "block.su2", jm.Mesh(block.points, block.cells, sides))
    return tmp_path


def ring(*more):
    return main(["deform", "ring.su2", "out.su2", "--moving", "wall", "--fixed", "far", "--method", "graph", *more])


def block(*more):
    motion = ["--moving", "roof", "--fixed", "floor", "--method", "graph", "--translate", "0", "0", "0.5"]
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
    dark = [half[(half[..., 0] - half[..., 2]) > 60].sum() for half in halves]  # skewed by the rotation
    assert dark[1] > 10 * dark[0]
    assert tomllib.loads((here / "job.toml").read_text())["picture"] == "ring.png"


@pytest.mark.slow
@pytest.mark.filterwarnings("default:.*boundary faces")
def test_in_3d_a_page_or_a_picture(here):
    assert block("--picture", "block.html") == 0
    assert b"deformation" in (here / "block.html").read_bytes()
    assert block("--picture", "block.png") == 0
    picture = np.asarray(Image.open("block.png").convert("RGB")).astype(int)
    blue = (picture[..., 2] - picture[..., 0] > 60).sum()
    orange = (picture[..., 0] - picture[..., 2] > 60).sum()
    assert min(blue, orange) > 10_000


@pytest.mark.parametrize("lift", runs([0.0], nightly=[0.1]))
def test_a_mesh_one_cell_wide_is_drawn_in_2d(tmp_path, lift):
    """Unless it moves out of its plane. Its numbers are those of the 2-D mesh that it was made of."""
    flat = ring_mesh()
    n, moved = len(flat.points), np.array(flat.points)
    moved[flat.patch("wall")] += [0.1, 0.05]
    slab = np.concatenate([np.insert(flat.points, 1, y, axis=1) for y in (0, 0.2)])
    after = np.concatenate([np.insert(moved, 1, y + lift * (moved[:, 0] > 0), axis=1) for y in (0, 0.2)])
    cells = np.concatenate([flat.cells["quad"] + n, flat.cells["quad"]], axis=1)
    mesh = jm.Mesh(slab, {"hexahedron": cells}, {"wall": np.append(flat.patch("wall"), flat.patch("wall") + n)})
    plot.picture(tmp_path / "slab.png", mesh, after, moving=mesh.patch("wall"))
    plot.picture(tmp_path / "flat.png", flat, moved, moving=flat.patch("wall"))
    pictures = [np.asarray(Image.open(tmp_path / f"{name}.png")) for name in ("slab", "flat")]
    assert np.array_equal(*pictures) == (lift == 0)


@pytest.mark.nightly
def test_a_bad_mesh_is_drawn_though_not_written(here, capsys):
    assert ring("--scale", "7", "7", "--picture", "bad.png", "--no-dry-run") == 1
    assert (here / "bad.png").exists()
    assert not (here / "out.su2").exists()


def test_a_page_of_a_mesh_in_2d_is_refused_before_the_work(here, capsys):
    words = ["deform", "ring.su2", "out.su2", "--moving", "wall", "--fixed", "far", "--picture", "ring.html"]
    refused(capsys, [*words, "--rotate", "20"], r"ring.html: a picture of this mesh ends in \.png\.$")
    assert not (here / "out.su2").exists()
