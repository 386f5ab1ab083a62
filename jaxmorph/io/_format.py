"""File formats, the source of a mesh in a file, and what the file holds of the mesh's points."""

import contextlib
import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray

from jaxmorph import Mesh
from jaxmorph._boundary.periodic import Periodic
from jaxmorph._host.cells.pieces import owned_sides
from jaxmorph._host.cells.topology import CORNERS, EDGES, SHAPES
from jaxmorph._host.package.errors import place_of, warn
from jaxmorph._host.rows import join_ids
from jaxmorph._mesh.exchange import Grid, Parts, Patch, checked_parts, intact_source, parts
from jaxmorph._mesh.polyhedra import Polyhedra

LOST_SHARE = 0.1
"""Share of the motion, or of an edge, that rounding may take without a warning."""

MOST_NAMED = 12
"""Names that a note lists."""

EVERYTHING = ((slice(None), slice(None)),)
"""The `singles` of a file in single precision."""

ArraysByName = Mapping[str, ndarray]


def warn_of_loss(path: Path, cells: Mapping[str, Any], held: Any, points: ndarray) -> ndarray:
    """Computes what the file holds of moved points (n, d); warns where rounding takes much."""
    values = np.array(held.in_file(points), float)
    for place in held.singles:
        values[place] = values[place].astype(np.float32)
    stored = held.in_mesh(values)
    if not held.singles:
        return stored
    base = held.in_mesh(held.points)
    off, motion = (np.linalg.norm(change, axis=1) for change in (stored - points, points - base))
    most = motion.max(initial=0.0)
    losses = []
    # far from the origin nodes that hardly move are rounded more, and that changes nothing there
    if (off[motion >= most / 2] > LOST_SHARE * most).any():
        losses.append(f"more than a tenth of the motion, which is {most:.3g}")
    start, end = _changed_edges(cells, base, points.astype(float), stored)
    if len(start):
        length = np.linalg.norm(points[end] - points[start], axis=1)
        place = place_of(points[start[length.argmin()]])
        losses.append(
            f"more than a tenth of {len(start)} edges of cells, the shortest {length.min():.3g} "
            f"near ({place})"
        )
    if losses:
        warn(
            f"{path}: the file holds single precision. Rounding moves nodes by up to "
            f"{off.max():.3g}: {', and '.join(losses)}. "
            "Write another format, such as .vtu or .su2, or begin with a file in double precision."
        )
    return stored


def _changed_edges(
    cells: Mapping[str, Any], base: ndarray, points: ndarray, stored: ndarray
) -> ndarray:
    """Finds edges (2, k) that rounding changes by much, but those without a length in the file."""
    found = [np.zeros((0, 2), int)]
    for kind, ids in cells.items():
        for edge in EDGES[SHAPES[kind]]:
            ends = np.sort(np.asarray(ids)[:, edge], axis=1)
            old, new, in_file = (np.diff(x[ends], axis=1)[:, 0] for x in (base, points, stored))
            change, length = (np.linalg.norm(x, axis=1) for x in (in_file - new, new))
            found.append(ends[(change > LOST_SHARE * length) & old.any(axis=1)])
    return np.unique(np.concatenate(found), axis=0).T


