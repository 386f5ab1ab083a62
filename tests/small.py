"""Meshes of a few cells for pictures."""

import numpy as np

import jaxmorph as jm


def mixed():
    """A unit square of one quad and two triangles beside it, which come after it in the mesh as in the alphabet."""
    points = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [2, 0], [2, 1]], dtype=float)
    return jm.Mesh(points, {"triangle": [[1, 4, 5], [1, 5, 2]], "quad": [[0, 1, 2, 3]]})


def bricks(k=3):
    """k^3 hexahedra in the unit cube; the patch `floor` is at z = 0."""
    ids = np.arange((k + 1) ** 3).reshape(k + 1, k + 1, k + 1)
    x, y, z = np.meshgrid(*[np.linspace(0, 1, k + 1)] * 3, indexing="ij")
    low, high = slice(0, -1), slice(1, None)
    ring = [(low, low), (high, low), (high, high), (low, high)]
    corners = np.stack([ids[(*side, end)].ravel() for end in (low, high) for side in ring], axis=1)
    points = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    return jm.Mesh(points, {"hexahedron": corners}, {"floor": ids[:, :, 0].ravel()})
