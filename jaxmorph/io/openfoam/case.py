"""OpenFOAM's cases: `constant/polyMesh`, ascii or binary, plain or compressed (doc.openfoam.com).

Only `points` is written: into a time folder of the case, or into a copy of the case. The case
itself stays as it is.
"""

import contextlib
import dataclasses
import functools
import gzip
import os
import pathlib
import re
import shutil
import zlib
from collections.abc import Iterator

import numpy as np

from jaxmorph._boundary.periodic import Periodic
from jaxmorph._host.package.errors import warn
from jaxmorph._host.package.files import complete
from jaxmorph._mesh.exchange import Parts, checked_parts
from jaxmorph._mesh.polyhedra import Polyhedra, tetrahedra

from .._format import EVERYTHING, Arrays, Held, MeshLike, Source, as_in_file, source_of
from .._text import replace_words
from .file import PARENTHESES, FoamFile, Patch, load, patches
from .plane import Layer, Sector, check_cyclic, cyclic_pairs, layer, plane_cells, sector
from .topology import Topology, topology_of

NAME = "OpenFOAM"
COPIED = ("constant", "system", "0", "0.orig")
"""Parts of a case that a new one gets."""


@dataclasses.dataclass(frozen=True, eq=False)
class _CaseContent:
    """A case's file of points, its values, the folder of faces, and the planes of a 2-D case.

    `shared` are the points (k,) of the file that other parts of a decomposed case have too.
    """

    file: FoamFile
    points: np.ndarray
    topology: pathlib.Path
    plane: Layer | Sector | None
    shared: np.ndarray

    def in_file(self, points: np.ndarray) -> np.ndarray:
        """Computes the points (N, 3) of the file, both planes' of one in 2-D.

        Raises `ValueError` where the axis does not stay.
        """
        in_space = points if self.plane is None else self.plane.in_space(self.points, points)
        return as_in_file(in_space, self.points)

    def in_mesh(self, values: np.ndarray) -> np.ndarray:
        """Computes the points of the mesh from those of the file."""
        plane = self.plane.fitted(values) if isinstance(self.plane, Sector) else self.plane
        return values if plane is None else plane.in_plane(values)

    def held(self) -> Held | None:
        """Tells how the file holds the points; None: all digits, in planes that are not tilted."""
        is_single = self.file.is_binary and self.file.dtype("scalar").itemsize == 4
        if not is_single and not isinstance(self.plane, Sector):
            return None
        return Held(self.points, self.in_file, self.in_mesh, EVERYTHING if is_single else ())

    @functools.cached_property
    def point_ids(self) -> np.ndarray:
        """The numbers (n,) of a part's points in the whole mesh: its `pointProcAddressing`."""
        return point_ids(self.topology, len(self.points))


