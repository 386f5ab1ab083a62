"""Generated meshes: airfoils of the NACA family, a wing, bricks, bodies in a box.

Below them are their parts: ids, cells, spacings that grow; C-grids around any section.
"""

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, cast

import numpy as np
from numpy import ndarray
from scipy.optimize import brentq, isotonic_regression

import jaxmorph as jm
from jaxmorph.extend import between, checked, finite_array

# A section of unit chord: t in [-1, 1] -> (k, 2), from the lower trailing edge (-1) round the nose
# (0) to the upper.
Section = Callable[[ndarray], ndarray]

REFERENCE_POINTS = 39_666

# chords, along the wall, on the grid of REFERENCE_POINTS
NOSE_SPACING = 0.003
TRAILING_EDGE_SPACING = 1.05e-3

FARFIELD_X = 17.0
RAY_LENGTH = 15.0
WAKE_FIRST_CELL = 1e-3
WAKE_WEIGHT = 0.892
SMALLEST_CELL = 1e-12  # chords: what float64 still resolves at the trailing edge
LEAST_TURN = 0.1  # radians that neighbouring rays turn at least, per chord of wall between them


class Counts(NamedTuple):
    """Cells along half of the wall, along the wake, along a ray and across the base."""

    half: int
    wake: int
    normal: int
    base: int


REFERENCE = Counts(half=80, wake=50, normal=150, base=6)

# Corners of a hexahedron, in VTK's order, of the cells into which it is divided; 8 is its middle.
BRICK_PARTS = {
    "hexahedron": ((0, 1, 2, 3, 4, 5, 6, 7),),
    "wedge": ((0, 5, 1, 3, 6, 2), (0, 4, 5, 3, 7, 6)),
    "tetra": ((0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6), (0, 5, 1, 6)),
    "pyramid": (
        (0, 1, 2, 3, 8),
        (4, 7, 6, 5, 8),
        (0, 4, 5, 1, 8),
        (1, 5, 6, 2, 8),
        (2, 6, 7, 3, 8),
        (3, 7, 4, 0, 8),
    ),
}


@checked
def naca0015(*, points: int = REFERENCE_POINTS) -> jm.Mesh:
    """Makes the C-grid around the NACA0015 of the paper's section 3.1, in chords.

    It has 39,666 points, none coincident, and 39,300 convex quads; patches `airfoil` (166 nodes)
    and `farfield` (566). The mean skewness (weighted by area) is 0.0710, the largest 0.1750, the
    paper's values. The first cell is 1e-5 chords, the trailing edge blunt.

    The first 260 x 150 cells are layers round the airfoil, from the wall outwards. Columns 50 to
    209 touch the wall, the others lie above and below the wake. The last 50 x 6 are behind the
    base.

    **Arguments:**

    - `points`: about how many points, 300 or more: 2,000 for a test, a million for a benchmark.
      Default 39,666.

    **Raises:** `ValueError` for fewer than 300 points.
    """
    return naca4("0015", points=points, first_cell=1e-5)


@checked
def naca4(
    code: str, *, points: int = REFERENCE_POINTS, first_cell: float = 1e-6, sharp: bool = False
) -> jm.Mesh:
    """Makes a C-grid around a NACA 4-digit airfoil, in chords: `cases.naca4("4412")`.

    Thickness is laid off normal to the camber line, and the trailing edge is blunt, as published
    (Jacobs, Ward and Pinkerton, NACA Report 460, 1933). Rays leave the wall nearly along its
    normal, and turn steadily from one trailing edge to the other: they never meet before a concave
    wall. Cells, their order and patches as in `naca0015`.

    **Arguments:**

    - `code`: four digits: the camber in percent of the chord, its place in tenths, and the
      thickness in percent.
    - `points`: about how many points, 300 or more. Default 39,666.
    - `first_cell`: height of the cells at the wall, in chords. Default 1e-6.
    - `sharp`: True lets the thickness end at zero (its last coefficient is then 0.1036). Both sides
      meet in one node, and there is no base. Default False.

    **Raises:** `ValueError` for a code outside of the family, fewer than 300 points, and a first
    cell that does not fit. Also for sections whose straight rays leave a cell that is not convex.
    These are below 4 % thickness with the camber far aft, or from 24 % with large camber in the
    first tenth (9901, 9124).
    """
    if not (isinstance(code, str) and len(code) == 4 and code.isascii() and code.isdigit()):
        raise ValueError(
            f"`code` is {code!r}; the NACA 4-digit family is written with four digits, such as "
            "'4412'."
        )
    camber = int(code[0]) / 100
    place = int(code[1]) / 10
    thickness = int(code[2:]) / 100
    if thickness == 0 or (camber > 0 and place == 0):
        raise ValueError(
            f"`code` is {code!r}: it has no thickness (the last two digits), or a camber without "
            "its place (the second digit)."
        )
    section = functools.partial(_section, camber, place, thickness, 0.1036 if sharp else 0.1015)
    return c_grid(section, points=points, first_cell=first_cell)


