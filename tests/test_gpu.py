"""Programs for a GPU, by export alone: they exist, and take few steps one after the other."""

import pathlib
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import body, motion

import jaxmorph as jm
from jaxmorph._kernels.compile import compiled
from jaxmorph._kernels.linear import few_rows_in_one_loop
from jaxmorph._methods.blocks import map_rows, sized_by_platform

sys.path.insert(0, str(pathlib.Path(__file__).parents[1] / "benchmarks"))
import gpu  # pyright: ignore[reportMissingImports]

N = 10_000_000


def test_rounds_of_loops_are_counted():
    def inner(x):
        return jax.lax.scan(lambda x, _: (jnp.sin(x), None), x, length=7)[0]

    def outer(x):
        return inner(jax.lax.scan(lambda x, _: (inner(x), None), x, length=5)[0])

    assert gpu.steps(outer, (jnp.ones(3),)) == 5 + 5 * 7 + 7


@pytest.mark.slow
def test_ten_million_points_take_blocks_that_fit_the_platform():
    """By shapes alone: ten million points take few steps; on a CPU ten thousands of blocks that stay in its cache."""
    for name, function, arguments, *_ in gpu.programs(600, 300):
        shapes = gpu.grown(arguments, 600, N)
        assert gpu.steps(function, shapes) <= (128 if name == "deform" else 256)
        assert name == "refit" or gpu.steps(function, shapes, "cpu") > 10_000


@pytest.mark.nightly
@pytest.mark.parametrize(
    "method", [None, jm.SurfaceReconstruction.published(4, 4)], ids=["default", "published"]
)
def test_other_methods(method):
    mesh = body(3)
    u = motion(mesh.points[mesh.moving])
    plan = jm.prepare(mesh.points, mesh.moving, mesh.fixed, method=method)
    plan, points = gpu.grown((plan, plan.points), len(mesh.points), N)
    for function, arguments in (
        (jm.deform, (plan, u)),
        (jm.pullback, (plan, u, points)),
        (jm.refit, (plan, points)),
    ):
        assert gpu.steps(function, arguments) <= 512


@pytest.mark.slow
def test_quality():
    name, function, arguments, *_ = gpu.of_cells(45)
    assert gpu.steps(function, arguments) <= 4, name


def test_many_blocks_are_joined_in_order():
    rows = jnp.asarray(np.random.default_rng(3).normal(size=(301, 2)))

    def joined(rows):
        return map_rows(lambda part: jnp.sin(part), rows, 2)

    value, pull = jax.vjp(joined, rows)
    np.testing.assert_array_equal(value, jnp.sin(rows))
    np.testing.assert_allclose(pull(rows)[0], rows * jnp.cos(rows), rtol=0, atol=1e-15)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_product_in_one_loop(axis):
    rng = np.random.default_rng(axis)
    block = rng.normal(size=(5, 7))
    rows = rng.normal(size=(3, block.shape[axis]))
    found = few_rows_in_one_loop(jnp.asarray(rows.T), jnp.asarray(block), axis)
    np.testing.assert_allclose(
        found.T, rows @ (block if axis == 0 else block.T), rtol=0, atol=1e-14
    )


def test_a_direct_call_on_a_cpu_is_traced_for_it_alone():
    """Whatever else traces the same functions, nested ones too, is given blocks for each platform."""
    blocks = []

    def noted(rows, block):
        blocks.append(block)
        return rows

    inner = compiled(lambda x: sized_by_platform(noted, x, 1))
    outer = compiled(lambda x: inner(x))
    for function, expected in ((outer, {1}), (jax.jit(outer), {1, 256}), (inner, {1})):
        blocks.clear()
        function(jnp.ones(100))
        assert set(blocks) == expected
