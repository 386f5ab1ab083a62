"""gmsh's .msh, versions 1, 2, 4.0, 4.1, text and binary: written back by replacing coordinates."""

import dataclasses
import pathlib
from collections.abc import Iterator

import numpy as np

from jaxmorph._host.cells.orders import GMSH, reordered
from jaxmorph._host.cells.topology import DIMENSION
from jaxmorph._mesh.exchange import LEVELS, Grid, Parts, Patch, gathered, regions_note

from .._format import FilePoints, MeshLike, Source, content_of, faults_of, of_grid, patch_faces
from .._text import Section, replaced
from .sections import (
    TYPES,
    Elements,
    Form,
    Groups,
    Names,
    Stream,
    elements,
    entities,
    form_of,
    nodes,
    physical_names,
    sections,
    triples,
)

NAME = "gmsh"
NODES, ELEMENTS = ("Nodes", "ParametricNodes", "NOD"), ("Elements", "ELM")
"""Sections of nodes and of elements; the last name of each is from version 1."""
NUMBERS = {kind: number for number, kind in TYPES.items()}
SPARSE = 10
"""Range of the tags of nodes, in numbers of nodes, up to which a table of them is made."""


@dataclasses.dataclass(frozen=True, eq=False)
class _GmshContent(FilePoints):
    """A file's points, its section of nodes, and the place of each node's x, see `Stream`."""

    section: Section
    form: Form
    places: np.ndarray

    def moved(self, points: np.ndarray) -> Iterator[bytes | bytearray | memoryview]:
        data = self.section.text
        if self.form.is_text:
            words = (self.places[:, None] // 8 + np.arange(3)).ravel()
            return replaced(data, slice(self.section.start, self.section.stop), points.ravel(), at=words)
        copy = bytearray(data)
        triples(copy)[self.places] = points.astype(self.form.types["d"]).view("V24").ravel()
        return iter([copy])


@dataclasses.dataclass
class _Found:
    form: Form
    names: Names = dataclasses.field(default_factory=dict)
    groups: Groups = dataclasses.field(default_factory=dict)
    tags: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0, np.int64))
    content: _GmshContent | None = None
    cells: list[Elements] = dataclasses.field(default_factory=list)
    others: dict[str, None] = dataclasses.field(default_factory=dict)

    def take(self, name: str, section: Section) -> None:
        if name == "PhysicalNames":
            self.names = physical_names(section, self.form)
        elif name in ("Entities", "PartitionedEntities") and self.form.version >= 4:
            stream = Stream(section, self.form, np.float64)
            self.groups |= entities(stream, is_partitioned=name == "PartitionedEntities")
        elif name in NODES:
            if self.content is not None:
                raise ValueError("a second one; gmsh adds a view without the mesh if PostProcessing.SaveMesh is 0")
            stream = Stream(section, self.form, np.float64)
            self.tags, places = nodes(stream, is_parametric=name == "ParametricNodes")
            points = triples(stream.data)[places].view(stream.types["d"]).reshape(-1, 3).astype(float)
            self.content = _GmshContent(points, section, self.form, places)
        elif name in ELEMENTS:
            self.cells = elements(Stream(section, self.form), self.groups)
        elif name not in ("MeshFormat", "Comments"):
            self.others[f"${name[:40]}"] = None


def read(path: pathlib.Path) -> Parts:
    """Reads points, cells and patches: the physical groups of lower dimension than the mesh.

    A group without a name is `physical_` and its tag. Of duplicate names the first of the highest
    dimension stays, others add their dimension and tag.
    """
    found = _read(path)
    content = found.content
    if content is None or not len(found.tags) or not found.cells:
        raise ValueError(f"{path}: no mesh, the file holds no $Nodes or no $Elements, or none in them.")
    with faults_of(path):
        cells = _numbered(found.cells, found.tags)
    groups = sorted(_groups(cells, found.names).items(), key=lambda item: -item[0][0])
    blocks = [(block.kind, reordered(block.kind, block.corners, GMSH, None)) for block in cells]
    top = max(DIMENSION.get(kind, 0) for kind, _ in blocks)
    notes = tuple(regions_note(patch.name for (level, _), patch in groups if level == top))
    notes += (f"sections {', '.join(found.others)} are not read, and stay in the file.",) * bool(found.others)
    source = Source(path, NAME, content, notes=notes, **content.known)
    patches = [patch for (level, _), patch in groups if level < top]
    return of_grid(path, Grid(content.points, blocks, {}, {}), source, patches)


