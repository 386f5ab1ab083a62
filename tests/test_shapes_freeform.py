"""Free-form deformation against SciPy's B-splines and Bernstein polynomials."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meshes import lattice
from runs import over, refusals
from scipy.interpolate import BSpline
from scipy.special import comb

from jaxmorph import io, shapes
from jaxmorph.shapes._freeform import SLAB


def cloud(d, count=60):
    return np.random.default_rng(d).uniform(-1, 1, size=(count, d))


def weights(t, count, degree):
    """(m, count) functions at t, by SciPy."""
    if degree == count - 1:
        k = np.arange(count)
        return comb(degree, k) * t[:, None] ** k * (1 - t[:, None]) ** (degree - k)
    knots = np.concatenate(
        [np.zeros(degree), np.linspace(0, 1, count - degree + 1), np.ones(degree)]
    )
    return BSpline.design_matrix(t, knots, degree).toarray()


def expected(x, origin, axes, counts, degrees, control):
    t = np.linalg.solve(axes.T, (x - origin).T).T
    t = np.where(np.abs(t - np.round(t)) < 1e-12, np.round(t), t)  # a place on a face is inside
    inside = ((t >= 0) & (t <= 1)).all(axis=1)
    factors = [weights(t[inside, a], counts[a], degrees[a]) for a in range(len(counts))]
    terms = "mi,mj,ijd->md" if len(counts) == 2 else "mi,mj,mk,ijkd->md"
    moved = x.copy()
    moved[inside] += np.einsum(terms, *factors, control)
    return moved, inside


BOXES = {
    "bernstein-2": ([-0.8, -0.7], np.diag([1.6, 1.5]), (4, 3), None),
    "bspline-2": ([-0.8, -0.7], np.array([[1.6, 0.3], [-0.2, 1.5]]), (7, 5), (3, 2)),
    "bernstein-3": ([-0.8, -0.7, -0.9], np.diag([1.6, 1.5, 1.7]), (4, 3, 2), None),
    "bspline-3": ([-0.8, -0.7, -0.9], np.diag([1.6, 1.5, 1.7]) + 0.1, (6, 5, 4), (3, 2, 1)),
    "mixed-3": ([-0.8, -0.7, -0.9], np.diag([1.6, 1.5, 1.7]), (6, 3, 2), (3, None, None)),
}


@over("name", ["bspline-2", "mixed-3"], nightly=["bernstein-2", "bernstein-3", "bspline-3"])
def test_values_are_scipys(name):
    origin, axes, counts, degree = BOXES[name]
    box = shapes.FreeForm(origin, axes, counts, degree=degree)
    d = len(counts)
    # the lattice has a place on each face, edge and corner
    x = np.concatenate([cloud(d), np.asarray(box.lattice()).reshape(-1, d)])
    control = np.random.default_rng(1).normal(size=(*counts, d))
    moved, inside = expected(x, np.array(origin), axes, counts, box.degrees, control)
    assert 5 < inside.sum() < len(x) - 5
    np.testing.assert_allclose(box(x, control), moved, atol=1e-13)
    np.testing.assert_array_equal(box(x, control)[~inside], x[~inside])
    np.testing.assert_array_equal(box(x, box.neutral()), x)
    np.testing.assert_allclose(box.at(x)(control), moved - x, atol=1e-13)


@over("name", ["bspline-2"], nightly=[name for name in BOXES if name != "bspline-2"])
def test_the_transpose_and_derivatives(name):
    """Of so many points that they are summed in slabs."""
    origin, axes, counts, degree = BOXES[name]
    box, rng = shapes.FreeForm(origin, axes, counts, degree=degree), np.random.default_rng(2)
    x, d = cloud(len(counts), SLAB + 1500), len(counts)
    control, other, cotangent = (
        rng.normal(size=shape) for shape in ((*counts, d), (*counts, d), x.shape)
    )
    operator = box.at(x)
    back = jax.vjp(operator, control)[1](cotangent)[0]
    np.testing.assert_allclose(
        np.vdot(operator(other), cotangent), np.vdot(other, back), rtol=1e-11
    )
    np.testing.assert_allclose(
        jax.grad(lambda c: jnp.vdot(box(x, c), cotangent))(control), back, atol=1e-11
    )
    several = jax.vmap(operator)(jnp.stack([control, other]))
    np.testing.assert_allclose(several[1], operator(other), atol=1e-13)
    squares = jax.jvp(jax.grad(lambda c: jnp.sum(operator(c) ** 2)), (control,), (other,))[1]
    np.testing.assert_allclose(
        squares, 2 * jax.vjp(operator, control)[1](operator(other))[0], atol=1e-10
    )
    h = 1e-6
    slope = jax.jvp(lambda x: box(x, control), (x,), (cotangent,))[1]
    t = np.asarray(box.coordinates(jnp.asarray(x)))
    smooth = (np.abs(t % 1) > 1e-3).all(axis=1) & (
        np.abs(t * (np.array(counts) - box.degrees) % 1) > 1e-3
    ).all(axis=1)
    differences = (box(x + h * cotangent, control) - box(x - h * cotangent, control)) / (2 * h)
    np.testing.assert_allclose(slope[smooth], differences[smooth], atol=1e-6)


@pytest.mark.nightly
def test_a_box_around_points_holds_them_all():
    for d in (2, 3):
        box = shapes.FreeForm.around(cloud(d), (3,) * d, margin=0.0)
        shift = np.ones((*box.counts, d))
        np.testing.assert_allclose(box(cloud(d), shift), cloud(d) + 1, atol=1e-14)
        low, high = np.asarray(box.lattice())[(0,) * d], np.asarray(box.lattice())[(-1,) * d]
        np.testing.assert_allclose(
            [low, high], [cloud(d).min(axis=0), cloud(d).max(axis=0)], atol=1e-14
        )


@pytest.mark.nightly
@pytest.mark.parametrize("k", [0, 1, 2])
def test_continuity_joins_the_border(k):
    """Displacement and k derivatives across the border are zero on it."""
    box = shapes.FreeForm([0.0, 0.0], np.eye(2), (8, 9), degree=(3, 4), continuity=k)
    control = np.random.default_rng(0).normal(size=(8, 9, 2))

    def across(s):
        return box.at(jnp.stack([s, 0.3])[None])(control)[0]

    for order in range(k + 1):
        assert np.abs(across(1e-13)).max() < 1e-10, order
        across = jax.jacfwd(across)
    assert np.abs(across(1e-13)).max() > 0.1


WRONG = ([[(0, 1, 2)]], [[(0, 0.5)]], [[(0, 5)]], [[1, 2, 3]], [["abc"]])
"""Groups of no control points of a lattice."""


def unit(*counts, **options):
    return shapes.FreeForm([0, 0], np.eye(2), counts, **options)


test_bad_input_is_refused = refusals(
    (lambda: unit(4, 4, degree=4), "count - 1"),
    (lambda: unit(4, 4, continuity=1), "no control"),
    (lambda: shapes.FreeForm.around(np.zeros((5, 2)), (2, 2)), "flat"),
    (lambda: shapes.FreeForm.around(np.zeros((0, 2)), (2, 2)), "no rows"),
    (
        lambda: shapes.FreeForm.around([[0, 0], [np.nan, 1]], (2, 2)),
        "1 of 4 numbers of `points` are not finite",
    ),
    (lambda: unit(4, 4).raise_if_outside([[0, 1], [0, 2]]), r"1 of 2 .* row 1 at \(0, 2"),
    (lambda: shapes.fit(unit(2, 2), cloud(2) + 9, cloud(2)), "none of 8 parameters"),
    (lambda: shapes.fit(unit(2, 2), [[0, 0]], [[0, 1]]).raise_if_singular(), "6 of 8"),
    (lambda: unit(4, 4)(cloud(3), np.zeros((4, 4, 2))), "in 2-D"),
    (lambda: unit(4, 4)(cloud(2), np.zeros((4, 4, 3))), "this shape needs"),
    (lambda: shapes.FreeForm([0, 0], [[1, 1], [0, 1]], (3, 3)).linked(mirror=0), "along no axis"),
    (lambda: unit(3, 3).linked(free=np.zeros((3, 3), bool)), "left free"),
    *((lambda groups=groups: unit(3, 3).linked(groups=groups), "groups") for groups in WRONG),
)


@pytest.mark.slow
def test_paraview_reads_the_lattice(tmp_path):
    pyvista = pytest.importorskip("pyvista")
    for d in (2, 3):
        box = shapes.FreeForm([0.0] * d, np.eye(d) * 2 + 0.1, (4, 3, 2)[:d])
        control = 0.1 * np.random.default_rng(0).normal(size=(*box.counts, d))
        io.write_lattice(tmp_path / "box.vts", box.lattice(control))
        grid = pyvista.read(tmp_path / "box.vts")
        assert grid.dimensions == (*box.counts, 1)[:3]
        expected = np.asarray(box.lattice(control)).reshape(*grid.dimensions, d)
        np.testing.assert_array_equal(
            grid.points[:, :d], expected.transpose(2, 1, 0, 3).reshape(-1, d)
        )
    with pytest.raises(ValueError, match=r"should end in \.vts"):
        io.write_lattice(tmp_path / "box.vtk", box.lattice())
    with pytest.raises(ValueError, match="`points` has shape"):
        io.write_lattice(tmp_path / "box.vts", np.zeros((4, 3)))


@pytest.mark.parametrize("degree", [1, 2, None])
def test_faces_and_corners_belong_to_the_box(degree):
    """Coordinates are 0 and 1 to the last bit, where a function beyond the last knot would be NaN."""
    box, x = (
        shapes.FreeForm([0, 0], np.eye(2), (5, 4), degree=degree),
        lattice([0.0, 0.5, 1], [0.0, 0.5, 1]),
    )
    control = np.random.default_rng(0).normal(size=(5, 4, 2))
    moved, slope = jax.jvp(lambda x: box(x, control), (x,), (np.ones_like(x),))
    by_scipy = expected(x, np.zeros(2), np.eye(2), box.counts, box.degrees, control)[0]
    np.testing.assert_allclose(moved, by_scipy, atol=1e-14)
    np.testing.assert_array_equal(moved[-1], [1, 1] + control[-1, -1])
    assert np.isfinite(slope).all()
