"""CGNS, structured and unstructured: a copy of the file with other coordinates, or a new file."""

import collections
import dataclasses
import functools
import itertools
import pathlib
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy import ndarray

from jaxmorph._boundary.periodic import Periodic
from jaxmorph._host.cells.pieces import outer_pieces
from jaxmorph._host.rows import Rows, join_ids
from jaxmorph._mesh.exchange import Parts, gathered, regions_note
from jaxmorph._mesh.faces import faces_of_cells, joined_faces
from jaxmorph._mesh.polyhedra import Polyhedra

from .._format import MeshLike, Source, content_of, faults_of, own_source
from .._joined import join_zones
from .._tree import Coordinates, TreePoints, open_tree
from .conditions import (
    Connection,
    describe_conditions,
    find_connections,
    find_patches,
    list_left_interfaces,
    name_patches,
)
from .new import check_new_file, new_file
from .zone import CGNS_DIMENSIONS, CGNS_TYPES, Zone, find_children, find_first, read_data, read_word

NAME = "CGNS"
PatchLists = dict[str, list[ndarray]]
LEVEL_OF_TYPE = {CGNS_TYPES[number]: dimension for number, dimension in CGNS_DIMENSIONS.items()}


def read(path: pathlib.Path) -> Parts:
    """Reads all zones of one base; nodes where two zones meet are one.

    `patches` are the boundary conditions, by family, and the sides of periodic interfaces. Other
    outer faces are the patch `unnamed`, `boundary` in a file without any.
    """
    with open_tree(path) as file:
        zones, dimension = open_zones(path, file)
        content = TreePoints.of(path, file, functools.partial(_find_zone_coordinates, path))
        _take_cells(zones, dimension, content.points)
        notes = [*_note_others(file, zones, dimension), *name_patches(zones)]
        of_patch, faces, regions = _gather_patches(zones)
        found = list(find_connections(zones))
        notes += [*regions_note(regions), *_note_sections(zones, found, of_patch)]
        pairs = _pair_connections(found, of_patch)
        known = describe_conditions(file, zones, of_patch)
    with faults_of(path):
        blocks = [block[:2] for zone in zones for block in zone.content.blocks]
        mesh, node = join_zones(content.points, blocks, of_patch, faces)
        content = dataclasses.replace(content, node=node)
        known |= {"notes": tuple(notes), **content.known}
        known |= {"periodic": tuple(_make_periodic(*pair, content.is_flat) for pair in pairs)}
        return mesh._replace(
            source=Source(path, NAME, content, *_join_polyhedra(zones, node), **known)
        )


def check(path: pathlib.Path, mesh: MeshLike) -> None:
    if content_of(mesh, NAME) is None:
        check_new_file(path, mesh)
    else:
        own_source(mesh, NAME)


def new(mesh: MeshLike) -> Iterator[bytes]:
    """Yields a new file; types of patches stay where they are of CGNS."""
    is_known = getattr(mesh.source, "format", "") == NAME
    yield from new_file(mesh, mesh.source.kinds if is_known else {})


def _find_zone_coordinates(path: pathlib.Path, file: Any) -> Iterator[Coordinates]:
    for zone in open_zones(path, file)[0]:
        yield from zone.coordinates()


def open_zones(path: pathlib.Path, file: Any) -> tuple[list[Zone], int]:
    """Lists the zones of the base of the highest dimension, and this dimension of its cells."""
    most = max((level for *_, level in _list_bases(file)), default=0)
    bases = {name: base for name, base, level in _list_bases(file) if level == most}
    if len(bases) > 1:
        raise ValueError(
            f"{path}: {len(bases)} bases of {most}-D cells in this file ({', '.join(bases)}); one "
            "is read."
        )
    zones = []
    start = 0
    for name, group in find_children(next(iter(bases.values()), {}), "Zone_t"):
        is_structured = read_word(find_first(group, "ZoneType_t"), "Structured") == "Structured"
        sizes = np.atleast_2d(read_data(group))[0]
        shape = tuple(map(int, sizes if is_structured else sizes[:1]))
        zones.append(Zone(path, name, group, shape, is_structured, start))
        start += zones[-1].count
    if not zones:
        raise ValueError(f"{path}: no CGNS base with zones in this file.")
    return zones, most


def _list_bases(file: Any) -> Iterator[tuple[str, Any, int]]:
    for name, base in find_children(file, "CGNSBase_t"):
        if any(find_children(base, "Zone_t")):
            yield name, base, int(read_data(base)[0])


