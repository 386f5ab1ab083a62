"""CAD models: closest places on their faces, edges and vertices, and where points are on them."""

import functools
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from ..linear.products import cross_rows, dot_rows, normals, row_lengths, unit_rows
from ..package.rounding import Tree
from ..tolerances import LEAST_DIVISOR, SAME, SMOOTH_SEAM
from .cad_kernel import DEFLECTION, CadShape, Use
from .gaps import FaceTrees, closest

FARTHER = 2.0  # deflections by which a facet may be farther than that of the closest place
AROUND_POLE = np.arange(8) / 8  # shares of the parameters there, where a search begins
SEARCH_STEPS = 30
CONVERGED = 1e-14  # step of a search over the model's size
BESIDE = 4.0  # deflections of facets by which another face, or an edge, may be nearer
PIECES = 8  # parts of a segment of the facets, on an edge itself
INWARD = 0.1  # share of a facet by which a search begins off its border
CONVEX = 1e-3  # share of a curvature that is left where a distance has a minimum
ROUNDED = 1e-6  # distance over the size, of coordinates of few digits, from an edge they are on
STATIONS = np.linspace(0.1, 0.9, 5)  # shares of an edge at which its faces' normals are compared


Starts = tuple[ndarray, ndarray, ndarray]


class Found(NamedTuple):
    """Closest `places` (m, 3), and their derivatives (m, 3, 3) by the points. `face` is a number
    and `at` (m, 2) its parameters, or -1 on a border.
    """

    places: ndarray
    slopes: ndarray
    face: ndarray
    at: ndarray
    distance: ndarray


class Located(NamedTuple):
    """Where points (m,) are: on vertices, edges or faces, by `dimension` (0, 1, 2) and `number`.
    `at` (m, 2) are parameters of a face, or a share of an edge; `distance` is that from the model.
    """

    dimension: ndarray
    number: ndarray
    at: ndarray
    distance: ndarray