@dataclasses.dataclass(frozen=True, eq=False)
class Source:
    """The file that a mesh was read from, and the `content` that restores it.

    Compared by identity: a static field of a pytree may be of any size.

    - `polyhedra`, `cell_ids`, `groups`, `between`, `file_nodes`: as in `Mesh`.
    - `periodic`, `symmetry`, `kinds`: periodic pairs of patches, patches in symmetry planes, and
      the type of each patch.
    - `node_ids` (n,): numbers of the nodes in other files, None for 0, 1, 2, ...
    - `labels` (n,): the file's own numbers of the nodes, None where they count from 0.
    - `in_file`: takes points (n, d) of the mesh to points (N, 3) of the file; None where a mesh has
      the nodes of its file.
    - `held`: the content, where the file does not keep all digits of the points, else None. Its
      `in_file` and `in_mesh` take points to the file's and back. Of its `points`, those of the
      file, rows and columns `singles` are in single precision.
    - `cells`: numbers of the file's cells by type, by which changed cells are seen; None: unknown.
    - `notes`: sentences on what of the file is not in the mesh, or has another name there.
    - `origin`: the content of a file whose cells were replaced, of which a new one may be made.
    """

    path: Path
    format: str
    content: Any
    polyhedra: Polyhedra | None = None
    cell_ids: ndarray | None = None
    groups: Mapping[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)
    periodic: tuple[Periodic, ...] = ()
    between: ndarray | None = None
    node_ids: ndarray | None = None
    labels: ndarray | None = None
    symmetry: tuple[str, ...] = ()
    kinds: Mapping[str, str] = dataclasses.field(default_factory=dict)
    file_nodes: ndarray | None = None
    in_file: Callable[[ndarray], ndarray] | None = None
    held: Any = None
    cells: Mapping[str, int] | None = None
    notes: tuple[str, ...] = ()
    origin: Any = None

    def __repr__(self) -> str:
        return f"Source({str(self.path)!r}, {self.format})"

    @property
    def of_new_cells(self) -> "Source":
        """The source of a mesh of other cells: what the file says of patches is known."""
        return Source(
            self.path,
            self.format,
            None,
            groups=self.groups,
            periodic=self.periodic,
            symmetry=self.symmetry,
            kinds=self.kinds,
            origin=self.content if self.origin is None else self.origin,
        )


MeshLike = Mesh | Parts
"""What a format writes."""


def source_of(mesh: MeshLike, format_name: str) -> Source | None:
    source = intact_source(mesh)
    is_of_format = (
        isinstance(source, Source) and source.format == format_name and source.content is not None
    )
    return source if is_of_format else None


def content_of(mesh: MeshLike, format_name: str) -> Any:
    return getattr(source_of(mesh, format_name), "content", None)


def own_source(mesh: MeshLike, format_name: str) -> Source:
    """Returns the source of a mesh, for a format whose files are copies of the file that was read.

    Raises `ValueError` for other meshes, and for a file of copies that has changed since.
    """
    source = source_of(mesh, format_name)
    if source is None:
        raise ValueError(only_of(format_name, ".su2" if {*mesh.cells} <= {*CORNERS} else ".msh"))
    if not getattr(source.content, "is_current", True):
        raise ValueError(
            f"{source.path} has changed since the mesh was read from it; read it again."
        )
    return source


def only_of(format_name: str, other: str) -> str:
    article = "a" if format_name in ("Fluent", "Fluent HDF5", "CGNS", "MED", "PLOT3D") else "an"
    what = "OpenFOAM case" if format_name == "OpenFOAM" else f"{format_name} file"
    return (
        f"only a mesh that was read from {article} {what} can be written to one; write .vtu or "
        f"{other}."
    )


def check_form(path: Path, mesh: MeshLike, name: str, form_of: Callable[[Path], str]) -> None:
    """Refuses a path by whose name numbers are written otherwise than in the file that was read."""
    own = own_source(mesh, name).path
    if form_of(path) != form_of(own):
        raise ValueError(
            f"only a mesh that was read from a file of this form can be written to one; end it as "
            f"{own.name} ends, or write .vtu or .msh."
        )


def note_unread(what: str, names: Iterable[str]) -> tuple[str, ...]:
    """Makes a note on sections of a file that no mesh has, if there are any."""
    listed = [*names]
    more = f" and {len(listed) - MOST_NAMED} more" if len(listed) > MOST_NAMED else ""
    text = f"{what}{', '.join(listed[:MOST_NAMED])}{more} are not read, and stay in the file."
    return (text,) if listed else ()


@contextlib.contextmanager
def faults_of(path: Path) -> Iterator[None]:
    """Puts the path before what is wrong with a file, where it does not stand there already."""
    try:
        yield
    except ValueError as error:
        raise (
            error if str(error).startswith(str(path)) else ValueError(f"{path}: {error}")
        ) from error


