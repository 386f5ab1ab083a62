"""De Boer's bases: values and derivatives in 40 digits, at a source and at the edge of the support too; definiteness; radii."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from meshes import lattice
from runs import over
from scipy.spatial import KDTree

import jaxmorph as jm

R = 0.8
TABLE = {
    jm.WendlandC0: lambda x: (1 - x) ** 2,
    jm.WendlandC2: lambda x: (1 - x) ** 4 * (4 * x + 1),
    jm.WendlandC4: lambda x: (1 - x) ** 6 * (mpmath.mpf(35) / 3 * x**2 + 6 * x + 1),
    jm.WendlandC6: lambda x: (1 - x) ** 8 * (32 * x**3 + 25 * x**2 + 8 * x + 1),
    jm.CompactC0: lambda x: (1 - x) ** 5,
    jm.CompactC1: lambda x: (
        1
        + mpmath.mpf(80) / 3 * x**2
        - 40 * x**3
        + 15 * x**4
        - mpmath.mpf(8) / 3 * x**5
        + 20 * x**2 * mpmath.log(x)
    ),
    jm.CompactC2a: lambda x: (
        1 - 30 * x**2 - 10 * x**3 + 45 * x**4 - 6 * x**5 - 60 * x**3 * mpmath.log(x)
    ),
    jm.CompactC2b: lambda x: (
        1 - 20 * x**2 + 80 * x**3 - 45 * x**4 - 16 * x**5 + 60 * x**4 * mpmath.log(x)
    ),
}
GLOBAL = {
    jm.Gaussian: lambda x: mpmath.exp(-(x**2)),
    jm.Multiquadric: lambda x: mpmath.sqrt(1 + x**2),
    jm.InverseMultiquadric: lambda x: 1 / mpmath.sqrt(1 + x**2),
    jm.InverseQuadratic: lambda x: 1 / (1 + x**2),
}
SPLINES = {
    jm.LinearSpline: lambda r: r,
    jm.CubicSpline: lambda r: r**3,
    jm.ThinPlateSpline: lambda r: r**2 * mpmath.log(r),
}
ALL = [
    *((kind(R), form, R) for kind, form in (TABLE | GLOBAL).items()),
    *((kind(), form, 1.0) for kind, form in SPLINES.items()),
]
SMOOTH = ("WendlandC2", "WendlandC4", "WendlandC6", *(kind.__name__ for kind in GLOBAL))
"""Bases whose formula has a second derivative at 0, which is that of a source; a cubic's is 0."""
FAST = ("WendlandC2", "CompactC1", "ThinPlateSpline", "Gaussian")
NAMES = [type(row[0]).__name__ for row in ALL]
MARKED = [
    pytest.param(*row, marks=() if name in FAST else pytest.mark.nightly)
    for name, row in zip(NAMES, ALL, strict=True)
]
every = pytest.mark.parametrize(("basis", "form", "radius"), MARKED, ids=NAMES)


@every
def test_values_and_derivatives_in_r(basis, form, radius):
    mpmath.mp.dps = 40
    xi = np.concatenate([np.geomspace(1e-8, 0.9, 12), [0.5, 0.999, 1 - 1e-6]])
    if not isinstance(basis, tuple(TABLE)):
        xi = np.append(xi, [2.5, 60.0])
    at = [mpmath.mpf(float(x)) for x in xi]
    value, slope, curvature = (
        np.array([float(mpmath.diff(form, x, k)) for x in at]) / radius**k for k in range(3)
    )
    r = jnp.asarray(xi * radius)

    def along(r):
        return basis(r**2)

    np.testing.assert_allclose(along(r), value, rtol=1e-10, atol=1e-14)  # they cancel at the edge
    np.testing.assert_allclose(jax.vmap(jax.grad(along))(r), slope, rtol=1e-9, atol=1e-11)
    off = np.abs(jax.vmap(jax.grad(jax.grad(along)))(r) - curvature)
    rounding = np.abs(slope) / np.asarray(r)  # a slope's digits over r
    assert (off < 1e-8 * np.abs(curvature) + 1e-9 + 1e-14 * rounding).all()


