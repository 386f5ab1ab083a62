"""Springs along the edges (Batina 1990), and against closing angles (Farhat et al. 1998)."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._host.cells.topology import EDGES, FRAMES
from ..base import number
from .cells import AbstractCellMethod, all_pairs


class SpringAnalogy(AbstractCellMethod):
    """Holds each edge by a spring that acts in all directions (Batina 1990).

    It needs the mesh's cells, of which it takes the edges alone.

    **Arguments:**

    - `exponent`: a spring is as stiff as 1 / length^exponent. Default 2.

    **Raises:** `prepare` raises a `ValueError` for points without cells.
    """

    exponent: Float[Array, ""] = eqx.field(converter=number("exponent"), default=2.0)

    def pairs(self, kind):
        return EDGES[kind] if kind != "triangle" else all_pairs(kind)

    def entries(self, kind, corners, distance):
        i, j = np.array(self.pairs(kind)).T
        squared = jnp.sum((corners[j] - corners[i]) ** 2, axis=1)
        has_length = squared > 0
        stiff = jnp.where(has_length, squared, 1) ** (-self.exponent.astype(corners.dtype) / 2)
        return -jnp.where(has_length, stiff, jnp.inf)


class TorsionalSprings(AbstractCellMethod):
    """Holds each edge by a spring, and each angle by a spring that grows stiff as it closes.

    It needs the mesh's cells. In 2-D it is the method of Farhat et al. (1998): springs against
    changes of the angles of each triangle. A quad has the triangles at its four corners. In 3-D it
    is the semi-torsional method (Zeng and Ethier 2005). An edge of a tetrahedron is as stiff as 1 /
    sin^2 of the angle between the two faces that do not hold it. Other cells have the tetrahedra at
    their corners.

    **Arguments:**

    - `lineal`: stiffness of the springs along edges, times 1 / length^2, so that scaling the mesh
      changes nothing. Farhat et al. have 1 / length. Default 0.1.

    **Raises:** `prepare` raises a `ValueError` for points without cells.
    """

    lineal: Float[Array, ""] = eqx.field(converter=number("lineal", 0, ends="[)"), default=0.1)

    def entries(self, kind, corners, distance):
        place = {pair: k for k, pair in enumerate(self.pairs(kind))}
        d = corners.shape[1]
        total: list = [jnp.zeros((d, d) if d == 2 else (), corners.dtype)] * len(place)
        simplices = FRAMES[kind]
        for simplex in simplices:
            parts = (_triangle if d == 2 else _tetrahedron)(
                corners[np.array(simplex)], self.lineal.astype(corners.dtype)
            )
            for (a, b), part in parts.items():
                i, j = simplex[a], simplex[b]
                k, part = (place[i, j], part) if i < j else (place[j, i], part.T)
                total[k] = total[k] + part
        return jnp.stack(total)


def _triangle(corners: Float[Array, "3 2"], lineal: Float[Array, ""]) -> dict[tuple[int, int], Float[Array, "2 2"]]:
    """Computes the blocks of a triangle's three torsional and three lineal springs."""
    parts = dict.fromkeys(((0, 1), (0, 2), (1, 2)), jnp.zeros((2, 2), corners.dtype))
    for i, j in parts:
        edge = corners[j] - corners[i]
        squared = jnp.sum(edge**2)
        parts[i, j] = parts[i, j] - lineal * edge[:, None] * edge[None] / squared**2
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        to_j, to_k = corners[j] - corners[i], corners[k] - corners[i]
        squared_j, squared_k = jnp.sum(to_j**2), jnp.sum(to_k**2)
        area = to_j[0] * to_k[1] - to_j[1] * to_k[0]
        stiff = squared_j * squared_k / area**2  # 1 / sin^2
        turn = jnp.array([[0.0, -1.0], [1.0, 0.0]], corners.dtype)
        rate = {j: -(turn @ to_j) / squared_j, k: (turn @ to_k) / squared_k}
        rate[i] = -rate[j] - rate[k]
        for a, b in parts:
            parts[a, b] = parts[a, b] + stiff * rate[a][:, None] * rate[b][None]
    return parts


def _tetrahedron(corners: Float[Array, "4 3"], lineal: Float[Array, ""]) -> dict[tuple[int, int], Float[Array, ""]]:
    """Computes the stiffness of a tetrahedron's six edges.

    The stiffness has a lineal part, and a part by the angle between the faces opposite to the ends.
    """
    parts = {}
    for i, j in all_pairs("tetra"):
        k, m = (corner for corner in range(4) if corner not in (i, j))
        edge = corners[m] - corners[k]  # the two faces opposite to edge ij share the other edge
        normal_i = jnp.cross(edge, corners[i] - corners[k])
        normal_j = jnp.cross(edge, corners[j] - corners[k])
        both = jnp.sum(normal_i**2) * jnp.sum(normal_j**2)
        sine = jnp.sum(jnp.cross(normal_i, normal_j) ** 2)
        squared = jnp.sum((corners[j] - corners[i]) ** 2)
        parts[i, j] = -(lineal + both / sine) / squared
    return parts
