"""Independent oracles: VTK and closed forms for flat meshes, the textbook RBF system, Jacobians by differences."""

import jax
import numpy as np
import pytest
import pyvista
from scipy.spatial import cKDTree

import jaxmorph as jm


def polydata(mesh: jm.Mesh) -> pyvista.PolyData:
    quads = mesh.cells["quad"]
    faces = np.column_stack([np.full(len(quads), 4), quads]).ravel()
    return pyvista.PolyData(np.column_stack([mesh.points, np.zeros(len(mesh.points))]), faces)


def boundary_edges(mesh: jm.Mesh) -> np.ndarray:
    """Directed edges that one cell alone has, cell on their left."""
    quads = mesh.cells["quad"]
    directed = np.stack([quads, np.roll(quads, -1, axis=1)], axis=-1).reshape(-1, 2)
    _, first, count = np.unique(np.sort(directed, axis=1), axis=0, return_index=True, return_counts=True)
    assert count.max() == 2
    return directed[first[count == 1]]


def shoelace(points: np.ndarray, edges: np.ndarray) -> float:
    a, b = points[edges[:, 0]], points[edges[:, 1]]
    return 0.5 * float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))


def check_geometry(mesh: jm.Mesh) -> None:
    """Convex, counter-clockwise, no coincident points, boundary = patches, no overlap."""
    quality = polydata(mesh).cell_quality(["scaled_jacobian", "area"])
    assert quality["scaled_jacobian"].min() > 0
    corners = mesh.points[mesh.cells["quad"]]
    diagonals = corners[:, 2:] - corners[:, :2]
    areas = 0.5 * (diagonals[:, 0, 0] * diagonals[:, 1, 1] - diagonals[:, 0, 1] * diagonals[:, 1, 0])
    np.testing.assert_allclose(areas, quality["area"], rtol=1e-6, atol=1e-16)
    distances, _ = cKDTree(mesh.points).query(mesh.points, k=2)
    assert distances[:, 1].min() > 9e-13
    edges = boundary_edges(mesh)
    np.testing.assert_array_equal(np.unique(edges), mesh.patch("airfoil", "farfield"))
    assert not np.intersect1d(mesh.patch("airfoil"), mesh.patch("farfield")).size
    assert len(edges) == len(mesh.patch("airfoil", "farfield"))
    assert areas.sum() == pytest.approx(shoelace(mesh.points, edges), rel=1e-12)


def wendland(distance, radius):
    x = np.minimum(distance / radius, 1)
    return (1 - x) ** 4 * (4 * x + 1)


def dense(points, sources, values, phi, degree):
    """The textbook system (eq. 3), solved by NumPy in the mesh's own coordinates."""
    tail = np.concatenate([np.ones((len(sources), 1)), sources], axis=1)[
        :, : {None: 0, 0: 1, 1: 1 + sources.shape[1]}[degree]
    ]
    distance = np.linalg.norm(sources[:, None] - sources[None], axis=2)
    matrix = np.block([[phi(distance), tail], [tail.T, np.zeros((tail.shape[1],) * 2)]])
    weights = np.linalg.solve(matrix, np.concatenate([values, np.zeros((tail.shape[1], values.shape[1]))]))
    there = np.concatenate([np.ones((len(points), 1)), points], axis=1)[:, : tail.shape[1]]
    kernel = phi(np.linalg.norm(points[:, None] - sources[None], axis=2))
    return kernel @ weights[: len(sources)] + there @ weights[len(sources) :]


def jacobian(function, x, step):
    """Jacobians of a tree of arrays by each component of x, from central differences of three steps; the error is of step^6."""
    x = np.asarray(x, dtype=float)

    def column(place):
        tangent = np.zeros(x.size)
        tangent[place] = 1.0
        tangent = tangent.reshape(x.shape)

        def central(h):
            ahead, behind = function(x + h * tangent), function(x - h * tangent)
            return jax.tree.map(lambda a, b: (np.asarray(a) - np.asarray(b)) / (2 * h), ahead, behind)

        def refined(coarse, middle, fine):
            first, second = (4 * middle - coarse) / 3, (4 * fine - middle) / 3
            return (16 * second - first) / 15

        return jax.tree.map(refined, *(central(step / share) for share in (1, 2, 4)))

    columns = [column(place) for place in range(x.size)]
    return jax.tree.map(lambda *parts: np.stack(parts, axis=-1).reshape(*parts[0].shape, *x.shape), *columns)
