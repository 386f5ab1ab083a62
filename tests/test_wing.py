"""The paper's wing: bending, torsion, a flap and a sharp wave, against the full interpolation and pure graph mapping."""

import functools
from typing import NamedTuple

import numpy as np
import pytest
import pyvista as pv

import jaxmorph as jm
from benchmarks import agard445

INCH = 0.0254
SPAN = 30 * INCH
FINE, COARSE = 64_943, 6_500
PLANE = jm.Plane((0, 1, 0), (0, 0, 0))
EVERY = jm.RBF.classic()
REDUCED = jm.SurfaceReconstruction(jm.RBF(fixed_reduction=jm.AllPoints()), jm.DelaunayGraph())
"""The paper's: 64 leaves on the wing, the whole far field."""

FULL_SIZE = pytest.param(FINE, marks=pytest.mark.full)
both_sizes = pytest.mark.parametrize("points", [COARSE, FULL_SIZE])


class Quality(NamedTuple):
    """By determinants and VTK, not by the package."""

    aspect_ratio: np.ndarray
    volume_ratio: np.ndarray

    @property
    def inverted(self):
        return int(np.sum(~(self.volume_ratio > 0)))


class Wing:
    """A mesh, and plans made once."""

    def __init__(self, points, cache):
        self.mesh = agard445.mesh(points, cache)
        self.moving, self.fixed = self.mesh.patch("wing"), self.mesh.patch("farfield")
        self.base = self.mesh.points[self.moving]
        self.volume = self._volume(self.mesh.points)
        self.plan = functools.cache(self._plan)

    def _plan(self, method, symmetric=False):
        symmetry = PLANE if symmetric else ()
        return jm.prepare(
            self.mesh.points, self.moving, self.fixed, method=method, symmetry=symmetry
        )

    def _volume(self, points):
        a, b, c, d = points[self.mesh.cells["tetra"]].swapaxes(0, 1)
        return np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6

    def judge(self, points):
        points = np.asarray(points)
        grid = pv.UnstructuredGrid({pv.CellType.TETRA: self.mesh.cells["tetra"]}, points)
        aspect_ratio = grid.cell_quality("aspect_ratio")["aspect_ratio"]
        return Quality(aspect_ratio, self._volume(points) / self.volume)

    def moved(self, u, method=None, symmetric=False):
        """Quality after one step; surface, far field and symmetry plane are checked on the way."""
        points = np.asarray(jm.deform(self.plan(method, symmetric), u))
        np.testing.assert_allclose(points[self.moving], self.base + u, atol=1e-12, rtol=0)
        np.testing.assert_array_equal(points[self.fixed], self.mesh.points[self.fixed])
        assert not points[self.mesh.patch("symmetry"), 1].any()
        return self.judge(points)


@functools.cache
def wing_of(points, cache):
    return Wing(points, cache)


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


@pytest.fixture
def wing(points, cache):
    return wing_of(points, cache)


def planform(base):
    """Span and chord coordinates from 0 to 1, leading edge and chord."""
    eta = base[:, 1] / SPAN
    leading, chord = 31.866 * INCH * eta, INCH * (21.96 + (14.496 - 21.96) * eta)
    return eta, (base[:, 0] - leading) / chord, leading, chord


def turned(base, x_axis, angle):
    """Displacement by a turn about an axis along the span at (x_axis, 0), nose up, by an angle for each point."""
    z = (base[:, 0] - x_axis + 1j * base[:, 2]) * (np.exp(-1j * angle) - 1)
    return np.column_stack([z.real, np.zeros(len(base)), z.imag])


def twist(base):
    """5 degrees at the tip, about the quarter chord."""
    eta, _, leading, chord = planform(base)
    return turned(base, leading + chord / 4, np.deg2rad(5) * eta)


def flap(base):
    """20 degrees over the aft 25 % of the chord from 0.4 to 0.8 of the span, gradually over 0.1 at both ends."""
    eta, xi, leading, chord = planform(base)
    rise = np.clip(np.minimum(eta - 0.4, 0.8 - eta) / 0.1, 0, 1)
    angle = np.deg2rad(20) * rise**2 * (3 - 2 * rise)
    return turned(base, leading + 0.75 * chord, np.where(xi > 0.75, angle, 0))


def wave(base):
    """eta^2 sin(4 pi eta), 0.05 semi-spans at most."""
    eta, *_ = planform(base)
    return 0.05 * SPAN * (eta**2 * np.sin(4 * np.pi * eta))[:, None] * [0, 0, 1]


def mode(number, amplitude):
    return lambda base: agard445.mode(base, number, amplitude)


