"""Parts of a mesh move as the whole does: pieces by the two halves of `prepare`, and points laid over devices."""

import json
import os
import pickle
import subprocess
import sys

import numpy as np
import pytest
from meshes import lattice
from runs import over

import jaxmorph as jm
from jaxmorph import cases, shapes
from jaxmorph._host.surface.graph import graph_of
from jaxmorph._methods import corrections


@pytest.fixture(scope="module")
def mesh():
    return cases.naca0015(points=300)


def wave(x):
    return np.stack([0.02 * np.cos(5 * x[:, 1]), 0.05 * x[:, 0] * (1 - x[:, 0])], axis=1)


def displacement(half, mesh):
    return wave(np.asarray(mesh.points)[half.moving])


def pieces_of(mesh, count=3):
    """Shares of the nodes in no order, without those of the wall in the last one; neighbours share a node."""
    every = np.random.default_rng(1).permutation(len(mesh.points))
    shares = [np.array(share) for share in np.array_split(every, count)]
    wall = mesh.patch("airfoil")
    shares[0] = np.union1d(shares[0], wall)
    shares[-1] = np.append(np.setdiff1d(shares[-1], wall), shares[1][:5])
    return shares


def brick():
    """A unit square of 6 by 6 nodes: its lower side moves, the upper one is fixed, the left one lies in a symmetry plane."""
    points = lattice(*[np.linspace(0, 1, 6)] * 2)[:, ::-1]
    return points, np.arange(6), np.arange(30, 36)


def airfoil(method, mesh):
    base = np.asarray(mesh.points)[mesh.patch("airfoil")]
    return mesh, ("airfoil", "farfield"), {"method": method}, pieces_of(mesh), wave(base)


def square(mesh, **boundary):
    points, moving, fixed = brick()
    u = 0.1 * np.stack([0 * points[moving, 0], np.sin(2 * points[moving, 0])], axis=1)
    return points, (moving, fixed), boundary, (np.arange(3, 20), np.arange(18, 36), np.arange(3)), u


CASES = {
    "graph": lambda mesh: airfoil(jm.DelaunayGraph(), mesh),
    "default": lambda mesh: airfoil(None, mesh),
    "multiscale": lambda mesh: airfoil(jm.SurfaceReconstruction(correction=jm.Multiscale()), mesh),
    "rbf": lambda mesh: airfoil(jm.RBF(reduction=jm.KDTree(4)), mesh),
    "symmetry": lambda mesh: square(
        mesh, symmetry=[jm.Plane((1, 0), (0, 0)), jm.Plane((1, 0), (1, 0))]
    ),
    "sliding": lambda mesh: square(
        mesh, sliding=jm.Slide(np.arange(6, 30, 6), jm.Plane((1, 0), (0, 0)))
    ),
}
"""A mesh, its lists, the rest of `prepare`'s arguments, the nodes of each piece, and a displacement."""


