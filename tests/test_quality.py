"""Quality against VTK's Verdict, finite differences, and meshes whose angles are known."""

import functools
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import pyvista
from meshes import IDEAL, grid, reflected, shaken
from runs import over
from scipy.spatial import Delaunay
from vtkmodules.vtkFiltersVerdict import vtkMeshQuality

import jaxmorph as jm
from jaxmorph import cases
from jaxmorph._host.cells.adjacency import handedness, neighbours
from jaxmorph._host.cells.topology import FACES
from jaxmorph._quality import vector
from jaxmorph._quality.quality import link
from jaxmorph._quality.report import MEASURES, Report

VTK = {kind: getattr(pyvista.CellType, kind.upper()) for kind in IDEAL}
# measure -> VTK's name of it, where pyvista's `cell_quality` has it
VERDICT = {
    "triangle": {"area": "area", "aspect_ratio": "aspect_ratio"},
    "quad": {
        "area": "area",
        "aspect_ratio": "aspect_ratio",
        "skewness": "skew",
        "jacobian": "jacobian",
    },
    "tetra": {"volume": "volume", "aspect_ratio": "aspect_ratio", "jacobian": "jacobian"},
    "pyramid": {"volume": "volume"},
    "wedge": {"volume": "volume"},
    "hexahedron": {
        "volume": "volume",
        "aspect_ratio": "max_edge_ratio",
        "skewness": "skew",
        "jacobian": "jacobian",
    },
}
# the rest is reached cell by cell, through VTK's static functions
STATIC = {
    "triangle": {"skewness": "TriangleEquiangleSkew"},
    "tetra": {"skewness": "TetEquiangleSkew"},
    "pyramid": {"skewness": "PyramidEquiangleSkew", "jacobian": "PyramidJacobian"},
    "wedge": {
        "skewness": "WedgeEquiangleSkew",
        "jacobian": "WedgeJacobian",
        "aspect_ratio": "WedgeEdgeRatio",
    },
}
KINDS = tuple(IDEAL)


def scattered(kind: str, count: int = 40, seed: int = 0, spread: float = 0.15) -> jm.Mesh:
    """Cells apart from each other: the ideal one, then with its corners moved and stretched at random."""
    random = np.random.default_rng(seed)
    ideal = np.array(IDEAL[kind], dtype=float)
    d = ideal.shape[1]
    corners = ideal + random.uniform(-spread, spread, (count, len(ideal), d))
    corners = corners @ (np.eye(d) + random.uniform(-0.2, 0.2, (count, d, d))) + random.uniform(
        -3, 3, (count, 1, d)
    )
    corners[0] = ideal
    return jm.Mesh(corners.reshape(-1, d), {kind: np.arange(count * len(ideal)).reshape(count, -1)})


def grid_of(mesh: jm.Mesh) -> pyvista.UnstructuredGrid:
    points = np.zeros((len(mesh.points), 3))
    points[:, : mesh.points.shape[1]] = mesh.points
    return pyvista.UnstructuredGrid({VTK[kind]: ids for kind, ids in mesh.cells.items()}, points)


