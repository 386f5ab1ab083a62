"""The skin of the moving walls: edges between its nodes, the size of bodies, sharp tips in 2-D."""

import dataclasses

import numpy as np
from numpy import ndarray
from scipy.spatial import ConvexHull, QhullError

from ..cells.topology import ByType, Pair
from ..linear.products import dot_rows, outward, row_lengths
from ..package.rounding import (
    Tree,
    canonical_order,
    distinct_places,
    extent_of,
    first_largest,
    morton_order,
    nearest_few,
    nearest_of,
    ranked,
    roundoff,
    spacing,
)
from ..rows import join_ids
from ..sources.farthest import farthest
from ..tolerances import ON_PLANE, SAME, SHARP_TIP

# radii of pairs of rings at which a body's field comes to rest in value and slope, relative to the
# body's radius; the first pair stands where no fixed node is near
RINGS = (
    (12, 24),
    (40, 80),
)
PAST_RINGS = 1.1  # least distance of fixed nodes, relative to the second ring
HULL_SIDES = 64  # largest sides of the surface's hull on which free nodes are searched
# distance of the points of a ring, relative to its radius: 25 on a circle, so that it does not
# matter which ones they are
RING_STEP = {
    2: 0.25,
    3: 0.5,
}


def edges(points: ndarray, moving: int, faces: ByType | None = None) -> ndarray:
    """Lists pairs (e, 2) of neighbouring rows among the first `moving` surface rows, each once.
    Pairs are the sides of the `faces`, else neighbours by distance. None coincide.
    """
    pairs = []
    for corners in (faces or {}).values():
        inside = corners[(corners < moving).all(axis=1)]
        pairs.append(np.stack([inside, np.roll(inside, -1, axis=1)], axis=2))
    sides = join_ids(pairs).reshape(-1, 2)
    sides = np.unique(
        np.sort(sides if len(sides) else _pair_nearest(points[:moving]), axis=1), axis=0
    )
    length = row_lengths(points[sides[:, 1]] - points[sides[:, 0]])
    return sides[length > roundoff(points)]


def _pair_nearest(points: ndarray) -> ndarray:
    """Pairs a node with its nearest and the nearest behind it (2-D), or its six nearest (3-D)."""
    first = distinct_places(points)[0]
    unique = points[first]
    start = np.arange(len(first))
    if len(unique) < 2:
        return np.zeros((0, 2), dtype=np.int64)
    nearest = nearest_few(unique, unique, min(7, len(unique)))[:, 1:]
    if points.shape[1] == 2:
        arm = unique[nearest] - unique[:, None]
        behind = np.einsum("kcd,kd->kc", arm, arm[:, 0]) < -SAME * (arm[:, :1] ** 2).sum(axis=2)
        nearest = np.column_stack([nearest[:, 0], nearest[start, behind.argmax(axis=1)]])
    return first[np.column_stack([np.repeat(start, nearest.shape[1]), nearest.ravel()])]


def thinned(places: ndarray, most: int) -> ndarray:
    """Picks the ids of at most `most` places, spread like all places."""
    if len(places) <= most:
        return np.arange(len(places))
    canonical = canonical_order(places)
    order = canonical[morton_order(places[canonical])]
    return np.sort(order[np.linspace(0, len(order) - 1, most).astype(np.int64)])


def chords(points: ndarray, wall: ndarray, faces: ByType | None = None) -> Pair:
    """Finds two distant nodes of every wall (w, 2), and measures its mean chord (w,). It is half of
    the wall's length, in 3-D of its area over the distance of the two nodes: a wing's chord, about
    the diameter of a sphere.
    """
    size = np.bincount(wall, _measure_shares(points, faces))
    ends = np.zeros((len(size), 2), dtype=np.int32)
    order = canonical_order(points)
    for label in np.unique(wall):
        members = order[wall[order] == label]
        start = points[members].mean(axis=0)
        for k in range(2):
            ends[label, k] = members[first_largest(((points[members] - start) ** 2).sum(axis=1))]
            start = points[ends[label, k]]
    span = row_lengths(points[ends[:, 0]] - points[ends[:, 1]])
    safe = np.where(span > 0, span, 1)
    return ends, size / (2 * safe ** (points.shape[1] - 1))


