"""The laws that every method obeys, each tried on every method of `cases.py`."""

import functools
import io
import json
import pickle
import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import BY_NAME, NAMES, body, motion
from hypothesis import given as given_by
from hypothesis import settings, strategies
from meshes import even, half, renumbered, slit, thin, turn
from runs import runs
from scipy.spatial.transform import Rotation

import jaxmorph as jm

FAST = {("delaunay", 2), ("reduced", 2)}
"""Cases whose laws the fast tests hold."""

WHOLE = FAST | {
    ("default", 2),
    ("inverse-distance", 2),
    ("elasticity", 2),
    ("notebook's method", 2),
}
"""One case for each class of fields: `.ci/run` holds all laws of these. `.ci/nightly` holds every law of every case."""

CHEAP = {
    ("default", 2),
    ("elasticity", 2),
    ("inverse-distance", 2),
}
"""Cases of which the fast tests hold the cheap laws too."""


def over(names, is_cheap=False):
    """Parametrises a law over cases, each marked by the run that holds it."""
    fast = FAST | CHEAP if is_cheap else FAST
    marks = [
        [] if pair in fast else [pytest.mark.slow if pair in WHOLE else pytest.mark.nightly]
        for pair in names
    ]
    cases = [
        pytest.param(*pair, marks=mark, id=f"{pair[0]}-{pair[1]}d")
        for pair, mark in zip(names, marks, strict=True)
    ]
    return pytest.mark.parametrize(("name", "dimension"), cases)


every_method, every_method_cheaply = over(NAMES), over(NAMES, is_cheap=True)
LINEAR = [pair for pair in NAMES if BY_NAME[pair[0]].make(1.0).linear]
every_linear, every_linear_cheaply = over(LINEAR), over(LINEAR, is_cheap=True)
PIECES = (
    "default",
    "few-sources",
    "near-wall",
    "multiscale",
    "delaunay",
    "wendland-none",
    "reduced",
)
every_piece = over([pair for pair in NAMES if pair[0] in PIECES and pair[1] == 2])


@functools.cache
def planned(name, dimension):
    mesh = body(dimension)
    return BY_NAME[name].prepared(mesh.points, mesh.moving, mesh.fixed)


@functools.cache
def given(dimension):
    """A displacement u, and weights that make a scalar of the moved points."""
    mesh = body(dimension)
    return motion(mesh.points[mesh.moving]), np.random.default_rng(7).normal(size=mesh.points.shape)


@functools.cache
def operator(name, dimension):
    """(n d, m d): the linear map from u to the displacements, a column for each unit displacement."""
    plan = planned(name, dimension)
    m, d = plan.n_moving, dimension
    columns = [jm.deform(plan, e.reshape(m, d)) - plan.points for e in np.eye(m * d)]
    return np.stack([np.asarray(column).ravel() for column in columns], axis=1)


def rotation(dimension):
    return turn(0.7, 2) if dimension == 2 else Rotation.from_rotvec([0.5, -0.4, 0.8]).as_matrix()


@every_method_cheaply
@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_few_nodes_move(name, dimension, count):
    mesh = body(dimension)
    apart = np.linalg.norm(mesh.points[mesh.moving] - mesh.points[mesh.moving[0]], axis=1)
    few = mesh.moving[np.argsort(apart)[:count]]
    plan = BY_NAME[name].prepared(mesh.points, few, np.setdiff1d(mesh.boundary, few))
    moved = np.asarray(jm.deform(plan, np.full((count, dimension), 0.01))) - mesh.points
    assert np.abs(moved).max() < 0.1
    if BY_NAME[name].exact:
        np.testing.assert_allclose(moved[few], 0.01, rtol=1e-9)


