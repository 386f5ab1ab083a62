"""Work on several cores: their number, results that do not depend on it, and errors from threads."""

import dataclasses
import itertools
import os
import subprocess
import sys
import threading

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import BY_NAME, body, motion
from meshes import grid, lattice
from runs import runs

import jaxmorph as jm
from jaxmorph._host.package import cores, rounding
from jaxmorph._host.surface.neighbours import near_walls
from jaxmorph._methods.blocks import is_rows
from jaxmorph._plan import deform as slabs
from jaxmorph._quality import face_quality, vector
from jaxmorph.cases import naca4, wing

METHODS = {
    "default": None,
    "published": jm.SurfaceReconstruction.published(8),
    "radial functions": jm.RBF(),
    "multiscale": jm.Multiscale(),
    "cells": jm.Laplacian(),
}


@pytest.fixture
def fine():
    """A square of 5,041 nodes with a bump at the bottom."""
    axis = np.linspace(0, 1, 71) ** 1.5
    rest = lambda ids: np.concatenate([ids[-1], ids[:, -1]])  # noqa: E731
    return grid(
        axis,
        axis,
        patches={"bottom": lambda ids: ids[:, 0], "left": lambda ids: ids[0], "rest": rest},
    )


@pytest.fixture
def few_points(monkeypatch):
    """Slabs, searches by threads and blocks of few points, faces and cells."""
    monkeypatch.setattr(slabs, "LEAST_SLAB", 1024)
    monkeypatch.setattr(rounding, "FEW_POINTS", 64)
    monkeypatch.setattr(cores, "ROWS_OF_A_CORE", 512)
    monkeypatch.setattr(face_quality, "FACES_AT_ONCE", 512)
    monkeypatch.setattr(vector, "CACHED", 512)


EVERY = list(itertools.product(METHODS, ("fixed", "a plane")))
FAST = ("radial functions", "fixed")