def _measure_shares(points: ndarray, faces: ByType | None) -> ndarray:
    """Measures the length (2-D) or area (3-D) around every node (b,); an estimate without faces."""
    share = np.zeros(len(points))
    for corners in (faces or {}).values():
        np.add.at(
            share,
            corners,
            row_lengths(outward(points[corners]))[:, None] / corners.shape[1],
        )
    left = np.flatnonzero(share == 0)
    count = min(2 if points.shape[1] == 2 else 6, len(points) - 1)
    if not left.size or count < 1:
        return share
    distance = np.asarray(Tree(points).query(points[left], k=count + 1)[0])[:, 1:]
    share[left] = (
        distance.mean(axis=1)
        if points.shape[1] == 2
        else np.pi * distance[:, -1] ** 2 / (count + 0.5)
    )
    return share


def nearest_held(points: ndarray, moving: int, wall: ndarray, pairs: ndarray) -> ndarray:
    """Finds each edge's (e,) nearest row fixed or on another wall; else the edge's first row."""
    middle = points[pairs].mean(axis=1)
    nearest = pairs[:, 0].copy()
    label_of_edge = wall[pairs[:, 0]]
    for label in np.unique(label_of_edge):
        here = np.flatnonzero(label_of_edge == label)
        others = np.flatnonzero((wall != label) | (np.arange(len(wall)) >= moving))
        if others.size:
            nearest[here] = nearest_of(middle[here], points[others], others)
    return nearest


def drawn_in(
    surface: ndarray, centre: ndarray, body: ndarray, fixed: ndarray, images: ndarray
) -> tuple:
    """Finds distant fixed sources, and shares of the way to them where rings stand. The way
    begins at the centre of the `body`, the places of its nodes.
    """
    way = row_lengths(surface - centre)
    own = fixed[images[fixed] == fixed]
    size = row_lengths(body - centre).max()
    rows = []
    shares = []
    for rings in RINGS:
        is_beyond = way[own] > PAST_RINGS * (1 + SAME) * rings[1] * size
        is_near = rings == RINGS[0] and not is_beyond.all()
        if is_near or not is_beyond.any() or size == 0:  # one moving node has no size
            continue
        far = own[is_beyond]
        far = far[canonical_order(surface[far])]
        step = RING_STEP[surface.shape[1]] * way[far]
        far = far[farthest(surface[far], len(far), 0.0, reach=step)]
        far = fixed[np.isin(images[fixed], far)]
        rows += [far] * 2
        shares += [radius * size / way[far] for radius in rings]
    return join_ids(rows), np.concatenate([[], *shares])


def has_free_sides(surface: ndarray, is_free: ndarray, points: ndarray) -> bool:
    """Checks whether a flat side of the surface's hull holds points that are not on the surface.
    `surface` (b, d) has images in symmetry planes; `is_free` (n,) marks `points` off the surface.
    """
    try:
        hull = ConvexHull(surface)
    except QhullError:
        return False
    # Facets of one plane have equal rounded equations. Their areas add up to a side's, and only the
    # largest sides are looked at, by the equation of their largest facet.
    size = row_lengths(outward(surface[hull.simplices]))
    order = np.argsort(-size, kind="stable")
    equations = hull.equations[order]
    size = size[order]
    first, plane = np.unique(
        np.round(equations, 6), axis=0, return_index=True, return_inverse=True
    )[1:]
    area = np.bincount(plane.ravel(), size)
    largest = first[np.argsort(ranked(-area, SAME * area.max()), kind="stable")[:HULL_SIDES]]
    slack = ON_PLANE * float(extent_of(surface))
    free = points[is_free]
    return any(
        (free @ np.array(normal) + offset > -slack).sum() > 1
        for *normal, offset in equations[largest]
    )


def has_free_faces(points: ndarray, faces: ByType, is_held: ndarray) -> bool:
    """Checks whether boundary faces, but for the sides of a cut, have corners that are not held."""
    free = [corners[~is_held[corners].all(axis=1)] for corners in faces.values()]
    middles = np.concatenate([points[corners].mean(axis=1) for corners in free])
    return len(middles) > 0 and bool((spacing(middles) > SAME * extent_of(points)).any())