@over("name", ["graph"], nightly=["default", "symmetry", "multiscale", "rbf", "sliding"])
def test_pieces_move_as_the_whole(mesh, tmp_path, name):
    """Whatever the splitting: places, walls, nodes that pieces share, and the sum of the pieces' gradients."""
    given, lists, options, pieces, u = CASES[name](mesh)
    plan, method = jm.prepare(given, *lists, **options), options.pop("method", None)
    half = jm.prepare_surface(jm.Boundary(given, *lists, **options), method=method)
    jm.save(tmp_path / "half.npz", pickle.loads(pickle.dumps(half)))
    half = jm.load(tmp_path / "half.npz")
    np.testing.assert_array_equal(half.moving, plan.moving)
    np.testing.assert_array_equal(half.surface_nodes, plan.surface_nodes)
    points = np.asarray(plan.points)
    whole, cotangent = (
        np.asarray(jm.deform(plan, u)),
        np.random.default_rng(2).normal(size=points.shape),
    )
    seen, total = {}, 0.0
    for nodes in pieces:
        piece = half.attach(points[nodes], nodes)
        assert piece.is_piece
        moved = np.asarray(jm.deform(piece, u))
        np.testing.assert_allclose(moved, whole[nodes], rtol=0, atol=3e-12)
        on_wall = np.isin(nodes, half.moving)
        if plan.method.exact:
            rows = [np.flatnonzero(half.moving == node)[0] for node in nodes[on_wall]]
            np.testing.assert_array_equal(moved[on_wall], points[nodes[on_wall]] + u[rows])
        first = np.array(
            [node not in seen for node in nodes]
        )  # a node counts in the first piece that has it
        for node, place in zip(nodes, moved, strict=True):
            np.testing.assert_allclose(seen.setdefault(node, place), place, rtol=0, atol=1e-13)
        total = total + np.asarray(
            jm.pullback(piece, u, np.where(first[:, None], cotangent[nodes], 0))
        )
    assert len(seen) == len(points)
    expected = np.asarray(jm.pullback(plan, u, cotangent))
    np.testing.assert_allclose(total, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@over("span", slow=[0.05], nightly=[2.0])
def test_a_wing_between_two_planes_moves_alike_however_it_is_prepared(span):
    """At once, from its surface alone as parts of a case are, and as the one piece of an MPI run."""
    wing = cases.wing(points=500, stations=5, span=span)
    sides = ("root", "tip")
    points = np.asarray(wing.points)
    plan = jm.prepare(wing, "wing", "farfield", symmetry=sides)
    x = np.asarray(plan.moving_points)
    u = 0.05 * np.stack([np.cos(3 * x[:, 0]), 0 * x[:, 0], np.sin(5 * x[:, 0] + x[:, 1])], axis=1)
    whole = np.asarray(jm.deform(plan, u))
    outer = jm.boundary_faces(wing)
    nodes = np.unique(np.concatenate([corners.ravel() for corners in outer.values()]))
    faces = {kind: np.searchsorted(nodes, corners) for kind, corners in outer.items()}
    patches = {name: np.searchsorted(nodes, ids) for name, ids in wing.patches.items()}
    surface = jm.Mesh(points[nodes], faces, patches)
    boundary = jm.Boundary(surface, "wing", "farfield", symmetry=sides)
    half = jm.prepare_surface(boundary, nodes=nodes, faces=faces)
    every = np.arange(len(points))
    full = np.zeros(points.shape)
    full[plan.moving] = u
    ways = {"parts": jm.deform(half.attach(points, every), full[half.moving])}
    mpi = pytest.importorskip("jaxmorph.integrations.mpi")
    planes = [jm.Plane.through(points, wing.patch(name)) for name in sides]
    piece = mpi.prepare(mpi.MPI.COMM_SELF, wing, every, plan.moving, plan.fixed, symmetry=planes)
    ways["one process"] = piece.deform(u)
    for moved in ways.values():
        assert np.abs(np.asarray(moved) - whole).max() < 1e-9 * np.abs(u).max()


@pytest.mark.nightly
def test_pieces_march_and_replay(mesh):
    plan, half = (
        jm.prepare(mesh, "airfoil", "farfield"),
        jm.prepare_surface(jm.Boundary(mesh, "airfoil", "farfield")),
    )
    u, points, nodes = displacement(half, mesh), np.asarray(mesh.points), pieces_of(mesh)[2]
    path = np.stack([u, 2 * u, 4 * u])
    piece = half.attach(points[nodes], nodes)
    steps, moved = jm.march(piece, path)
    np.testing.assert_allclose(
        moved, np.asarray(jm.march(plan, path)[1])[nodes], rtol=0, atol=1e-11
    )
    np.testing.assert_array_equal(jm.replay(steps, path), moved)
    with pytest.raises(ValueError, match="march of a piece needs rebuild=False"):
        jm.march(piece, path, rebuild=True)


def test_a_surface_gathered_from_elsewhere(mesh):
    """No process has the mesh: the half is made of the surface's points, in another order and with ids of their own."""
    points = np.asarray(mesh.points)
    wall, far = mesh.patch("airfoil"), mesh.patch("farfield")
    some = np.concatenate([far, wall])
    rows = np.arange(len(some))
    graph = jm.DelaunayGraph()
    half = jm.prepare_surface(
        jm.Boundary(points[some], rows[len(far) :], rows[: len(far)]), nodes=some, method=graph
    )
    plan = jm.prepare(points, wall, far, method=graph)
    u = displacement(half, mesh)
    nodes = np.arange(100, 200)
    moved = jm.deform(half.attach(points[nodes], nodes), u)
    np.testing.assert_allclose(moved, np.asarray(jm.deform(plan, u))[nodes], rtol=0, atol=1e-13)


def test_the_graph_is_built_once_and_is_not_in_the_file(mesh, monkeypatch):
    half = jm.prepare_surface(jm.Boundary(mesh, "airfoil", "farfield"), method=jm.DelaunayGraph())
    bytes_before, built = len(pickle.dumps(half)), []
    monkeypatch.setattr(
        corrections, "graph_of", lambda surface: built.append(surface) or graph_of(surface)
    )
    for nodes in pieces_of(mesh):
        half.attach(np.asarray(mesh.points)[nodes], nodes)
    assert len(built) == 1
    assert len(pickle.dumps(half)) == bytes_before


def test_what_a_half_refuses(mesh):
    points = np.asarray(mesh.points)
    half = jm.prepare_surface(jm.Boundary(mesh, "airfoil", "farfield"), method=jm.DelaunayGraph())
    u, wall = displacement(half, mesh), half.moving[:4]
    boundary = jm.Boundary(mesh, "airfoil", "farfield")
    piece, at, of_other = (
        half.attach(points[wall], wall),
        points[wall],
        "call {} with the plan of the surface",
    )
    lifted = at + 0.1 * np.eye(4)[:, [0, 2]] * [0, 1]
    refused = {
        r"1 nodes are named more than once in `nodes`, first \d+": lambda: half.attach(
            at[[0, 0]], wall[[0, 0]]
        ),
        r"1 surface nodes lie elsewhere than in the half: id \d+, point 2, by 0.1": lambda: (
            half.attach(lifted, wall)
        ),
        "expected an id for each of 4 points": lambda: half.attach(at, wall[:2]),
        "the piece has no points": lambda: half.attach(at[:0], wall[:0]),
        "only -1 may come twice": lambda: jm.prepare_surface(
            boundary, nodes=np.zeros(len(points), int)
        ),
        "LinearElasticity needs the cells": lambda: jm.prepare_surface(
            boundary, method=jm.LinearElasticity()
        ),
        rf"\d+ surface nodes are in .*{of_other.format('inspect')}": lambda: jm.inspect(piece, u),
        rf"\d+ surface nodes are in .*{of_other.format('boundary_quality')}": lambda: (
            jm.boundary_quality(piece, at)
        ),
        "this plan is of a piece: call prepare_surface": lambda: jm.refit(piece, at),
        "`method` is the class DelaunayGraph: call it": lambda: jm.prepare_surface(
            boundary, method=jm.DelaunayGraph
        ),
    }
    for message, call in refused.items():
        with pytest.raises(ValueError, match=message):
            call()


def test_shapes_move_the_nodes_of_other_pieces_too(mesh):
    half = jm.prepare_surface(jm.Boundary(mesh, "airfoil", "farfield"), method=jm.DelaunayGraph())
    nodes = half.moving[5:9]
    piece, wall = half.attach(mesh.points[nodes], nodes), mesh.points[half.moving]
    u = shapes.displacement(lambda x, angle: shapes.rotate(x, angle, (0.25, 0)), piece, 0.1)
    np.testing.assert_allclose(u, shapes.rotate(wall, 0.1, (0.25, 0)) - wall, rtol=0, atol=1e-15)


@pytest.mark.nightly
def test_a_free_side_that_only_pieces_show():
    points, moving, fixed = brick()
    some = np.concatenate([moving, fixed])
    rows = np.arange(12)
    half = jm.prepare_surface(jm.Boundary(points[some], rows[:6], rows[6:]), nodes=some)
    with pytest.raises(
        ValueError, match="flat side of the mesh that is neither moving, fixed nor a symmetry plane"
    ):
        half.attach(points, np.arange(36))
    told = jm.prepare_surface(
        jm.Boundary(points[some], rows[:6], rows[6:]), nodes=some, is_open=True
    )
    u = 0.1 * np.stack([0 * points[moving, 0], np.sin(2 * points[moving, 0])], axis=1)
    expected = jm.deform(jm.prepare(points, moving, fixed), u)
    np.testing.assert_allclose(
        jm.deform(told.attach(points, np.arange(36)), u), expected, rtol=0, atol=1e-12
    )


@pytest.mark.slow
def test_parts_march_by_a_method_that_is_not_exact():
    points, moving, fixed = brick()
    method = jm.RBF(reduction=jm.KDTree(2))
    u = 0.05 * np.stack([0 * points[moving, 0], np.sin(2 * points[moving, 0])], axis=1)
    path = np.stack([u, 2 * u])
    whole = jm.march(jm.prepare(points, moving, fixed, method=method), path)[1]
    parts = list(jm.prepare_in_chunks(jm.Boundary(points, moving, fixed), size=10, method=method))
    assert len(parts) == 3
    for nodes, plan in parts:
        np.testing.assert_allclose(jm.march(plan, path)[1], whole[nodes], rtol=0, atol=1e-12)


def test_rows_name_the_displacement_of_each_node():
    points, moving, fixed = brick()
    numbers = np.random.default_rng(0).permutation(100)[: len(points)]
    half = jm.prepare_surface(
        jm.Boundary(points, moving, fixed), nodes=numbers, method=jm.InverseDistance()
    )
    some = half.moving[[4, 0, 2]]
    np.testing.assert_array_equal(half.rows(some), [4, 0, 2])
    np.testing.assert_array_equal(half.moving[half.rows(numbers[moving])], numbers[moving])
    with pytest.raises(ValueError, match=f"1 of 2 nodes do not move, first {numbers[30]}"):
        half.rows([half.moving[0], numbers[30]])


SHARDED = """
import json, re
import jax, jax.numpy as jnp, numpy as np
jax.config.update("jax_enable_x64", True)
import jaxmorph as jm
from jaxmorph import cases
from jaxmorph._host.linear import systems as linear

mesh, found = cases.naca0015(points=2000), {}
rng = np.random.default_rng(0)
u, cotangent = 0.01 * rng.normal(size=(len(mesh.patch("airfoil")), 2)), rng.normal(size=mesh.points.shape)
methods = {
    "default": jm.SurfaceReconstruction(jm.RBF(reduction=jm.KDTree(8), fixed_reduction=jm.KDTree(4)), jm.NearWall()),
    "graph": jm.DelaunayGraph(),
    "compact": jm.CompactRBF(0.2),
}
solves, solved = [], linear.solve
linear.solve = lambda *system, **options: solves.append(1) or solved(*system, **options)
for name, method in methods.items():
    plan = jm.prepare(mesh.points, mesh.patch("airfoil"), mesh.patch("farfield"), method=method)
    path = np.stack([u / 2, u])
    whole = jm.deform(plan, u), jm.pullback(plan, u, cotangent), jm.march(plan, path)[1]
    base = jax.grad(lambda x: jnp.vdot(jm.deform(jm.refit(plan, x), u), cotangent))(plan.points)
    for count in (2, 3):
        laid = jm.shard(plan, jax.devices()[:count])
        solves.clear()
        equal = bool((jm.deform(laid, u) == whole[0]).all())
        jax.block_until_ready(jm.pullback(laid, u, cotangent))
        found[f"{name} {count} solves"] = [equal, len(solves)]
        shared = jm.deform(laid, u), jm.pullback(laid, u, cotangent), jm.march(laid, path)[1]
        shared += (jax.grad(lambda x: jnp.vdot(jm.deform(jm.refit(laid, x), u), cotangent))(laid.points),)
        found[f"{name} {count}"] = [float(jnp.abs(a - b).max() / jnp.abs(a).max()) for a, b in zip((*whole, base), shared)]
        gradient = jax.jit(jax.grad(lambda u, laid: (jm.deform(laid, u) ** 3).sum()))
        text = gradient.lower(jnp.asarray(u), laid).compile().as_text()
        bodies = re.findall(r"body=%?([\\w.]+)", text)
        inside = [body for body in bodies if "all-reduce" in text.split("%" + body + " (")[1].split("\\n}")[0]]
        found[f"{name} {count} text"] = [len(re.findall(r"all-reduce(?:-start)?\\(", text)), len(inside)]
    found[f"{name} points"] = len(laid.points) == len(plan.points)
print(json.dumps(found))
"""


@pytest.mark.nightly
def test_equal_to_the_whole_with_one_all_reduce_outside_of_loops():
    """Points bit for bit but for the order of sums, gradients as far as the solve lets them: one process compiles it all."""
    flags = os.environ.get("XLA_FLAGS", "") + " --xla_force_host_platform_device_count=3"
    environment = os.environ | {"XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"}
    done = subprocess.run(
        [sys.executable, "-c", SHARDED],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    found = json.loads(done.stdout)
    for method, least in (("default", 1e-8), ("graph", 1e-12), ("compact", 1e-11)):
        assert found[f"{method} points"], "the number of points has changed"
        for count in (2, 3):
            points, pulled, marched, base = found[f"{method} {count}"]
            assert points < 1e-13
            assert marched < 1e-12  # a second solve, on points that differ by round-off
            assert max(pulled, base) < least
            reduces, in_loops = found[f"{method} {count} text"]
            assert in_loops == 0
            if (
                method == "compact"
            ):  # `deform` and `pullback` solve on the host once each, not once a device
                assert found[f"{method} {count} solves"] == [True, 2]
            else:
                assert reduces == 1
