"""New cells where a motion has worn the old ones; all others stay as they are."""

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import ArrayLike, Int
from numpy import ndarray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from .._boundary.names import Nodes, nodes_named
from .._host.cells.adjacency import parts_of
from .._host.cells.pieces import owned_sides
from .._host.cells.topology import CORNERS, Pair
from .._host.linear.products import outward, row_lengths, unit_rows
from .._host.package.arguments import between, checked, finite_array, rows_of, whole
from .._host.rows import join_ids, mark
from .._mesh.mesh import Mesh, PointsLike
from .._quality.quality import quality
from .region import border_of, chosen_cells, inner_faces, region_of, staying
from .transfer import Remeshed, link_meshes, signed_volumes, simplices_in

GROWTH = 0.3  # of sizes of new cells, over the distance from the border of the region
HEIGHTS = (0.35, 0.2, 0.1)  # of pyramids, over the width of their base, tried in turn


@checked
def remesh(
    mesh: Mesh,
    points: PointsLike,
    *,
    keep: Nodes = (),
    target: float = 0.2,
    layers: int = 2,
    cells: Int[ArrayLike, " _k"] | Sequence[int] = (),
) -> Remeshed:
    """Replaces the cells that a motion has worn by triangles or tetrahedra of gmsh.

    A cell is worn where its smallest Jacobian falls below `target` of the undeformed one. It is
    worn, too, where 1 less its skewness falls below `target`, and fell. Worn cells and those
    around them are filled anew, with edges that grow from the border of their region. All other
    nodes and cells keep their numbers' order, and every bit. So do boundary faces, and the layers
    at walls: quads, wedges and hexahedra that are stacked on a boundary face and lower than wide. A
    pyramid stands on each quad that the new cells meet. Nodes of patches stay inside, too.

    **Arguments:**

    - `mesh`: the undeformed mesh, in 2-D or 3-D, of linear cells.
    - `points`: the moved points (n, d), in the unit of the mesh.
    - `keep`: node ids or patches that stay, with the cells between them. Default: none.
    - `target`: share of quality below which a cell is worn, from 0 to 1. Default 0.2.
    - `layers`: layers of cells around worn ones that are replaced, too, default 2. In 2-D they
      share edges; in 3-D nodes, and two count as one.
    - `cells`: numbers of further worn cells, such as `jm.judge(...).bad` of a next step.

    **Returns:** a `Remeshed`; without worn cells with the moved mesh as it is. **Raises:**
    `ImportError` without gmsh. `ValueError` for meshes of curved or cut cells, where no worn cell
    may be replaced, and where gmsh fails.
    """
    between("target", target, 0, 1)
    whole("layers", layers)
    moved = _checked_mesh(mesh, points)
    nodes = nodes_named(keep, "keep", mesh, len(mesh.points))
    worn = worn_cells(mesh, moved, target)
    worn[rows_of("cells", cells, len(worn))] = True
    return with_new_cells(mesh, moved, worn, nodes, layers=layers)


def with_new_cells(
    mesh: Mesh, moved: Mesh, worn: ndarray, keep: ndarray, *, layers: int, growth: float = GROWTH
) -> Remeshed:
    """Replaces worn cells (k,) of a moved mesh; sizes grow by `growth` with the distance."""
    if not worn.any():
        every = (np.arange(len(moved.points)), np.arange(len(worn)))
        return link_meshes(moved, moved, *every)
    chosen = region_of(moved, worn, staying(mesh, moved, keep), layers)
    if not chosen.any():
        raise ValueError(
            f"all {worn.sum()} worn cells belong to layers at walls, to inner "
            "patches or to `keep`, and stay: no mesh can be handed over here."
        )
    return _Hole.of(mesh, moved, chosen, growth).filled()


def _checked_mesh(mesh: Mesh, points: PointsLike) -> Mesh:
    places = finite_array("points", points, tuple(mesh.points.shape))
    reasons = {
        "no cells that fill the space": mesh.outer_faces is None,
        "curved cells": mesh.is_curved,
        "polyhedra or polygons": mesh.polyhedra is not None,
        "faces to other parts of a mesh": mesh.between is not None,
    }
    for reason, holds in reasons.items():
        if holds:
            raise ValueError(f"{mesh} has {reason}: jm.remesh takes a whole mesh of linear cells.")
    is_same = places is mesh.points or np.array_equal(places, mesh.points)
    return mesh if is_same else mesh.moved(places)