@pytest.mark.parametrize(
    ("name", "sides"), runs([FAST], nightly=[case for case in EVERY if case != FAST])
)
def test_any_number_of_cores_gives_equal_bits(fine, few_points, monkeypatch, name, sides):
    fixed, symmetry = (("left", "rest"), ()) if sides == "fixed" else ("rest", "left")
    x = np.asarray(fine.points)[fine.patch("bottom")]
    u = np.stack([0.02 * x[:, 0] * (1 - x[:, 0]), 0.1 * np.sin(np.pi * x[:, 0]) ** 2], axis=1)
    w, found = np.random.default_rng(0).normal(size=fine.points.shape), []
    for count in ("1", "3"):
        monkeypatch.setenv(cores.SWITCH, count)
        plan = jm.prepare(fine, "bottom", fixed, symmetry=symmetry, method=METHODS[name])
        assert len(slabs.slabs(len(fine.points), plan, u)) > 1
        assert slabs.shares(plan, u) == 4
        found.append([*jax.tree.leaves(plan), jm.pullback(plan, u, w), jm.deform(plan, u)])
    for first, other in zip(*found, strict=True):
        np.testing.assert_array_equal(first, other)
    in_jit, transpose = jax.vjp(jax.jit(lambda u: jm.deform(plan, u)), jnp.asarray(u))
    np.testing.assert_allclose(found[0][-1], in_jit, rtol=0, atol=1e-11)
    (expected,) = transpose(jnp.asarray(w))
    np.testing.assert_allclose(found[0][-2], expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_shares_of_a_method_whose_field_names_nothing(fine, few_points):
    """Every leaf of such a field may depend on `u`: the pullback through shares is the same."""
    x = np.asarray(fine.points)[fine.patch("bottom")]
    u = 0.05 * np.sin(np.pi * x)
    w = np.random.default_rng(0).normal(size=fine.points.shape)
    method = BY_NAME["notebook's method"].make(1.0)
    plan = jm.prepare(fine, "bottom", ("left", "rest"), method=method)
    assert slabs.shares(plan, u) == 4
    expected = jax.vjp(jax.jit(lambda u: jm.deform(plan, u)), jnp.asarray(u))[1](jnp.asarray(w))[0]
    np.testing.assert_allclose(jm.pullback(plan, u, w), expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize("count", [2048, 5041, 6144, 6145, 100_000, 216_000, 1_000_003])
@pytest.mark.parametrize("number", [2, 6, 64])
def test_slabs_hold_every_point_and_are_of_one_size(count, number, few_points, monkeypatch):
    monkeypatch.setattr(slabs, "MOST_PARTS", number)
    parts = slabs.slabs(count)
    rows = jnp.arange(float(count))[:, None]
    assert len(parts) <= number
    assert len({size for _, size in parts}) == 1
    assert all(start % slabs.SLAB_STEP == 0 for start, _ in parts)
    joined = slabs.join_slabs(tuple(rows[start : start + size] for start, size in parts), count)
    np.testing.assert_array_equal(joined, rows)


def test_slabs_are_for_many_points_and_direct_calls_alone():
    assert slabs.slabs(2 * slabs.LEAST_SLAB - 1) == []
    jax.jit(lambda x: np.testing.assert_equal(slabs.slabs(10**6, x), []))(1.0)


def test_the_environment_and_the_affinity_say_how_many_cores(monkeypatch):
    monkeypatch.delenv(cores.SWITCH, raising=False)
    if hasattr(os, "sched_getaffinity"):
        allowed = os.sched_getaffinity(0)
        assert cores.cores() == len(allowed)
        os.sched_setaffinity(0, {min(allowed)})
        try:
            assert cores.cores() == 1
        finally:
            os.sched_setaffinity(0, allowed)
    monkeypatch.setenv(cores.SWITCH, "48")
    assert cores.cores() == 48
    for words in ("0", "-1", "two", "1.5"):
        monkeypatch.setenv(cores.SWITCH, words)
        with pytest.raises(
            ValueError, match=f"JAXMORPH_CPUS must be a number of cores, 1 or more, found '{words}'"
        ):
            cores.cores()


@pytest.mark.parametrize("count", ["1", "2"])
def test_a_call_beside_returns_or_raises_where_its_result_is_asked_for(monkeypatch, count):
    monkeypatch.setenv(cores.SWITCH, count)
    names = []
    call = cores.beside(lambda word: names.append(threading.current_thread().name) or word, "done")
    assert [call.result(), call.result()] == ["done", "done"]
    assert len(names) == 1
    assert (names[0] == threading.current_thread().name) == (count == "1")
    failing = cores.beside(jm.prepare, np.zeros((3, 2)), [7])
    with pytest.raises(ValueError, match="are not in 0 to 2"):
        failing.result()


@pytest.mark.parametrize("count", ["1", "2"])
def test_a_surface_without_extent_is_refused_beside_other_work(monkeypatch, count):
    monkeypatch.setenv(cores.SWITCH, count)
    points = np.concatenate([np.stack([np.linspace(0, 1, 9), np.zeros(9)], axis=1), [[0.5, 1.0]]])
    method = jm.SurfaceReconstruction(jm.InverseDistance(), jm.DelaunayGraph())
    with pytest.raises(ValueError, match="lie in one line, so no Delaunay graph"):
        jm.prepare(points, [0, 1, 2], range(3, 9), method=method)


@pytest.mark.nightly
def test_tables_of_the_transpose_are_made_for_derivatives_alone(monkeypatch):
    from jaxmorph._methods import sparse

    made, tabled = [], sparse.Interpolation._tabled
    monkeypatch.setattr(
        sparse.Interpolation, "_tabled", lambda *given: made.append(given) or tabled(*given)
    )
    mesh = body(2)
    plan = jm.prepare(mesh.points, mesh.moving, mesh.fixed)
    u, w = motion(mesh.points)[mesh.moving], np.random.default_rng(0).normal(size=mesh.points.shape)
    jm.deform(plan, u)
    assert not made
    assert all(
        rows.table is None for rows in jax.tree.leaves(plan, is_leaf=is_rows) if is_rows(rows)
    )
    expected = jm.pullback(plan, u, w)
    count = len(made)
    assert count
    jm.pullback(plan, 2 * u, w)
    jax.grad(lambda u: jnp.vdot(w, jm.deform(plan, u)))(jnp.asarray(u))
    assert len(made) == count
    scattered = eqx.filter_jit(eqx.filter_grad(lambda u, plan: jnp.vdot(w, jm.deform(plan, u))))(
        jnp.asarray(u), plan
    )
    np.testing.assert_allclose(scattered, expected, rtol=0, atol=1e-11 * np.abs(expected).max())
    np.testing.assert_allclose(
        jnp.vdot(w, jm.deform(plan, u) - plan.points), jnp.vdot(expected, u), rtol=1e-9
    )


def test_more_points_than_a_thread_searches_alone_get_equal_neighbours(few_points, monkeypatch):
    points = lattice(*[np.linspace(0, 1, 12)] * 3)
    tree = rounding.Tree(points)
    monkeypatch.setenv(cores.SWITCH, "1")
    alone = tree.query(points + 0.3, k=3)
    monkeypatch.setenv(cores.SWITCH, "3")
    for first, other in zip(alone, tree.query(points + 0.3, k=3), strict=True):
        np.testing.assert_array_equal(first, other)


@pytest.mark.parametrize("wall", runs(["airfoil"], nightly=["wing"]))
def test_quality_has_equal_bits_on_any_number_of_cores(few_points, monkeypatch, wall):
    mesh = naca4("2412", points=3000) if wall == "airfoil" else wing(points=300, stations=5)
    random, base = np.random.default_rng(0), np.asarray(mesh.points)
    points, found = base + 1e-3 * random.normal(size=base.shape), []
    for count in ("1", "2", "3"):
        monkeypatch.setenv(cores.SWITCH, count)
        faces = jm.face_quality(mesh, points)
        measures = jm.quality(mesh, points), jm.quality(mesh), jm.wall_quality(mesh, wall, points)
        found.append(
            [
                *jax.tree.leaves(measures),
                *(getattr(faces, field.name) for field in dataclasses.fields(faces)),
            ]
        )
    assert len(faces.volume) > 512
    for others in found[1:]:
        for first, other in zip(found[0], others, strict=True):
            np.testing.assert_array_equal(first, other)


@pytest.mark.parametrize("count", ["1", "3"])
def test_results_come_in_order_and_few_are_ahead(monkeypatch, count):
    monkeypatch.setenv(cores.SWITCH, count)
    begun = []
    results = cores.in_order(lambda piece: begun.append(piece) or piece**2, range(100))
    assert [next(results) for _ in range(5)] == [0, 1, 4, 9, 16]
    assert len(begun) <= 5 + int(count) * (cores.AHEAD + 1)
    assert list(results) == [k**2 for k in range(5, 100)]
    with pytest.raises(ZeroDivisionError):
        list(cores.in_order(lambda piece: 1 // (7 - piece), range(20)))
    assert list(cores.in_order(abs, [])) == []


@pytest.mark.parametrize("count", [3, 7, 300, 5000])
def test_blocks_hold_every_row_once(few_points, monkeypatch, count):
    monkeypatch.setenv(cores.SWITCH, "3")
    seen = np.zeros(count, dtype=int)
    cores.over_blocks(lambda rows: np.add.at(seen, rows, 1), count)
    np.testing.assert_array_equal(seen, 1)


@pytest.mark.parametrize("number", ["1", "3"])
def test_the_nearest_wall_is_found_among_the_boxes_of_all(few_points, monkeypatch, number):
    monkeypatch.setenv(cores.SWITCH, number)
    random = np.random.default_rng(0)
    surface = random.uniform(size=(600, 3))
    wall = np.repeat(np.arange(6), 100).astype(np.int32)
    for label in range(6):  # the sides of a cube
        surface[wall == label, label // 2] = label % 2
    points, reach = random.uniform(size=(2000, 3)), np.repeat([0.3, 0.1, 0.4, 0.2, 0.25, 0.05], 100)
    near, rows = near_walls(surface, wall, reach, points, 3)
    distance = np.linalg.norm(points[:, None] - surface[None], axis=2)
    nearest = np.where(distance < reach, distance, np.inf).argmin(axis=1)
    own = np.take_along_axis(distance, nearest[:, None], axis=1)[:, 0]
    others = np.where(wall == wall[nearest][:, None], np.inf, distance)
    is_near = (own < reach[nearest]) & (own <= others.min(axis=1))
    np.testing.assert_array_equal(np.sort(near), np.flatnonzero(is_near))
    np.testing.assert_array_equal(rows[:, 0], nearest[near])
    far = 8 * reach[nearest[near]]
    expected = np.where(others[near].min(axis=1) < far, others[near].argmin(axis=1), rows[:, 0])
    np.testing.assert_array_equal(rows[:, 3], expected)


ON_CORES = """
import os, sys
os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: int(sys.argv[1])])
import jax, numpy as np
jax.config.update("jax_enable_x64", True)
import jaxmorph as jm
from jaxmorph import cases
mesh = cases.naca4("2412", points=3000)
plan = jm.prepare(mesh, "airfoil", "farfield")
u = 0.05 * np.sin(3 * np.asarray(plan.moving_points) + np.arange(2))
w = np.random.default_rng(0).normal(size=mesh.points.shape)
moved = jm.deform(plan, u)
pulled = jm.pullback(plan, u, w)
np.savez(sys.argv[2], moved=moved, pulled=pulled, transposed=jax.vjp(lambda u: jm.deform(plan, u), u)[1](w)[0])
"""


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="needs the affinity mask of Linux")
def test_one_core_and_several_differ_by_round_off(tmp_path):
    found = []
    for count in ("1", "2"):
        environment = os.environ | {"JAXMORPH_CACHE": "off"}
        command = [sys.executable, "-c", ON_CORES, count, str(tmp_path / count)]
        subprocess.run(command, env=environment, check=True, timeout=300)
        found.append(np.load(tmp_path / f"{count}.npz"))
    size = np.abs(found[0]["pulled"]).max()
    np.testing.assert_allclose(found[1]["moved"], found[0]["moved"], rtol=0, atol=1e-9 * 0.05)
    for other in (found[1]["pulled"], found[0]["transposed"]):
        np.testing.assert_allclose(other, found[0]["pulled"], rtol=0, atol=1e-9 * size)
