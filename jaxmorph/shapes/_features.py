"""Edges and corners of a wall, and those of its target onto which they go."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Array, Bool, Float, Int
from numpy import ndarray

from jaxmorph import Facets, MeshError, Plane
from jaxmorph.extend import Either, Module, join_ids, namespace, norm, parts_of, put_at

from ._arguments import rows_like, shown_place
from ._tolerances import ON_SYMMETRY

NodeIds = Int[ndarray | Array, " _"]
Places = Float[Either, "m d"]
Planes = Plane | Sequence[Plane]
Borders = tuple[tuple[Plane, NodeIds], ...]

# share of the extent: distance of the farthest edge or corner
FARTHEST = 0.25
# share of the extent of waves that are noise, as errors suggest it
NOISE = 0.05
# length of the mean of unit normals at a node from which on it looks one way: none at a sharp tail
CLEAR = 0.3


class Rail(Module):
    """Nodes `rows` (c,) of a wall that stay on points `ids` (c,) of the target, or on a `curve`.

    `beside` (c, 2) are the neighbours of each node along the wall's own curve.
    """

    rows: NodeIds
    beside: Int[ndarray | Array, "c 2"]
    ids: NodeIds | None = None
    curve: Facets | None = None

    def places(self, x: Places, facing: Places, target: Facets) -> Any:
        points = namespace(x).asarray(target.points)
        if self.curve is None:
            return points[self.ids]
        is_model = target.model is not None
        curve = self.curve if is_model else self.curve.at(points)
        places = curve.closest(x[self.rows], facing[self.rows])
        # sections and named edges are polylines
        return target.closest(places) if is_model and curve.model is None else places


class Clip(Module):
    """The points of a surface cut off at a plane: `pairs` (n, 2) of points before it was cut. They
    are one point twice, or the ends of an edge. Those `on` the plane stand where it cuts the edge.
    """

    pairs: Int[ndarray | Array, "n 2"]
    on: Bool[ndarray | Array, " n"]
    plane: Plane

    def __call__(self, points: Float[Either, "n d"]) -> Places:
        xp = namespace(points)
        a, b = points[self.pairs.T]
        first = height_of(a, self.plane)
        apart = first - height_of(b, self.plane)
        share = xp.where(apart != 0, first / xp.where(apart != 0, apart, 1), 0)
        place = a + share[:, None] * (b - a)
        normal = xp.asarray(self.plane.normal, a.dtype)
        place = place - height_of(place, self.plane)[:, None] * normal[None]
        return xp.where(self.on[:, None], place, a)


def borders_of(wall: Facets, symmetry: Planes) -> Borders:
    """Finds the rows of a wall's border that stand in each plane."""
    planes = (symmetry,) if isinstance(symmetry, Plane) else tuple(symmetry)
    x = np.asarray(wall.points, float)
    rim = np.unique(wall.rim)
    slack = ON_SYMMETRY * np.ptp(x, axis=0).max()
    d = x.shape[1]
    if others := {len(plane.normal) for plane in planes} - {d}:
        raise ValueError(f"the wall is in {d}-D, a plane in {max(others)}-D.")
    return tuple((plane, rim[np.abs(plane.height(x[rim])) <= slack]) for plane in planes)


def height_of(x: Places, plane: Plane) -> Float[Either, " m"]:
    xp = namespace(x)
    normal, origin = (xp.asarray(vector, x.dtype) for vector in (plane.normal, plane.origin))
    return xp.sum((x - origin[None]) * normal[None], axis=1)


def on_target(features: Sequence[Any], target: Facets, clips: Sequence[Clip] = ()) -> Sequence[Any]:
    """Numbers the second ids of pairs as the cut target does, with all points at one place."""
    found = []
    for own, other in features:
        ids = rows_like("features", other, len(target.points))
        ids = np.flatnonzero(np.isin(target.welded, np.asarray(target.welded)[ids]))
        for clip in clips:
            ids = np.flatnonzero(np.isin(clip.pairs, ids).all(axis=1))
        found.append((own, ids))
    return found


def length_hint(points: ndarray) -> str:
    """An argument for a scan with noise, of a length that keeps the shape of a section."""
    return f"`length={NOISE * np.ptp(points, axis=0).max():.2g}`"


