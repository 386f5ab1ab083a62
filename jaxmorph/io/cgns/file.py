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
from .._joined import Zones, join
from .._tree import Coordinates, opened, points_of, singles_of, write_points
from .conditions import (
    SYMMETRY,
    Connection,
    connections,
    groups_of,
    kinds_of,
    left_interfaces,
    patches,
    read_conditions,
)
from .zone import DIMENSION, TYPES, Ragged, Zone, children, data, word

NAME = "CGNS"
LEVEL = {TYPES[number]: dimension for number, dimension in DIMENSION.items()}


def read(path: pathlib.Path) -> Parts:
    """Reads all zones of one base; nodes where two zones meet are one.

    `patches` are the boundary conditions, by family, and the sides of periodic interfaces. Other
    outer faces are the patch `unnamed`, `boundary` in a file without any.
    """
    with opened(path) as file:
        zones, dimension = open_zones(path, file)
        coordinates = [each for zone in zones for each in zone.coordinates()]
        n, d = zones[-1].rows.stop, max(each.columns.stop for each in coordinates)
        points, singles = points_of(coordinates, n, d), singles_of(coordinates)
        notes = [*_other_bases(file, dimension), *_read_cells(zones, dimension, points), *read_conditions(zones)]
        of_patch, faces, regions = _patches(zones)
        found = [each for zone in zones for each in connections(zone, {other.name: other for other in zones})]
        notes += [*regions_note(regions), *_left(zones, found, of_patch)]
        pairs = _pairs(found, of_patch)
        conditions = [condition for zone in zones for condition in zone.conditions]
        kinds = {name: kind for name, kind in kinds_of(file, conditions).items() if name in of_patch}
        known = {"kinds": kinds, "groups": groups_of(file, conditions, of_patch), "notes": tuple(notes)}
    cells = [(block.kind, block.corners) for zone in zones for block in zone.content.blocks]
    with faults_of(path):
        mesh, joined = join(Zones(points, cells, of_patch, faces))
        content = dataclasses.replace(joined, stamp=stamp_of(path))
        known |= {"periodic": tuple(_periodic(*pair, joined.is_flat) for pair in pairs)}
        known |= {"symmetry": tuple(patch for patch, kind in kinds.items() if kind == SYMMETRY)}
        known |= {"in_file": content.in_file, "held": content.held(singles), "file_nodes": joined.node}
        return mesh._replace(source=Source(path, NAME, content, *_whole(zones, joined.node), **known))


def write(path: pathlib.Path, mesh: MeshLike, point_data: Arrays, cell_data: Arrays) -> None:
    def coordinates(file: Any) -> Iterator[Coordinates]:
        for zone in open_zones(path, file)[0]:
            yield from zone.coordinates()

    write_points(path, mesh, NAME, coordinates)


def open_zones(path: pathlib.Path, file: Any) -> tuple[list[Zone], int]:
    """Lists the zones of the base of the highest dimension, and this dimension of its cells."""
    bases = list(_bases(file))
    most = max((dimension for _, _, dimension in bases), default=0)
    bases = [(name, base) for name, base, dimension in bases if dimension == most]
    if len(bases) > 1:
        names = ", ".join(name for name, _ in bases)
        raise ValueError(f"{path}: {len(bases)} bases of {most}-D cells in this file ({names}); one is read.")
    zones, first = [], 0
    for name, group in (child for _, base in bases for child in children(base, "Zone_t")):
        kind = next((word(child) for _, child in children(group, "ZoneType_t")), "Structured")
        sizes = np.atleast_2d(data(group))[0]
        shape = tuple(int(size) for size in (sizes if kind == "Structured" else sizes[:1]))
        zones.append(Zone(path, name, group, shape, kind == "Structured", first))
        first += zones[-1].count
    if not zones:
        raise ValueError(f"{path}: no CGNS base with zones in this file.")
    return zones, most


def _bases(file: Any) -> Iterator[tuple[str, Any, int]]:
    for name, base in children(file, "CGNSBase_t"):
        if any(children(base, "Zone_t")):
            yield name, base, int(data(base)[0])


def _read_cells(zones: list[Zone], dimension: int, points: np.ndarray) -> Iterator[str]:
    contents = [zone.cells(points[zone.rows]) for zone in zones]
    levels = [LEVEL[block.kind] for content in contents for block in content.blocks if len(block.corners)]
    if max(levels, default=0) == 2 < dimension:  # a surface alone in a base of volumes
        dimension = 2
    for zone, content in zip(zones, contents, strict=True):
        blocks = [block for block in content.blocks if LEVEL[block.kind] == dimension and len(block.corners)]
        if not blocks:
            raise zone.error(f"no cells of {dimension} dimensions")
        zone.content = dataclasses.replace(content, blocks=blocks, dimension=dimension)
    steps = [zone.name for zone in zones if len(list(children(zone.group, "GridCoordinates_t"))) > 1]
    if steps:
        yield f"of several GridCoordinates of the zones {', '.join(steps)} the first are read, and moved."


