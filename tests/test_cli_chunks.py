"""`jaxmorph deform --chunk`: the same mesh as without, some nodes at a time."""

import pickle
import re

import numpy as np
import pytest
from laws import check_parts
from meshes import lattice, sides, write_ring

import jaxmorph as jm
from jaxmorph import io
from jaxmorph.cli import main

MOVE = ["--moving", "wall", "--fixed", "far", "--translate", "0.2", "0", "--rotate", "30"]


@pytest.fixture
def sizes(monkeypatch):
    """How many points each chunk has that is prepared by the command line."""
    made, called = jm.prepare_in_chunks, []

    def counted(*arguments, **settings):
        for nodes, plan in made(*arguments, **settings):
            called.append(len(plan.points))
            yield nodes, plan

    monkeypatch.setattr(jm, "prepare_in_chunks", counted)
    return called


def run(file, out, *flags):
    assert main(["deform", file, out, *flags]) == 0
    return np.asarray(io.read(out).points)


@pytest.mark.nightly
@pytest.mark.parametrize(
    "flags", [["--steps", "2"], ["--method", "rbf", "--dtype", "float32"]], ids=" ".join
)
def test_chunks_give_the_mesh_of_the_whole(here, sizes, flags):
    mesh = write_ring(here / "ring.su2")
    whole = run("ring.su2", "whole.su2", *MOVE, *flags)
    parts = run("ring.su2", "parts.su2", *MOVE, *flags, "--chunk", "100")
    assert sizes == [216, 132, 132]  # 48 nodes of the surface, and halves of 168
    np.testing.assert_allclose(parts, whole, rtol=0, atol=2e-6 if "float32" in flags else 1e-14)
    np.testing.assert_array_equal(parts[mesh.patch("wall")], whole[mesh.patch("wall")])
    np.testing.assert_array_equal(parts[mesh.patch("far")], mesh.points[mesh.patch("far")])


def brick():
    """Points between z = 0 and 1, in any order; x = 0 and y = 0 are planes of symmetry."""
    points = np.random.default_rng(0).permutation(lattice(*[np.linspace(0, 1, 6)] * 3))
    return jm.Mesh(points, {}, sides(points))


@pytest.mark.slow
def test_nodes_slide_in_their_planes_in_every_chunk():
    """Without the judging of cells, which takes ten times longer to compile."""
    mesh, slides = brick(), ["x0", "y0"]
    moving, fixed = mesh.patch("z0"), mesh.patch("z1", "x1", "y1")
    planes = [jm.Plane.through(mesh.points, mesh.patch(side)) for side in slides]
    x, y, _ = mesh.points[moving].T
    u = (np.cos(np.pi * x / 2) * np.cos(np.pi * y / 2))[:, None] * [0.1, 0.2, 0.3]
    boundary = jm.Boundary(mesh.points, moving, fixed, symmetry=planes)
    plan = jm.prepare(boundary)
    check_parts(boundary, plan, u, 50)
    moved = np.asarray(jm.deform(plan, u))
    for axis, side in enumerate(slides):
        inner = np.setdiff1d(mesh.patch(side), mesh.patch("z0", "z1", "x1", "y1"))
        np.testing.assert_array_equal(moved[mesh.patch(side), axis], 0)
        assert np.abs(moved - mesh.points)[inner].max() > 0.003


def test_chunks_cover_the_mesh_and_have_one_length(here):
    mesh = write_ring(here / "ring.su2")
    wall, far = mesh.patch("wall"), mesh.patch("far")
    for size in (10, 50, 167, 168, 1000, None):
        boundary = jm.Boundary(mesh.points, wall, far)
        chunks = [
            nodes
            for nodes, _ in jm.prepare_in_chunks(boundary, size=size, method=jm.InverseDistance())
        ]
        assert len(chunks) == (1 if size is None else -(-168 // size))
        assert len({len(nodes) for nodes in chunks}) == 1
        assert all(np.isin([*wall, *far], nodes).all() for nodes in chunks)
        np.testing.assert_array_equal(np.unique(np.concatenate(chunks)), np.arange(216))
    with pytest.raises(ValueError, match="`size` must be a whole number of at least 1, not 0"):
        jm.prepare_in_chunks(jm.Boundary(mesh.points, wall, far), size=0)


def test_errors_name_nodes_of_the_mesh(here, capsys):
    """A wall alone has no hull that holds the mesh: the worst node of the chunk is named as the mesh numbers it."""
    mesh = write_ring(here / "ring.su2")
    moved = np.array(mesh.points)
    moved[150] = [7, 3]
    io.write("out.su2", mesh.moved(moved))
    assert main(["deform", "out.su2", "b.su2", *MOVE, "--chunk", "40"]) == 2
    assert re.search(r"the worst is node 150 at \(7, 3\)", capsys.readouterr().err)


@pytest.mark.slow
def test_warnings_name_nodes_of_the_mesh(here, capsys):
    """Two neighbours of the wall torn apart, where chunks number the far field's nodes otherwise than the mesh does."""
    mesh = write_ring(here / "ring.su2")
    order = np.random.default_rng(0).permutation(len(mesh.points))  # old id of each new node
    new = np.argsort(order)
    patches = {name: new[ids] for name, ids in mesh.patches.items()}
    cells = {kind: new[corners] for kind, corners in mesh.cells.items()}
    io.write("mixed.su2", jm.Mesh(np.asarray(mesh.points)[order], cells, patches))
    wall = patches["wall"]
    rows = [f"{node} {0.4 if node == new[3] else 0} 0\n" for node in wall.tolist()]
    (here / "tear.dat").write_text("".join(rows))
    motion = ["--displacement", "tear.dat", "--displacement-is", "displacement", "--no-dry-run"]
    for chunk in ([], ["--chunk", "50"]):
        main(
            ["deform", "mixed.su2", "b.su2", "--moving", "wall", "--fixed", "far", *motion, *chunk]
        )
        pair = re.search(r"the worst nodes (\d+) and (\d+) (?:of|near)", capsys.readouterr().err)
        assert pair
        assert {new[3]} < {int(node) for node in pair.groups()} <= {new[2], new[3], new[4]}


def test_an_error_carries_its_nodes():
    """Node ids and the sentence agree, in the part of the mesh and in all of it, and through pickle."""
    error = jm.MeshError("2 nodes are far away, first node {node}.", [2, 0])
    whole = pickle.loads(pickle.dumps(error.renumbered(np.array([3, 5, 8]))))
    assert isinstance(whole, ValueError)
    assert (str(error), str(whole)) == (
        "2 nodes are far away, first node 2.",
        "2 nodes are far away, first node 8.",
    )
    assert whole.nodes.tolist() == [8, 3]
