"""A ball in prisms onto a scan of an ellipsoid with a bump: `shapes.onto`, and what SciPy's user would write.

PyGeM takes the same displacements as SciPy's interpolator: its radial functions want every control point before and after.
"""

import inspect

import jax
import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.spatial import ConvexHull, KDTree

import jaxmorph as jm
from jaxmorph import shapes


def ball(count: int) -> tuple[np.ndarray, np.ndarray]:
    i = np.arange(count) + 0.5
    polar, azimuth = np.arccos(1 - 2 * i / count), np.pi * (1 + 5**0.5) * i
    points = np.stack(
        [np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)], axis=1
    )
    faces = ConvexHull(points).simplices
    inward = np.linalg.det(points[faces]) < 0
    return points, np.where(inward[:, None], faces[:, ::-1], faces)


def in_prisms(count: int, layers: int = 16, first_cell: float = 1e-4) -> jm.Mesh:
    points, faces = ball(count)
    radii = 1 + np.append(0, first_cell * 2.0 ** np.arange(layers))
    first = count * np.arange(layers)[:, None, None]
    prisms = np.concatenate([faces + first, faces + first + count], axis=2).reshape(-1, 6)
    ids = np.arange(count)
    places = (radii[:, None, None] * points).reshape(-1, 3)
    return jm.Mesh(places, {"wedge": prisms}, {"wall": ids, "far": ids + count * layers})


def scan(count: int) -> jm.Facets:
    points, faces = ball(count)
    bump = 0.15 * np.exp(-np.sum((points - [0.6, 0.5, 0.62]) ** 2, axis=1) / 0.3)
    return jm.Facets((1 + bump)[:, None] * points * [1.25, 1, 0.9], faces)


def by_jaxmorph(mesh, target):
    u = shapes.onto(jm.Facets.of(mesh, "wall"), target)
    return jm.deform(jm.prepare(mesh, "wall", "far"), u)


def by_nearest_vertex(mesh, target):
    points, wall, far = np.asarray(mesh.points), mesh.patch("wall"), mesh.patch("far")
    nearest = np.asarray(target.points)[KDTree(target.points).query(points[wall])[1]]
    u = np.concatenate([nearest - points[wall], np.zeros((len(far), 3))])
    return points + RBFInterpolator(points[np.concatenate([wall, far])], u)(points)


def by_closest_place(mesh, target):
    points, wall, far = np.asarray(mesh.points), mesh.patch("wall"), mesh.patch("far")
    corners, x = np.asarray(target.points)[target.faces], points[wall]
    best, place = np.full(len(x), np.inf), x.copy()
    for a, b, c in corners:  # closest place of each triangle: plane, then edges
        normal = np.cross(b - a, c - a)
        flat = x - np.outer((x - a) @ normal / (normal @ normal), normal)
        sides = [np.cross(q - p, flat - p) @ normal for p, q in ((a, b), (b, c), (c, a))]
        found = [np.where((np.min(sides, axis=0) >= 0)[:, None], flat, a)]
        for p, q in ((a, b), (b, c), (c, a)):
            t = np.clip((x - p) @ (q - p) / ((q - p) @ (q - p)), 0, 1)
            found.append(p + t[:, None] * (q - p))
        for each in found:
            away = np.linalg.norm(each - x, axis=1)
            place[away < best], best = each[away < best], np.minimum(best, away)
    u = np.concatenate([place - x, np.zeros((len(far), 3))])
    return points + RBFInterpolator(points[np.concatenate([wall, far])], u)(points)


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    mesh, target = in_prisms(300), scan(1200)
    wall, nodes = jm.Facets.of(mesh, "wall"), mesh.patch("wall")
    sizes = np.linalg.norm(np.asarray(wall.areas()), axis=1)
    print(
        "| way | lines | distance | faces, smallest to largest | first height | inverted |\n|---|---|---|---|---|---|"
    )
    for way in (by_jaxmorph, by_nearest_vertex, by_closest_place):
        points = np.asarray(way(mesh, target))
        ratio = np.linalg.norm(np.asarray(wall.at(points[nodes]).areas()), axis=1) / sizes
        height = np.asarray(jm.wall_quality(mesh, nodes, points).height)
        lines = len(inspect.getsource(way).splitlines()) - 1
        off, inverted = (
            float(target.distance(points[nodes]).max()),
            int(jm.quality(mesh, points).inverted),
        )
        faces, first = (f"{each.min():.2f} to {each.max():.2f}" for each in (ratio, height))
        print(f"| {way.__name__} | {lines} | {off:.1e} | {faces} | {first} | {inverted} |")


if __name__ == "__main__":
    main()
