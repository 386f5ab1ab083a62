"""The kernel for NVIDIA's GPUs: its body run by Pallas's interpreter, its program for CUDA, and its derivatives on a CPU."""

import functools
import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.spatial
from jax import export
from jax.experimental import pallas
from runs import over

import jaxmorph as jm
from jaxmorph._kernels import gpu
from jaxmorph._methods.rbf import system

BASES = [
    (jm.ThinPlateSpline(), lambda r: r**2 * np.log(np.maximum(r, 1e-300))),
    (jm.WendlandC2(0.9), lambda r: np.where(r < 0.9, (1 - r / 0.9) ** 4 * (4 * r / 0.9 + 1), 0)),
    (jm.Gaussian(0.5), lambda r: np.exp(-((r / 0.5) ** 2))),
]
"""A basis, and the function of the distance that it is."""


def numbers(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=shape)


@pytest.fixture
def interpreted(monkeypatch):
    """Has the kernel run here."""
    monkeypatch.setattr(
        pallas, "pallas_call", functools.partial(pallas.pallas_call, interpret=True)
    )


SIZES = {"points": (6, 700), "sources": (45, 70), "few": (3, 5)}


@over(
    "basis phi count n",
    [(*BASES[0], *SIZES["points"]), (*BASES[1], *SIZES["sources"]), (*BASES[2], *SIZES["few"])],
    nightly=[(*BASES[0], *SIZES["few"])],
    ids=["spline, points", "compact, sources", "gaussian, few", "spline, few"],
)
def test_the_sum_is_that_of_scipys_distances(interpreted, monkeypatch, basis, phi, count, n):
    """Of more points than blocks hold, of sources in several parts, and of fewer points than a block."""
    monkeypatch.setattr(gpu, "FEW", 512)
    monkeypatch.setattr(gpu, "LEAST_SHARE", 10)
    monkeypatch.setattr(gpu, "PROGRAMS", 8)
    weights, sources, points = numbers(count, 2), numbers(count, 3, seed=1), numbers(n, 3, seed=2)
    points[:3] = sources[:3]
    leaves, structure = jax.tree.flatten(basis)
    given = [jnp.asarray(each) for each in (weights, sources, points)]
    found = gpu.fused_sum(
        lambda r2, *leaves: jax.tree.unflatten(structure, leaves)(r2), *given, constants=leaves
    )
    expected = phi(scipy.spatial.distance.cdist(points, sources)) @ weights
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13 * np.abs(expected).max())


@pytest.mark.parametrize(
    "shapes", [((300, 3), (300, 3), (10**7, 3)), ((10**7, 2), (10**7, 2), (300, 2))]
)
@pytest.mark.parametrize("dtype", ["float64", pytest.param("float32", marks=pytest.mark.slow)])
def test_a_program_for_cuda_is_one_kernel(shapes, dtype):
    given = [jax.ShapeDtypeStruct(shape, dtype) for shape in shapes]
    traced = jax.jit(lambda *given: gpu.fused_sum(jm.ThinPlateSpline(), *given)).trace(*given)
    program = traced.lower(lowering_platforms=("cuda",)).as_text()
    assert program.count("custom_call") == 1
    assert "stablehlo.while" not in program


def test_every_operation_that_is_allowed_can_be_compiled():
    def phi(x):
        y = jnp.where(
            (x < 0.5) & ~(x > 0.7) | (x == 0.3) | (x != 0.2) & (x >= 0.1) & (x <= 9),
            jnp.maximum(x, 0.1),
            x**1.3,
        )
        y = (
            jnp.exp(-y)
            + jnp.exp2(y)
            + jnp.log(y)
            + jnp.log1p(y)
            + jax.nn.sigmoid(y)
            + jnp.tanh(y)
            + jnp.sqrt(y)
        )
        y = jax.lax.rsqrt(jnp.abs(y)) / (y**5 + jnp.square(y)) - jnp.minimum(
            jnp.sign(y), jnp.cos(y) * jnp.sin(y)
        )
        return y + jm.ThinPlateSpline()(x)

    names = {equation.primitive.name for equation in jax.make_jaxpr(phi)(jnp.ones(4)).eqns}
    assert len(names & gpu.ELEMENTWISE) > 25
    assert gpu.is_elementwise(phi, "float64")
    given = [jax.ShapeDtypeStruct(shape, "float64") for shape in [(9, 3), (9, 3), (10**6, 3)]]
    program = (
        jax.jit(lambda *given: gpu.fused_sum(phi, *given))
        .trace(*given)
        .lower(lowering_platforms=("cuda",))
    )
    assert "gpu.triton" in program.as_text()


@over(
    "capability is_enough",
    [("9.0", True), ("12.1", True), ("7.5", False), ("gfx90a", False), (None, False)],
)
def test_old_cards_and_those_of_others_have_loops(monkeypatch, capability, is_enough):
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(
        jax, "devices", lambda: [types.SimpleNamespace(compute_capability=capability)]
    )
    assert gpu.has_kernels() == is_enough