def read(path: pathlib.Path) -> Parts:
    """Reads the mesh of a case, a time folder, or a folder polyMesh; nodes in file order.

    `patches` come from `boundary`, `groups` from their `inGroups`. Cells with more or other faces
    than the standard types are cut into tetrahedra between their own nodes. Of a case with `empty`
    patches the plane in front is the mesh, in two coordinates. So it is with `wedge` patches, at
    places along the axis and distances from it; nodes on the axis are the patch `axis`.

    Of a decomposed case `path` may be a folder `processor3`. Faces to other processors are no
    boundary, `processorXtoY` is no patch. Faces of a cyclic patch whose partners are on another
    processor stay in their cyclic patch.
    """
    here, topology = _folders(path)
    boundary = patches(load(topology, "boundary"))
    divided = [patch for patch in boundary if patch.refers and patch.count]
    empty, wedges = ([patch for patch in boundary if patch.type == kind and patch.count] for kind in ("empty", "wedge"))
    if wedges and (len(wedges) != 2 or empty):
        names = ", ".join(patch.name for patch in wedges + empty)
        raise ValueError(
            f"{path}: patches of type wedge ({names}); an axisymmetric case has two of them, and none of type empty."
        )
    topology_data = topology_of(topology, boundary, is_plane=bool(empty or wedges))
    file, points = _points(here)
    topology_data.check(topology, len(points))
    boundary = [patch for patch in boundary if patch.name in topology_data.nodes]
    try:
        if wedges:
            mesh, ids, whole, plane = _in_sector(topology_data, points, boundary, wedges)
        elif empty:
            mesh, ids, whole, plane = _in_plane(topology_data, points, boundary, empty)
        else:
            (mesh, ids, whole), plane = _in_space(topology_data, points), None
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    groups: dict[str, tuple[str, ...]] = {}
    for patch in boundary:
        groups |= {group: (*groups.get(group, ()), patch.name) for group in patch.groups}
    pairs = tuple(Periodic(first.name, second.name) for first, second in cyclic_pairs(boundary))
    between = topology_data.between
    shared = np.unique(between[between >= 0])
    if plane is not None and len(between):
        between = plane.edges(between)
    # a caller may change the mesh's points in place, and the file's values must stay
    content = _CaseContent(file, points.copy() if plane is None else points, topology, plane, shared)
    planes = [patch.name for patch in boundary if patch.type in ("symmetry", "symmetryPlane") and patch.count]
    planes += ["axis"] * (isinstance(plane, Sector) and bool(plane.on_axis.any()))
    between = between if len(between) else None
    pairs = () if len(divided) else pairs
    kinds = {patch.name: patch.type for patch in boundary} | {name: name for name in planes if name == "axis"}
    nodes = None if plane is None else plane.file_nodes()
    known = {"symmetry": tuple(planes), "kinds": kinds, "file_nodes": nodes, "in_file": content.in_file}
    known |= {"held": content.held(), "notes": tuple(_notes(topology, [*empty, *wedges]))}
    source = Source(file.path, NAME, content, whole, ids, groups, pairs, between, **known)
    return mesh._replace(source=source)


def check(path: pathlib.Path, mesh: MeshLike) -> None:
    """Raises `ValueError` for what `write` cannot do, before any work."""
    source = source_of(mesh, NAME)
    if source is None:
        raise ValueError(f"{path}: only a mesh that was read from an OpenFOAM case can be written to one.")
    case = _case_of(source.content.topology)
    if _is_time(path):
        if case is None or not path.parent.is_dir() or not os.path.samefile(path.parent, case):
            raise ValueError(f"{path}: a time folder must be one of the case that the mesh was read from, {case}.")
    elif case is None:
        raise ValueError(f"{path}: {source.path.parent} is in no case with a folder constant; nothing to copy.")
    elif path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise ValueError(f"{path}: exists; name a new folder, or a time folder of the case such as {case / '1'}.")
    elif case.resolve() in path.resolve().parents:
        raise ValueError(f"{path}: a new case cannot be inside of the case that the mesh was read from.")
    folder = path / _region_of(source.content.topology) / "polyMesh"
    if _is_time(path) and any(_is_file(folder / name, source.path) for name in ("points", "points.gz")):
        raise ValueError(f"{path}: the mesh was read from this folder; write to another one.")


def write(path: pathlib.Path, mesh: MeshLike, point_data: Arrays, cell_data: Arrays) -> None:
    """Writes `points` in a time folder, or a new case: `constant`, `system`, `0`, `0.orig`."""
    points = file_points(mesh)
    source = source_of(mesh, NAME)
    assert source is not None
    _warn_of_parts(path, _case_of(source.content.topology))
    write_points(path, mesh, points)


def file_points(mesh: MeshLike) -> np.ndarray:
    """Computes the file's points (N, 3) of a mesh that was read from a case: in 2-D both planes'.

    It raises `ValueError` where cyclic patches do not match any more.
    """
    source = source_of(mesh, NAME)
    assert source is not None
    content: _CaseContent = source.content
    points = content.in_file(np.asarray(mesh.points))
    check_cyclic(content.topology, content.points, points)
    return points


