"""A smooth metric on a wall: one variable a node, and shapes that an optimiser does not roughen."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy import sparse

from jaxmorph import Facets
from jaxmorph.extend import checked

from ._arguments import Column, Numbers, rows_like, vector
from ._features import Borders, Planes, borders_of, normals_beside
from ._shape import AbstractLinearShape, Move
from ._smooth import Smoother, matrix_of, solve_along, sparse_product, symmetric_factors


class SobolevMetric(AbstractLinearShape):
    """Moves each node of a wall along its normal, by variables of a smooth metric.

    The Euclidean length of the variables (v,) is the Sobolev norm of the heights h: |q|^2 is the
    wall's mean of h^2 + length^2 |grad h|^2. A gradient by the variables is thus a Sobolev
    gradient, and an optimiser takes about as many steps on a fine wall as on a coarse one.

        metric = shapes.SobolevMetric(jm.Facets.of(mesh, "body"), 0.3, symmetry=axis)
        u = shapes.displacement(metric, plan, q)
        gradient = shapes.pullback(metric, plan, q, dJ_dpoints)

    There is a variable for each node, of nodes at one place one for all. It does not belong to that
    node alone: bounds of variables bound no heights.

    **Arguments:**

    - `wall`: such as `jm.Facets.of(mesh, "body")`, or `jm.Facets(points, faces)` without a mesh.
    - `length`: in the units of the wall. Waves much shorter cost the metric more. 0: the mean of
      h^2 alone.
    - `symmetry`: planes in which the border of the wall stays. Default: none.
    - `held`: rows of nodes that stay. Default: none; the wall's border ends freely.

    **Raises:** `ValueError` as `Smoother` does, and for a plane of another dimension.
    """

    wall: Facets
    smoother: Smoother
    borders: Borders
    rows: Int[Array, " e"]
    columns: Int[Array, " e"]
    values: Float[Array, " e"]
    vertex_of: Int[Array, " m"]

    @checked
    def __init__(self, wall: Facets, length: float, *, symmetry: Planes = (), held: Any = ()):
        self.wall = wall
        self.borders = borders_of(wall, symmetry)
        # nodes at one place are one vertex, and have one height
        vertices, vertex_of = np.unique(np.asarray(wall.welded), return_inverse=True)
        points = np.asarray(wall.points, float)[vertices]
        held = vertex_of[rows_like("held", held, len(vertex_of))]
        smoother = Smoother(points, vertex_of[np.asarray(wall.faces)], length, held=held)
        # h = A^-1 C q with A = C C^T: then |q|^2 = h^T A h, and a solve with A is all it needs
        root = _root_of(matrix_of(smoother)).tocoo()
        self.rows = jnp.asarray(root.row)
        self.columns = jnp.asarray(root.col)
        self.values = jnp.asarray(root.data * np.sqrt(np.sum(smoother.masses)))
        self.smoother = smoother
        self.vertex_of = jnp.asarray(vertex_of)

    def neutral(self) -> Column:
        return jnp.zeros(len(self.smoother.masses), self.wall.points.dtype)

    def at(self, x: Numbers) -> Move:
        normals = normals_beside(self.borders, self.wall.at(jnp.asarray(x)))
        return lambda q: self.heights(q).astype(normals.dtype)[:, None] * normals

    def heights(self, q: Numbers) -> Column:
        """Computes the heights (m,) of variables (v,)."""
        q = vector("q", q, jnp.asarray(self.wall.points), self.neutral().shape)
        free = self.smoother.free.astype(q.dtype)[:, None]
        h = free * solve_along(self.smoother, free * sparse_product(self, q[:, None]))
        return h[self.vertex_of, 0]


def _root_of(matrix: Any) -> Any:
    """Computes C of a positive definite matrix C C^T; C is sparse, and triangular up to rows."""
    factors = symmetric_factors(matrix)
    diagonal = sparse.diags(np.sqrt(factors.U.diagonal()))
    return (factors.L @ diagonal).tocsr()[factors.perm_r]