@every
def test_at_a_source_and_beyond_the_support(basis, form, radius):
    name, value = type(basis).__name__, basis(jnp.zeros(1))[0]
    np.testing.assert_allclose(value, 0 if isinstance(basis, tuple(SPLINES)) else 1, rtol=3e-15)

    @jax.jit
    def derivatives(x):
        return jax.grad(lambda x: basis(jnp.sum(x**2)))(x), jax.hessian(
            lambda x: basis(jnp.sum(x**2))
        )(x)

    gradient, hessian = derivatives(jnp.zeros(3))
    assert (gradient == 0).all()
    assert np.isfinite(hessian).all()
    if name in SMOOTH:
        curvature = float(mpmath.diff(form, 0, 2)) / radius**2
        np.testing.assert_allclose(hessian, curvature * np.eye(3), rtol=1e-12, atol=1e-12)
    if isinstance(basis, tuple(TABLE)):
        beyond = jnp.array([R**2 * (1 + 1e-12), 50.0, 1e300])
        assert (basis(beyond) == 0).all()
        assert (jax.vmap(jax.grad(basis))(beyond) == 0).all()


@every
def test_definite_on_random_points(basis, form, radius):
    """With the polynomial that a basis asks for, the quadratic form has one sign; a conditional one has it off the polynomial."""
    points = np.random.default_rng(0).uniform(0, 1.5, (40, 3))
    matrix = np.asarray(basis(((points[:, None] - points[None]) ** 2).sum(axis=2)))
    if basis.min_degree is not None:
        terms = np.concatenate([np.ones((40, 1)), points][: 1 + basis.min_degree], axis=1)
        complement = np.linalg.svd(terms, full_matrices=True)[0][:, terms.shape[1] :]
        matrix = complement.T @ matrix @ complement * (-1) ** (basis.min_degree + 1)
    assert np.linalg.eigvalsh(matrix).min() > 1e-9


@every
def test_dtype_and_shape_follow_the_distances(basis, form, radius):
    r2 = np.linspace(0, 2, 12).reshape(3, 4)
    found = basis(jnp.asarray(r2, jnp.float32))
    assert found.dtype == jnp.float32
    assert found.shape == (3, 4)
    np.testing.assert_allclose(
        found, basis(r2), rtol=1e-5, atol=1e-5
    )  # terms of 80 cancel at the edge


@over(
    "make", [jm.WendlandC2], nightly=[kind for kind in TABLE | GLOBAL if kind is not jm.WendlandC2]
)
def test_derivative_in_the_radius(make):
    r2 = np.array([0.0, 1e-6, 0.1, 0.5, 0.9, 4 * R**2])
    difference = (make(R + 1e-6)(r2) - make(R - 1e-6)(r2)) / 2e-6
    np.testing.assert_allclose(
        jax.jacfwd(lambda radius: make(radius)(r2))(R), difference, rtol=1e-6, atol=1e-8
    )


@over("make", [jm.WendlandC2], nightly=[jm.Gaussian, jm.Multiquadric])
def test_what_a_radius_may_be(make):
    assert all(
        leaf.dtype == np.float64
        for leaf in jax.tree.leaves([make(2), make(np.int32(2)), make(2.0)])
    )
    r2 = np.linspace(0, 3, 7)
    assert (make(2)(r2) == make(2.0)(r2)).all()
    slope = jax.jit(jax.grad(lambda radius: make(radius)(r2).sum()))  # traced, it passes unseen
    assert np.isfinite(slope(2.0))
    swept = jax.vmap(make)(np.array([1.0, 2.0]))
    np.testing.assert_allclose(
        jax.vmap(lambda basis: basis(r2))(swept)[1], make(2.0)(r2), rtol=1e-15
    )
    assert jax.tree.leaves(jax.eval_shape(make, 2.0))[0].shape == ()


@pytest.mark.nightly
def test_a_ridge_smooths_noise():
    """On noisy values of a smooth motion the field with a ridge is nearer to the motion than the one that follows them."""
    rng = np.random.default_rng(1)
    points, between = rng.uniform(0, 1, (120, 2)), rng.uniform(0.1, 0.9, (200, 2))
    everything = np.concatenate([points, between])
    motion = np.sin(3 * everything)
    u = motion[:120] + 0.05 * rng.normal(size=(120, 2))
    miss = []
    for ridge in (0.0, 3e-2):
        method = jm.RBF(jm.CubicSpline(), jm.AllPoints(), jm.AllPoints(), ridge=ridge)
        assert method.exact == (ridge == 0)
        moved = jm.deform(jm.prepare(everything, np.arange(120), method=method), u) - everything
        miss.append(np.sqrt(np.mean((moved - motion)[120:] ** 2)))
    assert miss[1] < 0.6 * miss[0]


