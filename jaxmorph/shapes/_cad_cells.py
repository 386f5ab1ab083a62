"""A wall in the parameters of a CAD model's faces: a mesh in 2-D that moves with its borders."""

from collections import defaultdict
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

GAP = 0.1  # between faces side by side, over their width
FLAT = 1e-9  # area of a triangle over the square of its longest side that is none


class BorderPlaces(NamedTuple):
    """Places (k,) on borders of faces, by the number of a use and the share of its edge, with the
    face's parameters `at` (k, 2) where the model starts.
    """

    use: ndarray
    share: ndarray
    face: ndarray
    at: ndarray

    @classmethod
    def of(cls, model: Any, pairs: Sequence[tuple[int, float]]) -> "BorderPlaces":
        """Makes places of uses and shares, with parameters on this model."""
        use, share = np.reshape(pairs, (-1, 2)).T
        face = np.array([each.face for each in model.uses])[use.astype(int)]
        made = cls(use.astype(int), share, face, np.zeros((0, 2)))
        return made._replace(at=made.on(model))

    def on(self, model: Any) -> ndarray:
        """The parameters (k, 2) on a model."""
        pairs = zip(self.use.tolist(), self.share.tolist(), strict=True)
        return np.array([model.uses[use].at(share) for use, share in pairs]).reshape(-1, 2)


def lengths_of(model: Any) -> ndarray:
    """Lengths (f, 2) of the parameters of each face: means of the derivatives."""
    share = np.array([0.1, 0.5, 0.9])
    low, high = model.bounds[:, [0, 2]], model.bounds[:, [1, 3]]
    grid = np.stack(np.meshgrid(share, share), axis=2).reshape(-1, 2)
    at = low[:, None] + grid * (high - low)[:, None]
    face = np.repeat(np.arange(len(at)), len(grid))
    slopes = model.on_faces(face, at.reshape(-1, 2), 1)[:, 1:]
    length = np.linalg.norm(slopes, axis=2).reshape(len(at), -1, 2).mean(axis=1)
    return np.where(length > 0, length, 1)


class ParameterMesh(NamedTuple):
    """Triangles `cells` (c, 3) of a wall, in its faces' parameters, side by side. The first of the
    `points` (n, 2) are on `borders` of faces, the next are the `inner` nodes (k,).
    """

    points: ndarray
    cells: ndarray
    borders: BorderPlaces
    inner: ndarray

    @classmethod
    def of(
        cls, model: Any, located: Any, points: ndarray, faces: ndarray, scale: ndarray
    ) -> "ParameterMesh":
        # A triangle belongs to the face that all its corners are on. A corner on a border has a
        # place there for each use of its edge: of a seam's two it is that beside the triangle.
        # Keys of inner corners are rows of nodes, those of others places, negative.
        parts = _Parts(model, located)
        owner, middle = parts.owners(points, faces)
        known = owner >= 0
        owner, middle, faces = owner[known], middle[known], faces[known]
        keys = faces.copy()
        at = located.at[faces]
        places: dict[tuple[int, float], int] = {}
        for row, corner in np.argwhere(located.dimension[faces] < 2).tolist():
            face = int(owner[row])
            place = parts.beside(int(faces[row, corner]), face, middle[row], scale[face])
            keys[row, corner] = -1 - places.setdefault(place, len(places))
            at[row, corner] = model.uses[place[0]].at(place[1])
        keys = keys[_has_area(model, owner, at, points[faces], scale)]
        used = np.unique(-1 - keys[keys < 0])
        inner = np.unique(keys[keys >= 0])[: None if len(used) else 0]  # nothing carries them
        borders = BorderPlaces.of(model, [[*places][number] for number in used])
        cells = np.where(
            keys < 0,
            np.searchsorted(used, -1 - keys),
            len(used) + np.searchsorted(inner, keys),
        )
        face = np.concatenate([borders.face, located.number[inner]])
        flat = np.concatenate([borders.at, located.at[inner]]) * scale[face]
        low, high = model.bounds[:, :2].T * scale[:, 0]
        width = (1 + GAP) * (high - low)
        flat[:, 0] += (np.cumsum(width) - width - low)[face]
        return cls(flat, cells, borders, inner)


