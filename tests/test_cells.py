"""Methods that solve on the mesh's cells: elements against closed forms, symmetry planes, coincident nodes, and the two solvers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import BY_NAME, body, motion
from meshes import blocks, lattice, sphere, turn
from runs import over
from scipy import sparse
from scipy.sparse.linalg import spsolve

import jaxmorph as jm
from jaxmorph import cases
from jaxmorph._host.linear import solves
from jaxmorph._host.linear import systems as linear
from jaxmorph._methods.elements import gradients, quadrature

UNIFORM = jm.LinearElasticity(jm.ByVolume(0.0))


@pytest.fixture(autouse=True)
def no_factors_of_other_tests():
    linear.inverse_of.cache_clear()
    yield
    linear.inverse_of.cache_clear()


def planned_slab(columns, method):
    points, quads, ids = slab(columns)
    return jm.prepare(
        jm.Mesh(points, {"quad": quads}), ids[:, 0], ids[:, -1], method=method, free=ids.ravel()
    )


def by_both_solvers(monkeypatch, solved):
    """What `solved` returns by factors, and by conjugate gradients with a multigrid cycle."""
    pytest.importorskip("pyamg")
    for direct in (10**6, 10):
        monkeypatch.setattr(solves, "DIRECT", direct)
        linear.inverse_of.cache_clear()
        yield solved()


def hull(points):
    """The nodes of the unit cube's boundary."""
    return np.flatnonzero(((points < 1e-9) | (points > 1 - 1e-9)).any(axis=1))


@over("kind", ["hexahedron"], nightly=["tetra", "pyramid", "wedge"])
def test_patch_test(kind):
    """An affine motion of the boundary moves the nodes inside alike, whatever their places and the type of their cells."""
    mesh = cases.bricks(kind, cells=3)
    boundary = hull(mesh.points)
    inner = np.setdiff1d(np.arange(len(mesh.points)), boundary)
    points = mesh.points.copy()
    points[inner] += 0.04 * np.random.default_rng(0).uniform(-1, 1, (len(inner), 3))
    shear = 0.3 * np.random.default_rng(1).normal(size=(3, 3))
    plan = jm.prepare(mesh.moved(points), boundary, method=UNIFORM)
    moved = jm.deform(plan, (points @ shear)[boundary])
    np.testing.assert_allclose(moved, points + points @ shear, rtol=0, atol=1e-12)


def test_laplacian_has_the_cotangents():
    """A weight of Laplace's equation on triangles is half the sum of the cotangents of the angles that face the edge."""
    mesh = body(2)
    corners, n = mesh.cells, len(mesh.points)
    matrix = np.zeros((n, n))
    for one in corners:
        for k in range(3):
            apex, i, j = one[k], one[(k + 1) % 3], one[(k + 2) % 3]
            a, b = mesh.points[i] - mesh.points[apex], mesh.points[j] - mesh.points[apex]
            weight = 0.5 * (a @ b) / abs(a[0] * b[1] - a[1] * b[0])
            matrix[[i, j, i, j], [j, i, i, j]] += np.array([-1, -1, 1, 1]) * weight
    u, inner = motion(mesh.points[mesh.moving]), mesh.inner
    expected = mesh.points.copy()
    expected[mesh.moving] += u
    expected[inner] -= np.linalg.solve(
        matrix[np.ix_(inner, inner)], matrix[np.ix_(inner, mesh.moving)] @ u
    )
    plan = BY_NAME["laplacian-uniform"].prepared(mesh.points, mesh.moving, mesh.fixed)
    np.testing.assert_allclose(jm.deform(plan, u), expected, rtol=0, atol=1e-11)