@every_method_cheaply
def test_nodes_of_no_cell_stay_and_change_nothing(name, dimension):
    mesh, (u, weights) = body(dimension), given(dimension)
    method, kind = BY_NAME[name].make(1.0), "triangle" if dimension == 2 else "tetra"
    cells = {kind: mesh.cells if method.needs_cells else mesh.outside}
    loose = np.array([[50.0] * dimension, [0.0] * dimension, mesh.points[mesh.moving[3]]])
    plans = [
        jm.prepare(
            jm.Mesh(points, cells),
            mesh.moving,
            mesh.fixed,
            method=method,
            free=np.arange(len(points)),
        )
        for points in (mesh.points, np.concatenate([mesh.points, loose]))
    ]
    moved, more = (np.asarray(jm.deform(plan, u)) for plan in plans)
    np.testing.assert_allclose(more[:-3], moved, rtol=0, atol=1e-12)
    assert (more[-3:] == loose).all()
    expected = jm.pullback(plans[0], u, weights)
    found = jm.pullback(plans[1], u, np.concatenate([weights, np.ones_like(loose)]))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


@every_method_cheaply
def test_the_surface_goes_where_it_is_told(name, dimension):
    plan, (u, _) = planned(name, dimension), given(dimension)
    mesh, moved = body(dimension), np.asarray(jm.deform(plan, u))
    if BY_NAME[name].exact:
        assert (moved[mesh.moving] == mesh.points[mesh.moving] + u).all()
        assert (moved[mesh.fixed] == mesh.points[mesh.fixed]).all()
    else:
        miss = np.abs(moved[mesh.moving] - mesh.points[mesh.moving] - u).max()
        assert 1e-12 < miss < np.abs(u).max()
    assert np.isfinite(moved).all()
    inner = moved[mesh.inner] - mesh.points[mesh.inner]
    assert (
        1e-3 < np.abs(inner).max() < 3 * np.abs(u).max()
    )  # the volume follows, and does not overshoot


@every_method_cheaply
def test_interior_is_continuous_at_the_wall(name, dimension):
    """The first layer, 1e-3 of the far field's distance off the wall, moves nearly as its wall node does."""
    plan, (u, _) = planned(name, dimension), given(dimension)
    mesh, moved = body(dimension), np.asarray(jm.deform(plan, u))
    gap = np.linalg.norm(mesh.points[mesh.inner][:, None] - mesh.points[mesh.moving][None], axis=2)
    node, wall = np.argwhere(gap < 6e-3).T
    assert len(node) >= 20
    difference = moved[mesh.inner[node]] - mesh.points[mesh.inner[node]] - u[wall]
    allowed = 0.1 if BY_NAME[name].exact else 1
    assert np.abs(difference).max() < allowed * np.abs(u).max()


@every_method_cheaply
def test_nothing_moves_when_nothing_is_asked(name, dimension):
    plan = planned(name, dimension)
    assert (
        np.asarray(jm.deform(plan, np.zeros((plan.n_moving, dimension)))) == body(dimension).points
    ).all()


@over([pair for pair in NAMES if BY_NAME[pair[0]].translates])
def test_affine_motions_of_the_whole_boundary(name, dimension):
    case, mesh = BY_NAME[name], body(dimension)
    plan = case.prepared(mesh.points, mesh.boundary)
    shift = np.array([0.3, -0.2, 0.5])[:dimension]
    motions = [np.eye(dimension)]
    if case.affine:
        shear = np.eye(dimension) + 0.3 * np.random.default_rng(1).normal(
            size=(dimension, dimension)
        )
        motions += [rotation(dimension), shear]
    for matrix in motions:
        target = mesh.points @ matrix.T + shift
        moved = jm.deform(plan, (target - mesh.points)[mesh.boundary])
        np.testing.assert_allclose(moved, target, rtol=0, atol=1e-10)


@every_linear_cheaply
def test_linear_in_u(name, dimension):
    plan, (u, _) = planned(name, dimension), given(dimension)
    v = np.random.default_rng(2).normal(size=u.shape)
    together = jm.deform(plan, 2 * u - 3 * v) - plan.points
    apart = 2 * (jm.deform(plan, u) - plan.points) - 3 * (jm.deform(plan, v) - plan.points)
    size = max(1.0, float(np.abs(together).max()))  # a sparse system may amplify what it is given
    np.testing.assert_allclose(together, apart, rtol=0, atol=1e-10 * size)


