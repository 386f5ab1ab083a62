"""The mesh: points, cells, and patches of boundary nodes."""

import dataclasses
import weakref
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Integer, Real

from .._host.cells.lagrange import ORDERS, node_keys, of_order
from .._host.cells.pieces import linear_cells, places_of, steps_of
from .._host.cells.topology import CORNERS, DIMENSION, SHAPES
from .._host.package.arguments import check_value, checked, shown, whole
from .._host.package.text import list_names, patch_names
from .._host.rows import Rows, first_of_equals, join_ids
from .._kernels.module import Module
from .._kernels.values import is_known
from . import exchange, export, vtk
from .exchange import checked_parts, floats
from .polyhedra import Polyhedra
from .topology import OuterFaces, Topology

PointsLike = Real[ArrayLike, "n d"] | Sequence[Any]
"""Coordinates as public functions take them: arrays of real numbers, or lists."""

# What meshes have found, beside them: Equinox takes what stands in a module for its structure.
_TOPOLOGIES: weakref.WeakKeyDictionary["Mesh", Topology] = weakref.WeakKeyDictionary()
_OUTER_FACES: weakref.WeakKeyDictionary["Mesh", OuterFaces | None] = weakref.WeakKeyDictionary()


class Mesh(Module):
    """Points, the cells between them, and named patches of boundary nodes.

    **Arguments:**

    - `points`: coordinates (n, d) with d = 2 or 3, in the units of the file. Arrays of NumPy are
      kept read-only, as a copy where the caller could write into them.
    - `cells`: corner ids (k, corners) by type, numbered as VTK numbers them. Types are `triangle`,
      `quad`, `tetra`, `pyramid`, `wedge` and `hexahedron` (aliases `tri`, `tet`, `prism`, `hex`),
      and of order 2 to 4 these with their number of nodes, `triangle6` or `hexahedron64`. Types are
      kept in alphabetical order, also under `jit`. Default: none.
    - `patches`: node ids by name, without repetition. Default: none.
    - `source`: the file's content, for `jaxmorph.io.write`. Default: none.

    Nodes of a cell of order p stand on its edges, faces and inside at equal steps of 1 / p. A cell
    lists its corners first, then the inner nodes of its edges, of its faces, and of the cell.
    `jaxmorph.io.read` brings the nodes of all formats into this order.

    **Raises:** `ValueError` for an unknown cell type, ids outside of `points`, and wrong shapes.
    """

    points: Float[Array | np.ndarray, "n d"]
    cells: dict[str, Integer[Array | np.ndarray, "_k _corners"]]
    patches: dict[str, Integer[Array | np.ndarray, "_p"]]
    source: Any = eqx.field(static=True, default=None)

    def __init__(self, points, cells=None, patches=None, source=None):
        check_value("cells", cells, Mapping[str, Any] | None, Mesh)
        check_value("patches", patches, Mapping[str, Any] | None, Mesh)
        self.points, self.cells, self.patches, self.source = checked_parts(
            points, cells, patches, source
        )

    @checked
    def patch(self, *names: str) -> np.ndarray:
        """Lists the node ids of one or several patches, ascending, without repetition.

        A name is that of a patch or a group, or a regular expression for whole names of patches,
        `"motorBike.*"`.

        **Raises:** `ValueError`, with all names of the mesh, for a name without a patch.
        """
        if not names:
            return np.zeros(0, dtype=np.int64)
        return np.unique(
            np.concatenate([np.asarray(self.patches[name]) for name in self.patch_names(*names)])
        )

    @checked
    def patch_names(self, *names: str) -> tuple[str, ...]:
        """Lists the patches of names, as `patch` takes names."""
        is_flat = self.points.shape[1] == 2
        for name in names if is_flat else ():
            kind = getattr(self.source, "kinds", {}).get(name)
            if kind and name not in self.patches:
                raise ValueError(
                    f"{name!r} ({kind}) is no patch, for the mesh is in 2-D and lies in it: leave "
                    f"it out; {list_names(self.patches, self.groups)}."
                )
        return patch_names(names, self.patches, self.groups)

    @property
    def groups(self) -> Mapping[str, tuple[str, ...]]:
        """Groups of patches in the file, by name: an OpenFOAM case's `inGroups`."""
        groups = getattr(self.source, "groups", {})
        within = {
            name: tuple(patch for patch in patches if patch in self.patches)
            for name, patches in groups.items()
        }
        return {name: patches for name, patches in within.items() if patches}

    @property
    def kinds(self) -> Mapping[str, str]:
        """Kinds of patches in the file, by name: `BCFarfield` (CGNS), `wall` (OpenFOAM)."""
        return {
            name: kind
            for name, kind in getattr(self.source, "kinds", {}).items()
            if name in self.patches
        }

    @property
    def file_nodes(self) -> np.ndarray:
        """The node (N,) of this mesh for every node of its file, in the file's order.

        Zones of a CGNS or PLOT3D file share nodes of the mesh, and so do the two planes of an
        OpenFOAM case in 2-D.
        """
        nodes = getattr(self.source, "file_nodes", None)
        return np.arange(len(self.points)) if nodes is None else nodes

    @checked
    def in_file_order(self, points: PointsLike) -> np.ndarray:
        """Computes coordinates (N, D) of all nodes of the file from this mesh's `points` (n, d).

        `jaxmorph.io.write` writes these. D is 3 if the file has three coordinates, also for a mesh
        in 2-D. A node that has not moved keeps the file's coordinates in all of its copies.

        **Raises:** `ValueError` when the shape of `points` differs.
        """
        places = np.array(self.moved(points).points)
        in_file = getattr(self.source, "in_file", None)
        return places if in_file is None else in_file(places)

    @property
    def polyhedra(self) -> Polyhedra | None:
        """Whole cells of a file with polyhedra (2-D: polygons), cut in `cells`; or None."""
        return getattr(self.source, "polyhedra", None)

    @property
    def cell_ids(self) -> np.ndarray:
        """File numbers (k,) of `cells`; pieces of a polyhedron share a number."""
        ids = getattr(self.source, "cell_ids", None)
        return (
            np.arange(sum(len(corners) for corners in self.cells.values())) if ids is None else ids
        )

    @property
    def between(self) -> np.ndarray | None:
        """Faces (k, corners), 2-D: edges, between this part of a mesh and others; or None.

        Rows end in -1. These faces are no boundary: their nodes are inner nodes, and no measure
        compares the cells on their two sides.
        """
        return getattr(self.source, "between", None)

    @property
    def cell_counts(self) -> dict[str, int]:
        """Numbers of cells by type in the file; cut cells count as `polyhedron` or `polygon`."""
        counts = exchange.numbers_of_cells(self.cells)
        if self.polyhedra is not None:
            is_whole = ~np.isin(self.cell_ids, self.polyhedra.cut)
            counts = {
                kind: int(is_whole[first:][: counts[kind]].sum())
                for kind, first in self._firsts.items()
            }
            counts["polygon" if self.points.shape[1] == 2 else "polyhedron"] = len(
                self.polyhedra.cut
            )
        return {kind: count for kind, count in counts.items() if count}

    @property
    def is_curved(self) -> bool:
        """True where some cells are of order 2 or more."""
        return any(kind != SHAPES[kind] for kind in self.cells)

    @property
    def linear(self) -> "Mesh":
        """This mesh with linear cells: pieces of order-p cells between all nodes; else itself."""
        if not self.is_curved:
            return self
        cells = linear_cells(
            self.cells, np.concatenate if is_known(*self.cells.values()) else jnp.concatenate
        )
        return self._with("cells", {kind: cells[kind] for kind in sorted(cells)})

    @checked
    def skin(self, *patches: str) -> tuple["Mesh", Integer[np.ndarray, " k"]]:
        """Makes a mesh of the outer faces (2-D: edges), curved where the cells are.

        Of `patches`, as `patch` takes names, it has the faces with all nodes in them; by default
        all. Faces to other parts of a mesh are left out.

        **Returns:** the mesh, with the points and patches of this one, and the number (k,) of the
        cell that has each face, in the order of `cells`.

        **Raises:** `ValueError` for a name without a patch, and for polyhedra and polygons, whose
        faces `boundary_faces` lists.
        """
        if self.polyhedra is not None:
            raise ValueError(
                f"{self} has polyhedra or polygons: jm.boundary_faces(mesh) lists their outer "
                "faces."
            )
        outer = self.topology.outer(self.patch(*patches) if patches else slice(None))
        sides = {kind: nodes for kind, (nodes, _) in outer.items()}
        owners = join_ids(outer[kind][1] for kind in sorted(outer))
        return Mesh(self.points, sides, self.patches), owners

    @property
    def topology(self) -> Topology:
        """How the cells hang together, found once; `moved` copies share it."""
        if self not in _TOPOLOGIES:
            n, d = self.points.shape
            _TOPOLOGIES[self] = Topology(self.cells, n, d, self.between, self.polyhedra)
        return _TOPOLOGIES[self]

    @property
    def outer_faces(self) -> OuterFaces | None:
        """The boundary faces, seen from outside, found once; None if no cells fill the space."""
        if self not in _OUTER_FACES:
            _OUTER_FACES[self] = OuterFaces.of(self.topology, np.asarray(self.points))
        return _OUTER_FACES[self]

    @property
    def _firsts(self) -> dict[str, int]:  # the number of the first cell of each type
        return dict(
            zip(self.cells, np.cumsum([0, *map(len, self.cells.values())]).tolist(), strict=False)
        )

    def refined(self, steps: int) -> tuple["Mesh", Integer[np.ndarray, " k"]]:
        """Makes a mesh of linear cells that follow the curved ones: each edge has `steps` pieces.

        The pieces share points, which are new; there are no patches.

        **Returns:** the mesh, and the number (k,) of the cell of which each of its cells is a
        piece, in the order of `cells`.

        **Raises:** `ValueError` for fewer steps than 1.
        """
        whole("steps", steps)
        points, tables = _lattices(self, steps)
        found = {}
        numbers = self._firsts
        for kind, table in tables.items():
            for shape, rows in steps_of(SHAPES[kind], steps).items():
                owner = numbers[kind] + np.repeat(np.arange(len(table)), len(rows))
                found.setdefault(shape, []).append(
                    (table[:, rows].reshape(-1, rows.shape[1]), owner)
                )
        joined = {
            shape: [np.concatenate(part) for part in zip(*found[shape], strict=True)]
            for shape in sorted(found)
        }
        owners = join_ids(owner for _, owner in joined.values())
        return Mesh(points, {shape: ids for shape, (ids, _) in joined.items()}), owners

    @checked
    def moved(self, points: PointsLike) -> "Mesh":
        """Makes a mesh with coordinates `points` (n, d), and the cells and patches of this mesh.

        **Raises:** `ValueError` when the shape of `points` differs.
        """
        places = floats(points)
        if tuple(places.shape) != tuple(self.points.shape):
            raise ValueError(
                f"`points` has shape {tuple(places.shape)}; this mesh has "
                f"{tuple(self.points.shape)}."
            )
        moved = self._with("points", places)
        _TOPOLOGIES[moved] = self.topology
        return moved

    def _with(self, name: str, value: Any) -> "Mesh":
        other = object.__new__(Mesh)
        for field in dataclasses.fields(self):
            object.__setattr__(
                other, field.name, value if field.name == name else getattr(self, field.name)
            )
        return other

    @staticmethod
    def from_meshio(mesh: Any) -> "Mesh":
        """Makes a mesh of a `meshio.Mesh`: cells of highest dimension, 2-D if all z are equal.

        Patches are point sets, cell sets of lower dimension, gmsh's physical groups and point
        arrays `patch:NAME`. Without them, the whole numbers of an array `patch`, `marker`,
        `boundary` ..., on the boundary's cells or on points, name patches. Without such an array
        the one patch is `boundary`. Point ids stay, and `to_meshio` of the result knows the
        `meshio.Mesh`.

        **Raises:** `ValueError` for cell types that are not supported (polyhedra, nodes between
        corners), points that are not finite, and a mesh without area or volume.
        """
        return Mesh(*exchange.parts(exchange.of_meshio(mesh)))

    @checked
    def to_meshio(
        self,
        *,
        point_data: dict[str, ArrayLike] | None = None,
        cell_data: dict[str, ArrayLike] | None = None,
    ) -> Any:
        """Makes a `meshio.Mesh`: the one that this mesh came from, with other points, or a new one.

        Patches are point arrays `patch:NAME` of zeros and ones.

        **Arguments:**

        - `point_data`, `cell_data`: arrays to add, one row a point, or a cell in the order of
          `cells`. Other cells of the `meshio.Mesh` get NaN. Default: none.

        **Raises:** `ValueError` for arrays of a wrong length, `ImportError` for a missing meshio.
        """
        return export.to_meshio(self._parts, point_data, cell_data)

    @staticmethod
    def from_pyvista(grid: Any) -> "Mesh":
        """Makes a mesh of a `pyvista.UnstructuredGrid`, or other data set, as `from_meshio` does.

        **Raises:** `ValueError` as `from_meshio` does, and for a `MultiBlock`.
        """
        if not hasattr(type(grid), "cells_dict"):
            if not hasattr(grid, "cast_to_unstructured_grid"):
                raise ValueError(
                    f"`grid` must be a single grid of PyVista, not {shown(grid)}; one of several "
                    "blocks has `combine`."
                )
            grid = grid.cast_to_unstructured_grid()
        return Mesh(*vtk.mesh_of(grid))

    @checked
    def to_pyvista(
        self,
        *,
        point_data: dict[str, ArrayLike] | None = None,
        cell_data: dict[str, ArrayLike] | None = None,
    ) -> Any:
        """Makes a `pyvista.UnstructuredGrid`; patches, arguments and errors as of `to_meshio`."""
        return export.to_pyvista(self._parts, point_data, cell_data)

    @property
    def _parts(self) -> exchange.Parts:
        return exchange.Parts(self.points, self.cells, self.patches, self.source)

    def __repr__(self) -> str:
        n, d = self.points.shape
        cells = (
            ", ".join(f"{len(corners)} {kind}" for kind, corners in self.cells.items())
            or "no cells"
        )
        patches = (
            ", ".join(f"{name} ({len(nodes)})" for name, nodes in self.patches.items()) or "none"
        )
        return f"Mesh({n} points in {d}-D; {cells}; patches: {patches})"