def box(shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Points and cells of a grid of unit squares or cubes."""
    mesh = grid(*[np.arange(n + 1.0) for n in shape])
    return np.asarray(mesh.points), next(iter(mesh.cells.values()))


def tetrahedra(count: int = 60, seed: int = 1) -> jm.Mesh:
    """SciPy's Delaunay of random points: tetrahedra numbered either way."""
    points = np.random.default_rng(seed).random((count, 3))
    return jm.Mesh(points, {"tetra": Delaunay(points).simplices})


def volumes(mesh: jm.Mesh) -> np.ndarray:
    x = mesh.points[mesh.cells["tetra"]]
    return np.linalg.det(x[:, 1:] - x[:, :1]) / 6


@pytest.mark.parametrize("kind", KINDS)
def test_measures_are_those_of_verdict(kind):
    mesh = scattered(kind)
    report, grid = jm.quality(mesh), grid_of(mesh)
    measured = {
        name: grid.cell_quality(measure, null_value=np.nan)[measure]
        for name, measure in VERDICT[kind].items()
    }
    expected = {name: np.array(values) for name, values in measured.items()}
    for name, function in STATIC.get(kind, {}).items():
        measure = getattr(vtkMeshQuality, function)
        expected[name] = np.array([measure(grid.GetCell(i)) for i in range(grid.n_cells)])
    assert int(report.inverted) == 0
    for name, values in expected.items():
        np.testing.assert_allclose(
            getattr(report, name), values, rtol=2e-12, atol=2e-12, err_msg=name
        )


@pytest.mark.parametrize("kind", ["triangle", "quad"])
def test_surfaces_in_3d_are_measured_as_verdict_does(kind):
    flat = scattered(kind)
    random = np.random.default_rng(4)
    points = np.column_stack([flat.points, random.uniform(-0.1, 0.1, len(flat.points))])
    mesh = jm.Mesh(points, flat.cells)
    report, grid = jm.quality(mesh), grid_of(mesh)
    for name, measure in VERDICT[kind].items():
        np.testing.assert_allclose(
            getattr(report, name), grid.cell_quality(measure)[measure], rtol=2e-12, err_msg=name
        )
    turned = jm.quality(mesh, points @ np.diag([-1.0, 1.0, -1.0]))
    assert int(turned.inverted) == 0
    np.testing.assert_allclose(turned.area, report.area, rtol=1e-12)


def test_aspect_ratio_of_a_pyramid():
    mesh = scattered("pyramid")
    x = mesh.points[mesh.cells["pyramid"]]
    pairs = [(0, 1), (1, 2), (2, 3), (3, 0), (0, 4), (1, 4), (2, 4), (3, 4)]
    lengths = np.stack([np.linalg.norm(x[:, a] - x[:, b], axis=1) for a, b in pairs])
    np.testing.assert_allclose(
        jm.quality(mesh).aspect_ratio, lengths.max(axis=0) / lengths.min(axis=0), rtol=1e-13
    )


@pytest.mark.parametrize("kind", ["quad", "hexahedron", "wedge", "tetra", "pyramid"])
def test_non_orthogonality_by_faces(kind):
    """That of typed cells, traced, and that of arbitrary faces on the host are one number, however cells are numbered."""
    mesh = reflected(cases.naca0015(points=1000) if kind == "quad" else cases.bricks(kind, cells=3))
    points = np.asarray(mesh.points)
    sheared = np.array([[1, 0.3, 0.1], [0, 1.2, -0.2], [0.4, 0, 0.7]])[
        : points.shape[1], : points.shape[1]
    ]
    moved = (points + 0.3 * points**2 * (kind != "quad")) @ sheared.T  # faces stay flat
    expected = jm.face_quality(mesh.moved(moved)).non_orthogonality
    assert expected.max() > 30
    for found in (jm.quality(mesh.moved(moved)), jm.quality(mesh, moved)):
        np.testing.assert_allclose(found.non_orthogonality, expected, rtol=1e-6, atol=1e-6)


def test_volume_ratios_are_determinants_also_where_cells_are_turned_first():
    """An affine map multiplies all volumes by its determinant, of cells numbered either way round."""
    mesh = cases.bricks("hexahedron", cells=3)
    corners = np.array(mesh.cells["hexahedron"])
    mirrored = jm.Mesh(mesh.points, {"hexahedron": corners[:, [4, 5, 6, 7, 0, 1, 2, 3]]})
    matrix = np.array([[1, 0.3, 0.1], [0, 1.2, -0.2], [0.4, 0, -0.7]])
    for each in (mesh, mirrored):
        ratio = jm.face_quality(each, np.asarray(mesh.points) @ matrix.T).volume_ratio
        np.testing.assert_allclose(ratio, np.linalg.det(matrix), rtol=1e-12)
    np.testing.assert_array_equal(jm.face_quality(mesh).volume_ratio, 1.0)


def test_both_reports_answer_alike():
    """Boundary elements do not count; the extremes, the worst cells and the error are those of the arrays."""
    mesh = cases.bricks("tetra", cells=3)
    faces = np.asarray(mesh.cells["tetra"])[:5, :3]
    mesh = jm.Mesh(mesh.points, {"triangle": faces, **mesh.cells})
    points = shaken(mesh, 0.1)
    by_faces, by_corners = jm.face_quality(mesh, points), jm.quality(mesh, points)
    inverted = int((np.asarray(by_corners.volume_ratio) <= 0)[by_corners.counted].sum())
    assert 0 < inverted < len(mesh.cells["tetra"])
    for report in (by_faces, by_corners):
        assert isinstance(report, Report)
        assert (report.count, int(report.inverted)) == (len(mesh.cells["tetra"]), inverted)
        for name in ("skewness", "aspect_ratio", "non_orthogonality", "volume", "volume_ratio"):
            values = np.asarray(getattr(report, name))[report.counted]
            assert float(report.min(name)) == values.min()
            assert float(report.max(name)) == values.max()
            worst = np.asarray(getattr(report, name))[report.worst(3, by=name)]
            np.testing.assert_array_equal(
                worst, np.sort(values)[:3] if "volume" in name else np.sort(values)[:-4:-1]
            )
        weight = np.abs(np.asarray(report.volume)[report.counted])
        mean = np.average(np.asarray(report.skewness)[report.counted], weights=weight)
        assert float(report.mean("skewness")) == pytest.approx(mean, rel=1e-12)
        plain = np.asarray(report.skewness)[report.counted].mean()
        assert float(report.mean("skewness", weighted=False)) == pytest.approx(plain, rel=1e-12)
        assert np.asarray(report.is_inverted)[report.worst(inverted)].all()
        first = int(np.flatnonzero(report.is_inverted)[0])
        where = re.escape(", ".join(f"{x:.3g}" for x in np.asarray(report.centroid)[first]))
        message = f"{inverted} of {report.count} cells are inverted, first cell {first} near .{where}.*jm.inspect.plan, u"
        with pytest.raises(ValueError, match=message):
            report.raise_if_inverted()
        with pytest.raises(ValueError, match="no measure is called 'beauty'; there are skewness"):
            report.worst(1, by="beauty")
    jm.face_quality(mesh).raise_if_inverted()


def test_face_quality_prints_a_table():
    """Its numbers are those of the arrays: the extremes, means by volume, the worst cell and its place."""
    mesh = cases.bricks("hexahedron", cells=3)
    points = shaken(mesh, 0.02)
    measured = jm.face_quality(mesh, points)
    first, _, *rows = str(measured).splitlines()
    assert first == f"{len(measured.volume)} cells: {measured.is_inverted.sum()} inverted"
    assert repr(measured) == f"FaceQuality({len(measured.volume)} cells)"
    assert [row.split()[0] for row in rows] == [
        "skewness",
        "aspect_ratio",
        "non_orthogonality",
        "volume",
        "pyramid",
    ]
    for row in rows:
        name, least, mean, most, cell, *place = row.split()
        values = getattr(measured, name)
        expected = np.average(values, weights=measured.volume)
        expected = measured.mean_non_orthogonality if name == "non_orthogonality" else expected
        found = [float(least), float(mean), float(most)]
        np.testing.assert_allclose(found, [values.min(), expected, values.max()], rtol=5e-3)
        assert int(cell) == (values.argmin() if name in ("volume", "pyramid") else values.argmax())
        np.testing.assert_allclose(
            eval(" ".join(place)), measured.centroid[int(cell)], rtol=5e-3, atol=1e-3
        )
    moved = np.where(np.arange(len(points))[:, None] == 0, np.nan, points)
    assert "nan" in str(jm.face_quality(mesh, moved))


def test_centre_of_unequal_cells():
    """Two trapezoids (and prisms over them), one above the other: the centres are the closed form's."""
    low, high = (
        np.array([[0, 0], [4, 0], [3, 1], [0, 1]]),
        np.array([[0, 1], [3, 1], [1, 3], [0, 3]]),
    )
    centre = [(4**2 + 4 * 3 + 3**2) / (3 * (4 + 3)), (4 + 2 * 3) / (3 * (4 + 3))]
    above = [(3**2 + 3 + 1) / (3 * (3 + 1)), 1 + 2 * (3 + 2) / (3 * (3 + 1))]
    angle = np.degrees(np.arctan2(abs(above[0] - centre[0]), above[1] - centre[1]))
    flat = np.vstack([low, high[2:]]).astype(float)
    cells = np.array([[0, 1, 2, 3], [3, 2, 4, 5]])
    solid = np.vstack([np.column_stack([flat, np.full(6, z)]) for z in (0.0, 1.0)])
    meshes = [
        jm.Mesh(flat, {"quad": cells}),
        jm.Mesh(solid, {"hexahedron": np.hstack([cells, cells + 6])}),
    ]
    for mesh in meshes:
        np.testing.assert_allclose(jm.quality(mesh).non_orthogonality, angle, rtol=1e-12)


def test_mixed_types_in_one_mesh():
    """A pyramid on a cube, two tetrahedra on it, a wedge beside it, and a boundary quad: neighbours across types."""
    points = np.array(
        [*IDEAL["hexahedron"], [0.5, 0.5, 2], [2, 0.5, 1.5], [2, 0.5, 0], [2, 0.5, 1]], dtype=float
    )
    cells = {"quad": [[0, 3, 2, 1]], "hexahedron": [range(8)], "pyramid": [[4, 5, 6, 7, 8]]}
    mesh = jm.Mesh(points, cells | {"tetra": [[5, 6, 8, 9]], "wedge": [[1, 10, 2, 5, 11, 6]]})
    report, order = jm.quality(mesh), list(mesh.cells)
    neighbour = neighbours(mesh.cells)[0]
    at = np.cumsum([0, *(len(FACES[kind]) for kind in order)])
    pairs = {
        kind: {order[j] for j in neighbour[at[i] : at[i + 1]] if j >= 0}
        for i, kind in enumerate(order)
    }
    expected = {
        "quad": set(),
        "hexahedron": {"pyramid", "wedge"},
        "pyramid": {"hexahedron", "tetra"},
    }
    assert pairs == expected | {"tetra": {"pyramid"}, "wedge": {"hexahedron"}}
    assert int(report.inverted) == 0
    for kind, volume in {"quad": 1, "hexahedron": 1, "pyramid": 1 / 3, "wedge": 0.5}.items():
        np.testing.assert_allclose(
            report.volume[order.index(kind)], volume, rtol=1e-14, err_msg=kind
        )
    # the boundary quad has an entry, but does not count
    assert float(report.max("volume")) == pytest.approx(1)
    skewness, weight = (
        np.delete(each, order.index("quad")) for each in (report.skewness, report.volume)
    )
    assert float(report.mean_skewness) == pytest.approx(
        np.average(skewness, weights=weight), rel=1e-14
    )
    assert order.index("quad") not in report.worst(4).tolist()


def test_ratios_are_relative_to_the_undeformed_mesh():
    mesh = tetrahedra()
    points = shaken(mesh, 0.02, 2)
    report = jm.quality(mesh, points)
    ratio = volumes(mesh.moved(points)) / volumes(mesh)
    np.testing.assert_allclose(report.volume_ratio, ratio, rtol=1e-10)
    np.testing.assert_allclose(report.jacobian_ratio, ratio, rtol=1e-10)
    np.testing.assert_array_equal(report.is_inverted, ratio < 0)
    assert 0 < int(report.inverted) < len(ratio)
    affine = np.array([[1.2, 0.1, 0], [0.3, 0.9, 0], [0, 0.2, 1.1]])
    for kind in ("wedge", "hexahedron"):
        cells = scattered(kind)
        report = jm.quality(cells, cells.points @ affine + 5)
        np.testing.assert_allclose(report.volume_ratio, np.linalg.det(affine), rtol=1e-11)
        np.testing.assert_allclose(report.jacobian_ratio, np.linalg.det(affine), rtol=1e-11)


def test_cells_that_were_bad_from_the_start_are_not_inverted():
    points = np.array([[0, 0], [2, 0], [2, 2], [0.6, 0.6], [1, 0], [0, 2], [3.0, 1]])
    quads = {
        "not convex": [0, 1, 2, 3],
        "left-handed": [0, 5, 2, 1],
        "straight corner": [0, 4, 1, 2],
        "collapsed": [0, 4, 1, 4],
        "collapsed too": [4, 1, 4, 0],
        "two nodes in one place": [1, 6, 2, 2],
    }
    own = np.arange(len(quads))[:, None] * len(
        points
    )  # cells apart: no neighbour tells that one is folded
    mesh = jm.Mesh(np.tile(points, (len(quads), 1)), {"quad": np.array(list(quads.values())) + own})
    points = np.asarray(mesh.points)
    assert int(jm.quality(mesh, points).inverted) == 0
    report = jm.quality(mesh, jm.shapes.rotate(points + np.array([1e3, 7]), 1.0, [0, 0]))
    assert dict(zip(quads, report.is_inverted.tolist(), strict=True)) == dict.fromkeys(quads, False)
    np.testing.assert_allclose(report.jacobian_ratio, 1, rtol=1e-9)
    assert report.is_degenerate.tolist() == [False, False, False, True, True, False]
    assert int(report.degenerate) == 2
    # a reflection inverts whatever had a sign
    report = jm.quality(mesh, points * [-1, 1])
    assert report.is_inverted.tolist() == [True, True, True, False, False, True]
    assert int(report.inverted) == 4


def test_non_convex_quads_and_hexahedra_are_found_by_their_corners():
    points, cells = box((2, 2))
    moved = points.copy()
    moved[0] = [0.6, 0.6]
    report = jm.quality(jm.Mesh(points, {"quad": cells}), moved)
    assert float(report.volume_ratio[0]) > 0
    assert report.is_inverted.tolist() == [True, False, False, False]
    assert float(report.jacobian[0]) == pytest.approx(0.4 * 0.4 - 0.6 * 0.6)
    assert jm.quality(jm.Mesh(moved, {"quad": cells})).is_inverted.tolist() == [
        True,
        False,
        False,
        False,
    ]
    points, cells = box((1, 1, 1))
    moved = points.copy()
    moved[0] = [0.75, 0.75, 0.75]
    report = jm.quality(jm.Mesh(points, {"hexahedron": cells}), moved)
    assert float(report.volume[0]) > 0
    assert float(report.jacobian[0]) < 0
    assert int(report.inverted) == 1


def test_a_mesh_alone_is_judged_whatever_its_numbering():
    mesh = tetrahedra()
    assert int(jm.quality(mesh).inverted) == 0
    inner = np.setdiff1d(np.arange(len(mesh.points)), np.unique(Delaunay(mesh.points).convex_hull))
    points = np.array(mesh.points)
    points[inner] = points[inner].mean(axis=0) + 0.4 * (
        points[inner[::-1]] - points[inner].mean(axis=0)
    )
    alone, relative = jm.quality(mesh.moved(points)), jm.quality(mesh, points)
    assert int(relative.inverted) > 0
    np.testing.assert_array_equal(alone.is_inverted, relative.is_inverted)
    # two parts of opposite handedness, far from each other
    quads, cells = box((3, 2))
    parts = jm.Mesh(
        np.vstack([quads, quads + 10]), {"quad": np.vstack([cells, cells[:, ::-1] + len(quads)])}
    )
    assert int(jm.quality(parts).inverted) == 0


def test_handedness_is_found_from_ids():
    cells = np.array(box((3, 2, 2))[1])
    flip = np.random.default_rng(3).random(len(cells)) < 0.5
    cells[flip] = cells[flip][:, [0, 3, 2, 1, 4, 7, 6, 5]]
    sign, part = handedness({"hexahedron": cells}, *neighbours({"hexahedron": cells}))
    assert set(part) == {part[0]}
    assert set(sign * np.where(flip, -1, 1)) in ({1}, {-1})
    strip = np.array([[0, 1, 3, 2], [2, 3, 5, 4], [4, 5, 0, 1]])  # a Moebius strip
    sign, _ = handedness({"quad": strip}, *neighbours({"quad": strip}))
    assert sign.tolist() == [1, 1, 1]


def test_neighbours_are_those_of_scipy_and_the_same_when_traced():
    cells = {"tetra": tetrahedra().cells["tetra"]}
    neighbour, flipped = neighbours(cells)
    expected = Delaunay(tetrahedra().points).neighbors
    np.testing.assert_array_equal(np.sort(neighbour.reshape(-1, 4)), np.sort(expected))
    alone = jm.Mesh(tetrahedra().points, cells)
    traced = jax.jit(lambda mesh: link(mesh).neighbour)(alone)
    np.testing.assert_array_equal(neighbour, traced)
    assert not flipped[neighbour < 0].any()
    # a face of three cells belongs to none of them
    fan = {"triangle": np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4], [1, 2, 5]])}
    assert neighbours(fan)[0].reshape(4, 3).tolist() == [
        [-1, 3, -1],
        [-1, -1, -1],
        [-1, -1, -1],
        [0, -1, -1],
    ]


