"""Structured meshes in 3-D: a wing between two planes, and bricks of each type of cell."""

import numpy as np

import jaxmorph as jm

from .._host.package.arguments import between, checked
from ._naca import naca4
from ._structured import geometric, hexahedra, ids_of

# Corners of a hexahedron, in VTK's order, of the cells into which it is divided; 8 is its middle.
PARTS = {
    "hexahedron": ((0, 1, 2, 3, 4, 5, 6, 7),),
    "wedge": ((0, 5, 1, 3, 6, 2), (0, 4, 5, 3, 7, 6)),
    "tetra": ((0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6), (0, 5, 1, 6)),
    "pyramid": ((0, 1, 2, 3, 8), (4, 7, 6, 5, 8), (0, 4, 5, 1, 8), (1, 5, 6, 2, 8), (2, 6, 7, 3, 8), (3, 7, 4, 0, 8)),
}


@checked
def wing(
    code: str = "6409", *, points: int = 2000, stations: int = 13, span: float = 2.0, first_cell: float = 1e-5
) -> jm.Mesh:
    """Makes a swept and tapered wing of hexahedra between two planes.

    The C-grid of `naca4` is repeated at stations along y, from the root of chord 1 to the tip of
    chord 0.7. The tip's leading edge lies half a chord behind. Nodes on the wall lie much closer
    along the section than along the span: chains of nearest neighbours stay within one section.
    Patches: `wing`, `farfield`, and the planes `root` (y = 0) and `tip` (y = span).

    **Arguments:**

    - `code`: four digits of the section, as in `naca4`. Default "6409".
    - `points`: about how many points each station has, 300 or more. Default 2000.
    - `stations`: sections along the span, 2 or more. Default 13.
    - `span`: length of the wing, in chords of the root. Default 2.
    - `first_cell`: height of the cells at the wall, in chords of the root. Default 1e-5.

    **Returns:** a `Mesh`.

    **Raises:** `ValueError` for fewer than 2 stations, and as `naca4` does.
    """
    between("span", span, 0)
    if stations < 2:
        raise ValueError(f"a wing needs 2 stations, not {stations}.")
    section = naca4(code, points=points, first_cell=first_cell)
    n, cells = len(section.points), section.cells["quad"]
    eta = np.linspace(0, 1, stations)[:, None]
    x = (1 - 0.3 * eta) * section.points[:, 0] + 0.5 * eta
    z = (1 - 0.3 * eta) * section.points[:, 1]
    places = np.stack([x, np.broadcast_to(span * eta, x.shape), z], axis=-1).reshape(-1, 3)
    layers = cells + n * np.arange(stations)[:, None, None]
    corners = np.concatenate([layers[1:], layers[:-1]], axis=-1).reshape(-1, 8)
    ids = ids_of(stations, n)
    patches = {
        name: ids[:, section.patch(patch)].ravel() for name, patch in (("wing", "airfoil"), ("farfield", "farfield"))
    }
    return jm.Mesh(places, {"hexahedron": corners}, patches | {"root": ids[0], "tip": ids[-1]})


@checked
def bricks(kind: str = "hexahedron", *, cells: int = 6, first_cell: float | None = None) -> jm.Mesh:
    """Makes the unit cube of `cells` by `cells` by `cells` bricks, divided into cells of a type.

    Patches: `floor` (z = 0), `lid` (z = 1), `sides`, which share nodes.

    **Arguments:**

    - `kind`: the type of the cells. It is `hexahedron`, `wedge` (2 a brick), `tetra` (6 a brick),
      `pyramid` (6 a brick, around a node in its middle) or `mixed`. A mixed mesh has hexahedra at
      the floor, a layer of pyramids above, and wedges.
    - `cells`: bricks along each edge, 3 or more. Default 6.
    - `first_cell`: height of the bricks at z = 0, from which the layers grow. Default None: all
      layers are equal.

    **Returns:** a `Mesh`.

    **Raises:** `ValueError` for another kind, fewer than 3 cells, and a first cell that is not
    between 0 and 1.
    """
    if kind not in (*PARTS, "mixed") or cells < 3:
        raise ValueError(f"expected one of {', '.join(PARTS)}, mixed, and 3 cells at least, not {kind!r} and {cells}.")
    first = 1 / cells if first_cell is None else first_cell
    if not 0 < first < 1:
        raise ValueError(f"`first_cell` is {first}; the cube's side is 1.")
    z, x = geometric(cells, first), np.linspace(0, 1, cells + 1)
    height, across, along = np.meshgrid(z, x, x, indexing="ij")
    points = np.stack([along, across, height], axis=-1).reshape(-1, 3)
    ids = ids_of(*(cells + 1,) * 3)
    sides = np.concatenate([ids[:, [0, -1]].ravel(), ids[:, :, [0, -1]].ravel()])
    patches = {"floor": ids[0].ravel(), "lid": ids[-1].ravel(), "sides": sides}
    whole = hexahedra(ids)
    if kind != "mixed":
        return jm.Mesh(*_divided(points, {kind: whole}), patches)
    below, middle = (share * cells * cells for share in (cells // 2, cells // 2 + 1))
    layers = {"hexahedron": whole[:below], "pyramid": whole[below:middle], "wedge": whole[middle:]}
    return jm.Mesh(*_divided(points, layers), patches)


def _divided(points: np.ndarray, layers: dict[str, np.ndarray]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Divides bricks (k, 8) into cells of each type."""
    cells = {}
    for kind, corners in layers.items():
        if kind == "pyramid":
            middles = points[corners].mean(axis=1)
            corners = np.column_stack([corners, len(points) + np.arange(len(corners))])
            points = np.concatenate([points, middles])
        parts = np.array(PARTS[kind])
        cells[kind] = corners[:, parts].reshape(-1, parts.shape[1])
    return points, cells
