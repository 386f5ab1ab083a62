"""Parts of structured meshes: ids, cells, spacings that grow; C-grids around any section."""

from collections.abc import Callable, Sequence
from typing import NamedTuple, cast

import numpy as np
from scipy.optimize import brentq, isotonic_regression

import jaxmorph as jm
from jaxmorph.extend import between

# A section of unit chord: t in [-1, 1] -> (k, 2), from the lower trailing edge (-1) round the nose
# (0) to the upper.
Section = Callable[[np.ndarray], np.ndarray]

REFERENCE_POINTS = 39_666
NOSE_SPACING, TRAILING_EDGE_SPACING = 0.003, 1.05e-3  # chords, along the wall, on the grid of REFERENCE_POINTS
FARFIELD_X, RAY_LENGTH = 17.0, 15.0
WAKE_FIRST_CELL, WAKE_WEIGHT = 1e-3, 0.892
SMALLEST_CELL = 1e-12  # chords: what float64 still resolves at the trailing edge
LEAST_TURN = 0.1  # radians that neighbouring rays turn at least, per chord of wall between them


class Counts(NamedTuple):
    """Cells along half of the wall, along the wake, along a ray and across the base."""

    half: int
    wake: int
    normal: int
    base: int


REFERENCE = Counts(half=80, wake=50, normal=150, base=6)


def ids_of(*shape: int) -> np.ndarray:
    return np.arange(np.prod(shape)).reshape(shape)


def quads(ids: np.ndarray) -> np.ndarray:
    """Makes the cells (k, 4) of a block, counter-clockwise: rows along y, columns along x."""
    return np.stack([ids[:-1, :-1], ids[:-1, 1:], ids[1:, 1:], ids[1:, :-1]], axis=-1).reshape(-1, 4)


def hexahedra(ids: np.ndarray) -> np.ndarray:
    """Makes the cells (k, 8) of a block: layers along z, rows along y, columns along x."""
    floor, lid = ids[:-1], ids[1:]
    return np.concatenate([np.stack([quads(layer) for layer in part]) for part in (floor, lid)], axis=-1).reshape(-1, 8)


def geometric(cells: int, first: float, samples: int | None = None) -> np.ndarray:
    """Divides [0, 1] with the growth of `cells` from `first` (or evenly), by `samples` cells."""
    samples = cells if samples is None else samples
    between("first_cell", first, 0)
    if first * cells >= 1:
        return np.linspace(0, 1, samples + 1)
    growth = root(lambda beta: np.log(np.expm1(beta / cells) / np.expm1(beta) / first), 1e-9, 700.0)
    return np.expm1(growth * np.linspace(0, 1, samples + 1)) / np.expm1(growth)


def root(function: Callable[[float], float], lower: float, upper: float) -> float:
    return float(cast(float, brentq(function, lower, upper, xtol=1e-14)))


def cut(axes: Sequence[np.ndarray], is_solid) -> tuple[np.ndarray, np.ndarray]:
    ids = ids_of(*map(len, axes))
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    cells = quads(ids) if len(axes) == 2 else hexahedra(ids)
    cells = cells[~is_solid(*places[cells].mean(axis=1).T)]
    used, cells = np.unique(cells, return_inverse=True)
    return places[used], cells.reshape(-1, 2 ** len(axes))