@checked
def elevate(mesh: Mesh, order: int) -> Mesh:
    """Makes a mesh of order 2 to 4 of a linear one.

    The cells stay straight, with nodes on their edges, faces and inside. The nodes of the linear
    mesh come first, in their order. New nodes of boundary faces belong to the patches that have all
    corners of the face. `curve` then puts the wall's nodes onto a curved surface.

    **Arguments:**

    - `mesh`: a mesh of linear cells.
    - `order`: 2, 3 or 4.

    **Returns:** a new `Mesh`, which belongs to no file.

    **Raises:** `ValueError` for another order, curved cells, no cells, and polyhedra.
    """
    if order not in ORDERS[1:]:
        raise ValueError(f"`order` is {order}; meshes of order 2, 3 and 4 can be made.")
    if mesh.is_curved or mesh.polyhedra is not None or not mesh.cells:
        raise ValueError(
            f"{mesh} cannot be elevated: linear cells are needed, of the types "
            f"{', '.join(CORNERS)}."
        )
    old = np.asarray(mesh.points)
    places, tables = _lattices(mesh, order)
    number = np.full(len(places), -1)
    for kind, table in tables.items():
        number[table[:, : CORNERS[kind]]] = mesh.cells[kind]
    new = np.flatnonzero(number < 0)
    number[new] = len(old) + np.arange(len(new))
    cells = {of_order(kind, order).name: number[table] for kind, table in tables.items()}
    points = np.concatenate([old, places[new]])
    return Mesh(points, cells, _joined_patches(mesh, cells, len(points)))


