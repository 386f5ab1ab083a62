"""Boundary of a CGNS file: conditions, their types and families, and interfaces between zones."""

import collections
import contextlib
import itertools
from collections.abc import Collection, Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from jaxmorph._host.rows import join_ids

from .._joined import number_block
from .zone import Condition, Zone, find_children, find_first, read_data, read_word

NORMAL = {"IFaceCenter": 0, "JFaceCenter": 1, "KFaceCenter": 2}
SYMMETRY_TYPE = "BCSymmetryPlane"
UNSAID = ("", "Null", "FamilySpecified")
ONE_TO_ONE = "GridConnectivity1to1_t"
INTERFACES = (ONE_TO_ONE, "GridConnectivity_t", "OversetHoles_t")
CHOICES = ("PointRange", "PointList", "ElementRange", "ElementList")


class Interface(NamedTuple):
    """A zone's interface: its label and node, and the node that makes it periodic, or None."""

    label: str
    name: str
    node: Any
    turn: Any

    @property
    def choice(self) -> str | None:
        return next((what for what in CHOICES[:2] if what in self.node), None)

    @property
    def is_joint(self) -> bool:
        return self.label == ONE_TO_ONE and self.turn is None


class Connection(NamedTuple):
    """A periodic interface: nodes of zone and donor, centre and angles, zero if translated."""

    zone: str
    name: str
    nodes: ndarray
    others: ndarray
    centre: ndarray
    angles: ndarray


def list_interfaces(zone: Zone) -> Iterator[Interface]:
    for label in INTERFACES:
        for name, node in find_children(zone.group, "ZoneGridConnectivity_t", label):
            yield Interface(
                label, name, node, find_first(node, "GridConnectivityProperty_t", "Periodic_t")
            )


def find_connections(zones: list[Zone]) -> Iterator[Connection]:
    """Yields the periodic interfaces of zones whose nodes are named on both sides."""
    by_name = {zone.name: zone for zone in zones}
    for zone in zones:
        for each in list_interfaces(zone):
            donor = by_name.get(read_word(each.node).rpartition("/")[2])
            if each.turn is not None and donor is not None and f"{each.choice}Donor" in each.node:
                yield from _find_connection(zone, donor, each)


def _find_connection(zone: Zone, donor: Zone, each: Interface) -> Iterator[Connection]:
    place = read_word(each.node.get("GridLocation"), "Vertex")
    sides = ((zone, f"{each.choice}"), (donor, f"{each.choice}Donor"))
    nodes, others = (_pick_nodes(side, each.name, each.node, what, place) for side, what in sides)
    if nodes is not None and others is not None:
        turn = {
            key: read_data(array).astype(float).ravel()
            for key, array in find_children(each.turn, "DataArray_t")
        }
        centre, angles = (turn.get(key, np.zeros(3)) for key in ("RotationCenter", "RotationAngle"))
        yield Connection(zone.name, each.name, np.unique(nodes), np.unique(others), centre, angles)


def list_left_interfaces(zone: Zone, found: Iterable[Connection]) -> list[str]:
    """Lists the names of interfaces that are not read: without equal nodes, or overset holes."""
    known = {each.name for each in found if each.zone == zone.name}
    known |= {each.name for each in list_interfaces(zone) if each.is_joint}
    return [f"{zone.name}/{each.name}" for each in list_interfaces(zone) if each.name not in known]


def name_patches(zones: list[Zone]) -> list[str]:
    """Names the patch of each boundary condition; returns notes on those of one name.

    Conditions of one family are one patch, and so are those of one name and type without a family.
    A patch with the name of another one is named by the zone too; families keep their names.
    """
    names: dict[Any, str] = {}
    notes = []
    members = collections.Counter()
    every = itertools.chain(*(zone.conditions for zone in zones))
    for condition in sorted(every, key=lambda each: not each.family):
        key = condition.family or (condition.name, condition.kind)
        patch = condition.patch
        while key not in names and patch in names.values():
            patch += f"_{condition.zone}"
        if patch != condition.patch:
            place = f"the boundary condition {condition.name} of zone {condition.zone}"
            notes.append(f"{place} is called as another patch: it is the patch {patch}.")
        condition.patch = names.setdefault(key, patch)
        members[condition.patch] += not condition.family
    text = "the boundary conditions {} of {} zones, of one type, are one patch."
    return notes + [text.format(name, count) for name, count in members.items() if count > 1]


