"""Bodies with boundary layers in channels and boxes, and what becomes of them on their way."""

import dataclasses
import itertools

import numpy as np
from meshes import ball, grid, tetrahedra

import jaxmorph as jm
from jaxmorph._host.cells.first_lines import first_lines

HEIGHT = 0.006
RATIO = 1.25
"""Height of the first cells at bodies, and its growth."""


def box_sides(sides, spacing: float) -> np.ndarray:
    """The corners and inner points of the edges of a rectangle, counterclockwise."""
    left, right, bottom, top = sides
    corners = np.array([[left, bottom], [right, bottom], [right, top], [left, top]], float)
    after = np.roll(corners, -1, axis=0)
    counts = [
        max(2, round(np.abs(b - a).sum() / spacing)) for a, b in zip(corners, after, strict=True)
    ]
    steps = [np.arange(count)[:, None] / count for count in counts]
    return np.concatenate([a + t * (b - a) for a, b, t in zip(corners, after, steps, strict=True)])


def stacked(wall: np.ndarray, normal: np.ndarray, layers: int) -> np.ndarray:
    """Points of layers (layers + 1, m, d) on a wall (m, d)."""
    heights = HEIGHT * (RATIO ** np.arange(layers + 1) - 1) / (RATIO - 1)
    return wall[None] + heights[:, None, None] * normal[None]


def growing(points: np.ndarray, corners: np.ndarray, centre, least: float, most: float):
    """Sizes of new cells on a lattice of simplices: they grow with the distance from a centre."""
    from jaxmorph._advice.fill import Sizes

    away = np.linalg.norm(points - centre, axis=1)
    sizes = np.clip(least + 0.2 * (away - 0.7), least, most)
    return Sizes(points[corners], sizes[corners])


def layered(wall: np.ndarray, sides, spacing: float, layers: int = 9) -> jm.Mesh:
    """Quads in layers around a body (m, 2), counterclockwise, and triangles up to a rectangle."""
    from jaxmorph._advice.fill import fill_region

    along = np.roll(wall, -1, axis=0) - np.roll(wall, 1, axis=0)
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    rings = stacked(wall, normal, layers).reshape(-1, 2)
    ids = np.arange(len(rings)).reshape(-1, len(wall))
    after = np.roll(ids, -1, axis=1)
    quads = np.stack([ids[:-1], ids[1:], after[1:], after[:-1]], axis=2).reshape(-1, 4)
    box = box_sides(sides, spacing)
    outer = len(rings) + np.arange(len(box))
    edges = [np.stack([after[-1], ids[-1]], axis=1), np.stack([outer, np.roll(outer, -1)], axis=1)]
    left, right, bottom, top = sides
    lattice = grid(np.linspace(left, right, 99), np.linspace(bottom, top, 41))
    corners = np.asarray(lattice.cells["quad"])[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
    least = np.linalg.norm(rings[ids[-1]] - rings[after[-1]], axis=1).mean()
    size = growing(np.asarray(lattice.points), corners, wall.mean(axis=0), least, spacing)
    border = np.concatenate(edges)
    points = np.concatenate([rings, box])
    new, triangles = fill_region(points, border, np.zeros((len(border), 2), int), size)
    cells = {"quad": quads, "triangle": triangles}
    return jm.Mesh(np.concatenate([points, new]), cells, {"body": ids[0], "box": outer})


@dataclasses.dataclass
class Way:
    """What a relay has done on its way: for each move the share of cells replaced, 0 without."""

    state: jm.Relay
    replaced: list[float]
    inverted: int
    heights: tuple[float, float]
    """The least and largest height of first cells, over that in the beginning."""

    @property
    def gaps(self) -> np.ndarray:
        """Numbers of moves before the first hand-over, and between them."""
        return np.diff(np.flatnonzero([1, *self.replaced]))


def travel(state: jm.Relay, wall: np.ndarray, path) -> Way:
    """Moves along a path, and measures the cells at each of its ends."""
    mesh = state.mesh
    cells = {kind: np.asarray(ids) for kind, ids in mesh.cells.items()}
    lines = first_lines(cells, mesh.topology.outer(wall), np.asarray(mesh.points), wall)
    nodes = lines.nodes
    ends = lines.ends
    start = np.linalg.norm(np.asarray(mesh.points)[ends] - np.asarray(mesh.points)[nodes], axis=1)
    way = Way(state, [], 0, (1.0, 1.0))
    for u in path:
        state = state.moved(u)
        made = state.remeshed
        if made is not None:
            nodes = made.of_old[nodes]
            ends = made.of_old[ends]
        x = np.asarray(state.points)
        ratios = np.linalg.norm(x[ends] - x[nodes], axis=1) / start
        way.state = state
        way.replaced.append(made.replaced if made is not None else 0.0)
        way.inverted += int(jm.quality(state.mesh.moved(x)).inverted)
        way.heights = (min(way.heights[0], ratios.min()), max(way.heights[1], ratios.max()))
    return way


def around_sphere(count: int, sides, spacing: float, layers: int = 5) -> jm.Mesh:
    """Wedges in layers around a ball of diameter 1, and tetrahedra up to a box."""
    from jaxmorph._advice.fill import fill_region

    unit, faces = ball(count)
    rings = stacked(unit / 2, unit, layers).reshape(-1, 3)
    ids = np.arange(len(rings)).reshape(-1, count)
    inwards = faces[:, ::-1]
    wedges = np.concatenate(
        [np.hstack([low[inwards], high[inwards]]) for low, high in itertools.pairwise(ids)]
    )
    axes = [np.linspace(low, high, 1 + round((high - low) / spacing)) for low, high in sides]
    lattice = grid(*axes)
    outer, _ = lattice.topology.outer()["quad"]
    used, quads = np.unique(outer, return_inverse=True)
    quads = quads.reshape(-1, 4) + len(rings)
    border = np.concatenate([ids[-1][inwards], quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    points = np.concatenate([rings, np.asarray(lattice.points)[used]])
    cubes = np.arange(len(lattice.points)).reshape([len(axis) for axis in axes])
    least = np.linalg.norm(np.diff(rings[ids[-1]][faces[:, :2]], axis=1), axis=2).mean()
    size = growing(np.asarray(lattice.points), tetrahedra(cubes), np.zeros(3), least, spacing)
    shells = np.zeros((len(border), 2), int)
    shells[len(faces) :, 1] = 1
    new, tetra = fill_region(points, border, shells, size)
    patches = {"body": ids[0], "box": np.arange(len(rings), len(points))}
    return jm.Mesh(np.concatenate([points, new]), {"wedge": wedges, "tetra": tetra}, patches)