def worn_cells(mesh: Mesh, moved: Mesh, target: float) -> ndarray:
    """Marks the cells (k,) that the motion to another mesh of the same cells has worn."""
    now, start = (quality(mesh, np.asarray(each.points)) for each in (moved, mesh))
    skewed = (1 - now.skewness < target) & (now.skewness > start.skewness)
    return np.array(now.is_inverted | ~(now.jacobian_ratio >= target) | skewed)


@dataclasses.dataclass(frozen=True, eq=False)
class _Hole:
    """The region of `chosen` cells (k,) of a moved mesh, within faces seen from outside, by type.
    `shells` (f, 2) has numbers of the part that has each face, and of what lies behind it; `sizes`
    lengths of edges, at the nodes (n,).
    """

    moved: Mesh
    chosen: ndarray
    faces: dict[str, ndarray]
    shells: dict[str, ndarray]
    sizes: ndarray

    @classmethod
    def of(cls, mesh: Mesh, moved: Mesh, chosen: ndarray, growth: float) -> "_Hole":
        start = np.asarray(mesh.points, float)
        x = np.asarray(moved.points, float)
        simplices, owner = simplices_in(chosen_cells(mesh, chosen))
        volume = np.bincount(owner, signed_volumes(start[simplices]), chosen.sum())
        part = _connected_parts(mesh, chosen)
        kinds = ("line",) if start.shape[1] == 2 else ("triangle", "quad")
        faces = {kind: np.zeros((0, CORNERS[kind]), int) for kind in kinds}
        shells = {kind: np.zeros((0, 2), int) for kind in kinds}
        for kind, (ids, cell) in border_of(mesh, chosen).items():
            faces[kind] = np.where(volume[cell, None] < 0, ids[:, ::-1], ids)
            shells[kind] = np.stack([part[cell], _behind(mesh, chosen, kind, ids)], axis=1)
        on_border = _mean_lengths(x, faces.values())
        return cls(moved, chosen, faces, shells, _growing(x, simplices, on_border, growth))

    def filled(self) -> Remeshed:
        """Fills the hole; lower pyramids are tried where gmsh finds no room."""
        heights = HEIGHTS if len(self.faces.get("quad", ())) else HEIGHTS[:1]
        for height in heights:
            try:
                return self._filled(height)
            except ValueError:
                if height == heights[-1]:
                    raise
        raise AssertionError

    def _filled(self, height: float) -> Remeshed:
        from .fill import Sizes, fill_region  # needs gmsh

        moved = self.moved
        x = np.asarray(moved.points, float)
        d = x.shape[1]
        simplices, _ = simplices_in(chosen_cells(moved, self.chosen))
        sizes = Sizes(x[simplices], self.sizes[simplices])
        if d == 2:
            added, triangles = fill_region(x, self.faces["line"], self.shells["line"], sizes)
            return self._joined(added, {"triangle": triangles})
        apexes, pyramids = self._pyramids(x, height)
        # a pyramid's sides, seen from the tetrahedra beside it
        sides = [pyramids[:, [first, last, 4]] for first, last in ((1, 0), (2, 1), (3, 2), (0, 3))]
        border = np.concatenate([self.faces["triangle"], *sides])
        shells = np.concatenate([self.shells["triangle"], *[self.shells["quad"]] * 4])
        added, tetra = fill_region(np.concatenate([x, apexes]), border, shells, sizes)
        return self._joined(np.concatenate([apexes, added]), {"pyramid": pyramids, "tetra": tetra})

    def _pyramids(self, x: ndarray, height: float) -> Pair:
        """Apexes (q, 3) on the quads of the border, and pyramids (q, 5)."""
        base = self.faces["quad"][:, ::-1]
        corners = x[base]
        area = outward(corners)
        rise = height * np.sqrt(row_lengths(area))
        apexes = corners.mean(axis=1) + rise[:, None] * unit_rows(area)
        ids = len(x) + np.arange(len(base))
        return apexes, np.column_stack([base, ids])

    def _joined(self, added: ndarray, new: dict[str, ndarray]) -> Remeshed:
        """Joins the cells that stay and the new ones; checks that they meet."""
        moved = self.moved
        n = len(moved.points)
        self._check(np.concatenate([np.asarray(moved.points, float), added]), new)
        left = chosen_cells(moved, ~self.chosen)
        gone = mark(n, *chosen_cells(moved, self.chosen).values())
        gone &= ~mark(n, *left.values(), *self.faces.values())
        kept = np.flatnonzero(~gone)
        of_old = np.where(gone, -1, np.cumsum(~gone) - 1)
        number = np.append(of_old, len(kept) + np.arange(len(added)))
        kinds = sorted({*left, *new})
        none = {kind: np.zeros((0, CORNERS[kind]), int) for kind in kinds}
        cells = {
            kind: number[np.concatenate([(none | left)[kind], (none | new)[kind]])]
            for kind in kinds
        }
        points = np.asarray(moved.points)
        points = np.concatenate([points[kept], added.astype(points.dtype)])
        patches = {name: of_old[np.asarray(nodes)] for name, nodes in moved.patches.items()}
        cells = {kind: ids for kind, ids in cells.items() if len(ids)}
        mesh = Mesh(points, cells, patches, getattr(moved.source, "of_new_cells", None))
        starts = np.cumsum([0, *(len(mesh.cells[kind]) for kind in mesh.cells)]).tolist()
        first = dict(zip(mesh.cells, starts, strict=False))
        cells_of_old = np.full(len(self.chosen), -1)
        cells_of_old[~self.chosen] = join_ids(
            first.get(kind, 0) + np.arange(len(ids)) for kind, ids in left.items()
        )
        return link_meshes(moved, mesh, of_old, cells_of_old)

    def _check(self, x: ndarray, new: dict[str, ndarray]) -> None:
        simplices, _ = simplices_in(new)
        good = (signed_volumes(x[simplices]) > 0).all()
        sides = owned_sides(new, len(x))
        for kind, ids in self.faces.items():
            there = sides.get(kind, (ids[:0],))[0]
            rows, others = (np.unique(np.sort(faces, axis=1), axis=0) for faces in (ids, there))
            good &= np.array_equal(rows, others)
        if not good:
            raise ValueError(
                "gmsh has changed the border of the region, or left cells without volume: hand "
                "over earlier, with a larger `target`."
            )


