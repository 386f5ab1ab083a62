"""Generated meshes for the faults that walls provoke: sharp edges, passages, channels, walls that nearly touch."""

import numpy as np

import jaxmorph as jm
from jaxmorph.cases._meshes import block_ids, geometric, quads, without_solid, zero_of

FAR = 20.0  # chords, from an O-grid's section
SAMPLES = 600  # along each of its rays, to measure their lengths
LENGTH = 1.7  # of the cascade's passage, in chords
OUTERMOST = 2.2  # the last ray node's radius about the blade's circle, before it is carried to the passage's boundary


def sharp_o_grid(
    *,
    around: int = 128,
    layers: int = 64,
    first_cell: float = 1.7e-7,
    camber: float = 0.0,
    edge: float = 12.0,
) -> jm.Mesh:
    """Makes an O-grid of quads around a section of unit chord, its sharp edge at (1, 0).

    The section is a circle under the map of Karman and Trefftz. The far field is a circle of 20
    chords. The rays leave the wall along its normal, and at the edge along the line between both
    sides. All cells are convex and counter-clockwise. Patches: `airfoil`, `farfield`.

    **Arguments:**

    - `around`: cells round the section, 16 or more. Default 128.
    - `layers`: cells from the section to the far field, 8 or more. Default 64.
    - `first_cell`: height of the cells at the wall, in chords. Default 1.7e-7.
    - `camber`: height of the mean line, about an arc, in chords. Default 0.
    - `edge`: angle of the trailing edge in degrees, 1 to 60. Default 12.

    **Returns:** a `Mesh`.

    **Raises:** `ValueError` for fewer than 16 cells around or 8 layers, and for an edge that is not
    between 1 and 60 degrees.
    """
    if around < 16 or layers < 8:
        raise ValueError(
            f"an O-grid needs 16 cells around and 8 layers, not {around} and {layers}."
        )
    if not 1 <= edge <= 60:
        raise ValueError(f"`edge` is {edge}; a sharp trailing edge is 1 to 60 degrees open.")
    section = SharpSection(camber, edge)
    nodes = rays(section, around, layers, first_cell, FAR * abs(section.nose) / section.radius)
    ids = block_ids(layers + 1, around)
    closed = np.column_stack([ids, ids[:, 0]])[:, ::-1]
    return jm.Mesh(
        nodes.reshape(-1, 2), {"quad": quads(closed)}, {"airfoil": ids[0], "farfield": ids[-1]}
    )


class SharpSection:
    """A section of unit chord: the image of a circle under the map of Karman and Trefftz.

    The circle runs through the map's singular point 1 and round the other, -1.
    """

    def __init__(self, camber: float, edge: float, thickness: float = 0.08):
        self.power = 2 - edge / 180
        self.centre = -thickness + 2j * camber
        self.radius = abs(1 - self.centre)
        self.start = np.angle(1 - self.centre)
        wall = self._map(1.0, np.linspace(0, 1, 4001))
        self.nose = wall.real.min()

    def __call__(self, radius: np.ndarray | float, turn: np.ndarray) -> np.ndarray:
        """Computes complex places in chords at `radius` (1 on the wall) and `turn`.

        The turn is 0 to 1, counter-clockwise from the edge.
        """
        return 1 + self._map(radius, turn) / -self.nose

    def _map(self, radius, turn):
        """Computes places relative to the edge, to full relative precision near it."""
        away = self.radius * (
            radius * np.exp(1j * (2 * np.pi * turn + self.start)) - np.exp(1j * self.start)
        )
        power = (away / (2 + away)) ** self.power
        return 2 * self.power * power / (1 - power)


def rays(
    section: SharpSection, around: int, layers: int, first_cell: float, outermost: float
) -> np.ndarray:
    """Places (layers + 1, around, 2) nodes on rays, spaced geometrically along each ray.

    The rays go from radius 1 to `outermost`.
    """
    turn = np.arange(around) / around
    radius = 1 + np.concatenate([[0.0], np.geomspace(1e-7, outermost - 1, SAMPLES)])[:, None]
    places = section(radius, turn)
    length = np.concatenate(
        [np.zeros((1, around)), np.cumsum(np.abs(np.diff(places, axis=0)), axis=0)]
    )
    stations = np.empty((layers + 1, around))
    for i in range(around):
        wanted = length[-1, i] * geometric(layers, first_cell / length[-1, i])
        stations[1:, i] = np.exp(
            np.interp(np.log(wanted[1:]), np.log(length[1:, i]), np.log(radius[1:, 0] - 1))
        )
    stations[0] = 0
    nodes = section(1 + stations, turn)
    return np.stack([np.real(nodes), np.imag(nodes)], axis=-1)


