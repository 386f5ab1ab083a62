"""First grid lines off a wall, from the cells' own polynomials; linear cells are of order 1."""

import functools
import operator
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from .lagrange import PLACES, Lagrange, derivatives_at_nodes, lagrange_types
from .pieces import owned_sides
from .topology import CORNERS, DIMENSION, FACES, SHAPES


class WallSides(NamedTuple):
    """Sides of cells of one type on the wall."""

    ids: np.ndarray  # (f, s) nodes of each side
    rows: np.ndarray  # (f, s) their rows among the wall nodes; a node without a line has the row after them
    sign: np.ndarray  # (f,) 1 or -1, of triangles the half, so that area vectors point into the mesh
    slopes: np.ndarray  # (s, s, d - 1) derivatives of the shape functions at the nodes of a side

    def areas(self, x: Any) -> Any:
        """Area vectors (f, s, d) at the nodes of the sides, by NumPy or JAX."""
        return _node_areas(x[self.ids], self.slopes.astype(x.dtype)) * self.sign[:, None, None].astype(x.dtype)


class Lines(NamedTuple):
    """First grid lines of w wall nodes, and the sides of the wall by type."""

    nodes: np.ndarray  # (w,) ids of the wall nodes
    ends: np.ndarray  # (w,) ids of the other ends of their lines
    near: np.ndarray  # (w, k) nodes of a sum, the derivative along a line at its wall node
    weights: np.ndarray  # (w, k) their weights in it
    beside: np.ndarray  # (w,) ids of neighbours on the wall
    sides: tuple[WallSides, ...]

    def directions(self, x: Any) -> Any:
        """Derivatives (w, d) along the lines at their wall nodes, by NumPy or JAX."""
        return (x[self.near] * self.weights[:, :, None].astype(x.dtype)).sum(axis=1)

    def areas(self, x: Any) -> list[tuple[Any, Any]]:
        """Rows (e,) of wall nodes, with the area vectors (e, d) of the sides there."""
        return [(side.rows.ravel(), side.areas(x).reshape(-1, x.shape[1])) for side in self.sides]


def _node_areas(x: Any, slopes: Any) -> Any:
    """Area vectors (f, s, d) of sides x (f, s, d) at their own nodes."""
    nodes = range(slopes.shape[1])
    a, *others = (
        functools.reduce(operator.add, (slopes[None, :, k, axis, None] * x[:, k, None] for k in nodes))
        for axis in range(slopes.shape[2])
    )
    if not others:
        return a[..., ::-1] * np.array([[[-1.0, 1.0]]], dtype=x.dtype)
    (b,), after, before = others, np.array([1, 2, 0]), np.array([2, 0, 1])
    return a[..., after] * b[..., before] - a[..., before] * b[..., after]


def _slopes(kind: str) -> np.ndarray:
    """Derivatives at the nodes of a side; of a linear side their mean, the whole face's."""
    slopes = derivatives_at_nodes(kind)
    return slopes if lagrange_types()[kind].order > 1 else np.broadcast_to(slopes.mean(axis=0), slopes.shape)


def first_lines(cells: Mapping[str, np.ndarray], points: np.ndarray, wall: np.ndarray) -> Lines:
    """Picks, for every wall node, the grid line off the wall that is nearest to the wall's normal.
    From a node inside of an edge or a side, a line goes to the node opposite. Raises `ValueError`
    if no boundary side of a cell has all nodes among the wall nodes.
    """
    on_wall = np.zeros(len(points), dtype=bool)
    on_wall[wall] = True
    cells = {kind: np.asarray(ids) for kind, ids in cells.items() if DIMENSION[kind] == points.shape[1]}
    sides = _sides(cells, points, wall)
    if not any(len(side.ids) for side in sides.values()):
        raise ValueError(
            f"no cell has a boundary side whose nodes are all among the {len(wall)} wall nodes: name the nodes of a patch."
        )
    normal, beside = np.zeros(points.shape), np.full(len(points), -1)
    for kind, side in sides.items():
        np.add.at(normal, side.ids, side.areas(points))
        for node in range(side.ids.shape[1]):
            beside[side.ids[:, node]] = side.ids[:, _neighbour(kind, node)]
    start, end, cell_nodes, weights = _candidates(cells, on_wall & (beside >= 0), on_wall)
    along = (points[cell_nodes] * weights[:, :, None]).sum(axis=1)
    size = np.linalg.norm(along, axis=1)
    steepness = np.round(np.sum(along * normal[start], axis=1) / np.where(size > 0, size, 1), 12)
    order = np.lexsort((end, -steepness, start))
    nodes, first = np.unique(start[order], return_index=True)
    chosen = order[first]
    place = np.full(len(points), len(nodes))
    place[nodes] = np.arange(len(nodes))
    every = tuple(side._replace(rows=place[side.ids]) for side in sides.values())
    return Lines(nodes, end[chosen], cell_nodes[chosen], weights[chosen], beside[nodes], every)


