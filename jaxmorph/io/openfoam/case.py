"""OpenFOAM's cases: `constant/polyMesh`, text or binary, plain or compressed (doc.openfoam.com)."""

import contextlib
import dataclasses
import functools
import gzip
import os
import pathlib
import re
import shutil
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy import ndarray

from jaxmorph._boundary.periodic import Periodic
from jaxmorph._host.package.errors import check_all_finite, warn
from jaxmorph._host.package.files import complete, is_same
from jaxmorph._host.rows import Rows, join_ids
from jaxmorph._mesh.exchange import Parts, checked_parts, gathered
from jaxmorph._mesh.faces import Faces, standard_cells
from jaxmorph._mesh.polyhedra import Polyhedra, tetrahedra

from .._format import EVERYTHING, MeshLike, Source, content_of, faults_of, own_source
from .._text import Pieces, replace_numbers
from .file import PARENTHESES, Boundary, FoamFile, load_faces, load_file, read_patches
from .new import new_files, refuse_patches
from .plane import Front, check_cyclic, find_layer, find_sector, list_cyclic_pairs, make_front_cells

NAME = "OpenFOAM"
COPIED = ("constant", "system", "0", "0.orig")
SYMMETRY_PATCHES = ("symmetry", "symmetryPlane")
ZONES = ("cellZones", "faceZones", "pointZones")
PLANE_TYPES = ("empty", "wedge")
"""Types of patches in front of and behind the one layer of cells of a case in two dimensions."""

PatchNodes = dict[str, ndarray]


@dataclasses.dataclass(frozen=True, eq=False)
class CaseContent:
    """A case's file of points, its values, the folder of faces, planes in 2-D, shared points."""

    file: FoamFile
    points: ndarray
    topology: pathlib.Path
    plane: Front | None
    shared: ndarray

    def in_file(self, points: ndarray) -> ndarray:
        """Computes the points (N, 3) of the file, in 2-D both planes'; unmoved ones as read."""
        moved = points if self.plane is None else self.plane.in_space(self.points, points)
        return np.where(moved == self.points.astype(moved.dtype), self.points, moved)

    def in_mesh(self, values: ndarray) -> ndarray:
        return values if self.plane is None else self.plane.fitted(values).in_plane(values)

    @property
    def singles(self) -> Sequence[tuple[slice, Any]]:
        return EVERYTHING if self.file.is_binary and self.file.dtype("scalar").itemsize == 4 else ()

    @property
    def known(self) -> dict[str, Any]:
        """Fields of the source: the file does not hold all digits if planes may be tilted."""
        is_held = not self.singles and (self.plane is None or self.plane.kind == "empty")
        nodes = None if self.plane is None else self.plane.file_nodes()
        return {"in_file": self.in_file, "held": None if is_held else self, "file_nodes": nodes}

    @functools.cached_property
    def point_ids(self) -> ndarray:
        """The numbers (n,) of a part's points in the whole mesh: its `pointProcAddressing`."""
        try:
            ids = load_file(self.topology, "pointProcAddressing").numbers("label").ravel()
        except FileNotFoundError:
            raise ValueError(
                f"{self.topology}: there is no pointProcAddressing, so it is not known which "
                "points the processors share. "
                "Run reconstructParMesh -constant in the case, which writes it, or decomposePar "
                "again."
            ) from None
        if len(ids) != len(self.points) or ids.min(initial=0) < 0 or len(Rows(ids).repeated):
            raise ValueError(
                f"{self.topology / 'pointProcAddressing'}: {len(ids)} numbers for "
                f"{len(self.points)} points; each point has "
                "one of its own, from 0 on. Run decomposePar again."
            )
        return ids

    @property
    def case(self) -> pathlib.Path | None:
        above = self.topology.resolve().parents
        inner = [folder for folder in above if folder.name == "constant"] or list(
            filter(is_time, above)
        )
        return inner[0].parent if inner else None

    @property
    def place(self) -> pathlib.Path:
        """The folder of the mesh in `constant` or a time: `polyMesh`, or that of a region."""
        case = self.case
        here = self.topology.resolve()
        return pathlib.Path(
            "polyMesh" if case is None else here.relative_to(case / here.relative_to(case).parts[0])
        )


