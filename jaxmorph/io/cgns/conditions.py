"""Boundary of a CGNS file: conditions, their types and families, and interfaces between zones."""

import collections
import contextlib
import dataclasses
from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from .._joined import block_ids
from .zone import Condition, Ragged, Zone, children, data, word

NORMAL = {"IFaceCenter": 0, "JFaceCenter": 1, "KFaceCenter": 2}
SYMMETRY = "BCSymmetryPlane"
UNSAID = ("", "Null", "FamilySpecified")
ONE_TO_ONE = "GridConnectivity1to1_t"


@dataclasses.dataclass(frozen=True, eq=False)
class Connection:
    """A periodic interface: nodes of zone and donor, centre and angles, zero if translated."""

    zone: str
    name: str
    nodes: np.ndarray
    others: np.ndarray
    centre: np.ndarray
    angles: np.ndarray


def connections(zones: list[Zone]) -> Iterator[Connection]:
    """Yields the periodic interfaces of zones whose nodes are named on both sides."""
    by_name = {zone.name: zone for zone in zones}
    for zone in zones:
        for name, interface, turns in _interfaces(zone, ONE_TO_ONE, "GridConnectivity_t"):
            donor = by_name.get(word(interface).rpartition("/")[2])
            if not turns or donor is None:
                continue
            nodes, others = _chosen(zone, name, interface), _chosen(donor, name, interface, "Donor")
            if nodes is not None and others is not None:
                values = {key: data(array).astype(float).ravel() for key, array in children(turns[0], "DataArray_t")}
                centre, angles = (values.get(key, np.zeros(3)) for key in ("RotationCenter", "RotationAngle"))
                yield Connection(zone.name, name, np.unique(nodes), np.unique(others), centre, angles)


def _chosen(zone: Zone, name: str, interface: Any, end: str = "") -> np.ndarray | None:
    """Finds the nodes of one side of an interface; None if they are not named on both sides."""
    what = next((kind for kind in ("PointRange", "PointList") if {kind, f"{kind}Donor"} <= {*interface}), None)
    return None if what is None else _picked(zone, name, interface, what + end, _place(interface))


def _joints(zone: Zone) -> Iterator[np.ndarray]:
    for name, interface, turns in _interfaces(zone, ONE_TO_ONE):
        if not turns and "PointRange" in interface:
            with contextlib.suppress(ValueError):  # a wrong range of an interface does no harm
                nodes = _picked(zone, name, interface, "PointRange", "Vertex")
                yield np.zeros(0, np.int64) if nodes is None else np.unique(nodes)


def _interfaces(zone: Zone, *labels: str) -> Iterator[tuple[str, Any, list[Any]]]:
    for _, connectivity in children(zone.group, "ZoneGridConnectivity_t"):
        for label in labels:
            for name, interface in children(connectivity, label):
                properties = [group for _, group in children(interface, "GridConnectivityProperty_t")]
                yield name, interface, [turn for group in properties for _, turn in children(group, "Periodic_t")]


def _place(parts: Mapping[str, Any]) -> str:
    return word(parts.get("GridLocation"), "Vertex")


def left_interfaces(zone: Zone, found: Iterable[Connection]) -> Iterator[str]:
    """Yields the names of interfaces that are not read: without equal nodes, or overset holes."""
    known = {interface.name for interface in found if interface.zone == zone.name}
    known |= {name for name, _, turns in _interfaces(zone, ONE_TO_ONE) if not turns}
    for name, *_ in _interfaces(zone, ONE_TO_ONE, "GridConnectivity_t", "OversetHoles_t"):
        if name not in known:
            yield f"{zone.name}/{name}"


