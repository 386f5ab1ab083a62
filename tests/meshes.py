"""Small meshes that many tests move: lattices, rings, bricks and bodies with named patches."""

import contextlib
import functools
import itertools
import pathlib

import numpy as np
import pytest
from scipy.spatial import ConvexHull

import jaxmorph as jm
from jaxmorph import io
from jaxmorph._host.cells.lagrange import lagrange_types
from jaxmorph._host.cells.topology import FACES
from jaxmorph._quality.distortion import IDEAL

TETRAHEDRA = [[0, 4, 6, 7], [0, 6, 2, 7], [0, 2, 3, 7], [0, 3, 1, 7], [0, 1, 5, 7], [0, 5, 4, 7]]
"""The six tetrahedra of a cube, by corners 4 i + 2 j + k."""


INWARD = [face[::-1] for face in FACES["hexahedron"]]
"""The sides of a cube as its middle sees them."""


@contextlib.contextmanager
def gmsh_session():
    """Opens gmsh, silent, and closes it; skips the test where gmsh is not installed."""
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    try:
        yield gmsh
    finally:
        gmsh.finalize()


def lattice(*axes) -> np.ndarray:
    """Lists the points (n, d) of a product of axes, the last one fastest."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def blocks(ids: np.ndarray) -> np.ndarray:
    """Lists the quads of ids (i, j), or the hexahedra of ids (i, j, k), numbered as in VTK."""
    low, high = slice(0, -1), slice(1, None)
    around = [(low, low), (high, low), (high, high), (low, high)]
    ends = [()] if ids.ndim == 2 else [(low,), (high,)]
    return np.stack([ids[(*side, *end)].ravel() for end in ends for side in around], axis=1)


def tetrahedra(ids: np.ndarray) -> np.ndarray:
    """Lists six tetrahedra for each cube of ids (i, j, k)."""
    low, high = slice(0, -1), slice(1, None)
    corners = np.stack(
        [ids[i, j, k].ravel() for i in (low, high) for j in (low, high) for k in (low, high)],
        axis=1,
    )
    return np.concatenate([corners[:, row] for row in TETRAHEDRA])


def sides(points: np.ndarray) -> dict[str, np.ndarray]:
    """Lists the nodes of a unit box's sides: `x0`, `x1`, `y0` and so on."""
    ways = itertools.product(range(points.shape[1]), (0, 1))
    return {f"{'xyz'[axis]}{side}": np.flatnonzero(points[:, axis] == side) for axis, side in ways}


def grid(*axes, patches=None) -> jm.Mesh:
    """Makes quads or hexahedra on a product of axes; `patches` names ids by functions of their array."""
    points = lattice(*axes)
    ids = np.arange(len(points)).reshape([len(axis) for axis in axes])
    names = {name: np.ravel(of(ids)) for name, of in (patches or {}).items()}
    return jm.Mesh(points, {"quad" if len(axes) == 2 else "hexahedron": blocks(ids)}, names)


def unit_grid(count: int, dimension: int = 2) -> jm.Mesh:
    """Makes the unit square of quads, or the unit cube of hexahedra, `count` along each side."""
    return grid(*[np.linspace(0, 1, count + 1)] * dimension)


def unit_box(count: int = 3) -> jm.Mesh:
    """Makes the unit cube of hexahedra, its six sides as patches."""
    mesh = unit_grid(count, 3)
    return jm.Mesh(mesh.points, mesh.cells, sides(mesh.points))


def square(count: int = 3) -> jm.Mesh:
    """Makes a square of quads with the patches `wall` (bottom), `far` (the three other sides) and `left`."""
    far = lambda ids: np.unique(np.concatenate([ids[0, 1:], ids[-1, 1:], ids[:, -1]]))  # noqa: E731
    patches = {"wall": lambda ids: ids[:, 0], "far": far, "left": lambda ids: ids[0]}
    return grid(*[np.linspace(0, 1, count + 1)] * 2, patches=patches)


def bricks(count: int = 3) -> jm.Mesh:
    """Makes hexahedra in the unit cube; the patch `floor` is at z = 0."""
    return grid(*[np.linspace(0, 1, count + 1)] * 3, patches={"floor": lambda ids: ids[:, :, 0]})


