"""Reads and writes meshes: finds the format, and lists what a file holds beside its mesh."""

import contextlib
import dataclasses
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np
from jaxtyping import Float, Shaped
from numpy import ndarray

from jaxmorph import Mesh, Periodic, QualityReport
from jaxmorph._host.cells.adjacency import repeated_cells
from jaxmorph._host.cells.topology import HIGH_ORDER
from jaxmorph._host.package import files
from jaxmorph._host.package.arguments import checked
from jaxmorph._host.package.errors import check_all_finite, place_of, warn
from jaxmorph._host.package.files import PathLike, complete, output_path
from jaxmorph._mesh.exchange import Parts, numbers_of_cells

from ._format import Source, faults_of, only_of, own_source, source_of, warn_of_loss
from .kinds import FOREIGN, FORMATS, Format, ending, is_folder, plugin

FIRST_BYTES = 4096
"""Bytes by which a file is known."""
QUALITIES = ("skewness", "aspect_ratio", "volume_ratio", "jacobian_ratio")


def format_of(path: Path) -> Format:
    """Finds the format of a file to read by its first bytes, then by its ending.

    A folder is an OpenFOAM case. Of the formats of the ending one that the bytes are of comes
    first, then one that may begin by any, then another format. Raises `ValueError` for a kind that
    is not read, and for an unknown ending with the known ones.
    """
    found = _of_ending(path)
    if not path.is_file():
        return _by_name(path, found)
    with path.open("rb") as file:
        first = file.read(FIRST_BYTES).removeprefix(b"\xef\xbb\xbf").lstrip()
    told = [candidate for candidate in FORMATS if candidate.recognises(first)]
    near = [candidate for candidate in found if candidate in told or candidate.begins is None]
    if near:
        return min(near, key=lambda candidate: candidate not in told)
    if len(told) == 1:
        return told[0]
    if told and not found:
        kinds = ", ".join(f"{each.name} ({each.suffixes[0]})" for each in told)
        raise ValueError(f"{path}: by its first bytes this may be {kinds}: give it that ending.")
    for what, begins in FOREIGN.items():
        if re.match(begins, first):
            raise ValueError(f"{path}: by its first bytes this is {what}.")
    return _by_name(path, found)


def format_to_write(path: Path, source: object) -> Format:
    """Finds the format of a file to write by its ending, and by the source of the mesh.

    That is the format of the source for its own ending, and for one that it shares. Raises
    `ValueError`, with the known endings, for another one.
    """
    found = _of_ending(path)
    if isinstance(source, Source):
        is_like = ending(path) == ending(source.path)
        candidates = FORMATS if is_like else found
        own = [candidate for candidate in candidates if candidate.name == source.format]
        found = own or found
    return _by_name(path, found)


def _of_ending(path: Path) -> list[Format]:
    """Lists the formats of an ending, the one first of whose endings it comes first."""
    found = [candidate for candidate in FORMATS if ending(path) in candidate.suffixes]
    return sorted(found, key=lambda each: (each.suffixes.index(ending(path)), each.name))


def _by_name(path: Path, found: Sequence[Format]) -> Format:
    if found:
        return found[0]
    if is_folder(path):  # it raises for unknown endings
        return next(candidate for candidate in FORMATS if candidate.is_folder)
    point = plugin(path)
    return Format(point.name, _Plugin(point.name, point.load()), takes_any=True)


class _Plugin(NamedTuple):
    """A format of another package: a `codec` with `read(path)`, and perhaps `write(path, mesh)`."""

    name: str
    codec: Any

    def read(self, path: Path) -> Parts:
        mesh = self.codec.read(path)
        if not isinstance(mesh, Mesh):
            raise ValueError(
                f"the format {self.name} of another package returned {type(mesh).__name__}, no "
                "Mesh."
            )
        return Parts(
            mesh.points, dict(mesh.cells), dict(mesh.patches), Source(path, self.name, mesh.source)
        )

    def check(self, path: Path, mesh: Mesh) -> None:
        if not hasattr(self.codec, "write"):
            raise ValueError(
                f"files of the format {self.name} are read, and not written; write .vtu."
            )

    def write(self, path: Path, mesh: Mesh) -> None:
        source = source_of(mesh, self.name)
        self.codec.write(
            path, Mesh(mesh.points, mesh.cells, mesh.patches, source and source.content)
        )