def _take_cells(zones: list[Zone], dimension: int, points: ndarray) -> None:
    contents = [zone.cells(points[zone.rows]) for zone in zones]
    levels = {LEVEL_OF_TYPE[block.kind] for content in contents for block in content.blocks}
    if max(levels, default=0) == 2 < dimension:  # a surface alone in a base of volumes
        dimension = 2
    for zone, content in zip(zones, contents, strict=True):
        blocks = [block for block in content.blocks if LEVEL_OF_TYPE[block.kind] == dimension]
        if not blocks:
            raise zone.error(f"no cells of {dimension} dimensions")
        zone.content = content._replace(blocks=blocks, dimension=dimension)


def _gather_patches(zones: list[Zone]) -> tuple[PatchLists, list[ndarray], list[str]]:
    of_patch = {}
    faces = []
    regions = []
    for zone in zones:
        for name, nodes in find_patches(zone):
            if nodes is None:
                regions.append(name)
            else:
                of_patch.setdefault(name, []).append(nodes)
        alone = gathered(block[:2] for block in zone.content.blocks)
        faces += zone.content.sides or outer_pieces(alone, zone.rows.stop).values()
    return of_patch, faces, regions


def _note_others(file: Any, zones: list[Zone], dimension: int) -> Iterator[str]:
    for name, _, level in _list_bases(file):
        if level < dimension:
            yield f"the base {name} of {level}-D cells is not read, and stays in the file."
    steps = [
        zone.name for zone in zones if len(list(find_children(zone.group, "GridCoordinates_t"))) > 1
    ]
    if steps:
        names = ", ".join(steps)
        yield f"of several GridCoordinates of the zones {names} the first are read, and moved."


def _note_sections(
    zones: list[Zone], found: list[Connection], patches: PatchLists
) -> Iterator[str]:
    inside = Rows(join_ids(itertools.chain(*patches.values())))
    sections = itertools.chain(*(zone.outer_sections() for zone in zones))
    outside = [each.section for each in sections if not inside.mask(each.vertices.values).all()]
    if outside and any(zone.conditions for zone in zones):
        names = ", ".join(dict.fromkeys(outside))
        yield f"no boundary condition has all faces of the sections {names}: they are in unnamed."
    interfaces = list(itertools.chain(*(list_left_interfaces(zone, found) for zone in zones)))
    if interfaces:
        yield f"interfaces without equal nodes on both sides are not read: {', '.join(interfaces)}."


def _pair_connections(
    found: list[Connection], patches: PatchLists
) -> list[tuple[str, str, Connection]]:
    names = {}
    counts = collections.Counter(each.name for each in found)
    for each in found:
        is_taken = each.name in patches or counts[each.name] > 1
        name = f"{each.zone}/{each.name}" if is_taken else each.name
        names[each.nodes.tobytes()] = name
        patches[name] = [each.nodes]
    pairs: dict[frozenset[str], tuple[str, str, Connection]] = {}
    for each in found:
        name = names[each.nodes.tobytes()]
        partner = names.setdefault(each.others.tobytes(), f"{name} donor")
        patches.setdefault(partner, [each.others])
        pairs.setdefault(frozenset((name, partner)), (name, partner, each))
    return list(pairs.values())


def _make_periodic(first: str, second: str, interface: Connection, is_flat: bool) -> Periodic:
    """Makes a pair of an interface. Files differ in the sign of shifts and angles; nodes tell."""
    if not interface.angles.any():
        return Periodic(first, second)
    about = np.pad(interface.centre, (0, 3))[: 2 if is_flat else 3]
    return Periodic(first, second, about=about, axis=None if is_flat else interface.angles)


def _join_polyhedra(zones: list[Zone], node: Any) -> tuple[Polyhedra, ndarray] | tuple[None, None]:
    """Joins all zones' cells where some are cut; with each cell's number, types as in the mesh."""
    if not any(len(getattr(zone.content.whole, "cut", ())) for zone in zones):
        return None, None
    parts = []
    cut = []
    ids = []
    first = 0
    for zone in zones:
        start = first
        whole = zone.content.whole
        if whole is not None:
            parts.append(whole.faces.renumbered(start))
            cut.append(whole.cut + start)
            first += whole.faces.count
        for kind, corners, cell in zone.content.blocks:
            if cell is None:
                ids.append((kind, first + np.arange(len(corners))))
                parts.append(faces_of_cells(kind, corners, ids[-1][1]))
                first += len(corners)
            else:
                ids.append((kind, start + cell))
    faces = joined_faces([dataclasses.replace(part, labels=node[part.labels]) for part in parts])
    numbers = np.concatenate([cells for _, cells in sorted(gathered(ids).items())])
    return Polyhedra(faces, np.concatenate(cut)), numbers