def write_points(path: pathlib.Path, mesh: MeshLike, points: np.ndarray) -> None:
    """Writes a case, or a time folder, as `write` does, with the file's points (N, 3)."""
    source = source_of(mesh, NAME)
    assert source is not None
    content: _CaseContent = source.content
    case, region = _case_of(content.topology), _region_of(content.topology)
    if _is_time(path):
        folder = path / region / "polyMesh"
        made = [directory for directory in dict.fromkeys((path, folder.parent, folder)) if not directory.exists()]
        with _removed_on_failure(made):
            folder.mkdir(parents=True, exist_ok=True)
            with complete(folder / content.file.path.name) as partial:
                _write_points(partial, content, points)
            other = {"points": "points.gz", "points.gz": "points"}[content.file.path.name]
            (folder / other).unlink(missing_ok=True)
        return
    assert case is not None
    with complete(path, folder=True) as partial:
        for name in COPIED:
            if (case / name).is_dir():
                shutil.copytree(case / name, partial / name)
        folder = partial / "constant" / region / "polyMesh"
        shutil.copytree(content.topology, folder, dirs_exist_ok=True)
        for name in ("points", "points.gz"):
            (folder / name).unlink(missing_ok=True)
        _write_points(folder / content.file.path.name, content, points)


def _warn_of_parts(path: pathlib.Path, case: pathlib.Path | None) -> None:
    """Warns where the case is decomposed: its parts keep the old points."""
    parts = [] if case is None else [part for part in case.glob("processor*") if part.is_dir()]
    if parts:
        fate = "keep the old points" if _is_time(path) else "are not copied"
        warn(
            f"{path}: the case is decomposed, and its {len(parts)} folders processor* {fate}. "
            "Run decomposePar -force on the written mesh before a parallel run.",
        )


def point_ids(topology: pathlib.Path, count: int) -> np.ndarray:
    """Reads `pointProcAddressing`: the number (n,) of each point of a part in the whole mesh.

    It raises `ValueError`, with what to do, where the file is missing or is not of these points.
    """
    try:
        ids = load(topology, "pointProcAddressing").numbers("label").ravel()
    except FileNotFoundError:
        raise ValueError(
            f"{topology}: there is no pointProcAddressing, so it is not known which points the processors share. Run "
            "reconstructParMesh -constant in the case, which writes it, or decomposePar again."
        ) from None
    if len(ids) != count or ids.min(initial=0) < 0 or len(np.unique(ids)) < count:
        raise ValueError(
            f"{topology / 'pointProcAddressing'}: {len(ids)} numbers for {count} points; each point has one of its own, from 0 on. "
            "Run decomposePar again."
        )
    return ids


def _write_points(path: pathlib.Path, content: _CaseContent, points: np.ndarray) -> None:
    file = content.file
    if np.array_equal(points, content.points):
        path.write_bytes(file.raw)
        return
    with path.open("wb") as out:
        if path.suffix != ".gz":
            out.writelines(_replaced(file, content.points, points))
            return
        with gzip.GzipFile(file.path.stem, "wb", 6, out) as packed:  # it keeps a name: not the temporary one
            packed.writelines(_replaced(file, content.points, points))


def _replaced(file: FoamFile, known: np.ndarray, points: np.ndarray) -> Iterator[bytes]:
    """Yields the file with `points` in place of its `known` ones, in pieces."""
    place = file.list_at(file.end)
    if place.uniform:
        raise file.error("a list with one value for all points cannot hold moved ones")
    if file.is_binary:
        values = points.astype(file.dtype("scalar"))
        yield file.data[: place.start]
        yield values.tobytes()
        yield file.data[place.start + values.nbytes :]
        return
    stop = file.end_of_text(place.start)
    yield file.data[: place.start]
    yield from replace_words(file.data, place.start, stop, known.ravel(), points.ravel(), PARENTHESES)
    yield file.data[stop:]


