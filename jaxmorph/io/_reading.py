"""The formats there are, and what is read from their files, without JAX."""

import dataclasses
import pathlib
from collections.abc import Iterator

import numpy as np

from jaxmorph._host.cells.adjacency import repeated_cells
from jaxmorph._host.cells.topology import HIGH_ORDER
from jaxmorph._host.package.errors import place_of, warn
from jaxmorph._mesh.exchange import Parts, numbers_of_cells

from .._host.package.text import MESHES, is_folder
from ._format import Format, Source

FORMATS = (
    Format("SU2", MESHES["SU2"], "_su2"),
    Format("VTK", MESHES["VTK"], "vtk.file", holds_arrays=True),
    Format("gmsh", MESHES["gmsh"], "gmsh.file"),
    Format("CGNS", MESHES["CGNS"], "cgns.file"),
    Format("MFEM", MESHES["MFEM"], "mfem.file"),
    Format("MED", MESHES["MED"], "_med"),
    Format("Exodus", MESHES["Exodus"], "_exodus", magic=(b"CDF", b"\x89HDF")),
    Format("PLOT3D", MESHES["PLOT3D"], "_plot3d"),
    Format("OpenFOAM", MESHES["OpenFOAM"], "openfoam.case", is_folder=True),
)


def format_of(path: pathlib.Path, source: object = None) -> Format:
    """Finds the format of a file by its ending, of a folder OpenFOAM.

    Two formats may have an ending. Then the format of `source` decides, from which a mesh to be
    written came, or the first bytes of a file to be read. It raises `ValueError`, with the endings
    there are, for another one.
    """
    found = [candidate for candidate in FORMATS if path.suffix.lower() in candidate.suffixes]
    if len(found) > 1 and isinstance(source, Source):
        found = [candidate for candidate in found if candidate.name == source.format] or found
    elif len(found) > 1 and path.is_file():
        with path.open("rb") as file:
            first = file.read(8)
        known = [candidate for candidate in found if first.startswith(candidate.magic)]
        found = known or [candidate for candidate in found if not candidate.magic]
    found += [candidate for candidate in FORMATS if candidate.is_folder]
    is_folder(path)  # it raises for unknown endings
    return found[0]


def file_mesh(path: pathlib.Path) -> Parts:
    """Reads and checks the mesh in a file or a case, as `jaxmorph.io.read` describes it."""
    mesh = format_of(path).codec().read(path)
    check_nodes(path, mesh)
    notes = (*mesh.source.notes, *_hidden_groups(mesh))
    source = dataclasses.replace(mesh.source, cells=numbers_of_cells(mesh.cells), notes=notes)
    return mesh._replace(source=source)


def _hidden_groups(mesh: Parts) -> Iterator[str]:
    """Yields a sentence on each group whose name is that of a patch, which goes before it."""
    for group, names in mesh.source.groups.items():
        if group in mesh.patches and set(names) != {group}:
            yield f"the group {group} ({', '.join(names)}) has the name of a patch: {group} is the patch alone."


def check_nodes(path: pathlib.Path, mesh: Parts) -> None:
    """Raises `ValueError` for two cells with equal nodes; warns of curved cells with a node twice.

    Pieces of polyhedra may coincide.
    """
    cut, first = None, 0
    if mesh.source.polyhedra is not None:
        cut = np.isin(mesh.source.cell_ids, mesh.source.polyhedra.cut)
    for kind, corners in mesh.cells.items():
        corners = np.asarray(corners)
        chosen = None if cut is None else np.flatnonzero(~cut[first : first + len(corners)])
        first += len(corners)
        twice = repeated_cells(corners) if chosen is None else chosen[repeated_cells(corners[chosen])]
        if len(twice):
            raise ValueError(
                f"{path}: {len(twice)} cells of type {kind} have the nodes of another one, first cell {twice[0]} "
                f"between nodes {corners[twice[0]].tolist()}: remove the copies."
            )
        if kind not in HIGH_ORDER:
            continue
        folded = np.flatnonzero((np.diff(np.sort(corners, axis=1), axis=1) == 0).any(axis=1))
        if len(folded):
            centre = place_of(np.asarray(mesh.points)[corners[folded[0]]].mean(axis=0))
            warn(
                f"{path}: {len(folded)} of {len(corners)} cells of type {kind} name a node twice, first cell {folded[0]} "
                f"near ({centre}): they fold there, or are flat."
            )
