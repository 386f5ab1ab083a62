"""CGNS files for tests, node by node after the SIDS' mapping to HDF5."""

import foam
import h5py
import numpy as np

CODES = {"<i4": "I4", "<i8": "I8", "<f4": "R4", "<f8": "R8", "|i1": "C1"}


def node(parent, name, label, value=None):
    group = parent.create_group(name, track_order=True)
    if isinstance(value, str):
        value = np.frombuffer(value.encode(), np.int8)
    code = "MT" if value is None else CODES[np.asarray(value).dtype.str]
    for key, said, width in (("name", name, 33), ("label", label, 33), ("type", code, 3)):
        group.attrs.create(key, np.bytes_(said.ljust(width, "\0")), dtype=f"S{width}")
    group.attrs["flags"] = np.array([1], np.int32)
    if value is not None:
        group.create_dataset(" data", data=value)
    return group


def base(file, cell_dimension, dimension):
    file.create_dataset(" format", data=np.frombuffer(b"IEEE_LITTLE_32\0", np.int8))
    file.create_dataset(
        " hdf5version", data=np.frombuffer(b"HDF5 Version 1.10.8".ljust(33, b"\0"), np.int8)
    )
    root = (
        ("name", "HDF5 MotherNode", 33),
        ("label", "Root Node of HDF5 File", 33),
        ("type", "MT", 3),
    )
    for key, said, width in root:
        file.attrs.create(key, np.bytes_(said.ljust(width, "\0")), dtype=f"S{width}")
    node(file, "CGNSLibraryVersion", "CGNSLibraryVersion_t", np.array([3.4], np.float32))
    return node(file, "Base", "CGNSBase_t", np.array([cell_dimension, dimension], np.int32))


def zone(parent, name, coordinates, cells=None, kind="<f8"):
    """`coordinates` are arrays by i, j, k (or lists of vertices, with the number of cells)."""
    shape = coordinates[0].shape
    sizes = (
        [shape, [size - 1 for size in shape], [0] * len(shape)]
        if cells is None
        else [[shape[0]], [cells], [0]]
    )
    group = node(parent, name, "Zone_t", np.array(sizes, np.int32))
    node(group, "ZoneType", "ZoneType_t", "Structured" if cells is None else "Unstructured")
    grid = node(group, "GridCoordinates", "GridCoordinates_t")
    for axis, values in zip("XYZ", coordinates, strict=False):
        node(grid, f"Coordinate{axis}", "DataArray_t", np.asarray(values.T, kind))
    solution = node(group, "FlowSolution", "FlowSolution_t")
    node(solution, "Density", "DataArray_t", np.full(shape[::-1], 1.25))
    return group


def elements(group, name, kind, values, first, count):
    section = node(group, name, "Elements_t", np.array([kind, 0], np.int32))
    node(section, "ElementRange", "IndexRange_t", np.array([first, first + count - 1], np.int32))
    node(section, "ElementConnectivity", "DataArray_t", np.asarray(values, np.int32).ravel())


def polygons(group, name, kind, rows, first):
    """NGON_n (22) or NFACE_n (23), with offsets."""
    elements(group, name, kind, np.concatenate(rows), first, len(rows))
    starts = np.cumsum([0, *map(len, rows)]).astype(np.int32)
    node(group[name], "ElementStartOffset", "DataArray_t", starts)


def write(path, mesh, kind="<f8"):
    """A mesh of hexahedra as one zone without conditions."""
    corners = np.asarray(mesh.cells["hexahedron"]) + 1
    with h5py.File(path, "w") as file:
        group = zone(base(file, 3, 3), "box", tuple(np.asarray(mesh.points).T), len(corners), kind)
        elements(group, "cells", 17, corners, 1, len(corners))


def condition(group, name, places, family=None, location=None, what="PointRange"):
    found = group["ZoneBC"] if "ZoneBC" in group else node(group, "ZoneBC", "ZoneBC_t")
    child = node(found, name, "BC_t", "FamilySpecified" if family else "BCWall")
    node(
        child,
        what,
        "IndexRange_t" if what.endswith("Range") else "IndexArray_t",
        np.array(places, np.int32),
    )
    if family:
        node(child, "FamilyName", "FamilyName_t", family)
    if location:
        node(child, "GridLocation", "GridLocation_t", location)