def c_grid(section: Section, *, points: int = REFERENCE_POINTS, first_cell: float = 1e-5) -> jm.Mesh:
    """Makes a C-grid around a section of unit chord, about as many points as asked for.

    It has straight rays of 15 chords, and a wake to x = 17 chords. With 39,666 points it has 260 x
    150 cells, and 50 x 6 behind the base. Other numbers sample the same spacing laws along wall and
    wake, and scale the four counts alike. Cells and patches are as in `naca0015`. Behind a sharp
    trailing edge, both ends of the section at one place, the two wakes share their nodes.

    Raises `ValueError` for fewer than 300 points, a first cell that does not fit, and a section
    whose upper end lies below its lower one. Also where the rays leave a cell that is not convex.
    """
    counts = _counts(points)
    largest = 0.9 * RAY_LENGTH / counts.normal
    if not SMALLEST_CELL <= first_cell <= largest:
        raise ValueError(
            f"`first_cell` is {first_cell}; {counts.normal} growing cells on {RAY_LENGTH:g} chords need one "
            f"between {SMALLEST_CELL:g} and {largest:.3g} chords."
        )
    wall, angles = _wall(section, counts)
    sharp = np.abs(wall[-1] - wall[0]).max() < 1e-12
    if not (sharp or wall[-1, 1] - wall[0, 1] > 1e-9):
        raise ValueError(f"the trailing edge is crossed: its lower point is {wall[0]}, its upper one {wall[-1]}.")
    inner, weights = _with_wake(wall, counts)
    angles = np.pad(angles, counts.wake, mode="edge")
    lengths = _ray_lengths(weights, counts.normal, first_cell)
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    # vertical means vertical: the cosine of a rounded pi / 2 is not zero
    directions[: counts.wake + 1], directions[-counts.wake - 1 :] = (0, -1), (0, 1)
    rays = inner + lengths[:, :, None] * directions
    mesh = _sharp(rays, counts) if sharp else _assemble(rays, _wake_strip(inner, counts), counts)
    _check_convex(mesh)
    return mesh


def _counts(points: int) -> Counts:
    if points < 300:
        raise ValueError(f"`points` is {points}; a C-grid needs at least 300.")
    scale = np.sqrt(points / REFERENCE_POINTS)
    return Counts(*(max(2, round(scale * count)) for count in REFERENCE))


def _wall(section: Section, counts: Counts) -> tuple[np.ndarray, np.ndarray]:
    """Spaces nodes (2 half + 1, 2) from the lower trailing edge; rays' angles are in radians."""
    lower, upper = (_half(section, end, counts.half) for end in (-1.0, 1.0))
    t = np.concatenate([lower[::-1], upper[1:]])
    nodes = section(t)
    tangent = section(np.minimum(t + 1e-6, 1.0)) - section(np.maximum(t - 1e-6, -1.0))
    phi = np.unwrap(np.arctan2(tangent[:, 0], -tangent[:, 1]))  # of the outer normal
    phi += 2 * np.pi * np.round((np.pi - phi[counts.half]) / (2 * np.pi))  # about pi at the nose
    # Rays must not meet: where the wall is concave, the nearest angles (least squares) that do turn
    # steadily.
    steps = np.linalg.norm(np.diff(nodes, axis=0), axis=1)
    arc = np.concatenate([[0.0], np.cumsum(steps)])
    reach = np.convolve(steps, [0.5, 0.5])
    phi = isotonic_regression(phi + LEAST_TURN * arc, weights=reach, increasing=False).x - LEAST_TURN * arc
    return nodes, np.pi * (1.5 - (phi[0] - phi) / (phi[0] - phi[-1]))


def _half(section: Section, end: float, cells: int) -> np.ndarray:
    t = np.linspace(0.0, end, 20_001)
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(section(t), axis=0), axis=1))])
    first, last = NOSE_SPACING / arc[-1], TRAILING_EDGE_SPACING / arc[-1]
    return np.interp(arc[-1] * _two_sided(cells, REFERENCE.half, first, last), arc, t)


def _two_sided(samples: int, cells: int, first: float, last: float) -> np.ndarray:
    """Divides [0, 1] with spacings of `cells` cells at both ends, sampled by `samples` cells.

    Vinokur, "On one-dimensional stretching functions for finite-difference calculations", J.
    Comput. Phys. 50 (1983).
    """
    ratio, intensity = np.sqrt(last / first), 1 / (cells * np.sqrt(first * last))
    delta = root(lambda delta: np.sinh(delta) / delta - intensity, 1e-6, 50.0)
    u = 0.5 * (1 + np.tanh(delta * (np.linspace(0, 1, samples + 1) - 0.5)) / np.tanh(delta / 2))
    u[[0, -1]] = 0, 1
    return u / (ratio + (1 - ratio) * u)