def _connected_parts(mesh: Mesh, chosen: ndarray) -> ndarray:
    """The connected part of each chosen cell."""
    here, behind = inner_faces(mesh)
    both = chosen[here] & chosen[behind]
    return parts_of(here[both], behind[both], len(chosen))[chosen]


def _behind(mesh: Mesh, chosen: ndarray, kind: str, faces: ndarray) -> ndarray:
    """Numbers what lies behind faces of chosen cells: parts of other cells, or of the boundary."""
    rows, cell = border_of(mesh, ~chosen).get(kind, (faces[:0], np.zeros(0, int)))
    edges = _edge_nodes(ids for ids, _ in mesh.topology.outer().values())
    number = parts_of(edges[:, 0], edges[:, 1], len(mesh.points))[faces[:, 0]]
    both = np.sort(np.concatenate([rows, faces]), axis=1)
    _, first, place = np.unique(both, axis=0, return_index=True, return_inverse=True)
    twin = first[place.ravel()][len(rows) :]
    inner = twin < len(rows)
    number[inner] = len(mesh.points) + _connected_parts(mesh, ~chosen)[cell[twin[inner]]]
    return number


def _edge_nodes(corners: Iterable[ndarray]) -> ndarray:
    """The edges (e, 2) from each corner of faces or simplices to the one before."""
    pairs = [np.stack([ids, np.roll(ids, 1, axis=1)], axis=2).reshape(-1, 2) for ids in corners]
    return np.concatenate(pairs)


def _growing(x: ndarray, simplices: ndarray, sizes: ndarray, growth: float) -> ndarray:
    """Sizes (n,) that grow along the edges of simplices from those at nodes that have one."""
    # shortest ways from one more node, whose edge to a node with a size is as long as that
    n = len(x)
    pairs = np.unique(np.sort(_edge_nodes([simplices]), axis=1), axis=0)
    known = np.flatnonzero(sizes)
    lengths = growth * row_lengths(x[pairs[:, 1]] - x[pairs[:, 0]])
    ends = (np.append(pairs[:, 0], np.full(len(known), n)), np.append(pairs[:, 1], known))
    graph = csr_array((np.append(lengths, sizes[known]), ends), (n + 1, n + 1))
    return dijkstra(graph, directed=False, indices=n)[:n]


def _mean_lengths(x: ndarray, corners: Iterable[ndarray]) -> ndarray:
    """The mean length of edges at each node (n,); 0 where there is none."""
    pairs = _edge_nodes(corners)
    length = row_lengths(x[pairs[:, 1]] - x[pairs[:, 0]])
    total = np.bincount(pairs.ravel(), np.repeat(length, 2), len(x))
    return total / np.maximum(np.bincount(pairs.ravel(), minlength=len(x)), 1)
