"""Walls of a surface: by faces between its nodes, or by chains of nearest neighbours; its order."""

import numpy as np
from numpy import ndarray

from ..cells.adjacency import parts_of
from ..cells.topology import ByType
from ..linear.products import outward, unit_rows
from ..package.rounding import Tree, distinct_places, nearest_of, ranked, resolution
from ..sources.farthest import farthest
from ..tolerances import CONCAVE, SAME

# distance of neighbours, relative to that of the eighth nearest node (2-D: second nearest)
REACH = 1.5
# most nodes of a curve, as its extent over the nearest node's distance; surfaces have more
CURVED = 4
CURVE_SAMPLE = 16  # nodes of a curve that vote for the next part
# nearest nodes among which a node finds its vote; if votes fail, all nodes are searched
VOTERS = 512


def walls(
    points: ndarray,
    moving: int,
    faces: ByType | None = None,
    in_planes: ndarray | None = None,
) -> ndarray:
    """Returns each surface node's wall (b,); the first `moving` nodes move.

    Moving and fixed nodes are on different walls. `faces` are rows of `points`, counterclockwise as
    seen from outside of the mesh. With faces, a wall continues from a face to its neighbours, but
    not round a corner of less than 135 degrees with the mesh inside. Floor and side of a box are
    two walls, both sides of an airfoil are one. Without faces, chains of nearest neighbours (2 in
    2-D, 8 in 3-D) join nodes. In structured 3-D meshes a chain may stay within one section of a
    wing, so parts that are curves are joined to the parts beside them. Nodes of symmetry planes,
    marked by `in_planes` (b,), take the wall of the nearest other node.
    """
    label = np.full(len(points), -1)
    groups = [
        sort_faces(np.asarray(group)) for _, group in sorted((faces or {}).items()) if len(group)
    ]
    if groups:
        label = _label_by_faces(points, moving, groups)
    else:
        others = np.arange(moving, len(points))
        others = others if in_planes is None else others[~in_planes[others]]
        label[:moving] = _label_by_chains(points[:moving])
        label[others] = _label_by_chains(points[others]) + 1 + label.max()
    known = np.flatnonzero(label >= 0)
    left = np.flatnonzero(label < 0)
    if left.size:
        label[left] = nearest_of(points[left], points[known], label[known])
    return np.unique(label, return_inverse=True)[1].astype(np.int32)


def sort_faces(faces: ndarray) -> ndarray:
    """Sorts faces (k, c) by their nodes, each from its first node on; edges keep their sense."""
    if faces.shape[1] > 2:
        turn = faces.argmin(axis=1)[:, None] + np.arange(faces.shape[1])
        faces = np.take_along_axis(faces, turn % faces.shape[1], axis=1)
    return faces[np.lexsort(faces.T[::-1])]


def ordered_rows(points: ndarray, moving: int, faces: ByType | None) -> ndarray:
    """Sorts nodes (b, d) by place, the first `moving` nodes before all others. Of nodes in one
    place, as on two sides of a slit, the directions of their `faces` decide.
    """
    columns = [ranked(column, resolution(points)) for column in points.T]
    is_still = np.arange(len(points)) >= moving
    order = np.lexsort([*columns[::-1], is_still])
    repeated = np.logical_and.reduce([np.diff(column[order]) == 0 for column in columns])
    if not repeated.any() or not faces:
        return order
    about = np.zeros((len(points), 2 * points.shape[1]))
    for corners in faces.values():
        arms = unit_rows(points[corners].mean(axis=1, keepdims=True) - points[corners])
        normal = np.broadcast_to(unit_rows(outward(points[corners]))[:, None], arms.shape)
        np.add.at(about, corners, np.concatenate([normal, arms], axis=2))
    columns += [ranked(column, SAME) for column in about.T]
    return np.lexsort([*columns[::-1], is_still])


def _label_by_faces(points: ndarray, moving: int, groups: list[ndarray]) -> ndarray:
    """The wall of every node (b,) by its faces; -1 for a node without faces."""
    normal = np.concatenate([outward(points[group]) for group in groups])
    middle = np.concatenate([points[group].mean(axis=1) for group in groups])
    first, second, agree = _pair_neighbours(groups)
    unit = unit_rows(normal)
    closing = np.einsum("kd,kd->k", unit[first], middle[second] - middle[first]) < 0
    sharp = (
        agree & closing & (np.einsum("kd,kd->k", unit[first], unit[second]) < CONCAVE * (1 - SAME))
    )
    fixed = np.concatenate([(group >= moving).any(axis=1) for group in groups])
    joined = (fixed[first] == fixed[second]) & ~sharp
    part = parts_of(first[joined], second[joined], len(fixed))
    # A moving node at the rim may have moving and fixed faces; its moving faces must name its wall,
    # and a fixed node's fixed faces. So these faces write last.
    node = np.concatenate([group.T.ravel() for group in groups])
    face = face_of_corner(groups)
    order = np.argsort((node >= moving) == fixed[face], kind="stable")
    label = np.full(len(points), -1)
    label[node[order]] = part[face[order]]
    return label


