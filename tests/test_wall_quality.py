"""The first grid line off a wall: its angle and its height, against constructions by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meshes import grid
from runs import refusals
from scipy.spatial.transform import Rotation

import jaxmorph as jm
from jaxmorph import cases


def sheared(points, degrees):
    """Lines along the last axis lean by so many degrees along the first; the floor stays."""
    return points + np.tan(np.deg2rad(degrees)) * points[:, -1:] * np.eye(points.shape[1])[0]


def plate(columns=6, rows=4):
    x, y = np.linspace(0, 1, columns + 1), np.array([0, 0.1, 0.3, 0.6, 1.0])[: rows + 1]
    patches = {
        "floor": lambda ids: ids[:, 0],
        "left": lambda ids: ids[0],
        "lid": lambda ids: ids[:, -1],
    }
    return grid(x, y, patches=patches)


MESHES = {
    "quads": plate,
    **{
        kind: lambda kind=kind: cases.bricks(kind, cells=3)
        for kind in ("hexahedron", "wedge", "tetra", "mixed")
    },
}


@pytest.mark.parametrize("kind", MESHES)
def test_lean_height_and_turn(kind):
    """Lines that lean by 20 degrees, cells twice as high, and the whole mesh turned after that."""
    mesh = MESHES[kind]()
    d = mesh.points.shape[1]
    stretched = sheared(mesh.points, 20) * np.append(np.ones(d - 1), 2.0)
    lean = np.rad2deg(np.arctan(np.tan(np.deg2rad(20)) / 2))
    turn = (
        np.array([[0.8, -0.6], [0.6, 0.8]])
        if d == 2
        else Rotation.from_rotvec([0.5, -0.4, 0.8]).as_matrix()
    )
    for points in (stretched, stretched @ turn.T + 3.0):
        report = jm.wall_quality(mesh, "floor", points)
        np.testing.assert_array_equal(report.nodes, mesh.patch("floor"))
        np.testing.assert_allclose(report.height, 2, rtol=1e-12)
        np.testing.assert_allclose(report.angle, lean, rtol=1e-10)
    nothing = jm.wall_quality(mesh, "floor", mesh.points @ turn.T)
    np.testing.assert_allclose(nothing.angle, 0, atol=1e-10)
    assert "floor" in mesh.patches
    assert str(nothing).startswith(f"{len(nothing.nodes)} wall nodes: first grid line")


def test_a_line_that_was_inclined_from_the_start():
    """Its own angle to the wall counts: leaning on by 10 degrees more, in the plane of the wall's normal, and about it."""
    mesh = cases.bricks("hexahedron", cells=3)
    inclined = mesh.moved(sheared(mesh.points, 30))
    report = jm.wall_quality(inclined, "floor", sheared(mesh.points, 40))
    np.testing.assert_allclose(report.angle, 10, rtol=1e-10)
    about = (
        sheared(mesh.points, 30) + 0
    )  # the lean turned by a right angle about the normal, the floor at rest
    about[:, :2] = mesh.points[:, :2] + (about - mesh.points)[:, [1, 0]]
    between = np.rad2deg(np.arccos(np.cos(np.deg2rad(30)) ** 2))
    np.testing.assert_allclose(jm.wall_quality(inclined, "floor", about).angle, between, rtol=1e-10)


def test_a_rigid_motion_and_camber_of_an_airfoil():
    """A turn leaves both measures; a wall bent under lines that stay upright leans by the slope of the bend."""
    mesh = cases.naca0015(points=2000)
    wall = mesh.patch("airfoil")
    z = (mesh.points @ [1, 1j]) * np.exp(0.4j)
    report = jm.wall_quality(mesh, "airfoil", np.column_stack([z.real, z.imag]))
    assert np.max(report.angle) < 1e-6
    np.testing.assert_allclose(report.height, 1, rtol=1e-9)
    x = mesh.points[:, 0]
    bent = mesh.points + np.column_stack([0 * x, 0.4 * x * (1 - x)])
    report = jm.wall_quality(mesh, "airfoil", bent)
    middle = (mesh.points[report.nodes, 0] > 0.2) & (mesh.points[report.nodes, 0] < 0.9)
    slope = np.rad2deg(np.arctan(0.4 * (1 - 2 * mesh.points[report.nodes, 0])))
    np.testing.assert_allclose(report.angle[middle], np.abs(slope)[middle], atol=2.0)
    assert np.isin(report.nodes, wall).all()


@pytest.mark.slow
def test_derivatives_and_the_smooth_twin():
    mesh = cases.bricks("tetra", cells=3)
    rng = np.random.default_rng(0)
    points = mesh.points + 0.01 * rng.normal(size=mesh.points.shape)
    w = rng.normal(size=(2, len(mesh.patch("floor"))))

    def objective(points, softness=None):
        report = jm.wall_quality(mesh, "floor", points, softness=softness)
        return jnp.sum(w[0] * report.angle) + jnp.sum(w[1] * report.height)

    for softness in (None, 0.5):
        gradient = jax.jit(jax.grad(lambda points, s=softness: objective(points, s)))(points)
        step = 1e-6 * rng.normal(size=points.shape)
        difference = (objective(points + step, softness) - objective(points - step, softness)) / 2
        np.testing.assert_allclose(np.vdot(gradient, step), difference, rtol=1e-6)
    assert np.isfinite(jax.grad(lambda points: objective(points))(mesh.points)).all()
    sharp, smooth = (
        np.asarray(jm.wall_quality(mesh, "floor", points, softness=s).angle) for s in (None, 0.5)
    )
    np.testing.assert_allclose(smooth, np.sqrt(sharp**2 + 0.25) - 0.5, rtol=1e-12)
    assert sharp.max() > 1
    several = jax.vmap(lambda points: jm.wall_quality(mesh, "floor", points))(
        np.stack([points, mesh.points])
    )
    np.testing.assert_allclose(several.max_angle, [sharp.max(), 0], atol=1e-6)
    np.testing.assert_allclose(several.mean_angle, [sharp.mean(), 0], atol=1e-6)
    height = np.asarray(jm.wall_quality(mesh, "floor", points).height)
    np.testing.assert_allclose(several.min_height, [height.min(), 1], rtol=1e-12)
    np.testing.assert_allclose(several.max_height, [height.max(), 1], rtol=1e-12)


test_bad_walls = refusals(
    (lambda mesh: jm.wall_quality(mesh, "wing"), "no patch is called 'wing'"),
    (
        lambda mesh: jm.wall_quality(mesh, [0, 2]),
        "no cell has a boundary side whose nodes are all among the 2 wall nodes",
    ),
    (
        lambda mesh: jm.wall_quality(mesh, [0, 99]),
        r"1 ids in `wall` are not in 0 to [0-9]+, first 99",
    ),
    (lambda mesh: jm.wall_quality(mesh, "floor", mesh.points[:3]), "`points` has shape"),
    of=lambda: (plate(),),
)


def test_several_patches_are_one_wall():
    both = jm.wall_quality(plate(), ["floor", "lid"])
    assert len(both.nodes) == len(plate().patch("floor", "lid"))