def test_an_exported_program_has_loops():
    """JAX refuses to export the kernel."""
    phi = system.Radial(jm.ThinPlateSpline(), jnp.ones(()))
    shapes = [jax.ShapeDtypeStruct(shape, "float64") for shape in [(9, 3), (9, 3), (10**5, 3)]]
    program = jax.jit(lambda sources, weights, points: system.fused(phi, sources, weights, points))
    assert (
        program.trace(*shapes).lower(lowering_platforms=("cuda",)).as_text().count("gpu.triton")
        == 1
    )
    exported = export.export(program, platforms=["cuda"])(*shapes).mlir_module()
    assert "gpu.triton" not in exported
    assert "stablehlo.while" in exported or "stablehlo.reduce" in exported


def test_a_version_of_jax_without_the_kernel_has_loops(monkeypatch):
    """Where Pallas has other names, sums are made by loops, and a warning tells why."""
    monkeypatch.delattr(pallas.triton, "CompilerParams")
    monkeypatch.setattr(system, "has_kernels", lambda: True)
    gaussian = system.Radial(jm.Gaussian(0.5), jnp.ones(()))
    shapes = [jax.ShapeDtypeStruct(shape, "float64") for shape in [(9, 3), (9, 3), (2000, 3)]]
    program = jax.jit(
        lambda sources, weights, points: system.fused(gaussian, sources, weights, points)
    ).trace(*shapes)
    with pytest.warns(UserWarning, match="loops take its place: AttributeError"):
        text = program.lower(lowering_platforms=("cuda",)).as_text()
    assert "gpu.triton" not in text
    assert "stablehlo.while" in text or "stablehlo.reduce" in text


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_every_basis_can_be_in_a_kernel(dtype):
    bases = [each(0.7) for each in (jm.WendlandC4, jm.CompactC2a, jm.InverseMultiquadric)]
    for basis in [*bases, jm.CubicSpline(), jm.LinearSpline(), *(basis for basis, _ in BASES)]:
        assert gpu.is_elementwise(system.Radial(basis, jnp.asarray(0.5, dtype)), dtype), basis


def test_a_basis_that_is_not_elementwise_is_left_to_blocks(monkeypatch):
    monkeypatch.setattr(system, "has_kernels", lambda: True)

    class Tabled(jm.AbstractBasis):
        def __call__(self, r2):
            return jnp.interp(r2, jnp.arange(4.0), jnp.array([1.0, 0.5, 0.1, 0.0]))

    assert system.is_fused(system.Radial(jm.Gaussian(1.0), jnp.ones(())), jnp.dtype("float64"))
    assert not system.is_fused(system.Radial(Tabled(), jnp.ones(())), jnp.dtype("float64"))
    assert not system.is_fused(system.Radial(jm.Gaussian(1.0), jnp.ones(())), jnp.dtype("float16"))


@pytest.mark.nightly
def test_a_plan_moves_as_without_a_kernel(monkeypatch):
    """By one operation inside a `jit`: points, products with the Jacobian and its transpose, batches, second derivatives."""
    points = numbers(90, 3)
    method = jm.RBF(jm.WendlandC2(3.0), jm.AllPoints(), jm.AllPoints())
    plan = jm.prepare(points, np.arange(12), np.arange(12, 20), method=method)
    u, v, w = (
        jnp.asarray(0.1 * numbers(*shape, seed=i))
        for i, shape in enumerate([(12, 3), (12, 3), (90, 3)])
    )

    def work(u, x):
        return jnp.sum(w * jm.deform(jm.refit(plan, x), u) ** 2)

    def everything(u, x):
        moved, change = jax.jvp(lambda u: jm.deform(plan, u), (u,), (v,))
        slopes = jax.grad(work, (0, 1))(u, x)
        bent = jax.jvp(lambda x: jax.grad(work)(u, x), (x,), (w,))[1]
        batch = jax.vmap(lambda u: jm.deform(plan, u))(jnp.stack([u, v]))
        back = jax.vmap(lambda w: jax.vjp(lambda u: jm.deform(plan, u), u)[1](w)[0])(
            jnp.stack([w, 2 * w])
        )
        return moved, change, slopes, bent, batch, back, jm.deform(jm.refit(plan, x), u)

    expected = jax.jit(everything)(u, plan.points)
    jax.clear_caches()  # which hold what is traced without
    monkeypatch.setattr(system, "has_kernels", lambda: True)
    assert "weighted_sum" in str(jax.make_jaxpr(everything)(u, plan.points))
    found = jax.jit(lambda u, x: everything(u, x))(u, plan.points)
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, rtol=0, atol=1e-11 * np.abs(b).max()),
        found,
        expected,
    )
    jax.clear_caches()
