"""CGNS, structured and unstructured: a copy of the file with other coordinates, rest untouched."""

import dataclasses
import pathlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from jaxmorph._boundary.periodic import Periodic
from jaxmorph._host.cells.pieces import boundary_faces
from jaxmorph._mesh.exchange import Parts, regions_note
from jaxmorph._mesh.faces import faces_of_cells, joined_faces
from jaxmorph._mesh.polyhedra import Polyhedra

from .._format import Arrays, MeshLike, Source, faults_of, stamp_of
from .._joined import Joined, Zones, join
from .._tree import opened, write_points
from .conditions import (
    Condition,
    Connection,
    conditions,
    connections,
    groups_of,
    kinds_of,
    left_interfaces,
    patches,
    symmetry_of,
)
from .zone import DIMENSION, TYPES, Block, Content, Ragged, Zone, children, data, word

NAME = "CGNS"
LEVEL = {TYPES[number]: dimension for number, dimension in DIMENSION.items()}


@dataclasses.dataclass(frozen=True, eq=False)
class _CGNSContent(Joined):
    """The way back to the nodes of the file, and marks by which a changed file is found."""

    stamp: tuple[int, int]


def read(path: pathlib.Path) -> Parts:
    """Reads all zones of one base; nodes where two zones meet are one.

    `patches` are the boundary conditions, by family, and the sides of periodic interfaces. Outer
    faces without either are the patch `unnamed`, `boundary` in a file without any.
    """
    path.open("rb").close()
    with opened(path) as file:
        zones, cells, pairs, singles, known = _zones(path, file)
    with faults_of(path):
        mesh, joined = join(zones)
        whole, ids = _whole(cells, joined.node)
        content = _CGNSContent(**vars(joined), stamp=stamp_of(path))
        known |= {"periodic": periodic_of(pairs, joined.is_flat), "symmetry": symmetry_of(known["kinds"])}
        known |= {"held": joined.held(singles)}
        source = Source(path, NAME, content, whole, ids, file_nodes=joined.node, in_file=joined.in_file, **known)
        return mesh._replace(source=source)


def write(path: pathlib.Path, mesh: MeshLike, point_data: Arrays, cell_data: Arrays) -> None:
    """Writes a copy of the file that the mesh was read from."""

    def put(file: Any, points: np.ndarray, old: np.ndarray) -> None:
        for zone in open_zones(path, file)[0]:
            rows = slice(zone.first, zone.first + zone.count)
            for axis, values in enumerate(zone.coordinates()):
                if not np.array_equal(points[rows, axis], old[rows, axis]):
                    values[...] = points[rows, axis].reshape(values.shape).astype(values.dtype)

    write_points(path, mesh, NAME, put)


def open_zones(path: pathlib.Path, file: Any) -> tuple[list[Zone], int]:
    """Lists the zones of the base of the highest dimension, and this dimension of its cells."""
    bases = [(name, base) for name, base in children(file, "CGNSBase_t") if any(children(base, "Zone_t"))]
    most = max((int(data(base)[0]) for _, base in bases), default=0)
    bases = [(name, base) for name, base in bases if int(data(base)[0]) == most]
    if len(bases) > 1:
        names = ", ".join(name for name, _ in bases)
        raise ValueError(f"{path}: {len(bases)} bases of {most}-D cells in this file ({names}); one is read.")
    zones, first = [], 0
    for name, group in (child for _, base in bases for child in children(base, "Zone_t")):
        kind = [word(child) for _, child in children(group, "ZoneType_t")]
        is_structured = kind[:1] in ([], ["Structured"])  # a zone that says nothing is structured
        sizes = np.atleast_2d(data(group))[0]
        shape = tuple(int(size) for size in (sizes if is_structured else sizes[:1]))
        zones.append(Zone(path, name, group, shape, is_structured, first))
        first += zones[-1].count
    if not zones:
        raise ValueError(f"{path}: no CGNS base with zones in this file.")
    return zones, most


def _zones(
    path: pathlib.Path, file: Any
) -> tuple[Zones, list[Content], list[tuple[str, str, Connection]], list[tuple[slice, int]], dict[str, Any]]:
    """Reads all zones.

    The last values are what is in single precision, and the patches' `kinds`, `groups` and `notes`.
    """
    zones, dimension = open_zones(path, file)
    points, singles = [], []
    for zone in zones:
        columns = [values[()].ravel() for values in zone.coordinates()]
        points.append(np.stack(columns, axis=1).astype(float))
        rows = slice(zone.first, zone.first + zone.count)
        singles += [(rows, axis) for axis, values in enumerate(columns) if values.dtype.itemsize < 8]
    contents = [zone.cells(places) for zone, places in zip(zones, points, strict=True)]
    levels = [LEVEL[block.kind] for content in contents for block in content.blocks if len(block.corners)]
    notes = list(_other_bases(file, dimension))
    if max(levels, default=0) == 2 < dimension:  # a surface alone in a base of volumes
        dimension = 2
    of_zones, said = conditions(zones)
    of_patch, faces, regions = {}, [], []
    for at, zone in enumerate(zones):
        blocks = [block for block in contents[at].blocks if LEVEL[block.kind] == dimension and len(block.corners)]
        if not blocks:
            raise zone.error(f"no cells of {dimension} dimensions")
        contents[at] = dataclasses.replace(contents[at], blocks=blocks, dimension=dimension)
        for name, nodes in patches(zone, contents[at], of_zones[zone.name]):
            if nodes is None:
                regions.append(name)
                continue
            of_patch.setdefault(name, []).append(nodes)
        faces += contents[at].sides or _outer(zone, points[at], blocks)
    several = [condition for of_zone in of_zones.values() for condition in of_zone]
    notes += [*said, *regions_note(regions), *_left(zones, contents, of_patch, several)]
    pairs = pairs_of(zones, contents, of_patch)
    cells = [(block.kind, block.corners) for content in contents for block in content.blocks]
    kinds = {name: kind for name, kind in kinds_of(file, several).items() if name in of_patch}
    known = {"kinds": kinds, "groups": groups_of(file, several, of_patch), "notes": tuple(notes)}
    return Zones(np.concatenate(points), cells, of_patch, faces), contents, pairs, singles, known