def read(path: pathlib.Path) -> Parts:
    """Reads the mesh of a case, a time folder, or a folder polyMesh; nodes in file order.

    `patches` come from `boundary`, `groups` from their `inGroups`. Cells of other shapes than the
    standard types are cut into tetrahedra between their own nodes. With `empty` patches the plane
    in front is the mesh, in two coordinates. So it is with `wedge` patches, in coordinates along
    the axis and away from it; nodes on the axis are the patch `axis`.

    In a folder `processor3` of a decomposed case, faces to other processors are no boundary, and
    `processorXtoY` is no patch. Faces of a cyclic patch whose partners are on another processor
    stay in their cyclic patch.
    """
    here, folder = _find_folders(path)
    boundary = read_patches(load_file(folder, "boundary"))
    planes = _select_planes(path, boundary)
    file, points = _load_points(here)
    faces = load_faces(folder, boundary, len(points))
    nodes = _gather_nodes(faces, boundary)
    with faults_of(path):
        mesh, ids, whole, plane = (_make_in_plane if planes else _make_in_space)(
            faces, points, nodes, planes
        )
    between = faces.padded(join_ids(patch.faces for patch in boundary if patch.is_between))
    # a caller may change the mesh's points in place, and the file's values must stay
    kept = points.copy() if plane is None else points
    content = CaseContent(file, kept, folder, plane, np.unique(between[between >= 0]))
    if plane is not None:
        between = plane.ids(between).reshape(-1, 2)
    joined = np.concatenate([ids[kind] for kind in mesh.cells])
    source = Source(
        file.path,
        NAME,
        content,
        whole,
        None if (joined[1:] > joined[:-1]).all() else joined,
        between=between if len(between) else None,
        notes=(*_note_zones(folder, planes), *_note_other_times(content, here)),
        **content.known,
        **_describe_patches(boundary, mesh, plane),
    )
    return mesh._replace(source=source)


def _gather_nodes(faces: Faces, boundary: Boundary) -> PatchNodes:
    """Lists nodes of patches, copied: views would keep all labels.

    Faces of a `processorCyclic` patch belong to the cyclic patch that it refers to.
    """
    own = [patch for patch in boundary if not patch.is_between]
    return gathered(
        (patch.refers or patch.name, faces.nodes(patch.start, patch.end)) for patch in own
    )


def _select_planes(path: pathlib.Path, boundary: Boundary) -> Boundary:
    planes = [patch for patch in boundary if patch.type in PLANE_TYPES]
    kinds = [patch.type for patch in planes if patch.size]
    if "wedge" in kinds and kinds != ["wedge"] * 2:
        names = ", ".join(patch.name for patch in planes if patch.size)
        raise ValueError(
            f"{path}: patches of type wedge ({names}); an axisymmetric case has two, and none of "
            "type empty."
        )
    return planes if kinds else []


def _describe_patches(boundary: Boundary, mesh: Parts, plane: Front | None) -> dict[str, Any]:
    own = [patch for patch in boundary if patch.name in mesh.patches or patch.type in PLANE_TYPES]
    kinds = {patch.name: patch.type for patch in own}
    symmetry = [patch.name for patch in own if patch.type in SYMMETRY_PATCHES and patch.size]
    if plane is not None and plane.on_axis.any():
        symmetry = [*symmetry, "axis"]
        kinds = kinds | {"axis": "axis"}
    groups = dict.fromkeys(name for patch in own for name in patch.groups)
    return {
        "groups": {
            group: tuple(patch.name for patch in own if group in patch.groups) for group in groups
        },
        "periodic": _list_periodic(boundary, own),
        "symmetry": tuple(symmetry),
        "kinds": kinds,
    }


