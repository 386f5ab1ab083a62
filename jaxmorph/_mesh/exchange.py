"""Meshes of meshio and PyVista as a `Mesh`, and back: their cells, patches and arrays."""

import dataclasses
import importlib
import urllib.parse
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from .._host.cells.orders import MESHIO, VTK_ORDER, reordered
from .._host.cells.pieces import outer_pieces
from .._host.cells.topology import (
    CORNERS,
    DIMENSION,
    KNOWN,
    NODES,
    SHAPES,
    VTK_QUADRATIC,
    canonical_type,
    solid,
)
from .._host.package.arguments import freeze, has_type, native_order, real_array, shown

# point arrays of this name and a patch's hold 1 at the nodes of the patch and 0 elsewhere
PREFIX = "patch:"

MARKERS = (
    "patch",
    "patch_id",
    "patchid",
    "marker",
    "boundary",
    "boundary_id",
    "cellentityids",
    "medit:ref",
)
MARKERS += ("modelfaceid", "facet_tags", "name_to_read", "ugrid:ref", "nastran:ref")
"""Names, in lower case, of arrays whose numbers name patches."""

GROUPS = (
    "gmsh:physical",
    "netgen:index",
)  # meshio's arrays of numbers of groups, whose names are field data
BOUNDING = "gmsh:bounding_entities"  # meshio's name of a set of cells that is no physical group

LAGRANGE = {
    **{
        "VTK_LAGRANGE_CURVE": "line",
        "VTK_LAGRANGE_TRIANGLE": "triangle",
        "VTK_LAGRANGE_QUADRILATERAL": "quad",
    },
    **{
        "VTK_LAGRANGE_TETRAHEDRON": "tetra",
        "VTK_LAGRANGE_HEXAHEDRON": "hexahedron",
        "VTK_LAGRANGE_WEDGE": "wedge",
    },
}
"""meshio's names of VTK's cells of any order; the number of nodes tells the order."""

GMSH_LEVELS = ("point", "curve", "surface", "volume")  # gmsh's names of the dimensions
SHOWN = 6  # numbers of an array that a sentence lists

Arrays = Mapping[str, Any]
ByName = dict[str, np.ndarray]
Block = tuple[int, np.ndarray, Any]  # dimension, corners (k, c) and value of a block of cells


@dataclasses.dataclass(frozen=True, eq=False)
class Origin:
    """The foreign mesh that a mesh came from, and numbers of the mesh's cells by type. `polyhedra`
    and `cell_ids` are as in `Mesh`, `notes` sentences on what was left out or renamed. Compared by
    identity, as a static field of a pytree must be.
    """

    content: Any
    cells: Mapping[str, int]
    polyhedra: Any = None
    cell_ids: np.ndarray | None = None
    notes: tuple[str, ...] = ()


class Patch(NamedTuple):
    """A set of nodes called `name`, and its own name, `nodes_10` for node set 10."""

    name: str
    own: str
    nodes: np.ndarray


def distinct(patches: Iterable[Patch]) -> tuple[ByName, tuple[str, ...]]:
    """Gives each set of nodes a name, and notes duplicate names, of which the first one stays.
    Other sets add their own name. Sets of the same name and nodes are one.
    """
    found: ByName = {}
    notes = []
    for name, own, nodes in patches:
        new = name
        nodes = np.unique(nodes)
        while new in found and not np.array_equal(found[new], nodes):
            new = f"{new}_{own}"
        if new in found:
            notes.append(
                f"{own} has the name and the nodes of the patch {new}: the two are one patch."
            )
        elif new != name:
            notes.append(
                f"{own} is called {name}, as another patch with other nodes: it is the patch {new}."
            )
        found[new] = nodes
    return found, tuple(notes)


def gathered(pairs: Iterable[tuple[Any, np.ndarray]]) -> dict[Any, np.ndarray]:
    parts: dict[Any, list[np.ndarray]] = {}
    for key, rows in pairs:
        parts.setdefault(key, []).append(rows)
    return {key: np.concatenate(parts.pop(key)) for key in list(parts)}


def numbers_of_cells(cells: Mapping[str, Any]) -> dict[str, int]:
    return {kind: len(corners) for kind, corners in cells.items()}


def intact_source(mesh: Any) -> Any:
    known = getattr(mesh.source, "cells", None)
    return mesh.source if known in (None, numbers_of_cells(mesh.cells)) else None