@every_linear
def test_derivatives_with_respect_to_u(name, dimension):
    """Reverse and second derivatives of a nonlinear scalar, at u and at u = 0, against the operator itself."""
    plan, (u, w), a = planned(name, dimension), given(dimension), operator(name, dimension)
    v = np.random.default_rng(3).normal(size=u.shape)

    def objective(u):
        return jnp.sum(w * jnp.sin(jm.deform(plan, u)))

    derivatives = jax.jit(lambda u: jax.jvp(jax.grad(objective), (u,), (jnp.asarray(v),)))
    for at in (u, np.zeros_like(u)):
        points = np.asarray(plan.points).ravel() + a @ at.ravel()
        gradient, second = derivatives(at)
        by_hand = a.T @ (w.ravel() * np.cos(points))
        np.testing.assert_allclose(np.ravel(gradient), by_hand, rtol=1e-8, atol=1e-8)
        by_hand = a.T @ (-w.ravel() * np.sin(points) * (a @ v.ravel()))
        np.testing.assert_allclose(np.ravel(second), by_hand, rtol=1e-8, atol=1e-8)
        h = 1e-5
        difference = (objective(at + h * v) - objective(at - h * v)) / (2 * h)
        np.testing.assert_allclose(jnp.vdot(gradient, v), difference, rtol=1e-6)


@every_linear
def test_pullback_is_the_transpose(name, dimension):
    plan, (u, w), a = planned(name, dimension), given(dimension), operator(name, dimension)
    pulled = np.asarray(jm.pullback(plan, u, w))
    np.testing.assert_allclose(pulled.ravel(), a.T @ w.ravel(), rtol=1e-8, atol=1e-9)
    pushed = np.asarray(jm.deform(plan, u) - plan.points)
    round_off = 1e-13 * np.linalg.norm(a) * np.linalg.norm(u) * np.linalg.norm(w)
    assert abs(np.vdot(pushed, w) - np.vdot(u, pulled)) <= round_off


@every_method_cheaply
def test_what_a_field_does_not_name_does_not_depend_on_u(name, dimension):
    """`pullback` takes no derivative by other leaves of a field than `varying`."""
    plan, (u, _) = planned(name, dimension), given(dimension)
    surface, others = plan.surface, []
    for factor in (1, 2):
        own = jnp.zeros_like(surface.points).at[: plan.n_moving].set(factor * u)
        field = plan.method.field(surface.ids, surface.factors, surface.points, own)
        named = [id(leaf) for leaf in jax.tree.leaves(field.varying)]
        assert {*named} <= {id(leaf) for leaf in jax.tree.leaves(field)}
        others.append([leaf for leaf in jax.tree.leaves(field) if id(leaf) not in named])
    for one, other in zip(*others, strict=True):
        np.testing.assert_array_equal(one, other)


@over([pair for pair in NAMES if pair[1] == 2 or pair[0] in ("delaunay", "reduced")])
def test_derivatives_with_respect_to_the_base_points(name, dimension):
    """The ids stay, everything else moves: the gradient is that of the plan's own arithmetic. Also jvp, and grad of grad."""
    plan, (u, w), mesh = planned(name, dimension), given(dimension), body(dimension)

    @jax.jit
    @jax.value_and_grad
    def objective(points):
        return jnp.sum(w * jm.deform(jm.refit(plan, points), u))

    found = np.asarray(objective(mesh.points)[1])
    assert np.isfinite(found).all()
    step = 1e-7 * np.random.default_rng(5).normal(size=w.shape)
    difference = (objective(mesh.points + step)[0] - objective(mesh.points - step)[0]) / 2
    np.testing.assert_allclose(np.vdot(found, step), difference, rtol=1e-6, atol=1e-13)
    for node, axis in (
        (mesh.moving[3], 0),
        (mesh.moving[11], 1),
        (mesh.fixed[5], 0),
        (mesh.inner[40], dimension - 1),
    ):
        step = np.zeros_like(mesh.points)
        step[node, axis] = 1e-6
        difference = (objective(mesh.points + step)[0] - objective(mesh.points - step)[0]) / 2e-6
        np.testing.assert_allclose(found[node, axis], difference, rtol=1e-6, atol=2e-6)