def slab(columns):
    """Quads in a strip of x from -columns to columns, y from 0 to 4; the bottom moves, the top is fixed."""
    x, y = np.meshgrid(np.arange(-columns, columns + 1.0), np.arange(5.0), indexing="ij")
    points = np.stack(
        [x + 0.1 * np.sin(3 * x) * (abs(x) < columns), y + 0.1 * x**2 * y * (4 - y) / 16], axis=-1
    )
    ids = np.arange(x.size).reshape(x.shape)
    quads = blocks(ids)
    return points.reshape(-1, 2), quads, ids


@over("method angle", [(jm.Laplacian(), 0.6)], slow=[(jm.LinearElasticity(), 0.0)])
def test_nodes_slide_in_symmetry_planes(method, angle):
    """A half, with a plane in any direction, moves like the half of the whole."""
    points, quads, ids = slab(3)
    frame = turn(angle, 2)
    u = np.stack([0.1 * np.sin(points[ids[:, 0], 0]), 0.3 * np.cos(points[ids[:, 0], 0])], axis=1)
    whole = jm.Mesh(points, {"quad": quads}, {"bottom": ids[:, 0], "top": ids[:, -1]})
    kept = np.flatnonzero(points[:, 0] > -1e-9)
    number = np.full(len(points), -1)
    number[kept] = np.arange(len(kept))
    inside = (number[quads] >= 0).all(axis=1)
    half = jm.Mesh(points[kept] @ frame.T, {"quad": number[quads[inside]]})
    plan = jm.prepare(whole, "bottom", "top", method=method, free=ids.ravel())
    expected = jm.deform(plan, u)[kept] @ frame.T
    bottom, top = number[ids[3:, 0]], number[ids[3:, -1]]
    plane = jm.Plane(frame[:, 0], [0.0, 0.0])
    half_plan = jm.prepare(
        half, bottom, top, method=method, symmetry=plane, free=np.arange(len(kept))
    )
    moved = jm.deform(half_plan, u[3:] @ frame.T)
    np.testing.assert_allclose(moved, expected, rtol=0, atol=1e-11)
    if angle == 0:  # a coarse field has to place the images of the surface, too
        coarse = jm.SurfaceReconstruction(method, jm.DelaunayGraph())
        half_plan = jm.prepare(
            half, bottom, top, method=coarse, symmetry=plane, free=np.arange(len(kept))
        )
        np.testing.assert_allclose(
            jm.deform(half_plan, u[3:] @ frame.T), expected, rtol=0, atol=1e-11
        )


def test_a_stretched_bar_grows_thin():
    """In plane strain by -nu / (1 - nu) of its stretch, where its sides are free."""
    points = lattice([0.0, 0.3, 1, 1.4], [0.0, 0.2, 0.7])
    ids = np.arange(12).reshape(4, 3)
    points[ids[1:3, 1]] += [[0.1, 0.05], [-0.1, 0.1]]
    quads = blocks(ids)
    method = jm.LinearElasticity(jm.ByVolume(0.0), poisson=0.2)
    ends = np.concatenate([ids[0], ids[-1]])
    plan = jm.prepare(jm.Mesh(points, {"quad": quads}), ends, method=method, free=ids.ravel())
    u = points * [0.1, -0.1 * 0.2 / 0.8]
    np.testing.assert_allclose(jm.deform(plan, u[ends]), points + u, rtol=0, atol=1e-13)


def test_nodes_at_one_place_move_alike():
    """A cut that is no boundary, as behind a trailing edge, stays closed; nodes of no cell rest."""
    points, quads, ids = slab(3)
    cut = ids[3, 1:4]
    points = np.concatenate([points, points[cut], [[9.0, 9.0]]])
    doubled = quads.copy()
    right = (points[quads].mean(axis=1) > points[ids[3, 0]])[:, 0]
    for old, new in zip(cut, len(points) - 4 + np.arange(3), strict=True):
        doubled[right] = np.where(doubled[right] == old, new, doubled[right])
    u = 0.2 * np.stack([np.cos(points[ids[:, 0], 0]), np.sin(points[ids[:, 0], 0])], axis=1)
    moved = []
    for cells in (quads, doubled):
        mesh = jm.Mesh(points, {"quad": cells})
        plan = jm.prepare(mesh, ids[:, 0], ids[:, -1], method=UNIFORM, free=np.arange(len(points)))
        moved.append(np.asarray(jm.deform(plan, u)))
    np.testing.assert_allclose(moved[1][: ids.size], moved[0][: ids.size], rtol=0, atol=1e-13)
    np.testing.assert_array_equal(moved[1][-4:-1], moved[1][cut])
    np.testing.assert_array_equal(moved[1][-1], points[-1])