def _section(camber: float, place: float, thickness: float, last: float, t: ndarray) -> ndarray:
    """Computes the contour, x = t^2 along the chord: t < 0 below, t > 0 above."""
    x = t**2
    root = 0.2969 * np.abs(t)
    half = 5 * thickness * (root + x * (-0.126 + x * (-0.3516 + x * (0.2843 - last * x))))
    ahead = x < place
    scale = camber / np.where(ahead, place, 1 - place) ** 2
    line = scale * (np.where(ahead, 0, 1 - 2 * place) + 2 * place * x - x**2)
    slope = 2 * scale * (place - x)
    away = np.sign(t) * half / np.sqrt(1 + slope**2)
    return np.column_stack([x - away * slope, line + away])


@checked
def wing(
    code: str = "6409",
    *,
    points: int = 2000,
    stations: int = 13,
    span: float = 2.0,
    first_cell: float = 1e-5,
) -> jm.Mesh:
    """Makes a swept and tapered wing of hexahedra between two planes.

    The C-grid of `naca4` is repeated at stations along y, from the root of chord 1 to the tip of
    chord 0.7, whose leading edge lies half a chord behind. Wall nodes lie much closer along the
    section than along the span: chains of nearest neighbours stay within one section. Patches:
    `wing`, `farfield`, and the planes `root` (y = 0) and `tip` (y = span).

    **Arguments:**

    - `code`, `points`: the section and its points, as in `naca4`. Default "6409", 2000.
    - `stations`: sections along the span, 2 or more. Default 13.
    - `span`, `first_cell`: length of the wing and height of the cells at the wall, in chords of the
      root. Default 2, 1e-5.

    **Raises:** `ValueError` for fewer than 2 stations, and as `naca4` does.
    """
    between("span", span, 0)
    if stations < 2:
        raise ValueError(f"a wing needs 2 stations, not {stations}.")
    section = naca4(code, points=points, first_cell=first_cell)
    n = len(section.points)
    cells = section.cells["quad"]
    eta = np.linspace(0, 1, stations)[:, None]
    x = (1 - 0.3 * eta) * section.points[:, 0] + 0.5 * eta
    z = (1 - 0.3 * eta) * section.points[:, 1]
    places = np.stack([x, np.broadcast_to(span * eta, x.shape), z], axis=-1).reshape(-1, 3)
    layers = cells + n * np.arange(stations)[:, None, None]
    corners = np.concatenate([layers[1:], layers[:-1]], axis=-1).reshape(-1, 8)
    ids = block_ids(stations, n)
    wall, far = (ids[:, section.patch(name)].ravel() for name in ("airfoil", "farfield"))
    patches = {"wing": wall, "farfield": far, "root": ids[0], "tip": ids[-1]}
    return jm.Mesh(places, {"hexahedron": corners}, patches)