def mixed() -> jm.Mesh:
    """Makes a unit square of one quad and two triangles beside it, which come after it in the mesh as in the alphabet."""
    points = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [2, 0], [2, 1]], dtype=float)
    return jm.Mesh(points, {"triangle": [[1, 4, 5], [1, 5, 2]], "quad": [[0, 1, 2, 3]]})


def wedges() -> jm.Mesh:
    """Makes a hexahedron and two wedges beside it, between the patches `floor` and `roof`."""
    points = np.array([[x, y, z] for z in (0.0, 1.0) for y in (0.0, 1.0) for x in (0.0, 1.0, 2.0)])
    cells = {
        "hexahedron": [[0, 1, 4, 3, 6, 7, 10, 9]],
        "wedge": [[1, 2, 4, 7, 8, 10], [2, 5, 4, 8, 11, 10]],
    }
    return jm.Mesh(points, cells, {"floor": np.arange(6), "roof": np.arange(6, 12)})


REFLECTED = {
    **{
        "triangle": [0, 2, 1],
        "quad": [0, 3, 2, 1],
        "tetra": [0, 2, 1, 3],
        "pyramid": [0, 3, 2, 1, 4],
    },
    **{"wedge": [0, 2, 1, 3, 5, 4], "hexahedron": [0, 3, 2, 1, 4, 7, 6, 5]},
}
"""The nodes of a cell that is listed the other way round, left-handed, by type."""

TURNED = {
    **{
        "triangle": [1, 2, 0],
        "quad": [1, 2, 3, 0],
        "tetra": [1, 2, 0, 3],
        "pyramid": [1, 2, 3, 0, 4],
    },
    **{"wedge": [1, 2, 0, 4, 5, 3], "hexahedron": [1, 2, 3, 0, 5, 6, 7, 4]},
}
"""The nodes of a cell that begins with its second corner, by type."""


def renumbered(mesh: jm.Mesh, seed: int) -> tuple[jm.Mesh, np.ndarray]:
    """Numbers nodes, cells and patches at random, half of the cells the other way round; and lists each node's old number."""
    random = np.random.default_rng(seed)
    old = random.permutation(len(mesh.points))
    new, cells, patches = np.argsort(old), {}, {}
    for kind, ids in reversed(mesh.cells.items()):
        corners = random.permutation(new[ids])
        for table in (REFLECTED, TURNED):
            chosen = random.random(len(corners)) < 0.5
            corners[chosen] = corners[chosen][:, table[kind]]
        cells[kind] = corners
    for name, ids in reversed(mesh.patches.items()):
        patches[name] = random.permutation(new[ids])
    return jm.Mesh(np.asarray(mesh.points)[old], cells, patches), old


def with_hole(points: np.ndarray, cells: dict) -> jm.Mesh:
    """Makes the unit square or cube without its middle third: the patches are `wall`, around the hole, and `far`."""
    middle = {
        kind: np.abs(points[ids].mean(axis=1) - 0.5).max(axis=1) for kind, ids in cells.items()
    }
    left = {kind: ids[middle[kind] > 1 / 6] for kind, ids in cells.items()}
    used = np.unique(np.concatenate([ids.ravel() for ids in left.values()]))
    points, away = points[used], np.abs(points[used] - 0.5).max(axis=1)
    patches = {"wall": np.flatnonzero(away < 1 / 6 + 1e-9), "far": np.flatnonzero(away == 0.5)}
    return jm.Mesh(
        points, {kind: np.searchsorted(used, ids) for kind, ids in left.items()}, patches
    )


@functools.cache
def even(kind: str) -> jm.Mesh:
    """Makes a lattice with a hole, full of equal distances: `2-D` of quads and triangles, `3-D` of four types, or `tetra`."""
    count = 12 if kind == "2-D" else 6
    points = lattice(*[np.linspace(0, 1, count + 1)] * (2 if kind == "2-D" else 3))
    ids = np.arange(len(points)).reshape([count + 1] * points.shape[1])
    if kind == "tetra":
        return with_hole(points, {"tetra": tetrahedra(ids)})
    whole = blocks(ids)
    column = np.floor(points[whole].mean(axis=1) * count)[:, :2].astype(
        int
    )  # cut whole columns: faces match
    if kind == "2-D":
        cut = whole[column.sum(axis=1) % 3 == 0]
        triangles = np.concatenate([cut[:, [0, 1, 2]], cut[:, [0, 2, 3]]])
        return with_hole(points, {"quad": whole[column.sum(axis=1) % 3 > 0], "triangle": triangles})
    third = column.sum(axis=1) % 3
    split, peaks, bricks = (whole[third == k] for k in range(3))
    wedges = np.concatenate([split[:, [0, 1, 2, 4, 5, 6]], split[:, [0, 2, 3, 4, 6, 7]]])
    tip = len(points) + np.arange(len(peaks))
    pyramids = np.concatenate([np.column_stack([peaks[:, list(face)], tip]) for face in INWARD])
    points = np.concatenate([points, points[peaks].mean(axis=1)])
    return with_hole(points, {"hexahedron": bricks, "wedge": wedges, "pyramid": pyramids})