@dataclasses.dataclass(frozen=True, eq=False)
class Grid:
    """A mesh of another library: `blocks` of one cell type; `cell_data` has one array a block.
    `outer` are the nodes of the outer faces, None where those of the cells tell them; `content` is
    the library's own mesh. `own` are its words for the members of sets of cells and of points.
    `whole` are its polyhedra, and the whole cell of each cell, where some are cut.
    """

    points: np.ndarray
    blocks: list[tuple[str, np.ndarray]]
    point_data: Arrays
    cell_data: Mapping[str, list[np.ndarray]]
    cell_sets: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    field_data: Arrays = dataclasses.field(default_factory=dict)
    point_sets: Arrays = dataclasses.field(default_factory=dict)
    content: Any = None
    outer: np.ndarray | None = None
    own: tuple[str, str] = ("cells", "points")
    whole: tuple[Any, Any] = (None, None)

    def of_blocks(self, values: Iterable[Any], *, full: bool = False) -> Iterator[Block]:
        """Yields dimension, corners and value of blocks below the highest dimension, or of it."""
        levels = [DIMENSION.get(kind, 2 if kind == "polygon" else 0) for kind, _ in self.blocks]
        for level, (_, corners), value in zip(levels, self.blocks, values, strict=False):
            if (level == max(levels)) == full:
                yield level, corners, value


def of_meshio(mesh: Any) -> Grid:
    names = ("point_data", "cell_data", "cell_sets", "field_data")
    if not all(hasattr(mesh, name) for name in ("points", "cells", *names)):
        raise ValueError(
            f"`mesh` must be a meshio.Mesh, not {shown(mesh)}. Call "
            "Mesh.from_meshio(meshio.read(path))."
        )
    blocks = [kind_of_block(block.type, np.asarray(block.data)) for block in mesh.cells]
    unknown = dict.fromkeys(
        kind for kind, ids in blocks if len(ids) and kind not in (*NODES, "vertex")
    )
    if unknown:
        raise ValueError(f"cells of type {', '.join(unknown)} are not supported; {KNOWN}.")
    arrays = {name: getattr(mesh, name) for name in names}
    return Grid(
        np.asarray(mesh.points),
        blocks,
        **arrays,
        point_sets=getattr(mesh, "point_sets", {}),
        content=mesh,
    )


def kind_of_block(kind: str, ids: np.ndarray) -> tuple[str, np.ndarray]:
    if not len(ids):
        return kind, ids
    shape = LAGRANGE.get(kind)
    order = MESHIO
    if shape is not None:
        kind = sized(shape, ids.shape[1])
        order = VTK_ORDER
    check_width(kind, ids.shape[-1])
    return kind, reordered(kind, ids, order, None) if kind in NODES else ids


def sized(shape: str, size: int) -> str:
    return shape if size == CORNERS[shape] else f"{shape}{size}"


def check_width(kind: str, size: int) -> None:
    if size != NODES.get(kind, size):
        raise ValueError(f"cells of type {kind} have {size} nodes, not {NODES[kind]}.")


def block_of(kind: str, ids: Any) -> tuple[str, np.ndarray]:
    """Names a cell type as meshio does (VTK's from order 3 on), and orders its nodes so."""
    ids = np.asarray(ids)
    names = {shape: name for name, shape in LAGRANGE.items()}
    if kind in CORNERS or kind in VTK_QUADRATIC or SHAPES[kind] not in names:
        return kind, reordered(kind, ids, None, MESHIO)
    return names[SHAPES[kind]], reordered(kind, ids, None, VTK_ORDER)


