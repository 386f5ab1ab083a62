"""First grid lines off a wall, from the cells' own polynomials; linear cells are of order 1."""

import functools
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from ..linear.products import dot_rows, row_lengths
from ..rows import mark
from ..tolerances import NO_WEIGHT
from .lagrange import PLACES, derivatives_at_nodes, lagrange_types, shape_values
from .topology import CORNERS, DIMENSION, EDGES, FACES, SHAPES, ByType, Pair


class WallSides(NamedTuple):
    """Sides of cells of one type on the wall."""

    ids: ndarray  # (f, s) nodes of each side
    rows: ndarray  # (f, s) their rows among the wall nodes; without a line the row after them
    sign: ndarray  # (f,) 1 or -1, of triangles the half, so that area vectors point into the mesh
    slopes: ndarray  # (s, s, d - 1) derivatives of the shape functions at the nodes of a side

    def areas(self, x: Any) -> Any:
        """Area vectors (f, s, d) at the nodes of the sides, by NumPy or JAX."""
        return _node_areas(x[self.ids], self.slopes.astype(x.dtype)) * self.sign[
            :, None, None
        ].astype(x.dtype)


class Lines(NamedTuple):
    """First grid lines of w wall nodes, and the sides of the wall by type."""

    nodes: ndarray  # (w,) ids of the wall nodes
    ends: ndarray  # (w,) ids of the other ends of their lines
    near: ndarray  # (w, k) nodes of a sum, the derivative along a line at its wall node
    weights: ndarray  # (w, k) their weights in it
    beside: ndarray  # (w,) ids of neighbours on the wall
    sides: tuple[WallSides, ...]

    def directions(self, x: Any) -> Any:
        """Derivatives (w, d) along the lines at their wall nodes, by NumPy or JAX."""
        return (x[self.near] * self.weights[:, :, None].astype(x.dtype)).sum(axis=1)

    def areas(self, x: Any) -> list[tuple[Any, Any]]:
        """Rows (e,) of wall nodes, with the area vectors (e, d) of the sides there."""
        return [(side.rows.ravel(), side.areas(x).reshape(-1, x.shape[1])) for side in self.sides]


def _node_areas(x: Any, slopes: Any) -> Any:
    """Area vectors (f, s, d) of sides x (f, s, d) at their own nodes."""
    nodes, axes = (range(size) for size in slopes.shape[1:])
    along: list[Any] = [
        sum(slopes[None, :, k, axis, None] * x[:, k, None] for k in nodes) for axis in axes
    ]
    a, *others = along
    if not others:
        return a[..., ::-1] * np.array([[[-1.0, 1.0]]], dtype=x.dtype)
    (b,) = others
    after = np.array([1, 2, 0])
    before = np.array([2, 0, 1])
    return a[..., after] * b[..., before] - a[..., before] * b[..., after]


def first_lines(cells: ByType, sides: Mapping[str, Pair], points: ndarray, wall: ndarray) -> Lines:
    """Picks, for every wall node, the grid line off the wall that is nearest to the wall's normal.
    From a node inside of an edge or a side, a line goes to the node opposite. Of the `sides` among
    the wall nodes, each has its cell, numbered as in `cells`. Raises `ValueError` for none.
    """
    on_wall = mark(len(points), wall)
    centre = np.concatenate([_centres(kind, ids, points) for kind, ids in cells.items()])
    walls = {
        kind: _wall_sides(kind, ids, centre[owner], points) for kind, (ids, owner) in sides.items()
    }
    if not any(len(side.ids) for side in walls.values()):
        raise ValueError(
            f"no cell has a boundary side whose nodes are all among the {len(wall)} wall nodes: "
            "name the nodes of a patch."
        )
    normal = np.zeros(points.shape)
    beside = np.full(len(points), -1)
    for kind, side in walls.items():
        np.add.at(normal, side.ids, side.areas(points))
        beside[side.ids.T] = side.ids.T[_nodes_beside(kind)]
    largest = {kind: ids for kind, ids in cells.items() if DIMENSION[kind] == points.shape[1]}
    start, end, cell_nodes, weights = _candidates(largest, on_wall & (beside >= 0), on_wall)
    along = (points[cell_nodes] * weights[:, :, None]).sum(axis=1)
    size = row_lengths(along)
    steepness = np.round(dot_rows(along, normal[start]) / np.where(size > 0, size, 1), 12)
    order = np.lexsort((end, -steepness, start))
    nodes, first = np.unique(start[order], return_index=True)
    chosen = order[first]
    place = np.full(len(points), len(nodes))
    place[nodes] = np.arange(len(nodes))
    every = tuple(side._replace(rows=place[side.ids]) for side in walls.values())
    return Lines(nodes, end[chosen], cell_nodes[chosen], weights[chosen], beside[nodes], every)


