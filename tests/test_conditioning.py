"""What a plan does with interpolations that rounding spoils, and with those that only look so."""

import dataclasses
import re
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import body, full, motion, moved_by, planned, surface_values
from meshes import grid
from oracles import dense, wendland
from runs import over, runs

import jaxmorph as jm
from jaxmorph import cases

WIDE = runs(
    [(jm.Multiquadric(100.0), 0, 2)],
    nightly=[
        (jm.Gaussian(10.0), 1, 2),
        (jm.Gaussian(100.0), None, 3),
        (jm.Multiquadric(10.0), 0, 3),
    ],
)


@pytest.mark.parametrize(("basis", "degree", "dimension"), WIDE)
def test_bases_too_wide_for_their_sources_are_refused(basis, degree, dimension):
    """LAPACK factors these without complaint, pivots of 1e-15 and all; what comes out misses the values it was given."""
    mesh = body(dimension)
    text = rf"{len(mesh.boundary)} sources is ill-conditioned: rounding changes .* the nearest two sources, \(.*\) and \(.*, are"
    with pytest.raises(ValueError, match=text):
        planned(mesh, full(basis, degree))
    method, ids = full(basis, degree), jnp.arange(len(mesh.boundary))
    sources, values = mesh.points[mesh.boundary], surface_values(mesh)[1]
    field = method.field(
        ids,
        method.fit(ids, jnp.asarray(sources), jnp.asarray(sources)),
        sources,
        jnp.asarray(values),
    )
    assert np.abs(field.evaluate(sources, None) - values).max() > 1e-3 * np.abs(values).max()


def test_between_good_and_useless_is_a_warning():
    """Wendland's function of 2000 lengths of the body: the values at the sources are still right to about 1e-6."""
    mesh = body(3)
    u, values = surface_values(mesh)
    told = r"rounding changes the displacements by \de-0[56] of their size.*a smaller `support_radius` of the basis"
    with pytest.warns(UserWarning, match=told):
        planned(mesh, full(jm.WendlandC2(2000.0), None))
    moved = moved_by(mesh, full(jm.WendlandC2(200.0), None), u)
    expected = dense(
        mesh.points, mesh.points[mesh.boundary], values, lambda r: wendland(r, 200.0), None
    )
    np.testing.assert_allclose(moved - mesh.points, expected, rtol=0, atol=1e-7)


@pytest.mark.nightly
def test_a_large_condition_number_alone_is_no_fault():
    """The sources of a C-grid lie 1e-3 to 15 chords apart: reciprocal condition 1e-11 and less, interpolated values right."""
    mesh = cases.naca0015(points=2000)
    moving, fixed = mesh.patch("airfoil"), mesh.patch("farfield")
    plan = jm.prepare(
        mesh.points, moving, fixed, method=full(jm.ThinPlateSpline(), 1)
    )  # any warning is an error here
    sources = plan.points[plan.surface.nodes]
    matrix = dense_matrix(np.asarray(sources) / 15)
    assert np.linalg.cond(matrix, 1) > 1e9
    values = np.zeros(sources.shape)
    values[: len(moving)] = motion(np.asarray(sources[: len(moving)]))
    surface, values = plan.surface, plan.images.vectors(jnp.asarray(values))
    field = plan.method.field(surface.ids, surface.factors, surface.points, values)
    np.testing.assert_allclose(field.evaluate(surface.points, None), values, rtol=0, atol=1e-9)


def dense_matrix(sources):
    """Thin plate spline with a linear polynomial (eq. 3)."""
    tail = np.concatenate([np.ones((len(sources), 1)), sources], axis=1)
    r = np.linalg.norm(sources[:, None] - sources[None], axis=2)
    kernel = r**2 * np.log(np.where(r > 0, r, 1))
    return np.block([[kernel, tail], [tail.T, np.zeros((tail.shape[1],) * 2)]])


@over(
    "solver more",
    slow=[(None, "")],
    nightly=[(jm.Iterative(neighbours=12, dense=12), ", or a larger `tolerance`")],
)
def test_what_is_told_of_two_nodes_that_nearly_coincide_helps(solver, more):
    """A fixed node 1e-9 beside a moving one, which no field follows: each hint is one that the method can follow."""
    mesh = body(2)
    points = np.concatenate([mesh.points, mesh.points[mesh.moving[:1]] + 1e-9])
    fixed, u = np.append(mesh.fixed, len(mesh.points)), motion(mesh.points[mesh.moving])
    classic = dataclasses.replace(jm.RBF.classic(), solver=solver)

    def prepared(method):
        return jm.prepare(points, mesh.moving, fixed, method=method)

    told = rf"apart\. Try a `ridge` of RBF such as 1e-6, .*fewer sources by .* such as jm.KDTree\(64\){more}"
    with pytest.raises(ValueError, match=told):
        prepared(classic)
    smooth = prepared(dataclasses.replace(classic, ridge=1e-6))
    few = prepared(
        dataclasses.replace(classic, reduction=jm.KDTree(64), fixed_reduction=jm.KDTree(64))
    )
    for plan in (smooth, few):
        assert np.abs(jm.deform(plan, u) - points).max() < 2 * np.abs(u).max()
    close = jm.KDTree(64, separation=0.0)
    told = r"Try a smaller `radius` of .*, a larger `separation` in .* another `degree`"
    with pytest.raises(ValueError, match=told):
        prepared(jm.RBF(jm.Multiquadric(1.0), close, close, solver=solver))


