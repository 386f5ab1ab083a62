"""The AGARD 445.6 wing's section and modes against the published tables and an independent fit."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmorph.cases import _agard445_modes as modes
from jaxmorph.cases import _agard445_wing as wing
from jaxmorph.cases import agard445_mode

INCH = 0.0254
TIP_TRAILING_EDGE = np.array([[(31.866 + 14.496) * INCH, 30 * INCH, 0.0]])
SHARED = [parent / "shared/cases/agard445-modes" for parent in Path(__file__).resolve().parents]
PUBLISHED = next((folder for folder in SHARED if folder.is_dir()), None)


def test_section_is_the_published_one():
    x = np.linspace(0, 1, 2001)
    z = wing.half_thickness(x)
    assert (
        np.max(np.abs(wing.half_thickness(np.array(wing.STATIONS) / 100) - np.array(wing.HALF_THICKNESS) / 100)) < 1e-15
    )
    assert z.max() == pytest.approx(0.02, abs=2e-5)
    assert 0.40 < x[z.argmax()] < 0.45
    nose = np.array([1e-8])
    assert wing.half_thickness(nose) ** 2 / (2 * nose) == pytest.approx(0.00102, rel=1e-3)
    slope = np.diff(z) / np.diff(x)
    assert np.sum(np.diff(np.sign(slope)) != 0) == 1, "more than one maximum"
    assert slope[1600:] == pytest.approx(np.full(400, -0.0482), abs=3e-3), "the aft fifth is nearly straight"


def test_section_belongs_to_its_family():
    """Half thickness over thickness is nearly linear in thickness: from the 65A008 and 65A006 of NASA's program.

    Ordinates at 20, 30 .. 90 % of the chord, in percent (public domain program naca456, after NASA TM 4741).
    """
    eight = np.array([3.3022, 3.7910, 3.9942, 3.8946, 3.4545, 2.7623, 1.8997, 0.9627]) / 8
    six = np.array([2.4754, 2.8415, 2.9949, 2.9247, 2.6014, 2.0859, 1.4389, 0.7307]) / 6
    four = 4 * (2 * six - eight)
    assert 100 * wing.half_thickness(np.arange(0.2, 0.95, 0.1)) == pytest.approx(four, abs=0.006)


def test_contour_is_even_along_its_arc():
    steps = np.linalg.norm(np.diff(wing.upper_contour(400), axis=0), axis=1)
    assert steps.max() / steps.min() < 1.06  # chords of the round nose are shorter than its arc


@pytest.mark.skipif(PUBLISHED is None, reason="the published table is not here")
@pytest.mark.parametrize("mode", [1, 2])
def test_table_is_the_published_one(mode):
    assert PUBLISHED is not None
    vertices = np.loadtxt(PUBLISHED / "yates_vertices.txt")[:, 1:] * INCH
    assert modes.structural_nodes() == pytest.approx(vertices, abs=1e-4 * INCH)
    normal = np.loadtxt(PUBLISHED / f"yates_mode{mode}.txt")[:, 3]
    assert np.array_equal(np.ravel(modes.DEFLECTIONS[mode]), normal)


@pytest.mark.parametrize(("mode", "root_mean_square", "largest"), [(1, 0.0008, 0.003), (2, 0.005, 0.033)])
def test_modes_fit_the_table(mode, root_mean_square, largest):
    nodes = modes.structural_nodes()
    table = np.ravel(modes.DEFLECTIONS[mode])
    rest = (agard445_mode(nodes, mode)[:, 2] / (30 * INCH) - table / table[-1])[11:]
    assert np.sqrt(np.mean(rest**2)) < root_mean_square
    assert np.abs(rest).max() < largest


@pytest.mark.parametrize("mode", [1, 2])
def test_fit_is_the_least_squares_one(mode):
    """Against the saddle-point system of the constrained fit, in another basis (Legendre polynomials)."""
    nodes = modes.structural_nodes()
    table = np.ravel(modes.DEFLECTIONS[mode])
    eta, xi = modes.planform_coordinates(nodes)
    legendre = np.polynomial.legendre.legvander2d(2 * eta - 1, 2 * xi - 1, [4, 3])
    terms = eta[:, None] ** 2 * legendre
    normal = terms.T @ terms
    system = np.block([[normal, terms[-1:].T], [terms[-1:], np.zeros((1, 1))]])
    solution = np.linalg.solve(system, np.append(terms.T @ (table / table[-1]), 1.0))
    assert agard445_mode(nodes, mode)[:, 2] == pytest.approx(30 * INCH * terms @ solution[:-1], abs=1e-9)


@pytest.mark.parametrize("mode", [1, 2])
def test_root_is_clamped_and_tip_is_one(mode):
    x = np.linspace(0, 21.96 * INCH, 20)
    root = np.column_stack([x, np.zeros(20), np.zeros(20)])
    assert np.all(agard445_mode(root, mode) == 0)
    slope = jax.vmap(jax.jacfwd(lambda p: agard445_mode(p[None], mode)[0]))(jnp.asarray(root))
    assert np.all(np.asarray(slope) == 0)
    moved = agard445_mode(TIP_TRAILING_EDGE, mode, amplitude=0.25)
    assert moved == pytest.approx(np.array([[0, 0, 0.25 * 0.762]]), abs=1e-12)


@pytest.mark.parametrize("mode", [1, 2])
def test_mode_is_one_polynomial_for_numpy_and_jax(mode):
    points = modes.structural_nodes() + np.array([0, 0, 0.01])
    u = agard445_mode(points, mode, 0.1)
    assert isinstance(u, np.ndarray)
    assert u.shape == points.shape
    assert np.all(u[:, :2] == 0)
    traced = jax.jit(agard445_mode, static_argnums=1)(jnp.asarray(points), mode, 0.1)
    assert np.asarray(traced) == pytest.approx(u, abs=1e-13)
    eta, xi = modes.planform_coordinates(points)
    alpha = np.zeros((7, 4))
    alpha[2:] = modes.coefficients(mode)
    assert u[:, 2] == pytest.approx(0.0762 * np.polynomial.polynomial.polyval2d(eta, xi, alpha), abs=1e-12)
    assert agard445_mode(points.astype(np.float32), mode).dtype == np.float32
    assert agard445_mode(jnp.asarray(points, jnp.float32), mode).dtype == jnp.float32
    assert agard445_mode(points.tolist(), mode, 0.1) == pytest.approx(u)