@checked
def bricks(kind: str = "hexahedron", *, cells: int = 6, first_cell: float | None = None) -> jm.Mesh:
    """Makes the unit cube of `cells` by `cells` by `cells` bricks, divided into cells of a type.

    Patches: `floor` (z = 0), `lid` (z = 1), `sides`, which share nodes.

    **Arguments:**

    - `kind`: the type of the cells: `hexahedron`, `wedge` (2 a brick), `tetra` (6 a brick),
      `pyramid` (6 a brick, around a node in its middle) or `mixed`. A mixed mesh has hexahedra at
      the floor, a layer of pyramids above, and wedges.
    - `cells`: bricks along each edge, 3 or more. Default 6.
    - `first_cell`: height of the bricks at z = 0, from which the layers grow. Default None: all
      equal.

    **Raises:** `ValueError` for another kind, fewer than 3 cells, and a first cell that is not
    between 0 and 1.
    """
    if kind not in (*BRICK_PARTS, "mixed") or cells < 3:
        raise ValueError(
            f"expected one of {', '.join(BRICK_PARTS)}, mixed, and 3 cells at least, not "
            f"{kind!r} and {cells}."
        )
    first = 1 / cells if first_cell is None else first_cell
    if not 0 < first < 1:
        raise ValueError(f"`first_cell` is {first}; the cube's side is 1.")
    z = geometric(cells, first)
    x = np.linspace(0, 1, cells + 1)
    height, across, along = np.meshgrid(z, x, x, indexing="ij")
    points = np.stack([along, across, height], axis=-1).reshape(-1, 3)
    ids = block_ids(*(cells + 1,) * 3)
    sides = np.concatenate([ids[:, [0, -1]].ravel(), ids[:, :, [0, -1]].ravel()])
    patches = {"floor": ids[0].ravel(), "lid": ids[-1].ravel(), "sides": sides}
    whole = hexahedra(ids)
    if kind != "mixed":
        return jm.Mesh(*_in_parts(points, {kind: whole}), patches)
    below, middle, above = np.split(whole, cells**2 * np.array([cells // 2, cells // 2 + 1]))
    layers = {"hexahedron": below, "pyramid": middle, "wedge": above}
    return jm.Mesh(*_in_parts(points, layers), patches)


def _in_parts(points: ndarray, layers: dict[str, ndarray]) -> tuple[ndarray, dict[str, ndarray]]:
    cells = {}
    for kind, corners in layers.items():
        if kind == "pyramid":
            middles = points[corners].mean(axis=1)
            corners = np.column_stack([corners, len(points) + np.arange(len(corners))])
            points = np.concatenate([points, middles])
        parts = np.array(BRICK_PARTS[kind])
        cells[kind] = corners[:, parts].reshape(-1, parts.shape[1])
    return points, cells


@checked
def bodies(
    boxes: Mapping[str, Sequence[float]],
    *,
    box: Sequence[float] = (-8.0, 8.0, -4.0, 4.0),
    spacing: float = 0.25,
) -> jm.Mesh:
    """Makes squares around rectangular bodies in a box, which may pass each other or part.

    Patches: each body by its name, and `farfield`.

    **Arguments:**

    - `boxes`: each body's sides, (x least, x largest, y least, y largest), by its name. They move
      to the nearest grid line.
    - `box`: sides of the box, as in `boxes`. Default: 16 wide and 8 high about the origin.
    - `spacing`: side of a cell, about; a whole number of them fills the box. Default 0.25.

    **Raises:** `ValueError` for sides in another order, and a body without a cell in or beside it.
    """
    left, right, bottom, top = finite_array("box", box, (4,)).tolist()
    if not (left < right and bottom < top and spacing > 0):
        raise ValueError(
            f"a box has x and y from least to largest and a positive spacing, not {box} and "
            f"{spacing}."
        )
    ends = (bottom, top), (left, right)
    axes = [np.linspace(low, high, 1 + max(1, round((high - low) / spacing))) for low, high in ends]
    sides = [
        _on_lines(name, finite_array(f"boxes[{name!r}]", four, (4,)), axes)
        for name, four in boxes.items()
    ]
    low, high = np.reshape(sides, (-1, 2, 2, 1)).transpose(2, 0, 1, 3)

    def within(places: ndarray, margin: float) -> ndarray:
        return np.all((places > low - margin) & (places < high + margin), axis=1)

    places, cells = without_solid(axes, lambda *places: within(np.array(places), 0.0).any(axis=0))
    y, x = places.T
    patches = dict(zip(boxes, within(places.T, 1e-9), strict=True))
    patches["farfield"] = (y == bottom) | (y == top) | (x == left) | (x == right)
    nodes = {name: np.flatnonzero(on) for name, on in patches.items()}
    return jm.Mesh(np.stack([x, y], axis=1), {"quad": cells}, nodes)


def _on_lines(name: str, sides: ndarray, axes: Sequence[ndarray]) -> list[ndarray]:
    """The ends of a body along y and x, on grid lines."""
    ends = []
    for axis, pair in zip(axes, (sides[2:], sides[:2]), strict=True):
        first, last = np.abs(axis[:, None] - pair).argmin(axis=0)
        if not 0 < first < last < len(axis) - 1:
            raise ValueError(
                f"body {name!r} at {tuple(sides.tolist())} has no cell within it or beside it: try "
                "a smaller spacing."
            )
        ends.append(axis[[first, last]])
    return ends


def block_ids(*shape: int) -> ndarray:
    return np.arange(np.prod(shape)).reshape(shape)


def quads(ids: ndarray) -> ndarray:
    """Makes the cells (k, 4) of a block, counter-clockwise: rows along y, columns along x."""
    below = ids[:-1]
    above = ids[1:]
    corners = [below[:, :-1], below[:, 1:], above[:, 1:], above[:, :-1]]
    return np.stack(corners, axis=-1).reshape(-1, 4)


def hexahedra(ids: ndarray) -> ndarray:
    """Makes the cells (k, 8) of a block: layers along z, rows along y, columns along x."""
    layers = np.stack([quads(layer) for layer in ids])
    return np.concatenate([layers[:-1], layers[1:]], axis=-1).reshape(-1, 8)


def geometric(cells: int, first: float, samples: int | None = None) -> ndarray:
    """Divides [0, 1] with the growth of `cells` from `first` (or evenly), by `samples` cells."""
    samples = cells if samples is None else samples
    between("first_cell", first, 0)
    if first * cells >= 1:
        return np.linspace(0, 1, samples + 1)
    growth = zero_of(
        lambda beta: np.log(np.expm1(beta / cells) / np.expm1(beta) / first), 1e-9, 700.0
    )
    return np.expm1(growth * np.linspace(0, 1, samples + 1)) / np.expm1(growth)


def zero_of(function: Callable[[float], float], lower: float, upper: float) -> float:
    return float(cast(float, brentq(function, lower, upper, xtol=1e-14)))


def without_solid(axes: Sequence[ndarray], is_solid) -> tuple[ndarray, ndarray]:
    ids = block_ids(*map(len, axes))
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    cells = quads(ids) if len(axes) == 2 else hexahedra(ids)
    cells = cells[~is_solid(*places[cells].mean(axis=1).T)]
    used, cells = np.unique(cells, return_inverse=True)
    return places[used], cells.reshape(-1, 2 ** len(axes))


def c_grid(
    section: Section, *, points: int = REFERENCE_POINTS, first_cell: float = 1e-5
) -> jm.Mesh:
    """Makes a C-grid around a section of unit chord, about as many points as asked for.

    It has straight rays of 15 chords, and a wake to x = 17 chords. With 39,666 points it has 260 x
    150 cells, and 50 x 6 behind the base. Other numbers sample the same spacing laws along wall and
    wake, and scale the four counts alike. Cells and patches are as in `naca0015`. Behind a sharp
    trailing edge, both ends of the section at one place, the two wakes share their nodes.

    Raises `ValueError` for fewer than 300 points, a first cell that does not fit, and a section
    whose upper end lies below its lower one. Also where the rays leave a cell that is not convex.
    """
    if points < 300:
        raise ValueError(f"`points` is {points}; a C-grid needs at least 300.")
    scale = np.sqrt(points / REFERENCE_POINTS)
    counts = Counts(*(max(2, round(scale * count)) for count in REFERENCE))
    largest = 0.9 * RAY_LENGTH / counts.normal
    if not SMALLEST_CELL <= first_cell <= largest:
        raise ValueError(
            f"`first_cell` is {first_cell}; {counts.normal} growing cells on {RAY_LENGTH:g} "
            f"chords need one between {SMALLEST_CELL:g} and {largest:.3g} chords."
        )
    wall, angles = _wall_nodes(section, counts)
    is_sharp = bool(np.abs(wall[-1] - wall[0]).max() < 1e-12)
    if not (is_sharp or wall[-1, 1] - wall[0, 1] > 1e-9):
        raise ValueError(
            f"the trailing edge is crossed: its lower point is {wall[0]}, its upper one {wall[-1]}."
        )
    inner, weights = _with_wake(wall, counts)
    angles = np.pad(angles, counts.wake, mode="edge")
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    # vertical means vertical: the cosine of a rounded pi / 2 is not zero
    directions[: counts.wake + 1] = 0, -1
    directions[-counts.wake - 1 :] = 0, 1
    rays = inner + _ray_lengths(weights, counts.normal, first_cell)[:, :, None] * directions
    mesh = _assemble(rays, counts, is_sharp)
    _check_convex(mesh)
    return mesh


def _wall_nodes(section: Section, counts: Counts) -> tuple[ndarray, ndarray]:
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
    phi = (
        isotonic_regression(phi + LEAST_TURN * arc, weights=reach, increasing=False).x
        - LEAST_TURN * arc
    )
    return nodes, np.pi * (1.5 - (phi[0] - phi) / (phi[0] - phi[-1]))


def _half(section: Section, end: float, cells: int) -> ndarray:
    t = np.linspace(0.0, end, 20_001)
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(section(t), axis=0), axis=1))])
    first = NOSE_SPACING / arc[-1]
    last = TRAILING_EDGE_SPACING / arc[-1]
    return np.interp(arc[-1] * _two_sided(cells, REFERENCE.half, first, last), arc, t)