@over(
    [
        ("reduced", 2),
        ("wendland-none", 2),
        ("elasticity", 2),
        ("laplacian", 2),
        ("elasticity", 3),
        ("laplacian", 3),
    ]
)
def test_second_derivatives_with_respect_to_the_base_points(name, dimension):
    plan, (u, w), mesh = planned(name, dimension), given(dimension), body(dimension)
    v = (
        np.linalg.norm(mesh.points, axis=1)[:, None]
        * 0.1
        * np.random.default_rng(6).normal(size=w.shape)
    )
    gradient = jax.jit(jax.grad(lambda points: jnp.sum(w * jm.deform(jm.refit(plan, points), u))))
    second = jax.jit(jax.grad(lambda points: jnp.vdot(gradient(points), v)))(mesh.points)
    h = 1e-6
    across = (gradient(mesh.points + h * v) - gradient(mesh.points - h * v)) / (2 * h)
    assert np.isfinite(second).all()
    np.testing.assert_allclose(second, across, rtol=0, atol=2e-5 * np.abs(across).max())


@every_method
def test_jit_and_vmap(name, dimension):
    """The plan is an argument like any other; many displacements at once are as good as one by one."""
    plan, (u, _) = planned(name, dimension), given(dimension)
    several = np.stack([u, 0 * u, -2 * u])
    mapped = jax.jit(jax.vmap(jm.deform, in_axes=(None, 0)))(plan, several)
    looped = jnp.stack([jm.deform(plan, u) for u in several])
    np.testing.assert_allclose(mapped, looped, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ["delaunay", pytest.param("reduced", marks=pytest.mark.slow)])
def test_eager_scan_jacfwd_and_vjp(name):
    plan, (u, w) = planned(name, 2), given(2)
    one = jm.deform(plan, u)
    with jax.disable_jit():
        np.testing.assert_allclose(jm.deform(plan, u), one, rtol=0, atol=1e-13)
    _, scanned = jax.lax.scan(
        lambda carry, u: (carry, jm.deform(plan, carry * u)), 2.0, jnp.stack([u, -u])
    )
    np.testing.assert_allclose(scanned[1], jm.deform(plan, -2 * u), rtol=0, atol=1e-13)
    jacobian = jax.jacfwd(lambda u: jm.deform(plan, u))(jnp.asarray(u))
    np.testing.assert_allclose(
        jacobian.reshape(w.size, u.size), operator(name, 2), rtol=0, atol=1e-12
    )
    _, pushed = jax.jvp(lambda u: jm.deform(plan, u), (jnp.asarray(u),), (jnp.asarray(2 * u),))
    np.testing.assert_allclose(pushed, 2 * (one - plan.points), rtol=0, atol=1e-13)
    _, transpose = jax.vjp(
        lambda w: jm.pullback(plan, u, w), jnp.asarray(w)
    )  # the transpose of the transpose
    np.testing.assert_allclose(transpose(jnp.asarray(u))[0], one - plan.points, rtol=0, atol=1e-12)


@every_method
def test_translated_turned_and_scaled_meshes(name, dimension):
    """Displacements turn and scale with the mesh. The reductions' boxes stand along the axes: those turn by right angles."""
    case, mesh, (u, _) = BY_NAME[name], body(dimension), given(dimension)
    reference = np.asarray(jm.deform(planned(name, dimension), u)) - mesh.points
    turned = rotation(dimension) if case.turns else np.roll(np.eye(dimension), 1, axis=0)
    for length, shift, matrix in (
        (1e3, 0, np.eye(dimension)),
        (1e-3, 7e-3, np.eye(dimension)),
        (1, 0, turned),
    ):
        points = length * mesh.points @ matrix.T + shift
        plan = case.prepared(points, mesh.moving, mesh.fixed, length)
        moved = jm.deform(plan, length * u @ matrix.T) - points
        np.testing.assert_allclose(moved / length, reference @ matrix.T, rtol=0, atol=1e-9)


