"""Delaunay graph mapping (Liu, Qin and Xia 2006; section 2.3 of the paper, eqs. 6 to 9)."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._host.linear.products import cofactors, dot
from .._host.package.cores import Beside
from .._host.surface.graph import Graph, graph_of, locate
from .base import AbstractMethod, AbstractPlacing
from .sparse import InterpolatedField, Interpolation
from .surface import Surface


class DelaunayGraph(AbstractPlacing):
    """Moves each point with the simplex of surface nodes that holds it (eq. 8).

    The graph stands on the undeformed surface and carries displacements, so that the map is one
    linear operator for any motion. A surface node follows itself alone; the first of duplicate
    nodes (moving before fixed) stands in the graph. The graph is discontinuous in the base
    coordinates: nodes on one circle or sphere can be joined in several ways. Coordinates are
    rounded first, far below the distance of nodes, so that round-off does not choose.

    **Raises:** `prepare` raises a `ValueError` for points outside of the surface's convex hull.
    """

    def connect(self, surface: Surface, points):
        rows = surface.rows(len(points))
        vertices = np.repeat(rows[:, None], points.shape[1] + 1, axis=1)  # a node of the surface: itself, d + 1 times
        inside = np.flatnonzero(rows == len(surface.points))
        if inside.size:
            vertices[inside] = locate(_begun(surface).result(), points, inside)
        return None, vertices

    def fit(self, ids, surface, points):
        return None

    def place(self, x, ids, factors, surface):
        e = barycentric(x, [surface[i] for i in ids], ids[0] == ids[1])
        return Interpolation(ids, jnp.stack(e))

    def field(self, ids, factors, surface, u):
        return InterpolatedField(u)


def begin_graph(method: AbstractMethod, surface: Surface, count: int) -> None:
    """Starts a method's graph in the background, if it has one and points are off the surface."""

    def is_graph(leaf: object) -> bool:
        return isinstance(leaf, DelaunayGraph)

    if count > (surface.nodes >= 0).sum() and any(map(is_graph, jax.tree.leaves(method, is_leaf=is_graph))):
        _begun(surface)


def _begun(surface: Surface) -> Beside[Graph]:
    return surface.once("graph", lambda: Beside(graph_of, surface.points))


def barycentric(x: Float[Array, " d"], corners: list[Float[Array, " d"]], at_node) -> list[Float[Array, ""]]:
    edges = [corner - corners[0] for corner in corners[1:]]
    rows = cofactors(edges)
    whole = jnp.where(at_node, 1, dot(rows[0], edges[0]))
    parts = [jnp.where(at_node, 0, dot(row, x - corners[0]) / whole) for row in rows]
    return [1 - sum(parts, start=jnp.zeros_like(whole)), *parts]