def _two_sided(samples: int, cells: int, first: float, last: float) -> ndarray:
    """Divides [0, 1] with spacings of `cells` cells at both ends, sampled by `samples` cells.

    Vinokur, "On one-dimensional stretching functions for finite-difference calculations", J.
    Comput. Phys. 50 (1983).
    """
    ratio = np.sqrt(last / first)
    intensity = 1 / (cells * np.sqrt(first * last))
    delta = zero_of(lambda delta: np.sinh(delta) / delta - intensity, 1e-6, 50.0)
    u = 0.5 * (1 + np.tanh(delta * (np.linspace(0, 1, samples + 1) - 0.5)) / np.tanh(delta / 2))
    u[[0, -1]] = 0, 1
    return u / (ratio + (1 - ratio) * u)


def _with_wake(wall: ndarray, counts: Counts) -> tuple[ndarray, ndarray]:
    """Makes the innermost line, lower wake to upper wake, and rays' weights of the wake's law."""
    first = TRAILING_EDGE_SPACING / (FARFIELD_X - 1)
    along = geometric(REFERENCE.wake, first, counts.wake)[1:]
    rows = [
        np.column_stack([x + (FARFIELD_X - x) * along, np.full_like(along, y)])
        for x, y in wall[[0, -1]]
    ]
    weights = WAKE_WEIGHT * np.concatenate([along[::-1], np.zeros(len(wall)), along])
    return np.concatenate([rows[0][::-1], wall, rows[1]]), weights


