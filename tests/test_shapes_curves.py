"""Shapes along one coordinate, combinations of shapes, and fits: formulas and SciPy's splines as oracles."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meshes import naca
from oracles import jacobian
from runs import over, refusals
from scipy.interpolate import BSpline, CubicSpline
from scipy.spatial.transform import Rotation

from jaxmorph import shapes

AIRFOIL = naca(0.02, 0.4, 0.12)
LINEAR = {
    "hicks-henne": shapes.HicksHenne([0.2, 0.5, 0.8]),
    "cst": shapes.CST(4),
    "curve": shapes.BSplineCurve(AIRFOIL, 6),
    "modes": shapes.Modes(np.random.default_rng(0).normal(size=(3, *AIRFOIL.shape))),
    "part": shapes.Part(shapes.HicksHenne([0.3]), AIRFOIL[:, 1] > 0),
    "together": shapes.Together(shapes.HicksHenne([0.3]), shapes.CST(2)),
    "linked": shapes.Linked(shapes.CST(2), np.ones((4, 1))),
    "box": shapes.FreeForm([-0.1, -0.2], np.diag([1.2, 0.4]), (3, 3)).linked(mirror=0),
}

BREADTH = ("hicks-henne", "curve", "box")


def random_like(parameters, seed=1):
    rng = np.random.default_rng(seed)
    return jax.tree.map(lambda leaf: jnp.asarray(rng.normal(size=leaf.shape)), parameters)


@over("name", [name for name in LINEAR if name not in BREADTH], nightly=BREADTH)
def test_linear_shapes_and_their_transposes(name):
    shape = LINEAR[name]
    np.testing.assert_array_equal(shape(AIRFOIL, shape.neutral()), AIRFOIL)
    a, b = random_like(shape.neutral()), random_like(shape.neutral(), 2)
    operator, cotangent = shape.at(AIRFOIL), np.cos(np.arange(AIRFOIL.size)).reshape(AIRFOIL.shape)
    total = operator(jax.tree.map(lambda p, q: 2 * p - q, a, b))
    np.testing.assert_allclose(total, 2 * operator(a) - operator(b), atol=1e-13)
    assert np.abs(total).max() > 1e-3
    back = jax.grad(lambda p: jnp.vdot(shape(AIRFOIL, p), cotangent))(a)
    products = jax.tree.leaves(jax.tree.map(np.vdot, back, b))
    np.testing.assert_allclose(sum(products), np.vdot(operator(b), cotangent), rtol=1e-11)


def test_a_bump_is_hicks_and_hennes():
    x = np.column_stack([np.linspace(-0.2, 1.2, 29), np.zeros(29)])
    t = np.clip(x[:, 0], 1e-300, 1)
    bump = np.where(
        (x[:, 0] > 0) & (x[:, 0] < 1), np.sin(np.pi * t ** (np.log(0.5) / np.log(0.3))) ** 2, 0
    )
    moved = shapes.HicksHenne([0.3], 2.0)(x, [0.07])
    np.testing.assert_allclose(moved, x + np.column_stack([0 * t, 0.07 * bump]), atol=1e-15)
    chord = shapes.Chord([1, 1], [1, 3])  # twice as long, upwards: up is to the left
    turned = np.column_stack([1 - 0 * t, 1 + 2 * x[:, 0]])
    moved = shapes.HicksHenne([0.3], 2.0, chord=chord)(turned, [0.07])
    np.testing.assert_allclose(moved - turned, np.column_stack([-0.07 * bump, 0 * t]), atol=1e-15)


def test_the_curve_is_scipys_spline():
    lengths = np.append(0, np.cumsum(np.linalg.norm(np.diff(AIRFOIL, axis=0), axis=1)))
    control = np.random.default_rng(0).normal(size=(6, 2))
    spline = BSpline(np.array([0, 0, 0, 0, 1 / 3, 2 / 3, 1, 1, 1, 1]), control, 3)
    np.testing.assert_allclose(
        LINEAR["curve"].at(AIRFOIL)(control), spline(lengths / lengths[-1]), atol=1e-13
    )


@pytest.mark.nightly
@pytest.mark.parametrize("given", [(0.02, 0.4, 0.12), (0.0, 0.4, 0.12)])
def test_one_naca_airfoil_becomes_another(given):
    shape, x = shapes.NACA4(*given), naca(*given)
    np.testing.assert_array_equal(shape(x, shape.neutral()), x)
    for other in ((0.04, 0.4, 0.15), (0.03, 0.6, 0.09)):
        np.testing.assert_allclose(shape(x, other), naca(*other), atol=2e-13)
    p, away = (
        np.array([0.04, 0.4, 0.15]),
        np.abs(x[:, 0] - 0.4) > 1e-3,
    )  # where the second derivative jumps
    expected = jacobian(lambda p: naca(*p), p, 1e-4)
    np.testing.assert_allclose(
        jax.jacfwd(lambda p: shape(x, p))(p)[away], expected[away], atol=1e-8
    )


def test_fits_find_the_parameters_of_linear_and_other_shapes():
    box = shapes.FreeForm.around(AIRFOIL, (3, 3))
    truth = 0.1 * random_like(box.neutral())
    result = shapes.fit(box, AIRFOIL, box(AIRFOIL, truth))
    np.testing.assert_allclose(result.parameters, truth, atol=1e-9)
    assert (int(result.rank), result.count) == (18, 18)
    alike = shapes.Linked(shapes.CST(2), np.ones((4, 2)))  # two parameters that do the same
    result = shapes.fit(alike, AIRFOIL, alike(AIRFOIL, [0.1, 0.2]))
    assert (int(result.rank), result.count) == (1, 2)
    np.testing.assert_allclose(result.parameters, [0.15, 0.15], atol=1e-12)
    turned = shapes.rotate(AIRFOIL, 0.4, [0.25, 0.0])
    result = shapes.fit(
        lambda x, a: shapes.rotate(x, a, [0.25, 0.0]), AIRFOIL, turned, jnp.array(0.0)
    )
    np.testing.assert_allclose(result.parameters, 0.4, atol=1e-9)
    assert float(result.max_residual) < 1e-9


def test_frozen_linked_and_mirrored_control_points():
    box = shapes.FreeForm([-1.0, 0.0], np.diag([2.0, 1.0]), (5, 3))
    free = np.ones((5, 3), bool)
    free[:, 0] = False
    linked = box.linked(free=free, groups=[[(0, 1), (0, 2)]], mirror=0)
    control = np.asarray(linked.matrix @ random_like(linked.neutral())).reshape(5, 3, 2)
    assert (control[:, 0] == 0).all()
    np.testing.assert_array_equal(control[0, 1], control[0, 2])
    np.testing.assert_array_equal(control[::-1] * [-1, 1], control)
    # one control of the left column for both, (1, 1) and (1, 2) free, and (2, 1) and (2, 2) on the plane across alone
    assert linked.matrix.shape == (30, 2 + 4 + 2)
    x = np.random.default_rng(0).uniform([0, 0], [1, 1], (20, 2))
    moved, image = (
        linked(x, random_like(linked.neutral())),
        linked(x * [-1, 1], random_like(linked.neutral())),
    )
    np.testing.assert_allclose(np.asarray(image) * [-1, 1], moved, atol=1e-14)


def test_a_wall_that_would_tear_is_told():
    box = shapes.FreeForm([0.2, -1.0], np.diag([0.5, 2.0]), (3, 3))
    control = np.full((3, 3, 2), [0.0, 0.1])
    with pytest.raises(ValueError, match=r"[1-9]\d* of 121 nodes stay outside"):
        box.raise_if_torn(AIRFOIL, control)
    control[[0, -1]] = 0
    box.raise_if_torn(AIRFOIL, control)


PLANFORM = shapes.ReferenceAxis([[0.25, 0, 0], [0.45, 1, 0.1], [0.75, 2, 0.2]])


def wing():
    rng = np.random.default_rng(0)
    return rng.uniform([0, -0.1, -0.1], [1, 2.1, 0.2], (50, 3))


@over("cubic", [False], nightly=[True])
def test_stations_are_interpolated(cubic):
    shape = shapes.ReferenceAxis(PLANFORM.points, cubic=cubic)
    x, values = wing(), np.array([0.3, -0.2, 0.5])
    y = np.clip(x[:, 1], 0, 2)
    expected = (
        CubicSpline([0, 1, 2], values, bc_type="natural")(y)
        if cubic
        else np.interp(y, [0, 1, 2], values)
    )
    np.testing.assert_allclose(shape.weights(jnp.asarray(x)) @ values, expected, atol=1e-14)
    np.testing.assert_allclose(
        shape(x, {"dihedral": values}) - x, expected[:, None] * [[0, 0, 1]], atol=1e-14
    )
    np.testing.assert_array_equal(shape(x, shape.neutral()), x)


def test_a_planform_twists_and_scales_sections_about_its_axis():
    x, y = wing(), None
    y = np.clip(x[:, 1], 0, 2)
    centre = np.stack(
        [np.interp(y, [0, 1, 2], np.asarray(PLANFORM.points)[:, k]) for k in range(3)], axis=1
    )
    centre[:, 1] = x[:, 1]
    twist, chord = (
        np.interp(y, [0, 1, 2], [0.0, 0.1, 0.4]),
        np.interp(y, [0, 1, 2], [1.0, 0.8, 0.5]),
    )
    turns = Rotation.from_rotvec(twist[:, None] * [[0, 1, 0]])
    expected = centre + turns.apply(chord[:, None] * (x - centre))
    expected += np.interp(y, [0, 1, 2], [0, 0.1, 0.3])[:, None] * [1, 0, 0]
    moved = PLANFORM(
        x, {"twist": [0.0, 0.1, 0.4], "chord": [1.0, 0.8, 0.5], "sweep": [0.0, 0.1, 0.3]}
    )
    np.testing.assert_allclose(moved, expected, atol=1e-14)
    slope = jax.jacrev(lambda t: PLANFORM(x, {"twist": t}))(jnp.zeros(3))
    arm = x - centre
    ahead = np.asarray(PLANFORM.weights(jnp.asarray(x)))
    np.testing.assert_allclose(slope[:, 0], arm[:, 2:] * ahead, atol=1e-14)
    np.testing.assert_allclose(slope[:, 2], -arm[:, :1] * ahead, atol=1e-14)


test_bad_input_is_refused = refusals(
    (lambda: shapes.HicksHenne([0.5])(AIRFOIL, [0.1, 0.2]), "parameters have shape"),
    (lambda: shapes.HicksHenne([0.5])(wing(), [0.1]), "a chord in 2-D"),
    (lambda: shapes.Chord([0, 0, 0], [1, 0, 0]), "`up` is missing"),
    (
        lambda: shapes.BSplineCurve(AIRFOIL[[0, 1, 1, 2]], 4),
        "1 nodes stand on the one before, first 2",
    ),
    (lambda: shapes.BSplineCurve(AIRFOIL, 3), "degree is 1 to count - 1"),
    (lambda: LINEAR["curve"].at(AIRFOIL[:5]), "is for positions"),
    (lambda: shapes.Modes(AIRFOIL), "expected"),
    (lambda: LINEAR["modes"].at(AIRFOIL[:5]), "is for positions"),
    (lambda: shapes.Part(shapes.CST(2), [0, 1]), "True and False"),
    (lambda: LINEAR["part"].at(AIRFOIL[:5]), "121 rows for 5"),
    (lambda: shapes.Linked(shapes.CST(2), np.ones((3, 1))), "needs"),
    (lambda: LINEAR["together"](AIRFOIL, (1,)), "1 sets of parameters for 2"),
    (lambda: shapes.NACA4(0.0, 0.4, 0.1)(AIRFOIL, [0.1]), "expected camber, place, thickness"),
    (lambda: shapes.fit(shapes.CST(2), AIRFOIL, AIRFOIL[:3]), "row to row"),
    (lambda: shapes.fit(lambda x, a: x, AIRFOIL, AIRFOIL), "a plain function has no neutral"),
    (lambda: shapes.ReferenceAxis([[0, 0, 0], [0, 2, 0], [0, 1, 0], [0, 3, 0]]), "station 2"),
    (lambda: PLANFORM(wing(), {"twist": [0.0, 1.0]}), "expected"),
    (lambda: PLANFORM(wing(), {"taper": [0.0, 1.0, 1.0]}), "for any of twist, chord"),
)
