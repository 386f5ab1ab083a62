"""The formats there are, and `read` and `write`, which choose among them."""

import os
import pathlib
from typing import cast

import numpy as np
from jaxtyping import Shaped

from jaxmorph import Mesh
from jaxmorph._host.files import complete

from ._format import FolderCodec, Format, Source

FORMATS = (
    Format("SU2", (".su2",), "_su2", holds_arrays=False),
    Format("VTK", (".vtu", ".vtk"), "_vtk"),
    Format("gmsh", (".msh",), "_gmsh", holds_arrays=False),
    Format("CGNS", (".cgns",), "cgns.file", holds_arrays=False),
    Format("PLOT3D", (".xyz", ".p3d", ".p3dfmt", ".x", ".g"), "_plot3d", holds_arrays=False),
    Format("OpenFOAM", (), "openfoam.case", holds_arrays=False, is_folder=True),
)


def format_of(path: pathlib.Path) -> Format:
    """The format of a file by its ending, of a folder OpenFOAM; `ValueError`, with those there are, for another ending."""
    for candidate in FORMATS:
        if path.suffix.lower() in candidate.suffixes:
            return candidate
        if candidate.is_folder and (path.is_dir() or path.suffix.strip(".0123456789") == ""):
            return candidate
    known = ", ".join(suffix for candidate in FORMATS for suffix in candidate.suffixes)
    raise ValueError(f"{path}: unknown file ending {path.suffix!r}; known are {known}, and folders of OpenFOAM.")


def read(path: str | os.PathLike[str]) -> Mesh:
    """The mesh in a file: SU2 (.su2), VTK (.vtu, .vtk), gmsh (.msh), CGNS (.cgns), PLOT3D (.xyz, .p3d, .p3dfmt, .x, .g).

    Or in an OpenFOAM case: its folder, or a time folder. VTK, gmsh and CGNS need the extra `io`.

    Coordinates are float64, in the units and the order of the file. Patches are SU2's markers, gmsh's physical groups, CGNS's
    families or boundary conditions, OpenFOAM's patches, the sides of PLOT3D's blocks (or those that a file beside it names: the
    grid's name and `.patches`, lines `NAME BLOCK SIDE` or `NAME BLOCK I1 I2 J1 J2 [K1 K2]`), and in VTK files the point arrays
    called `patch:NAME`; a file that names none has the patch `boundary`. A mesh of cells in the plane has two coordinates when
    all z of the file are equal.

    Raises `ValueError`, with file, line and what was found there, for a file that is not a good mesh; `OSError` for one
    that cannot be opened; `ImportError` when the extra is missing.
    """
    path = pathlib.Path(path)
    return format_of(path).codec().read(path)


def write(
    path: str | os.PathLike[str],
    mesh: Mesh,
    *,
    point_data: dict[str, Shaped[np.ndarray, "n ..."]] | None = None,
    cell_data: dict[str, Shaped[np.ndarray, "c ..."]] | None = None,
) -> None:
    """Writes a mesh in the format of the file's ending. `mesh` may be one read from a file and then `moved`.

    Written to the format it came from, everything but the coordinates is kept, byte for byte in SU2, gmsh, OpenFOAM and PLOT3D
    files, and an unmoved mesh gives the same file. Coordinates read back bit for bit, rounded once where the file is in
    single precision. Between formats, and for generated meshes, points, cells and patches are written; SU2 and gmsh express a
    patch by the boundary faces between its nodes. CGNS, PLOT3D and OpenFOAM take back only meshes that came from them.

    `point_data` (one row a point) and `cell_data` (one row a cell, in the order of `mesh.cells`, one type after the other)
    add arrays to formats that hold any.

    A mesh from an OpenFOAM case goes into a time folder of the case (`case/0.5`: its `polyMesh/points`), or into a new
    folder: a copy of the case's `constant`, `system`, `0` and `0.orig` with other points. The case stays as it is. Cases in
    the plane (`empty` patches) are meshes in two coordinates, and both planes move alike.

    The file appears when it is complete, under a temporary name until then. Raises `ValueError` when `path` is the file
    that the mesh was read from, for arrays of a wrong length, points that are not finite, and what the format cannot say.
    """
    path = pathlib.Path(path)
    chosen = _checked(path, mesh)
    arrays = dict(point_data or {}), dict(cell_data or {})
    if any(arrays) and not chosen.holds_arrays:
        raise ValueError(
            f"{path}: {chosen.name} files hold no arrays; write .vtu to keep {', '.join([*arrays[0], *arrays[1]])}."
        )
    finite = np.asarray(np.isfinite(np.asarray(mesh.points)).all(axis=1))
    if not finite.all():
        raise ValueError(
            f"{path}: {(~finite).sum()} of {len(finite)} points are not finite, first node {np.argmin(finite)}."
        )
    if chosen.is_folder:
        chosen.codec().write(path, mesh, *arrays)
        return
    with complete(path) as partial:
        chosen.codec().write(partial, mesh, *arrays)


def check_output(path: str | os.PathLike[str], mesh: Mesh) -> bool:
    """What `write` checks of a path, before any work. Returns whether its format holds arrays.

    Raises `ValueError` for an unknown ending, a folder that does not exist, and the file that the mesh was read from.
    """
    return _checked(pathlib.Path(path), mesh).holds_arrays


def _checked(path: pathlib.Path, mesh: Mesh) -> Format:
    chosen = format_of(path)
    if not path.parent.is_dir():
        raise ValueError(f"{path}: there is no folder {path.parent}.")
    if chosen.is_folder:
        cast(FolderCodec, chosen.codec()).check(path, mesh)
    if isinstance(mesh.source, Source) and _same_file(path, mesh.source.path):
        raise ValueError(f"{path}: the mesh was read from this file; write to another one.")
    return chosen


def _same_file(a: pathlib.Path, b: pathlib.Path) -> bool:
    """Whether two paths lead to one file."""
    try:
        return os.path.samefile(a, b)
    except OSError:
        return a.resolve() == b.resolve()