def _points(folder: pathlib.Path) -> tuple[FoamFile, np.ndarray]:
    file = load(folder, "points")
    points = file.numbers("scalar", 3)
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if bad.size or not len(points):
        fault = f"point {bad[0]} is not finite: {points[bad[0]].tolist()}" if bad.size else "no points"
        raise file.error(fault)
    return file, points


def _in_space(topology: Topology, points: np.ndarray) -> tuple[Parts, np.ndarray | None, Polyhedra | None]:
    cells, ids, faces = topology.cells, topology.ids, topology.faces
    if faces is None:
        mesh = checked_parts(points, cells, topology.nodes)
        return mesh, _joined_ids(mesh, ids), None
    cut = ids.pop("polyhedron")
    pieces, owners = tetrahedra(faces, cut, points)
    cells["tetra"] = np.concatenate([cells["tetra"], pieces]) if "tetra" in cells else pieces
    ids["tetra"] = np.concatenate([ids["tetra"], owners]) if "tetra" in ids else owners
    mesh = checked_parts(points, cells, topology.nodes)
    return mesh, _joined_ids(mesh, ids), Polyhedra(faces, cut)


def _joined_ids(mesh: MeshLike, ids: dict[str, np.ndarray]) -> np.ndarray | None:
    """Returns the case's number of each cell of the mesh; None where the order is equal."""
    joined = np.concatenate([ids[kind] for kind in mesh.cells])
    return None if (joined[1:] > joined[:-1]).all() else joined


def _in_plane(
    topology: Topology, points: np.ndarray, boundary: list[Patch], empty: list[Patch]
) -> tuple[Parts, np.ndarray | None, Polyhedra | None, Layer]:
    assert topology.faces is not None
    chosen = np.concatenate([np.arange(patch.start, patch.start + patch.count) for patch in empty])
    plane = layer(topology.faces, points, chosen)
    nodes = {patch.name: plane.ids(topology.nodes[patch.name]) for patch in boundary if patch.type != "empty"}
    cells, ids, whole = plane_cells(topology.faces, points, chosen, plane)
    mesh = checked_parts(plane.in_plane(points), cells, nodes)
    return mesh, _joined_ids(mesh, ids), whole, plane


def _in_sector(
    topology: Topology, points: np.ndarray, boundary: list[Patch], wedges: list[Patch]
) -> tuple[Parts, np.ndarray | None, Polyhedra | None, Sector]:
    faces = topology.faces
    assert faces is not None
    plane = sector(faces, topology.nodes[wedges[0].name], topology.nodes[wedges[1].name], points)
    patch = wedges[0 if plane.is_first else 1]
    front = np.arange(patch.start, patch.start + patch.count)
    if (faces.sizes[front] > 4).any():
        raise ValueError("patches of type wedge with faces of more than four corners are not supported.")
    nodes = {
        patch.name: plane.ids(topology.nodes[patch.name]) for patch in boundary if patch.type not in ("empty", "wedge")
    }
    if plane.on_axis.any():
        if len(nodes.get("axis", ())):
            raise ValueError("the patch axis has faces; nodes on the axis get its name: call it otherwise in boundary.")
        nodes["axis"] = np.flatnonzero(plane.on_axis)
    cells, ids, whole = plane_cells(faces, points, front, plane)
    mesh = checked_parts(plane.in_plane(points), cells, nodes)
    return mesh, _joined_ids(mesh, ids), whole, plane


def _folders(path: pathlib.Path) -> tuple[pathlib.Path, pathlib.Path]:
    """Finds the folder of the points, and that of the faces, which is often the case's."""
    if path.name == "polyMesh":
        here = path
    elif (path / "constant" / "polyMesh").is_dir():
        here = path / "constant" / "polyMesh"
    elif (path / "polyMesh").is_dir():
        here = path / "polyMesh"
    else:
        raise ValueError(f"{path}: no OpenFOAM case, there is no folder constant/polyMesh in it.{_hint(path)}")
    if any((here / name).is_file() for name in ("faces", "faces.gz")):
        return here, here
    # points alone are those of a time: the faces have the same place in the case's constant
    time = next((folder for folder in here.absolute().parents if _is_time(folder)), here.absolute().parent)
    return here, time.parent / "constant" / here.absolute().relative_to(time)


