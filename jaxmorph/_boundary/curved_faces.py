"""Walls made of a patch's own curved faces: the polynomials of the cells' sides."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._host.cells.lagrange import lagrange_types
from .._host.cells.pieces import boundary_sides, linear_cells
from .._host.cells.topology import SHAPES, solid
from .._mesh.mesh import Mesh
from .slide import faces_around
from .walls import BLOCK, AbstractWall, Faceted

SEARCH, POLISH = 8, 2
"""Steps of Gauss and Newton inside each face near a point; of Newton on the nearest face."""


class CurvedFaces(Faceted):
    """The curved faces of one type between nodes: lines in 2-D. They follow the base points.

    - `nodes`, `vertices`, `faces`, `around`: as in `Faceted`, for linear pieces of the faces.
    - `sides` (q, s): the nodes of each face, as rows of `vertices`; their type is `kind`.
    - `near` (v, c): curved faces near every vertex; the last face fills up a row.
    """

    sides: Int[Array | np.ndarray, "q s"]
    near: Int[Array | np.ndarray, "v c"]
    kind: str = eqx.field(static=True)

    def at(self, points):
        return self._with(self.nodes, points[self.nodes])

    def renumbered(self, place):
        return self._with(place[np.asarray(self.nodes)], self.vertices)

    def _with(self, nodes, vertices) -> "CurvedFaces":
        return CurvedFaces(nodes, vertices, self.faces, self.around, self.sides, self.near, self.kind)

    def nearest(self, x):
        """Finds the nearest points of the faces, and the normals there."""
        vertices = jnp.asarray(self.vertices, x.dtype)
        return jax.lax.map(lambda point: self._on_sides(point, vertices), x, batch_size=BLOCK)

    def _on_sides(
        self, x: Float[Array, " d"], vertices: Float[Array, "v d"]
    ) -> tuple[Float[Array, " d"], Float[Array, " d"]]:
        powers, matrix = polynomials(self.kind)
        nodes = jnp.asarray(self.sides)[jnp.asarray(self.near)[jnp.argmin(jnp.sum((vertices - x[None]) ** 2, axis=1))]]
        corners = vertices[nodes]
        coefficients = jnp.einsum("ks,wsd->wkd", jnp.asarray(matrix, x.dtype), corners, precision="highest")
        first = jnp.argmin(jnp.sum((corners - x[None, None]) ** 2, axis=2), axis=1)
        start = jnp.asarray(lagrange_types()[self.kind].reference, x.dtype)[first]
        place = functools.partial(_place, powers=powers)
        found = jax.lax.stop_gradient(jax.vmap(self._searched, in_axes=(None, 0, 0))(x, start, coefficients))
        distances = jnp.sum((jax.vmap(place)(found, coefficients) - x[None]) ** 2, axis=1)
        chosen = jnp.argmin(jax.lax.stop_gradient(distances))
        at, own = found[chosen], coefficients[chosen]
        # the last steps go beyond the face, and carry derivatives also of a node on its edge
        for _ in range(POLISH):
            gradient = jax.grad(lambda at: jnp.sum((place(at, own) - x) ** 2))
            at = at - _solved(jax.jacfwd(gradient)(at), gradient(at))
        slope = jax.jacfwd(place)(at, own)
        normal = jnp.cross(slope[:, 0], slope[:, 1]) if len(x) == 3 else jnp.stack([slope[1, 0], -slope[0, 0]])
        length = jnp.sqrt(jnp.sum(normal**2))
        return place(at, own), normal / jnp.where(length > 0, length, 1)

    def _searched(
        self, x: Float[Array, " d"], start: Float[Array, " e"], coefficients: Float[Array, "k d"]
    ) -> Float[Array, " e"]:
        """Finds the coordinates of a face's place near x, inside of the face."""
        place = functools.partial(_place, powers=polynomials(self.kind)[0])
        is_triangle = SHAPES[self.kind] == "triangle"

        def nearer(at, _):
            slope, off = jax.jacfwd(place)(at, coefficients), place(at, coefficients) - x
            right = jnp.sum(slope * off[:, None], axis=0)
            step = _solved(jnp.sum(slope[:, :, None] * slope[:, None], axis=0), right)
            at = jnp.clip(at - jnp.clip(step, -0.5, 0.5), 0, 1)
            return at / jnp.maximum(jnp.sum(at), 1) if is_triangle else at, None

        return jax.lax.scan(nearer, start, length=SEARCH)[0]


def _place(at: Float[Array, " e"], coefficients: Float[Array, "k d"], powers: np.ndarray) -> Float[Array, " d"]:
    """Evaluates a face's polynomial; powers are products, safe at zero in every derivative."""
    table = [jnp.ones_like(at)]
    for _ in range(int(powers.max())):
        table.append(table[-1] * at)
    table = jnp.stack(table)
    monomials = functools.reduce(jnp.multiply, [table[powers[:, axis], axis] for axis in range(powers.shape[1])])
    return jnp.sum(monomials[:, None] * coefficients, axis=0)


def _solved(matrix: Float[Array, "e e"], right: Float[Array, " e"]) -> Float[Array, " e"]:
    """Solves for one or two unknowns; a singular matrix gives zero."""
    if len(right) == 1:
        return right / jnp.where(matrix[0] != 0, matrix[0], jnp.inf)
    whole = matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0]
    first = matrix[1, 1] * right[0] - matrix[0, 1] * right[1]
    second = matrix[0, 0] * right[1] - matrix[1, 0] * right[0]
    return jnp.stack([first, second]) / jnp.where(whole != 0, whole, jnp.inf)


@functools.cache
def polynomials(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Returns exponents (k, e) of a side's polynomial, and coefficients (k, s) by its nodes."""
    name, completion = lagrange_types()[kind].completion()
    complete = lagrange_types()[name]
    monomials = np.prod(complete.reference[:, None] ** complete.lattice[None], axis=2)
    return complete.lattice, np.linalg.solve(monomials, completion)


def with_own_curves(
    walls: list[tuple[AbstractWall, np.ndarray]], mesh: Mesh | None
) -> list[tuple[AbstractWall, np.ndarray]]:
    """Replaces the linear pieces of walls by the curved faces that they are pieces of.

    Walls whose faces are of two types, or that have faces across holes, keep their pieces.
    """
    if mesh is None or not mesh.is_curved:
        return walls
    return [(_curved(wall, mesh) if type(wall) is Faceted else wall, nodes) for wall, nodes in walls]


def _curved(wall: Faceted, mesh: Mesh) -> AbstractWall:
    cells = {kind: np.asarray(ids) for kind, ids in solid(mesh.cells, mesh.points.shape[1]).items()}
    nodes = np.asarray(wall.nodes)
    sides = {kind: ids for kind, ids in boundary_sides(cells, len(mesh.points), nodes).items() if len(ids)}
    pieces = sum(len(ids) * (2 if kind == "quad" else 1) for kind, ids in linear_cells(sides).items())
    if len(sides) != 1 or pieces != len(wall.faces):
        return wall
    ((kind, ids),) = sides.items()
    place = np.full(len(mesh.points), -1)
    place[nodes] = np.arange(len(nodes))
    rows = place[ids].astype(np.int32)
    rows = rows[np.lexsort(np.sort(rows, axis=1).T)]
    near = faces_around(rows, len(nodes))
    return CurvedFaces(wall.nodes, wall.vertices, wall.faces, wall.around, rows, near, kind)
