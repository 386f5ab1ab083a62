"""Several steps: what march leaves, replay gives back; with derivatives."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import body, few, full, motion
from runs import over

import jaxmorph as jm
from jaxmorph import cases
from jaxmorph._kernels.compile import compiled

STEPS = 2


def turned(mesh, steps=STEPS, angle=0.5):
    """A path of rotations of the moving nodes, with some bending: totals, so not on a straight line."""
    wall = mesh.points[mesh.moving]
    centre, axis = np.zeros(wall.shape[1]), None if wall.shape[1] == 2 else [0, 0, 1]
    shares = np.arange(1, steps + 1) / steps
    return np.stack(
        [jm.shapes.rotate(wall, angle * s, centre, axis) - wall + s * motion(wall) for s in shares]
    )


METHODS = {
    "few": jm.SurfaceReconstruction(few(), jm.DelaunayGraph()),
    "near-wall": jm.SurfaceReconstruction(few(), jm.NearWall(width=0.3)),
    "delaunay": jm.DelaunayGraph(),
    "full": full(jm.ThinPlateSpline(), 1),
    "reduced": few(),
    "multiscale": jm.Multiscale(),
    "compact": jm.CompactRBF(2.0),
    "local": jm.LocalCorrection(2.0),
}


@functools.cache
def planned(name, dimension=2):
    mesh = body(dimension)
    return jm.prepare(mesh.points, mesh.moving, mesh.fixed, method=METHODS[name])


@functools.cache
def marched(name, rebuild, dimension=2):
    return jm.march(planned(name, dimension), turned(body(dimension)), rebuild=rebuild)


CASES = [
    ("few", False),
    ("few", True),
    ("near-wall", False),
    ("delaunay", True),
    ("full", False),
    ("reduced", False),
]
BREADTH = {"near-wall", "full", "few"}
every_march = pytest.mark.parametrize(
    ("name", "rebuild"),
    [
        pytest.param(*case, marks=[pytest.mark.nightly] if case[0] in BREADTH else [])
        for case in CASES
    ],
    ids=[f"{name}{'-rebuilt' * again}" for name, again in CASES],
)


@every_march
def test_replay_equals_march(name, rebuild):
    path = turned(body(2))
    plans, points = marched(name, rebuild)
    assert len(plans) == STEPS
    np.testing.assert_allclose(eqx.filter_jit(jm.replay)(plans, path), points, rtol=0, atol=1e-12)


@every_march
def test_the_surface_arrives_and_the_far_field_stays(name, rebuild):
    mesh, path = body(2), turned(body(2))
    _, points = marched(name, rebuild)
    if name == "reduced":
        assert 1e-6 < np.abs(points[mesh.moving] - mesh.points[mesh.moving] - path[-1]).max() < 0.5
        return
    np.testing.assert_allclose(
        points[mesh.moving], mesh.points[mesh.moving] + path[-1], rtol=0, atol=1e-14
    )
    assert (np.asarray(points[mesh.fixed]) == mesh.points[mesh.fixed]).all()


@over(
    "name dimension",
    [("delaunay", 2)],
    nightly=[("delaunay", 3), ("multiscale", 2), ("compact", 2), ("local", 2)],
)
def test_steps_of_a_correction_equal_one(name, dimension):
    """It stands on the undeformed mesh: the path does not matter, nor the number of steps."""
    mesh = body(dimension)
    path = turned(mesh, steps=5)
    plan = planned(name, dimension)
    _, points = jm.march(plan, path)
    np.testing.assert_allclose(
        points, jm.deform(plan, path[-1]), rtol=0, atol=4e-15 * np.abs(mesh.points).max()
    )


def test_steps_by_hand():
    """A march with ids found again is a chain of prepare and deform, each by what the wall still has to go."""
    mesh, path = body(2), turned(body(2))
    points = mesh.points
    for target in path:
        plan = jm.prepare(np.asarray(points), mesh.moving, mesh.fixed, method=METHODS["few"])
        points = jm.deform(plan, mesh.points[mesh.moving] + target - points[mesh.moving])
    np.testing.assert_allclose(marched("few", True)[1], points, rtol=0, atol=1e-12)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("name", "rebuild"), [("few", False), pytest.param("few", True, marks=pytest.mark.slow)]
)
def test_gradients_of_replay(name, rebuild):
    """With respect to the whole path and to the base points, the ids as they were recorded."""
    mesh, path = body(2), turned(body(2))
    plans, _ = marched(name, rebuild)
    weights = np.random.default_rng(0).normal(size=mesh.points.shape)

    @eqx.filter_jit
    def objective(path, points, plans):
        def scalar(arguments):
            path, points = arguments
            return jnp.sum(
                weights * jnp.sin(jm.replay((jm.refit(plans[0], points), *plans[1:]), path))
            )

        return jax.value_and_grad(scalar)((path, points))

    _, gradient = objective(path, mesh.points, plans)
    rng, h = np.random.default_rng(1), 1e-6
    for argument, at in ((0, path), (1, mesh.points)):
        step = h * rng.normal(size=at.shape) * (1 if argument == 0 else 0.05)
        ahead, behind = ([path, mesh.points] for _ in range(2))
        ahead[argument], behind[argument] = at + step, at - step
        difference = (objective(*ahead, plans)[0] - objective(*behind, plans)[0]) / 2
        np.testing.assert_allclose(
            np.vdot(gradient[argument], step), difference, rtol=1e-5, atol=1e-12
        )


def test_what_is_not_a_path():
    with pytest.raises(ValueError, match="`path` has 3 steps, but there are 2 plans"):
        jm.replay(marched("few", False)[0], np.zeros((3, planned("few").n_moving, 2)))


def test_tuples_of_numbers_compile_once():
    traced = []

    @compiled
    def total(x):
        traced.append(x)
        return x.sum()

    assert [float(total(((a, 2.0), (3, 4)))) for a in (1.0, 2.0, 3.0)] == [10, 11, 12]
    assert len(traced) == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    "method",
    [jm.LinearElasticity(jm.ByDistance(1.0)), jm.InverseDistance(rotations=True)],
    ids=["elasticity", "turning"],
)
def test_rebuilt_steps_with_the_mesh_are_those_of_prepare(method):
    """Each step's plan is what `prepare` makes of the moved mesh, cells and boundary faces included; replayed as well."""
    mesh = cases.bodies({"body": (-1.0, 1.0, -1.0, 1.0)}, box=(-4.0, 4.0, -4.0, 4.0), spacing=1.0)
    base = mesh.points[mesh.patch("body")]
    path = np.stack(
        [np.asarray(jm.shapes.rotate(base, angle, about=(0.0, 0.0))) - base for angle in (0.2, 0.5)]
    )
    plan = jm.prepare(mesh, "body", "farfield", method=method)
    plans, points = jm.march(plan, path, rebuild=True, mesh=mesh)
    first = jm.deform(plan, path[0])
    second = jm.prepare(mesh.moved(first), "body", "farfield", method=method)
    expected = jm.deform(second, base + path[1] - np.asarray(first)[mesh.patch("body")])
    np.testing.assert_allclose(points, expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose(jm.replay(plans, path), points, rtol=0, atol=1e-12)
    if method.needs_cells:
        with pytest.raises(ValueError, match=r"march\(plan, path, rebuild=True, mesh=mesh\)"):
            jm.march(plan, path, rebuild=True)
    with pytest.raises(ValueError, match=r"`mesh` needs `rebuild=True`"):
        jm.march(plan, path, mesh=mesh)
    with pytest.raises(ValueError, match=r"`mesh` has points"):
        jm.march(plan, path, mesh=cases.bodies({}, spacing=1.0))


@over("dimension", [2], nightly=[3])
def test_delaunay_steps_with_kept_ids_equal_one(dimension):
    """The graph stands on the undeformed mesh: the path does not matter, nor the number of steps."""
    mesh = body(dimension)
    path = turned(mesh, steps=5)
    plan = planned("delaunay", dimension)
    _, points = jm.march(plan, path)
    np.testing.assert_allclose(
        points, jm.deform(plan, path[-1]), rtol=0, atol=2e-15 * np.abs(mesh.points).max() * 2
    )