def test_compact_functions_are_a_sparse_system():
    """Against the dense interpolation with the same function."""
    rng = np.random.default_rng(3)
    points, u = rng.uniform(size=(300, 3)), rng.normal(size=(80, 3))
    dense = jm.prepare(
        points,
        np.arange(60),
        np.arange(60, 80),
        method=jm.RBF.classic(jm.WendlandC2(0.4), degree=None),
    )
    sparse = jm.prepare(points, np.arange(60), np.arange(60, 80), method=jm.CompactRBF(0.4))
    np.testing.assert_allclose(
        jm.deform(sparse, u[:60]), jm.deform(dense, u[:60]), rtol=0, atol=1e-12
    )


def slit(gap):
    """A square's nodes, and a plate in its middle with two nodes a place: the mesh, the plate's two sides, the border."""
    grid = lattice(*[np.linspace(0, 1, 21)] * 2)
    border = np.flatnonzero((np.abs(grid - 0.5) == 0.5).any(axis=1))
    lower = np.flatnonzero((np.abs(grid[:, 1] - 0.5) < 1e-9) & (np.abs(grid[:, 0] - 0.5) < 0.24))
    points = np.concatenate([grid, grid[lower] + [0, gap]])
    return points, lower, len(grid) + np.arange(len(lower)), border


@over("gap", [0.0], nightly=[1e-9])
def test_coincident_nodes_have_one_compact_function(gap):
    """It takes their mean, so the field is that of a plate of single nodes; each node goes where it is sent."""
    points, lower, upper, border = slit(gap)
    for order in (np.r_[lower, upper], np.r_[upper, lower]):
        plan = jm.prepare(points, order, border, method=jm.CompactRBF(0.5))
        single = jm.prepare(points[: upper[0]], lower, border, method=jm.CompactRBF(0.5))
        u = np.zeros((len(points), 2))
        u[lower], u[upper] = [0.02, 0.05], [0.02, 0.05]
        together = np.asarray(jm.deform(plan, u[order]))
        np.testing.assert_allclose(
            together[: upper[0]], jm.deform(single, u[lower]), rtol=0, atol=1e-8
        )
        u[upper, 1] += 0.1
        opened = np.asarray(jm.deform(plan, u[order]))
        inner = np.setdiff1d(np.arange(upper[0]), lower)
        mean = jm.deform(single, (u[lower] + u[upper]) / 2)
        np.testing.assert_allclose(opened[inner], np.asarray(mean)[inner], rtol=0, atol=1e-8)
        np.testing.assert_array_equal(opened[order], points[order] + u[order])