def _ray_lengths(weights: ndarray, cells: int, first_cell: float) -> ndarray:
    """Computes the distances (cells + 1, rays) of the nodes from the innermost line."""
    wall = geometric(cells, first_cell / RAY_LENGTH)[:, None]
    wake_first = max(first_cell, min(WAKE_FIRST_CELL, 0.5 * RAY_LENGTH / cells))
    wake = geometric(cells, wake_first / RAY_LENGTH)[:, None]
    return RAY_LENGTH * ((1 - weights) * wall + weights * wake)


def _assemble(rays: ndarray, counts: Counts, is_sharp: bool) -> jm.Mesh:
    """Makes the mesh of the C's nodes (normal + 1, rays, 2) and of the nodes between the wakes."""
    # The C's nodes are numbered layer by layer from the wall, those of the strip behind the base
    # follow, exit last. It has the innermost nodes of both wakes as its first and last line; behind
    # a sharp edge these are one line.
    ids = block_ids(*rays.shape[:2])
    lower = rays[0, counts.wake :: -1]
    upper = rays[0, -counts.wake - 1 :]
    across = np.linspace(0, 1, 2 if is_sharp else counts.base + 1)[1:-1, None, None]
    strip = lower + across * (upper - lower)
    between = ids.size + block_ids(*strip.shape[:2])
    first = ids[0, counts.wake :: -1]
    last = ids[0, -counts.wake - 1 :]
    if is_sharp:
        last[:] = first
    lines = np.vstack([first, between, last])
    behind = quads(lines[:1] if is_sharp else lines)
    points = np.concatenate([rays.reshape(-1, 2), strip.reshape(-1, 2)])
    cells = np.concatenate([quads(ids), behind])
    patches = {
        "airfoil": np.concatenate([ids[0, counts.wake : -counts.wake], between[:, 0]]),
        "farfield": np.concatenate([ids[-1], ids[:, 0], ids[:, -1], between[:, -1]]),
    }
    nodes, cells = np.unique(cells, return_inverse=True)
    patches = {name: np.searchsorted(nodes, own) for name, own in patches.items()}
    return jm.Mesh(points[nodes], {"quad": cells.reshape(-1, 4)}, patches)


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
            f"{bad.size} of {len(quads)} cells around this section are not convex, first cell "
            f"{bad[0]} near ({x:.4g}, {y:.4g}). Try less camber, a smoother section or more points."
        )