def check_nodes(path: Path, mesh: Parts) -> None:
    """Refuses duplicate cells but pieces of polyhedra; warns of duplicate nodes in curved cells."""
    whole = mesh.source.polyhedra
    first = 0
    for kind, corners in mesh.cells.items():
        corners = np.asarray(corners)
        rows = np.arange(len(corners))
        if whole is not None:
            rows = rows[~np.isin(mesh.source.cell_ids[first + rows], whole.cut)]
        first += len(corners)
        twice = rows[repeated_cells(corners[rows])]
        if len(twice):
            raise ValueError(
                f"{path}: {len(twice)} cells of type {kind} have the nodes of another one, first "
                f"cell {twice[0]} "
                f"between nodes {corners[twice[0]].tolist()}: remove the copies."
            )
        folded = np.flatnonzero((np.diff(np.sort(corners, axis=1), axis=1) == 0).any(axis=1))
        if kind in HIGH_ORDER and len(folded):
            centre = place_of(np.asarray(mesh.points)[corners[folded[0]]].mean(axis=0))
            warn(
                f"{path}: {len(folded)} of {len(corners)} cells of type {kind} name a node twice, "
                f"first cell {folded[0]} "
                f"near ({centre}): they fold there, or are flat."
            )


@checked
def read(path: PathLike, *, tags: PathLike | None = None) -> Mesh:
    """Reads the mesh in a file or an OpenFOAM case.

    Files are SU2 (.su2), VTK (.vtu, .vtk, .vts, .vtp, .pvtu, .vtm), gmsh (.msh), Fluent (.msh,
    .cas, .cas.h5), CGNS (.cgns), MFEM (.mesh), MED (.med). Others are Exodus (.e, .exo, .ex2,
    .exoii, .g), PLOT3D (.xyz, .p3d, .p3dfmt, .x, .g, .grd, .fmt) and Medit (.mesh, .meshb). Abaqus
    and CalculiX (.inp), XDMF (.xdmf, .xmf), I-deas (.unv) and AFLR (.ugrid) are read, too. Any may
    end in .gz. For an OpenFOAM case `path` is its folder or a time folder. VTK, XDMF, CGNS, MED,
    Exodus and .cas.h5 need the extra `io`.

    Coordinates are float64, in the units and the order of the file. A mesh of 2-D cells has two
    coordinates when all z of the file are equal. Patches are

    - SU2's markers, gmsh's physical groups, Fluent's zones of faces, CGNS's families or boundary
      conditions, MED's groups, OpenFOAM's patches, VTK's point arrays called `patch:NAME`;
    - sets and surfaces of Abaqus, groups of I-deas, references of Medit, `medit:ref_3`, and numbers
      of AFLR's surfaces, `ugrid:ref_3`;
    - MFEM's attributes of boundary elements, `boundary_3` for attribute 3; named sets are groups;
    - Exodus's side sets and node sets, and its blocks of lower dimension;
    - the sides of PLOT3D's blocks, or patches from a file beside the grid, with its name and the
      ending `.patches`. Its lines are `NAME BLOCK SIDE` or `NAME BLOCK I1 I2 J1 J2 [K1 K2]`;
    - XDMF's numbers of facets, `facet_tags_3`, in the same file or in `tags`;
    - the one patch `boundary` for a file that names none.

    Of two patches with one name but different nodes, the second gets a suffix, `wall_nodes_20`.
    `mesh.source.notes` lists these, and what the mesh leaves out of the file.

    **Arguments:**

    - `path`: the file or folder.
    - `tags`: an XDMF file of numbered facets of an XDMF mesh, as FEniCS has them. Their corners
      are nodes of the mesh, by place. Default: none.

    **Returns:** a `Mesh` with its source, so that `write` can give the file back with other
    coordinates.

    **Raises:** `ValueError`, with file and line, for a file that is not a good mesh; `OSError` for
    a file that cannot be opened; `ImportError` for a missing extra.
    """
    path = files.input_path(path)
    with files.unpack(path) as file:
        try:
            with faults_of(file):
                mesh = _read_by_format(file, tags)
        except ValueError as error:
            raise ValueError(str(error).replace(str(file), str(path))) from error
    if file != path:
        if hasattr(type(mesh.source.content), "is_current"):
            raise ValueError(
                f"{path}: files of {mesh.source.format} are copied when they are written: unpack "
                "it first."
            )
        mesh = mesh._replace(source=dataclasses.replace(mesh.source, path=path))
    check_nodes(path, mesh)
    groups = {group: names for group, names in mesh.source.groups.items() if group in mesh.patches}
    hidden = (
        f"the group {group} ({', '.join(names)}) has the name of a patch: {group} is the patch "
        "alone."
        for group, names in groups.items()
        if {*names} != {group}
    )
    notes = (*mesh.source.notes, *hidden)
    source = dataclasses.replace(mesh.source, cells=numbers_of_cells(mesh.cells), notes=notes)
    return Mesh(*mesh._replace(source=source))


