"""Generated meshes for the faults at walls: VTK measures their cells, their patches are their boundary."""

import numpy as np
import pytest
from oracles import boundary_edges, polydata, shoelace
from runs import refusals
from scipy.spatial import cKDTree

from benchmarks import faults
from jaxmorph import cases
from jaxmorph._host.cells.pieces import outer_pieces

FLAT = {
    "sharp_o_grid": lambda: faults.sharp_o_grid(around=96, layers=40),
    "cambered o-grid": lambda: faults.sharp_o_grid(around=96, layers=40, camber=0.05, edge=5.0),
    "sharp c-grid": lambda: cases.naca4("4412", points=4000, sharp=True),
    "cascade": lambda: faults.cascade(around=120, layers=30),
    "wide cascade": lambda: faults.cascade(around=120, layers=30, pitch=3.0),
    "channel": lambda: faults.channel(columns=20, rows=16),
}


def area(mesh):
    corners = mesh.points[mesh.cells["quad"]]
    first, second = corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]
    return 0.5 * float(np.sum(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]))


@pytest.mark.parametrize("name", FLAT)
def test_cells_are_convex_and_fill_their_boundary(name):
    mesh = FLAT[name]()
    assert polydata(mesh).cell_quality(["scaled_jacobian"])["scaled_jacobian"].min() > 0
    edges = boundary_edges(mesh)
    np.testing.assert_array_equal(np.unique(edges), mesh.patch(*mesh.patches))
    assert area(mesh) == pytest.approx(shoelace(mesh.points, edges), rel=1e-12)
    distances, _ = cKDTree(mesh.points).query(mesh.points, k=2)
    assert distances[:, 1].min() > 9e-13


@pytest.mark.parametrize("first_cell", [1.7e-7, 1e-5])
def test_o_grid(first_cell):
    """One node at the edge, rays along the normal, the first cell as asked for."""
    mesh = faults.sharp_o_grid(around=64, layers=32, first_cell=first_cell)
    layers = mesh.points.reshape(33, 64, 2)
    np.testing.assert_allclose(layers[0, 0], [1, 0], atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(layers[1] - layers[0], axis=1), first_cell, rtol=1e-3)
    before, after = layers[0, 0] - layers[0, 1], layers[0, -1] - layers[0, 0]
    angles = np.degrees(np.arctan2(*np.stack([before, after]).T[::-1]))
    assert abs(np.diff(angles)[0]) % 180 == pytest.approx(168, abs=4)  # an edge of 12 degrees
    along, ray = (layers[0, 2:] - layers[0, :-2]), (layers[1] - layers[0])[1:-1]
    cosine = (
        np.einsum("kd,kd->k", along, ray)
        / np.linalg.norm(along, axis=1)
        / np.linalg.norm(ray, axis=1)
    )
    assert np.abs(cosine[5:-5]).max() < 0.1
    np.testing.assert_allclose(np.linalg.norm(layers[-1] - [0.5, 0], axis=1), 20, rtol=0.01)


def test_a_sharp_c_grid_has_its_wake_once():
    blunt, sharp = (cases.naca4("0012", points=4000, sharp=sharp) for sharp in (False, True))
    wall = sharp.points[sharp.patch("airfoil")]
    ends = wall[wall[:, 0] > 1 - 1e-9]
    np.testing.assert_allclose(ends, [[1, 0]], atol=1e-12)
    assert len(sharp.points) < len(blunt.points)
    gaps = cKDTree(np.delete(sharp.points, sharp.patch("airfoil"), axis=0)).query(wall)[0]
    assert np.sum(np.isclose(gaps, 1e-6, rtol=1e-3)) >= len(wall) - 1


def test_a_channel_shares_its_corners():
    mesh = faults.channel(columns=10, rows=12, gap=0.3, first_cell=1e-4)
    sizes = [len(mesh.patch(name)) for name in ("inner", "outer", "inlet", "outlet")]
    assert sizes == [11, 11, 13, 13]
    assert len(mesh.patch(*mesh.patches)) == sum(sizes) - 4
    heights = np.unique(mesh.points[:, 1])
    np.testing.assert_allclose(
        [heights[1], 0.3 - heights[-2], heights[-1]], [1e-4, 1e-4, 0.3], rtol=1e-2
    )


def test_a_blade_has_a_passage_around_it():
    mesh = faults.cascade(around=120, layers=30)
    rim = mesh.points[mesh.patch("inlet", "outlet", "upper", "lower")]
    np.testing.assert_allclose(np.ptp(rim, axis=0), [1.7, 1.0])
    for first, second in (
        ("inlet", "lower"),
        ("inlet", "upper"),
        ("outlet", "lower"),
        ("outlet", "upper"),
    ):
        assert len(np.intersect1d(mesh.patch(first), mesh.patch(second))) == 1
    blade = mesh.points[mesh.patch("blade")]
    assert np.ptp(blade[:, 0]) == pytest.approx(1, abs=2e-3)
    assert 0.2 < cKDTree(rim).query(blade)[0].min() < 0.5


def check_solid(mesh):
    """Checks cells, and that the patches hold the boundary, so that all inner faces are shared; returns its nodes."""
    assert mesh.to_pyvista().cell_quality(["scaled_jacobian"])["scaled_jacobian"].min() > 0
    faces = outer_pieces(mesh.cells, len(mesh.points)).values()
    surface = np.unique(np.concatenate([face.ravel() for face in faces]))
    np.testing.assert_array_equal(surface, mesh.patch(*mesh.patches))
    return surface


@pytest.mark.parametrize("kind", ["hexahedron", "wedge", "tetra", "pyramid", "mixed"])
@pytest.mark.parametrize("first_cell", [None, 1e-3])
def test_bricks_fill_the_cube(kind, first_cell):
    mesh = cases.bricks(kind, cells=4, first_cell=first_cell)
    assert mesh.to_pyvista().compute_cell_sizes()["Volume"].sum() == pytest.approx(1, rel=1e-12)
    assert set(mesh.cells) == ({"hexahedron", "pyramid", "wedge"} if kind == "mixed" else {kind})
    surface = check_solid(mesh)
    assert ((mesh.points[surface] == 0) | (mesh.points[surface] == 1)).any(axis=1).all()
    if first_cell:
        assert np.unique(mesh.points[mesh.patch("sides"), 2])[1] == pytest.approx(first_cell)


def test_wing():
    mesh = cases.wing(points=1000, stations=5)
    check_solid(mesh)
    wall = mesh.points[mesh.patch("wing")]
    np.testing.assert_allclose(np.ptp(wall, axis=0)[:2], [1.2, 2.0], rtol=0.01)
    assert np.sort(cKDTree(wall).query(wall, k=9)[0][:, -1]).max() < 0.5  # within one station


test_what_makes_no_sense = refusals(
    (lambda: faults.sharp_o_grid(around=4), "16 cells around"),
    (lambda: faults.sharp_o_grid(edge=90), "1 to 60 degrees"),
    (lambda: faults.cascade(layers=3), "40 cells around and 8 layers"),
    (lambda: faults.cascade(pitch=0.5), "1 to 3 chords"),
    (lambda: faults.channel(rows=2), "4 columns and rows"),
    (lambda: cases.bricks("cube"), "expected one of hexahedron, wedge"),
    (lambda: cases.bricks(first_cell=2.0), "the cube's side is 1"),
    (lambda: cases.wing(stations=1), "2 stations"),
)