@pytest.mark.nightly
def test_batches_of_meshes():
    """Two meshes of one family under `vmap`: each has its own matrix, and none the other's answer."""
    plan, (points, quads, ids) = planned_slab(2, jm.LinearElasticity()), slab(2)
    u = np.random.default_rng(4).normal(size=(5, 2))
    family = (
        jnp.asarray(points)[None]
        * jnp.array([1.0, 2.0])[:, None, None] ** jnp.arange(2.0)[None, None]
    )
    moved = jax.vmap(lambda points: jm.deform(jm.refit(plan, points), u))(family)
    for k in range(2):
        mesh = jm.Mesh(np.asarray(family[k]), {"quad": quads})
        alone = jm.prepare(mesh, plan.moving, plan.fixed, method=plan.method, free=ids.ravel())
        np.testing.assert_allclose(moved[k], jm.deform(alone, u), rtol=0, atol=1e-12)


def test_wrong_uses_are_told():
    points, quads, ids = slab(2)
    with pytest.raises(
        ValueError, match=r"LinearElasticity needs the cells of the whole mesh: pass the mesh"
    ):
        jm.prepare(points, ids[:, 0], ids[:, -1], method=jm.LinearElasticity())
    mesh = jm.Mesh(points, {"quad": quads})
    with pytest.raises(ValueError, match=r"Laplacian needs the cells of the whole mesh"):
        jm.prepare_in_chunks(
            jm.Boundary(mesh, ids[:, 0], ids[:, -1], free=ids.ravel()),
            size=4,
            method=jm.Laplacian(),
        )
    with pytest.raises(ValueError, match=r"solves for all nodes at once"):
        jm.shard(planned_slab(2, jm.Laplacian()), jax.devices())
    with pytest.raises(
        ValueError, match=r"unknowns of LinearElasticity .* stiffness is not finite"
    ):
        planned_slab(2, jm.LinearElasticity(jm.ByVolume(3e4)))


def test_a_missing_solver_is_told(monkeypatch):
    mesh = cases.bricks("tetra", cells=3)
    monkeypatch.setattr(solves, "DIRECT", 10)
    monkeypatch.setattr(linear, "find_spec", lambda name: None)
    with pytest.raises(
        ImportError, match=r"24 unknowns in 3-D .* pip install 'jaxmorph\[solvers\]'"
    ):
        jm.prepare(mesh, hull(mesh.points), method=jm.LinearElasticity())


def test_a_solve_that_does_not_converge_is_factored_or_no_answer(monkeypatch):
    pytest.importorskip("pyamg")
    monkeypatch.setattr(solves, "DIRECT", 0)
    monkeypatch.setattr(linear, "MOST_STEPS", 1)
    rng = np.random.default_rng(0)
    pairs, values = np.array([[0, 1], [1, 2]]), rng.normal(size=(2, 3, 3))
    right, free = rng.normal(size=(3, 3)), np.ones((3, 3), bool)
    system = pairs, values, np.broadcast_to(9 * np.eye(3), (3, 3, 3)), np.zeros(0), free
    expected = np.linalg.solve(dense(3, 3, *system[:3]), right.ravel()).reshape(3, 3)
    np.testing.assert_allclose(linear.solve(*system, right), expected, rtol=0, atol=1e-14)
    linear.inverse_of.cache_clear()
    monkeypatch.setattr(linear, "RESORT", 0)
    assert np.isnan(linear.solve(*system, right)).all()