def face_of_corner(groups: list[ndarray]) -> ndarray:
    """The face of every corner, group by group (k, c), first corners of all its faces first."""
    starts = np.cumsum([0, *map(len, groups)])
    faces = zip(starts, groups, strict=False)
    return np.concatenate(
        [np.tile(start + np.arange(len(group)), group.shape[1]) for start, group in faces]
    )


def _pair_neighbours(groups: list[ndarray]) -> tuple[ndarray, ndarray, ndarray]:
    """Pairs of faces that share an edge (2-D: node), and a mask of opposite senses along it."""
    # Every face lists its edges; in 2-D its nodes, as an edge from the first and to the last.
    # Sorted by their nodes, lowest node first, equal edges are neighbours.
    start = np.concatenate([group.T.ravel() for group in groups])
    end = np.concatenate([np.roll(group, -1, axis=1).T.ravel() for group in groups])
    if groups[0].shape[1] == 2:
        is_first = np.repeat([True, False], len(start) // 2)
        start, end = np.where(is_first, start, -1), np.where(is_first, -1, start)
    owner = face_of_corner(groups)
    edge = np.sort([start, end], axis=0)
    turned = start < end
    order = np.lexsort(edge)
    same = (np.diff(edge[:, order]) == 0).all(axis=0)
    before = order[:-1][same]
    after = order[1:][same]
    return owner[before], owner[after], turned[before] != turned[after]


def _label_by_chains(points: ndarray) -> ndarray:
    """The wall of nodes (k,), all moving or all fixed, by chains of nearest neighbours."""
    first, inverse = distinct_places(points)
    unique = points[first]
    count = min({2: 2, 3: 8}[points.shape[1]], len(unique) - 1)
    if count < 1:
        return np.zeros(len(points), dtype=np.int64)
    distance, nearest = map(np.asarray, Tree(unique).query(unique, k=min(3 * count, len(unique))))
    near = distance <= REACH * (1 + SAME) * distance[:, count, None]
    label = parts_of(np.nonzero(near)[0], nearest[near], len(unique))
    if points.shape[1] == 3 and label.max() > 0:
        first_part, second_part = _join_curves(unique, label, distance[:, 1]).T
        label = parts_of(first_part, second_part, int(label.max()) + 1)[label]
    return label[inverse]


def _join_curves(points: ndarray, label: ndarray, spacing: ndarray) -> ndarray:
    """Pairs (p, 2) of every part that is a curve and the next part of its wall, on both sides."""
    pairs = []
    for curve in range(label.max() + 1):
        members = points[label == curve]
        others = np.flatnonzero(label != curve)
        extent = np.linalg.norm(np.ptp(members, axis=0))
        if len(members) > CURVED * (1 + SAME) * extent / np.median(spacing[label == curve]):
            continue
        tree = Tree(points[others])
        sample = members[farthest(members, CURVE_SAMPLE, 0.0)]
        for count in (VOTERS, len(others)):
            near = others[
                np.sort(tree.query(sample, k=range(1, min(count, len(others)) + 1))[1], axis=1)
            ]
            parts = _vote_for_parts(members, points[near] - sample[:, None], label[near])
            if parts:
                break
        pairs += [(curve, part) for part in parts]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def _vote_for_parts(curve: ndarray, offsets: ndarray, label: ndarray) -> list[int]:
    """The part next to a curve on either side, if most nodes of a sample of the curve find it.
    `offsets` (s, k, d) lead from the sample to other nodes, whose parts are `label` (s, k).
    """
    distance = np.linalg.norm(offsets, axis=2)
    parts = []
    size, axes = np.linalg.svd(curve - curve.mean(axis=0), full_matrices=False)[1:]
    # the normal of the curve's plane, or the way from a straight curve to the nearest node
    across = axes[-1]
    if not size[1] > 0.01 * size[0]:
        nearest = tuple(np.argwhere(distance <= (1 + SAME) * distance.min())[0])
        across = offsets[nearest] / distance[nearest]
    for side in (-1, 1):
        reachable = np.where(
            side * (offsets @ across) > 0.5 * (1 + SAME) * distance, distance, np.inf
        )
        least = reachable.min(axis=1)
        closest = np.where(reachable <= (1 + SAME) * least[:, None], label, label.max() + 1).min(
            axis=1
        )
        votes = np.bincount(closest[np.isfinite(least)], minlength=1)
        if 2 * votes.max() > len(distance):
            parts.append(int(votes.argmax()))
    return parts