@every_method
def test_the_order_of_the_points_does_not_matter(name, dimension):
    case, mesh, (u, _) = BY_NAME[name], body(dimension), given(dimension)
    rng = np.random.default_rng(8)
    order, rows = rng.permutation(len(mesh.points)), rng.permutation(len(mesh.moving))
    place = np.argsort(order)
    plan = case.prepared(
        mesh.points[order], place[mesh.moving][rows], place[mesh.fixed][::-1], order=order
    )
    moved = jm.deform(plan, u[rows])
    np.testing.assert_allclose(
        moved, jm.deform(planned(name, dimension), u)[order], rtol=0, atol=1e-11
    )


def change_by_numbers(mesh, make, seeds, alone=False, **boundaries):
    """Measures the largest change of the displacements as numbers change, relative to the largest displacement."""

    def moved(mesh):
        # the displacement of a node on one of two sides in one place is that of its side
        wall, points = mesh.patch("wall"), np.asarray(mesh.points)
        around = np.zeros_like(points)
        for corners in mesh.cells.values():
            np.add.at(around, corners, points[corners].mean(axis=1)[:, None])
        u = motion(2 * points[wall]) + 0.01 * np.sign(np.round(around[wall], 9))
        plan = jm.prepare(
            points if alone else mesh, wall, mesh.patch("far"), method=make(), **boundaries
        )
        return np.asarray(jm.deform(plan, u)) - points, np.abs(u).max()

    (still, size), changes = moved(mesh), []
    for seed in seeds:
        numbered, old = renumbered(mesh, seed)
        changes.append(np.abs(moved(numbered)[0] - still[old]).max() / size)
    return max(changes)


@every_method_cheaply
def test_numbering_does_not_matter(name, dimension):
    """On a lattice all distances are equal many times over; half of the cells are listed the other way round."""
    case = BY_NAME[name]
    for kind in ["2-D"] if dimension == 2 else ["3-D", "tetra"]:
        for alone in [False] if case.faces or case.make(1.0).needs_cells else [False, True]:
            assert change_by_numbers(even(kind), lambda: case.make(0.3), [0], alone) < 1e-9, (
                kind,
                alone,
            )


SLIT = functools.cache(lambda: slit(12))
NUMBERED = {
    "lattice": (lambda: even("2-D"), {}),
    "ellipse": (lambda: thin(48), {}),
    "slit": (SLIT, {}),
    "bricks": (lambda: even("3-D"), {}),
    "tetrahedra": (lambda: even("tetra"), {}),
    "half": (lambda: half(even("tetra")), {"symmetry": "plane"}),
    "sliding": (lambda: half(even("3-D"), bent=0.05), {"sliding": "plane"}),
    "periodic": (
        lambda: half(even("3-D"), is_passage=True),
        {"symmetry": "plane", "periodic": jm.Periodic("left", "right")},
    ),
}


WITH_FACES = [("lattice", False), ("half", False)]
BREADTH = [
    ("ellipse", False),
    ("slit", False),
    ("bricks", False),
    ("tetrahedra", False),
    ("sliding", False),
    ("periodic", False),
]
ALONE = [("lattice", True), ("ellipse", True), ("bricks", True), ("tetrahedra", True)]


@pytest.mark.parametrize(("kind", "alone"), runs(WITH_FACES, slow=BREADTH + ALONE))
def test_numbering_does_not_matter_to_prepares_own_default(kind, alone):
    make, boundaries = NUMBERED[kind]
    assert change_by_numbers(make(), lambda: None, range(3), alone, **boundaries) < 1e-9


BLOCKS = {
    *("BATCH", "BLOCK", "CACHED", "CELLS", "CELLS_OF_BLOCK", "CHUNK", "DISTANCES_TOGETHER"),
    *(
        "FACES_AT_ONCE",
        "FEW_PARTS",
        "KERNEL_BLOCK",
        "LEAST_SLAB",
        "MOST_PARTS",
        "PLACES_TOGETHER",
        "POINT_BLOCK",
    ),
    *("POINTS_OF_BLOCK", "POINTS_TOGETHER", "ROOM", "ROWS_TOGETHER", "SLAB", "SLAB_STEP", "SQUARE"),
    *("TOGETHER", "TRACED_ROOM", "VALUES_OF_BLOCK", "WIDER"),
}
"""Names of constants that divide work into blocks, and nothing else."""