def imported(name: str, extra: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ImportError(
            f"this needs {name.split('modules')[0]}: pip install 'jaxmorph[{extra}]'"
        ) from error


class Parts(NamedTuple):
    """Points (n, d), corner ids by type, nodes by patch, and the source: a `Mesh`, without JAX."""

    points: Any
    cells: dict[str, Any]
    patches: dict[str, Any]
    source: Any = None


def parts(grid: Grid, more: Iterable[Patch] = ()) -> Parts:
    """Makes points, cells and patches of a grid: highest dimension, without z if all z are equal.
    Patches are `more`, point arrays `patch:NAME`, named sets of points and of cells of lower
    dimension, and gmsh's physical groups. Without them, the numbers of an array of `MARKERS` name
    patches. Without such an array, the nodes of faces that belong to one cell only are the patch
    `boundary`.
    """
    cells = _cells(grid)
    points = _points_of_grid(grid, cells)
    patches, notes = distinct([*more, *_sets(grid), *_physical(grid)])
    taken, marked = ("", {}) if patches else _marked(grid)
    patches = patches or marked
    if not patches and grid.outer is not None:
        patches = {"boundary": grid.outer}
    elif not patches:
        outer = outer_pieces(cells, len(points))
        patches = {"boundary": np.concatenate([corners.ravel() for corners in outer.values()])}
        faces = sum(len(corners) for kind, corners in grid.blocks if kind not in cells)
        notes += (
            f"{faces} faces, edges or points of the file have no names, and are no patches.",
        ) * bool(faces)
    origin = Origin(
        grid.content, numbers_of_cells(cells), *grid.whole, (*notes, *_left(grid, taken))
    )
    return Parts(np.ascontiguousarray(points), cells, patches, origin)


def _cells(grid: Grid) -> ByName:
    found = gathered((kind, ids) for kind, ids in grid.blocks if len(ids) and kind in DIMENSION)
    cells = solid(found, max((2, *(DIMENSION[kind] for kind in found))))
    if not cells:
        there = ", ".join(dict.fromkeys(kind for kind, _ in grid.blocks)) or "nodes"
        raise ValueError(f"no cells of an area or a volume, only {there}.")
    return cells


def _points_of_grid(grid: Grid, cells: Mapping[str, np.ndarray]) -> np.ndarray:
    points = grid.points.astype(float)
    if DIMENSION[next(iter(cells))] == 2 and points.shape[1] == 3 and np.ptp(points[:, 2]) == 0:
        points = points[:, :2]
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if len(bad):
        raise ValueError(f"point {bad[0]} is not finite: {points[bad[0]].tolist()}.")
    for kind, corners in cells.items():
        outside = corners[(corners < 0) | (corners >= len(points))]
        if len(outside):
            raise ValueError(
                f"a {kind} names node {outside[0]}, but there are {len(points)} points."
            )
    return points


def _sets(grid: Grid) -> Iterator[Patch]:
    for name, values in grid.point_data.items():
        if name.startswith(PREFIX) and np.ndim(values) == 1:
            yield Patch(
                urllib.parse.unquote(name.removeprefix(PREFIX)), "array", np.flatnonzero(values)
            )
    for name, members in grid.cell_sets.items():
        blocks = grid.of_blocks(members if name != BOUNDING else ())
        nodes = [ids[np.asarray(rows, int)].ravel() for _, ids, rows in blocks if _has_some(rows)]
        if nodes:
            yield Patch(name, grid.own[0], np.concatenate(nodes))
    for name, members in grid.point_sets.items():
        yield Patch(name, grid.own[1], np.asarray(members, dtype=np.int64))


def _physical(grid: Grid) -> Iterator[Patch]:
    """Yields gmsh's physical groups, and Netgen's; an unnamed group is `physical_` and its tag."""
    names = {
        tuple(np.asarray(info).tolist()): name
        for name, info in grid.field_data.items()
        if np.size(info) == 2
    }
    groups = next((grid.cell_data[name] for name in GROUPS if name in grid.cell_data), ())
    nodes = gathered(
        ((tag, level), nodes) for level, tag, nodes in by_number(grid.of_blocks(groups)) if tag > 0
    )
    for (tag, level), members in nodes.items():
        yield Patch(
            names.get((tag, level), f"physical_{tag}"), f"{GMSH_LEVELS[level]}_{tag}", members
        )


def _marked(grid: Grid) -> tuple[str, ByName]:
    """Makes patches by the first array of `MARKERS`, and names it; on points 0 means inside."""
    for name, blocks in _marker_arrays(grid):
        found = [each for each in by_number(blocks) if each[0]]
        highest = max(
            (level for level, *_ in found), default=0
        )  # edges beside faces have numbers of their own
        patches = gathered(
            (f"{name}_{number}", nodes) for level, number, nodes in found if level == highest
        )
        if patches:
            return name, patches
    return "", {}


def _marker_arrays(grid: Grid) -> Iterator[tuple[str, Iterable[Block]]]:
    for name in _marker_names(grid.cell_data):
        yield name, grid.of_blocks(grid.cell_data[name])
    for name in _marker_names(grid.point_data):
        nodes = np.arange(len(grid.points))
        values = np.asarray(grid.point_data[name])
        if values.ndim == 1:
            yield name, [(1, nodes[values != 0], values[values != 0])]


def by_number(blocks: Iterable[Block]) -> Iterator[tuple[int, int, np.ndarray]]:
    """Yields dimension, number and nodes of blocks whose values are whole numbers."""
    for level, ids, values in blocks:
        values = np.asarray(values)
        if values.ndim == 1 and (values == np.floor(values)).all():
            for number in np.unique(values).tolist():
                yield level, int(number), ids[values == number].ravel()


def _left(grid: Grid, taken: str) -> Iterator[str]:
    """Yields sentences on sets of cells of full dimension, and on numbers that are no patches.
    `taken` is the array that has become patches.
    """
    solid = {
        name: [part for *_, part in grid.of_blocks(parts, full=True)]
        for name, parts in grid.cell_sets.items()
    }
    yield from regions_note(
        name for name, parts in solid.items() if name != BOUNDING and any(map(_has_some, parts))
    )
    for what, name, parts in _arrays(grid):
        numbers = _numbers(list(map(np.asarray, parts)))
        if not numbers or name in (taken, *GROUPS, "gmsh:geometrical") or name.startswith(PREFIX):
            continue
        listed = ", ".join(map(str, numbers[:SHOWN])) + " ..." * (len(numbers) > SHOWN)
        way = " They are where it is called patch and nothing else names patches." * (
            what != "cells"
        )
        yield f"the array {name} numbers {what} ({listed}): these are no patches.{way}"


def _arrays(grid: Grid) -> Iterator[tuple[str, str, list[Any]]]:
    for name, values in grid.point_data.items():
        yield "nodes", name, [values]
    for name, values in grid.cell_data.items():
        yield "faces", name, [value for *_, value in grid.of_blocks(values)]
        if name.lower() in MARKERS:
            yield "cells", name, [value for *_, value in grid.of_blocks(values, full=True)]


def _has_some(members: Any) -> bool:
    return members is not None and np.size(members) > 0


def _numbers(parts: list[np.ndarray]) -> list[int]:
    if not parts or any(values.ndim != 1 or values.dtype.kind not in "iu" for values in parts):
        return []
    values = np.concatenate(parts)
    numbers = np.unique(values).tolist()
    return numbers if any(numbers) and len(numbers) < max(len(values), 2) else []


def regions_note(names: Iterable[str]) -> Iterator[str]:
    listed = ", ".join(dict.fromkeys(names))
    if listed:
        yield f"regions, sets of cells, are no patches and move as one mesh: {listed}."


def _marker_names(arrays: Arrays) -> list[str]:
    return sorted(
        (name for name in arrays if name.lower() in MARKERS),
        key=lambda name: MARKERS.index(name.lower()),
    )


def checked_parts(
    points: Any,
    cells: Mapping[str, Any] | None,
    patches: Mapping[str, Any] | None,
    source: Any = None,
) -> Parts:
    points = floats(points)
    ids = {}
    names = {}
    for kind, corners in sorted(
        (cells or {}).items(), key=lambda item: canonical_type(item[0])
    ):  # as JAX sorts keys
        canonical = canonical_type(kind)
        if canonical in names:
            twice = ", ".join(sorted((kind, names[canonical])))
            raise ValueError(f"cells of one type have several names ({twice}): join them.")
        ids[canonical] = freeze(ids_of(kind, corners))
        names[canonical] = kind
    nodes = {
        name: freeze(np.unique(ids_of(name, members))) for name, members in (patches or {}).items()
    }
    _check_parts(points, ids, nodes)
    return Parts(points, ids, nodes, source)


def _check_parts(points: Any, cells: Mapping[str, Any], patches: Mapping[str, Any]) -> None:
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise ValueError(f"`points` has shape {points.shape}; expected (n, 2) or (n, 3).")
    n = points.shape[0]
    for kind, corners in cells.items():
        if corners.ndim != 2 or corners.shape[1] != NODES[kind]:
            raise ValueError(
                f"cells of type {kind!r} have shape {corners.shape}; expected (k, {NODES[kind]})."
            )
    for name, ids in {**cells, **patches}.items():
        low = ids.min(initial=0)
        high = ids.max(initial=-1)
        if low < 0 or high >= n:
            bad = high if high >= n else low
            raise ValueError(
                f"{name!r} names node {bad}, but the mesh has {n} points (0 to {n - 1})."
            )


def floats(points) -> Any:
    """Returns coordinates as read-only floats; a JAX array stays one: quality traces through it."""
    if isinstance(points, np.ndarray) or not has_type(points):
        return freeze(native_order(real_array("points", points, (None, 2), (None, 3))))
    if points.dtype.kind not in "fiuV":  # JAX's short floats have no letter of their own
        raise ValueError(f"`points` holds {points.dtype}; coordinates are real numbers.")
    return points.astype(float) if points.dtype.kind in "iu" else points


def ids_of(name: str, values: Any) -> np.ndarray:
    ids = np.asarray(values)
    if ids.size == 0:
        return ids.astype(np.int64)
    if ids.dtype.kind not in "iu":
        mask = "; for a mask use np.flatnonzero" if ids.dtype == bool else ""
        raise ValueError(f"{name!r} takes ids, whole numbers, not {ids.dtype}{mask}.")
    return native_order(ids) if ids.dtype.kind == "i" else ids.astype(np.int64)
