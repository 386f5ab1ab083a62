"""Bodies with boundary layers in channels and boxes, filled by gmsh; what happens on their way."""

import numpy as np
from meshes import circle

import jaxmorph as jm


def layered(
    wall: np.ndarray, sides: tuple[float, float, float, float], spacing: float, layers: int = 6
) -> jm.Mesh:
    """Quads in layers around a body (m, 2), counterclockwise, and triangles up to a rectangle."""
    from jaxmorph._advice.fill import Sizes, fill

    m = len(wall)
    along = np.roll(wall, -1, axis=0) - np.roll(wall, 1, axis=0)
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    heights = 0.01 * (1.5 ** np.arange(layers + 1) - 1) / 0.5
    rings = (wall[None] + heights[:, None, None] * normal[None]).reshape(-1, 2)
    ids = np.arange(len(rings)).reshape(-1, m)
    after = np.roll(ids, -1, axis=1)
    quads = np.stack([ids[:-1], ids[1:], after[1:], after[:-1]], axis=2).reshape(-1, 4)
    left, right, bottom, top = sides
    nx, ny = (max(2, round(length / spacing)) for length in (right - left, top - bottom))
    x = left + (right - left) * np.arange(nx) / nx
    y = bottom + (top - bottom) * np.arange(ny) / ny
    box = np.concatenate(
        [
            np.stack([x, np.full(nx, bottom)], axis=1),
            np.stack([np.full(ny, right), y], axis=1),
            np.stack([left + right - x, np.full(nx, top)], axis=1),
            np.stack([np.full(ny, left), bottom + top - y], axis=1),
        ]
    )
    outer = len(rings) + np.arange(len(box))
    points = np.concatenate([rings, box])
    border = np.concatenate(
        [np.stack([after[-1], ids[-1]], axis=1), np.stack([outer, np.roll(outer, -1)], axis=1)]
    )
    # sizes grow with the distance from the body
    grid = np.stack(np.meshgrid(np.linspace(left, right, 81), np.linspace(bottom, top, 41)), axis=2)
    away = np.linalg.norm(grid - wall.mean(axis=0), axis=2)
    edge = np.linalg.norm(rings[ids[-1]] - rings[after[-1]], axis=1).mean()
    size = np.minimum(edge + 0.25 * np.maximum(away - np.ptp(wall, axis=0).max() / 2, 0), spacing)
    a, b = [grid[j : j + 40, i : i + 80].reshape(-1, 2) for j in (0, 1) for i in (0, 1)][::3], None
    corners, values = [], []
    for shifts in (((0, 0), (0, 1), (1, 1)), ((0, 0), (1, 1), (1, 0))):
        corners.append(np.stack([grid[j : j + 40, i : i + 80].reshape(-1, 2) for j, i in shifts], 1))
        values.append(np.stack([size[j : j + 40, i : i + 80].ravel() for j, i in shifts], 1))
    sizes = Sizes(np.concatenate(corners), np.concatenate(values))
    new, triangles = fill(points, border, np.zeros(len(border), int), sizes)
    patches = {"body": ids[0], "channel": outer}
    return jm.Mesh(np.concatenate([points, new]), {"quad": quads, "triangle": triangles}, patches)


class Way:
    """What happened on the way of a relay."""

    def __init__(self, plan: jm.Plan, mesh: jm.Mesh, wall, **options):
        self.state = jm.Relay(plan, mesh, **options)
        lines = jm.wall_quality(mesh, wall)
        self.wall = np.asarray(lines.nodes)
        self.first = self.heights(mesh, mesh.points)
        self.replaced, self.inverted, self.low, self.high = [], [], [], []

    def heights(self, mesh, points):
        lines = first_line_heights(mesh, points, self.wall)
        return lines