def half(mesh: jm.Mesh, bent: float = 0.0, is_passage: bool = False) -> jm.Mesh:
    """Makes the upper half of a lattice with a hole on a floor `plane`, `bent` by some height; a passage has open sides."""
    points = np.asarray(mesh.points)
    cells = {kind: ids[points[ids].mean(axis=1)[:, -1] > 0.5] for kind, ids in mesh.cells.items()}
    used = np.unique(np.concatenate([ids.ravel() for ids in cells.values()]))
    cells = {kind: np.searchsorted(used, ids) for kind, ids in cells.items()}
    x = points[used]
    side = {"left": x[:, 0] == 0, "right": x[:, 0] == 1, "plane": x[:, -1] == 0.5}
    side["wall"], side["far"] = (
        np.isin(used, mesh.patches["wall"]),
        np.isin(used, mesh.patches["far"]),
    )
    if is_passage:
        side["far"] &= (np.abs(x[:, 1:] - 0.5) == 0.5).any(axis=1)
    x = (
        x
        + bent
        * np.eye(x.shape[1])[-1]
        * (np.sin(3 * x[:, 0]) * np.sin(4 * x[:, 1]) * (1 - x[:, -1]))[:, None]
    )
    return jm.Mesh(x, cells, {name: np.flatnonzero(mask) for name, mask in side.items()})


def slit(count: int) -> jm.Mesh:
    """Makes a square of quads with a slit in the middle, the `wall`, whose two sides have nodes of their own."""
    axis = np.linspace(-1, 1, count + 1)
    mesh = grid(axis, axis)
    points = np.asarray(mesh.points)
    inner = np.flatnonzero((points[:, 1] == 0) & (np.abs(points[:, 0]) < 0.5))
    twin = np.arange(len(points))
    twin[inner] = len(points) + np.arange(len(inner))
    quads = mesh.cells["quad"].copy()
    above = points[quads].mean(axis=1)[:, 1] > 0
    quads[above] = twin[quads[above]]
    ends = np.flatnonzero((points[:, 1] == 0) & (np.abs(np.abs(points[:, 0]) - 0.5) < 1e-9))
    wall, far = (
        np.concatenate([inner, twin[inner], ends]),
        np.flatnonzero(np.abs(points).max(axis=1) == 1),
    )
    return jm.Mesh(
        np.concatenate([points, points[inner]]), {"quad": quads}, {"wall": wall, "far": far}
    )


def thin(around: int) -> jm.Mesh:
    """Makes rings of quads about an ellipse 50 times as long as high."""
    wall, far, share = (
        circle(around) * [0.5, 0.01],
        6 * circle(around),
        np.linspace(0, 1, 12)[:, None, None] ** 2,
    )
    ids = np.arange(12 * around).reshape(12, around)
    quads = blocks(np.concatenate([ids, ids[:, :1]], axis=1))
    return jm.Mesh(
        (wall + share * (far - wall)).reshape(-1, 2),
        {"quad": quads},
        {"wall": ids[0], "far": ids[-1]},
    )