def test_gradients_are_those_of_differences():
    """Other types of cells: `test_quality_derivatives.py`."""
    random = np.random.default_rng(5)
    points, cells = box((2, 2))
    mesh = jm.Mesh(points, {"quad": cells})
    points = jnp.asarray(mesh.points + 0.03 * random.normal(size=mesh.points.shape))
    weight = random.random(sum(map(len, mesh.cells.values())))

    def weighted(points):
        report = jm.quality(mesh, points)
        return jnp.stack([weight @ getattr(report, name) for name in MEASURES])

    direction, step, function = random.normal(size=points.shape), 1e-6, jax.jit(weighted)
    difference = (function(points + step * direction) - function(points - step * direction)) / (
        2 * step
    )
    gradient = jax.jit(jax.jacrev(weighted))(points)
    np.testing.assert_allclose(
        jnp.sum(gradient * direction[None], axis=(1, 2)), difference, rtol=1e-5
    )


@over("kind", ["quad"], nightly=[kind for kind in KINDS if kind != "quad"])
def test_what_the_host_measures_is_what_traces_batches_and_meshes_as_arguments_do(kind):
    mesh = reflected(scattered(kind))
    points = shaken(mesh, 0.05, 2)
    for measure in (jm.quality, lambda mesh, points: jm.quality(mesh.moved(points))):
        host, traced = measure(mesh, points), jax.jit(functools.partial(measure, mesh))(points)
        batched = jax.jit(jax.vmap(functools.partial(measure, mesh)))(
            np.stack([mesh.points, points])
        )
        assert batched.inverted.shape == (2,)
        for found in (
            traced,
            jax.jit(measure)(mesh, points),
            jax.tree.map(lambda a: a[1], batched),
        ):
            for name in (*MEASURES, "is_inverted", "is_degenerate", "centroid"):
                at = f"{name} {kind}"
                np.testing.assert_allclose(
                    getattr(found, name), getattr(host, name), rtol=1e-9, atol=1e-9, err_msg=at
                )
            for name in ("inverted", "mean_skewness", "max_aspect_ratio", "min_jacobian_ratio"):
                assert float(getattr(found, name)) == pytest.approx(
                    float(getattr(host, name)), rel=1e-9
                )