def check_pairs(features: Sequence[Any]) -> None:
    if not all(isinstance(pair, list | tuple) and len(pair) == 2 for pair in features):
        raise ValueError(
            "`features` must be pairs: ids of nodes of the wall, and of points of the target."
        )


def normals_beside(borders: Borders, wall: Facets) -> Places:
    """Computes unit normals (m, d) at a wall's nodes, within the planes where its border stays."""
    normals: Any = wall.normals()
    xp = namespace(normals)
    for plane, rows in borders:
        normal = xp.asarray(plane.normal, normals.dtype)
        own = normals[rows]
        own = own - xp.sum(own * normal[None], axis=1)[:, None] * normal[None]
        normals = put_at(normals, rows, own / norm(own)[:, None])
    return normals


def clipped(target: Facets, plane: Plane, side: float, slack: float) -> tuple[Clip, Facets]:
    """Cuts a target off at a plane, and keeps one side (1 or -1)."""
    points = np.asarray(target.points, float)
    faces = np.asarray(target.faces)
    width = faces.shape[1]
    height = side * plane.height(points)
    height[np.abs(height) <= slack] = 0
    # Sutherland and Hodgman: around each face its corners on this side, and after each corner the
    # place where the edge from it crosses the plane; each is a pair of points
    first = faces[(height[faces] > 0).any(axis=1)]
    second = np.roll(first, -1, axis=1)
    ends = np.stack([first, second], axis=2)
    slots = np.stack([first[:, :, None].repeat(2, axis=2), np.sort(ends, axis=2)], axis=2)
    is_used = np.stack([height[first] >= 0, height[ends].prod(axis=2) < 0], axis=2)
    if width == 2:
        is_used[:, 1, 1] = False  # the way back along a segment
    # those that are used come first; a polygon of four is a fan of two triangles
    order = np.argsort(~is_used.reshape(len(first), -1), axis=1, kind="stable")
    ring = np.take_along_axis(slots.reshape(len(first), -1, 2), order[:, :, None], axis=1)
    count = is_used.sum(axis=(1, 2))
    fans = [ring[count >= k + width - 1][:, [0, *range(k, k + width - 1)]] for k in (1, 2)]
    pairs, place = np.unique(np.concatenate(fans).reshape(-1, 2), axis=0, return_inverse=True)
    on = (height[pairs[:, 0]] == 0) | (pairs[:, 0] != pairs[:, 1])
    if not on.any():
        raise ValueError(
            f"the target ends {np.abs(height).min():.3g} before the symmetry plane through "
            f"{shown_place(plane.origin)}. Extend the target, or stay near it by "
            f"{length_hint(points)}: what is beyond its border then follows the rest of the wall."
        )
    clip = Clip(pairs, on, plane)
    cut = place.reshape(-1, width)
    return clip, Facets(
        clip(points), cut, smooth=target.smooth, angle=target.angle, model=target.model
    )