SIZES = BLOCKS | {
    *("COARSEST", "DENSE", "DIRECT", "ENOUGH", "FEW", "FEW_BLOCKS", "FITS", "FIT_ROWS", "LEAVES"),
    *("MANY", "NEIGHBOURS", "QUICK_POINTS", "QUICK_ROWS", "RADIUS_NEIGHBOURS", "RESORT", "SAMPLE"),
    *("SOURCES_ALONE", "WALLS_APART"),
    *("WALLS", "WIDTH", "CANDIDATES", "CURVE_SAMPLE", "FEW_POINTS", "HULL_SIDES", "VOTERS"),
    *("LEAP_NEIGHBOURS", "ROWS_OF_A_CORE", "ROW_WIDTH"),
}
"""These, and constants that decide how many of many are looked at."""


def lower(monkeypatch, names):
    """Lowers all of these sizes to 10; code that was compiled with others is dropped."""

    def lowered(value):
        if isinstance(value, dict):
            return {key: lowered(each) for key, each in value.items()}
        return tuple(map(lowered, value)) if isinstance(value, tuple) else min(value, 10)

    count = 0
    for name, module in list(sys.modules.items()):
        for word in names & {*vars(module)} if name.startswith("jaxmorph.") else ():
            value = vars(module)[word]
            parts = list(value.values()) if isinstance(value, dict) else value
            if all(
                type(each) is int
                for each in (parts if isinstance(parts, tuple | list) else [parts])
            ):
                count += lowered(value) != value
                monkeypatch.setattr(module, word, lowered(value))
    assert count > 15
    drop_compiled_code()


@pytest.fixture
def small(monkeypatch):
    lower(monkeypatch, SIZES)
    yield
    monkeypatch.undo()
    drop_compiled_code()


def drop_compiled_code():
    eqx.clear_caches()
    jax.clear_caches()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["lattice", "ellipse", "half"])
def test_numbering_does_not_matter_however_small_blocks_and_samples_are(small, kind):
    make, boundaries = NUMBERED[kind]
    assert change_by_numbers(make(), lambda: None, [0], **boundaries) < 1e-9


@pytest.mark.parametrize(
    ("name", "kind"),
    runs(
        [("inverse-distance", "2-D")],
        slow=[("default", "2-D"), ("elasticity", "tetra")],
        nightly=[("default", "tetra"), ("compact", "2-D"), ("iterative", "2-D")],
    ),
)
def test_the_size_of_blocks_does_not_matter(monkeypatch, name, kind):
    """Points, quality and proofs of an even mesh, all of it in blocks of ten."""
    mesh = even(kind)
    wall = mesh.patch("wall")
    u = motion(2 * np.asarray(mesh.points)[wall])

    def answers():
        plan = jm.prepare(mesh, wall, mesh.patch("far"), method=BY_NAME[name].make(0.3))
        moved = jm.deform(plan, u)
        report = jm.quality(mesh, moved)
        margin = jm.proof(mesh, moved).margin
        return [np.asarray(each) for each in (moved, report.jacobian_ratio, margin)]

    expected = answers()
    lower(monkeypatch, BLOCKS)
    try:
        for found, old in zip(answers(), expected, strict=True):
            np.testing.assert_allclose(found, old, rtol=0, atol=1e-9 * np.abs(u).max())
    finally:
        monkeypatch.undo()
        drop_compiled_code()


@pytest.mark.nightly
@pytest.mark.parametrize(("name", "dimension"), [pair for pair in NAMES if pair[1] == 2])
def test_numbering_does_not_matter_to_any_method_of_small_blocks(small, name, dimension):
    test_numbering_does_not_matter(name, dimension)


@pytest.mark.slow
@given_by(
    strategies.sampled_from(["lattice", "ellipse", "slit", "tetrahedra"]),
    strategies.integers(0, 2**32 - 1),
)
@settings(max_examples=20, deadline=None)
def test_no_numbering_is_found_that_matters(kind, seed):
    assert change_by_numbers(NUMBERED[kind][0](), lambda: None, [seed]) < 1e-9