def _nodes_beside(kind: str) -> ndarray:
    """A node beside each of a side's nodes: the corner before, or the nearest on the lattice."""
    cell = lagrange_types()[kind]
    if cell.order == 1:
        return np.arange(cell.corners) - 1
    squared = np.sum((cell.lattice[:, None] - cell.lattice) ** 2, axis=2)
    return np.where(squared > 0, squared, squared.max() + 1).argmin(axis=1)


def _centres(kind: str, ids: ndarray, points: ndarray) -> ndarray:
    return points[ids[:, : CORNERS[SHAPES[kind]]]].mean(axis=1)


def _wall_sides(kind: str, ids: ndarray, inside: ndarray, points: ndarray) -> WallSides:
    """Sides of one type, each with a place (f, d) in its cell; rows are ids here."""
    slopes = derivatives_at_nodes(kind)
    if SHAPES[kind] == kind:  # of a linear side their mean, the whole face's
        slopes = np.broadcast_to(slopes.mean(axis=0), slopes.shape)
    area = _node_areas(points[ids], slopes).mean(axis=1)
    is_outward = dot_rows(area, inside - _centres(kind, ids, points)) < 0
    size = 0.5 if SHAPES[kind] == "triangle" else 1
    return WallSides(ids, ids, np.where(is_outward, -size, size), slopes)


def _candidates(cells: ByType, starts: ndarray, on_wall: ndarray) -> tuple[ndarray, ...]:
    """Lines from `starts` to nodes off the wall: start, end, nodes and weights (l, k)."""
    width = max((len(row) for kind in cells for *_, row, _ in _list_lines(kind)), default=1)
    parts = []
    for kind, ids in cells.items():
        near = ids[starts[ids].any(axis=1)]
        for first, last, nodes, weights in _list_lines(kind):
            chosen = near[starts[near[:, first]] & ~on_wall[near[:, last]]]
            fill = width - len(nodes)
            row = np.pad(chosen[:, nodes], ((0, 0), (0, fill)))
            factor = np.broadcast_to(np.pad(weights, (0, fill)), row.shape)
            parts.append((chosen[:, first], chosen[:, last], row, factor))
    return tuple(np.concatenate(part) for part in zip(*parts, strict=True))


@functools.cache
def _list_lines(kind: str) -> tuple[tuple[int, int, ndarray, ndarray], ...]:
    """Lines of a type that may leave a wall: start, end, and weights of some nodes."""
    cell = lagrange_types()[kind]
    lines = []
    ends = derivatives_at_nodes("line" if cell.order == 1 else f"line{cell.order + 1}")[:2, :, 0]
    for edge in cell.edges:
        first, last = edge[:2].tolist()
        lines += [(first, last, edge, ends[0]), (last, first, edge, -ends[1])]
    slopes = derivatives_at_nodes(kind)
    corners = np.array(PLACES[cell.shape])
    for face, (side, nodes) in zip(FACES[cell.shape], cell.sides, strict=True):
        beyond = corners[[opposite_corner(cell.shape, face, corner) for corner in face]]
        ends = np.rint(
            cell.order * shape_values(SHAPES[side], lagrange_types()[side].reference) @ beyond
        ).astype(int)
        inner = nodes >= cell.corners
        for node, last in zip(
            nodes[inner].tolist(), cell.nodes_at(ends[inner]).tolist(), strict=True
        ):
            weights = slopes[node] @ (cell.reference[last] - cell.reference[node])
            near = np.flatnonzero(np.abs(weights) > NO_WEIGHT * np.abs(weights).max())
            lines.append((node, last, near, weights[near]))
    return tuple(lines)


def opposite_corner(shape: str, face: tuple[int, ...], corner: int) -> int:
    """The corner opposite a face's corner: its only neighbour off the face, else itself."""
    others = [end for edge in EDGES[shape] if corner in edge for end in edge if end not in face]
    return others[0] if len(others) == 1 else corner