def read_conditions(zones: list[Zone]) -> list[str]:
    """Reads each zone's boundary conditions; returns notes on those of one name.

    Conditions of one family are one patch, and so are those of one name and type without a family.
    One of another type, or with the name of a family, is a patch of its own, named by the zone too.
    """
    for zone in zones:
        zone.conditions += _conditions(zone)
    every = [condition for zone in zones for condition in zone.conditions]
    families = {condition.family for condition in every} - {""}
    notes, kinds, members = [], {}, collections.Counter()
    for condition in (condition for condition in every if not condition.family):
        name = condition.name
        if name not in families and kinds.setdefault(name, condition.kind) == condition.kind:
            members[name] += 1
            continue
        while condition.patch in families | kinds.keys():
            condition.patch += f"_{condition.zone}"
        kinds[condition.patch] = condition.kind
        other = "family" if name in families else "condition of another type"
        notes.append(
            f"the boundary condition {name} of zone {condition.zone} is called as a {other}: "
            f"it is the patch {condition.patch}."
        )
    text = "the boundary conditions {} of {} zones, of one type, are one patch."
    return notes + [text.format(name, count) for name, count in members.items() if count > 1]


def _conditions(zone: Zone) -> Iterator[Condition]:
    for _, zone_bc in children(zone.group, "ZoneBC_t"):
        for name, node in children(zone_bc, "BC_t"):
            family = word(next((child for _, child in children(node, "FamilyName_t")), None))
            yield Condition(zone.name, name, node, family, family or name)


def patches(zone: Zone) -> Iterator[tuple[str, np.ndarray | None]]:
    """Yields the patch and the nodes of each boundary condition; None for a condition on cells.

    gmsh writes these for volumes. Conditions inside of the mesh are left out. A zone without any
    condition or interface has its sections of faces as patches, as SU2 reads them.
    """
    joined = {nodes.tobytes() for nodes in _joints(zone)}
    for condition in zone.conditions:
        nodes = _nodes_of(zone, condition)
        if nodes is None or np.unique(nodes).tobytes() not in joined:
            yield condition.patch, nodes
    if not zone.conditions and not any(children(zone.group, "ZoneGridConnectivity_t")):
        for section in zone.outer_sections():
            if not isinstance(section.vertices, Ragged):
                yield section.section, section.vertices.ravel()


def _nodes_of(zone: Zone, condition: Condition) -> np.ndarray | None:
    parts = condition.node
    what = next((part for part in ("PointRange", "PointList", "ElementRange", "ElementList") if part in parts), None)
    if what is None:
        raise zone.error(f"boundary condition {condition.name} says neither a range nor a list of points")
    place = "FaceCenter" if what.startswith("Element") else _place(parts)
    if "InwardNormalIndex" in parts and place in ("FaceCenter", "CellCenter"):
        place = list(NORMAL)[int(np.argmax(np.abs(data(parts["InwardNormalIndex"]))))]
    return _picked(zone, condition.name, parts, what, place)


def _picked(zone: Zone, name: str, parts: Any, what: str, place: str) -> np.ndarray | None:
    """Finds nodes of a range or list of points, faces or elements; None for a region of cells.

    A range may run backwards. One that ends before the first node is empty.
    """
    chosen, is_range = np.atleast_2d(data(parts[what])).astype(np.int64), "Range" in what
    first, last = chosen.reshape(2, -1) if is_range else (chosen, chosen)
    if not chosen.size or ((last < first) & (last < 1)).any():
        return np.zeros(0, np.int64)
    if zone.is_structured:
        return _of_block(zone, name, place, chosen, is_range)
    _check_numbers(zone, name, place, chosen)
    numbers = np.arange(chosen.min(), chosen.max() + 1) if is_range else chosen.ravel()
    return numbers - 1 + zone.first if place == "Vertex" else _of_elements(zone, name, numbers)


def _check_numbers(zone: Zone, name: str, place: str, chosen: np.ndarray) -> None:
    if place == "Vertex":
        wrong = f"vertices beyond 1 to {zone.count}" if chosen.min() < 1 or chosen.max() > zone.count else ""
    else:
        sections = zone.content.elements.items()
        most = max((begin + len(section.vertices) for begin, section in sections), default=1) - 1
        wrong = f"elements beyond the last one, {most}" if chosen.max() > most else ""
    if wrong:
        raise zone.error(f"boundary condition {name} names {wrong}")