def _read(path: pathlib.Path) -> _Found:
    data = path.read_bytes()
    found = _Found(form_of(path, data))
    for name, section in sections(path, data, found.form):
        try:
            found.take(name, section)
        except (ValueError, IndexError, OverflowError) as error:
            if str(path) in str(error):
                raise
            raise ValueError(f"{path}: not a .msh file, or a damaged one, in ${name[:40]} ({error}).") from error
    return found


def _numbered(cells: list[Elements], tags: np.ndarray) -> list[Elements]:
    """Replaces the tags of nodes by their places: by a table, by a search if tags are sparse."""
    # Either way a tag that is none gives some place, so the tag at the place is compared.
    least, most = int(tags.min()), int(tags.max())
    is_dense = most - least <= SPARSE * len(tags)
    order = np.argsort(tags)
    table = np.full(most - least + 1 if is_dense else 0, -1)
    if is_dense:
        table[tags - least] = np.arange(len(tags))
    numbered = []
    for block in cells:
        corners = np.clip(block.corners, least, most)
        ids = table[corners - least] if is_dense else order[np.searchsorted(tags, corners, sorter=order)]
        wrong = block.corners[(ids < 0) | (tags[ids] != block.corners)]
        if len(wrong):
            raise ValueError(f"a {block.kind} between nodes of which {wrong[0]} is none of the {len(tags)} in $Nodes.")
        numbered.append(dataclasses.replace(block, corners=ids))
    return numbered


def _groups(cells: list[Elements], names: Names) -> dict[tuple[int, int], Patch]:
    nodes = gathered(
        ((DIMENSION.get(block.kind, 0), tag), (block.corners if rows is None else block.corners[rows]).ravel())
        for block in cells
        for tag, rows in block.groups.items()
    )
    groups = {}
    for (level, tag), members in nodes.items():
        name = names.get((level, tag)) or names.get((None, tag)) or f"physical_{tag}"
        groups[level, tag] = Patch(name, f"{LEVELS[level]}_{tag}", members)
    return groups


def check(path: pathlib.Path, mesh: MeshLike) -> None:
    """Raises `ValueError` for patches that a new file cannot have.

    Boundary faces cannot express them, or their name ends before its end.
    """
    if content_of(mesh, NAME) is not None:
        return
    for name in mesh.patches:
        if any(mark in name for mark in '"\r\n') or not name:
            message = f"{path}: {name!r} cannot be the name of a physical group: empty, or with '\"' or a line break."
            raise ValueError(message)
    patch_faces(mesh)


def write(path: pathlib.Path, mesh: MeshLike) -> None:
    """Writes the mesh's own file with new coordinates; else a new binary file of version 2.2.

    In a new file a patch becomes a physical group, with the boundary faces between its nodes as
    elements.
    """
    content = content_of(mesh, NAME)
    with path.open("wb") as file:
        file.writelines(_new(mesh) if content is None else content.moved(content.in_file(np.asarray(mesh.points))))


def _new(mesh: MeshLike) -> Iterator[bytes]:
    """Yields a new file in pieces; an element has its group's tag as group and as entity."""
    points, markers = np.asarray(mesh.points, float), patch_faces(mesh)
    blocks = [(kind, 0, np.asarray(ids)) for kind, ids in mesh.cells.items()]
    names = []
    for tag, (name, faces) in enumerate(markers.items(), start=1):
        kinds = [kind for kind, corners in faces.items() if len(corners)]
        blocks += [(kind, tag, faces[kind]) for kind in kinds]
        names += [f'{DIMENSION[kinds[0]]} {tag} "{name}"\n'] if kinds else []
    yield b"$MeshFormat\n2.2 1 8\n" + np.array(1, "<i4").tobytes() + b"\n$EndMeshFormat\n"
    if names:
        yield f"$PhysicalNames\n{len(names)}\n{''.join(names)}$EndPhysicalNames\n".encode()
    rows = np.zeros(len(points), [("tag", "<i4"), ("x", "<f8", 3)])
    rows["tag"] = 1 + np.arange(len(points))
    rows["x"][:, : points.shape[1]] = points
    yield f"$Nodes\n{len(points)}\n".encode() + rows.tobytes() + b"\n$EndNodes\n"
    yield f"$Elements\n{sum(len(corners) for *_, corners in blocks)}\n".encode()
    first = 1
    for kind, tag, corners in blocks:
        table = np.full((len(corners), 3 + corners.shape[1]), tag, "<i4")
        table[:, 0] = first + np.arange(len(corners))
        table[:, 3:] = 1 + reordered(kind, corners, None, GMSH)
        yield np.array([NUMBERS[kind], len(corners), 2], "<i4").tobytes() + table.tobytes()
        first += len(corners)
    yield b"\n$EndElements\n"