def find_patches(zone: Zone) -> Iterator[tuple[str, ndarray | None]]:
    """Yields the patch and the nodes of each boundary condition; None for a condition on cells.

    gmsh writes these for volumes. Conditions inside of the mesh are left out. A zone without any
    condition or interface has its sections of faces as patches, as SU2 reads them.
    """
    joined = _find_joints(zone)
    for condition in zone.conditions:
        nodes = _pick_condition(zone, condition)
        if nodes is None or np.unique(nodes).tobytes() not in joined:
            yield condition.patch, nodes
    if not zone.conditions and not any(list_interfaces(zone)):
        for section in zone.outer_sections():
            if not section.is_of_faces:
                yield section.section, section.vertices.values


def _find_joints(zone: Zone) -> set[bytes]:
    joined = set()
    for each in list_interfaces(zone):
        if each.is_joint and each.choice == "PointRange":
            with contextlib.suppress(ValueError):  # a wrong range of an interface does no harm
                nodes = _pick_nodes(zone, each.name, each.node, "PointRange", "Vertex")
                joined.add(b"" if nodes is None else np.unique(nodes).tobytes())
    return joined


def _pick_condition(zone: Zone, condition: Condition) -> ndarray | None:
    parts = condition.node
    what = next((part for part in CHOICES if part in parts), None)
    if what is None:
        raise zone.error(
            f"boundary condition {condition.name} says neither a range nor a list of points"
        )
    place = (
        "FaceCenter"
        if what.startswith("Element")
        else read_word(parts.get("GridLocation"), "Vertex")
    )
    if "InwardNormalIndex" in parts and place in ("FaceCenter", "CellCenter"):
        place = list(NORMAL)[int(np.argmax(np.abs(read_data(parts["InwardNormalIndex"]))))]
    return _pick_nodes(zone, condition.name, parts, what, place)


def _pick_nodes(zone: Zone, name: str, parts: Any, what: str, place: str) -> ndarray | None:
    """Finds nodes of a range or list of points, faces or elements; None for a region of cells.

    A range may run backwards. One that ends before the first node is empty.
    """
    chosen = np.atleast_2d(read_data(parts[what])).astype(np.int64)
    if not chosen.size:
        return np.zeros(0, np.int64)
    # a list is one range for each of its members
    width = chosen.shape[1] if zone.is_structured else 1
    start, stop = chosen.reshape(2, 1, -1) if "Range" in what else (chosen.reshape(-1, width),) * 2
    if ((stop < start) & (stop < 1)).any():
        return np.zeros(0, np.int64)
    start, stop = np.minimum(start, stop), np.maximum(start, stop)
    if zone.is_structured:
        return _pick_of_block(zone, name, place, start - 1, stop - 1)
    start = start.ravel()
    stop = stop.ravel()
    if place != "Vertex":
        return _pick_of_elements(zone, name, start, stop)
    if start.min() < 1 or stop.max() > zone.count:
        raise zone.error(f"boundary condition {name} names vertices beyond 1 to {zone.count}")
    return zone.first - 1 + (np.arange(start[0], stop[0] + 1) if len(start) == 1 else start)


def _pick_of_block(
    zone: Zone, name: str, place: str, start: ndarray, stop: ndarray
) -> ndarray | None:
    low = start.min(axis=0)
    high = stop.max(axis=0)
    step = np.zeros(len(low), np.int64)
    if place != "Vertex":
        normal = _find_normal(low, high, zone.shape, place)
        if normal is None:
            return None
        step[np.arange(len(step)) != normal] = 1
    if len(low) != len(zone.shape) or (low < 0).any() or (high + step >= zone.shape).any():
        raise zone.error(
            f"boundary condition {name} goes beyond {' x '.join(map(str, zone.shape))} vertices"
        )
    ids = number_block(zone.shape, zone.first).reshape(zone.shape)
    ends = stop + step + 1
    return np.concatenate(
        [ids[tuple(map(slice, *box))].ravel() for box in zip(start, ends, strict=True)]
    )