BASES = [jm.Gaussian(0.3), jm.WendlandC2(1.0), jm.ThinPlateSpline()]


@over(
    "basis list_of_twin", [(BASES[0], "fixed"), (BASES[0], "moving")],
    nightly=[(basis, name) for basis in BASES[1:] for name in ("fixed", "moving")],
)  # fmt: skip
def test_two_nodes_that_nearly_coincide_are_told_with_every_basis(basis, list_of_twin):
    """1e-9 apart: what one of them does otherwise than the other is blown up by a million, or worse."""
    mesh = body(2)
    points = np.concatenate([mesh.points, mesh.points[mesh.moving[:1]] + 1e-9])
    lists = {"moving": mesh.moving, "fixed": mesh.fixed}
    lists[list_of_twin] = np.append(lists[list_of_twin], len(mesh.points))
    told = "sources is ill-conditioned: rounding changes .* the nearest two sources"
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            jm.prepare(points, **lists, method=full(basis, 1))
        except ValueError as error:
            said = str(error)
        else:  # both move: the error may be small enough for a warning
            assert list_of_twin == "moving"
            said = " ".join(str(each.message) for each in caught)
    assert re.search(told, said)


@over("degree", [0], nightly=[None])
def test_one_source(degree):
    """Its value spreads as the basis does; with a constant, everything moves alike."""
    points = np.array([[3.0, 1.0], [3.5, 1.0], [3.0, 2.0]])
    plan = jm.prepare(points, [0], method=full(jm.Gaussian(0.7), degree))
    spread = np.exp(-np.array([0, 0.25, 1]) / 0.49) if degree is None else np.ones(3)
    np.testing.assert_allclose(
        jm.deform(plan, [[0.2, -0.1]]) - points, spread[:, None] * [0.2, -0.1], atol=1e-15
    )
    assert np.isfinite(
        jax.grad(lambda x: jm.deform(jm.refit(plan, x), [[0.2, -0.1]]).sum())(points)
    ).all()


def test_a_singular_system():
    """One source of a thin plate spline, which is zero there, and no polynomial."""
    with pytest.warns(UserWarning, match="ThinPlateSpline without a polynomial"):
        method = full(jm.ThinPlateSpline(), None)
    with pytest.raises(
        ValueError, match=r"the interpolation matrix of 1 sources is singular\. Try"
    ):
        jm.prepare(np.eye(2), [0], method=method)


def test_fixed_sources_keep_away_from_moving_ones():
    """A wall that goes on as a fixed one, and a node of each 9e-4 from the other: the moving one alone is a source."""
    moving = np.stack([np.linspace(0, 1, 9), np.zeros(9)], axis=1)
    fixed = np.concatenate(
        [np.stack([np.linspace(1 + 9e-4, 3, 9), np.zeros(9)], axis=1), [[0, 2.0], [3, 2]]]
    )
    points = np.concatenate([moving, fixed])

    def sources(reduction, fixed_reduction):
        method = jm.RBF(reduction=reduction, fixed_reduction=fixed_reduction)
        return np.asarray(jm.prepare(points, np.arange(9), np.arange(9, 20), method=method).sources)

    near = sources(jm.KDTree(2), jm.KDTree(2))
    assert 8 in near
    assert 9 not in near
    assert 9 in sources(
        jm.KDTree(2), jm.KDTree(2, separation=1e-6)
    )  # the smaller one of both counts
    assert 9 in sources(jm.AllPoints(), jm.KDTree(2))
    assert len(sources(jm.AllPoints(), jm.AllPoints())) == 20


@pytest.mark.parametrize("least", [1e-6, 1e-12])
def test_cells_too_flat_for_a_method_on_cells_are_told(least):
    """One step of refinement measures what rounding changes; a stiff but sound system is not told of."""
    heights = np.append(0, np.geomspace(least, 1, 9))
    sides = {
        "wall": lambda ids: ids[:, 0],
        "far": lambda ids: np.concatenate([ids[:, -1], ids[0, 1:-1], ids[-1, 1:-1]]),
    }
    mesh = grid(np.linspace(0, 1, 7), heights, patches=sides)
    for method in (jm.Biharmonic(), jm.TorsionalSprings()):
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            jm.prepare(mesh, "wall", "far", method=method)
        words = [str(each.message) for each in told]
        is_told = any("unknowns of Biharmonic are ill-conditioned" in text for text in words)
        assert is_told == (least < 1e-9 and isinstance(method, jm.Biharmonic)), words
