"""Place of an airfoil: its chord, and the nodes on its upper side."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from jaxmorph.extend import Module, Tree, checked, finite_array

from ._arguments import Column, Numbers, Positions, Scalar, Vector, known_positions, rows_of
from ._walls import simplices_of

Mask = Bool[np.ndarray, " k"]
Places = Float[np.ndarray, "k 2"]

SAME = 1e-9  # distance in chords within which two nodes stand at one place
TIE = 1e-12  # difference in chords within which two tours are equally long
AT = 1e-3  # share of an edge within which the nose or the tail is the node at its end
BLUNT = 0.1  # largest length in chords of a blunt tail whose corner is given as the tail

CORNER, SHARP = np.cos(
    np.deg2rad([45, 135])
)  # cosines of turns at a corner of a blunt tail: upper, lower bound


class Chord(Module):
    """The chord of an airfoil, from point `nose` (d,) to `tail`, and the direction `up` across it.

    By default `up` (d,) is the chord turned to the left; 3-D needs it.

    **Raises:** `ValueError` for a chord without length, and for no `up` in 3-D.
    """

    nose: Vector
    tail: Vector
    up: Vector

    @checked
    def __init__(
        self, nose: Numbers = (0.0, 0.0), tail: Numbers = (1.0, 0.0), up: Numbers | None = None
    ):
        nose = finite_array("nose", nose, (2,), (3,))
        tail = finite_array("tail", tail, nose.shape)
        if (nose == tail).all():
            raise ValueError(f"a chord from {nose} to {tail}: expected two different points.")
        if up is None and len(nose) == 3:
            raise ValueError("`up` is missing: a chord in 3-D needs the direction across it.")
        along = (tail - nose) / np.linalg.norm(tail - nose)
        across = (
            np.array([-along[1], along[0]]) if up is None else finite_array("up", up, nose.shape)
        )
        if not across.any():
            raise ValueError(f"`up` is {across}; expected a direction ({len(nose)},).")
        self.nose, self.tail = jnp.asarray(nose, float), jnp.asarray(tail, float)
        self.up = jnp.asarray(across / np.linalg.norm(across), float)

    @property
    def length(self) -> Scalar:
        return jnp.linalg.norm(self.tail - self.nose)

    def coordinates(self, x: Positions) -> tuple[Column, Column]:
        """Computes the place along the chord (0 to 1) and the height across it (in units of x)."""
        chord = (self.tail - self.nose).astype(x.dtype)
        if chord.shape != x.shape[1:]:
            raise ValueError(f"positions in {x.shape[1]}-D and a chord in {len(chord)}-D.")
        arm = x - self.nose.astype(x.dtype)[None, :]
        return arm @ chord / (chord @ chord), arm @ self.up.astype(x.dtype)

    @staticmethod
    @checked
    def along(points: Numbers) -> "Chord":
        """Finds the chord of an airfoil in 2-D from its nodes (m, 2).

        The tail has the largest x, the nose is farthest from the tail. Of several such nodes, as of
        a blunt tail, the mean counts.
        """
        known = known_positions(points, "points")
        last = known[:, 0].max()
        tail = known[known[:, 0] > last - 1e-9 * max(np.ptp(known[:, 0]), 1e-300)].mean(axis=0)
        distance = np.linalg.norm(known - tail, axis=1)
        return Chord(known[distance > (1 - 1e-9) * distance.max()].mean(axis=0), tail)


@checked
def upper_side(points: Numbers, chord: Chord | None = None, *, wall: Any = None) -> Mask:
    """Marks the nodes on the upper side of an airfoil.

    The wall is cut at nose and tail. A single node there is on the upper side; a blunt tail has a
    corner on either side. In 2-D without `wall`, the shortest tour of all nodes, along the chord
    and back, counts as the wall.

    **Arguments:**

    - `points`: positions (m, d) of the airfoil's nodes, or of a mesh with `wall`.
    - `chord`: the airfoil's. Default `Chord.along` of its nodes.
    - `wall`: ids of its nodes in order, as `wall_loop` finds them; in 3-D, where it is needed, its
      faces, as `jaxmorph.boundary_faces` finds them.

    **Returns:** mask (m,), False beside the airfoil. **Raises:** `ValueError` where all nodes would
    be on one side, for ids that are no rows, and without `wall` in 3-D.
    """
    x = known_positions(points, "points").astype(float)
    ids = _ids_of(wall, x.shape)
    rows = np.unique(ids)
    chord = Chord.along(x[rows]) if chord is None else chord
    t, height = (np.asarray(values, float) for values in chord.coordinates(jnp.asarray(x)))
    places = np.column_stack([t, height / float(chord.length)])
    upper = np.zeros(len(x), bool)
    if ids.ndim == 2:
        upper[rows] = _by_faces(x, ids, np.asarray(chord.up, float))[rows]
    else:
        upper[ids] = _by_tour(places) if wall is None else _by_loop(places[ids])
    if upper[rows].all() or not upper.any():
        raise ValueError(
            f"{len(rows)} nodes do not show the two sides of an airfoil around its chord."
        )
    return upper


def _ids_of(wall: Any, shape: tuple[int, ...]) -> Int[np.ndarray, "..."]:
    if shape[1] == 3:
        if wall is None:
            raise ValueError(
                "`wall` is missing: in 3-D the faces tell the sides, as "
                "`jaxmorph.boundary_faces` finds them."
            )
        return simplices_of(wall, shape)
    if wall is None:
        return np.arange(shape[0])
    ids = rows_of("wall", wall, shape[0])
    if ids.ndim != 1 or not 3 <= len(ids) == len(np.unique(ids)):
        raise ValueError(
            f"`wall` has shape {ids.shape}; a wall in 2-D is a loop (k,) of three different nodes "
            "or more."
        )
    return ids


def _by_faces(x: np.ndarray, triangles: Int[np.ndarray, "t 3"], up: np.ndarray) -> Mask:
    """The normals of a node's faces are summed with the faces' angles at the node; a tie is upper.
    Inward faces, as those of a mesh's cells around the body, enclose a negative volume.
    """
    corners = x[triangles] - x[np.unique(triangles)].mean(axis=0)
    ahead = np.roll(corners, -1, axis=1) - corners
    back = np.roll(corners, 1, axis=1) - corners
    area = np.cross(ahead[:, 0], back[:, 0])
    size = np.linalg.norm(area, axis=1)
    angles = np.arctan2(size[:, None], np.sum(ahead * back, axis=2))
    unit = np.sign(np.sum(area * corners.sum(axis=1))) * area / np.where(size > 0, size, 1)[:, None]
    normals = np.zeros_like(x)
    np.add.at(normals, triangles, angles[:, :, None] * unit[:, None, :])
    return normals @ up >= -SAME * np.linalg.norm(normals, axis=1)


def _by_loop(places: Places) -> Mask:
    """Marks the nodes on the upper side of a loop in either sense; a line has none. Of several
    nodes at the nose or the tail each side has one half. `places` are along and across the chord,
    in chords.
    """
    x, y = places.T
    area = (x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2
    if abs(area) < SAME:
        return np.zeros(len(places), bool)
    if area < 0:
        return _by_loop(places[::-1])[::-1]
    # neighbours at one place are one corner of the loop; it begins at the end of its longest edge
    lengths = np.linalg.norm(places - np.roll(places, 1, axis=0), axis=1)
    count = len(places)
    start = int(lengths.argmax())
    first = np.flatnonzero(np.roll(lengths, -start) > SAME)
    corners = np.roll(places, -start, axis=0)[first]

    def node(corner: int) -> int:
        return int(first[corner % len(first)]) + count * (corner // len(first))

    # counter-clockwise, the upper side runs from the middle of the tail to the middle of the nose
    tail = _blunt(corners, *_cut(corners, 1.0))
    nose = _cut(corners, 0.0)
    begin = (node(tail[0]) + node(tail[1])) // 2
    end = (node(nose[0]) + node(nose[1]) - 1) // 2
    return np.roll((np.arange(count) - begin) % count <= (end - begin) % count, start)


def _by_tour(places: Places) -> Mask:
    near = Tree(places).query_pairs(SAME, output_type="ndarray")
    pairs = coo_array((np.ones(len(near), bool), near.T), (len(places), len(places)))
    spot = connected_components(pairs, directed=False)[1]
    different = places[np.unique(spot, return_index=True)[1]]
    upper = np.zeros(len(different), bool)
    if len(different) > 2:
        around = _tour(different)
        upper[around] = _by_loop(different[around])
    return upper[spot]


def _cut(corners: Places, place: float) -> tuple[int, int]:
    """Finds the corners, first to before last, nearest to a place on the chord; none in an edge."""
    edges = np.roll(corners, -1, axis=0) - corners
    arms = np.array([[place, 0.0]]) - corners
    share = np.clip(np.sum(arms * edges, axis=1) / np.sum(edges**2, axis=1), 0, 1)
    nearest = int(np.linalg.norm(arms - share[:, None] * edges, axis=1).argmin())
    if AT < share[nearest] < 1 - AT:
        return nearest + 1, nearest + 1
    corner = nearest + int(share[nearest] > 0.5)
    return corner, corner + 1


def _blunt(corners: Places, first: int, last: int) -> tuple[int, int]:
    edges = np.roll(corners, -1, axis=0) - corners
    count = len(corners)
    lengths = np.linalg.norm(edges, axis=1)
    before = np.roll(edges, 1, axis=0)
    turn = np.sum(edges * before, axis=1) / (lengths * np.linalg.norm(before, axis=1))
    if first == last or not SHARP < turn[first % count] < CORNER:
        return first, last
    ways = []
    for step in (1, -1):
        corner = first
        length = 0.0
        while length <= BLUNT:
            length += lengths[(corner if step > 0 else corner - 1) % count]
            corner += step
            if turn[corner % count] < CORNER:
                ways.append((length, corner))
                break
    length, other = min(ways, default=(np.inf, first))
    return (min(first, other), max(first, other) + 1) if length <= BLUNT else (first, last)


def _tour(places: Places) -> Int[np.ndarray, " m"]:
    along = np.argsort(places[:, 0], kind="stable")
    column = np.cumsum(np.diff(places[along, 0], prepend=-np.inf) > SAME)
    order = along[np.lexsort((places[along, 1], column))]
    ahead = places[order]
    count = len(order)
    # two chains reach the nodes up to k: one ends at k, the other at j < k, and `cost[j]` is the
    # length of both
    cost = np.zeros(count)
    before = np.zeros(count, int)
    cost[0] = np.linalg.norm(ahead[1] - ahead[0])
    for k in range(1, count):
        following = ahead[min(k + 1, count - 1)]
        total = cost[:k] + np.linalg.norm(ahead[:k] - following, axis=1)
        before[k] = int(np.argmax(total <= total.min() + TIE))
        cost[:k] += np.linalg.norm(following - ahead[k])
        cost[k] = total[before[k]]
    # backwards: k was reached from k - 1, or from `before[k - 1]` where the other chain ends there
    other = int(before[count - 1])
    chains = [count - 1], [other]
    for k in range(count - 1, 1, -1):
        reached = int(before[k - 1]) if other == k - 1 else k - 1
        chains[int(chains[1][-1] == k)].append(reached)
        other = reached if other == k - 1 else other
    return order[chains[0] + chains[1][::-1]]