class _Parts:
    """The faces that nodes are on, and their places on borders of faces."""

    def __init__(self, model: Any, located: Any):
        self.model = model
        self.located = located
        self.on_edge = defaultdict(list)  # uses of an edge by a face
        self.at_vertex = defaultdict(list)  # uses and their ends, of a vertex by a face
        self.faces_of = (defaultdict(set), defaultdict(set))  # faces of vertices, of edges
        for number, use in enumerate(model.uses):
            self.on_edge[use.face, use.edge].append(number)
            self.faces_of[1][use.edge].add(use.face)
            for end, vertex in enumerate(model.topology.ends[use.edge]):
                self.at_vertex[use.face, vertex].append((number, end))
                self.faces_of[0][vertex].add(use.face)

    def faces(self, node: int) -> set[int]:
        number = int(self.located.number[node])
        dimension = self.located.dimension[node]
        return {number} if dimension == 2 else self.faces_of[dimension][number]

    def owners(self, points: ndarray, faces: ndarray) -> tuple[ndarray, ndarray]:
        """The face of each triangle, -1 for none, and parameters (t, 2) in its middle."""
        is_inner = self.located.dimension[faces] == 2
        count = is_inner.sum(axis=1)
        owner = np.where(is_inner, self.located.number[faces], -1).max(axis=1)
        total = np.sum(np.where(is_inner[:, :, None], self.located.at[faces], 0), axis=1)
        middle = total / np.maximum(count, 1)[:, None]
        bare = np.flatnonzero(count == 0)
        if len(bare):
            found = self.model.closest(points[faces[bare]].mean(axis=1))
            owner[bare] = found.face
            middle[bare] = found.at
        for row in np.flatnonzero(owner >= 0).tolist():
            if any(owner[row] not in self.faces(node) for node in faces[row].tolist()):
                owner[row] = -1
        return owner, middle

    def beside(self, node: int, face: int, middle: ndarray, scale: ndarray) -> tuple[int, float]:
        """The use and share of a node on a face's border that is nearest to parameters."""
        number = int(self.located.number[node])
        if self.located.dimension[node] == 1:
            share = float(self.located.at[node, 0])
            choices = [(use, share) for use in self.on_edge[face, number]]
        else:
            choices = [
                self._turned(use, end, middle, scale) for use, end in self.at_vertex[face, number]
            ]
        off = [
            np.linalg.norm((self.model.uses[use].at(share) - middle) * scale)
            for use, share in choices
        ]
        return choices[int(np.argmin(off))]

    def _turned(self, number: int, end: int, middle: ndarray, scale: ndarray) -> tuple[int, float]:
        """A pole is a line in the parameters: its place is the nearest on that line."""
        use = self.model.uses[number]
        if not self.model.is_point[use.edge]:
            return number, float(end)
        first, last = np.array([use.at(0.0), use.at(1.0)]) * scale
        along = last - first
        return number, float(np.clip((middle * scale - first) @ along / (along @ along), 0, 1))


def _has_area(model: Any, owner: ndarray, at: ndarray, corners: ndarray, scale: ndarray) -> ndarray:
    """Marks triangles that are on the surface, not across a seam, and have an area."""
    there = model.on_faces(owner, at.mean(axis=1))[:, 0]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    is_near = np.linalg.norm(there - corners.mean(axis=1), axis=1) <= longest
    flat = at * scale[owner][:, None]
    first, second = np.swapaxes(flat[:, 1:] - flat[:, :1], 0, 1)
    area = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    return is_near & (area > FLAT * (np.sum(first**2, axis=1) + np.sum(second**2, axis=1)))