@pytest.mark.parametrize("join", [0.0, 1e-3])
def test_unknowns_that_nothing_joins_are_solved_by_sparse_factors(join):
    """No negative entry: the last level is the matrix itself."""
    pytest.importorskip("pyamg")
    n = 2 * solves.COARSEST
    matrix = sparse.csr_matrix(np.eye(n) + join * (np.eye(n, k=1) + np.eye(n, k=-1)))
    cycle = solves.hierarchy(matrix, np.ones(n))
    right = np.random.default_rng(0).normal(size=n)
    assert not cycle.levels
    np.testing.assert_allclose(matrix @ cycle(right), right, rtol=0, atol=1e-12)


def test_thin_layers_of_hexahedra_take_few_steps(monkeypatch):
    """Laplace's equation on layers from 1e-6 to 1e-2 thick, a twelfth wide: where isotropic aggregates take 67 steps."""
    pytest.importorskip("pyamg")

    def in_one_direction(lengths):
        """Stiffness and masses of linear elements."""
        a, b = lengths[:-1], lengths[1:]
        beside, after = np.diag(b[:-1], -1), np.diag(1 / b[:-1], -1)
        return np.diag(1 / a + 1 / b) - after - after.T, (
            np.diag(2 * (a + b)) + beside + beside.T
        ) / 6

    (wide, wide_mass), (thin, thin_mass) = map(
        in_one_direction, (np.full(12, 1 / 12), 1e-6 * 1.5 ** np.arange(20))
    )
    along = sparse.kron(wide, wide_mass) + sparse.kron(wide_mass, wide)
    matrix = (
        sparse.kron(thin, sparse.kron(wide_mass, wide_mass)) + sparse.kron(thin_mass, along)
    ).tocsr()
    root = np.sqrt(matrix.diagonal())
    scaled = (sparse.diags(1 / root) @ matrix @ sparse.diags(1 / root)).tocsr()
    right = np.random.default_rng(0).normal(size=len(root))
    monkeypatch.setattr(linear, "MOST_STEPS", 25)
    x = linear.iterate_to_accuracy(scaled, right, solves.hierarchy(scaled, root), 1 / root)
    np.testing.assert_allclose(scaled @ x, right, rtol=0, atol=1e-7)


@pytest.mark.slow
def test_a_dense_system_is_solved_without_multigrid(monkeypatch):
    """Where a row has hundreds of entries, unknowns are far smaller than right sides: the residual alone tells the end."""
    points = sphere(1000)
    apart = np.linalg.norm(points[:, None] - points[None], axis=2) / 1.2
    matrix = np.maximum(1 - apart, 0) ** 4 * (4 * apart + 1)  # Wendland's C2 on a sphere
    right = np.sin(3 * points[:, 0])
    monkeypatch.setattr(linear, "MOST_STEPS", 120)  # 240 without a cycle
    x = linear.iterate_to_accuracy(matrix, right, None, np.ones(1000))
    np.testing.assert_allclose(matrix @ x, right, rtol=0, atol=1e-8)


def test_springs_have_derivatives_where_corners_coincide():
    corners = jnp.array([[0.0, 0], [1, 0], [1, 1], [1, 1]])
    springs = jm.SpringAnalogy()
    slope = jax.grad(lambda corners: springs.entries("quad", corners, jnp.ones(()))[0])(corners)
    assert np.isfinite(slope).all()


def entries_of(method, kind):
    """Compiles them as one program."""
    return jax.jit(lambda corners, distance: method.entries(kind, corners, distance))