@pytest.mark.nightly
def test_cells_in_blocks_are_the_same_and_so_are_derivatives(monkeypatch):
    """20 quads in two blocks, 32 triangles in three and a part; the oracle is all of them together."""
    points, quads = box((6, 6))
    cells = {
        "quad": quads[:20],
        "triangle": np.concatenate([quads[20:, [0, 1, 2]], quads[20:, [0, 2, 3]]]),
    }
    mesh = jm.Mesh(points, cells)
    rng = np.random.default_rng(3)
    moved, weights = (
        jnp.asarray(points + 0.05 * rng.normal(size=points.shape)),
        rng.normal(size=(4, 52)),
    )

    def objective(points):
        report, smooth = jm.quality(mesh, points), jm.smooth_quality(mesh, points)
        values = (
            report.skewness,
            report.non_orthogonality,
            report.jacobian_ratio,
            smooth.aspect_ratio,
        )
        return sum(jnp.vdot(w, value) for w, value in zip(weights, values, strict=True))

    def found():
        slope = jax.jit(jax.grad(objective))(moved)
        return jm.quality(mesh), jm.quality(mesh, moved), jm.smooth_quality(mesh, moved), slope

    whole = found()
    monkeypatch.setattr(vector, "VALUES_OF_BLOCK", 10)
    monkeypatch.setattr(vector, "CACHED", 10)
    jax.clear_caches()
    for a, b in zip(jax.tree.leaves(whole), jax.tree.leaves(found()), strict=True):
        np.testing.assert_allclose(b, a, rtol=1e-12, atol=1e-13)
    jax.clear_caches()