def test_fixed_nodes_do_not_count_where_a_moving_one_is():
    points, lower, upper, border = slit(0.0)
    single = jm.prepare(points[: upper[0]], lower, border, method=jm.CompactRBF(0.5))
    touching = jm.prepare(points, lower, np.r_[border, upper], method=jm.CompactRBF(0.5))
    u = np.random.default_rng(0).normal(size=(len(lower), 2))
    moved = np.asarray(jm.deform(touching, u))
    np.testing.assert_allclose(moved[: upper[0]], jm.deform(single, u), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(moved[upper], points[upper])


@over("method", [jm.RBF.classic()], nightly=[jm.CompactRBF(0.5)], ids=["classic", "compact"])
def test_nodes_that_nearly_coincide_are_told(method):
    """A difference between them comes out large: told at 1e-6, not at 1e-2, where it does not exceed the motion by much."""
    points, lower, upper, border = slit(1e-6)
    told = (
        f"{2 * len(lower)} surface nodes nearly coincide with others, the nearest two 1e-06 apart"
    )
    with pytest.warns(UserWarning, match=told):
        jm.prepare(points, np.r_[lower, upper], border, method=method)
    points, lower, upper, border = slit(1e-2)
    plan = jm.prepare(points, np.r_[lower, upper], border, method=method)
    u = np.zeros((2 * len(lower), 2))
    u[len(lower) :, 1] = 0.1
    assert np.abs(np.asarray(jm.deform(plan, u)) - points).max() < 1


def test_a_radius_that_rounding_does_not_bear_is_refused():
    points = np.random.default_rng(3).uniform(size=(400, 2))
    with pytest.raises(
        ValueError, match=r"the matrix of CompactRBF, of 400 nodes.*Try a smaller radius"
    ):
        jm.prepare(points, np.arange(300), np.arange(300, 400), method=jm.CompactRBF(1e6))


SQUEEZED = {
    "compact": (jm.CompactRBF(0.2), 0.4),
    "local": (jm.LocalCorrection(0.2), 0.4),
    "corrected": (
        jm.SurfaceReconstruction(jm.RBF(reduction=jm.KDTree(2)), jm.CompactRBF(0.2)),
        0.4,
    ),
    "layered": (jm.NearWall(jm.LocalCorrection(0.2)), 0.4),
}


@over("name", ["compact"], nightly=["layered", "local", "corrected"])
def test_a_base_on_which_nodes_come_nearer_is_refused_or_nan(name):
    """What `refit` gives is what `prepare` gives on the new base, or an error; traced, NaN."""
    method, factor = SQUEEZED[name]
    points, lower, upper, border = slit(0.0)
    points = points[: upper[0]]
    u = np.tile([0.0, 0.05], (len(lower), 1))
    plan = jm.prepare(points, lower, border, method=method)
    near = points + 1e-3 * np.sin(9 * points[:, ::-1])
    squeezed = points * [1, factor] + [0, 0.5 * (1 - factor)]
    traced = jax.jit(lambda base: jm.deform(jm.refit(plan, base), u))
    if name != "corrected":  # its sources may be others
        expected = jm.deform(jm.prepare(near, lower, border, method=method), u)
        distance = KDTree(points[np.r_[lower, border]]).query(points, k=2)[0]
        is_clear = (
            np.diff(distance, axis=1)[:, 0] > 5e-3
        )  # of two that are equally near either may be the nearest later
        np.testing.assert_allclose(traced(near)[is_clear], expected[is_clear], rtol=0, atol=1e-6)
    np.testing.assert_allclose(traced(points + 7.0), jm.deform(plan, u) + 7.0, rtol=0, atol=1e-12)
    assert np.isnan(traced(squeezed)).any()
    with pytest.raises(
        ValueError, match="points have lost their place at the new base points, first node"
    ):
        jm.refit(plan, squeezed)


@pytest.mark.nightly
def test_a_base_that_differs_much_but_brings_no_nodes_nearer_is_served():
    """Beyond the slack of the search all pairs are looked at: a stretched mesh has fewer."""
    points, lower, upper, border = slit(0.0)
    points = points[: upper[0]]
    stretched = points * [1.0, 1.5]
    u = np.tile([0.0, 0.05], (len(lower), 1))
    again = jm.refit(jm.prepare(points, lower, border, method=jm.CompactRBF(0.2)), stretched)
    expected = jm.deform(jm.prepare(stretched, lower, border, method=jm.CompactRBF(0.2)), u)
    np.testing.assert_allclose(jm.deform(again, u), expected, rtol=0, atol=1e-12)


@over("dimension count", [(2, 250)], nightly=[(3, 90)])
def test_the_automatic_radius_reaches_200_nodes_from_half_of_the_moving_ones(dimension, count):
    """Each counts itself. A surface of fewer nodes is reached whole."""
    points = np.random.default_rng(4).uniform(size=(count, dimension)) ** 2
    moving, fixed = np.arange(41), np.arange(41, count)
    radius = jm.prepare(points, moving, fixed, method=jm.CompactRBF()).reach
    within = (
        np.linalg.norm(points[moving][:, None] - points[None], axis=2) <= radius * (1 + 1e-12)
    ).sum(axis=1)
    assert (within >= min(200, count)).sum() == 21
    shorter = np.linalg.norm(points[moving][:, None] - points[None], axis=2) <= radius * (1 - 1e-9)
    assert (shorter.sum(axis=1) >= min(200, count)).sum() == 20