def filled(kind: str, count: int = 3) -> jm.Mesh:
    """Makes the unit square or cube of right-handed cells of any one type; edges of `count` steps."""
    cell = lagrange_types()[kind]
    axes = [np.linspace(0, 1, count + 1)] * cell.dimension
    points = lattice(*axes)
    ids = np.arange(len(points)).reshape([count + 1] * cell.dimension)
    cubes = blocks(ids)
    if cell.shape == "pyramid":  # six in each cube, about its middle
        faces = [cubes[:, list(face[::-1])] for face in FACES["hexahedron"]]
        apex = len(points) + np.arange(len(cubes))
        points = np.concatenate([points, points[cubes].mean(axis=1)])
        cells = np.concatenate([np.column_stack([face, apex]) for face in faces])
    elif cell.shape == "tetra":
        cells = tetrahedra(ids)
    else:
        rows = {
            "triangle": [[0, 1, 2], [0, 2, 3]],
            "wedge": [[0, 1, 2, 4, 5, 6], [0, 2, 3, 4, 6, 7]],
        }
        cells = np.concatenate(
            [cubes[:, row] for row in rows.get(cell.shape, [range(cubes.shape[1])])]
        )
    if cell.shape == "tetra":  # the list of six is right-handed up to a turn
        edges = points[cells[:, 1:]] - points[cells[:, :1]]
        cells = np.where((np.linalg.det(edges) < 0)[:, None], cells[:, [0, 2, 1, 3]], cells)
    outer = np.flatnonzero(np.any((points == 0) | (points == 1), axis=1))
    mesh = jm.Mesh(points, {cell.shape: cells}, {"boundary": outer})
    return mesh if cell.order == 1 else jm.elevate(mesh, cell.order)


def reflected(mesh: jm.Mesh, seed: int = 0) -> jm.Mesh:
    """Lists about half of the cells of a mesh the other way round."""
    rng, cells = np.random.default_rng(seed), {}
    for kind, ids in mesh.cells.items():
        lattice = lagrange_types()[kind].lattice
        place = {tuple(at): row for row, at in enumerate(lattice.tolist())}
        mirror = [
            place[tuple(at)] for at in lattice[:, [1, 0, *range(2, lattice.shape[1])]].tolist()
        ]
        cells[kind] = np.where(rng.random((len(ids), 1)) < 0.5, np.asarray(ids)[:, mirror], ids)
    return jm.Mesh(mesh.points, cells, mesh.patches)


def with_folds(mesh: jm.Mesh, count: int = 1, seed: int = 0) -> np.ndarray:
    """Moves inner nodes of a `filled` mesh past the cells around them: points on which some cells are folded."""
    points, rng = np.array(mesh.points), np.random.default_rng(seed)
    inner = np.flatnonzero(np.all((points > 0) & (points < 1), axis=1))
    nodes = rng.choice(inner, count, replace=False)
    way = rng.normal(size=(count, points.shape[1]))
    points[nodes] += 0.45 * way / np.linalg.norm(way, axis=1, keepdims=True)
    return points


def on_circle(angle) -> np.ndarray:
    """Lists points of the unit circle by their angles."""
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def circle(count: int) -> np.ndarray:
    """Lists points of the unit circle, the first one on the x axis."""
    return on_circle(2 * np.pi / count * np.arange(count))


def ring(around: int = 24, radii=None, names=("wall", "far")) -> jm.Mesh:
    """Makes rings of quads around a circle: the first nodes are the inner patch, the last ones the outer one."""
    radii = np.geomspace(1, 5, 9) if radii is None else np.asarray(radii)
    points = (radii[:, None, None] * circle(around)).reshape(-1, 2)
    ids = np.arange(len(points)).reshape(len(radii), around)
    closed = np.concatenate([ids, ids[:, :1]], axis=1)
    return jm.Mesh(points, {"quad": blocks(closed)}, {names[0]: ids[0], names[1]: ids[-1]})


def write_ring(file: pathlib.Path) -> jm.Mesh:
    """Writes the default ring; its wall has the ids 0 to 23."""
    mesh = ring()
    io.write(file, mesh)
    return mesh


def sphere(count: int) -> np.ndarray:
    """Lists points spread evenly over the unit sphere, no four of them in one plane but by accident."""
    i = np.arange(count) + 0.5
    polar, azimuth = np.arccos(1 - 2 * i / count), np.pi * (1 + 5**0.5) * i
    return np.stack(
        [np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)], axis=1
    )