def _find_normal(low: ndarray, high: ndarray, shape: tuple[int, ...], place: str) -> int | None:
    """Finds the axis across faces from `low` to `high`; None for cells.

    Where the faces are one wide in several axes, it is the axis in which they lie behind the last
    cell, else at the first one of several cells.
    """
    if place in NORMAL:
        return NORMAL[place]
    sizes = np.array(shape)
    is_thin = (low == high) & (sizes > 1) if len(low) == len(sizes) else np.zeros(1, bool)
    if not is_thin.any():
        return None
    rank = 4 * (high == sizes - 1) + 2 * (low == 0) + (sizes > 2)
    return int(np.argmax(np.where(is_thin, rank, -1)))


def _pick_of_elements(zone: Zone, name: str, start: ndarray, stop: ndarray) -> ndarray | None:
    nodes = []
    count = 0
    solid = 0
    for begin, section in zone.content.elements.items():
        # of a range that part which lies in the section; members of a list are in it, or not
        low = np.maximum(start, begin)
        high = np.minimum(stop, begin + len(section.vertices) - 1)
        rows = (np.arange(low[0], high[0] + 1) if len(start) == 1 else low[low <= high]) - begin
        count += len(rows)
        if section.dimension < zone.content.dimension:
            nodes.append(section.vertices.take(rows).values)
        else:
            solid += len(rows)
    missing = (stop - start + 1).sum() - count
    if missing:
        raise zone.error(
            f"boundary condition {name}: {missing} of its {count + missing} elements are not there"
        )
    return None if solid == count else join_ids(nodes)


def describe_conditions(file: Any, zones: list[Zone], known: Collection[str]) -> dict[str, Any]:
    """Lists what the file says of the patches `known`: their types and groups, and symmetry."""
    conditions = [
        condition for zone in zones for condition in zone.conditions if condition.patch in known
    ]
    kinds = list_kinds(file, conditions)
    symmetry = tuple(patch for patch, kind in kinds.items() if kind == SYMMETRY_TYPE)
    return {
        "kinds": kinds,
        "groups": list_groups_of_families(file, conditions, known),
        "symmetry": symmetry,
    }


def list_kinds(file: Any, conditions: list[Condition]) -> dict[str, str]:
    """Finds each patch's type: its conditions' or family's; several in turn, if they differ."""
    families = _read_of_families(file, "FamilyBC_t")
    types: dict[str, dict[str, None]] = {}
    for condition in conditions:
        kinds = families.get(condition.patch, []) if condition.kind in UNSAID else [condition.kind]
        types.setdefault(condition.patch, {}).update(
            (kind, None) for kind in kinds if kind not in UNSAID
        )
    return {patch: ", ".join(kinds) for patch, kinds in types.items() if kinds}


def _read_of_families(file: Any, label: str) -> dict[str, list[str]]:
    families = find_children(file, "CGNSBase_t", "Family_t")
    return {
        name: [read_word(node) for _, node in find_children(family, label) if " data" in node]
        for name, family in families
    }


def list_groups_of_families(
    file: Any, conditions: list[Condition], known: Iterable[str]
) -> dict[str, tuple[str, ...]]:
    """Lists patches by the families of their family, and by additional families, as in gmsh."""
    above = _read_of_families(file, "FamilyName_t")
    groups: dict[str, dict[str, None]] = {}
    for condition in conditions:
        more = [
            read_word(family)
            for _, family in find_children(condition.node, "AdditionalFamilyName_t")
        ]
        for group in [*above.get(condition.patch, []), *more]:
            groups.setdefault(group, {})[condition.patch] = None
    return {name: tuple(several) for name, several in groups.items() if name not in known}
