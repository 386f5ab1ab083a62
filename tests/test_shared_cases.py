"""Meshes that others made: turned, bent, lifted, with a bump. They are not part of the repository; without them, skipped."""

import functools
import pathlib

import numpy as np
import pytest
from runs import over

import jaxmorph as jm
from jaxmorph import io

SHARED = pathlib.Path(__file__).parents[2] / "shared" / "cases"
pytestmark = pytest.mark.skipif(not SHARED.is_dir(), reason="needs the shared cases")

FILES = {
    "viscous": "naca0012-cgrid/n0012_225-65.su2",
    "euler": "naca0012-euler/naca0012_inv.su2",
    "brick": "brick-tets/brick_tets.su2",
}
MOVING = {"viscous": "airfoil", "euler": "airfoil", "brick": "z_m"}
FIXED = {
    "viscous": "farfield",
    "euler": "farfield",
    "brick": "z_p",
}  # the sides of the brick follow
METHODS = {
    "default": None,
    "paper": jm.SurfaceReconstruction.published(),
    "graph": jm.DelaunayGraph(),
}


@functools.cache
def mesh_of(name):
    return io.read(SHARED / FILES[name])


@functools.cache
def plan_of(name, method):
    mesh = mesh_of(name)
    return jm.prepare(
        mesh.points, mesh.patch(MOVING[name]), mesh.patch(FIXED[name]), method=METHODS[method]
    )


def turned(base, *degrees):
    z = base[:, 0] - 0.25 + 1j * base[:, 1]
    moves = [z * (np.exp(-1j * np.deg2rad(angle)) - 1) for angle in degrees]
    return np.stack([np.column_stack([move.real, move.imag]) for move in moves])


def lifted(base, height):
    """One step, along the last coordinate."""
    return np.column_stack([np.zeros((len(base), base.shape[1] - 1)), height])[None]


AIRFOIL = {
    "turn 15": lambda base: turned(base, 15),
    "turn 45": lambda base: turned(base, 15, 30, 45),
    "bend 0.1": lambda base: lifted(base, 0.1 * base[:, 0] ** 2),
    "bend 0.2": lambda base: lifted(base, 0.2 * base[:, 0] ** 2),
    "heave": lambda base: lifted(base, 0.1 + 0 * base[:, 0]),
    "bump": lambda base: lifted(
        base, 0.03 * np.exp(-(((base[:, 0] - 0.5) / 0.1) ** 2)) * (base[:, 1] > 0)
    ),
}
BRICK = {  # 2 x 1 x 1
    "bend 0.1": lambda base: lifted(base, 0.2 * (base[:, 0] / 2) ** 2),
    "bend 0.2": lambda base: lifted(base, 0.4 * (base[:, 0] / 2) ** 2),
    "heave": lambda base: lifted(base, 0.2 + 0 * base[:, 0]),
    "bump": lambda base: lifted(
        base, 0.2 * np.exp(-((base[:, 0] / 2 - 0.5) ** 2 + (base[:, 1] - 0.5) ** 2) / 0.05)
    ),
    "twist": lambda base: lifted(
        base, np.tan(np.deg2rad(30)) * (base[:, 1] - 0.5) * base[:, 0] / 2
    ),
}
RUNS = [(name, motion) for name in ("viscous", "euler") for motion in AIRFOIL] + [
    ("brick", motion) for motion in BRICK
]


def smallest_corner_ratio(mesh, points):
    """The smallest determinant at a cell's corners over the undeformed smallest: quads, triangles, tetrahedra."""
    ratios = []
    for kind, cells in mesh.cells.items():
        if kind == "line" or (kind in ("triangle", "quad") and points.shape[1] == 3):
            continue
        now, then = (
            np.linalg.det(edges_at_corners(kind, at[cells])) for at in (points, mesh.points)
        )
        sign = np.sign(then[:, :1])
        ratios.append((sign * now).min(axis=1) / (sign * then).min(axis=1))
    return min(ratio.min() for ratio in ratios)


def edges_at_corners(kind, x):
    if kind == "quad":
        return np.stack([np.roll(x, -1, axis=1) - x, np.roll(x, 1, axis=1) - x], axis=-2)
    return (x[:, 1:] - x[:, :1])[:, None]  # of a simplex: the same at each corner


@pytest.mark.parametrize("method", ["default", pytest.param("paper", marks=pytest.mark.nightly)])
@over("name motion", slow=RUNS[:1], nightly=RUNS[1:])
def test_no_cell_inverts(name, motion, method):
    mesh = mesh_of(name)
    moving, fixed = mesh.patch(MOVING[name]), mesh.patch(FIXED[name])
    path = (BRICK if name == "brick" else AIRFOIL)[motion](mesh.points[moving])
    points = np.asarray(jm.march(plan_of(name, method), path)[1])
    assert np.isfinite(points).all()
    np.testing.assert_allclose(points[moving], mesh.points[moving] + path[-1], atol=1e-14)
    np.testing.assert_array_equal(points[fixed], mesh.points[fixed])
    worst = smallest_corner_ratio(mesh, points)
    assert worst > (0.5 if name == "brick" else 0.9)
    report = jm.quality(mesh, points)
    assert int(report.inverted) == 0
    assert float(report.min_jacobian_ratio) == pytest.approx(worst, rel=1e-3)


@pytest.mark.slow
def test_flat_faces_that_follow_stay_flat():
    """Nodes on the hull of brick: none is lost, none leaves its face, in spite of the many degenerate simplices."""
    mesh = mesh_of("brick")
    path = BRICK["bend 0.2"](mesh.points[mesh.patch("z_m")])
    for method in METHODS:
        points = np.asarray(jm.deform(plan_of("brick", method), path[0]))
        for side in ("x_m", "x_p", "y_m", "y_p"):
            axis, ids = "xyz".index(side[0]), mesh.patch(side)
            np.testing.assert_allclose(
                points[ids, axis], mesh.points[ids, axis], rtol=0, atol=1e-12
            )
        assert smallest_corner_ratio(mesh, points) > 0.4
