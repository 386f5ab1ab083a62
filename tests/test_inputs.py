"""The whole interface takes JAX's arrays, NumPy's and lists alike, and gives the same numbers."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import body, motion
from meshes import lattice, unit_grid
from runs import refusals

import jaxmorph as jm

FORMS = {
    "numpy": np.asarray,
    "jax": jnp.asarray,
    "list": lambda values: np.asarray(values).tolist(),
    "another byte order": lambda values: np.asarray(values).astype(
        np.asarray(values).dtype.newbyteorder()
    ),
    "long": lambda values: (
        np.asarray(values).astype(np.longdouble) if np.asarray(values).dtype.kind == "f" else values
    ),
}


def results(form):
    """Everything that the calls of a user's day return, for arguments of one form."""
    one, half = body(2), 0.5
    points, u = form(one.points), motion(one.points[one.moving])
    plan = jm.prepare(points, form(one.moving), form(one.fixed), method=jm.DelaunayGraph())
    path = form(np.stack([half * u, u]))
    plans, marched = jm.march(plan, path)
    rows = np.arange(len(one.points) - 1)
    triangles = np.stack([rows[:-1], rows[1:], rows[:-1] // 2], axis=1)[2:]
    mesh = jm.Mesh(points, {"triangle": form(triangles)}, {"a": form(one.moving)})
    moved = mesh.moved(form(jm.deform(plan, form(u))))
    return {
        "deform": jm.deform(plan, form(u)),
        "pullback": jm.pullback(plan, form(u), form(one.points)),
        "refit": jm.refit(plan, form(one.points * 2)).points,
        "march": marched,
        "replay": jm.replay(list(plans), path),
        "moved": moved.points,
        "patch": mesh.patch("a"),
        "quality": jm.quality(mesh, form(moved.points)).volume,
        "distortion": jm.distortion(mesh, form(moved.points)),
        "soft_maximum": jm.soft_maximum(form(one.points[:, 0]), 5.0),
        "inspect": jm.inspect(plan, form(u)).offset,
    }  # fmt: skip


reference = functools.cache(lambda: results(np.asarray))


@pytest.mark.parametrize(
    "form",
    [
        "list",
        *(
            pytest.param(form, marks=pytest.mark.slow)
            for form in ("another byte order", "jax", "long")
        ),
    ],
)
def test_every_call_takes_every_form(form):
    for name, values in results(FORMS[form]).items():
        np.testing.assert_array_equal(
            np.asarray(values), np.asarray(reference()[name]), err_msg=name
        )


@pytest.mark.nightly
def test_improve_takes_every_form():
    mesh = unit_grid(3)
    points, quads = np.asarray(mesh.points), mesh.cells["quad"]
    tangled = points.copy()
    tangled[5] += 0.6
    found = [
        jm.improve(jm.Mesh(form(points), {"quad": form(quads)}), form(tangled)).points
        for form in FORMS.values()
    ]
    assert np.abs(found[0][5] - points[5]).max() < 0.05
    for other in found[1:]:
        np.testing.assert_array_equal(other, found[0])


def test_lists_are_arrays_before_they_are_compiled():
    """Other numbers in a list are no other program."""
    one = body(2)
    plan, traces = (
        jm.prepare(one.points, one.moving, one.fixed, method=CountsTraces()),
        CountsTraces.traces,
    )
    for scale in (1.0, 2.0, 3.0):
        jm.deform(plan, (scale * motion(one.points[one.moving])).tolist())
    assert len(traces) == 1


class CountsTraces(jm.AbstractMethod):
    """Nothing moves."""

    traces = []  # noqa: RUF012

    def connect(self, surface, points):
        return None, None

    def fit(self, ids, surface, points):
        return None

    def field(self, ids, factors, surface, u):
        CountsTraces.traces.append(u)
        return Nothing()


class Nothing(jm.AbstractField):
    def __call__(self, x, ids):
        return jnp.zeros_like(x)


CORNERS = np.array([[0.0, 0], [1, 0], [0, 1], [1, 1]])
FAR = "3 of 4 points are too far out for float{}, first node 1 "
NEAR = r"all 4 points lie within 1e-\d+, too near each other for float{}"
test_points_whose_volumes_overflow_or_underflow_are_refused = refusals(
    (lambda: jm.prepare(1e110 * CORNERS, [0, 1]), FAR.format(64)),
    (lambda: jm.prepare((1e14 * CORNERS).astype(np.float32), [0, 1]), FAR.format(32)),
    (lambda: jm.prepare(1e-110 * CORNERS, [0, 1]), NEAR.format(64)),
    (lambda: jm.prepare((1e-14 * CORNERS).astype(np.float32), [0, 1]), NEAR.format(32)),
)


@pytest.mark.parametrize(
    ("dtype", "size", "within"), [(np.float64, 3e-99, 1e-9), (np.float32, 3e-9, 1e-4)]
)
def test_points_just_far_enough_from_each_other_move_as_larger_ones(dtype, size, within):
    points = np.random.default_rng(0).random((60, 3)).astype(dtype)
    corners = lattice([0, 1], [0, 1], [0, 1]).astype(dtype)
    points, u = np.concatenate([corners, points]), dtype(0.2) * np.ones((1, 3), dtype)

    def moved(scale):
        plan = jm.prepare(dtype(scale) * points, [0], np.arange(1, 8), method=jm.DelaunayGraph())
        return np.asarray(jm.deform(plan, dtype(scale) * u)) / dtype(scale)

    np.testing.assert_allclose(moved(size), moved(1), rtol=0, atol=within)


def test_limits_are_those_of_the_precision_that_jax_computes_in():
    jax.config.update("jax_enable_x64", False)
    try:
        with pytest.raises(ValueError, match="too near each other for float32"):
            jm.prepare(1e-20 * CORNERS, [0, 1])
        with pytest.raises(ValueError, match="too far out for float32"):
            jm.prepare(1e20 * CORNERS, [0, 1])
    finally:
        jax.config.update("jax_enable_x64", True)


def test_what_needs_numbers_on_the_host_says_so_in_traced_code():
    mesh = unit_grid(4)
    moving = np.flatnonzero(np.asarray(mesh.points)[:, 1] == 0)
    fixed = np.flatnonzero(np.asarray(mesh.points)[:, 1] == 1)
    plan = jm.prepare(mesh.points, moving, fixed, method=jm.DelaunayGraph())
    for call in (lambda x: jm.judge(mesh, x), lambda x: jm.inspect(plan, x[moving])):
        with pytest.raises(ValueError, match=r"is traced, inside of jit.*make this call outside"):
            jax.jit(call)(jnp.asarray(mesh.points))


def test_a_mesh_in_a_plane_has_two_coordinates():
    flat = np.pad(np.asarray(unit_grid(4).points), ((0, 0), (0, 1)))
    with pytest.raises(ValueError, match=r"A mesh in a plane is given as \(n, 2\)"):
        jm.prepare(flat, [0, 1], [2, 3, 8], method=jm.RBF())