def of_triangles(method, corners, distance, cuts):
    """The entries of a quad made of linear triangles, half of each way to cut it."""
    place = {pair: k for k, pair in enumerate(method.pairs("quad"))}
    entries = entries_of(method, "triangle")
    total = np.zeros((6, *np.shape(entries(corners[:3], distance[:3]))[1:]))
    for cut in cuts:
        ids = np.array(cut)
        for (a, b), part in zip(
            method.pairs("triangle"), entries(corners[ids], distance[ids]), strict=True
        ):
            i, j = cut[a], cut[b]
            total[place[min(i, j), max(i, j)]] += 0.5 * np.asarray(part if i < j else part.T)
    return total


CUTS = ((0, 1, 2), (0, 2, 3), (0, 1, 3), (1, 2, 3))


@over(
    "make stiffness", [(jm.LinearElasticity, jm.ByDistance(1.5)), (jm.Laplacian, jm.ByVolume(0.0))]
)
def test_a_quad_is_the_mean_of_both_ways_to_cut_it(make, stiffness):
    corners = jnp.array([[0.0, 0.1], [1.3, 0], [1.1, 0.9], [0.2, 0.6]])
    distance = jnp.array([0.0, 0.3, 0.7, 0.2])
    method = make(stiffness)
    found = entries_of(method, "quad")(corners, distance)
    np.testing.assert_allclose(
        found, of_triangles(method, corners, distance, CUTS), rtol=0, atol=1e-12
    )


@pytest.mark.slow
def test_a_quad_with_two_corners_in_one_place_is_a_triangle():
    corners = jnp.array([[0.0, 0], [1, 0], [0.4, 1], [0.4, 1]])
    method = jm.LinearElasticity()
    found = entries_of(method, "quad")(corners, jnp.ones(4))
    expected = of_triangles(method, corners, jnp.ones(4), CUTS[::2])
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
    slope = jax.jit(
        jax.grad(lambda corners: jnp.sum(method.entries("quad", corners, jnp.ones(4)) ** 2))
    )(corners)
    assert np.isfinite(slope).all()


@over("make", [jm.Laplacian], nightly=[jm.LinearElasticity])
def test_a_quad_with_a_straight_corner_depends_on_no_rounding(make):
    """Blocks may meet on a straight line: the triangle at such a corner has no area but round-off."""
    points, ids = lattice(np.arange(7.0), np.arange(7.0)), np.arange(49).reshape(7, 7)
    x = points[:, 0].copy()
    points[24] = [2.5, 2.5]  # on the line between its neighbours across one quad
    quads = blocks(ids)
    moving, fixed = np.flatnonzero(x == 0), np.flatnonzero(x == 6)
    matrix = turn(0.3, 2)
    u = np.tile([0.0, 0.5], (len(moving), 1))
    moves = []
    for places, here in ((points, u), (points @ matrix.T + 100, u @ matrix.T)):
        mesh = jm.Mesh(places, {"quad": quads})
        plan = jm.prepare(mesh, moving, fixed, method=make(), free=[*ids[:, 0], *ids[:, -1]])
        moves.append(np.asarray(jm.deform(plan, here)) - places)
    np.testing.assert_allclose(moves[1] @ matrix, moves[0], rtol=0, atol=1e-4)


@over(
    "kind corners share",
    [
        ("quad", [(0, 0), (1, 0), (1, 1), (0, 1)], 1),
        ("tetra", [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], 1 / 6),
        ("wedge", [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (0, 1, 1)], 1 / 2),
    ],
    nightly=[
        ("triangle", [(0, 0), (1, 0), (0, 1)], 1 / 2),
        ("pyramid", [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1)], 1 / 3),
        ("hexahedron", [(x, y, z) for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))], 1),
    ],
)
def test_shape_functions_give_volumes_and_gradients(kind, corners, share):
    """A sheared cell has its volume, and a linear field its gradient, at every point of the quadrature."""
    derivatives, weights = quadrature(kind)
    points = np.array(corners, dtype=float)
    d = points.shape[1]
    shear, gradient = np.random.default_rng(0).normal(size=(2, d, d))
    points = points @ shear + 3
    jacobian = np.einsum("qcr,cd->qrd", derivatives, points)
    volume = (weights * np.linalg.det(jacobian)).sum()
    assert volume == pytest.approx(share * np.linalg.det(shear), rel=1e-13)
    flat, left = gradients(kind, jnp.full((len(points), d), 0.3))  # all corners in one place
    assert np.isfinite(flat).all()
    assert (left > 0).all()
    found = np.linalg.solve(jacobian, np.einsum("qcr,cd->qrd", derivatives, points @ gradient))
    np.testing.assert_allclose(found, np.broadcast_to(gradient, found.shape), rtol=0, atol=1e-12)
    if kind == "wedge":  # both ends are alike
        along = np.einsum("qi,qj->ij", derivatives[:, :, 2], derivatives[:, :, 2])
        ends = [3, 4, 5, 0, 1, 2]
        np.testing.assert_allclose(along, along[np.ix_(ends, ends)], rtol=1e-13)


