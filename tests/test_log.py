"""The logarithm written for CPUs: against NumPy in extended precision over the whole range of float64."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmorph._kernels.log import half_x_log_x, log


def everywhere():
    """Positive numbers of every exponent, subnormals too, and crowds where a logarithm is hard: near 1, near the cuts."""
    rng = np.random.default_rng(0)
    exponents = np.repeat(np.arange(-1074, 1024), 40)
    spread = np.ldexp(rng.uniform(1, 2, len(exponents)), exponents)
    near_one = 1 + rng.uniform(-1, 1, 20_000) * 10.0 ** rng.uniform(-16, -0.3, 20_000)
    cuts = np.sqrt([0.5, 2])[:, None] * (1 + rng.uniform(-1e-9, 1e-9, 5_000))
    tiny, largest, least = (
        getattr(np.finfo(float), name) for name in ("tiny", "max", "smallest_subnormal")
    )
    edges = [tiny, largest, least, np.nextafter(tiny, 0), 1, np.nextafter(1, 0), np.nextafter(1, 2)]
    values = np.concatenate([spread, near_one, cuts.ravel(), edges])
    return values[(values > 0) & np.isfinite(values)]


def error_in_last_place(found, reference):
    return np.abs(found.astype(np.longdouble) - reference) / np.spacing(
        np.abs(reference).astype(float)
    )


needs_extended = pytest.mark.skipif(
    np.finfo(np.longdouble).nmant < 60, reason="no extended precision to compare with"
)


@needs_extended
def test_three_units_in_the_last_place():
    x = everywhere()
    x = x[x >= np.finfo(float).tiny]
    found = np.asarray(jax.jit(log)(x))
    assert error_in_last_place(found, np.log(x.astype(np.longdouble))).max() < 3


@needs_extended
def test_x_log_x():
    x = everywhere()
    x = x[(x > 1e-290) & (x < 1e300)]  # results that are neither subnormal nor infinite
    found = np.asarray(jax.jit(half_x_log_x)(x))
    wide = x.astype(np.longdouble)
    assert error_in_last_place(found, wide * np.log(wide) / 2).max() < 4


def test_special_values():
    x = np.array([0.0, 5e-324, 1e-310, 1.0, np.inf, np.nan])
    found = np.asarray(jax.jit(half_x_log_x)(x))
    np.testing.assert_array_equal(found[[0, 3, 4, 5]], [0, 0, np.inf, np.nan])
    assert np.abs(found[1:3]).max() < 1e-306


@pytest.mark.nightly
@pytest.mark.parametrize("function", [log, half_x_log_x])
def test_derivatives(function):
    """First, second and third, forward and reverse, against closed forms."""
    x = jnp.asarray(np.random.default_rng(1).uniform(0.01, 30, 50))
    log_x = np.log(np.asarray(x))
    closed = {
        log: (1 / x, -1 / x**2, 2 / x**3),
        half_x_log_x: ((log_x + 1) / 2, 0.5 / x, -0.5 / x**2),
    }[function]
    derivative = function
    for expected in closed:
        forward = jax.jacfwd(derivative)
        np.testing.assert_allclose(jax.vmap(forward)(x), expected, rtol=1e-14)
        np.testing.assert_allclose(jax.vmap(jax.jit(jax.grad(derivative)))(x), expected, rtol=1e-14)
        derivative = forward


def test_derivatives_at_zero_are_finite():
    derivative = half_x_log_x
    for _ in range(3):
        derivative = jax.grad(derivative)
        assert np.isfinite(derivative(jnp.zeros(())))


def test_float32_is_the_plain_one():
    x = jnp.asarray(np.geomspace(1e-30, 1e30, 500), jnp.float32)
    assert log(x).dtype == half_x_log_x(x).dtype == jnp.float32
    np.testing.assert_array_equal(log(x), jnp.log(x))
    assert half_x_log_x(jnp.float32(0)) == 0


def test_compiles_without_a_branch_and_without_the_plain_logarithm():
    """On the CPU the choice is made when the program is lowered."""
    if jax.default_backend() != "cpu":
        pytest.skip("the other platforms take the plain logarithm")
    text = jax.jit(jax.vmap(half_x_log_x)).lower(jnp.ones((3, 5))).compile().as_text()
    assert "conditional(" not in text
    assert " log(" not in text