def _read_by_format(file: Path, tags: PathLike | None) -> Parts:
    chosen = format_of(file)
    if tags is None:
        return chosen.codec().read(file)
    if chosen.name != "XDMF":
        raise ValueError(f"`tags` are for XDMF; patches of {chosen.name} are in the file itself.")
    return chosen.codec().read(file, files.input_path(tags))


@checked
def write(
    path: PathLike,
    mesh: Mesh,
    *,
    point_data: dict[str, Shaped[ndarray, "n ..."]] | None = None,
    cell_data: dict[str, Shaped[ndarray, "c ..."]] | None = None,
) -> None:
    """Writes a mesh in the format of the file's ending.

    A mesh that was read and `moved` keeps everything but its coordinates in its own format, byte
    for byte but in VTK and XDMF files, in which all is kept. Coordinates read back bit for bit,
    except for rounding to single precision (`as_written`). Other meshes, and other formats, get
    points, cells and patches. SU2, gmsh and CGNS
    express a patch by the boundary faces between its nodes. Other formats take back only meshes
    that came from them. A file that ends in .gz is packed.

    A mesh from an OpenFOAM case goes into a time folder of the case (`case/0.5`: its
    `polyMesh/points`), or into a new folder. That is a copy of the case's `constant`, `system`, `0`
    and `0.orig` with other points. Both planes of a 2-D case move alike. With new cells (`remesh`)
    it goes into a new folder, without zones. The file has a temporary name until it is complete.

    **Arguments:**

    - `path`: the file or folder to write; its folder must exist.
    - `mesh`: the mesh.
    - `point_data`, `cell_data`: arrays by name, one row a point or a cell, in the order of
      `mesh.cells`, type by type. Only for formats that hold arrays. Default: none.

    **Raises:** `ValueError` when `path` is the file that the mesh was read from, for arrays of a
    wrong length, points that are not finite, and what the format cannot express.
    """
    chosen = _check_path(path, mesh)
    path = Path(path)
    arrays = dict(point_data or {}), dict(cell_data or {})
    if any(arrays) and not chosen.holds_arrays:
        raise ValueError(
            f"{path}: {chosen.name} files hold no arrays; write .vtu to keep "
            f"{', '.join([*arrays[0], *arrays[1]])}."
        )
    as_written(path, mesh)
    appear = contextlib.nullcontext if chosen.is_folder else complete
    codec = chosen.codec()
    with appear(path) as target, files.pack_into(target, path.stem) as file:
        if hasattr(codec, "write"):
            codec.write(file, mesh, *arrays[: 2 * chosen.holds_arrays])
        elif (source := source_of(mesh, chosen.name)) is not None:
            source.content.write(file, np.asarray(mesh.points))
        else:
            with file.open("wb") as stream:
                stream.writelines(codec.new(mesh))


@checked
def as_written(path: PathLike, mesh: Mesh) -> Float[ndarray, "n d"]:
    """Computes the points that reading a written file will give, bit for bit; writes nothing.

    A file in single precision rounds them: a small motion or the first cells at a wall may be lost.

    **Arguments:**

    - `path`, `mesh`: as `write` takes them.

    **Returns:** points (n, d), those of `mesh` for a file in double precision.

    **Raises:** `ValueError` for an unknown ending, and a folder that does not exist.

    **Warns:** where rounding takes more than a tenth of the motion, or of an edge of a cell.
    """
    chosen = format_to_write(Path(path), mesh.source)
    path = files.output_path(path, folder=chosen.is_folder)
    points = np.asarray(mesh.points)
    source = source_of(mesh, chosen.name)
    if source is None or source.held is None:
        return points
    return warn_of_loss(path, mesh.cells, source.held, points)


@checked
def check_output(path: PathLike, mesh: Mesh | PathLike) -> bool:
    """Checks a path as `write` does, before any work.

    **Arguments:**

    - `path`, `mesh`: as `write` takes them. Of the file of a mesh that is not read yet, the format
      is compared.

    **Returns:** True if the format holds arrays.

    **Raises:** `ValueError` as `write` does, for what is wrong whatever the points are.
    `ImportError` when the extra is missing.
    """
    return _check_path(path, mesh).holds_arrays


