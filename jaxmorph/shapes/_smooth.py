"""Shapes along a wall: smoothing (Sobolev gradients, vertex morphing), and growth and erosion along
its normals, as far as its sides leave room.
"""

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PyTree
from numpy import ndarray
from scipy import sparse
from scipy.sparse.linalg import splu

from jaxmorph import Facets, Mesh
from jaxmorph.extend import Tree, between, checked, finite_array, host_call, norm, rows_of

from ._arguments import Column, Numbers, Positions, known_positions, positions
from ._features import Borders, Planes, borders_of, normals_beside
from ._shape import AbstractLinearShape, AbstractShape, Move
from ._tolerances import SAME_LENGTH
from ._walls import FANS, faces_of, wall_faces

SMOOTHING_BALLS = 40  # tried at a node at most: the last ones hardly differ
NO_BALL = 1e30  # radius where no ball touches another node

FOUR = [*FANS[4], (0, 1, 3), (1, 2, 3)]
"""Triangles of half weight in place of a quad."""


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

    masses: Column
    rows: Int[Array, " e"]
    columns: Int[Array, " e"]
    values: Float[Array, " e"]
    free: Column
    dimension: int = eqx.field(static=True)
    solve: Callable[[ndarray], ndarray] = eqx.field(static=True)

    @checked
    def __init__(self, points: Numbers, faces: Any, length: float, *, held: Any = ()):
        known = known_positions(points, "points").astype(float)
        kinds = faces_of(faces, known.shape)
        between("length", length, 0, ends="[)")
        held = rows_of("held", held, len(known))
        masses, stiffness = _linear_elements(known, kinds)
        if (masses <= 0).any():
            raise ValueError(
                f"{(masses <= 0).sum()} nodes are in no face, first row {int(np.argmin(masses))}."
            )
        free = np.ones(len(known))
        free[held] = 0
        mask = sparse.diags(free)
        matrix = (mask @ (length**2 * stiffness) @ mask + sparse.diags(masses)).tocoo()
        self.solve = symmetric_factors(matrix).solve
        self.dimension = known.shape[1]
        self.masses = jnp.asarray(masses)
        self.free = jnp.asarray(free)
        self.rows = jnp.asarray(matrix.row)
        self.columns = jnp.asarray(matrix.col)
        self.values = jnp.asarray(matrix.data)

    @staticmethod
    @checked
    def on(mesh: Mesh, patch: str, length: float, *, held: Any = ()) -> "Smoother":
        """Makes the smoother of a mesh's patch; row i is node `mesh.patch(patch)[i]`.

        **Raises:** `ValueError` as the class does, and for a patch without faces.
        """
        nodes = mesh.patch(patch)
        own_rows = [np.searchsorted(nodes, ids) for ids in wall_faces(mesh, patch).values()]
        return Smoother(np.asarray(mesh.points)[nodes], own_rows, length, held=held)

    def neutral(self) -> Positions:
        return jnp.zeros((len(self.masses), self.dimension))

    def at(self, x: Numbers) -> Move:
        positions(x, like=(len(self.masses), self.dimension))
        return self.apply

    def apply(self, u: Numbers) -> Positions:
        """Filters displacements (m, d)."""
        u = positions(u, "u")
        free = self.free.astype(u.dtype)[:, None]
        return free * solve_along(self, self.masses.astype(u.dtype)[:, None] * free * u)

    def sensitivities(self, gradient: Numbers) -> Positions:
        """Filters sensitivities dJ/d(position) of the nodes: the transpose."""
        gradient = positions(gradient, "gradient")
        free = self.free.astype(gradient.dtype)[:, None]
        masses = self.masses.astype(gradient.dtype)[:, None]
        return free * masses * solve_along(self, free * gradient)


def matrix_of(smoother: Smoother) -> Any:
    """Returns M + length^2 K (m, m), without the held rows' stiffness."""
    return sparse.coo_matrix((smoother.values, (smoother.rows, smoother.columns)))


