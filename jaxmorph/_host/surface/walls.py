"""Walls of a surface: by faces between its nodes, or by chains of nearest neighbours; its order."""

from collections.abc import Mapping

import numpy as np

from ..cells.adjacency import parts_of
from ..linear.products import outward, unit_rows
from ..package.rounding import SAME, Tree, distinct, nearest_of, ranked
from ..sources.farthest import farthest

SHARP = np.cos(np.deg2rad(45))
"""Cosine of the angle at a concave corner from which on its two faces belong to different walls."""

REACH = 1.5  # distance of neighbours, relative to that of the eighth nearest node (2-D: second nearest)
CURVED = 4  # most nodes of a curve, as its extent over the nearest node's distance; surfaces have more
SAMPLE = 16  # nodes of a curve that vote for the next part
AROUND = 512  # nearest nodes among which a node finds its vote; if votes fail, all nodes are searched


def walls(
    points: np.ndarray,
    moving: int,
    faces: Mapping[str, np.ndarray] | None = None,
    in_planes: np.ndarray | None = None,
) -> np.ndarray:
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
    groups = [in_order(np.asarray(group)) for _, group in sorted((faces or {}).items()) if len(group)]
    if groups:
        label = _by_faces(points, moving, groups)
    else:
        others = np.arange(moving, len(points))
        others = others if in_planes is None else others[~in_planes[others]]
        label[:moving] = _by_chains(points[:moving])
        label[others] = _by_chains(points[others]) + 1 + label.max()
    known, left = np.flatnonzero(label >= 0), np.flatnonzero(label < 0)
    if left.size:
        label[left] = nearest_of(points[left], points[known], label[known])
    return np.unique(label, return_inverse=True)[1].astype(np.int32)


def in_order(faces: np.ndarray) -> np.ndarray:
    """Sorts faces (k, c) by their nodes, each from its first node on; edges keep their sense."""
    if faces.shape[1] > 2:
        turn = faces.argmin(axis=1)[:, None] + np.arange(faces.shape[1])
        faces = np.take_along_axis(faces, turn % faces.shape[1], axis=1)
    return faces[np.lexsort(faces.T[::-1])]


def ordered_rows(points: np.ndarray, moving: int, faces: Mapping[str, np.ndarray] | None) -> np.ndarray:
    """Sorts nodes (b, d) by place, the first `moving` nodes before all others. Of nodes in one
    place, as on two sides of a slit, the directions of their `faces` decide.
    """
    columns = [ranked(column, SAME * float(np.ptp(points, axis=0).max(initial=0))) for column in points.T]
    is_still = np.arange(len(points)) >= moving
    order = np.lexsort([*columns[::-1], is_still])
    repeated = np.logical_and.reduce([np.diff(column[order]) == 0 for column in columns])
    if not repeated.any() or not faces:
        return order
    about = np.zeros((len(points), 2 * points.shape[1]))
    for corners in faces.values():
        x = points[corners]
        for node, place in zip(corners.T, x.swapaxes(0, 1), strict=True):
            np.add.at(about, node, np.concatenate([unit_rows(outward(x)), unit_rows(x.mean(axis=1) - place)], axis=1))
    columns += [ranked(column, SAME) for column in about.T]
    return np.lexsort([*columns[::-1], is_still])


def _by_faces(points: np.ndarray, moving: int, groups: list[np.ndarray]) -> np.ndarray:
    """The wall of every node (b,) by its faces; -1 for a node without faces."""
    normal = np.concatenate([outward(points[group]) for group in groups])
    middle = np.concatenate([points[group].mean(axis=1) for group in groups])
    first, second, agree = _beside(groups)
    unit = unit_rows(normal)
    closing = np.einsum("kd,kd->k", unit[first], middle[second] - middle[first]) < 0
    sharp = agree & closing & (np.einsum("kd,kd->k", unit[first], unit[second]) < SHARP * (1 - SAME))
    fixed = np.concatenate([(group >= moving).any(axis=1) for group in groups])
    joined = (fixed[first] == fixed[second]) & ~sharp
    part = parts_of(first[joined], second[joined], len(fixed))
    label, starts = np.full(len(points), -1), np.cumsum([0, *map(len, groups)])
    # A moving node at the rim may have moving and fixed faces; its moving faces must name its wall,
    # and a fixed node's fixed faces. So these faces write last.
    for of_own_kind in (False, True):
        for group, start in zip(groups, starts, strict=False):
            face = slice(start, start + len(group))
            for column in group.T:
                rows = ((column >= moving) == fixed[face]) == of_own_kind
                label[column[rows]] = part[face][rows]
    return label