def dense(n, d, pairs, values, diagonal):
    """The matrix (n d, n d) of numbers or blocks for pairs and nodes."""
    matrix = np.zeros((n, d, n, d)) if values.ndim == 3 else np.zeros((n, 1, n, 1))
    for (i, j), value in zip(pairs, values, strict=True):
        matrix[i, :, j], matrix[j, :, i] = value, np.transpose(value)
    for node, value in enumerate(diagonal):
        matrix[node, :, node] = value
    return matrix.reshape(2 * (n * matrix.shape[1],))


@pytest.mark.parametrize("what", ["numbers", "masses", "blocks", "multigrid"])
def test_systems_of_pairs_against_dense_matrices(what, monkeypatch):
    """Two right sides at once, some unknowns held; NaN where the matrix is not finite or not positive."""
    n, d = 9, 3 if what == "multigrid" else 2
    if what == "multigrid":
        pytest.importorskip("pyamg")
        monkeypatch.setattr(solves, "DIRECT", 0)
    rng, pairs = np.random.default_rng(0), np.stack(np.triu_indices(n, 1), axis=1)
    block = (d, d) if what in ("blocks", "multigrid") else ()
    values = rng.normal(size=(len(pairs), *block))
    diagonal = np.broadcast_to(4 * n * (np.eye(d) if block else 1), (n, *block))
    masses = rng.uniform(1, 2, n) if what == "masses" else np.zeros(0)
    free, right = rng.uniform(size=(n, d)) < 0.7, rng.normal(size=(2, n, d))
    system = [pairs, values, diagonal, masses, free]
    x = np.stack([linear.solve(*system, one) for one in right])
    matrix = dense(n, d, pairs, values, diagonal)
    if not block:
        matrix = matrix @ np.diag(1 / masses) @ matrix if len(masses) else matrix
        matrix = np.kron(matrix, np.eye(d))
    held = ~free.ravel()
    matrix[held], matrix[:, held] = 0, 0
    matrix[held, held] = 1
    expected = np.linalg.solve(matrix, np.where(free, right, 0).reshape(2, -1).T).T.reshape(
        right.shape
    )
    np.testing.assert_allclose(x, expected, rtol=0, atol=1e-8 if what == "multigrid" else 1e-13)
    for wrong in (np.nan, -1.0) if what != "masses" else (np.nan,):
        assert np.isnan(
            linear.solve(pairs, values, wrong * diagonal, masses, free, right[0])[free]
        ).any()