def sparse_product(matrix: Any, v: Float[Array, "m k"]) -> Float[Array, "m k"]:
    """Multiplies the matrix of `values` at `rows` and `columns` by columns `v`."""
    terms = matrix.values.astype(v.dtype)[:, None] * v[matrix.columns]
    return jnp.zeros_like(v).at[matrix.rows].add(terms)


def solve_along(smoother: Smoother, right: Float[Array, "m k"]) -> Float[Array, "m k"]:
    """Solves (M + length^2 K) v = right."""

    def solve(_, b):
        in_double = lambda right: smoother.solve(np.asarray(right, float))  # noqa: E731
        return host_call(in_double, jax.ShapeDtypeStruct(b.shape, b.dtype), b)

    product = functools.partial(sparse_product, smoother)
    return jax.lax.custom_linear_solve(product, right, solve, symmetric=True)


def symmetric_factors(matrix: Any) -> Any:
    """Factors a symmetric matrix that is positive definite, its rows permuted as its columns."""
    options = {"SymmetricMode": True}
    return splu(matrix.tocsc(), "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)


def _linear_elements(points: ndarray, kinds: list[ndarray]) -> tuple[ndarray, Any]:
    """Assembles lumped masses (m,) and the stiffness matrix (m, m) of linear elements."""
    m = len(points)
    cuts = [(ids, corners) for ids in kinds for corners in {**FANS, 4: FOUR}[ids.shape[1]]]
    ids = np.concatenate([own[:, corners] for own, corners in cuts])
    weight = np.concatenate([np.full(len(own), 0.5 if own.shape[1] == 4 else 1) for own, _ in cuts])
    size, local = stiffness_of(points[ids])
    if (size <= 0).any():
        raise ValueError(
            f"{(size <= 0).sum()} faces have no size, first with nodes "
            f"{ids[int(np.argmin(size))].tolist()}."
        )
    shares = np.broadcast_to((weight * size / ids.shape[1])[:, None], ids.shape)
    masses = np.bincount(ids.ravel(), shares.ravel(), m)
    places = [part.ravel() for part in np.broadcast_arrays(ids[:, :, None], ids[:, None])]
    stiffness = sparse.coo_matrix(((weight[:, None, None] * local).ravel(), places), (m, m))
    return masses, stiffness


def stiffness_of(corners: Any) -> tuple[Any, Any]:
    """Returns sizes (k,) and stiffnesses (k, c, c) of segments or triangles (k, c, d)."""
    xp = np if isinstance(corners, ndarray) else jnp
    if corners.shape[1] == 2:
        size = norm(corners[:, 1] - corners[:, 0])
        local = np.array([[1, -1], [-1, 1]], size.dtype)[None]
        scale = xp.where(size > 0, size, 1)
    else:
        sides = xp.roll(corners, -1, axis=1) - xp.roll(corners, -2, axis=1)  # opposite each corner
        size = 0.5 * norm(xp.cross(sides[:, 0], sides[:, 1]))
        local = xp.einsum("kia,kja->kij", sides, sides)
        scale = 4 * xp.where(size > 0, size, 1)
    return size, local / scale[:, None, None]


class Offset(AbstractShape):
    """Moves a wall along its normals: growth of ice, erosion, change of thickness.

    Sides that would meet stop before. A node goes no farther than a `share` of its distance from
    the medial axis: the radius of the largest ball that touches the wall there, and holds no node.
    Up to half of that it goes all the way, beyond smoothly less.

    **Arguments:**

    - `wall`: such as `Facets.of(mesh, "wing")`; its normals look into the mesh.
    - `field`: heights (m,) that a single parameter scales; negative ones erode. Default None: the
      parameters are the heights (m,) of all nodes.
    - `length`: heights are smoothed as by a `Smoother` of this length. Default 0: as they are.
    - `symmetry`: planes in which the border of the wall stays. Default: none.
    - `share`: from 0 to 1. Default 0.9.

    **Raises:** `ValueError` for a field of another shape, and as `Smoother` does.

    Source: Ma, Bae and Choi, 3D medial axis point approximation using nearest neighbors and the
    normal field, The Visual Computer 28, 2012.
    """

    wall: Facets
    field: Column | None
    smoother: Smoother | None
    borders: Borders
    touching: Int[ndarray | Array, "2 m"]  # of growth, then of erosion; the node itself: none
    share: float

    @checked
    def __init__(
        self,
        wall: Facets,
        field: Numbers | None = None,
        *,
        length: float = 0.0,
        symmetry: Planes = (),
        share: float = 0.9,
    ):
        between("share", share, 0, 1, ends="(]")
        between("length", length, 0, ends="[)")
        x = np.asarray(wall.points, float)
        self.wall = wall
        self.share = share
        self.borders = borders_of(wall, symmetry)
        self.field = None
        if field is not None:
            heights = finite_array("field", field, (len(x),))
            self.field = jnp.asarray(heights, wall.points.dtype)
        self.smoother = Smoother(x, np.asarray(wall.faces), length) if length else None
        normals = np.asarray(normals_beside(self.borders, wall.at(x)), float)
        self.touching = np.stack([_touching(x, sign * normals) for sign in (1, -1)])

    def neutral(self) -> Float[Array, "..."]:
        return jnp.zeros(
            len(self.wall.points) if self.field is None else (), self.wall.points.dtype
        )

    def __call__(self, x: Numbers, parameters: PyTree) -> Positions:
        x = positions(x, like=self.wall.points.shape)
        heights = jnp.asarray(parameters, x.dtype)
        needed = self.neutral().shape
        if heights.shape != needed:
            raise ValueError(f"`parameters` have shape {heights.shape}; this shape needs {needed}.")
        heights = heights if self.field is None else heights * self.field.astype(x.dtype)
        if self.smoother is not None:
            heights = self.smoother.apply(jnp.stack([heights, heights], axis=1))[:, 0]
        normals = normals_beside(self.borders, self.wall.at(x))
        ahead, back = (self._radius(x, sign * normals, k) for k, sign in enumerate((1, -1)))
        room = self.share * jnp.where(heights > 0, ahead, back)
        ratio = jnp.abs(heights) / room
        # equal in value, slope and curvature at one half
        limited = jnp.where(
            ratio > 0.5, room * (0.5 + 0.5 * jnp.tanh(2 * ratio - 1)), jnp.abs(heights)
        )
        return x + (jnp.where(heights < 0, -1, 1) * limited)[:, None] * normals

    def _radius(self, x: Positions, ahead: Positions, side: int) -> Column:
        arm = x[self.touching[side]] - x
        above = jnp.sum(arm * ahead, axis=1)
        return jnp.where(
            above > 0, jnp.sum(arm**2, axis=1) / jnp.where(above > 0, 2 * above, 1), NO_BALL
        )


def _touching(x: ndarray, ahead: ndarray) -> ndarray:
    """Finds the node that the largest ball at each node touches; the node itself without one."""
    # A ball shrinks onto the node that is nearest to its centre, until none is inside.
    tree = Tree(x)
    found = np.arange(len(x))
    radius = np.full(len(x), 10 * np.ptp(x, axis=0).max())
    for _ in range(SMOOTHING_BALLS):
        distance, other = map(np.asarray, tree.query(x + radius[:, None] * ahead))
        arm = x[other] - x
        above = np.sum(arm * ahead, axis=1)
        is_inside = (distance < radius * (1 - SAME_LENGTH)) & (above > 0)
        if not is_inside.any():
            break
        radius = np.where(
            is_inside, np.sum(arm**2, axis=1) / np.where(is_inside, 2 * above, 1), radius
        )
        found = np.where(is_inside, other, found)
    return found