def test_float32_in_float32_out():
    mesh = scattered("quad")
    report, smooth = (
        measure(mesh, mesh.points.astype(np.float32)) for measure in (jm.quality, jm.smooth_quality)
    )
    assert smooth.aspect_ratio.dtype == np.float32
    assert all(
        leaf.dtype == np.float32
        for leaf in jax.tree.leaves(report)
        if jnp.issubdtype(leaf.dtype, jnp.floating)
    )
    np.testing.assert_allclose(report.skewness, jm.quality(mesh).skewness, atol=1e-5)


def test_thin_cells_far_from_the_origin_keep_their_sign_and_angle():
    """First cells of 1e-6 at 20 chords, in float64."""
    points, cells = box((4, 3))
    mesh = jm.Mesh(points * [1e-2, 1e-6] + [20, 0], {"quad": cells})
    report = jm.quality(mesh, mesh.points + np.array([0.3, 0.2]))
    assert int(report.inverted) == int(report.degenerate) == 0
    np.testing.assert_allclose(report.jacobian_ratio, 1, rtol=1e-8)
    assert float(report.max_non_orthogonality) < 1e-6


def test_the_table_fits_a_terminal():
    mesh = tetrahedra()
    report = jm.quality(mesh, mesh.points - [0, 0, 1e-4])
    text = str(report)
    assert max(map(len, text.splitlines())) <= 80
    assert (
        text.splitlines()[0]
        == f"{len(mesh.cells['tetra'])} tetra: 0 inverted, 0 degenerate from the start"
    )
    assert [line.split()[0] for line in text.splitlines()[2:]] == list(MEASURES)
    assert "volume_ratio" not in str(jm.quality(mesh))
    several = jax.tree.map(lambda values: jnp.stack([values, values, values]), report)
    assert str(several) == repr(several)
    assert several.inverted.tolist() == several.degenerate.tolist() == [0, 0, 0]
    np.testing.assert_allclose(several.mean_skewness, np.full(3, report.mean_skewness), rtol=1e-14)


def test_nan_is_never_fine():
    points, cells = box((2, 1))
    moved = points.copy()
    moved[0] = np.nan
    assert jm.quality(jm.Mesh(points, {"quad": cells}), moved).is_inverted.tolist() == [True, False]


@pytest.mark.parametrize("kind", ["quad", "hexahedron", "tetra", "wedge"])
def test_flags_alone_are_those_of_the_report(kind):
    mesh = scattered(kind, count=300)
    points = shaken(mesh, 0.3, 4)
    expected = np.asarray(jm.quality(mesh, points).is_inverted)
    assert 0 < expected.sum() < 300
    np.testing.assert_array_equal(jm.inverted(mesh, points), expected)
    with pytest.raises(ValueError, match="this mesh has"):
        jm.inverted(mesh, points[:-1])