@pytest.mark.parametrize("other", ["pairs", "masses", "free"])
def test_kept_factors_belong_to_one_system(other, monkeypatch):
    """Two systems with equal values, in turn, against SciPy: each has its own answer, and is factored once."""
    rng, n = np.random.default_rng(0), 12
    first, factored = np.arange(n - 1), []
    pairs, masses, free = np.stack([first, first + 1], axis=1), np.zeros(0), np.ones((n, 2), bool)
    changed = {
        "pairs": np.stack([first, np.full(n - 1, n - 1)], axis=1),
        "masses": rng.uniform(1, 2, n),
        "free": np.arange(n)[:, None] % [2, 3] != 0,
    }
    given = {"pairs": pairs, "masses": masses, "free": free}
    values, diagonal, right = -rng.uniform(0.1, 1, n - 1), np.full(n, 12.0), rng.normal(size=(n, 2))
    inverse = linear._make_inverse
    monkeypatch.setattr(
        linear, "_make_inverse", lambda *system: factored.append(system) or inverse(*system)
    )
    for system in 2 * [given, given | {other: changed[other]}]:
        i, j = system["pairs"].T
        matrix = sparse.csr_matrix((values, (i, j)), shape=(n, n))
        matrix = matrix + matrix.T + sparse.diags(diagonal)
        if len(system["masses"]):
            matrix = matrix @ sparse.diags(1 / system["masses"]) @ matrix
        expected = np.zeros((n, 2))
        for k, rows in enumerate(system["free"].T):
            expected[rows, k] = spsolve(matrix.tocsc()[rows][:, rows], right[rows, k])
        found = linear.solve(
            system["pairs"], values, diagonal, system["masses"], system["free"], right
        )
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
    assert len(factored) == 2


def test_one_solve_moves_and_one_pulls_back(monkeypatch):
    """With the factors of `prepare`: nothing is factored after it."""
    solved, inverse, factored, calls = linear.solve, linear._make_inverse, [], []
    plan = planned_slab(2, jm.LinearElasticity())
    monkeypatch.setattr(linear, "solve", lambda *a, **k: calls.append(1) or solved(*a, **k))
    monkeypatch.setattr(
        linear, "_make_inverse", lambda *system: factored.append(1) or inverse(*system)
    )
    rng = np.random.default_rng(4)
    u, w = rng.normal(size=(5, 2)), rng.normal(size=plan.points.shape)
    jax.block_until_ready(jm.deform(plan, u))
    assert (len(calls), len(factored)) == (1, 0)
    pulled = jm.pullback(plan, u, w)
    assert np.isfinite(pulled).all()
    assert (len(calls), len(factored)) == (2, 0)


@pytest.mark.slow
@pytest.mark.parametrize("method", [jm.Laplacian(), jm.LinearElasticity(jm.ByDistance(1.0))])
def test_thin_layers_of_soft_and_stiff_cells_are_solved_as_by_factors(method, monkeypatch):
    """A residual that is small beside that of the stiffest cells is not enough."""
    mesh = cases.bricks("hexahedron", cells=8)
    points = np.array(mesh.points)
    points[:, 2] = points[:, 2] ** 8 + 1e-4 * points[:, 2]
    mesh = jm.Mesh(points, mesh.cells, {"floor": np.flatnonzero(points[:, 2] == 0)})
    u, fixed = (
        0.1 * np.random.default_rng(0).normal(size=(81, 3)),
        np.setdiff1d(hull(points), mesh.patch("floor")),
    )
    solved = lambda: jm.deform(jm.prepare(mesh, "floor", fixed, method=method), u)  # noqa: E731
    factored, iterated = by_both_solvers(monkeypatch, solved)
    np.testing.assert_allclose(iterated, factored, rtol=0, atol=1e-7)


def test_a_right_side_that_is_not_finite_changes_no_later_solve(monkeypatch):
    pytest.importorskip("pyamg")
    monkeypatch.setattr(solves, "DIRECT", 0)
    rng = np.random.default_rng(0)
    pairs, right = np.stack([np.arange(19), np.arange(1, 20)], axis=1), rng.normal(size=(20, 3))
    system = pairs, -np.ones(19), np.full(20, 2.01), np.zeros(0), np.ones((20, 3), bool)
    first = linear.solve(*system, right)
    assert np.isnan(linear.solve(*system, np.where(right == right[3, 1], np.nan, right))).any()
    np.testing.assert_array_equal(linear.solve(*system, right), first)