def _list_periodic(boundary: Boundary, own: Boundary) -> tuple[Periodic, ...]:
    """Lists the cyclic pairs, unless partners of their faces are on another processor."""
    is_cut = any(patch.refers and patch.size for patch in boundary)
    pairs = () if is_cut else list_cyclic_pairs(own)
    return tuple(Periodic(a.name, b.name) for a, b in pairs if a.size == b.size > 0)


def _origin_of(mesh: MeshLike) -> CaseContent | None:
    """The content of the case whose cells were replaced; None for other meshes."""
    is_own = getattr(mesh.source, "format", "") == NAME
    return mesh.source.origin if is_own else None


def check(path: pathlib.Path, mesh: MeshLike) -> None:
    origin = _origin_of(mesh)
    if origin is not None:
        _check_new(path, origin)
        return
    content = own_source(mesh, NAME).content
    case = content.case
    if not is_time(path):
        if case is None:
            raise ValueError(
                f"{path}: {content.file.path.parent} is in no case with a folder constant; "
                "nothing to copy."
            )
        check_new_folder(
            path, case, f"a new folder, or a time folder of the case such as {case / '1'}"
        )
    elif case is None or not path.parent.is_dir() or not os.path.samefile(path.parent, case):
        raise ValueError(
            f"{path}: a time folder must be one of the case that the mesh was read from, {case}."
        )
    elif any(
        is_same(path / content.place / name, content.file.path) for name in ("points", "points.gz")
    ):
        raise ValueError(f"{path}: the mesh was read from this folder; write to another one.")


def _check_new(path: pathlib.Path, origin: CaseContent) -> None:
    case = origin.case
    if case is None or is_time(path):
        raise ValueError(
            f"{path}: a mesh with new cells goes into a new folder, with a copy of its case."
        )
    check_new_folder(path, case, "a new folder")
    refuse_patches(origin.topology)


def check_new_folder(path: pathlib.Path, case: pathlib.Path, remedy: str) -> None:
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise ValueError(f"{path}: exists; name {remedy}.")
    if case.resolve() in path.resolve().parents:
        raise ValueError(
            f"{path}: a new case cannot be inside of the case that the mesh was read from."
        )


def write(path: pathlib.Path, mesh: MeshLike) -> None:
    """Writes `points` in a time folder, or a new case: `constant`, `system`, `0`, `0.orig`."""
    origin = _origin_of(mesh)
    if origin is not None:
        _write_new(path, mesh, origin)
        return
    content = content_of(mesh, NAME)
    points = compute_file_points(mesh)
    case = content.case
    parts = [] if case is None else [part for part in case.glob("processor*") if part.is_dir()]
    if parts:
        fate = "keep the old points" if is_time(path) else "are not copied"
        warn(
            f"{path}: the case is decomposed, and its {len(parts)} folders processor* {fate}. "
            "Run decomposePar -force on the written mesh before a parallel run."
        )
    write_points(path, content, points)


def _write_new(path: pathlib.Path, mesh: MeshLike, origin: CaseContent) -> None:
    files = new_files(mesh, origin.topology, origin.plane, origin.points)
    case = origin.case
    assert case is not None
    zones = [name for name in ZONES if _count_zones(origin.topology, name) > 0]
    if zones:
        warn(f"{path}: {', '.join(zones)} are of the old cells and faces, and are not written.")
    with complete(path, folder=True) as partial:
        copy_case(case, partial)
        for folder in partial.iterdir():
            shutil.rmtree(folder / origin.place, ignore_errors=True)
        target = partial / "constant" / origin.place
        target.mkdir(parents=True)
        for name, text in files.items():
            (target / name).write_bytes(text)


def compute_file_points(mesh: MeshLike) -> ndarray:
    """Computes the file's points (N, 3) of a mesh, in 2-D both planes'; checks cyclic patches."""
    content = content_of(mesh, NAME)
    points = content.in_file(np.asarray(mesh.points))
    check_cyclic(content.topology, content.points, points)
    return points


