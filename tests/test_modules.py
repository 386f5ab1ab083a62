"""Public modules as functions: what `jax.jit` and `equinox.filter_jit` are given, object and method, in a trace too."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meshes import mixed
from runs import over

import jaxmorph as jm
from jaxmorph import shapes
from jaxmorph._kernels.module import Module

X = np.random.default_rng(0).random((12, 2))
BOX = shapes.FreeForm([0.0, 0.0], np.eye(2), (3, 3))
CONTROL = 0.1 * np.ones((3, 3, 2))
RING = np.stack([np.arange(12), np.roll(np.arange(12), -1)], axis=1)
SMOOTHER = shapes.Smoother(X, RING, 0.1)
METRIC = shapes.SobolevMetric(jm.Facets(X, RING), 0.1)
AIRFOIL = shapes.NACA4(0.02, 0.4, 0.12)
AXIS = shapes.ReferenceAxis([[0, 0, 0], [0, 1, 0]])
CALLS = {
    "box": lambda: (BOX, X, CONTROL),
    "method": lambda: (BOX.at(X), CONTROL),
    "coordinates": lambda: (BOX.coordinates, jnp.asarray(X)),
    "linked": lambda: (BOX.linked(mirror=0), X, jnp.ones(9)),
    "smoother": lambda: (SMOOTHER, X, X),
    "apply": lambda: (SMOOTHER.apply, X),
    "sensitivities": lambda: (SMOOTHER.sensitivities, X),
    "metric": lambda: (METRIC, X, X[:, 0]),
    "heights": lambda: (METRIC.heights, X[:, 0]),
    "naca": lambda: (AIRFOIL, X, np.array([0.03, 0.4, 0.1])),
    "axis": lambda: (AXIS, np.c_[X, X[:, 0]], {"twist": np.array([0.0, 0.1])}),
    "part": lambda: (shapes.Part(shapes.HicksHenne([0.3]), X[:, 1] > 0.5), X, np.ones(1)),
    "chain": lambda: (
        shapes.Chain({"box": BOX, "rows": shapes.OnRows(AIRFOIL, [0, 1])}),
        X,
        {"box": CONTROL},
    ),
    "together": lambda: (shapes.Together(shapes.CST(2), BOX), X, (np.ones(4), CONTROL)),
    "curve": lambda: (shapes.BSplineCurve(X, 4).at(X), np.ones((4, 2))),
    "basis": lambda: (jm.WendlandC2(0.5), np.linspace(0, 1, 5)),
    "stiffness": lambda: (jm.ByVolume(), jnp.array(0.5), jnp.array(0.1)),
}


BREADTH = ("naca", "together", "chain", "axis")
"""Shapes of which each takes seconds to compile; the fast tests hold what they are made of."""


@over("name", [name for name in CALLS if name not in BREADTH], nightly=BREADTH)
def test_jit_takes_modules_and_their_methods(name):
    function, *arguments = CALLS[name]()
    expected = function(*arguments)
    np.testing.assert_allclose(
        eqx.filter_jit(function)(*arguments), expected, rtol=1e-12, atol=1e-15
    )
    jit = jax.jit if isinstance(function, Module) else eqx.filter_jit  # Equinox's bound methods
    traced = jax.jit(lambda *arguments: jit(function)(*arguments) + jit(function)(*arguments))
    np.testing.assert_allclose(traced(*arguments), 2 * expected, rtol=1e-12, atol=1e-15)


def test_jit_takes_a_module_that_is_traced_itself():
    def twice(box):
        return jax.jit(box)(X, CONTROL) + jax.jit(box)(X, CONTROL)

    np.testing.assert_allclose(jax.jit(twice)(BOX), 2 * BOX(X, CONTROL), rtol=1e-12)


def test_jit_takes_methods_of_plans_and_searches():
    mesh = mixed()
    plan = jm.prepare(mesh.points, [0, 1, 2], [4, 5], method=jm.RBF.classic(jm.ThinPlateSpline()))
    search = jm.ValidSteps(jm.DesignedMesh(plan, mesh, lambda y: jnp.ones((3, 2)) * y))
    assert bool(jax.jit(search.holds)(jnp.array(0.01)))
    np.testing.assert_allclose(jax.jit(plan.offset)(jnp.zeros((3, 2))), 0, atol=1e-12)
    moved = jax.jit(mesh.moved)(jnp.asarray(mesh.points) + 1)
    np.testing.assert_array_equal(moved.points, np.asarray(mesh.points) + 1)


def test_a_module_with_other_arrays_is_another_function():
    boxes = [shapes.FreeForm([0.0, 0.0], size * np.eye(2), (3, 3)) for size in (1.0, 2.0)]
    for box in boxes:
        x = jnp.asarray(X)
        np.testing.assert_allclose(jax.jit(box.coordinates)(x), box.coordinates(x), rtol=1e-12)
    assert boxes[0] != boxes[1]
    assert boxes[0] == boxes[0]


def test_modules_without_arrays_count_by_their_value():
    assert jm.ThinPlateSpline() == jm.ThinPlateSpline()
    assert len({jm.ThinPlateSpline(), jm.ThinPlateSpline(), jm.CubicSpline()}) == 2


@pytest.mark.parametrize("room", [jm, shapes])
def test_public_modules_share_the_base(room):
    public = [getattr(room, name) for name in dir(room) if not name.startswith("_")]
    modules = [each for each in public if isinstance(each, type) and issubclass(each, eqx.Module)]
    missing = [each.__name__ for each in modules if not issubclass(each, Module)]
    assert not missing
