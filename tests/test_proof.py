"""Proof that cells fold nowhere inside: against gmsh's bounds, exact arithmetic, closed forms and samples."""

import itertools
import math
from fractions import Fraction

import jax
import numpy as np
import pytest
from meshes import filled, gmsh_session, reflected, with_folds
from oracles import cells_near_the_limit, jacobians_inside, samples_inside
from runs import over, runs

import jaxmorph as jm
from jaxmorph._host.cells.lagrange import lagrange_types
from jaxmorph._quality import bernstein
from jaxmorph._quality.bounds import bounds
from jaxmorph._quality.jacobian_form import form_of

SHAPES = ("triangle", "quad", "tetra", "pyramid", "wedge", "hexahedron")
COMPLETE = {
    (cell.shape, cell.order): cell for cell in lagrange_types().values() if cell.is_complete
}
GMSH = {
    "triangle": "Triangle",
    "quad": "Quadrangle",
    "tetra": "Tetrahedron",
    "pyramid": "Pyramid",
    "hexahedron": "Hexahedron",
}


def bounded(kind: str, nodes: np.ndarray, depth: int = 4):
    """Bounds on det J of cells of one type, nodes (k, nodes, d); and where it is least, in the reference cell."""
    form = form_of(kind)
    x = [nodes[:, :, axis].T - nodes[:, 0, axis] for axis in range(nodes.shape[2])]
    columns = form.columns(x)
    found = bounds(form.space, form.determinant(columns), form.round_off(x, columns), depth)
    return found, form.reference(form.inside(found.at)).T


DENSE = ((1, 840, 17, 1), (2, 420, 17, 1), (3, 280, 17, 1), (4, 140, 17, 1))
"""Near the limit: 10,080 cells in all, 17 samples along each direction."""