@dataclasses.dataclass(frozen=True)
class Curves:
    """Edges (s, 2) of a surface, in 2-D points (s, 1), by `kinds`: 0 for sharp ones, k for those on
    the border in the k-th plane, then named ones. At `corners` kinds meet, the bits of `codes`.
    Where normals of both sides cancel, a point is not `clear`.
    """

    points: ndarray
    normals: ndarray
    clear: ndarray
    edges: ndarray
    kinds: ndarray
    corners: ndarray
    codes: ndarray
    model: Any

    @classmethod
    def of(
        cls, facets: Facets, planes: Sequence[Plane], slack: float, ids: Sequence[Any]
    ) -> "Curves":
        points = np.asarray(facets.points, float)
        normals = np.asarray(facets.normals())
        rim = np.asarray(facets.rim)
        welded = np.asarray(facets.welded)
        faces = welded[np.asarray(facets.faces)]
        found = [np.asarray(facets.sharp) if not len(ids) else rim[:0]]
        found += [rim[(np.abs(plane.height(points[rim])) <= slack).all(axis=1)] for plane in planes]
        sides = np.sort(
            np.concatenate([faces[:, [k, k - 1]] for k in range(faces.shape[1])]), axis=1
        )
        for own in (np.unique(welded[rows]) for rows in ids):
            edges = np.unique(sides[np.isin(sides, own).all(axis=1)], axis=0)
            found.append(np.reshape(own, (-1, 1)) if rim.shape[1] == 1 else edges)
        edges = np.concatenate(found)
        kinds = np.repeat(np.arange(len(found)), [len(part) for part in found])
        corners, codes = _meeting_points(points, edges, kinds, rim, len(planes), facets.model)
        return cls(
            points=points,
            normals=normals,
            clear=_are_clear(facets, faces),
            edges=edges,
            kinds=kinds,
            corners=corners,
            codes=codes,
            model=facets.model,
        )

    def chains(self, kind: int) -> list[ndarray]:
        """The edges of a kind in parts between corners; none in 2-D, where all are corners."""
        edges = self.edges[self.kinds == kind]
        if edges.shape[1] == 1 or not len(edges):
            return []
        # a corner joins no edges
        own = len(self.points) + np.arange(edges.size).reshape(edges.shape)
        ends = np.where(np.isin(edges, self.corners), own, edges)
        part = parts_of(ends[:, 0], ends[:, 1], len(self.points) + edges.size)[ends[:, 0]]
        return [edges[part == number] for number in np.unique(part)]


def _are_clear(facets: Facets, faces: ndarray) -> ndarray:
    """Marks points (n,) at which faces, with corners (k, c) by vertex, look about one way."""
    areas = np.asarray(facets.areas(), float)
    unit = areas / np.linalg.norm(areas, axis=1, keepdims=True)
    total = np.zeros(np.shape(facets.points))
    np.add.at(total, faces, unit[:, None])
    count = np.bincount(faces.ravel(), minlength=len(total))
    return np.linalg.norm(total, axis=1) >= CLEAR * np.maximum(count, 1)


def _meeting_points(
    points: ndarray, edges: ndarray, kinds: ndarray, rim: ndarray, planes: int, model: Any
) -> tuple[ndarray, ndarray]:
    nodes, number = np.unique(edges, return_inverse=True)
    number = number.reshape(edges.shape)
    is_corner = np.ones(len(nodes), bool)
    met = np.zeros((len(nodes), max(kinds.max(initial=0), planes) + 1), bool)
    met[number, kinds[:, None]] = True
    if edges.shape[1] == 2:
        # Two directions away from a node cancel on a straight curve; at 60 degrees their sum has
        # length 1. An edge that ends at the border of the surface slides along itself.
        along = points[edges[:, 1]] - points[edges[:, 0]]
        total = np.zeros((len(nodes), points.shape[1]))
        along = along / np.linalg.norm(along, axis=1, keepdims=True)
        np.add.at(total, number, np.stack([along, -along], axis=1))
        count = np.bincount(number.ravel())
        is_single = ~np.isin(nodes, rim) | met[:, planes + 1 :].any(axis=1)
        is_end = np.where(count == 1, is_single, (count > 2) | (np.sum(total**2, axis=1) > 1))
        if model is not None:  # its own edges end there, also where they go on smoothly
            is_end |= model.is_vertex(points[nodes])
        is_corner = (is_end & ~met[:, 1 : planes + 1].any(axis=1)) | (met.sum(axis=1) > 1)
    return nodes[is_corner], met[is_corner] @ (1 << np.arange(met.shape[1]))


def guides_of(
    wall: Facets, target: Facets, planes: Sequence[Plane], features: Sequence[Any]
) -> tuple[Rail, ...]:
    """Finds which nodes of the wall stay on which curves and points of the target."""
    slack = ON_SYMMETRY * np.ptp(np.asarray(wall.points), axis=0).max()
    own, other = (
        Curves.of(
            facets,
            planes,
            slack,
            [rows_like("features", pair[k], len(facets.points)) for pair in features],
        )
        for k, facets in enumerate((wall, target))
    )
    guides = [
        guide for code in np.unique(own.codes).tolist() for guide in _on_points(own, other, code)
    ]
    taken = join_ids(guide.rows for guide in guides)
    kinds = range(own.kinds.max(initial=0) + 1)
    return (*(guide for kind in kinds for guide in _on_curves(own, other, kind, taken)), *guides)