def ball(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Lists points of the unit sphere, and the triangles of their convex hull, which look outwards."""
    points = sphere(count)
    faces = ConvexHull(points).simplices
    a, b, c = np.moveaxis(points[faces], 1, 0)
    inwards = np.sum(np.cross(b - a, c - a) * a, axis=1) < 0
    faces[inwards] = faces[inwards][:, ::-1]
    return points, faces


@functools.cache
def box_with_hole(cells: int = 8) -> jm.Mesh:
    """Makes a square of quads with a square hole in the middle; its outer sides are patches."""
    half = cells / 2
    points = lattice(*[np.arange(cells + 1.0)] * 2) - half
    quads = blocks(np.arange(len(points)).reshape(cells + 1, cells + 1))
    quads = quads[(np.abs(points[quads].mean(axis=1)) > 1).any(axis=1)]
    used, quads = np.unique(quads, return_inverse=True)
    points = points[used]
    patches = {"hole": np.flatnonzero((np.abs(points) <= 1).all(axis=1))}
    for name, axis, side in (
        ("left", 0, -half),
        ("right", 0, half),
        ("bottom", 1, -half),
        ("top", 1, half),
    ):
        patches[name] = np.flatnonzero(points[:, axis] == side)
    return jm.Mesh(points, {"quad": quads.reshape(-1, 4)}, patches)


@functools.cache
def drum(shape: str = "cylinder") -> jm.Mesh:
    """Makes bricks between an inner cylinder and a shroud around z, 12 around, 4 along; lids at z = 0 and 1."""
    r, angle, z = np.meshgrid(
        np.linspace(0, 1, 4), 2 * np.pi / 12 * np.arange(12), np.linspace(0, 1, 5), indexing="ij"
    )
    outer = {"cylinder": 2 + 0 * z, "cone": 2 + 0.5 * z, "bell": 2 + 0.3 * np.sin(2 * z)}[shape]
    radius = 1 + r * (outer - 1)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=-1).reshape(-1, 3)
    ids = np.arange(r.size).reshape(r.shape)
    ids = np.concatenate([ids, ids[:, :1]], axis=1)
    patches = {"hub": ids[0], "shroud": ids[-1], "bottom": ids[..., 0], "top": ids[..., -1]}
    return jm.Mesh(
        points,
        {"hexahedron": blocks(ids)},
        {name: np.unique(nodes) for name, nodes in patches.items()},
    )


def shaken(mesh: jm.Mesh, size: float, seed: int = 0) -> np.ndarray:
    """Lists the points of a mesh, displaced at random."""
    return np.asarray(mesh.points) + size * np.random.default_rng(seed).normal(
        size=mesh.points.shape
    )


def turn(angle: float, dimension: int) -> np.ndarray:
    """Returns the matrix of a rotation about z."""
    matrix = np.eye(dimension)
    matrix[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return matrix


def sector(dimension: int, sectors: int = 4, whole: bool = False):
    """A ring from radius 1, which moves, to 2, which is fixed with both ends in 3-D; its nodes, lists, sides and a motion."""
    steps = 6
    count = steps * sectors if whole else steps + 1
    axes = [
        np.linspace(1, 2, 5),
        2 * np.pi / sectors / steps * np.arange(count),
        np.linspace(0, 1, 4),
    ][:dimension]
    r, angle, *z = lattice(*axes).T
    points = np.stack([r * np.cos(angle), r * np.sin(angle), *z], axis=1)
    rests = (r == 2) | (np.isin(z[0], (0, 1)) if z else False)
    moving, fixed = np.flatnonzero((r == 1) & ~rests), np.flatnonzero(rests)
    first, last = np.flatnonzero(angle == 0), np.flatnonzero(np.isclose(angle, 2 * np.pi / sectors))
    wave = np.stack([np.cos(2 * r), np.sin(sectors * angle + 1), *z], axis=1)
    u = np.einsum("nij,nj->ni", np.stack([turn(each, dimension) for each in angle]), 0.03 * wave)
    return points, moving, fixed, (first, last), u[moving]


def joined(dimension: int, pair, **keywords) -> jm.Periodic:
    """Makes the boundary that joins both sides of a quarter of a wheel."""
    axis = {"axis": (0, 0, 2)} if dimension == 3 else {"about": (0, 0)}
    return jm.Periodic(*pair, rotation=np.pi / 2, **axis, **keywords)


def naca(camber, place, thickness, count=61, last=0.1015) -> np.ndarray:
    """Lists nodes of a NACA 4-digit airfoil: upper side from nose to tail, then the lower side."""
    s = 0.5 * (1 - np.cos(np.linspace(0, np.pi, count)))
    half = (
        5
        * thickness
        * (0.2969 * np.sqrt(s) - 0.126 * s - 0.3516 * s**2 + 0.2843 * s**3 - last * s**4)
    )
    front, scale = s < place, np.where(s < place, place, 1 - place)
    line = camber / scale**2 * (np.where(front, 0, 1 - 2 * place) + 2 * place * s - s**2)
    theta = np.arctan(2 * camber / scale**2 * (place - s))
    upper = np.column_stack([s - half * np.sin(theta), line + half * np.cos(theta)])
    lower = np.column_stack([s + half * np.sin(theta), line - half * np.cos(theta)])
    return np.concatenate([upper, lower[1:]])


def cusped(t: np.ndarray) -> np.ndarray:
    """A cusped section of 15 % thickness, concave behind 45 % of the chord, its cusp cut to 0.3 % of the chord."""
    x = t**2
    half = 0.15 / 0.75**1.5 * np.abs(t) * np.clip(1 - x, 0, None) ** 1.5 + 0.0015 * x
    return np.column_stack([x, np.sign(t) * half])


def pair(kind):
    """Two cells of ideal shape that share their first face or edge, the second mirrored: neighbours, as a mesh has them."""
    ideal = np.array(IDEAL[kind], dtype=float)
    axis = 1 if ideal.shape[1] == 2 else 2
    shared = np.flatnonzero(ideal[:, axis] == 0)
    second = np.arange(len(ideal)) + len(ideal)
    second[shared] = shared
    points = np.concatenate([ideal, ideal * np.where(np.arange(ideal.shape[1]) == axis, -1, 1)])
    used = np.unique(np.concatenate([np.arange(len(ideal)), second]))
    place = np.full(len(points), -1)
    place[used] = np.arange(len(used))
    return jm.Mesh(points[used], {kind: place[np.stack([np.arange(len(ideal)), second])]})


def capsule(degrees: float, count: int = 3, *, whole: bool = False) -> jm.Mesh:
    """Makes layers around a capsule along z: between two half planes through z, or all around."""
    step = np.deg2rad(degrees) / (count - 1)
    around = step * np.arange(round(360 / degrees) * (count - 1) if whole else count)
    tall = np.linspace(0, np.pi, 7)
    layers = np.linspace(0, 1, 4) ** 1.5
    out = np.stack([np.sin(tall), np.cos(tall)], axis=1)
    profile = out + [0, 1] * np.sign(np.round(out[:, 1:], 9))
    r, z = np.moveaxis(profile + layers[:, None, None] * (6 * out - profile), 2, 0)[..., None]
    r[:, [0, -1]] = 0
    # nodes of the axis come first, each once
    ids = np.empty((len(layers), len(tall), len(around)), int)
    ids[:, [0, -1]] = np.arange(2 * len(layers)).reshape(-1, 2, 1)
    ids[:, 1:-1] = 2 * len(layers) + np.arange(ids[:, 1:-1].size).reshape(ids[:, 1:-1].shape)
    points = np.zeros((ids.max() + 1, 3))
    points[ids] = np.stack([r * np.cos(around), r * np.sin(around), z + 0 * around], axis=-1)
    if whole:
        ids = np.concatenate([ids, ids[:, :, :1]], axis=2)
    ends = []
    for tip, ring in ((0, 1), (-1, -2)):
        sides = [ids[:, ring, :-1], ids[:, ring, 1:]]
        triangles = np.stack([ids[:, tip, :-1], *(sides if tip == 0 else sides[::-1])], axis=-1)
        ends.append(np.concatenate([triangles[:-1], triangles[1:]], axis=-1).reshape(-1, 6))
    cells = {"hexahedron": blocks(ids[:, 1:-1]), "wedge": np.concatenate(ends)}
    return jm.Mesh(points, cells, {"wall": np.unique(ids[0]), "far": np.unique(ids[-1])})


def between_half_planes(degrees: float) -> list[jm.Plane]:
    """The two half planes of `capsule`, as symmetry planes."""
    angle = np.deg2rad(degrees)
    return [
        jm.Plane((0, 1, 0), (0, 0, 0)),
        jm.Plane((-np.sin(angle), np.cos(angle), 0), (0, 0, 1)),
    ]
