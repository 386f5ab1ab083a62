"""Crossings: moved walls that run into another boundary or into themselves."""

import dataclasses

import numpy as np

from .._boundary.outer_faces import outer_faces
from .._host.cells.adjacency import parts_of
from .._host.package.rounding import Tree
from .._host.surface.crossings import crossing_faces
from .._mesh.mesh import Mesh

SAME = 1e-9
"""Distance of nodes that count as one place, relative to the extent of the mesh.

They are the two sides of a cut or of a sharp edge.
"""


@dataclasses.dataclass(frozen=True, eq=False)
class Crossings:
    """Pairs of boundary faces that cross or touch only after the motion; true if any do.

    A wall that has passed through another wall completely does not cross it any more, and is not
    found.

    - `nodes` (k, 2): one node of each of the two faces.
    - `patches`: the names of the two patches of each pair, equal for a wall that crosses itself; ""
      without a patch.
    - `places` (k, d): a point of each crossing, in the mesh's unit.
    """

    nodes: np.ndarray
    patches: tuple[tuple[str, str], ...]
    places: np.ndarray

    def __len__(self) -> int:
        return len(self.nodes)

    def __str__(self) -> str:
        """Describes the crossings in two sentences: how many, between which patches, and where."""
        if not len(self):
            return ""
        pairs = dict.fromkeys(tuple(sorted(pair)) for pair in self.patches)
        between = ", ".join(_between(*pair) for pair in pairs)
        place = ", ".join(f"{x:.4g}" for x in self.places[0])
        count = f"{len(self)} {'pair' if len(self) == 1 else 'pairs'}"
        return (
            f"{count} of boundary faces cross each other after the motion ({between}), first near ({place}). No mesh can follow: "
            "move the wall less, or both walls together."
        )


def _between(first: str, second: str) -> str:
    one, other = (repr(name) if name else "faces of no patch" for name in (first, second))
    return f"{one} and itself" if first == second else f"{one} and {other}"


def crossings(cut: tuple[np.ndarray, np.ndarray], mesh: Mesh, nodes: np.ndarray, vectors: np.ndarray) -> Crossings:
    """Finds where the boundary crosses itself after its `nodes` (o,) move by `vectors` (o, d).

    `cut` is what `simplices` returned for the nodes.
    """
    faces, ids = cut
    points = np.asarray(mesh.points, dtype=float)
    before = points[nodes]
    together = _together(before, SAME * np.ptp(points, axis=0).max())
    after = before + vectors
    pairs, places = crossing_faces(before, after, faces, together)
    single = np.sort(np.unique(np.sort(ids[pairs], axis=1), axis=0, return_index=True)[1])
    pairs, places = pairs[single], places[single]
    first, second = (names_of(mesh, nodes[faces[pairs[:, k]]]) for k in range(2))
    return Crossings(nodes[faces[pairs, 0]], tuple(zip(first, second, strict=True)), places)


def simplices(mesh: Mesh, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Cuts the boundary faces between `nodes` (o,) into simplices (f, d); None without faces.

    A simplex has rows of `nodes`, seen from outside.

    It also returns the number (f,) of the file's face that each is a part of.
    """
    outer = outer_faces(mesh)
    if outer is None:
        return None
    rows = np.full(len(mesh.points), -1)
    rows[nodes] = np.arange(len(nodes))
    parts = [(_simplices(rows[corners]), outer.ids[kind]) for kind, corners in outer.corners.items()]
    faces = np.concatenate([part for part, _ in parts])
    ids = np.concatenate([np.resize(face, len(part)) for part, face in parts])
    known = (faces >= 0).all(axis=1)
    return faces[known], ids[known]


def _simplices(corners: np.ndarray) -> np.ndarray:
    """Cuts quadrilaterals into two triangles: all first triangles, then all second ones."""
    if corners.shape[1] < 4:
        return corners
    return np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])


def _together(points: np.ndarray, distance: float) -> np.ndarray:
    """Numbers the places of nodes (b,): nodes that nearly coincide are at one place."""
    pairs = Tree(points).query_pairs(distance, output_type="ndarray")
    return parts_of(pairs[:, 0], pairs[:, 1], len(points))


def names_of(mesh: Mesh, faces: np.ndarray) -> list[str]:
    """Names the smallest patch with all nodes of each face (k, corners); "" without any."""
    names = np.full(len(faces), "", dtype=object)
    for name, nodes in sorted(mesh.patches.items(), key=lambda item: -len(item[1])):
        inside = np.zeros(len(mesh.points), dtype=bool)
        inside[np.asarray(nodes)] = True
        names[inside[faces].all(axis=1)] = name
    return names.tolist()