@over("order count per_side seed", [(1, 60, 7, 0), (2, 60, 7, 0)], nightly=list(DENSE))
@pytest.mark.parametrize("shape", SHAPES)
def test_bounds_agree_with_samples(shape, order, count, per_side, seed):
    """No valid cell has a sample that is not positive, no bound is above a sample, and a witness has the value it claims."""
    cell = COMPLETE[shape, order]
    nodes = cells_near_the_limit(cell, count, seed)
    found, reference = bounded(cell.name, nodes)
    is_valid, is_invalid = found.lower > 0, found.upper < 0
    places = samples_inside(cell.shape, per_side)
    chunks = np.array_split(np.arange(count), max(1, count * len(places) // 200_000))
    least = np.concatenate(
        [
            jacobians_inside(cell.shape, cell.order, cell.lattice, nodes[rows], places).min(axis=1)
            for rows in chunks
        ]
    )
    slack = 1e-9 * (1 + np.abs(least))
    assert (least[is_valid] > -slack[is_valid]).all()
    assert (found.lower <= least + slack).all()
    value = [
        jacobians_inside(
            cell.shape, cell.order, cell.lattice, nodes[i : i + 1], reference[i : i + 1]
        )[0, 0]
        for i in np.flatnonzero(found.upper < -0.01)[:20]
    ]
    assert (np.array(value) < 0).all()
    assert 0.1 < is_valid.mean() < 0.9
    assert (~is_valid & ~is_invalid).mean() < 0.02


@over("shape", [shape for shape in GMSH if shape != "hexahedron"], nightly=["hexahedron"])
def test_gmsh_finds_the_least_value_between_the_bounds(shape):
    """gmsh bounds det J by its own Bernstein coefficients, in its own reference cell, with its own order of nodes."""
    with gmsh_session() as gmsh:
        # gmsh's det J of curved pyramids contradicts samples of them
        for order in (1, 2, 3) if shape != "pyramid" else (1,):
            cell = COMPLETE[shape, order]
            nodes = cells_near_the_limit(cell, 40)
            if shape == "triangle":  # gmsh turns the normal of a triangle to its corners
                edges = nodes[:, 1:3] - nodes[:, :1]
                nodes = nodes[np.linalg.det(edges) > 0.1]
            theirs = least_of_gmsh(gmsh, cell, nodes)
            found, _ = bounded(cell.name, nodes)
            assert (found.lower <= theirs + 1e-6).all()
            assert (found.upper >= theirs - 1e-6).all()
            is_known = (found.lower > 0) | (found.upper < 0)
            assert is_known.mean() > 0.8


def least_of_gmsh(gmsh, cell, nodes: np.ndarray) -> np.ndarray:
    """The least det J of cells by gmsh, in the unit of the reference cells here."""
    kind = gmsh.model.mesh.getElementType(GMSH[cell.shape], cell.order)
    local = np.reshape(gmsh.model.mesh.getElementProperties(kind)[4], (len(cell.lattice), -1))[
        :, : cell.dimension
    ]
    if cell.shape in ("quad", "hexahedron"):
        local = (local + 1) / 2
    elif cell.shape == "pyramid":
        local = np.column_stack([(local[:, :2] + 1 - local[:, 2:]) / 2, local[:, 2]])
    place = {tuple(at): node for node, at in enumerate(cell.lattice.tolist())}
    order = [place[tuple(at)] for at in np.rint(local * cell.order).astype(int).tolist()]
    gmsh.clear()
    gmsh.model.addDiscreteEntity(cell.dimension, 1)
    xyz = np.zeros((nodes.shape[0], nodes.shape[1], 3))
    xyz[:, :, : cell.dimension] = nodes[:, order]
    tags = np.arange(1, xyz.shape[0] * xyz.shape[1] + 1)
    gmsh.model.mesh.addNodes(cell.dimension, 1, tags, xyz.ravel())
    elements = np.arange(1, len(nodes) + 1)
    gmsh.model.mesh.addElementsByType(1, kind, elements, tags)
    unit = {"quad": 4, "pyramid": 4, "hexahedron": 8}.get(cell.shape, 1)
    return unit * np.array(gmsh.model.mesh.getElementQualities(elements, "minDetJac"))


def exact(corners: np.ndarray) -> np.ndarray:
    """Bernstein coefficients (27,) of det J of a trilinear hexahedron in rational numbers, from its values on a lattice."""
    x = np.array([[Fraction(float(component)) for component in corner] for corner in corners])
    values = np.empty((3, 3, 3), object)
    for place in itertools.product(range(3), repeat=3):
        columns = []
        for axis in range(3):
            shares = [[1 - Fraction(k, 2), Fraction(k, 2)] for k in place]
            shares[axis] = [-1, 1]  # the slopes of both
            weights = [
                math.prod(share[u] for share, u in zip(shares, unit, strict=True)) for unit in UNITS
            ]
            columns.append(np.array(weights, object) @ x)
        values[place] = np.dot(np.cross(*columns[:2]), columns[2])
    to_coefficients = np.array([[1, 0, 0], [Fraction(-1, 2), 2, Fraction(-1, 2)], [0, 0, 1]])
    for axis in range(3):
        values = np.moveaxis(np.tensordot(to_coefficients, values, (1, axis)), 0, axis)
    return values.ravel()


UNITS = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]


def test_coefficients_are_those_of_rational_numbers_within_the_round_off_that_is_claimed():
    cell = COMPLETE["hexahedron", 1]
    some = cell.reference + 0.06 * np.random.default_rng(2).normal(size=(4, 8, 3))
    nodes = np.concatenate([cells_near_the_limit(cell, 4), some])
    form = form_of("hexahedron")
    x = [nodes[:, :, axis].T - nodes[:, 0, axis] for axis in range(3)]
    columns = form.columns(x)
    coefficients, slack = form.determinant(columns), form.round_off(x, columns)
    for k, corners in enumerate(nodes):
        for value, found in zip(exact(corners), coefficients[:, k], strict=True):
            assert abs(value - Fraction(float(found))) <= slack[k]


@pytest.mark.parametrize(
    "kind", [name for name, cell in lagrange_types().items() if cell.dimension > 1]
)
def test_an_affine_cell_has_one_coefficient(kind):
    """An affine map has the same det J everywhere, also of cells whose nodes inside of faces are left out."""
    cell = lagrange_types()[kind]
    d = cell.dimension
    matrix = np.eye(d) + 0.3 * np.random.default_rng(0).normal(size=(d, d))
    form = form_of(kind)
    x = list((cell.reference @ matrix.T).T[:, :, None])
    np.testing.assert_allclose(form.coefficients(x), np.linalg.det(matrix), rtol=1e-10)
    moving = form_of(kind, True)
    turned = [np.concatenate([a, 2 * a]) for a in x]  # doubled: (1 + t)^d det J
    at = np.full((1 + d, 1), 0.2)
    np.testing.assert_allclose(
        moving.values(moving.columns(turned), at), 1.2**d * np.linalg.det(matrix), rtol=1e-10
    )
    np.testing.assert_allclose(form.mean(form.coefficients(x)), np.linalg.det(matrix), rtol=1e-10)


@pytest.mark.parametrize("factor", [(1, 3), (2, 4), (3, 3)])
def test_parts_are_the_same_polynomial(factor):
    m, _ = factor
    rng = np.random.default_rng(0)
    coefficients = rng.normal(size=(bernstein.count_coefficients((factor,)), 1))
    parts = bernstein.halved((factor,), coefficients)
    weights = rng.dirichlet(np.ones(m + 1), size=5)
    for part, corners in zip(parts.T, bernstein.children(m), strict=True):
        inner, outer = (
            bernstein.terms((factor,), at[:, 1:].T) for at in (weights, weights @ corners)
        )
        scale = bernstein.multinomials((factor,))
        np.testing.assert_allclose(
            (part * scale) @ inner, (coefficients[:, 0] * scale) @ outer, rtol=1e-12
        )
    volumes = np.abs(np.linalg.det(bernstein.children(m)))
    np.testing.assert_allclose(volumes, 0.5**m)


def test_a_hexahedron_that_folds_between_its_corners_is_found():
    """`quality` sees corners and the centre of a hexahedron, all of them positive."""
    cell = COMPLETE["hexahedron", 1]
    nodes = cells_near_the_limit(cell, 400, seed=3)
    apart = np.arange(400)[:, None, None] * np.array([9.0, 0.0, 0.0])
    mesh = jm.Mesh(
        (cell.reference + apart).reshape(-1, 3), {"hexahedron": np.arange(3200).reshape(400, 8)}
    )
    moved = (nodes + apart).reshape(-1, 3)
    report = jm.proof(mesh, moved)
    hidden = np.flatnonzero(report.is_invalid & ~np.asarray(jm.quality(mesh, moved).is_inverted))
    assert len(hidden) > 5
    for k in hidden:
        value = jacobians_inside(
            "hexahedron", 1, cell.lattice, nodes[k : k + 1], report.reference[k : k + 1]
        )[0, 0]
        assert value < 0
        assert report.upper[k] == pytest.approx(value, abs=1e-9)


@over(
    "shape order count",
    slow=[("quad", 3, 200)],
    nightly=[("hexahedron", 2, 200), ("wedge", 2, 100)],
)
def test_quality_finds_the_curved_cells_that_the_bounds_call_invalid(shape, order, count):
    """Also where no sample sees the fold. What `quality` reports is a value of det J, with its derivative."""
    cell = COMPLETE[shape, order]
    d, nodes = cell.dimension, cells_near_the_limit(cell, count, seed=5)
    base = np.broadcast_to(cell.reference, nodes.shape).reshape(-1, d)
    mesh = jm.Mesh(base, {cell.name: np.arange(len(base)).reshape(count, -1)})
    points = nodes.reshape(-1, d)
    report, proof = jm.quality(mesh, points), jm.proof(mesh, points)
    inverted = np.asarray(report.is_inverted)
    assert inverted[proof.is_invalid].all()
    assert not inverted[proof.is_valid].any()
    assert np.asarray(jm.quality(mesh.moved(points)).is_inverted)[proof.is_invalid].all()
    places = samples_inside(shape, 2 * order + 1)  # the lattice of `quality` sees less
    least = jacobians_inside(shape, order, cell.lattice, nodes, places).min(axis=1)
    hidden = np.flatnonzero(proof.is_invalid & (least > 0))
    assert len(hidden) > 5
    found = np.asarray(report.jacobian)[hidden]
    assert (found <= proof.upper[hidden] + 1e-9).all()  # a Gauss point may be lower still
    assert (found >= proof.lower[hidden] - 1e-9).all()
    single = jm.quality(mesh, points.astype(np.float32))
    assert single.jacobian.dtype == np.float32
    assert (np.asarray(single.is_inverted) == inverted).mean() > 0.98
    traced, both = jax.jit(lambda x: jm.inverted(mesh, x)), jax.vmap(lambda x: jm.inverted(mesh, x))
    np.testing.assert_array_equal(traced(points), inverted)
    np.testing.assert_array_equal(
        both(np.stack([base, points])), np.stack([0 * inverted, inverted])
    )
    way = 0.01 * np.random.default_rng(0).normal(size=points.shape)
    ratio = jax.jit(lambda t: jm.quality(mesh, points + t * way).jacobian_ratio[hidden[:5]])
    slope = jax.jit(jax.jacrev(ratio))(0.0)
    np.testing.assert_allclose(slope, (ratio(1e-4) - ratio(-1e-4)) / 2e-4, rtol=0.02, atol=1e-5)


FILLED = runs(
    ["triangle"],
    slow=["tetra", "hexahedron", "triangle6"],
    nightly=[
        "quad",
        "pyramid",
        "wedge",
        "quad16",
        "triangle15",
        "tetra10",
        "wedge18",
        "pyramid14",
        "hexahedron27",
    ],
)


@pytest.mark.parametrize("kind", FILLED)
def test_a_mesh_that_arrives_folded_is_folded_however_its_cells_are_numbered(kind):
    """Samples of det J of the cells as they were listed before some were turned round decide who is folded."""
    mesh, cell = filled(kind), lagrange_types()[kind]
    for seed in range(3):
        start = with_folds(mesh, 1 + seed % 2, seed)
        before, turned = mesh.moved(start), reflected(mesh.moved(start), seed)
        ids = np.asarray(mesh.cells[kind])
        values = jacobians_inside(
            cell.shape, cell.order, cell.lattice, start[ids], samples_inside(cell.shape, 5)
        )
        least, largest = values.min(axis=1), values.max(axis=1)
        folded, inside_out = least < -1e-9, largest < -1e-9
        assert 0 < folded.sum() < len(ids) / 2
        for report in (
            jm.proof(turned),
            jm.proof(turned, start),
            jm.proof(turned, start, base=start),
        ):
            assert not report.is_valid[folded].any()
            assert report.is_valid[least > 0.05 * report.size].all()
        assert (jm.proof(turned).is_invalid >= folded).all()
        margin = np.asarray(jm.proven_margin(turned, start, depth=2))
        assert (margin[folded] < 0).all()
        alone, relative = jm.quality(turned), jm.quality(turned, start)
        assert (np.asarray(alone.is_inverted) <= (least < 1e-9)).all()
        assert np.asarray(alone.is_inverted)[inside_out].all()
        assert np.asarray(relative.is_inverted)[inside_out].all()
        np.testing.assert_array_equal(jm.inverted(turned, start), relative.is_inverted)
        assert int(relative.from_start) == int(relative.inverted)
        assert jm.proof(turned, mesh.points).valid == len(ids)
        assert int(jm.quality(turned, mesh.points).inverted) == 0
        for measure in (
            (jm.quality, jm.smooth_quality) if cell.order == 1 else ()
        ):  # curved cells have other samples
            for name in ("jacobian_ratio", "non_orthogonality"):
                expected, found = (
                    getattr(measure(either, start), name) for either in (before, turned)
                )
                np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(
            jm.proof(turned).margin, jm.proof(before).margin, rtol=1e-9, atol=1e-9
        )
        np.testing.assert_array_equal(alone.is_inverted, jm.quality(before).is_inverted)
        if cell.order == 1:
            other, one = (jm.distortion(each, mesh.points) for each in (turned, before))
            np.testing.assert_allclose(other, one, rtol=1e-6)


def test_cells_are_the_same_for_a_mesh_that_is_traced():
    mesh = filled("triangle")
    start = with_folds(mesh)
    turned = reflected(mesh.moved(start))
    expected = np.asarray(jm.quality(turned, start).is_inverted)
    assert expected.any()
    np.testing.assert_array_equal(
        jax.jit(lambda mesh: jm.inverted(mesh, mesh.points))(turned), expected
    )
    np.testing.assert_array_equal(
        jax.jit(lambda mesh: jm.quality(mesh).is_inverted)(turned), expected
    )
    margin = jax.jit(lambda mesh: jm.proven_margin(mesh, mesh.points))(turned)
    np.testing.assert_array_equal(margin < 0, expected)


def test_cells_around_a_pole_have_one_handedness():
    """Hexahedra about an axis repeat its nodes; faces that repeat a node still tell how cells are numbered."""
    around, up = 6, 3
    angle = np.linspace(0, 1.2, around)
    ids = np.arange(2 * around * up).reshape(2, around, up)
    rim = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = np.array(
        [[*(r * rim[j]), k] for r in (0.0, 1.0) for j in range(around) for k in range(up)]
    )
    ids[0] = ids[0, 0]  # the axis
    low, high = slice(0, -1), slice(1, None)
    corners = [(0, low, low), (1, low, low), (1, high, low), (0, high, low)]
    cells = np.stack(
        [ids[i, j, k] for layer in (low, high) for i, j, _ in corners for k in (layer,)], axis=-1
    )
    mesh = reflected(jm.Mesh(points, {"hexahedron": cells.reshape(-1, 8)}))
    assert int(jm.quality(mesh).inverted) == 0
    points[ids[1, 2, 1]] = [0.3, -0.6, 1]  # past its neighbour
    found = [
        np.asarray(jm.quality(reflected(mesh.moved(points), seed)).is_inverted) for seed in range(4)
    ]
    assert all((other == found[0]).all() for other in found)
    assert 0 < found[0].sum() <= 4


def test_flat_cells_and_parts_apart_leave_the_verdict_alone():
    """Cells of no size lead from neighbour to neighbour; each part of a mesh has its own handedness."""
    points = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0.5], [0.5, 0.5], [0.5, 1.4]])
    cells = np.array([[0, 1, 4], [1, 2, 4], [2, 5, 4], [2, 3, 5], [3, 0, 4], [3, 4, 5], [3, 2, 6]])
    for seed in range(4):
        mesh = reflected(
            jm.Mesh(np.vstack([points, points + 5]), {"triangle": np.vstack([cells, cells + 7])}),
            seed,
        )
        assert int(jm.quality(mesh).inverted) == 0
        assert int(jm.proof(mesh).invalid) == 0
        bent = np.array(mesh.points)
        bent[6] = [0.5, 0.9]
        for report in (jm.quality(mesh.moved(bent)), jm.quality(mesh.moved(bent), bent)):
            assert np.flatnonzero(report.is_inverted).tolist() == [6]
        assert np.flatnonzero(jm.proof(mesh.moved(bent), bent).is_invalid).tolist() == [6]
