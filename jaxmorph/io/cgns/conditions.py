"""Boundary of a CGNS file: conditions, their types and families, and interfaces between zones."""

import contextlib
import dataclasses
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from .zone import Content, Ragged, Zone, children, data, word

NORMAL = {"IFaceCenter": 0, "JFaceCenter": 1, "KFaceCenter": 2}


@dataclasses.dataclass(frozen=True, eq=False)
class Connection:
    """A periodic interface: its nodes, its donor's nodes, and a rotation's centre and angles.

    Centre and angles are zero for a translation.
    """

    name: str
    nodes: np.ndarray
    others: np.ndarray
    centre: np.ndarray
    angles: np.ndarray


def connections(zone: Zone, contents: Mapping[str, tuple[Zone, Content]]) -> Iterator[Connection]:
    """Yields the periodic interfaces of a zone whose nodes are named on both sides."""
    for name, interface, turns in _interfaces(zone, "GridConnectivity1to1_t", "GridConnectivity_t"):
        parts, donor = dict(interface.items()), word(interface).rpartition("/")[2]
        what = [kind for kind in ("PointRange", "PointList") if {kind, f"{kind}Donor"} <= parts.keys()]
        if not turns or not what or donor not in contents:
            continue
        place, sides = _place(parts), []
        for part, other in ((what[0], zone.name), (f"{what[0]}Donor", donor)):
            sides.append(_nodes(contents[other], name, place, data(parts[part]), what[0] == "PointRange"))
        if sides[0] is None or sides[1] is None:
            continue
        values = {key: data(array).astype(float).ravel() for key, array in children(turns[0], "DataArray_t")}
        centre, angles = (values.get(key, np.zeros(3)) for key in ("RotationCenter", "RotationAngle"))
        yield Connection(name, np.unique(sides[0]), np.unique(sides[1]), centre, angles)


def joints(zone: Zone, content: Content) -> Iterator[np.ndarray]:
    """Yields the nodes of interfaces at which the zone goes on in another one."""
    for name, interface, turns in _interfaces(zone, "GridConnectivity1to1_t"):
        if not turns and "PointRange" in interface:
            with contextlib.suppress(ValueError):  # a wrong range of an interface does no harm
                nodes = _nodes((zone, content), name, "Vertex", data(interface["PointRange"]), True)
                yield np.zeros(0, np.int64) if nodes is None else np.unique(nodes)


def _interfaces(zone: Zone, *labels: str) -> Iterator[tuple[str, Any, list[Any]]]:
    """Yields the name and node of each interface, and its nodes that say how it repeats."""
    for _, connectivity in children(zone.group, "ZoneGridConnectivity_t"):
        for label in labels:
            for name, interface in children(connectivity, label):
                properties = [group for _, group in children(interface, "GridConnectivityProperty_t")]
                yield name, interface, [turn for group in properties for _, turn in children(group, "Periodic_t")]


def _place(parts: Mapping[str, Any]) -> str:
    return word(parts["GridLocation"]) if "GridLocation" in parts else "Vertex"


def left_interfaces(zone: Zone, contents: Mapping[str, tuple[Zone, Content]]) -> Iterator[str]:
    """Yields the names of interfaces that are not read: without equal nodes, or overset holes."""
    known = {interface.name for interface in connections(zone, contents)}
    known |= {name for name, _, turns in _interfaces(zone, "GridConnectivity1to1_t") if not turns}
    for name, *_ in _interfaces(zone, "GridConnectivity1to1_t", "GridConnectivity_t", "OversetHoles_t"):
        if name not in known:
            yield f"{zone.name}/{name}"


class Condition(NamedTuple):
    """A boundary condition: the patch that it is of, its own name, and its node in the file."""

    patch: str
    name: str
    node: Any

    @property
    def kind(self) -> str:
        return word(self.node) if " data" in self.node else ""


def conditions(zones: list[Zone]) -> tuple[dict[str, list[Condition]], list[str]]:
    """Lists each zone's boundary conditions, and sentences on those of one name.

    Conditions of one family are one patch, and so are those of one name and type without a family.
    Another type, or a name that a family has too, makes a patch of its own, called by the zone too.
    """
    found: dict[str, list[Condition]] = {zone.name: [] for zone in zones}
    alone, families = [], set()
    for zone in zones:
        for _, zone_bc in children(zone.group, "ZoneBC_t"):
            for name, node in children(zone_bc, "BC_t"):
                family = [word(child) for _, child in children(node, "FamilyName_t")]
                families |= {*family[:1]}
                found[zone.name].append(Condition(family[0] if family else name, name, node))
                alone += [] if family else [(zone.name, len(found[zone.name]) - 1)]
    notes, kinds, members = [], {}, {}
    for zone_name, at in alone:
        condition = found[zone_name][at]
        name = condition.name
        if name not in families and kinds.setdefault(name, condition.kind) == condition.kind:
            members.setdefault(name, []).append(zone_name)
            continue
        patch = f"{name}_{zone_name}"
        while patch in families | kinds.keys():
            patch = f"{patch}_{zone_name}"
        found[zone_name][at], kinds[patch] = condition._replace(patch=patch), condition.kind
        other = "family" if name in families else "condition of another type"
        notes.append(
            f"the boundary condition {name} of zone {zone_name} is called as a {other}: it is the patch {patch}."
        )
    for name, of_zones in members.items():
        if len(of_zones) > 1:
            notes.append(f"the boundary conditions {name} of {len(of_zones)} zones, of one type, are one patch.")
    return found, notes