OTHERS = {
    "mode 2, 0.2": mode(2, 0.2),
    "mode 2, 0.3": mode(2, 0.3),
    "wave": wave,
    "flap": flap,
    "twist": twist,
}


def test_the_turn_is_nose_up():
    nose, tail = turned(np.array([[0.0, 1, 0], [1, 1, 0]]), 0.25, np.deg2rad(30))
    np.testing.assert_allclose(nose, [0.25 - 0.25 * np.cos(np.pi / 6), 0, 0.125], atol=1e-15)
    np.testing.assert_allclose(tail, [0.75 * np.cos(np.pi / 6) - 0.75, 0, -0.375], atol=1e-15)


@pytest.mark.nightly
@both_sizes
@pytest.mark.parametrize(
    "symmetric", [pytest.param(False, marks=pytest.mark.nightly), True], ids=["free", "plane"]
)
@pytest.mark.parametrize(
    "method", [pytest.param(REDUCED, marks=pytest.mark.nightly), None], ids=["paper's", "default"]
)
def test_bending(wing, method, symmetric):
    start = wing.judge(wing.mesh.points)
    for amplitude in (0.25, 0.5, 0.75):
        end = wing.moved(agard445.mode(wing.base, 1, amplitude), method, symmetric)
        assert end.inverted == 0
        assert (
            start.aspect_ratio.mean()
            < end.aspect_ratio.mean()
            < start.aspect_ratio.mean() + 0.36 * amplitude**2
        )


@pytest.mark.slow
@both_sizes
@pytest.mark.parametrize("name", OTHERS)
def test_other_motions(wing, name):
    for method in (REDUCED, None):
        assert wing.moved(OTHERS[name](wing.base), method).inverted == 0


@pytest.mark.slow
@both_sizes
def test_one_step_of_the_field_and_three_of_the_graph(wing):
    """As the paper does it (section 3.2), with a new graph before each step."""
    u = agard445.mode(wing.base, 1, 0.5)
    surface = np.union1d(wing.moving, wing.fixed)
    target = wing.mesh.points[surface].copy()
    target[np.searchsorted(surface, wing.moving)] += u
    points = np.asarray(jm.deform(wing.plan(REDUCED.coarse), u))
    for left in (3, 2, 1):
        graph = jm.prepare(points, surface, method=jm.DelaunayGraph())
        points = np.asarray(jm.deform(graph, (target - points[surface]) / left))
    np.testing.assert_allclose(points[wing.moving], wing.base + u, atol=1e-12, rtol=0)
    end, once = wing.judge(points), wing.moved(u, REDUCED)
    assert end.inverted == 0
    assert end.aspect_ratio.mean() == pytest.approx(once.aspect_ratio.mean(), abs=5e-4)
    assert end.volume_ratio.min() == pytest.approx(once.volume_ratio.min(), abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("points", [COARSE])
def test_dihedral_pulls_free_nodes_off_the_plane(wing):
    """A turn of the wing about the root moves nodes along the span: only `symmetry` keeps the plane a plane."""
    a = np.deg2rad(20)
    u = wing.base[:, [1]] * [0, np.cos(a) - 1, np.sin(a)]
    plane = np.setdiff1d(wing.mesh.patch("symmetry"), np.union1d(wing.moving, wing.fixed))
    free = np.asarray(jm.deform(wing.plan(None), u))
    assert np.abs(free[plane, 1]).max() > 0.01
    assert wing.moved(u, symmetric=True).inverted == 0


@pytest.mark.full
@pytest.mark.parametrize("points", [FINE])
def test_reduced_agrees_with_full_interpolation(wing):
    """Full: every node of wing and far field is a source, 17,147 of them. Minutes."""
    sources = len(REDUCED.coarse.reduction(wing.base)), len(wing.fixed)
    assert sources[0] == pytest.approx(293, rel=0.1)
    assert sources[1] == pytest.approx(923, rel=0.02)
    full = wing.plan(EVERY)
    for amplitude in (0.0735, 0.1, 0.25, 0.5, 0.75):
        u = agard445.mode(wing.base, 1, amplitude)
        expected = wing.judge(jm.deform(full, u))
        for method in (REDUCED, None):
            found = wing.moved(u, method)
            assert found.inverted == expected.inverted == 0
            assert found.aspect_ratio.mean() == pytest.approx(
                expected.aspect_ratio.mean(), abs=5e-4
            )
            assert found.aspect_ratio.max() == pytest.approx(expected.aspect_ratio.max(), rel=0.02)
            assert found.volume_ratio.min() == pytest.approx(expected.volume_ratio.min(), abs=0.01)
            if amplitude == 0.0735:
                assert found.aspect_ratio.max() < 7.3