# distances of sources from a tip over the mean chord: waves invert cells at tips
NEARBY = (0.002, 0.008, 0.032)
# least distance of a place behind a tip from the wall, relative to its distance from the tip
AWAY = 0.7


@dataclasses.dataclass(frozen=True)
class Tips:
    """Sharp tips of walls in 2-D, and walls as chains of places (coincident nodes are one).

    - `rows` (p,), `points` (p, 2): a row of the surface at every place, and its coordinates.
    - `ends` (e, 2): the two places of every edge.
    - `count` (p,), `beside` (p, 2): number of neighbours of a place, and two of them.
    - `tips` (t,): places at which a wall is sharp.
    """

    rows: ndarray
    points: ndarray
    ends: ndarray
    beside: ndarray
    count: ndarray
    tips: ndarray

    def lengths(self, tip: int, lengths: ndarray) -> ndarray:
        return lengths[(self.ends == tip).any(axis=1)]

    def sides(self, tip: int, length: float) -> list[int]:
        """Finds the first place at the distance `length` on both sides of a tip."""
        found = []
        reach = length * (1 - SAME)
        for place in self.beside[tip].tolist():  # follows the wall, or to its end
            before = tip
            while (
                self.count[place] == 2
                and np.linalg.norm(self.points[place] - self.points[tip]) < reach
            ):
                ahead = int(self.beside[place].sum()) - before
                if ahead == tip:
                    break
                before = place
                place = ahead
            found.append(place)
        return found


def sharp_tips(points: ndarray, pairs: ndarray) -> Tips:
    """Finds the sharp tips of the walls with the edges `pairs` (e, 2)."""
    first, same = distinct_places(points[pairs.ravel()])
    rows = pairs.ravel()[first]
    ends = same.reshape(-1, 2)  # the two nodes of a closed edge are one place
    place = points[rows]
    directed = np.unique(np.concatenate([ends, ends[:, ::-1]]), axis=0)  # sorted by start
    first = np.searchsorted(directed[:, 0], np.arange(len(place) + 1))
    beside = directed[np.minimum(first[:-1, None] + [0, 1], len(directed) - 1), 1]
    count = np.diff(first)
    arms = place[beside] - place[:, None]
    is_sharp = dot_rows(arms[:, 0], arms[:, 1]) > SHARP_TIP * (1 + SAME) * np.linalg.norm(
        arms, axis=2
    ).prod(axis=1)
    return Tips(rows, place, ends, beside, count, np.flatnonzero((count == 2) & is_sharp))


def behind_tips(walls: Tips, length: ndarray, closest: float, room: ndarray) -> ndarray:
    """Lists rows (g, 3): a sharp tip of a wall, and a node on either side. The middle of the two,
    mirrored in the tip, lies behind it. Its distance is at least `length`, at least one edge, more
    than `closest`, and less than `room`, both of edges (e,).
    """
    place = walls.points
    found = []
    for tip in walls.tips.tolist():
        sides = walls.sides(tip, walls.lengths(tip, length).min())
        image = 2 * place[tip] - place[sides].mean(axis=0)
        step = np.linalg.norm(image - place[tip])
        is_free = row_lengths(place - image).min() > AWAY * (1 + SAME) * step
        if closest * (1 + SAME) < step < walls.lengths(tip, room).min() * (1 - SAME) and is_free:
            found.append([tip, *sides])
    return walls.rows[np.array(found, dtype=np.int64).reshape(-1, 3)]


def beside_tips(walls: Tips, chord: ndarray) -> ndarray:
    """Lists rows on both sides of sharp tips, at distances `NEARBY`; edges (e,) have a `chord`.
    Distances shorter than the wall's edges at the tip are left out.
    """
    length = row_lengths(np.subtract(*walls.points[walls.ends.T]))
    places = [
        place
        for tip in walls.tips.tolist()
        for share in NEARBY
        if share * walls.lengths(tip, chord).min() >= walls.lengths(tip, length).max() * (1 - SAME)
        for place in walls.sides(tip, share * walls.lengths(tip, chord).min())
    ]
    return walls.rows[np.unique(np.array(places, dtype=np.int64))]
