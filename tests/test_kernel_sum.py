"""The kernel sum in blocks: against SciPy, against its own one-point form, under every transformation, in bounded memory."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from runs import over
from scipy.interpolate import RBFInterpolator

import jaxmorph as jm
from jaxmorph._kernels.linear import few_rows_times
from jaxmorph._methods.base import POINT_BLOCK
from jaxmorph._methods.blocks import map_points

BASES = {
    "thin-plate": (jm.ThinPlateSpline(), "thin_plate_spline", 1.0, 1),
    "gaussian": (jm.Gaussian(0.4), "gaussian", 1 / 0.4, 1),
    "multiquadric": (jm.Multiquadric(0.4), "multiquadric", 1 / 0.4, 0),
    "wendland": (jm.WendlandC2(0.9), None, None, None),
}


@functools.cache
def case(name, dimension=3, n=2 * POINT_BLOCK + 137, s=70):
    """A plan whose sources are all its moving nodes: more than two blocks of points, and a rest."""
    rng = np.random.default_rng(dimension)
    points = rng.uniform(-1, 1, (n, dimension)) + 3.0
    basis, _, _, degree = BASES[name]
    every = jm.AllPoints()
    method = jm.RBF(basis, reduction=every, fixed_reduction=every, degree=degree)
    plan = jm.prepare(points, np.arange(s), method=method)
    return plan, rng.normal(size=(s, dimension)), rng.normal(size=(n, dimension))


def field_of(plan, u):
    return plan.method.field(
        plan.surface.ids, plan.surface.factors, plan.surface.points, jnp.asarray(u)
    )


def in_blocks(plan, u):
    return map_points(field_of(plan, u), plan.points, None)


def one_by_one(plan, u):
    field = field_of(plan, u)
    return jax.vmap(lambda x: field(x, None))(plan.points)


@over("name dimension", [("thin-plate", 2), ("multiquadric", 3)], nightly=[("gaussian", 3)])
def test_scipy_agrees(name, dimension):
    plan, u, _ = case(name, dimension)
    _, kernel, epsilon, degree = BASES[name]
    points = np.asarray(plan.points)
    moving = points[plan.moving]
    reference = RBFInterpolator(moving, u, kernel=kernel, epsilon=epsilon, degree=degree)(points)
    if name == "multiquadric":  # SciPy's has the other sign, which the weights take up
        assert np.abs(reference).max() > 1
    np.testing.assert_allclose(
        jm.deform(plan, u) - points, reference, rtol=0, atol=1e-8 * np.abs(reference).max()
    )


SIZES = [("thin-plate", n, 25) for n in (26, POINT_BLOCK, POINT_BLOCK + 1)]


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("name", "n", "s"), [*((name, 2 * POINT_BLOCK + 137, 70) for name in BASES), *SIZES]
)
def test_blocks_are_the_one_point_form(name, n, s):
    plan, u, w = case(name, n=n, s=s)
    scale = np.abs(one_by_one(plan, u)).max()
    np.testing.assert_allclose(in_blocks(plan, u), one_by_one(plan, u), rtol=0, atol=1e-11 * scale)

    def gradients(form):
        by_u = jax.grad(lambda u, points: jnp.sum(w * jnp.sin(form(plan, u))))
        by_points = jax.grad(
            lambda u, points: jnp.sum(w * form(jm.refit(plan, points), u)), argnums=1
        )
        return jax.jit(lambda *at: (by_u(*at), by_points(*at)))(jnp.asarray(u), plan.points)

    for found, expected in zip(gradients(in_blocks), gradients(one_by_one), strict=True):
        assert np.isfinite(found).all()
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@over("name", nightly=["thin-plate", "wendland"])
def test_derivatives_at_a_source_are_finite(name):
    """First and second derivatives with respect to the points, some of which are sources."""
    plan, u, w = case(name, n=POINT_BLOCK + 3, s=25)

    @jax.jit
    def gradient(points):
        return jax.grad(lambda points: jnp.sum(w * in_blocks(jm.refit(plan, points), u)))(points)

    first, second = jax.jvp(gradient, (plan.points,), (jnp.ones_like(plan.points),))
    assert np.isfinite(first).all()
    assert np.isfinite(second).all()


def dense_kernels(text: str, n: int, s: int) -> int:
    """How many arrays of the compiled text hold a number for every point and every source."""
    return text.count(f"[{n},{s}]") + text.count(f"[{s},{n}]")


@pytest.mark.nightly
@pytest.mark.parametrize("what", ["deform", "gradient", "gradient by the points"])
def test_memory_does_not_grow_with_points_times_sources(what):
    """What the program sets aside beside its results: a few arrays of the points and one block, 40 times below n s."""
    plan, u, _ = case("thin-plate", n=40_000, s=200)
    squares = lambda plan, u, x: jnp.sum(jm.deform(jm.refit(plan, x), u) ** 2)  # noqa: E731
    function = {
        "deform": lambda plan, u: jm.deform(plan, u),
        "gradient": lambda plan, u: jax.grad(lambda u: jnp.sum(jm.deform(plan, u) ** 2))(u),
        "gradient by the points": lambda plan, u: jax.grad(squares, argnums=2)(
            plan, u, plan.points
        ),
    }[what]
    arrays, static = eqx.partition(plan, eqx.is_array)
    compiled = (
        jax.jit(lambda arrays, u: function(eqx.combine(arrays, static), u))
        .lower(arrays, u)
        .compile()
    )
    n, d = plan.points.shape
    assert (
        compiled.memory_analysis().temp_size_in_bytes < 8 * 10 * n * d + 8 * 12 * POINT_BLOCK * 200
    )
    assert dense_kernels(compiled.as_text(), n, 200) == 0


@pytest.mark.slow
def test_many_fields_share_one_kernel():
    """The compiled program of eight displacements evaluates as many logarithms as that of one."""
    plan, u, _ = case("thin-plate")

    def shifts(function, *arguments):
        return jax.jit(function).lower(*arguments).compile().as_text().count("shift-right-logical(")

    one = shifts(lambda u: in_blocks(plan, u), jnp.asarray(u))
    eight = jnp.stack([jnp.asarray(u)] * 8)
    assert shifts(jax.vmap(lambda u: in_blocks(plan, u)), eight) == one
    text = jax.jit(jax.vmap(lambda u: in_blocks(plan, u))).lower(eight).compile().as_text()
    assert f"f64[{len(u)},{POINT_BLOCK}]" in text
    assert f"f64[8,{len(u)},{POINT_BLOCK}]" not in text


def test_product_of_few_rows():
    rng = np.random.default_rng(0)
    rows, block = jnp.asarray(rng.normal(size=(3, 20))), jnp.asarray(rng.normal(size=(20, 7)))
    close = functools.partial(np.testing.assert_allclose, rtol=1e-13, atol=1e-13)
    close(few_rows_times(rows, block), rows @ block)
    many_rows, many_blocks = rng.normal(size=(5, 3, 20)), rng.normal(size=(5, 20, 7))
    close(jax.vmap(few_rows_times, (0, None))(many_rows, block), many_rows @ block)
    close(jax.vmap(few_rows_times, (None, 0))(rows, many_blocks), rows @ many_blocks)
    close(jax.vmap(few_rows_times)(many_rows, many_blocks), many_rows @ many_blocks)
    every = jax.vmap(jax.vmap(few_rows_times, (0, None)), (None, 0))
    close(every(many_rows, many_blocks), many_rows[None] @ many_blocks[:, None])
    cotangent = rng.normal(size=(3, 7))
    by_rows, by_block = jax.vjp(few_rows_times, rows, block)[1](jnp.asarray(cotangent))
    close(by_rows, cotangent @ block.T)
    close(by_block, rows.T @ cotangent)
