"""Linear finite elements of each cell type: derivatives of shape functions at quadrature points."""

import functools
import itertools

import numpy as np

_CUBE = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)])
_COLLAPSED = {
    "quad": (0, 1, 2, 3),
    "hexahedron": (0, 1, 2, 3, 4, 5, 6, 7),
    "wedge": (0, 1, 2, 2, 3, 4, 5, 5),
    "pyramid": (0, 1, 2, 3, 4, 4, 4, 4),
}
"""Corner of the cell at each corner of a square or cube: pairs make a wedge, four a pyramid."""


@functools.cache
def quadrature(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Computes derivatives (q, corners, d) of the shape functions, and weights (q,).

    Derivatives are by the reference coordinates. A simplex has one point. A quad has its four
    corners, with the linear triangles of the corners and their neighbours: the mean of both ways to
    cut the quad. Other types have two Gauss points in every direction.
    """
    if kind in ("triangle", "tetra"):
        d = 2 if kind == "triangle" else 3
        return np.concatenate([-np.ones((1, d)), np.eye(d)])[None], np.array([1 / (2 if d == 2 else 6)])
    target = np.array(_COLLAPSED[kind])
    d = 2 if kind == "quad" else 3
    corners = _CUBE[: len(target), :d]
    gauss = 0.5 - 12**-0.5, 0.5 + 12**-0.5
    places = corners.astype(float) if kind == "quad" else np.array(list(itertools.product(gauss, repeat=d)))
    factors = np.where(corners[None] == 1, places[:, None], 1 - places[:, None])  # (q, corners, d)
    signs = np.where(corners == 1, 1.0, -1.0)
    derivatives = np.stack([signs[:, i] * np.delete(factors, i, axis=2).prod(axis=2) for i in range(d)], axis=2)
    summed = np.einsum("qcd,ca->qad", derivatives, np.eye(target.max() + 1)[target])
    return summed, np.full(len(places), 1 / len(places))