def _lattices(mesh: Mesh, steps: int) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Points (p, d) of lattices of all cells, `steps` to an edge, and their ids (k, s) by type."""
    # A point is known by corners and their weights, in ascending order: cells that share a face
    # agree on it. In the order of these keys corners come first, which stay where they are.
    points = np.asarray(mesh.points)
    keys = {}
    places = [points[:0]]
    for kind, ids in mesh.cells.items():
        nodes = np.asarray(ids)
        corners = nodes[:, : CORNERS[SHAPES[kind]]]
        keys[kind] = node_keys(corners, of_order(SHAPES[kind], steps))
        here = np.einsum("sn,knd->ksd", places_of(kind, steps), points[nodes])
        here[:, : corners.shape[1]] = points[corners]
        places.append(here.reshape(-1, points.shape[1]))
    first, number = first_of_equals(join_ids(keys.values()).reshape(-1, 16))
    tables = {}
    for kind, key in keys.items():
        count = key.size // 16
        tables[kind] = number[:count].reshape(key.shape[:2])
        number = number[count:]
    return np.concatenate(places)[first].astype(points.dtype), tables


def _joined_patches(mesh: Mesh, cells: dict[str, np.ndarray], n: int) -> dict[str, np.ndarray]:
    patches = {name: [np.asarray(nodes)] for name, nodes in mesh.patches.items()}
    highest = max(DIMENSION[kind] for kind in cells)
    for kind, (sides, _) in Topology(cells, n, highest).sides.items():
        corners = sides[:, : CORNERS[SHAPES[kind]]]
        for name, nodes in mesh.patches.items():
            patches[name].append(sides[Rows(nodes).mask(corners).all(axis=1)].ravel())
    return {name: np.concatenate(parts) for name, parts in patches.items()}