@every_piece
def test_float32(name, dimension):
    mesh, (u, w) = body(dimension), given(dimension)
    plan = jm.prepare(
        mesh.points.astype(np.float32), mesh.moving, mesh.fixed, method=BY_NAME[name].make(1.0)
    )
    moved = jm.deform(plan, u.astype(np.float32))
    assert moved.dtype == jm.pullback(plan, u, w).dtype == plan.points.dtype == np.float32
    np.testing.assert_allclose(moved, jm.deform(planned(name, dimension), u), rtol=0, atol=1e-4)


@every_method
def test_round_trips(name, dimension):
    plan, (u, _) = planned(name, dimension), given(dimension)
    one = jm.deform(plan, u)
    leaves, structure = jax.tree.flatten(plan)
    file = io.BytesIO()
    eqx.tree_serialise_leaves(file, plan)
    file.seek(0)
    blank = jax.tree.map(jnp.zeros_like, plan)
    copies = [pickle.loads(pickle.dumps(plan)), jax.tree.unflatten(structure, leaves)]
    for copy in (*copies, eqx.tree_deserialise_leaves(file, blank)):
        assert jax.tree.structure(copy) == structure
        assert (jm.deform(copy, u) == one).all()
    assert all(isinstance(leaf, jax.Array) for leaf in leaves)


@every_piece
def test_blocks_agree_with_the_one_point_form(name, dimension):
    """`evaluate` is there for speed: value and derivatives are those of the field written for one point."""
    plan, (u, w) = planned(name, dimension), given(dimension)
    surface, method = plan.surface, plan.method
    own = jnp.zeros_like(surface.points).at[: plan.n_moving].set(u)

    def blocks(own):
        field = method.field(surface.ids, surface.factors, surface.points, own)
        return field.evaluate(plan.points, plan.volume.placed)

    def one_by_one(own):
        field = method.field(surface.ids, surface.factors, surface.points, own)
        at = lambda x, ids: field(x, method.place(x, ids, surface.factors, surface.points))  # noqa: E731
        return jax.vmap(at)(plan.points, plan.volume.ids)

    answers = [jax.jit(lambda own, form=form: jax.vjp(form, own)) for form in (blocks, one_by_one)]
    (value, pull), (expected, expected_pull) = (answer(own) for answer in answers)
    np.testing.assert_allclose(value, expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        pull(jnp.asarray(w))[0], expected_pull(jnp.asarray(w))[0], rtol=0, atol=1e-10
    )


X64_OFF = """
import json, sys, warnings
sys.path.insert(0, "tests")
warnings.simplefilter("error")
import jax, numpy as np, jaxmorph as jm
from cases import BY_NAME, body, motion
mesh, answer = body(2), {}
for name in ("delaunay", "reduced"):
    plan = jm.prepare(mesh.points.astype("float32"), mesh.moving, mesh.fixed, method=BY_NAME[name].make(1.0))
    u = motion(mesh.points[mesh.moving])
    moved = jm.deform(plan, u.astype("float32"))
    gradient = jax.grad(lambda u: jm.deform(plan, u).sum())(u.astype("float32"))
    answer[name] = [str(moved.dtype), str(gradient.dtype), np.asarray(moved, float).tolist()]
try:
    jm.prepare(mesh.points, mesh.moving, mesh.fixed, method=jm.DelaunayGraph())
except UserWarning as warning:
    answer["warning"] = str(warning)
print(json.dumps(answer))
"""


@pytest.mark.slow
def test_without_x64(request):
    """In a process of its own: float32 in, float32 out; float64 points are not cut to float32 in silence."""
    root = request.config.rootpath
    done = subprocess.run(
        [sys.executable, "-c", X64_OFF], capture_output=True, text=True, cwd=root, check=False
    )
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert "x64" in answer.pop("warning")
    for name, (dtype, gradient_dtype, moved) in answer.items():
        assert dtype == gradient_dtype == "float32"
        np.testing.assert_allclose(
            moved, jm.deform(planned(name, 2), given(2)[0]), rtol=0, atol=2e-3
        )