def patches(zone: Zone, content: Content, several: list[Condition]) -> Iterator[tuple[str, np.ndarray | None]]:
    """Yields the patch and the nodes of each boundary condition; None for a condition on cells.

    gmsh writes these for volumes. Conditions where the zone goes on in another zone are left out. A
    zone without any condition or interface has its sections of faces as patches, as SU2 reads them.
    """
    joined = {nodes.tobytes() for nodes in joints(zone, content)}
    for patch, name, condition in several:
        parts = dict(condition.items())
        places = [part for part in ("PointRange", "PointList", "ElementRange", "ElementList") if part in parts]
        if not places:
            raise zone.error(f"boundary condition {name} says neither a range nor a list of points")
        place = "FaceCenter" if places[0].startswith("Element") else _place(parts)
        if "InwardNormalIndex" in parts and place in ("FaceCenter", "CellCenter"):
            place = list(NORMAL)[int(np.argmax(np.abs(data(parts["InwardNormalIndex"]))))]
        nodes = _nodes((zone, content), name, place, data(parts[places[0]]), places[0].endswith("Range"))
        if nodes is None or np.unique(nodes).tobytes() not in joined:
            yield patch, nodes
    if not several and not list(children(zone.group, "ZoneGridConnectivity_t")):
        for section in content.elements.values():
            if section.dimension == content.dimension - 1 and not isinstance(section.vertices, Ragged):
                yield section.section, section.vertices.ravel()


def _nodes(where: tuple[Zone, Content], name: str, place: str, chosen: np.ndarray, is_range: bool) -> np.ndarray | None:
    """Finds nodes of a range or list of points, faces or elements; None for a region of cells."""
    # ranges may run backwards; one that ends before the first node, or a list without entries,
    # is empty
    chosen = np.atleast_2d(chosen).astype(np.int64)
    first, last = chosen.reshape(2, -1) if is_range else (chosen, chosen)
    if not chosen.size or ((last < first) & (last < 1)).any():
        return np.zeros(0, np.int64)
    if where[0].is_structured:
        return _of_block(where[0], name, place, chosen, is_range)
    return _of_elements(*where, name, place, chosen.ravel(), is_range)


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
    ids = zone.first + np.arange(zone.count).reshape(zone.shape, order="F")
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


def _of_elements(
    zone: Zone, content: Content, name: str, place: str, chosen: np.ndarray, is_range: bool
) -> np.ndarray | None:
    sections = content.elements.items()
    most = (
        zone.count
        if place == "Vertex"
        else max((begin + len(section.vertices) for begin, section in sections), default=1) - 1
    )
    if place == "Vertex" and (chosen.min() < 1 or chosen.max() > most):
        raise zone.error(f"boundary condition {name} names vertices beyond 1 to {most}")
    if chosen.max() > most:
        raise zone.error(f"boundary condition {name} names elements beyond the last one, {most}")
    numbers = np.arange(chosen.min(), chosen.max() + 1) if is_range else chosen
    if place == "Vertex":
        return numbers - 1 + zone.first
    nodes, count, solid = [np.zeros(0, np.int64)], 0, 0
    for begin, section in sections:
        rows = numbers[(numbers >= begin) & (numbers < begin + len(section.vertices))] - begin
        count += len(rows)
        if section.dimension < content.dimension:
            nodes.append(section.vertices[rows].ravel())
        else:
            solid += len(rows)
    if count < len(numbers):
        raise zone.error(
            f"boundary condition {name}: {len(numbers) - count} of its {len(numbers)} elements are not there"
        )
    return None if solid == count else np.concatenate(nodes)


SYMMETRY = "BCSymmetryPlane"
UNSAID = ("", "Null", "FamilySpecified")


def kinds_of(file: Any, conditions: list[Condition]) -> dict[str, str]:
    """Finds each patch's type: its conditions' or family's; several in turn, if they differ."""
    families = _of_families(file, "FamilyBC_t")
    types: dict[str, list[str]] = {}
    for condition in conditions:
        kind = condition.kind
        types.setdefault(condition.patch, []).extend(families.get(condition.patch, []) if kind in UNSAID else [kind])
    kinds = {
        patch: ", ".join(dict.fromkeys(kind for kind in several if kind not in UNSAID))
        for patch, several in types.items()
    }
    return {patch: kind for patch, kind in kinds.items() if kind}


def _of_families(file: Any, label: str) -> dict[str, list[str]]:
    """Reads the words of each family's nodes of a label."""
    families = [family for _, base in children(file, "CGNSBase_t") for family in children(base, "Family_t")]
    return {name: [word(node) for _, node in children(family, label) if " data" in node] for name, family in families}


def symmetry_of(kinds: dict[str, str]) -> tuple[str, ...]:
    """Lists the patches that lie in symmetry planes."""
    return tuple(patch for patch, kind in kinds.items() if kind == SYMMETRY)


def groups_of(file: Any, conditions: list[Condition], names: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Lists patches by the families that their family is part of, and by additional families.

    gmsh names physical groups so. Names of patches are no groups.
    """
    above = _of_families(file, "FamilyName_t")
    groups: dict[str, dict[str, None]] = {}
    for patch, _, condition in conditions:
        more = [word(family) for _, family in children(condition, "AdditionalFamilyName_t")]
        for group in [*above.get(patch, []), *more]:
            groups.setdefault(group, {})[patch] = None
    known = set(names)
    groups = {name: {patch: None for patch in several if patch in known} for name, several in groups.items()}
    return {name: tuple(several) for name, several in groups.items() if name not in known and several}