def cascade(
    *,
    around: int = 240,
    layers: int = 60,
    first_cell: float = 1e-5,
    pitch: float = 1.0,
    periodic: bool = False,
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
        raise ValueError(
            f"a cascade needs 40 cells around and 8 layers, not {around} and {layers}."
        )
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
    ids = block_ids(layers + 1, around)
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


def channel(
    *, columns: int = 60, rows: int = 40, gap: float = 0.2, first_cell: float = 1e-5
) -> jm.Mesh:
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
    if columns < 4 or rows < 4:
        raise ValueError(f"a channel needs 4 columns and rows, not {columns} and {rows}.")
    x, y = np.linspace(0, 1, columns + 1), gap * two_sided(rows, first_cell / gap)
    ids = block_ids(rows + 1, columns + 1)
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    patches = {"inner": ids[0], "outer": ids[-1], "inlet": ids[:, 0], "outlet": ids[:, -1]}
    return jm.Mesh(points, {"quad": quads(ids)}, patches)


def two_sided(cells: int, first: float) -> np.ndarray:
    """Divides [0, 1] into `cells` by a hyperbolic tangent.

    The first and the last cell are about `first` high.
    """
    if first * cells >= 1:
        return np.linspace(0, 1, cells + 1)

    def missing(delta):
        return np.log((1 - np.tanh(delta * (1 - 2 / cells)) / np.tanh(delta)) / 2 / first)

    delta = zero_of(missing, 1e-6, 18.0)
    share = 0.5 + 0.5 * np.tanh(np.linspace(-delta, delta, cells + 1)) / np.tanh(delta)
    share[[0, -1]] = 0, 1
    return share


def valve(*, lift: float = 0.1, layers: int = 5) -> jm.Mesh:
    """Makes quads around a flat valve that stands above its seat.

    It is the right half of a port and of the chamber above it.

    The port is 0.5 wide and 0.6 long, the chamber 1.5 wide and 1 high. The valve is 0.7 wide and
    0.15 thick: 0.2 of it hang over the seat, `lift` above. Patches: `valve`, `seat` (with the
    port's wall), `inlet`, `outlet`, `top`, and `middle` (x = 0), where the valve ends too.

    **Arguments:**

    - `lift`: gap between valve and seat, above 0 and at most 0.5. Default 0.1.
    - `layers`: cells across the gap, 2 or more. Default 5.

    **Returns:** a `Mesh`.

    **Raises:** `ValueError` for another lift, and for fewer than 2 layers.
    """
    if not 0 < lift <= 0.5 or layers < 2:
        raise ValueError(
            f"a valve needs a lift from 0 to 0.5 and 2 layers, not {lift} and {layers}."
        )
    first, roof = lift / layers, lift + 0.15
    x = np.concatenate(
        [
            np.linspace(0, 0.5, 11),
            np.linspace(0.5, 0.7, 9)[1:],
            0.7 + 0.8 * geometric(14, 0.025 / 0.8)[1:],
        ]
    )
    below, above = (
        -0.6 * geometric(14, first / 0.6)[:0:-1],
        roof + (1 - roof) * geometric(14, first / (1 - roof))[1:],
    )
    y = np.concatenate(
        [below, np.linspace(0, lift, layers + 1), np.linspace(lift, roof, 5)[1:], above]
    )
    places, cells = without_solid(
        (y, x), lambda y, x: ((y < 0) & (x > 0.5)) | ((x < 0.7) & (y > lift) & (y < roof))
    )
    y, x = places.T
    near = 1e-9
    patches = {
        "valve": (x <= 0.7 + near) & (y >= lift - near) & (y <= roof + near),
        "seat": (x >= 0.5 - near) & (y <= near),
        "inlet": y == y.min(),
        "outlet": x == x.max(),
        "top": y == y.max(),
        "middle": x == 0,
    }
    return jm.Mesh(
        np.stack([x, y], axis=1),
        {"quad": cells},
        {k: np.flatnonzero(v) for k, v in patches.items()},
    )


def blade_tip(*, gap: float = 0.01, layers: int = 5) -> jm.Mesh:
    """Makes hexahedra around a blade whose tip stands below a shroud.

    The blade is a plate 0.5 long and 0.27 thick on a hub of radius 1.

    The shroud is the cylinder of radius 2 about x, the mesh a sector of 0.8 radians and 2 long. The
    tip has the radius 2 - gap. Patches: `blade`, `shroud`, `hub`, `inlet`, `outlet`, and the sides
    `left` and `right`, of which one is the other turned.

    **Arguments:**

    - `gap`: distance from tip to shroud, above 0 and below 0.5. Default 0.01.
    - `layers`: cells across the gap, 2 or more. Default 5.

    **Returns:** a `Mesh`.

    **Raises:** `ValueError` for another gap, and for fewer than 2 layers.
    """
    if not 0 < gap < 0.5 or layers < 2:
        raise ValueError(
            f"a blade's tip needs a gap from 0 to 0.5 and 2 layers, not {gap} and {layers}."
        )
    x, angle, tip = np.linspace(-1, 1, 25), np.linspace(-0.4, 0.4, 25), 2 - gap
    r = np.concatenate([np.linspace(1, tip, 13), tip + gap * np.arange(1, layers + 1) / layers])
    places, cells = without_solid(
        (r, angle, x), lambda r, angle, x: (np.abs(x) < 0.25) & (np.abs(angle) < 0.06) & (r < tip)
    )
    r, angle, x = places.T
    near = 1e-9
    blade = (np.abs(x) <= 0.25 + near) & (np.abs(angle) <= 0.4 / 6 + near) & (r <= tip + near)
    patches = {"blade": blade, "shroud": r == r.max(), "hub": (r == 1) & ~blade}
    patches |= {
        "inlet": x == -1,
        "outlet": x == 1,
        "left": angle == angle.min(),
        "right": angle == angle.max(),
    }
    points = np.stack([x, r * np.sin(angle), r * np.cos(angle)], axis=1)
    return jm.Mesh(
        points, {"hexahedron": cells}, {k: np.flatnonzero(v) for k, v in patches.items()}
    )
