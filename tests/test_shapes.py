"""Rigid motions, twisting and bending: closed forms, neutral parameters, derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meshes import write_ring
from oracles import jacobian
from runs import over, refusals, runs
from scipy.spatial.transform import Rotation

import jaxmorph as jm
from jaxmorph import shapes

ABOUT = {2: [0.25, -0.1], 3: [0.25, -0.1, 0.4]}
AXIS = {2: None, 3: [1.0, -2.0, 0.5]}
ALONG = {2: [2.0, 1.0], 3: [2.0, 1.0, 0.0]}

ONE_PARAMETER = {
    "rotate": (lambda x, a: shapes.rotate(x, a, ABOUT[x.shape[1]], AXIS[x.shape[1]]), 0.0, 0.7),
    "translate": (lambda x, a: shapes.translate(x, a * jnp.array(ALONG[x.shape[1]])), 0.0, 0.3),
    "scale": (lambda x, a: shapes.scale(x, a, ABOUT[x.shape[1]]), 1.0, 1.7),
    "bend": (
        lambda x, a: shapes.bend(x, a, ABOUT[x.shape[1]], ALONG[x.shape[1]], 1.3, AXIS[x.shape[1]]),
        0.0,
        0.9,
    ),
    "twist": (lambda x, a: shapes.twist(x, a, ABOUT[3], AXIS[3], 1.3), 0.0, 0.9),
}
ALL = [
    ("twist", 3),
    *((name, d) for name in ("rotate", "scale", "bend", "translate") for d in (2, 3)),
]
CASES, SLOPES = (
    runs(fast, nightly=[case for case in ALL if case not in fast])
    for fast in (
        [("rotate", 2), ("scale", 2), ("bend", 2), ("twist", 3)],
        [("rotate", 3), ("scale", 2)],
    )
)


def cloud(d, count=40):
    return np.random.default_rng(d).normal(size=(count, d))


@pytest.mark.parametrize(("name", "d"), SLOPES)
def test_derivatives_equal_differences(name, d):
    (shape, neutral, value), x = ONE_PARAMETER[name], cloud(d)
    moved = lambda a: shape(x, a)  # noqa: E731
    slopes = jax.jit(
        lambda a: (jax.jacfwd(moved)(a), jax.jacrev(moved)(a), jax.jacfwd(jax.jacrev(moved))(a))
    )
    for at in (neutral, value):
        forward, back, second = slopes(at)
        np.testing.assert_allclose(forward, jacobian(moved, at, 1e-2), atol=1e-9)
        np.testing.assert_allclose(back, forward, atol=1e-13)
        assert np.isfinite(second).all()
    direction = np.cos(np.arange(x.size)).reshape(x.shape)
    along = lambda h: shape(x + h * direction, value)  # noqa: E731
    np.testing.assert_allclose(jax.jacfwd(along)(0.0), jacobian(along, 0.0, 1e-4), atol=1e-8)


@pytest.mark.parametrize(("name", "d"), CASES)
def test_neutral_parameters_batches_and_precision(name, d):
    """A neutral parameter gives the positions bit for bit; `vmap` equals a loop; float32 stays."""
    shape, neutral, value = ONE_PARAMETER[name]
    x, several = cloud(d), value * jnp.array([0.3, 1.0, -2.0])
    np.testing.assert_array_equal(shape(x, neutral), x)
    mapped = jax.jit(jax.vmap(lambda a: shape(x, a)))(several)
    np.testing.assert_allclose(mapped, np.stack([shape(x, a) for a in several]), atol=1e-14)
    assert shape(jnp.asarray(x, jnp.float32), value).dtype == jnp.float32


def test_rotation_is_scipys():
    axis, about, x = np.array(AXIS[3]), np.array(ABOUT[3]), cloud(3)
    turned = Rotation.from_rotvec(0.7 * axis / np.linalg.norm(axis)).apply(x - about) + about
    np.testing.assert_allclose(shapes.rotate(x, 0.7, about, axis), turned, atol=1e-14)
    in_plane = Rotation.from_rotvec([0, 0, 0.7]).apply(np.pad(cloud(2), ((0, 0), (0, 1))))[:, :2]
    np.testing.assert_allclose(shapes.rotate(cloud(2), 0.7, [0.0, 0.0]), in_plane, atol=1e-14)


def test_each_position_may_turn_by_its_own_angle():
    x, angles = cloud(2), np.linspace(-1, 1, 40)
    expected = np.concatenate(
        [shapes.rotate(x[i : i + 1], angle, ABOUT[2]) for i, angle in enumerate(angles)]
    )
    np.testing.assert_allclose(shapes.rotate(x, angles, ABOUT[2]), expected, atol=1e-15)


def test_scaling_by_one_number_and_by_several():
    np.testing.assert_allclose(shapes.scale(cloud(2), 3, [0, 0]), 3 * cloud(2), rtol=1e-15)
    np.testing.assert_allclose(
        shapes.scale(cloud(2), [1, 2], [0, 1]), cloud(2) * [1, 2] - [0, 1], atol=1e-14
    )


def test_twist_turns_sections_in_proportion():
    x = np.array([[1.0, 0, -1], [1, 0, 0], [1, 0, 0.5], [1, 0, 1], [1, 0, 4]])
    turned = shapes.twist(x, np.pi, [0, 0, 0], [0, 0, 2], 1.0)
    np.testing.assert_allclose(
        turned, [[1, 0, -1], [1, 0, 0], [0, 1, 0.5], [-1, 0, 1], [-1, 0, 4]], atol=1e-15
    )


@over("d", [2], nightly=[3])
def test_bending_makes_an_arc_of_the_same_length(d):
    s = np.linspace(-1, 3, 9)
    x = np.zeros((9, d))
    x[:, 0] = s
    bent = shapes.bend(x, np.pi / 2, np.zeros(d), np.eye(d)[0], 2.0, None if d == 2 else [0, 0, 1])
    radius, angle = 4 / np.pi, np.clip(s, 0, 2) * np.pi / 4
    expected = np.zeros((9, d))
    expected[:, 0] = np.where(s < 0, s, radius * np.sin(angle))
    expected[:, 1] = radius * (1 - np.cos(angle)) + np.clip(s - 2, 0, None)
    np.testing.assert_allclose(bent, expected, atol=1e-14)


def test_displacement_is_what_deform_takes(tmp_path):
    mesh = write_ring(tmp_path / "ring.su2")
    plan = jm.prepare(
        mesh.points, mesh.patch("wall"), mesh.patch("far"), method=jm.InverseDistance()
    )

    def turned(x, a):
        return shapes.rotate(x, a, [0.0, 0.0])

    points = jm.deform(plan, shapes.displacement(turned, plan, 0.1))
    wall = mesh.points[:24]
    np.testing.assert_allclose(points[:24], turned(wall, 0.1), atol=1e-14)
    slope = jax.jacfwd(lambda a: jm.deform(plan, shapes.displacement(turned, plan, a)))(0.1)[:24]
    np.testing.assert_allclose(
        slope, np.stack([-points[:24, 1], points[:24, 0]], axis=1), atol=1e-12
    )
    with pytest.raises(ValueError, match=r"\(24, 2\) into \(1, 2\)"):
        shapes.displacement(lambda x, a: x[:1], plan, 0.1)


test_bad_input_is_refused = refusals(
    (lambda: shapes.rotate(cloud(2)[0], 1.0, [0, 0]), "positions have shape"),
    (lambda: shapes.rotate(cloud(2), 1.0, [0, 0, 0]), "`about` has shape"),
    (lambda: shapes.rotate(cloud(2), 1.0, [0, 0], [0, 0, 1]), "leave it out in 2-D"),
    (lambda: shapes.rotate(cloud(3), 1.0, [0, 0, 0]), "`axis` is missing: a rotation in 3-D needs"),
    (lambda: shapes.rotate(cloud(3), 1.0, [0, 0, 0], [0, 0, 0]), "length 0"),
    (lambda: shapes.rotate(cloud(2), [1.0, 2.0], [0, 0]), "one number"),
    (lambda: shapes.rotate(cloud(2), np.nan, [0, 0]), "a real number, not nan"),
    (lambda: shapes.translate(cloud(2), [1.0]), "`by` has shape"),
    (lambda: shapes.scale(cloud(2), [1.0, 1.0, 1.0], [0, 0]), "`factors` has shape"),
    (lambda: shapes.twist(cloud(2), 1.0, [0, 0], [0, 1], 1.0), "`rotate` turns a section in 2-D"),
    (lambda: shapes.twist(cloud(3), 1.0, [0, 0, 0], [0, 0, 1], 0.0), "above 0"),
    (lambda: shapes.bend(cloud(3), 1.0, [0, 0, 0], [0, 0, 1], 1.0, [0, 1, 1]), "right angles"),
)


def test_lists_with_traced_numbers():
    """Design variables may stand in lists, as numbers among others."""
    slope = jax.grad(lambda a: jnp.sum(shapes.translate([[a, 1.0], [2.0, a]], (a, 0.0))))(1.0)
    assert float(slope) == 4