def write_points(path: pathlib.Path, content: CaseContent, points: ndarray) -> None:
    case = content.case
    name = content.file.path.name
    if not is_time(path):
        assert case is not None
        with complete(path, folder=True) as partial:
            copy_case(case, partial)
            folder = partial / "constant" / content.place
            shutil.copytree(content.topology, folder, dirs_exist_ok=True)
            for old in ("points", "points.gz"):
                (folder / old).unlink(missing_ok=True)
            _write_file(folder / name, content, points)
        return
    file = path / content.place / name
    # the first of the folders that is not there yet appears complete, else the file does
    new = next(
        (
            folder
            for folder in reversed(file.relative_to(path).parents)
            if not (path / folder).exists()
        ),
        None,
    )
    target = file if new is None else path / new
    with complete(target, folder=target != file) as partial:
        inner = partial / file.relative_to(target)
        inner.parent.mkdir(parents=True, exist_ok=True)
        _write_file(inner, content, points)
    file.with_name({"points": "points.gz", "points.gz": "points"}[name]).unlink(missing_ok=True)


def copy_case(case: pathlib.Path, folder: pathlib.Path, **options: Any) -> None:
    for name in COPIED:
        if (case / name).is_dir():
            shutil.copytree(case / name, folder / name, **options)


def _write_file(path: pathlib.Path, content: CaseContent, points: ndarray) -> None:
    file = content.file
    if np.array_equal(points, content.points):
        path.write_bytes(file.raw)
        return
    with path.open("wb") as out:
        if path.suffix != ".gz":
            out.writelines(_replace_points(content, points))
            return
        with gzip.GzipFile(
            file.path.stem, "wb", 6, out
        ) as packed:  # it keeps a name: not the temporary one
            packed.writelines(_replace_points(content, points))


def _replace_points(content: CaseContent, points: ndarray) -> Pieces:
    file = content.file
    place = file.list_at(file.end)
    if place.uniform:
        raise file.error("a list with one value for all points cannot hold moved ones")
    if file.is_binary:
        values = points.astype(file.dtype("scalar")).tobytes()
        yield from (file.data[: place.start], values, file.data[place.start + len(values) :])
    else:
        part = slice(place.start, file.end_of_text(place.start))
        yield from replace_numbers(
            file.data,
            part,
            content.points.ravel(),
            points.ravel(),
            plain=lambda text: text.translate(PARENTHESES),
        )


def _load_points(folder: pathlib.Path) -> tuple[FoamFile, ndarray]:
    file = load_file(folder, "points")
    points = file.numbers("scalar", 3)
    if not len(points):
        raise file.error("no points")
    with faults_of(file.path):
        check_all_finite(points)
    return file, points


Found = tuple[Parts, PatchNodes, Polyhedra | None, Front | None]
"""A mesh, the case's number of each cell by type, whole cells if some are cut, and planes."""


def _make_in_space(faces: Faces, points: ndarray, nodes: PatchNodes, planes: Boundary) -> Found:
    cells, ids = standard_cells(faces)
    whole = None
    if "polyhedron" in ids:
        whole = Polyhedra(faces, ids.pop("polyhedron"))
        pieces, owners = tetrahedra(faces, whole.cut, points)
        cells = gathered([*cells.items(), ("tetra", pieces)])
        ids = gathered([*ids.items(), ("tetra", owners)])
    return checked_parts(points, cells, nodes), ids, whole, None


def _make_in_plane(faces: Faces, points: ndarray, nodes: PatchNodes, planes: Boundary) -> Found:
    chosen = np.concatenate([patch.faces for patch in planes])
    kinds = {patch.type for patch in planes if patch.size}
    # no patches of the mesh in one of them
    sides = [ids for patch in planes if len(ids := nodes.pop(patch.name))]
    plane = (
        find_sector(faces, points, sides)
        if kinds == {"wedge"}
        else find_layer(faces, points, chosen)
    )
    own = {name: plane.ids(ids) for name, ids in nodes.items()}
    axis = np.flatnonzero(plane.on_axis)
    if len(axis):
        if len(own.get("axis", ())):
            raise ValueError(
                "the patch axis has faces; nodes on the axis get its name: call it otherwise in "
                "boundary."
            )
        own["axis"] = axis
    cells, ids, whole = make_front_cells(faces, points, chosen, plane)
    return checked_parts(plane.in_plane(points), cells, own), ids, whole, plane