def _on_points(own: Curves, other: Curves, code: int) -> list[Rail]:
    """A corner goes onto the closest corner of the same kinds of curves, that looks alike."""
    rows, ids = (side.corners[side.codes == code] for side in (own, other))
    if not len(ids):
        return []
    off = np.linalg.norm(own.points[rows][:, None] - other.points[ids], axis=2)
    away, chosen = _best(own, rows, off, other.normals[ids])
    away |= code > 1  # a plane or a name leaves no choice
    rows = rows[away]
    ids = ids[chosen][away]
    places = other.points[ids]
    _, place, count = np.unique(places, axis=0, return_inverse=True, return_counts=True)
    shared = np.flatnonzero(count[place.ravel()] > 1)
    if len(shared):
        raise MeshError(
            f"{len(shared)} corners of the wall share one of the target, at "
            f"{shown_place(places[shared[0]])}, one is "
            "node {node}. Name pairs in `features`, find fewer edges by the `angle` of `Facets`, "
            f"or stay near a scan with noise by {length_hint(own.points)}.",
            rows[shared],
        )
    return [Rail(rows=rows, beside=np.stack([rows, rows], axis=1), ids=ids)] if len(rows) else []


def _best(own: Curves, rows: ndarray, away: ndarray, looks: ndarray) -> tuple[ndarray, ndarray]:
    """Whether each node has one of q candidates `away` (c, q) within reach, and the best one."""
    reach = FARTHEST * np.ptp(own.points, axis=0).max()
    turned = np.linalg.norm(own.normals[rows][:, None] - looks, axis=2)
    best = (away + reach * turned).argmin(axis=1)
    return away[np.arange(len(rows)), best] <= reach, best


def _on_curves(own: Curves, other: Curves, kind: int, taken: ndarray) -> list[Rail]:
    """A chain goes onto the chains of its kind that are closest to its nodes, and look alike."""
    guides = []
    chains = other.chains(kind)
    for edges in own.chains(kind) if chains else []:
        rows = np.setdiff1d(edges, taken)
        looks = np.stack([other.normals[ids].mean(axis=(0, 1)) for ids in chains])
        near, best = _best(own, rows, _off_chains(own.points[rows], other.points, chains), looks)
        near |= kind > 0  # a plane or a name leaves no choice
        if near.any():
            onto = np.concatenate([chains[number] for number in np.unique(best[near])])
            rows = rows[near]
            is_clear = np.asarray(other.clear[onto].all(axis=1) | (kind > 0))
            curve = Facets(
                other.points,
                onto,
                sides=other.normals[onto].mean(axis=1) * is_clear[:, None],
                model=other.model if kind == 0 else None,
            )
            guides.append(Rail(rows=rows, beside=_neighbours_along(rows, edges), curve=curve))
    return guides


def _off_chains(x: ndarray, points: ndarray, chains: Sequence[ndarray]) -> ndarray:
    """Distances (c, q) of places from chains, of which noise makes thousands."""
    start, end = points[np.concatenate(chains)].transpose(1, 0, 2)
    along = end - start
    squared = np.sum(along**2, axis=1)
    squared[squared == 0] = 1  # an edge of no length: its start
    first = np.cumsum([0, *map(len, chains)])[:-1]
    rows = []
    for place in x:
        share = np.clip(np.sum((place - start) * along, axis=1) / squared, 0, 1)
        off = np.linalg.norm(start + share[:, None] * along - place, axis=1)
        rows.append(np.minimum.reduceat(off, first))
    return np.stack(rows)


def _neighbours_along(rows: ndarray, edges: ndarray) -> ndarray:
    """Neighbours (c, 2) of nodes along edges; the node itself in place of a missing one."""
    both = np.concatenate([edges, edges[:, ::-1]])
    both = both[np.lexsort(both.T[::-1])]
    first = np.searchsorted(both[:, 0], rows)
    last = np.searchsorted(both[:, 0], rows, side="right") - 1
    return np.stack([np.where(first == last, rows, both[first, 1]), both[last, 1]], axis=1)