def _neighbour(kind: str, node: int) -> int:
    """A node beside a side's node: the corner before, or the nearest on the lattice."""
    cell = lagrange_types()[kind]
    if cell.order == 1:
        return node - 1
    distance = np.sum((cell.lattice - cell.lattice[node]) ** 2, axis=1).astype(float)
    distance[node] = np.inf
    return int(distance.argmin())


def _sides(cells: Mapping[str, np.ndarray], points: np.ndarray, wall: np.ndarray) -> dict[str, WallSides]:
    """Sides of single cells with all nodes on the wall, by type; rows are ids here."""
    corners = [points[ids[:, : CORNERS[SHAPES[kind]]]].mean(axis=1) for kind, ids in cells.items()]
    centre, result = np.concatenate(corners or [points[:0]]), {}
    for side, (ids, owner) in owned_sides(cells, len(points), wall).items():
        area = _node_areas(points[ids], _slopes(side)).mean(axis=1)
        inward = centre[owner] - points[ids[:, : CORNERS[SHAPES[side]]]].mean(axis=1)
        upward = np.sum(area * inward, axis=1)
        sign = np.where(upward < 0, -1, 1) * (0.5 if SHAPES[side] == "triangle" else 1)
        result[side] = WallSides(ids, ids, sign, _slopes(side))
    return result


def _candidates(
    cells: Mapping[str, np.ndarray], starts: np.ndarray, on_wall: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Lines from `starts` to nodes off the wall: start, end, nodes and weights (l, k)."""
    width = max((len(row) for kind in cells for *_, row, _ in _lines(kind)), default=1)
    parts = []
    for kind, ids in cells.items():
        near = ids[starts[ids].any(axis=1)]
        for first, last, nodes, weights in _lines(kind):
            chosen = near[starts[near[:, first]] & ~on_wall[near[:, last]]]
            fill = width - len(nodes)
            row = np.pad(chosen[:, nodes], ((0, 0), (0, fill)))
            factor = np.broadcast_to(np.pad(weights, (0, fill)), row.shape)
            parts.append((chosen[:, first], chosen[:, last], row, factor))
    start, end, nodes, weights = (np.concatenate(part) for part in zip(*parts, strict=True))
    return start, end, nodes, weights


@functools.cache
def _lines(kind: str) -> tuple[tuple[int, int, np.ndarray, np.ndarray], ...]:
    """Lines of a type that may leave a wall: start, end, and weights of some nodes."""
    cell, lines = lagrange_types()[kind], []
    ends = derivatives_at_nodes("line" if cell.order == 1 else f"line{cell.order + 1}")[:2, :, 0]
    for edge in cell.edges:
        first, last = edge[:2].tolist()
        lines += [(first, last, edge, ends[0]), (last, first, edge, -ends[1])]
    place, slopes = cell.place, derivatives_at_nodes(kind)
    for side, (_, nodes) in zip(FACES[cell.shape], cell.sides, strict=True):
        for node in nodes[nodes >= cell.corners].tolist():
            last = place[tuple(_opposite(cell, side, cell.lattice[node]))]
            weights = slopes[node] @ (cell.reference[last] - cell.reference[node])
            near = np.flatnonzero(np.abs(weights) > 1e-12 * np.abs(weights).max())
            lines.append((node, last, near, weights[near]))
    return tuple(lines)


def _opposite(cell: Lagrange, side: tuple[int, ...], at: np.ndarray) -> list[int]:
    corners, p = np.array(PLACES[cell.shape]), cell.order
    others = [k for k in range(cell.corners) if k not in side]
    if len(others) == 1:  # the apex of a simplex, or of a pyramid
        return (p * corners[others[0]]).tolist()
    if cell.shape == "wedge" and len(side) == 4:  # the other edge, at the height of the place
        return [*(p * corners[others[0]][:2]).tolist(), int(at[2])]
    is_pyramid = cell.shape == "pyramid"  # the triangle opposite, at the height of the place
    axis = int(np.flatnonzero(np.ptp(corners[list(side[: 2 if is_pyramid else 4])], axis=0) == 0)[0])
    end = at.copy()
    end[axis] = p - at[axis] - (at[2] if is_pyramid else 0)
    return end.tolist()