def _find_folders(path: pathlib.Path) -> tuple[pathlib.Path, pathlib.Path]:
    places = [path / "constant" / "polyMesh", path / "polyMesh"]
    here = (
        path
        if path.name == "polyMesh"
        else next((place for place in places if place.is_dir()), None)
    )
    if here is None:
        raise ValueError(
            f"{path}: no OpenFOAM case, there is no folder constant/polyMesh in it."
            f"{_hint_at_parts(path)}"
        )
    if any((here / name).is_file() for name in ("faces", "faces.gz")):
        return here, here
    # points alone are those of a time: the faces have the same place in the case's constant
    time = next(
        (folder for folder in here.absolute().parents if is_time(folder)), here.absolute().parent
    )
    return here, time.parent / "constant" / here.absolute().relative_to(time)


def _note_zones(topology: pathlib.Path, planes: Boundary) -> Iterator[str]:
    sizes = {name: _count_zones(topology, name) for name in ZONES}
    zones = [f"{size} {name}" for name, size in sizes.items() if size > 0]
    if zones:
        yield f"{', '.join(zones)} are not read: zones are no patches, and stay in the case."
    if topology.parent.name == "constant" and (others := list_regions(topology.parent)):
        names = ", ".join(others)
        first = topology.parent / others[0]
        yield f"the regions {names} have meshes of their own: {first} is the first."
    if planes:
        names = ", ".join(f"{patch.name} ({patch.type})" for patch in planes if patch.size)
        yield f"the planes {names} are no patches: the mesh lies in one of them."


def _note_other_times(content: CaseContent, here: pathlib.Path) -> Iterator[str]:
    """Names the last time folder that has points of its own for the mesh read in `constant`."""
    case = content.case
    folder = content.topology
    if case is None or here != folder or folder.resolve().relative_to(case).parts[0] != "constant":
        return
    times = [
        folder
        for folder in filter(is_time, case.iterdir())
        if any((folder / content.place / name).is_file() for name in ("points", "points.gz"))
    ]
    if times:
        last = max(times, key=lambda folder: float(folder.name))
        yield (
            f"the points of constant are read, and {last.name}/{content.place} has others: "
            f"{case / last.name} is the mesh with those."
        )


def _count_zones(topology: pathlib.Path, name: str) -> int:
    with contextlib.suppress(OSError, ValueError):
        file = load_file(topology, name)
        return file.list_at(file.end).size
    return 0


def list_regions(folder: pathlib.Path) -> list[str]:
    return sorted(mesh.parent.name for mesh in folder.glob("*/polyMesh") if mesh.is_dir())


def _hint_at_parts(path: pathlib.Path) -> str:
    here = path if is_time(path) else path / "constant"
    parts = sorted(path.glob("processor*"))
    if found := list_regions(here):
        return (
            f" Its regions, {', '.join(found)}, have meshes of their own, each read by itself: "
            f"{here / found[0]}."
        )
    if not parts:
        return ""
    inner = list_regions(parts[0] / "constant")
    names = f", and has the regions {', '.join(inner)}" if inner else ""
    place = pathlib.Path("constant", *inner[:1]) if inner else pathlib.Path()
    return (
        f" It is decomposed{names}: jaxmorph deform --decomposed {path / place}, or take "
        f"{parts[0] / place}."
    )


def is_time(path: pathlib.Path) -> bool:
    return re.fullmatch(r"\d+(\.\d*)?(e[+-]?\d+)?", path.name) is not None
