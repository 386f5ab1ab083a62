"""The bases against their closed forms, with first and second derivatives, at a source too."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmorph as jm

R = 0.8


def thin_plate(r):
    return r**2 * np.log(r), 2 * r * np.log(r) + r, 2 * np.log(r) + 3


def wendland(r):
    x = r / R
    inside = x < 1
    value, slope = (1 - x) ** 4 * (4 * x + 1), -20 * x * (1 - x) ** 3 / R
    return (
        np.where(inside, value, 0),
        np.where(inside, slope, 0),
        np.where(inside, -20 * (1 - x) ** 2 * (1 - 4 * x) / R**2, 0),
    )


def gaussian(r):
    value = np.exp(-(r**2) / R**2)
    return value, -2 * r / R**2 * value, (4 * r**2 / R**4 - 2 / R**2) * value


def multiquadric(r):
    value = np.sqrt(1 + r**2 / R**2)
    return value, r / R**2 / value, 1 / R**2 / value**3


BASES = [
    (jm.ThinPlateSpline(), thin_plate),
    (jm.WendlandC2(R), wendland),
    (jm.Gaussian(R), gaussian),
    (jm.Multiquadric(R), multiquadric),
]
over_bases = pytest.mark.parametrize(("basis", "closed_form"), BASES, ids=lambda value: type(value).__name__)


@over_bases
def test_value_and_derivatives_in_r(basis, closed_form):
    r = np.concatenate([np.geomspace(1e-8, 2, 60), [0.5 * R, 0.999 * R, R * (1 + 1e-9), 50.0]])

    def along(r):
        return basis(r * r)

    value, slope, curvature = closed_form(r)
    np.testing.assert_allclose(along(r), value, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(jax.vmap(jax.grad(along))(r), slope, rtol=1e-10, atol=1e-13)
    np.testing.assert_allclose(jax.vmap(jax.grad(jax.grad(along)))(r), curvature, rtol=1e-8, atol=1e-12)


@over_bases
def test_at_a_source(basis, closed_form):
    """Value and both derivatives in 3-D at distance zero; r^2 log r has no second one there, but may not give NaN."""

    def around(x):
        return basis(jnp.sum(x**2))

    zero = jnp.zeros(3)
    gradient, hessian = jax.grad(around)(zero), jax.hessian(around)(zero)
    np.testing.assert_allclose(gradient, 0, atol=1e-15)
    if closed_form is thin_plate:
        assert float(around(zero)) == 0
        assert np.isfinite(hessian).all()
    else:
        value, _, curvature = closed_form(np.array(0.0))
        np.testing.assert_allclose(around(zero), value, rtol=1e-15)
        np.testing.assert_allclose(hessian, curvature * np.eye(3), rtol=1e-12, atol=1e-12)


@over_bases
def test_dtype_and_shape_follow_the_distances(basis, closed_form):
    r2 = jnp.asarray(np.linspace(0, 2, 12).reshape(3, 4), jnp.float32)
    assert basis(r2).dtype == jnp.float32
    assert basis(r2).shape == (3, 4)
    np.testing.assert_allclose(basis(r2)[1:], closed_form(np.sqrt(np.float64(r2[1:])))[0], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("make", [jm.WendlandC2, jm.Gaussian, jm.Multiquadric])
def test_derivative_in_the_radius(make):
    r2 = np.array([0.0, 1e-6, 0.1, 0.5, 0.9])
    (name,) = vars(make(R))

    def of_radius(radius):
        return eqx.tree_at(lambda basis: getattr(basis, name), make(R), radius)(r2)

    h = 1e-6
    difference = (of_radius(jnp.asarray(R + h)) - of_radius(jnp.asarray(R - h))) / (2 * h)
    np.testing.assert_allclose(jax.jacfwd(of_radius)(jnp.asarray(R)), difference, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("make", [jm.WendlandC2, jm.Gaussian, jm.Multiquadric])
def test_what_a_radius_may_be(make):
    for radius in (0, -1.5, np.nan, np.inf):
        with pytest.raises(ValueError, match="radius` must be a real number above 0 and finite, not"):
            make(radius)
    assert all(leaf.dtype == np.float64 for leaf in jax.tree.leaves([make(2), make(np.int32(2)), make(2.0)]))
    r2 = np.linspace(0, 3, 7)
    assert (make(2)(r2) == make(2.0)(r2)).all()
    slope = jax.jit(jax.grad(lambda radius: make(radius)(r2).sum()))  # traced, it passes unseen
    assert np.isfinite(slope(2.0))
    swept = jax.vmap(make)(np.array([1.0, 2.0]))
    np.testing.assert_allclose(jax.vmap(lambda basis: basis(r2))(swept)[1], make(2.0)(r2), rtol=1e-15)
    assert jax.tree.leaves(jax.eval_shape(make, 2.0))[0].shape == ()


def test_wendland_ends_smoothly():
    r = np.array([R, R * 1.5, 1e3 * R, 1e150])
    basis = jm.WendlandC2(R)
    assert (basis(r**2) == 0).all()
    assert (jax.vmap(jax.grad(lambda r: basis(r * r)))(r) == 0).all()
