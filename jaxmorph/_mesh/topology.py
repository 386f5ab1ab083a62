"""The topology of a mesh: what the ids of its cells tell, each found once."""

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Int

from .._host.cells.adjacency import handedness, is_among, neighbours
from .._host.cells.pieces import linear_cells, owned_sides, owners
from .._host.cells.topology import CORNERS, DIMENSION, SHAPES, ByType, Pair, solid
from .._host.linear.products import outward
from .._host.rows import mark
from .polyhedra import Polyhedra, triangles

Points = Float[np.ndarray, "n d"]


@dataclasses.dataclass(frozen=True, eq=False)
class Topology:
    """How the cells of a mesh hang together, by their ids alone: no motion changes it.

    A mesh and its `moved` copies share one topology, which finds each of its parts when first
    asked. Cells are numbered one type after another, as in `Mesh.cells`.

    - `cells`: node ids (k, nodes) by type.
    - `count`: the number of nodes.
    - `dimension`: of the cells that have `sides`.
    - `between`: corners (k, c) of faces to other parts of a mesh, or None.
    - `polyhedra`: the whole cells of a file with polyhedra, or None.
    """

    cells: Mapping[str, Any]
    count: int
    dimension: int
    between: np.ndarray | None = None
    polyhedra: Polyhedra | None = None

    @functools.cached_property
    def sides(self) -> dict[str, Pair]:
        """Faces (edges in 2-D) of one cell only: node ids (f, nodes) and the cell (f,), by type."""
        sides = owned_sides(jax.tree.map(np.asarray, dict(self.cells)), self.count)
        return {kind: side for kind, side in sides.items() if DIMENSION[kind] == self.dimension - 1}

    def outer(self, nodes: Any = slice(None)) -> dict[str, Pair]:
        """Selects the `sides` with all nodes among these ids, without those to other parts."""
        inside = np.zeros(self.count, bool)
        inside[nodes] = True
        outer = {}
        for kind, (ids, owner) in self.sides.items():
            rows = inside[ids].all(axis=1)
            if self.between is not None:
                rows &= ~is_among(ids, self.between)
            outer[kind] = ids[rows], owner[rows]
        return outer

    @functools.cached_property
    def neighbours(self) -> Pair:
        """The cell behind each face, and whether it is numbered with the opposite handedness."""
        return neighbours(jax.tree.map(np.asarray, dict(self.cells)))

    @functools.cached_property
    def handedness(self) -> Pair:
        """The sign of each cell's numbering, 1 or -1, and the number of its connected part."""
        return handedness(self.cells, *self.neighbours)

    @functools.cached_property
    def loose(self) -> Int[np.ndarray, " l"]:
        """Ids of the nodes of no cell."""
        labels = [] if self.polyhedra is None else [self.polyhedra.faces.labels]
        return np.flatnonzero(~mark(self.count, *self.cells.values(), *labels))


@dataclasses.dataclass(frozen=True, eq=False)
class OuterFaces:
    """The boundary faces (edges in 2-D) of the cells that fill the mesh, seen from outside.
    `corners` are node ids (k, corners) by type, `ids` (k,) the file's faces, one for all pieces of
    a face.
    """

    corners: dict[str, np.ndarray]
    ids: dict[str, np.ndarray]

    @classmethod
    def numbered(cls, faces: Mapping[str, Any]) -> "OuterFaces":
        return cls({kind: np.asarray(nodes) for kind, nodes in faces.items()}, owners(faces))

    @classmethod
    def of(cls, topology: Topology, points: Points) -> "OuterFaces | None":
        """Finds the boundary faces, none to other parts; None if no cells fill the space."""
        cells = {kind: np.asarray(ids) for kind, ids in topology.cells.items()}
        if not solid(cells, points.shape[1]):
            return None
        if topology.polyhedra is not None and points.shape[1] == 3:
            return _of_polyhedra(topology.polyhedra, points, topology.between)
        corners = [ids[:, : CORNERS[SHAPES[kind]]].T for kind, ids in cells.items()]
        middles = [sum(points[ids] for ids in columns) / len(columns) for columns in corners]
        outer = topology.outer()
        sides = {kind: nodes for kind, (nodes, _) in outer.items()}
        middle = np.concatenate(middles)[np.concatenate([owner for _, owner in outer.values()])]
        ids = owners(sides)
        return cls(_seen_from_outside(linear_cells(sides), ids, points, middle), ids)


def _seen_from_outside(
    corners: ByType, ids: ByType, points: np.ndarray, middle: np.ndarray
) -> dict[str, np.ndarray]:
    """Reverses faces that point to the `middle` (f, d) of their cell, each for itself: it runs
    clockwise. A face has one sense, that of the sum of its pieces.
    """
    outwards = np.zeros(len(middle))
    for kind, rows in corners.items():
        x = points[rows]
        face = ids[kind]
        np.add.at(outwards, face, np.einsum("kd,kd->k", outward(x), x.mean(axis=1) - middle[face]))
    return {
        kind: np.where(outwards[ids[kind], None] < 0, rows[:, ::-1], rows)
        for kind, rows in corners.items()
    }


def _of_polyhedra(whole: Polyhedra, points: np.ndarray, between: np.ndarray | None) -> OuterFaces:
    """The file's faces: pieces of polyhedra share none with the whole cells beside them."""
    faces = whole.faces
    rows = np.flatnonzero(faces.all_neighbours() < 0)
    if between is not None:
        rows = rows[~is_among(faces.padded(rows), between)]
    sizes = faces.sizes[rows]
    quads = np.flatnonzero(sizes == 4)
    others = np.flatnonzero(sizes != 4)
    corners: dict[str, Any] = {"triangle": np.zeros((0, 3), np.int64)}
    ids = {"triangle": np.zeros(0, int), "quad": quads}
    if len(others):
        corners["triangle"], piece_of = triangles(faces, rows[others], points)
        ids["triangle"] = others[piece_of]
    corners["quad"] = faces.corners(rows[quads], 4)
    owner = faces.owner[rows]
    middle = whole.middles(points, owner)[owner]
    return OuterFaces(_seen_from_outside(corners, ids, points, middle), ids)
