"""What calls the host from traced code ends on one core: no call waits for XLA's thread, which may be the one that makes it."""

import os
import pathlib
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meshes import bricks, mixed
from runs import over

from jaxmorph import cases
from jaxmorph._advice.largest_step import CornerBounds
from jaxmorph._kernels.callback import host_call

LIMIT = 300
"""Seconds that a process may take; one that ends takes ten, or more beside others."""

START = """
import os
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
import jax, jax.numpy as jnp, numpy as np
jax.config.update("jax_enable_x64", True)
import jaxmorph as jm
from jaxmorph import cases, shapes
def late(rows, columns):
    # zeros that XLA copies on its thread, since they are above 100 KiB and not aligned: what is called with them runs there, too
    return np.zeros(rows * columns + 1)[1:].reshape(rows, columns)
def airfoil(points, method):
    mesh = cases.naca0015(points=points)
    plan = jm.prepare(mesh, moving="airfoil", fixed="farfield", method=method)
    return mesh, plan, shapes.rotate(plan.moving_points, jnp.deg2rad(15.0), (0.25, 0.0)) - plan.moving_points
"""

PROGRAMS = {
    "improve": """
mesh, plan, u = airfoil(3000, jm.DelaunayGraph())
assert jm.improve(mesh, jm.deform(plan, u)).after == 0
""",
    "cells": """
_, plan, u = airfoil(3000, jm.LinearElasticity())
there_and_back = jax.jit(lambda u, zeros: jm.pullback(plan, u, jm.deform(plan, u + zeros[: len(u)])))
for _ in range(3):
    assert jnp.isfinite(there_and_back(u, late(9000, 2))).all()
""",
    "steps": """
import equinox, optimistix
mesh, plan, u = airfoil(7000, jm.DelaunayGraph())
search = jm.ValidSteps(jm.DesignedMesh(plan, mesh, lambda share: share * u))
solver = equinox.tree_at(lambda solver: solver.search, optimistix.GradientDescent(0.3, 1e-3, 1e-3), search)
drag = search.guarded(lambda share, _: (share - 1) ** 2)
minimise = jax.jit(lambda start: optimistix.minimise(drag, solver, start[0, 0], max_steps=30, throw=False).value)
for _ in range(3):
    assert abs(minimise(late(9000, 2)) - 1) < 0.01
""",
    "smooth": """
ids = np.arange(8100).reshape(90, 90)
faces = np.stack([ids[:-1, :-1], ids[1:, :-1], ids[1:, 1:], ids[:-1, 1:]], axis=-1).reshape(-1, 4)
x, y = np.divmod(np.arange(8100) / 90, 1)
smoother = shapes.Smoother(np.stack([x, y, np.sin(x * y)], axis=1), faces, 5.0)
smooth = jax.jit(lambda u: smoother.apply(u + 1) - smoother.sensitivities(u))
for _ in range(3):
    np.testing.assert_allclose(smooth(late(8100, 3)), 1, atol=1e-12)
""",
}
"""Programs with arrays above 100 KiB on the host: XLA copies smaller ones at once."""


def run(program):
    """Runs a program in a process that never has more than one core."""
    command, root = [sys.executable, "-c", START + program], pathlib.Path(__file__).parents[1]
    done = subprocess.run(
        command, cwd=root, timeout=LIMIT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-3000:]


ONE = pytest.mark.skipif(
    not hasattr(os, "sched_setaffinity"), reason="nothing here chooses the cores of a process"
)


@ONE
@over("name", slow=["cells"], nightly=[name for name in PROGRAMS if name != "cells"])
def test_it_ends_on_one_core(name):
    run(PROGRAMS[name])


@ONE
@pytest.mark.nightly
@pytest.mark.parametrize("name", PROGRAMS)
def test_it_ends_each_time(name):
    for _ in range(5):
        run(PROGRAMS[name])


@over(
    "mesh",
    [mixed(), bricks(), *(cases.bricks(kind, cells=3) for kind in ("tetra", "mixed"))],
    ids=str,
)
def test_the_largest_step_is_found_without_jax(mesh):
    """On the host any array that JAX makes would be waited for; the guard refuses them."""
    bounds, points = CornerBounds(mesh, float, 0.1), np.asarray(mesh.points)
    turned = points.copy()
    turned[0] = 3 * points.mean(axis=0) - 2 * points[0]
    with jax.transfer_guard("disallow_explicit"):
        found = bounds.largest_share(points, turned)
    assert 0 < found.step < 1
    assert found.cell >= 0


@pytest.mark.parametrize("is_jitted", [True, False])
def test_a_call_takes_arrays_of_numpy_and_one_element_of_a_batch_after_another(is_jitted):
    taken = []

    def product(a, b):
        taken.append((type(a), type(b), a.shape, b.shape))
        return np.outer(a, b)

    def call(a, b):
        return host_call(product, jax.ShapeDtypeStruct((3, 2), a.dtype), a, b)

    rng = np.random.default_rng(0)
    a, b = (
        jnp.asarray(rng.normal(size=(4, 3, 5)), jnp.float32),
        jnp.asarray(rng.normal(size=(2, 4)), jnp.float32),
    )
    every = jax.vmap(jax.vmap(call, (1, None)), (0, 1))  # b's batch is the outer one
    found = (jax.jit(every) if is_jitted else every)(a, b)
    np.testing.assert_array_equal(found, a.swapaxes(1, 2)[..., None] * b.T[:, None, None])
    assert found.dtype == jnp.float32
    assert taken == 20 * [(np.ndarray, np.ndarray, (3,), (2,))]