def _with_wake(wall: np.ndarray, counts: Counts) -> tuple[np.ndarray, np.ndarray]:
    """Makes the innermost line, lower wake to upper wake, and rays' weights of the wake's law."""
    first = TRAILING_EDGE_SPACING / (FARFIELD_X - 1)
    along = geometric(REFERENCE.wake, first, counts.wake)[1:]
    rows = [np.column_stack([x + (FARFIELD_X - x) * along, np.full_like(along, y)]) for x, y in wall[[0, -1]]]
    weights = WAKE_WEIGHT * np.concatenate([along[::-1], np.zeros(len(wall)), along])
    return np.concatenate([rows[0][::-1], wall, rows[1]]), weights


def _ray_lengths(weights: np.ndarray, cells: int, first_cell: float) -> np.ndarray:
    """Computes the distances (cells + 1, rays) of the nodes from the innermost line."""
    wall = geometric(cells, first_cell / RAY_LENGTH)[:, None]
    wake_first = max(first_cell, min(WAKE_FIRST_CELL, 0.5 * RAY_LENGTH / cells))
    wake = geometric(cells, wake_first / RAY_LENGTH)[:, None]
    return RAY_LENGTH * ((1 - weights) * wall + weights * wake)


def _wake_strip(inner: np.ndarray, counts: Counts) -> np.ndarray:
    """Places nodes (base - 1, wake + 1, 2) between the wakes; the exit is last."""
    lower, upper = inner[counts.wake :: -1], inner[-counts.wake - 1 :]
    across = np.linspace(0, 1, counts.base + 1)[1:-1, None, None]
    return lower + across * (upper - lower)


def _sharp(rays: np.ndarray, counts: Counts) -> jm.Mesh:
    places = ids_of(*rays.shape[:2])
    places[0, -counts.wake - 1 :] = places[0, counts.wake :: -1]
    nodes, ids = np.unique(places, return_inverse=True)
    ids = ids.reshape(places.shape)
    return jm.Mesh(
        points=rays.reshape(-1, 2)[nodes],
        cells={"quad": quads(ids)},
        patches={
            "airfoil": ids[0, counts.wake : -counts.wake],
            "farfield": np.concatenate([ids[-1], ids[:, 0], ids[:, -1]]),
        },
    )


def _assemble(rays: np.ndarray, strip: np.ndarray, counts: Counts) -> jm.Mesh:
    """Makes the mesh of the C's nodes (normal + 1, rays, 2) and of the nodes between the wakes."""
    # The C's nodes are numbered layer by layer from the wall, the strip's nodes follow. The strip
    # behind the base has the innermost nodes of both wakes as its first and last line.
    ids, between = ids_of(*rays.shape[:2]), rays[..., 0].size + ids_of(*strip.shape[:2])
    lower, upper = ids[0, counts.wake :: -1], ids[0, -counts.wake - 1 :]
    behind = np.vstack([lower, between, upper])
    return jm.Mesh(
        points=np.concatenate([rays.reshape(-1, 2), strip.reshape(-1, 2)]),
        cells={"quad": np.concatenate([quads(ids), quads(behind)])},
        patches={
            "airfoil": np.concatenate([ids[0, counts.wake : -counts.wake], between[:, 0]]),
            "farfield": np.concatenate([ids[-1], ids[:, 0], ids[:, -1], between[:, -1]]),
        },
    )


def _check_convex(mesh: jm.Mesh) -> None:
    quads = mesh.cells["quad"]
    corners = mesh.points[quads]
    edges = np.roll(corners, -1, axis=1) - corners
    before = np.roll(edges, 1, axis=1)
    jacobians = before[..., 0] * edges[..., 1] - before[..., 1] * edges[..., 0]
    bad = np.flatnonzero(~(jacobians.min(axis=1) > 0))
    if bad.size:
        x, y = corners[bad[0]].mean(axis=0)
        raise ValueError(
            f"{bad.size} of {len(quads)} cells around this section are not convex, first cell {bad[0]} near "
            f"({x:.4g}, {y:.4g}). Try less camber, a smoother section or more points."
        )
