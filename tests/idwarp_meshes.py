"""Grid files for the tests of IDWarp's calls: the unit cube on a floor, structured, unstructured, and as a case of OpenFOAM."""

import functools
import pathlib

import cgns
import foam
import h5py
import numpy as np
import plot3d
from meshes import blocks

CELLS = 4
SIDES = {
    "floor": (2, 0.0),
    "lid": (2, 1.0),
    "sym0": (0, 0.0),
    "xmax": (0, 1.0),
    "sym1": (1, 0.0),
    "ymax": (1, 1.0),
}
"""Patches of the cube: the axis that each is across, and where."""


def cube():
    """Coordinates (5, 5, 5, 3) of the cube's nodes by i, j, k; layers grow from the floor."""
    x, z = np.linspace(0, 1, CELLS + 1), np.linspace(0, 1, CELLS + 1) ** 1.5
    return np.stack(np.meshgrid(x, x, z, indexing="ij"), axis=-1)


def corners(shape):
    """Hexahedra between nodes numbered with i fastest."""
    return blocks(np.arange(np.prod(shape)).reshape(shape, order="F"))


def on(points, name):
    axis, place = SIDES[name]
    return (
        np.flatnonzero(points[..., axis].ravel() == place)
        if points.ndim == 2
        else points[..., axis] == place
    )


CONDITIONS = {"floor": "BCWallViscous", "sym0": "BCSymmetryPlane", "sym1": "BCSymmetryPlane"}


def write_structured(path):
    """Two blocks that meet at x = 1/2; the family of a side is called as the side, and says what it is."""
    grid = cube()
    with h5py.File(path, "w", track_order=True) as file:
        write_zones(cgns.base(file, 3, 3), {"left": grid[:3], "right": grid[2:]}, CONDITIONS)
    return np.concatenate([part.reshape(-1, 3, order="F") for part in (grid[:3], grid[2:])])


def write_zones(base, blocks, conditions, suffix="", shift=(0, 0, 0)):
    """Blocks of the cube as zones; the family of a side is called as the side with a suffix, and says what it is."""
    for side in SIDES:
        family = cgns.node(base, side + suffix, "Family_t")
        cgns.node(family, "FamilyBC", "FamilyBC_t", conditions.get(side, "BCFarfield"))
    for name, part in blocks.items():
        zone = cgns.zone(base, name, [part[..., k] + shift[k] for k in range(3)])
        for side, (axis, place) in SIDES.items():
            is_on = np.all(part[..., axis] == place, axis=tuple(k for k in range(3) if k != axis))
            if is_on.any():
                low, high = np.ones(3, int), np.array(part.shape[:3])
                low[axis] = high[axis] = 1 + np.flatnonzero(is_on)[0]
                cgns.condition(
                    zone, f"{side} of {name}", np.stack([low, high], axis=1).T, family=side + suffix
                )


OVERSET = {
    "wing.00000": (0, 0, 0),
    "wing.00001": (0, 0, 0),
    "tip.00000": (0, 0.5, 0),
    "far.00000": (0.2, 0.3, 0.4),
}
"""Zones of the file of `write_overset`, and where each cube stands."""


def overset_blocks():
    grid = cube()
    return {"wing.00000": grid[:3], "wing.00001": grid[2:], "tip.00000": grid, "far.00000": grid}


def overset_floors():
    """Faces of the lowest side of each zone, four corners each, and the zone of each face."""
    floors = [
        np.array(floor_faces(part)) + OVERSET[name] for name, part in overset_blocks().items()
    ]
    return np.concatenate(floors), np.repeat(
        np.arange(len(floors)), [len(each) // 4 for each in floors]
    )


def floor_faces(grid):
    """Corners of the faces at the lowest k, four for each."""
    turns, faces = (
        ((0, 0), (1, 0), (1, 1), (0, 1)),
        np.ndindex(grid.shape[0] - 1, grid.shape[1] - 1),
    )
    return [grid[i + a, j + b, 0] for i, j in faces for a, b in turns]


def write_overset(path, names=("wing", "tip", "far")):
    """Three cubes that overlap, as cgns_utils joins them: two with a floor, in three zones, and one without. Returns the nodes."""
    parts = {zone: part for zone, part in overset_blocks().items() if zone.split(".")[0] in names}
    with h5py.File(path, "w", track_order=True) as file:
        base = cgns.base(file, 3, 3)
        for name in names:
            own = {zone: part for zone, part in parts.items() if zone.startswith(name)}
            conditions = (
                {} if name == "far" else {"floor": "BCWallViscous", "sym0": "BCSymmetryPlane"}
            )
            write_zones(base, own, conditions, f"_{name}", OVERSET[next(iter(own))])
    return np.concatenate(
        [part.reshape(-1, 3, order="F") + OVERSET[zone] for zone, part in parts.items()]
    )


def write_unstructured(path, names=None):
    """One zone; `names` call sides otherwise."""
    grid = cube()
    points, cells = grid.reshape(-1, 3, order="F"), corners(grid.shape[:3])
    with h5py.File(path, "w", track_order=True) as file:
        zone = cgns.zone(cgns.base(file, 3, 3), "zone", list(points.T), cells=len(cells))
        cgns.elements(zone, "hexahedra", 17, cells + 1, 1, len(cells))
        for side in SIDES:
            nodes, family = on(points, side)[:, None] + 1, (names or {}).get(side, side)
            cgns.condition(zone, side, nodes, family=family, location="Vertex", what="PointList")
    return points


def write_plot3d(path):
    grid = cube()
    plot3d.write(pathlib.Path(path), [np.moveaxis(grid, -1, 0)], "text")
    return grid.reshape(-1, 3, order="F")


TYPES = {"floor": "wall", "sym0": "symmetryPlane", "sym1": "symmetry"}


def write_openfoam(folder, parts=False):
    """The case whole, and in two parts where `parts` is set."""
    grid = cube()
    points = grid.reshape(-1, 3, order="F")
    cells = foam.hexahedra(corners(grid.shape[:3]))
    is_on = lambda nodes, axis, place: bool((points[nodes, axis] == place).all())  # noqa: E731
    kinds = {name: TYPES.get(name, "patch") for name in SIDES}
    tests = [
        (name, kinds[name], functools.partial(is_on, axis=axis, place=at))
        for name, (axis, at) in SIDES.items()
    ]
    foam.write_case(folder, points, cells, tests)
    if parts:
        owner = [int(points[cell[0], 0].min() >= 0.5) for cell in corners(grid.shape[:3])]
        foam.write_parts(folder, points, cells, tests, owner)
    return points


FILES = {
    "structured": ("grid.cgns", "CGNS", write_structured),
    "unstructured": ("mesh.cgns", "CGNS", write_unstructured),
    "plot3d": ("grid.xyz", "PLOT3D", write_plot3d),
    "openfoam": ("case", "OpenFOAM", write_openfoam),
}


def bump(points):
    """Moves the floor where it is not near its edges, by a shape that is smooth, and symmetric about x = 0 and y = 0."""
    x, y = points[:, 0], points[:, 1]
    height = 0.1 * np.cos(np.pi * x / 2) ** 2 * np.cos(np.pi * y / 2) ** 2
    return points + np.stack([0.05 * x * (1 - x), 0.3 * height * y, height], axis=1)