def _of_block(zone: Zone, name: str, place: str, chosen: np.ndarray, is_range: bool) -> np.ndarray | None:
    low, high = chosen.min(axis=0) - 1, chosen.max(axis=0) - 1
    step = np.zeros(len(low), np.int64)
    if place != "Vertex":
        normal = _normal(low, high, zone.shape, place)
        if normal is None:
            return None
        step[np.arange(len(step)) != normal] = 1
    if len(low) != len(zone.shape) or (low < 0).any() or (high + step >= zone.shape).any():
        raise zone.error(f"boundary condition {name} goes beyond {' x '.join(map(str, zone.shape))} vertices")
    ids = block_ids(zone.shape, zone.first).reshape(zone.shape)
    if is_range:
        return ids[tuple(slice(a, b + 1) for a, b in zip(low, high + step, strict=True))].ravel()
    corners = np.stack(np.meshgrid(*(np.arange(size + 1) for size in step), indexing="ij"), axis=-1)
    places = chosen[:, None] - 1 + corners.reshape(-1, len(step))
    return ids[tuple(np.moveaxis(places, -1, 0))].ravel()


def _normal(low: np.ndarray, high: np.ndarray, shape: tuple[int, ...], place: str) -> int | None:
    """Finds the axis across faces from `low` to `high`; None for cells.

    Where the faces are one wide in several axes, it is the axis in which they lie behind the last
    cell, else at the first one of several cells.
    """
    sizes = np.array(shape)
    if place in NORMAL:
        return NORMAL[place]
    if len(low) != len(sizes) or not ((low == high) & (sizes > 1)).any():
        return None
    rank = 4 * (high == sizes - 1) + 2 * (low == 0) + (sizes > 2)
    return int(np.argmax(np.where((low == high) & (sizes > 1), rank, -1)))


def _of_elements(zone: Zone, name: str, numbers: np.ndarray) -> np.ndarray | None:
    nodes, count, solid = [np.zeros(0, np.int64)], 0, 0
    for begin, section in zone.content.elements.items():
        rows = numbers[(numbers >= begin) & (numbers < begin + len(section.vertices))] - begin
        count += len(rows)
        if section.dimension < zone.content.dimension:
            nodes.append(section.vertices[rows].ravel())
        else:
            solid += len(rows)
    if count < len(numbers):
        missing = len(numbers) - count
        raise zone.error(f"boundary condition {name}: {missing} of its {len(numbers)} elements are not there")
    return None if solid == count else np.concatenate(nodes)


def said(file: Any, zones: list[Zone], known: Collection[str]) -> dict[str, Any]:
    """Lists what the file says of the patches `known`: their types and groups, and symmetry."""
    conditions = [condition for zone in zones for condition in zone.conditions if condition.patch in known]
    kinds = kinds_of(file, conditions)
    symmetry = tuple(patch for patch, kind in kinds.items() if kind == SYMMETRY)
    return {"kinds": kinds, "groups": groups_of(file, conditions, known), "symmetry": symmetry}


def kinds_of(file: Any, conditions: list[Condition]) -> dict[str, str]:
    """Finds each patch's type: its conditions' or family's; several in turn, if they differ."""
    families = _of_families(file, "FamilyBC_t")
    types: dict[str, dict[str, None]] = {}
    for condition in conditions:
        kinds = families.get(condition.patch, []) if condition.kind in UNSAID else [condition.kind]
        types.setdefault(condition.patch, {}).update((kind, None) for kind in kinds if kind not in UNSAID)
    return {patch: ", ".join(kinds) for patch, kinds in types.items() if kinds}


def _of_families(file: Any, label: str) -> dict[str, list[str]]:
    families = [family for _, base in children(file, "CGNSBase_t") for family in children(base, "Family_t")]
    return {name: [word(node) for _, node in children(family, label) if " data" in node] for name, family in families}


def groups_of(file: Any, conditions: list[Condition], known: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Lists patches by the families of their family, and by additional families, as in gmsh."""
    above = _of_families(file, "FamilyName_t")
    groups: dict[str, dict[str, None]] = {}
    for condition in conditions:
        more = [word(family) for _, family in children(condition.node, "AdditionalFamilyName_t")]
        for group in [*above.get(condition.patch, []), *more]:
            groups.setdefault(group, {})[condition.patch] = None
    return {name: tuple(several) for name, several in groups.items() if name not in known}
