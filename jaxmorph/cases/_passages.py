"""Walls close to each other: a blade in a passage, and a channel whose walls touch."""

import numpy as np

import jaxmorph as jm

from .._host.package.arguments import between, checked
from ._o_grid import SharpSection, rays
from ._structured import geometric, ids_of, quads, two_sided

LENGTH = 1.7  # of the cascade's passage, in chords
OUTERMOST = 2.2  # the last ray node's radius about the blade's circle, before it is carried to the passage's boundary


@checked
def cascade(
    *, around: int = 240, layers: int = 60, first_cell: float = 1e-5, pitch: float = 1.0, periodic: bool = False
) -> jm.Mesh:
    """Makes an O-grid of quads around a turbine blade in a passage `pitch` chords wide.

    The blade's trailing edge is sharp, at (1, 0); the passage is 1.7 chords long. Its sides run
    straight and half a pitch from the blade's middle: a blade that turns by 45 degrees comes close
    to them. All cells are convex and counter-clockwise. Patches: `blade`, `inlet`, `outlet`,
    `lower`, `upper`; corners belong to two of them.

    **Arguments:**

    - `around`: cells round the blade, 40 or more. Default 240.
    - `layers`: cells from the blade to the passage's boundary, 8 or more. Default 60.
    - `first_cell`: height of the cells at the blade, in chords. Default 1e-5.
    - `pitch`: width of the passage, 1 to 3 chords. Default 1.
    - `periodic`: whether `upper` has the nodes of `lower`, a pitch above them. Default False.

    **Returns:** a `Mesh`.

    **Raises:** `ValueError` for fewer than 40 cells around or 8 layers, and a pitch not between 1
    and 3 chords.
    """
    if around < 40 or layers < 8:
        raise ValueError(f"a cascade needs 40 cells around and 8 layers, not {around} and {layers}.")
    if not 1 <= pitch <= 3:
        raise ValueError(f"`pitch` is {pitch}; a passage is 1 to 3 chords wide.")
    section = SharpSection(0.1, 14.0)
    near = rays(section, around, layers, first_cell, OUTERMOST) @ np.array([1, 1j])
    turn = np.arange(around) / around
    middle, half = section(OUTERMOST, turn).mean(), np.array([LENGTH / 2, pitch / 2])
    outer = middle + _box(near[-1] - middle, half, periodic)
    share = geometric(layers, first_cell / pitch)[:, None]
    weight = share**2 * (3 - 2 * share)
    places = (1 - weight) * near + weight * outer
    nodes = np.stack([np.real(places), np.imag(places)], axis=-1)
    ids = ids_of(layers + 1, around)
    closed = np.column_stack([ids, ids[:, 0]])[:, ::-1]
    sides = {"outlet": (0, 1), "inlet": (0, -1), "upper": (1, 1), "lower": (1, -1)}
    rim, centre = nodes[-1], np.array([middle.real, middle.imag])
    patches = {"blade": ids[0]}
    for name, (axis, sign) in sides.items():
        patches[name] = ids[-1][np.abs(rim[:, axis] - centre[axis] - sign * half[axis]) < 1e-12]
    return jm.Mesh(nodes.reshape(-1, 2), {"quad": quads(closed)}, patches)


def _box(directions: np.ndarray, half: np.ndarray, periodic: bool) -> np.ndarray:
    """Places complex points on a rectangle's boundary in given directions."""
    reach = np.minimum(half[0] / np.abs(np.real(directions)), half[1] / np.abs(np.imag(directions)))
    points = directions * reach
    corners = [complex(x, y) for x, y in half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])]
    nodes = [int(np.abs(points - corner).argmin()) for corner in corners]
    if periodic:
        step = 1 if np.imag(np.conj(points[0]) * points[1]) > 0 else -1
        lower = step * np.arange((step * (nodes[1] - nodes[0])) % len(points) + 1)
        nodes[3] = (nodes[2] + lower[-1]) % len(points)
        below, above = (nodes[0] + lower) % len(points), (nodes[2] + lower[::-1]) % len(points)
        along = np.sort((np.real(points[below]) + np.real(points[above])) / 2)
        points[below], points[above] = along - 1j * half[1], along + 1j * half[1]
    points[nodes] = corners
    return points


@checked
def channel(*, columns: int = 60, rows: int = 40, gap: float = 0.2, first_cell: float = 1e-5) -> jm.Mesh:
    """Makes a straight channel of unit length between two walls, of quads that are finest at both.

    Its four patches `inner` (y = 0), `outer` (y = gap), `inlet` (x = 0) and `outlet` (x = 1) share
    their corners.

    **Arguments:**

    - `columns`: cells along the channel, 4 or more. Default 60.
    - `rows`: cells across it, 4 or more. Default 40.
    - `gap`: width of the channel, relative to its length. Default 0.2.
    - `first_cell`: height of the cells at both walls. Default 1e-5.

    **Returns:** a `Mesh`.

    **Raises:** `ValueError` for fewer than 4 columns or rows.
    """
    between("gap", gap, 0)
    between("first_cell", first_cell, 0)
    if columns < 4 or rows < 4:
        raise ValueError(f"a channel needs 4 columns and rows, not {columns} and {rows}.")
    x, y = np.linspace(0, 1, columns + 1), gap * two_sided(rows, first_cell / gap)
    ids = ids_of(rows + 1, columns + 1)
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    patches = {"inner": ids[0], "outer": ids[-1], "inlet": ids[:, 0], "outlet": ids[:, -1]}
    return jm.Mesh(points, {"quad": quads(ids)}, patches)
