"""O-grids around sections with a sharp trailing edge, by a conformal map."""

import numpy as np

import jaxmorph as jm

from .._host.package.arguments import between, checked
from ._structured import geometric, ids_of, quads

FAR = 20.0  # chords
SAMPLES = 600  # along each ray, to measure its length


@checked
def sharp_o_grid(
    *, around: int = 128, layers: int = 64, first_cell: float = 1.7e-7, camber: float = 0.0, edge: float = 12.0
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
        raise ValueError(f"an O-grid needs 16 cells around and 8 layers, not {around} and {layers}.")
    if not 1 <= edge <= 60:
        raise ValueError(f"`edge` is {edge}; a sharp trailing edge is 1 to 60 degrees open.")
    between("camber", camber)
    section = SharpSection(camber, edge)
    nodes = rays(section, around, layers, first_cell, FAR * abs(section.nose) / section.radius)
    ids = ids_of(layers + 1, around)
    closed = np.column_stack([ids, ids[:, 0]])[:, ::-1]
    return jm.Mesh(nodes.reshape(-1, 2), {"quad": quads(closed)}, {"airfoil": ids[0], "farfield": ids[-1]})


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
        away = self.radius * (radius * np.exp(1j * (2 * np.pi * turn + self.start)) - np.exp(1j * self.start))
        power = (away / (2 + away)) ** self.power
        return 2 * self.power * power / (1 - power)


def rays(section: SharpSection, around: int, layers: int, first_cell: float, outermost: float) -> np.ndarray:
    """Places (layers + 1, around, 2) nodes on rays, spaced geometrically along each ray.

    The rays go from radius 1 to `outermost`.
    """
    turn = np.arange(around) / around
    radius = 1 + np.concatenate([[0.0], np.geomspace(1e-7, outermost - 1, SAMPLES)])[:, None]
    places = section(radius, turn)
    length = np.concatenate([np.zeros((1, around)), np.cumsum(np.abs(np.diff(places, axis=0)), axis=0)])
    stations = np.empty((layers + 1, around))
    for i in range(around):
        wanted = length[-1, i] * geometric(layers, first_cell / length[-1, i])
        stations[1:, i] = np.exp(np.interp(np.log(wanted[1:]), np.log(length[1:, i]), np.log(radius[1:, 0] - 1)))
    stations[0] = 0
    nodes = section(1 + stations, turn)
    return np.stack([np.real(nodes), np.imag(nodes)], axis=-1)
