"""Aspect ratio and skewness as OpenFOAM's checkMesh measures them: from the faces of cells, and skewness without upper bound."""

import numpy as np
from jaxtyping import Float, Int

from jaxmorph import Mesh
from jaxmorph._host.topology import CORNERS, DIMENSION, FACES

Vectors = Float[np.ndarray, "t d"]
FLOOR = 1e-300


def face_skewness(mesh: Mesh, points: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " k"]:
    """For each cell the largest over its faces; 0 for boundary elements.

    How far the line between the centres of two cells passes by the centre of their face, over the face's reach in that
    direction (at least 0.2 of the line's length; at the boundary 0.4 of the distance from the cell's centre to the plane of
    the face). In the plane faces are edges.

    Raises `ValueError` for surfaces in space.
    """
    faces, owner, total, corners = _faces_at(mesh, points)
    centre, area = _centres_and_areas(corners)
    own = _cell_centres(centre, area, owner, total)[0][owner]
    other = _behind(faces)
    inside = other >= 0
    normal = area / np.maximum(np.linalg.norm(area, axis=1, keepdims=True), FLOOR)
    arm = centre - own
    across = np.where(inside[:, None], own[other] - own, normal * _dot(normal, arm)[:, None])
    along = _dot(area, across)
    along = np.where(along == 0, FLOOR, along)
    by = arm - (_dot(area, arm) / along)[:, None] * across
    size = np.linalg.norm(by, axis=1)
    direction = by / np.maximum(size, FLOOR)[:, None]
    reach = np.abs(np.einsum("td,tcd->tc", direction, corners - centre[:, None])).max(axis=1)
    least = np.where(inside, 0.2, 0.4) * np.linalg.norm(across, axis=1)
    result = np.zeros(total)
    np.maximum.at(result, owner, size / np.maximum(np.maximum(reach, least), FLOOR))
    return result


def face_aspect_ratio(mesh: Mesh, points: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " k"]:
    """For each cell the largest of the sums of its faces' areas as seen along the axes, over the smallest; 1 for boundary elements.

    In space at least a sixth of those sums together over the volume to the power of 2/3. Depends on how a cell lies in the axes.

    Raises `ValueError` for surfaces in space.
    """
    _, owner, total, corners = _faces_at(mesh, points)
    centre, area = _centres_and_areas(corners)
    seen = _summed(np.abs(area), owner, total)
    counted = np.bincount(owner, minlength=total) > 0
    ratio = seen.max(axis=1) / np.maximum(seen.min(axis=1), FLOOR)
    if area.shape[1] == 3:
        volume = np.abs(_cell_centres(centre, area, owner, total)[1]) / 3
        ratio = np.maximum(ratio, seen.sum(axis=1) / 6 / np.maximum(volume, FLOOR) ** (2 / 3))
    return np.where(counted, ratio, 1.0)


def _faces_at(mesh: Mesh, points: Float[np.ndarray, "n d"]) -> tuple[np.ndarray, np.ndarray, int, np.ndarray]:
    """`_faces`, and the places of their corners."""
    points = np.asarray(points, float)
    faces, owner, total = _faces(mesh)
    if faces.shape[1] != points.shape[1] + (points.shape[1] == 3):
        raise ValueError("OpenFOAM's measures are for meshes that fill the plane or space, not for surfaces in space.")
    return faces, owner, total, points[np.where(faces < 0, faces[:, :1], faces)]


def _centres_and_areas(corners: Float[np.ndarray, "t c d"]) -> tuple[Vectors, Vectors]:
    return _edges(corners) if corners.shape[2] == 2 else _polygons(corners)


def _faces(mesh: Mesh) -> tuple[Int[np.ndarray, "t c"], Int[np.ndarray, " t"], int]:
    """Corners of each face of each cell of the highest dimension (-1 behind those of a triangle), its cell, all cells' number."""
    highest = max(DIMENSION[kind] for kind, ids in mesh.cells.items() if len(ids))
    width = 2 if highest == 2 else max(CORNERS["quad"], highest)
    faces, owners, first = [np.zeros((0, width), np.int64)], [np.zeros(0, np.int64)], 0
    for kind, ids in mesh.cells.items():
        if DIMENSION[kind] == highest:
            for face in FACES[kind]:
                padded = np.full((len(ids), width), -1)
                padded[:, : len(face)] = np.asarray(ids)[:, face]
                faces.append(padded)
                owners.append(first + np.arange(len(ids)))
        first += len(ids)
    return np.concatenate(faces), np.concatenate(owners), first


def _behind(faces: Int[np.ndarray, "t c"]) -> Int[np.ndarray, " t"]:
    """The same face as its other cell sees it, -1 where there is none."""
    key = np.sort(faces, axis=1)
    order = np.lexsort(key.T)
    same = np.flatnonzero((key[order[1:]] == key[order[:-1]]).all(axis=1))
    behind = np.full(len(faces), -1)
    behind[order[same]], behind[order[same + 1]] = order[same + 1], order[same]
    return behind


def _edges(corners: Float[np.ndarray, "t 2 2"]) -> tuple[Vectors, Vectors]:
    along = corners[:, 1] - corners[:, 0]
    return corners.mean(axis=1), np.stack([along[:, 1], -along[:, 0]], axis=1)


def _polygons(corners: Float[np.ndarray, "t 4 3"]) -> tuple[Vectors, Vectors]:
    """Centres and area vectors, by triangles about the mean of the corners; a corner that comes twice does no harm."""
    middle = corners.mean(axis=1, keepdims=True)
    after = np.roll(corners, -1, axis=1)
    areas = np.cross(after - corners, middle - corners) / 2
    weights = np.linalg.norm(areas, axis=2, keepdims=True)
    total = np.maximum(weights.sum(axis=1), FLOOR)
    return (weights * (corners + after + middle) / 3).sum(axis=1) / total, areas.sum(axis=1)


def _cell_centres(
    centre: Vectors, area: Vectors, owner: Int[np.ndarray, " t"], total: int
) -> tuple[Vectors, np.ndarray]:
    """Centres of mass, by pyramids (triangles in the plane) from the faces to the mean of their centres; volumes times d."""
    d = centre.shape[1]
    count = np.maximum(np.bincount(owner, minlength=total), 1)[:, None]
    middle = (_summed(centre, owner, total) / count)[owner]
    volume = _dot(area, centre - middle)[:, None]
    moments = _summed(volume * (d * centre + middle) / (d + 1), owner, total)
    volumes = _summed(volume, owner, total)
    return moments / np.where(volumes == 0, FLOOR, volumes), volumes[:, 0]


def _summed(values: Float[np.ndarray, "t k"], owner: Int[np.ndarray, " t"], total: int) -> Float[np.ndarray, "c k"]:
    return np.stack([np.bincount(owner, column, minlength=total) for column in values.T], axis=1)


def _dot(a: Vectors, b: Vectors) -> Float[np.ndarray, " t"]:
    return np.einsum("td,td->t", a, b)
