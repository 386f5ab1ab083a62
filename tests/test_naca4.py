"""C-grids of the NACA 4-digit family, and of a cusped section, by the laws that the paper's one is held to."""

import numpy as np
import pytest
from meshes import cusped
from oracles import check_geometry
from runs import over, refusals
from scipy.spatial import cKDTree

from jaxmorph import cases
from jaxmorph.cases._meshes import c_grid

# Percent of chord: station, upper and lower ordinate of the NACA 4412 as published (NACA Report 824, appendix II).
NACA4412 = np.column_stack(
    [
        [1.25, 2.5, 5, 10, 20, 30, 40, 60, 80, 95],
        [2.44, 3.39, 4.73, 6.59, 8.80, 9.76, 9.80, 8.14, 4.89, 1.47],
        [-1.43, -1.95, -2.49, -2.86, -2.74, -2.26, -1.80, -1.00, -0.39, -0.16],
    ]
)


def turning(contour):
    """Sine-like turn at each inner node of a polyline, positive to the left."""
    steps = np.diff(contour, axis=0)
    return steps[:-1, 0] * steps[1:, 1] - steps[:-1, 1] * steps[1:, 0]


def test_ordinates_of_the_4412():
    wall = cases.naca4("4412").points[50:211]
    nose = np.argmin(wall[:, 0])
    stations = NACA4412[:, 0] / 100
    np.testing.assert_allclose(
        np.interp(stations, *wall[nose:].T), NACA4412[:, 1] / 100, atol=1.5e-4
    )
    np.testing.assert_allclose(
        np.interp(stations, *wall[nose::-1].T), NACA4412[:, 2] / 100, atol=1.5e-4
    )


def test_first_cell_and_counts():
    for first_cell, mesh in [
        (1e-6, cases.naca4("4412")),
        (1e-7, cases.naca4("4412", first_cell=1e-7)),
    ]:
        wall, layer = mesh.points[50:211], mesh.points[261 + 50 : 261 + 211]
        np.testing.assert_allclose(np.linalg.norm(layer - wall, axis=1), first_cell, rtol=1e-6)
        assert len(mesh.points) == 39_666
        assert (len(mesh.patch("airfoil")), len(mesh.patch("farfield"))) == (166, 566)


def test_first_cell_is_kept_on_coarse_meshes():
    mesh = cases.naca4("4412", points=2_000)
    airfoil = mesh.patch("airfoil")
    outside = np.setdiff1d(np.arange(len(mesh.points)), airfoil)
    gaps, _ = cKDTree(mesh.points[outside]).query(mesh.points[airfoil])
    assert len(airfoil) < 50
    assert (
        np.sum(np.isclose(gaps, 1e-6, rtol=1e-6)) == len(airfoil) - 1
    )  # all but the middle of the base


def test_camber_makes_the_lower_wall_concave():
    wall = cases.naca4("4412").points[50:211]
    assert (
        turning(wall[:81]) > 0
    ).sum() >= 20  # the wall lies to the right: a left turn is concave
    assert (turning(wall[80:]) > 0).sum() == 0


@over(
    "code", ["0006", "1408", "2412", "4412", "4424", "6409", "6612", "9312", "9412", "9912", "0040"]
)
@over("points", [2_000], nightly=[12_000])
def test_geometry(code, points):
    check_geometry(cases.naca4(code, points=points, first_cell=1e-9 if code == "4412" else 1e-6))


def test_rays_leave_the_wall_near_its_normal():
    rays = cases.naca4("4412").points[: 151 * 261].reshape(151, 261, 2)[:, 50:211]
    tangents = np.gradient(rays[0], axis=0)
    normals = (
        np.column_stack([-tangents[:, 1], tangents[:, 0]])
        / np.linalg.norm(tangents, axis=1)[:, None]
    )
    directions = (rays[-1] - rays[0]) / 15
    cosines = np.einsum("kd,kd->k", normals, directions)
    assert np.degrees(np.arccos(cosines)).max() < 17


def test_cusped_section():
    mesh = c_grid(cusped)
    wall = mesh.points[50:211]
    assert np.ptp(wall[:, 1]) == pytest.approx(0.15, abs=1.5e-3)
    assert (turning(wall[:81]) > 0).sum() >= 20
    assert (turning(wall[80:]) > 0).sum() >= 20
    check_geometry(mesh)


def crossed(t):
    return cusped(t) - np.column_stack([0 * t, np.sign(t) * 0.0016 * t**2])


CODES = ("15", "00155", "naca", "-412", "4 12", "٤٤١٢")
test_what_has_no_mesh = refusals(
    *((lambda code=code: cases.naca4(code), "four digits") for code in CODES),
    (lambda: cases.naca4("4400"), "no thickness"),
    (lambda: cases.naca4("4012"), "a camber without its place"),
    (lambda: cases.naca4("9999"), r"cells around this section are not convex, first cell \d+ near"),
    (lambda: c_grid(crossed), "trailing edge is crossed"),
    (lambda: cases.naca0015(points=299), "`points` is 299; a C-grid needs at least 300"),
    *(
        (lambda h=h: cases.naca4("4412", first_cell=h), r"is .* between 1e-12 and 0\.09")
        for h in (0.0, -1e-6, 1e-14, 0.1)
    ),
)