def _patches(
    zones: list[Zone],
) -> tuple[dict[str, list[np.ndarray]], list[np.ndarray], list[str]]:
    of_patch, faces, regions = {}, [], []
    for zone in zones:
        for name, nodes in patches(zone):
            if nodes is None:
                regions.append(name)
            else:
                of_patch.setdefault(name, []).append(nodes)
        faces += zone.content.sides or _outer(zone)
    return of_patch, faces, regions


def _other_bases(file: Any, dimension: int) -> Iterator[str]:
    for name, _, level in _bases(file):
        if level < dimension:
            yield f"the base {name} of {level}-D cells is not read, and stays in the file."


def _left(zones: list[Zone], found: list[Connection], patches: dict[str, list[np.ndarray]]) -> Iterator[str]:
    inside = np.zeros(zones[-1].rows.stop, bool)
    for nodes in patches.values():
        inside[np.concatenate(nodes)] = True
    sections = {}
    for zone in zones if any(zone.conditions for zone in zones) else ():
        for section in zone.content.elements.values():
            nodes = section.vertices.values if isinstance(section.vertices, Ragged) else section.vertices
            if section.dimension == zone.content.dimension - 1 and not inside[nodes].all():
                sections[section.section] = None
    if sections:
        yield f"no boundary condition has all faces of the sections {', '.join(sections)}: they are in unnamed."
    interfaces = [name for zone in zones for name in left_interfaces(zone, found)]
    if interfaces:
        yield f"interfaces without equal nodes on both sides are not read: {', '.join(interfaces)}."


def _pairs(found: list[Connection], patches: dict[str, list[np.ndarray]]) -> list[tuple[str, str, Connection]]:
    names: list[str] = []
    for interface in found:
        is_taken = interface.name in patches or sum(interface.name == other.name for other in found) > 1
        names.append(f"{interface.zone}/{interface.name}" if is_taken else interface.name)
        patches[names[-1]] = [interface.nodes]
    pairs: dict[frozenset[str], tuple[str, str, Connection]] = {}
    for name, interface in zip(names, found, strict=True):
        of_nodes = (n for n, other in zip(names, found, strict=True) if np.array_equal(other.nodes, interface.others))
        partner = next(of_nodes, None)
        if partner is None:
            partner = f"{name} donor"
            patches[partner] = [interface.others]
        pairs.setdefault(frozenset((name, partner)), (name, partner, interface))
    return list(pairs.values())


def _periodic(first: str, second: str, interface: Connection, is_flat: bool) -> Periodic:
    """Makes a pair of an interface. Files differ in the sign of shifts and angles; nodes tell."""
    if not interface.angles.any():
        return Periodic(first, second)
    about = np.pad(interface.centre, (0, 3))[: 2 if is_flat else 3]
    return Periodic(first, second, about=about, axis=None if is_flat else interface.angles)


def _whole(zones: list[Zone], node: np.ndarray | None) -> tuple[Polyhedra, np.ndarray] | tuple[None, None]:
    """Joins all zones' cells where some are cut; with each cell's number, types as in the mesh."""
    if not any(zone.content.whole is not None and len(zone.content.whole.cut) for zone in zones):
        return None, None
    parts, cut, ids, first = [], [np.zeros(0, np.int64)], {}, 0
    for zone in zones:
        start, whole = first, zone.content.whole
        if whole is not None:
            faces = whole.faces
            neighbour = np.where(faces.neighbour < 0, -1, faces.neighbour + start)
            parts.append(dataclasses.replace(faces, owner=faces.owner + start, neighbour=neighbour))
            cut.append(whole.cut + start)
            first += int(max(faces.owner.max(), faces.neighbour.max())) + 1
        for block in zone.content.blocks:
            if block.cell is None:
                cell = first + np.arange(len(block.corners))
                parts.append(faces_of_cells(block.kind, block.corners, cell))
                first += len(cell)
            else:
                cell = start + block.cell
            ids.setdefault(block.kind, []).append(cell)
    faces = joined_faces(
        [dataclasses.replace(part, labels=part.labels if node is None else node[part.labels]) for part in parts]
    )
    numbers = np.concatenate([numbers for kind in sorted(ids) for numbers in ids[kind]])
    return Polyhedra(faces, np.concatenate(cut)), numbers


def _outer(zone: Zone) -> list[np.ndarray]:
    cells: dict[str, list[np.ndarray]] = {}
    for block in zone.content.blocks:
        cells.setdefault(block.kind, []).append(block.corners - zone.first)
    alone = {kind: np.concatenate(parts) for kind, parts in cells.items()}
    return [corners + zone.first for corners in boundary_faces(alone, zone.count).values()]