def _beside(groups: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of faces that share an edge (2-D: node), and a mask of opposite senses along it."""
    # Every face lists its edges. Sorted by their nodes, lowest node first, equal edges are
    # neighbours. The sense of an edge is lost by that, so `turned` keeps it.
    edges, owners, start = [], [], 0
    for group in groups:
        count = group.shape[1]
        starts = [group[:, [k, k]] for k in range(2)] if count == 2 else []
        edges += starts or [group[:, [k, (k + 1) % count]] for k in range(count)]
        owners += [np.arange(start, start + len(group))] * count
        start += len(group)
    edge, owner = np.concatenate(edges), np.concatenate(owners)
    turned = edge[:, 0] < edge[:, 1]
    if groups[0].shape[1] == 2:
        turned = np.repeat([False, True], len(edge) // 2)
    edge = np.sort(edge, axis=1)
    order = np.lexsort(edge.T)
    before, after = order[:-1], order[1:]
    same = (edge[after] == edge[before]).all(axis=1)
    before, after = before[same], after[same]
    return owner[before], owner[after], turned[before] != turned[after]


def _by_chains(points: np.ndarray) -> np.ndarray:
    """The wall of nodes (k,), all moving or all fixed, by chains of nearest neighbours."""
    first, inverse = distinct(points)
    unique = points[first]
    count = min({2: 2, 3: 8}[points.shape[1]], len(unique) - 1)
    if count < 1:
        return np.zeros(len(points), dtype=np.int64)
    distance, nearest = map(np.asarray, Tree(unique).query(unique, k=min(3 * count, len(unique))))
    near = distance <= REACH * (1 + SAME) * distance[:, count, None]
    label = parts_of(np.nonzero(near)[0], nearest[near], len(unique))
    if points.shape[1] == 3 and label.max() > 0:
        first, second = _next_to_curves(unique, label, distance[:, 1])
        label = parts_of(first, second, int(label.max()) + 1)[label]
    return label[inverse]


def _next_to_curves(points: np.ndarray, label: np.ndarray, spacing: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs every part that is a curve with the next part of its wall, on both sides, if most nodes
    of a sample of the curve find one part there.
    """
    tree, pairs = Tree(points), []
    for curve in range(label.max() + 1):
        members = np.flatnonzero(label == curve)
        extent = np.linalg.norm(np.ptp(points[members], axis=0))
        if len(members) > CURVED * (1 + SAME) * extent / np.median(spacing[members]):
            continue
        sample = points[members[farthest(points[members], SAMPLE, 0.0)]]
        around = np.sort(np.asarray(tree.query(sample, k=min(AROUND, len(points)))[1]).reshape(len(sample), -1), axis=1)
        pairs += _votes(points, label, members, sample, around) or _votes(
            points, label, members, sample, np.broadcast_to(np.arange(len(points)), (len(sample), len(points)))
        )
    first, second = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    return first, second


def _votes(points: np.ndarray, label: np.ndarray, members: np.ndarray, sample: np.ndarray, around: np.ndarray) -> list:
    curve = label[members[0]]
    offsets = points[around] - sample[:, None]
    distance = np.where(label[around] == curve, np.inf, np.linalg.norm(offsets, axis=2))
    if not np.isfinite(distance).any():
        return []
    across, pairs = _across(points[members], offsets, distance), []
    for side in (-1, 1):
        reachable = np.where(side * (offsets @ across) > 0.5 * (1 + SAME) * distance, distance, np.inf)
        least = reachable.min(axis=1)
        closest = np.where(reachable <= (1 + SAME) * least[:, None], label[around], len(points)).min(axis=1)
        votes = np.bincount(closest[np.isfinite(least)], minlength=1)
        if 2 * votes.max() > len(sample):
            pairs.append((curve, int(votes.argmax())))
    return pairs


def _across(curve: np.ndarray, offsets: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """The normal of a curve's plane, or the way from a straight curve to the nearest node."""
    size, axes = np.linalg.svd(curve - curve.mean(axis=0), full_matrices=False)[1:]
    if size[1] > 0.01 * size[0]:
        return axes[-1]
    sample, node = np.argwhere(distance <= (1 + SAME) * distance.min())[0]
    return offsets[sample, node] / distance[sample, node]