class Model(CadShape):
    """A CAD shape on which closest places are found."""

    @functools.cached_property
    def is_sharp(self) -> ndarray:
        """Marks edges at which two faces turn, or more meet; smooth seams are none."""
        return np.array([self._turns(uses) for uses in self.uses_of], bool)

    def _turns(self, uses: list[Use]) -> bool:
        if len(uses) != 2 or self.is_point[uses[0].edge]:
            return len(uses) > 2
        sides = []
        for use in uses:
            at = np.array([use.at(share) for share in STATIONS])
            slopes = self.on_faces(np.full(len(at), use.face), at, 1)
            sign = -1 if self.is_reversed[use.face] else 1
            sides.append(sign * unit_rows(cross_rows(slopes[:, 1], slopes[:, 2])))
        is_known = row_lengths(sides[0]) * row_lengths(sides[1]) > 0
        return bool((dot_rows(*sides)[is_known] < np.cos(SMOOTH_SEAM)).any())

    def is_feature(self, points: ndarray) -> ndarray:
        """Marks points of facets that lie on sharp edges."""
        facets = self.facets
        segments = facets.segments[self.is_sharp[facets.edge]]
        if not len(segments):
            return np.zeros(len(points), bool)
        return closest(segments, points).distance <= SAME * self.size

    def is_vertex(self, points: ndarray) -> ndarray:
        """Marks points of facets at which edges end."""
        if not len(self.vertices):
            return np.zeros(len(points), bool)
        return Tree(self.vertices).query(points)[0] <= SAME * self.size

    def onto_edges(
        self, edge: ndarray, along: ndarray, x: ndarray
    ) -> tuple[ndarray, ndarray, ndarray]:
        """Finds the closest parameters and places on given edges, and derivatives (m, 3, 3)."""
        along = along.copy()
        low, high = self.ranges[edge].T
        active = np.arange(len(x))
        for _ in range(SEARCH_STEPS):
            _, slope, divisor, step = self._step_along(edge[active], along[active], x[active])
            old = along[active]
            along[active] = np.clip(old - step, low[active], high[active])
            moved = np.abs(along[active] - old) * row_lengths(slope)
            active = active[moved > CONVERGED * self.size]
        place, slope, divisor, step = self._step_along(edge, along, x)
        is_foot = np.abs(step) * row_lengths(slope) <= SAME * self.size
        divisor = np.where(is_foot, divisor, np.inf)
        return along, place, slope[:, :, None] * slope[:, None] / divisor[:, None, None]

    def _step_along(self, edge: ndarray, along: ndarray, x: ndarray) -> tuple[ndarray, ...]:
        place, slope, bend = self.on_edges(edge, along, 2).swapaxes(0, 1)
        squared = np.maximum(dot_rows(slope, slope), LEAST_DIVISOR)
        curved = squared + dot_rows(place - x, bend)
        divisor = np.where(curved > CONVEX * squared, curved, squared)
        return place, slope, divisor, dot_rows(place - x, slope) / divisor

    def onto_faces(
        self, face: ndarray, at: ndarray, x: ndarray
    ) -> tuple[ndarray, ndarray, ndarray, ndarray]:
        """Finds the closest parameters and places on given surfaces, and derivatives. Those that
        are no foot of a perpendicular, at an end of the parameters, are marked last.
        """
        at = at.copy()
        low = self.bounds[face][:, [0, 2]]
        high = self.bounds[face][:, [1, 3]]
        active = np.arange(len(x))
        for _ in range(SEARCH_STEPS):
            step, sides, _ = _newton(self.on_faces(face[active], at[active], 2), x[active])
            old = at[active]
            at[active] = np.clip(old - step, low[active], high[active])
            moved = row_lengths(np.einsum("mk,mkd->md", at[active] - old, sides))
            active = active[moved > CONVERGED * self.size]
        values = self.on_faces(face, at, 2)
        step, sides, inverse = _newton(values, x)
        left = row_lengths(np.einsum("mk,mkd->md", step, sides))
        slopes = np.einsum("mka,mkl,mlb->mab", sides, inverse, sides)
        return at, values[:, 0], slopes, left <= SAME * self.size

    def closest(self, x: ndarray) -> Found:
        """Finds the closest places to points (m, 3), on the surfaces themselves."""
        # Facets that are about as near as the nearest have faces, and parameters to begin with.
        # Where a border is as near, its edges, and faces on their other sides, may be nearer.
        x = np.asarray(x, float)
        starts, distance = self._starts(x)
        edge, along, off = self.nearest_edges(x)
        reach = distance + BESIDE * DEFLECTION * self.size
        near = np.flatnonzero(off <= reach)
        row, edge, along, poles = self._edges_beside(near, edge[near], along[near], x, reach[near])
        along, places, slopes = self.onto_edges(edge, along, x[row])
        starts = [starts, poles, self._across(row, edge, along)]
        rows, face, at = map(np.concatenate, zip(*starts, strict=True))
        at, on_face, turned, is_foot = self.onto_faces(face, at, x[rows])
        check = is_foot & np.isin(rows, near)
        is_foot[check] = self.is_inside(face[check], at[check])
        rows = np.concatenate([rows, row])
        places = np.concatenate([on_face, places])
        off = row_lengths(places - x[rows])
        # a place outside of its face counts only where nothing else was found
        worse = np.concatenate([~is_foot, np.zeros(len(row), bool)])
        order = np.lexsort((off, worse, rows))
        best = order[np.unique(rows[order], return_index=True)[1]]
        return Found(
            places[best],
            np.concatenate([turned, slopes])[best],
            np.concatenate([face, np.full(len(row), -1)])[best],
            np.concatenate([at, np.zeros((len(row), 2))])[best],
            off[best],
        )

    def _starts(self, x: ndarray) -> tuple[Starts, ndarray]:
        """Rows, faces and parameters of facets that are near, and the distance of each point."""
        facets = self.facets
        corners = facets.points[facets.triangles]
        row, near = FaceTrees(corners).nearby(x, FARTHER * DEFLECTION * self.size)
        face = facets.face[near.face]
        weights = (1 - INWARD) * near.weights + INWARD / 3  # at a pole no step has a direction
        at = np.einsum("mc,mck->mk", weights, facets.at[near.face])
        distance = near.distance[np.unique(row, return_index=True)[1]]
        # one of each face that looks to one side: both sides of a thin part are tried
        normal = normals(corners)[near.face]
        axis = np.abs(normal).argmax(axis=1)
        side = 2 * axis + (normal[np.arange(len(axis)), axis] > 0)
        keys = np.stack([row, face, side], axis=1)
        order = np.lexsort((near.distance, *keys.T[::-1]))
        first = order[np.unique(keys[order], axis=0, return_index=True)[1]]
        return (row[first], face[first], at[first]), distance

    def rows(self, x: ndarray) -> ndarray:
        """Closest places, and their derivatives by three coordinates, as rows (m, 4, 3)."""
        found = self.closest(x)
        return np.concatenate([found.places[:, None], found.slopes], axis=1)

    def edge_rows(self, x: ndarray) -> ndarray:
        """The same on sharp edges."""
        x = np.asarray(x, float)
        edge, along, _ = self.nearest_edges(x, self.is_sharp)
        _, places, slopes = self.onto_edges(edge, along, x)
        return np.concatenate([places[:, None], slopes], axis=1)

    def locate(self, x: ndarray, tolerance: ndarray) -> Located:
        """Finds each point on a vertex or edge, else on a face. On an edge it is about as near to
        it as all points are to the model, and within its tolerance (m,).
        """
        found = self.closest(x)
        usual = max(BESIDE * found.distance.max(initial=0), ROUNDED * self.size)
        tolerance = np.minimum(tolerance, usual)
        dimension = np.full(len(x), 2)
        number = found.face.copy()
        at = found.at.copy()
        edge, along, off = self.nearest_edges(x)
        rows = np.flatnonzero((off <= tolerance + DEFLECTION * self.size) | (number < 0))
        edge = edge[rows]
        along, places, _ = self.onto_edges(edge, along[rows], x[rows])
        is_on = (row_lengths(places - x[rows]) <= tolerance[rows]) | (number[rows] < 0)
        low, high = self.ranges[edge].T
        dimension[rows[is_on]] = 1
        number[rows[is_on]] = edge[is_on]
        at[rows[is_on], 0] = ((along - low) / (high - low))[is_on]
        if len(self.vertices):
            off, vertex = Tree(self.vertices).query(x)
            is_on = off <= tolerance
            dimension[is_on] = 0
            number[is_on] = vertex[is_on]
        return Located(dimension, number, at, found.distance)

    def nearest_edges(
        self, x: ndarray, among: ndarray | None = None
    ) -> tuple[ndarray, ndarray, ndarray]:
        """Finds the nearest edge to each point, a parameter on it, and about its distance."""
        segments, ends, edge = self._fine_edges
        if among is not None:
            segments, ends, edge = (part[among[edge]] for part in (segments, ends, edge))
        if not len(segments):
            return np.zeros(len(x), int), np.zeros(len(x)), np.full(len(x), np.inf)
        found = closest(segments, x)
        along = np.sum(found.weights * ends[found.face], axis=1)
        return edge[found.face], along, found.distance

    @functools.cached_property
    def _fine_edges(self) -> tuple[ndarray, ndarray, ndarray]:
        share = np.linspace(0, 1, PIECES + 1)
        ends = self.facets.along[:, :1] + share * np.diff(self.facets.along, axis=1)
        edge = np.repeat(self.facets.edge, PIECES + 1)
        points = self.on_edges(edge, ends.ravel())[:, 0].reshape(*ends.shape, 3)
        pairs = [np.stack([values[:, :-1], values[:, 1:]], axis=2) for values in (points, ends)]
        pairs = [values.reshape(-1, *values.shape[2:]) for values in pairs]
        return pairs[0], pairs[1], np.repeat(self.facets.edge, PIECES)

    def _edges_beside(
        self, near: ndarray, edge: ndarray, along: ndarray, x: ndarray, reach: ndarray
    ) -> tuple[ndarray, ndarray, ndarray, Starts]:
        """Rows, edges and parameters: the nearest ones, and edges at vertices that are as near.
        About poles, which are vertices without a direction, parameters of their faces.
        """
        found = [(near, edge, along)]
        poles = [np.zeros((0, 4))]
        k, vertex = Tree(self.vertices).within(x[near], reach) if len(near) else (near, near)
        for number, ends in enumerate(self.topology.ends):
            for end, at in zip(ends, self.ranges[number], strict=True):
                rows = near[k[(vertex == end) & (edge[k] != number)]]
                if not self.is_point[number]:
                    found.append((rows, np.full(len(rows), number), np.full(len(rows), at)))
                    continue
                for use in self.uses_of[number]:
                    places = [(use.face, *use.at(share)) for share in AROUND_POLE]
                    rows = np.repeat(rows, len(places))
                    poles.append(np.column_stack([rows, np.resize(places, (len(rows), 3))]))
        row, face, *at = np.concatenate(poles).T
        starts = row.astype(int), face.astype(int), np.stack(at, axis=1)
        row, edge, along = map(np.concatenate, zip(*found, strict=True))
        return row, edge, along, starts

    def _across(self, row: ndarray, edge: ndarray, along: ndarray) -> Starts:
        """Rows, faces and parameters: where the faces of edges begin."""
        low, high = self.ranges[edge].T
        share = (along - low) / (high - low)
        found = [
            (number, use.face, use.at(part))
            for number, each, part in zip(row.tolist(), edge.tolist(), share.tolist(), strict=True)
            for use in self.uses_of[each]
        ]
        rows, faces, at = zip(*found, strict=True) if found else ((), (), ())
        return np.array(rows, int), np.array(faces, int), np.array(at, float).reshape(-1, 2)


def _newton(values: ndarray, x: ndarray) -> tuple[ndarray, ndarray, ndarray]:
    """Steps (m, 2) of Newton's method in a surface's parameters, its sides, and the inverses."""
    off = values[:, 0] - x
    sides = values[:, 1:3]
    gram = np.einsum("mkd,mld->mkl", sides, sides)
    bend = np.einsum("mkd,md->mk", values[:, 3:], off)[:, [0, 2, 2, 1]].reshape(-1, 2, 2)
    # in units of length; where the distance has no minimum, the surface counts as flat
    length = np.sqrt(np.diagonal(gram, axis1=1, axis2=2))
    length = np.where(length > SAME * length.max(axis=1, keepdims=True), length, np.inf)
    scale = length[:, :, None] * length[:, None]
    flat = gram / scale
    curved = flat + bend / scale
    is_convex = np.linalg.eigvalsh(curved)[:, 0] > CONVEX
    matrix = np.where(is_convex[:, None, None], curved, flat)
    inverse = np.linalg.pinv(matrix, rcond=SAME, hermitian=True) / scale
    step = np.einsum("mkl,mld,md->mk", inverse, sides, off)
    return step, sides, inverse
