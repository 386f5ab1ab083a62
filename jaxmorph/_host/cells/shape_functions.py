"""Shape functions of cells of high order: their derivatives, and where det J is looked at.

The functions of a node are 1 there and 0 at the other nodes. Their space is that of polynomials
whose exponents are the lattice; for a pyramid the space of Bergot et al. (J. Sci. Comput. 42,
2010), polynomials in (x / (1 - z), y / (1 - z), 1 - z). A place in a pyramid is given by x / (1 -
z), y / (1 - z), z here, by which its apex has directions.
"""

import functools
import itertools

import numpy as np
from numpy.polynomial import legendre

from .lagrange import Lagrange, depth, lagrange_types


@functools.cache
def derivatives_at_nodes(kind: str) -> np.ndarray:
    """Returns derivatives (s, nodes, d) of the shape functions at the nodes of a type.

    They are by the reference coordinates.
    """
    return derivatives(kind, collapsed(kind, lagrange_types()[kind].reference))


@functools.cache
def jacobian_samples(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Returns shape function derivatives (s, nodes, d) where det J is measured, and weights (s,).

    Places are a lattice twice as fine as that of the nodes, where weights are 0, and Gauss points
    of the exact volume.
    """
    cell = lagrange_types()[kind]
    d, fine = cell.dimension, 2 * cell.order
    grid = np.indices((fine + 1,) * d).reshape(d, -1).T
    if cell.shape != "pyramid":  # a pyramid has a lattice in its own coordinates
        grid = grid[depth(cell.shape, fine, grid) >= 0]
    nodes, weights = np.polynomial.legendre.leggauss(-(-d * cell.order // 2))
    cube = np.array(list(itertools.product((nodes + 1) / 2, repeat=d)))
    weight = np.array(list(itertools.product(weights / 2, repeat=d))).prod(axis=1)
    places, factor = _of_cube(cell.shape, cube)
    every = np.concatenate([grid / fine, places])
    return derivatives(kind, every), np.concatenate([np.zeros(len(grid)), weight * factor])


def derivatives(kind: str, places: np.ndarray) -> np.ndarray:
    """Computes derivatives (s, nodes, d) of the shape functions of a type at places (s, d)."""
    (_, slopes), inverse, completion = _expanded(kind, places)
    return np.einsum("skd,kn,nm->smd", slopes, inverse, completion, optimize=True)


def values(kind: str, places: np.ndarray) -> np.ndarray:
    """Computes the shape functions (s, nodes) of a type at places (s, d)."""
    (at_places, _), inverse, completion = _expanded(kind, places)
    return at_places @ inverse @ completion


def _expanded(kind: str, places: np.ndarray) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray, np.ndarray]:
    """Returns basis and derivatives at places, and two matrices to the functions of a type."""
    name, completion = lagrange_types()[kind].completion()
    complete = lagrange_types()[name]
    at_nodes, _ = _basis(complete, collapsed(name, complete.reference))
    return _basis(complete, places), np.linalg.inv(at_nodes), completion


def _basis(cell: Lagrange, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Computes a basis (s, k) of Legendre products, and its derivatives (s, k, d)."""
    p, powers = cell.order, cell.lattice
    one = legendre.legvander(2 * places - 1, p)  # (s, d, p + 1)
    slope = np.stack([legendre.legval(2 * places - 1, legendre.legder(row) * 2) for row in np.eye(p + 1)], axis=2)
    if cell.shape == "pyramid":
        return _pyramid(one, slope, places, powers)
    picked = [one[:, axis, powers[:, axis]] for axis in range(cell.dimension)]
    slopes = [
        np.prod([*picked[:axis], slope[:, axis, powers[:, axis]], *picked[axis + 1 :]], axis=0)
        for axis in range(cell.dimension)
    ]
    return np.prod(picked, axis=0), np.stack(slopes, axis=2)


def _pyramid(
    one: np.ndarray, slope: np.ndarray, places: np.ndarray, powers: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Computes a pyramid's basis: f(a) g(b) c^n with c = 1 - z, a = x / c, b = y / c.

    n is not below the degrees of f and g.
    """
    f, g = one[:, 0, powers[:, 0]], one[:, 1, powers[:, 1]]
    df, dg = slope[:, 0, powers[:, 0]], slope[:, 1, powers[:, 1]]
    n = powers[:, :2].max(axis=1) + powers[:, 2]
    a, b, c = places[:, :1], places[:, 1:2], 1 - places[:, 2:]
    less = c ** np.maximum(n - 1, 0)
    slopes = np.stack([df * g * less, f * dg * less, (a * df * g + b * f * dg - n * f * g) * less], axis=2)
    return f * g * c**n, slopes


def collapsed(kind: str, places: np.ndarray) -> np.ndarray:
    """Maps reference places to arguments of the basis; a pyramid's apex is seen from the middle."""
    if lagrange_types()[kind].shape != "pyramid":
        return places
    c = 1 - places[:, 2:]
    return np.concatenate([np.where(c > 0, places[:, :2] / np.where(c > 0, c, 1), 0.5), places[:, 2:]], axis=1)


def _of_cube(shape: str, cube: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Maps places of a square or cube to a shape: places (s, d), and the volume's factor (s,)."""
    if shape in ("line", "quad", "hexahedron"):
        return cube, np.ones(len(cube))
    u, v = cube[:, 0], cube[:, 1]
    if shape == "pyramid":
        return cube, (1 - cube[:, 2]) ** 2
    if shape == "tetra":
        w = cube[:, 2]
        return np.stack([u * (1 - v) * (1 - w), v * (1 - w), w], axis=1), (1 - v) * (1 - w) ** 2
    return np.column_stack([u * (1 - v), v, cube[:, 2:]]), 1 - v


def node_keys(ids: np.ndarray, cell: Lagrange) -> np.ndarray:
    """Lists corners and weights in turn (k, new, 16) of each cell's new nodes.

    Corners ascend, with zeros in front.
    """
    weights = _weights(cell)
    weights = weights // np.gcd.reduce(weights, axis=1)[:, None]  # alike in cells of all types that share a face
    order = np.argsort(np.where(weights[None] > 0, ids[:, None], -1), axis=2, kind="stable")
    weights = np.take_along_axis(np.broadcast_to(weights, (len(ids), *weights.shape)), order, axis=2)
    corners = np.where(
        weights > 0, np.take_along_axis(np.repeat(ids[:, None], weights.shape[1], axis=1), order, axis=2), 0
    )
    keys = np.zeros((*weights.shape[:2], 16), np.int64)
    width = 2 * weights.shape[2]
    keys[:, :, 16 - width :] = np.stack([corners, weights], axis=3).reshape(*weights.shape[:2], width)
    return keys


def _weights(cell: Lagrange) -> np.ndarray:
    """Lists integer weights (new, corners) of corners at new nodes: 12^3 linear shape functions."""
    places = collapsed(cell.shape, cell.reference[cell.corners :])
    return np.rint(12**3 * values(cell.shape, places)).astype(np.int64)