def periodic(
    group, name, donor, places, others, translation=(0, 0, 0), angles=(0, 0, 0), what="PointRange"
):
    """A periodic interface with the nodes of both sides."""
    found = group.get("ZoneGridConnectivity") or node(
        group, "ZoneGridConnectivity", "ZoneGridConnectivity_t"
    )
    kind = "GridConnectivity1to1_t" if what == "PointRange" else "GridConnectivity_t"
    child = node(found, name, kind, donor)
    label = "IndexRange_t" if what == "PointRange" else "IndexArray_t"
    node(child, what, label, np.array(places, np.int32))
    node(child, f"{what}Donor", label, np.array(others, np.int32))
    turn = node(
        node(child, "GridConnectivityProperty", "GridConnectivityProperty_t"),
        "Periodic",
        "Periodic_t",
    )
    for key, values in (
        ("RotationCenter", (0, 0, 0)),
        ("RotationAngle", angles),
        ("Translation", translation),
    ):
        node(turn, key, "DataArray_t", np.array(values, np.float32))


def two_blocks(path, kind="<f8"):
    """A box in two blocks, 4 x 3 x 3 and 3 x 3 x 3 nodes, that meet at x = 1, the second one with j and k exchanged."""
    x, y, z = np.meshgrid(
        np.linspace(0, 1, 4), np.linspace(0, 1, 3) ** 2, [0, 0.25, 1], indexing="ij"
    )
    other = np.meshgrid([1, 1.5, 2], np.linspace(0, 1, 3) ** 2, [0, 0.25, 1], indexing="ij")
    with h5py.File(path, "w", track_order=True) as file:
        root = base(file, 3, 3)
        first = zone(root, "one", (x, y, z), kind=kind)
        second = zone(root, "two", [np.swapaxes(axis, 1, 2) for axis in other], kind=kind)
        condition(first, "a", [[1, 1, 1], [1, 3, 3]], "inlet")
        condition(first, "b", [[1, 1, 1], [3, 2, 1]], "floor", "FaceCenter")
        condition(first, "c", [[1, 1, 3], [4, 3, 3]])
        condition(second, "d", [[1, 1, 1], [2, 1, 2]], "floor", "JFaceCenter")
        condition(second, "e", [[3, 2, 1], [3, 3, 3]])
        condition(second, "f", [[2, 2, 2], [3, 3, 3]], what="PointList")
    return path


def unstructured(path):
    """A cube and a wedge beside it, as MIXED elements; boundary quads; a condition of each kind."""
    square = [[0, 0], [1, 0], [1, 1], [0, 1]]
    points = np.array([[*p, z] for z in (0, 1) for p in square] + [[2, 0, 0], [2, 0, 1]], float)
    mixed = [17, 1, 2, 3, 4, 5, 6, 7, 8, 14, 2, 9, 3, 6, 10, 7]
    with h5py.File(path, "w", track_order=True) as file:
        one = zone(base(file, 3, 3), "all", tuple(points.T), 2)
        elements(one, "volume", 20, mixed, 1, 2)
        elements(one, "sides", 7, [[1, 4, 3, 2], [5, 6, 7, 8]], 3, 2)
        elements(one, "ends", 5, [[2, 3, 9]], 5, 1)
        condition(one, "low", [[3], [5]], "wall", "FaceCenter", "PointList")
        condition(one, "high", [[4], [4]], None, "FaceCenter")
        condition(one, "some", [[1], [8]], what="PointList")
        condition(one, "old", [[4], [5]], what="ElementRange")
    return points


def joined_polyhedra(path):
    """A cube, four small ones against its side; all as polyhedra, the face of each boundary cell seen from either side."""
    points, cells = foam.split()
    faces, owner, neighbour, outer = foam.polyhedral(cells)
    count = len(faces)
    faces += [sides[0][1] if i % 3 else sides[0][1][::-1] for i, sides in enumerate(outer)]
    members = [[] for _ in cells]
    for number, (a, b) in enumerate(zip(owner, neighbour, strict=True), start=1):
        members[a].append(number)
        members[b].append(-number)
    for i, sides in enumerate(outer):
        members[sides[0][0]].append((count + 1 + i) * (1 if i % 3 else -1))
    with h5py.File(path, "w", track_order=True) as file:
        group = zone(base(file, 3, 3), "p", tuple(points.T), len(cells))
        polygons(group, "faces", 22, [np.array(face) + 1 for face in faces], 1)
        polygons(group, "cells", 23, members, len(faces) + 1)
        low = [i + 1 for i, face in enumerate(faces) if (points[face, 2] == 0).all()]
        condition(group, "low", [[i] for i in low], "floor", "FaceCenter", "PointList")
    return points
