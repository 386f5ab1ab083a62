"""Smooth twins of the measures of quality: near the exact ones by the bounds stated, differentiable where those have kinks."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meshes import pair, shaken
from runs import over, runs

import jaxmorph as jm

KINDS = runs(["quad"], nightly=["triangle", "tetra", "pyramid", "wedge", "hexahedron"])
"""Those in 3-D take seconds to compile."""
MEASURES = ("skewness", "aspect_ratio", "non_orthogonality", "jacobian_ratio")
TERMS = 36
"""The most terms of which any measure takes the largest."""


@pytest.mark.parametrize("kind", KINDS)
def test_they_are_near_the_exact_ones_by_the_bounds_stated(kind):
    mesh, sharpness = pair(kind), 400.0
    points = shaken(mesh, 0.08)
    exact, smooth = jm.quality(mesh, points), jm.smooth_quality(mesh, points, sharpness=sharpness)
    terms, slack = np.log(TERMS), 1e-9
    below = exact.skewness - smooth.skewness
    assert np.all((below >= -slack) & (below <= terms / sharpness))
    factor = exact.aspect_ratio / smooth.aspect_ratio
    assert np.all((factor >= 1 - slack) & (factor <= TERMS ** (2 / sharpness)))
    below = exact.non_orthogonality - smooth.non_orthogonality
    assert np.all((below >= -slack) & (below <= 90 * (1 + terms) / sharpness))
    assert np.all(exact.non_orthogonality > 1)
    above = smooth.jacobian_ratio - exact.jacobian_ratio
    assert np.all((above >= -slack) & (above <= terms / sharpness))


@over("kind size", [("triangle", 0.1)], slow=[("triangle", 0.0)], nightly=[("quad", 0.0)])
def test_derivatives_are_those_of_differences(kind, size):
    """At the ideal cell, where the exact measures have their kinks, too. Solid cells: `test_quality_derivatives.py`."""
    mesh = pair(kind)
    points = jnp.asarray(shaken(mesh, size, 1))
    weights = np.random.default_rng(2).normal(size=(4, 2))
    tangent, step = np.random.default_rng(3).normal(size=points.shape), 1e-5

    @jax.jit
    def objective(points):
        found = jm.smooth_quality(mesh, points)
        return sum(
            jnp.vdot(w, getattr(found, name)) for w, name in zip(weights, MEASURES, strict=True)
        )

    difference = (objective(points + step * tangent) - objective(points - step * tangent)) / (
        2 * step
    )
    np.testing.assert_allclose(
        np.vdot(jax.grad(objective)(points), tangent), difference, rtol=1e-5, atol=1e-6
    )


@over("kind", ["triangle"], nightly=["quad", "tetra"])
def test_inverted_and_flat_cells_are_bad_by_a_finite_number_that_falls_as_they_turn_round(kind):
    mesh = pair(kind)
    axis = mesh.points.shape[1] - 1
    apex = np.flatnonzero(mesh.points[:, axis] > 0.1)

    @jax.jit
    @jax.value_and_grad
    def aspect(height):
        points = jnp.asarray(mesh.points).at[apex, axis].set(height * mesh.points[apex, axis])
        return jm.smooth_quality(mesh, points, softness=1e-3).aspect_ratio[0]

    heights = [1.0, 0.1, 0.0, -0.1, -0.5]
    values, slopes = np.array([aspect(height) for height in heights]).T
    assert np.all(np.isfinite(values))
    assert np.all(np.diff(values) > 0)
    np.testing.assert_allclose(values[2], 2 / 1e-3, rtol=1e-6)
    assert np.all(slopes[1:] < 0)
