"""Walls that nearly touch: a valve, a blade's tip, bodies in a box."""

from collections.abc import Mapping, Sequence

import numpy as np

import jaxmorph as jm

from .._host.package.arguments import checked, finite_array
from ._structured import geometric, hexahedra, ids_of, quads


@checked
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
        raise ValueError(f"a valve needs a lift from 0 to 0.5 and 2 layers, not {lift} and {layers}.")
    first, roof = lift / layers, lift + 0.15
    x = np.concatenate(
        [np.linspace(0, 0.5, 11), np.linspace(0.5, 0.7, 9)[1:], 0.7 + 0.8 * geometric(14, 0.025 / 0.8)[1:]]
    )
    below, above = -0.6 * geometric(14, first / 0.6)[:0:-1], roof + (1 - roof) * geometric(14, first / (1 - roof))[1:]
    y = np.concatenate([below, np.linspace(0, lift, layers + 1), np.linspace(lift, roof, 5)[1:], above])
    places, cells = _cut((y, x), lambda y, x: ((y < 0) & (x > 0.5)) | ((x < 0.7) & (y > lift) & (y < roof)))
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
    return jm.Mesh(np.stack([x, y], axis=1), {"quad": cells}, {k: np.flatnonzero(v) for k, v in patches.items()})


@checked
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
        raise ValueError(f"a blade's tip needs a gap from 0 to 0.5 and 2 layers, not {gap} and {layers}.")
    x, angle, tip = np.linspace(-1, 1, 25), np.linspace(-0.4, 0.4, 25), 2 - gap
    r = np.concatenate([np.linspace(1, tip, 13), tip + gap * np.arange(1, layers + 1) / layers])
    places, cells = _cut((r, angle, x), lambda r, angle, x: (np.abs(x) < 0.25) & (np.abs(angle) < 0.06) & (r < tip))
    r, angle, x = places.T
    near = 1e-9
    blade = (np.abs(x) <= 0.25 + near) & (np.abs(angle) <= 0.4 / 6 + near) & (r <= tip + near)
    patches = {"blade": blade, "shroud": r == r.max(), "hub": (r == 1) & ~blade}
    patches |= {"inlet": x == -1, "outlet": x == 1, "left": angle == angle.min(), "right": angle == angle.max()}
    points = np.stack([x, r * np.sin(angle), r * np.cos(angle)], axis=1)
    return jm.Mesh(points, {"hexahedron": cells}, {k: np.flatnonzero(v) for k, v in patches.items()})


@checked
def bodies(
    boxes: Mapping[str, Sequence[float]], *, box: Sequence[float] = (-8.0, 8.0, -4.0, 4.0), spacing: float = 0.25
) -> jm.Mesh:
    """Makes squares around rectangular bodies in a box, which may pass each other or part.

    Patches: each body by its name, and `farfield`.

    **Arguments:**

    - `boxes`: each body's sides, (x least, x largest, y least, y largest), by its name. They are
      moved to the nearest grid line.
    - `box`: sides of the box, as in `boxes`. Default: 16 wide and 8 high about the origin.
    - `spacing`: side of a cell, about; a whole number of them fills the box. Default 0.25.

    **Returns:** a `Mesh`.

    **Raises:** `ValueError` for sides in another order, and a body without a cell within or beside
    it.
    """
    left, right, bottom, top = finite_array("box", box, (4,)).tolist()
    sides = {name: finite_array(f"boxes[{name!r}]", box, (4,)).tolist() for name, box in boxes.items()}
    ends = []
    if not (left < right and bottom < top and spacing > 0):
        raise ValueError(f"a box has x and y from least to largest and a positive spacing, not {box} and {spacing}.")
    axes = [
        np.linspace(*side, 1 + max(1, round((side[1] - side[0]) / spacing))) for side in ((bottom, top), (left, right))
    ]
    for name, (x0, x1, y0, y1) in sides.items():
        near = [
            np.abs(axis[:, None] - side).argmin(axis=0) for axis, side in zip(axes, ((y0, y1), (x0, x1)), strict=True)
        ]
        if any(not 0 < first < last < len(axis) - 1 for axis, (first, last) in zip(axes, near, strict=True)):
            raise ValueError(
                f"body {name!r} at {(x0, x1, y0, y1)} has no cell within it or beside it: try a smaller spacing."
            )
        ends.append([axis[i] for axis, i in zip(axes, near, strict=True)])

    def within(y, x, margin):
        return [(y > a - margin) & (y < b + margin) & (x > c - margin) & (x < d + margin) for (a, b), (c, d) in ends]

    places, cells = _cut(axes, lambda y, x: np.any([np.zeros(len(x), bool), *within(y, x, 0.0)], axis=0))
    y, x = places.T
    patches = dict(zip(boxes, within(y, x, 1e-9), strict=True))
    patches["farfield"] = (y == bottom) | (y == top) | (x == left) | (x == right)
    return jm.Mesh(np.stack([x, y], axis=1), {"quad": cells}, {k: np.flatnonzero(v) for k, v in patches.items()})


def _cut(axes: Sequence[np.ndarray], is_solid) -> tuple[np.ndarray, np.ndarray]:
    """Makes the grid between axes without cells whose middle is solid."""
    ids = ids_of(*map(len, axes))
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    cells = quads(ids) if len(axes) == 2 else hexahedra(ids)
    cells = cells[~is_solid(*places[cells].mean(axis=1).T)]
    used, cells = np.unique(cells, return_inverse=True)
    return places[used], cells.reshape(-1, 2 ** len(axes))