def _notes(topology: pathlib.Path, planes: list[Patch]) -> Iterator[str]:
    """Yields sentences on zones, on other regions of the case, and on the planes of a 2-D case."""
    zones = [f"{size} {name}" for name in ("cellZones", "faceZones", "pointZones") if (size := _size(topology, name))]
    if zones:
        yield f"{', '.join(zones)} are not read: zones are no patches, and stay in the case."
    if topology.parent.name == "constant" and (others := regions(topology.parent)):
        yield f"the regions {', '.join(others)} have meshes of their own: {topology.parent / others[0]} is the first."
    if planes:
        names = ", ".join(f"{patch.name} ({patch.type})" for patch in planes)
        yield f"the planes {names} are no patches: the mesh lies in one of them."


def _size(topology: pathlib.Path, name: str) -> int:
    """Reads the length of the list in a file from its first lines; 0 without the file."""
    for path, opening in ((topology / name, open), (topology / f"{name}.gz", gzip.open)):
        with contextlib.suppress(OSError, EOFError, zlib.error), opening(path, "rb") as file:
            found = re.search(rb"^\s*(\d{1,18})\s*(\(|$)", file.read(1 << 13).rpartition(b"FoamFile")[2], re.MULTILINE)
            return int(found[1]) if found else 0
    return 0


def regions(folder: pathlib.Path) -> list[str]:
    """Lists the regions whose meshes are in `constant` or in a folder of a time."""
    return sorted(mesh.parent.name for mesh in folder.glob("*/polyMesh") if mesh.is_dir())


def _hint(path: pathlib.Path) -> str:
    """Says where the meshes are in a folder without one: in those of regions, or of processors."""
    here = path if _is_time(path) else path / "constant"
    found, divided = regions(here), list(path.glob("processor*/constant/polyMesh"))
    if found:
        several = "one region" if len(found) == 1 else f"{len(found)} regions"
        return f" It has {several}, {', '.join(found)}, each with a mesh that is read by itself: {here / found[0]}."
    if divided:
        parts = f"one of its {len(divided)} folders processor*"
        return f" It is decomposed: take {parts}, jaxmorph deform --decomposed, or reconstruct it."
    found = sorted({region for part in path.glob("processor*/constant") for region in regions(part)})
    if found:
        first = path / "constant" / found[0]
        return (
            f" It is decomposed, and has the regions {', '.join(found)}: jaxmorph deform --decomposed {first}, "
            f"or take {path / 'processor0' / 'constant' / found[0]}."
        )
    return ""


def _case_of(topology: pathlib.Path) -> pathlib.Path | None:
    """Finds the folder that holds `constant`, or the time folder, that a polyMesh is in."""
    above = topology.resolve().parents
    cases = [folder.parent for folder in above if folder.name == "constant"]
    return cases[0] if cases else next((folder.parent for folder in above if _is_time(folder)), None)


def _region_of(topology: pathlib.Path) -> pathlib.Path:
    """Returns the folder of the region that a polyMesh is of, in `constant` or a time; else "."."""
    case = _case_of(topology)
    return pathlib.Path() if case is None else pathlib.Path(*topology.resolve().relative_to(case).parts[1:-1])


def _is_time(path: pathlib.Path) -> bool:
    return re.fullmatch(r"\d+(\.\d*)?(e[+-]?\d+)?", path.name) is not None


def _is_file(a: pathlib.Path, b: pathlib.Path) -> bool:
    return a.exists() and os.path.samefile(a, b)


@contextlib.contextmanager
def _removed_on_failure(folders: list[pathlib.Path]) -> Iterator[None]:
    try:
        yield
    except BaseException:
        for folder in reversed(folders):
            with contextlib.suppress(OSError):
                folder.rmdir()
        raise
