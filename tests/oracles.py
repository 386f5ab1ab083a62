"""Independent oracles: VTK and closed forms for flat meshes, the textbook RBF system, Jacobians by differences."""

import itertools

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
    _, first, count = np.unique(
        np.sort(directed, axis=1), axis=0, return_index=True, return_counts=True
    )
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
    areas = 0.5 * (
        diagonals[:, 0, 0] * diagonals[:, 1, 1] - diagonals[:, 0, 1] * diagonals[:, 1, 0]
    )
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
    count = {None: 0, 0: 1, 1: 1 + sources.shape[1]}[degree]
    tail = np.concatenate([np.ones((len(sources), 1)), sources], axis=1)[:, :count]
    distance = np.linalg.norm(sources[:, None] - sources[None], axis=2)
    matrix = np.block([[phi(distance), tail], [tail.T, np.zeros((tail.shape[1],) * 2)]])
    weights = np.linalg.solve(
        matrix, np.concatenate([values, np.zeros((tail.shape[1], values.shape[1]))])
    )
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
            return jax.tree.map(
                lambda a, b: (np.asarray(a) - np.asarray(b)) / (2 * h), ahead, behind
            )

        def refined(coarse, middle, fine):
            first, second = (4 * middle - coarse) / 3, (4 * fine - middle) / 3
            return (16 * second - first) / 15

        return jax.tree.map(refined, *(central(step / share) for share in (1, 2, 4)))

    columns = [column(place) for place in range(x.size)]
    return jax.tree.map(
        lambda *parts: np.stack(parts, axis=-1).reshape((*parts[0].shape, *x.shape)), *columns
    )


def jacobians_inside(
    shape: str, order: int, lattice: np.ndarray, nodes: np.ndarray, places: np.ndarray
) -> np.ndarray:
    """det J (k, s) of curved cells with nodes (k, nodes, d) at places (s, d) in the reference cell, by monomials and LAPACK.

    Those of a pyramid are r^i s^j t^k (1 - t)^max(i, j) on the cube that is collapsed: no place may be at the apex.
    """
    d = lattice.shape[1]
    every = np.array(np.meshgrid(*[range(order + 1)] * d, indexing="ij")).reshape(d, -1).T
    degrees = {
        "triangle": every.sum(axis=1),
        "tetra": every.sum(axis=1),
        "wedge": np.maximum(every[:, :2].sum(axis=1), every[:, -1]),
        "pyramid": every[:, :2].max(axis=1) + every[:, -1],
    }
    powers = every[degrees.get(shape, every.max(axis=1)) <= order]
    fall = powers[:, :2].max(axis=1) if shape == "pyramid" else np.zeros(len(powers), int)

    def values(x, axis=None):
        """Monomials (s, m) at places, or their slopes."""
        factors = [x[:, i, None] ** powers[:, i] for i in range(d)] + [(1 - x[:, -1, None]) ** fall]
        if axis is None:
            return np.prod(factors, axis=0)
        others = np.prod([f for i, f in enumerate(factors) if i != axis], axis=0)
        slope = others * powers[:, axis] * x[:, axis, None] ** np.maximum(powers[:, axis] - 1, 0)
        if axis == d - 1:
            slope -= (
                np.prod(factors[:-1], axis=0)
                * fall
                * (1 - x[:, -1, None]) ** np.maximum(fall - 1, 0)
            )
        return slope

    def cube(x):
        if shape != "pyramid":
            return x
        return np.column_stack([x[:, :2] / np.where(x[:, 2:] < 1, 1 - x[:, 2:], 1), x[:, 2]])

    slopes = np.stack([values(cube(places), axis) for axis in range(d)], axis=2)
    functions = np.linalg.inv(values(cube(lattice / order)))
    slopes = np.einsum("smj,mn->jsn", slopes, functions)
    determinants = np.linalg.det(
        np.moveaxis(np.tensordot(nodes, slopes, (1, 2)), (0, 1, 2, 3), (0, 2, 3, 1))
    )
    return determinants / (1 - places[:, 2]) ** 2 if shape == "pyramid" else determinants


def corner_areas(mesh: jm.Mesh, points) -> np.ndarray:
    """Twice the signed areas (k, 4) of the triangles at the corners of each quad, by the cross product."""
    x = np.asarray(points)[mesh.cells["quad"]]
    after, before = np.roll(x, -1, axis=1) - x, np.roll(x, 1, axis=1) - x
    return after[..., 0] * before[..., 1] - after[..., 1] * before[..., 0]


def cells_near_the_limit(cell, count: int, seed: int = 0) -> np.ndarray:
    """Random cells of one type that are about to fold: nodes (count, nodes, d)."""
    rng = np.random.default_rng(seed)
    places, more = (
        samples_inside(cell.shape, 2 * cell.order + 3),
        4 * count,
    )  # not every direction leads to a fold
    noise = rng.normal(size=(more, *cell.lattice.shape)) / cell.order

    def is_folded(share):
        nodes = cell.reference + share[:, None, None] * noise
        return jacobians_inside(cell.shape, cell.order, cell.lattice, nodes, places).min(axis=1) < 0

    low, high = np.zeros(more), np.full(more, 2.0)
    noise = noise[is_folded(high)][:count]
    low, high = low[:count], high[:count]
    for _ in range(12):
        middle = (low + high) / 2
        folded = is_folded(middle)
        low, high = np.where(folded, low, middle), np.where(folded, middle, high)
    return cell.reference + (high * (1 + 0.05 * rng.normal(size=count)))[:, None, None] * noise


def samples_inside(shape: str, count: int) -> np.ndarray:
    """Places (s, d) inside a reference cell, on a lattice of its collapsed cube; none at an apex."""
    line = np.linspace(0, 1, count)
    d = 2 if shape in ("triangle", "quad") else 3
    at = np.array(list(itertools.product(line, repeat=d)))
    if shape in ("triangle", "wedge", "tetra"):
        at[:, 0] *= 1 - at[:, 1]
    if shape == "tetra":
        at[:, :2] *= 1 - at[:, 2:]
    if shape == "pyramid":
        at[:, 2] *= 1 - 1e-3
        at[:, :2] *= 1 - at[:, 2:]
    return at