def of_grid(
    path: Path,
    name: str,
    content: "FilePoints",
    grid: Grid,
    patches: Iterable[Patch] = (),
    notes: Iterable[str] = (),
    **known: Any,
) -> Parts:
    """Makes a mesh of a grid whose points are those of a file; `known` are fields of its source."""
    source = Source(path, name, content, **content.known, **known)
    with faults_of(path):
        points, cells, found, origin = parts(grid, patches)
        notes = (*notes, *origin.notes)
        return checked_parts(points, cells, found, dataclasses.replace(source, notes=notes))


@dataclasses.dataclass(frozen=True, eq=False)
class FilePoints:
    """The points (N, k) of a file, of which a 2-D mesh has no z.

    - `node` (N,): the mesh's node for each of them; None where the mesh has the nodes of the file.
    - `singles`: rows and columns of `points` that the file has in single precision.
    """

    points: ndarray
    _: dataclasses.KW_ONLY
    node: ndarray | None = None
    singles: Sequence[tuple[slice, Any]] = ()

    @property
    def is_flat(self) -> bool:
        return self.points.shape[1] == 2 or bool(np.ptp(self.points[:, 2]) == 0)

    @property
    def _first(self) -> Any:
        return slice(None) if self.node is None else np.unique(self.node, return_index=True)[1]

    def in_file(self, points: ndarray) -> ndarray:
        """Returns the file's points from the mesh's; all copies of an unmoved one stay as read."""
        d = points.shape[1]
        rows = slice(None) if self.node is None else self.node
        stays = (points == self.points[self._first, :d].astype(points.dtype))[rows]
        moved = np.where(stays, self.points[:, :d], points[rows])
        return np.concatenate([moved, self.points[:, d:]], axis=1)

    def in_mesh(self, values: ndarray) -> ndarray:
        """Returns the mesh's points from the file's, without z where all z are equal."""
        return values[self._first, : 2 if self.is_flat else 3]

    def moved(self, points: ndarray) -> Iterator[bytes | bytearray | memoryview]:
        """Yields the bytes of the file with other points of the mesh."""
        raise NotImplementedError

    def write(self, path: Path, points: ndarray) -> None:
        with path.open("wb") as file:
            file.writelines(self.moved(points))

    @property
    def known(self) -> dict[str, Any]:
        """Fields of the source of a mesh with these points in its file."""
        return {
            "in_file": self.in_file,
            "file_nodes": self.node,
            "held": self if self.singles else None,
        }


def patch_faces(mesh: MeshLike) -> dict[str, dict[str, ndarray]]:
    """Finds the boundary faces of each patch, by type: all nodes of the face are in the patch.

    A face that several patches could have (the one edge of an inlet between two walls of one patch)
    goes to the smallest. Raises `ValueError` for a patch with nodes that none of its faces holds.
    """
    n = mesh.points.shape[0]
    found = {}
    cells = {kind: np.asarray(ids) for kind, ids in mesh.cells.items()}
    sides = owned_sides(cells, n, np.unique(join_ids(mesh.patches.values())))
    left = {kind: faces for kind, (faces, _) in sides.items()}
    for name, nodes in sorted(mesh.patches.items(), key=lambda item: len(item[1])):
        inside = np.zeros(n, bool)
        inside[nodes] = True
        is_own = {kind: inside[faces].all(axis=1) for kind, faces in left.items()}
        found[name] = {kind: faces[is_own[kind]] for kind, faces in left.items()}
        left = {kind: faces[~is_own[kind]] for kind, faces in left.items()}
        for faces in found[name].values():
            inside[faces] = False
        missing = np.flatnonzero(inside)
        if missing.size:
            raise ValueError(
                f"patch {name!r}: {missing.size} of {len(nodes)} nodes (first {missing[0]}) are "
                "on no boundary face of "
                "the patch, and this format keeps patches as faces. Drop the patch, or write "
                ".vtu, which keeps nodes."
            )
    return {name: found[name] for name in mesh.patches}
