"""Smoothing along a wall: Sobolev gradients, vertex morphing."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy import sparse
from scipy.sparse.linalg import splu

from jaxmorph import Mesh
from jaxmorph.extend import between, checked, host_call, norm, rows_of

from ._arguments import Numbers, known_positions, positions
from ._shape import AbstractLinearShape, Move
from ._walls import faces_of, wall_faces


class Smoother(AbstractLinearShape):
    """Smooths along a wall: waves much shorter than `length` vanish.

    It solves (I + length^2 L) v = u, with the wall's Laplace-Beltrami operator L: with linear
    elements and lumped masses M, v = (M + length^2 K)^-1 M u. As a shape its parameters are (m, d):
    vertex morphing.

    **Arguments:**

    - `points`: (m, d) the wall's nodes.
    - `faces`: ids (k, 2) of segments in 2-D; (k, 3) or (k, 4) of triangles or quads in 3-D, one
      array or several.
    - `length`: in the units of the points.
    - `held`: rows of nodes that stay, such as the wall's border; all others end freely.

    **Raises:** `ValueError` for a negative length, ids that are no rows, faces without size, and
    nodes of no face.
    """

    masses: Float[Array, " m"]
    rows: Int[Array, " e"]
    columns: Int[Array, " e"]
    values: Float[Array, " e"]
    free: Float[Array, " m"]
    dimension: int = eqx.field(static=True)
    solve: Callable[[np.ndarray], np.ndarray] = eqx.field(static=True)

    @checked
    def __init__(self, points: Numbers, faces: Any, length: float, *, held: Any = ()):
        known = known_positions(points, "points").astype(float)
        pieces = _pieces(faces, known)
        between("length", length, 0, ends="[)")
        held = rows_of("held", held, len(known))
        masses, stiffness = _elements(known, pieces)
        if (masses <= 0).any():
            raise ValueError(f"{(masses <= 0).sum()} nodes are in no face, first row {int(np.argmin(masses))}.")
        free = np.ones(len(known))
        free[held] = 0
        mask = sparse.diags(free)
        matrix = (mask @ (length**2 * stiffness) @ mask + sparse.diags(masses)).tocoo()
        factors = splu(matrix.tocsc(), "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        self.solve, self.dimension = factors.solve, known.shape[1]
        self.masses, self.free = jnp.asarray(masses), jnp.asarray(free)
        self.rows, self.columns, self.values = (jnp.asarray(part) for part in (matrix.row, matrix.col, matrix.data))

    @staticmethod
    @checked
    def on(mesh: Mesh, patch: str, length: float, *, held: Any = ()) -> "Smoother":
        """Makes the smoother of a mesh's patch; row i is node `mesh.patch(patch)[i]`.

        **Raises:** `ValueError` as the class does, and for a patch without faces.
        """
        nodes = mesh.patch(patch)
        own_rows = [np.searchsorted(nodes, ids) for ids in wall_faces(mesh, patch).values()]
        return Smoother(np.asarray(mesh.points)[nodes], own_rows, length, held=held)

    def neutral(self) -> Float[Array, "m d"]:
        return jnp.zeros((len(self.masses), self.dimension))

    def at(self, x: Numbers) -> Move:
        if positions(x).shape != self.neutral().shape:
            raise ValueError(f"`x` has shape {positions(x).shape}; this wall has {self.neutral().shape}.")
        return self.apply

    def apply(self, u: Numbers) -> Float[Array, "m d"]:
        """Filters displacements (m, d)."""
        u = positions(u, "u")
        free = self.free.astype(u.dtype)[:, None]
        return free * self._solved(self.masses.astype(u.dtype)[:, None] * free * u)

    def sensitivities(self, gradient: Numbers) -> Float[Array, "m d"]:
        """Filters sensitivities dJ/d(position) of the nodes: the transpose."""
        gradient = positions(gradient, "gradient")
        free = self.free.astype(gradient.dtype)[:, None]
        return free * self.masses.astype(gradient.dtype)[:, None] * self._solved(free * gradient)

    def _solved(self, right: Float[Array, "m d"]) -> Float[Array, "m d"]:
        def product(v):
            return jnp.zeros_like(v).at[self.rows].add(self.values.astype(v.dtype)[:, None] * v[self.columns])

        def solve(_, b):
            in_double = lambda right: self.solve(np.asarray(right, float))  # noqa: E731
            return host_call(in_double, jax.ShapeDtypeStruct(b.shape, b.dtype), b)

        return jax.lax.custom_linear_solve(product, right, solve, symmetric=True)


def _pieces(faces: Any, points: np.ndarray) -> list[tuple[np.ndarray, float]]:
    """Cuts faces into segments or triangles: a quad into four triangles of half weight."""
    corners = [(0, 1, 2), (0, 2, 3), (0, 1, 3), (1, 2, 3)]
    return [
        (np.concatenate([ids[:, three] for three in corners]), 0.5) if ids.shape[1] == 4 else (ids, 1.0)
        for ids in faces_of(faces, points.shape)
    ]


def _elements(points: np.ndarray, pieces: list[tuple[np.ndarray, float]]) -> tuple[np.ndarray, Any]:
    """Assembles lumped masses (m,) and the stiffness matrix (m, m) of linear elements."""
    m = len(points)
    masses, stiffness = np.zeros(m), sparse.csr_matrix((m, m))
    for ids, weight in pieces:
        size, local = stiffness_of(points[ids])
        if (size <= 0).any():
            raise ValueError(
                f"{(size <= 0).sum()} faces have no size, first with nodes {ids[int(np.argmin(size))].tolist()}."
            )
        np.add.at(masses, ids, weight * np.broadcast_to(size[:, None] / ids.shape[1], ids.shape))
        places = [np.broadcast_to(rows, local.shape).ravel() for rows in (ids[:, :, None], ids[:, None, :])]
        stiffness = stiffness + sparse.coo_matrix((weight * local.ravel(), places), (m, m)).tocsr()
    return masses, stiffness


def stiffness_of(corners: Any) -> tuple[Any, Any]:
    """Returns sizes (k,) and stiffnesses (k, c, c) of segments or triangles (k, c, d)."""
    xp = np if isinstance(corners, np.ndarray) else jnp
    if corners.shape[1] == 2:
        size = norm(corners[:, 1] - corners[:, 0])
        local, scale = np.array([[1, -1], [-1, 1]])[None], xp.where(size > 0, size, 1)
    else:
        sides = xp.roll(corners, -1, axis=1) - xp.roll(corners, -2, axis=1)  # opposite each corner
        size = 0.5 * norm(xp.cross(sides[:, 0], sides[:, 1]))
        local, scale = xp.einsum("kia,kja->kij", sides, sides), 4 * xp.where(size > 0, size, 1)
    return size, local / scale[:, None, None]