def _other_bases(file: Any, dimension: int) -> Iterator[str]:
    for name, base in children(file, "CGNSBase_t"):
        if any(children(base, "Zone_t")) and int(data(base)[0]) < dimension:
            yield f"the base {name} of {int(data(base)[0])}-D cells is not read, and stays in the file."


def _left(
    zones: list[Zone], contents: list[Content], patches: dict[str, list[np.ndarray]], several: list[Condition]
) -> Iterator[str]:
    """Yields sentences on sections beyond all conditions, interfaces and coordinates not read."""
    donors = {zone.name: (zone, content) for zone, content in zip(zones, contents, strict=True)}
    inside = np.zeros(sum(zone.count for zone in zones), bool)
    for nodes in patches.values():
        inside[np.concatenate(nodes)] = True
    sections, interfaces = {}, []
    for zone, content in donors.values():
        interfaces += left_interfaces(zone, donors)
        for section in content.elements.values():
            nodes = section.vertices.values if isinstance(section.vertices, Ragged) else section.vertices
            if several and section.dimension == content.dimension - 1 and not inside[nodes].all():
                sections[section.section] = None
    steps = [zone.name for zone in zones if len(list(children(zone.group, "GridCoordinates_t"))) > 1]
    if steps:
        yield f"of several GridCoordinates of the zones {', '.join(steps)} the first are read, and moved."
    if sections:
        yield f"no boundary condition has all faces of the sections {', '.join(sections)}: they are in unnamed."
    if interfaces:
        yield f"interfaces without equal nodes on both sides are not read: {', '.join(interfaces)}."


def pairs_of(
    zones: list[Zone], contents: list[Content], patches: dict[str, list[np.ndarray]]
) -> list[tuple[str, str, Connection]]:
    """Adds the sides of periodic interfaces to the patches, and lists their names in pairs."""
    donors = {zone.name: (zone, content) for zone, content in zip(zones, contents, strict=True)}
    every = [(zone, interface) for zone in zones for interface in connections(zone, donors)]
    names, pairs = [], []
    for zone, interface in every:
        is_taken = interface.name in patches or sum(interface.name == other.name for _, other in every) > 1
        names.append(f"{zone.name}/{interface.name}" if is_taken else interface.name)
        patches[names[-1]] = [interface.nodes]
    for (_, interface), name in zip(every, names, strict=True):
        partner = [
            n for (_, other), n in zip(every, names, strict=True) if np.array_equal(other.nodes, interface.others)
        ]
        if not partner:
            partner = [f"{name} donor"]
            patches[partner[0]] = [interface.others]
        if not any({name, partner[0]} == {first, second} for first, second, _ in pairs):
            pairs.append((name, partner[0], interface))
    return pairs


def periodic_of(pairs: list[tuple[str, str, Connection]], is_flat: bool) -> tuple[Periodic, ...]:
    """Makes periodic pairs of interfaces.

    Translation or angle is that of the nodes, for files differ in its sign.
    """
    made = []
    for first, second, interface in pairs:
        turns = bool(interface.angles.any())
        about = np.pad(interface.centre, (0, 3))[: 2 if is_flat else 3] if turns else None
        made.append(Periodic(first, second, about=about, axis=interface.angles if turns and not is_flat else None))
    return tuple(made)


def _whole(zones: list[Content], node: np.ndarray) -> tuple[Polyhedra, np.ndarray] | tuple[None, None]:
    """Joins all zones' cells where some are cut; with each cell's number, types as in the mesh."""
    if not any(zone.whole is not None and len(zone.whole.cut) for zone in zones):
        return None, None
    parts, cut, ids, first = [], [np.zeros(0, np.int64)], {}, 0
    for zone in zones:
        start = first
        if zone.whole is not None:
            faces = zone.whole.faces
            neighbour = np.where(faces.neighbour < 0, -1, faces.neighbour + start)
            parts.append(dataclasses.replace(faces, owner=faces.owner + start, neighbour=neighbour))
            cut.append(zone.whole.cut + start)
            first += int(max(faces.owner.max(), faces.neighbour.max())) + 1
        for block in zone.blocks:
            if block.cell is None:
                cell = first + np.arange(len(block.corners))
                parts.append(faces_of_cells(block.kind, block.corners, cell))
                first += len(cell)
            else:
                cell = start + block.cell
            ids.setdefault(block.kind, []).append(cell)
    faces = joined_faces([dataclasses.replace(part, labels=node[part.labels]) for part in parts])
    return Polyhedra(faces, np.concatenate(cut)), np.concatenate(
        [numbers for kind in sorted(ids) for numbers in ids[kind]]
    )


def _outer(zone: Zone, points: np.ndarray, blocks: list[Block]) -> list[np.ndarray]:
    """Finds the outer faces of an unstructured zone."""
    cells: dict[str, list[np.ndarray]] = {}
    for block in blocks:
        cells.setdefault(block.kind, []).append(block.corners - zone.first)
    alone = {kind: np.concatenate(parts) for kind, parts in cells.items()}
    return [corners + zone.first for corners in boundary_faces(alone, len(points)).values()]