def _check_path(name: PathLike, mesh: Mesh | PathLike) -> Format:
    if isinstance(mesh, Mesh):
        source = mesh.source
    else:
        source = Source(Path(mesh), format_of(Path(mesh)).name, None)
    chosen = format_to_write(Path(name), source)
    path = files.output_path(name, folder=chosen.is_folder)
    if isinstance(source, Source) and files.is_same(path, source.path):
        raise ValueError(f"{path}: the mesh was read from this file; write to another one.")
    codec = chosen.codec()
    file = path.with_suffix("") if path.suffix.lower() == ".gz" else path
    with faults_of(path):
        if hasattr(codec, "check_ending"):
            codec.check_ending(file)
        if not isinstance(mesh, Mesh):
            # what is in a packed file is not known by its name
            is_packed = Path(mesh).suffix.lower() == ".gz"
            if not (chosen.takes_any or source.format == chosen.name or is_packed):
                raise ValueError(only_of(chosen.name, ".su2"))
            return chosen
        if hasattr(codec, "check"):
            codec.check(file, mesh)
        else:
            own_source(mesh, chosen.name)
        check_all_finite(np.asarray(mesh.points))
    return chosen


@checked
def losses(path: PathLike, mesh: Mesh) -> tuple[str, ...]:
    """Lists what a mesh and its file know, and a file at `path` will not have.

    **Arguments:**

    - `path`, `mesh`: as `write` takes them.

    **Returns:** sentences; none where the file goes back to its own format.

    **Raises:** `ValueError` as `check_output` does.
    """
    chosen = _check_path(path, mesh)
    source = mesh.source
    if not isinstance(source, Source) or source_of(mesh, chosen.name) is not None:
        return ()
    names = {
        "kinds of patches": dict.fromkeys(mesh.kinds.values()),
        "groups of patches": mesh.groups,
        "periodic pairs of patches": source.periodic and [str(len(source.periodic))],
        "arrays": getattr(source.content, "arrays", ()),
    }
    told = [f"{what} are lost: {', '.join(lost)}." for what, lost in names.items() if lost]
    told += ["whole polyhedra are lost; they are cut."] * (source.polyhedra is not None)
    return (*told, *source.notes)


@checked
def periodic(mesh: Mesh) -> tuple[Periodic, ...]:
    """Lists a file's periodic patches: of OpenFOAM `cyclic`, of CGNS interfaces, of gmsh groups.

    **Arguments:**

    - `mesh`: what `read` returned.

    **Returns:** pairs for `prepare(..., periodic=)`; none for other formats.
    """
    return getattr(mesh.source, "periodic", ())


@checked
def symmetry(mesh: Mesh) -> tuple[str, ...]:
    """Lists a file's symmetry patches: OpenFOAM's `symmetry` and `symmetryPlane`, axes of wedges.

    CGNS's are conditions or families of the type `BCSymmetryPlane`.

    **Arguments:**

    - `mesh`: what `read` returned.

    **Returns:** names for `prepare(..., symmetry=)`; none for other formats.
    """
    return getattr(mesh.source, "symmetry", ())


@checked
def write_moved(path: PathLike, mesh: Mesh, moved: Mesh, report: QualityReport) -> None:
    """Writes a moved mesh, with displacement and cell quality where the format holds arrays.

    **Arguments:**

    - `path`: the file; its ending chooses the format, as for `write`.
    - `mesh`, `moved`: the undeformed mesh and the moved one.
    - `report`: what `quality(mesh, moved.points)` gives.

    **Raises:** `ValueError` as `write` does.
    """
    path = Path(path)
    if not check_output(path, mesh):
        write(path, moved)
        return
    before = np.asarray(mesh.points)
    after = np.asarray(moved.points)
    if before.shape != after.shape:
        raise ValueError(
            f"`moved` has points of shape {after.shape}, `mesh` {before.shape}. It must be "
            "`mesh`, moved."
        )
    cell_data = {name: np.asarray(getattr(report, name)) for name in QUALITIES}
    cell_data["is_inverted"] = np.asarray(report.is_inverted).astype(np.uint8)
    write(path, moved, point_data={"displacement": after - before}, cell_data=cell_data)


@checked
def write_pvd(path: PathLike, files: Sequence[PathLike], times: Sequence[float]) -> None:
    """Writes ParaView's collection (.pvd): each of `files`, by its name, at one of `times`."""
    path = output_path(path, ".pvd")
    if len(files) != len(times):
        raise ValueError(f"`times` has {len(times)} numbers for {len(files)} `files`.")
    names = [quoteattr(Path(file).name) for file in files]
    rows = [
        f'    <DataSet timestep="{t!r}" part="0" file={name}/>'
        for name, t in zip(names, times, strict=True)
    ]
    head = [
        '<?xml version="1.0"?>',
        '<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">',
    ]
    text = "\n".join([*head, "  <Collection>", *rows, "  </Collection>", "</VTKFile>", ""])
    with complete(path) as partial:
        partial.write_bytes(text.encode())
