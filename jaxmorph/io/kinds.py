"""Kinds of files: names, modules, endings, first bytes; what is not read. It needs no NumPy."""

import importlib
import pathlib
import re
from typing import Any, NamedTuple


class Format(NamedTuple):
    """A format: its name, the module of this package (or the codec) that reads and writes it.

    `endings` are those of its files, in small letters; a format without any has folders.
    `begins` is a pattern of the first bytes of its files, after blanks; None where any may come.
    One that `takes_any` writes meshes of other formats, too.
    The module, and with it an extra, is imported at first use. It defines

    - `read(path) -> Parts`: `ValueError` names file, place and what was found;
    - `new(mesh)`: yields the bytes of a new file, for a mesh from elsewhere. For one that came from
      the format, `write(path, points)` of its source's content makes the file;
    - `write(path, mesh)`, in place of both: one that `holds_arrays` takes `point_data` and
      `cell_data` too, in the order of `mesh.cells`, type by type. A folder is written complete or
      not at all;
    - `check(path, mesh)`: raises `ValueError` for a mesh that cannot be written, whatever its
      points. Without it the format takes back only meshes that came from it.
    """

    name: str
    module: Any
    endings: str = ""
    holds_arrays: bool = False
    is_folder: bool = False
    begins: bytes | None = None
    takes_any: bool = False

    @property
    def suffixes(self) -> tuple[str, ...]:
        return tuple(self.endings.split())

    def recognises(self, first: bytes) -> bool:
        """Checks whether a file that begins so is one of the format, by its bytes alone."""
        return self.begins is not None and re.match(self.begins, first, re.DOTALL) is not None

    def codec(self) -> Any:
        if not isinstance(self.module, str):
            return self.module
        return importlib.import_module(f"{__package__}.{self.module}")


XML = rb"(?:<\?xml.{0,200}?\?>\s*)?(?:<!(?:--.*?--|DOCTYPE[^<\[>]*(?:\[.*?\]\s*)?)>\s*)*"
"""What comes before the first element of a file in XML."""
HDF = rb"\x89HDF"

FORMATS = (
    Format(
        "SU2",
        "_su2",
        ".su2",
        begins=rb"(?:%[^\n]*\s+)*(?:NDIME|NZONE|IZONE|NELEM|NPOIN|NMARK)\s*=",
        takes_any=True,
    ),
    Format(
        "VTK",
        "_vtk",
        ".vtu .vtk .vts .vtp .pvtu .vtm",
        holds_arrays=True,
        begins=rb"# vtk DataFile|" + XML + rb"<VTKFile\b",
        takes_any=True,
    ),
    Format(
        "gmsh",
        "_gmsh",
        ".msh .msh2 .msh4",
        begins=rb"\$(?:MeshFormat|NOD|Comments)\b",
        takes_any=True,
    ),
    Format("Fluent", "_fluent", ".cas .msh", begins=rb"\(\s*\d+\s"),
    Format("Fluent HDF5", "_fluent_h5", ".h5", begins=HDF),
    Format(
        "CGNS",
        "cgns.file",
        ".cgns",
        begins=HDF + rb"|.{4}ADF Database",
        takes_any=True,
    ),
    Format("MFEM", "_mfem", ".mesh", begins=rb"MFEM "),
    Format("MED", "_med", ".med", begins=HDF),
    Format("Exodus", "_exodus", ".e .exo .ex2 .exoii .g", begins=HDF + rb"|CDF[\1\2\5]"),
    Format("PLOT3D", "_plot3d", ".xyz .p3d .p3dfmt .x .g .grd .fmt .ufmt .bin .p2d .p2dfmt"),
    Format(
        "Medit",
        "_medit",
        ".mesh .meshb",
        begins=rb"(?:#[^\n]*\s+)*MeshVersion|\x01\0\0\0|\0\0\0\x01",
    ),
    Format("Abaqus", "_abaqus", ".inp .msh", begins=rb"\*"),
    Format("I-deas", "_ideas", ".unv", begins=rb"-1\s*\n\s*\d+\s*\n"),
    Format("XDMF", "_xdmf", ".xdmf .xmf", begins=XML + rb"<Xdmf\b"),
    Format("AFLR", "_aflr", ".ugrid"),
    Format("OpenFOAM", "openfoam.case", "", is_folder=True),
)
"""The formats; their order means nothing."""
FOREIGN = {
    "a UCD file of AVS; deal.II writes .msh too, and ParaView .vtu": (
        rb"(?:#[^\n]*\s+)*\d+(?:[ \t]+\d+){4}\s*\n"
    ),
    "a mesh of FreeFem; its savegmsh writes .msh": (
        rb"\d+[ \t]+\d+[ \t]+\d+[ \t\r]*\n\s*\S+[ \t]+\S+[ \t]+\d+\s*\n"
    ),
    "a mesh of GiD; a calculation's export to .med, .msh or .cgns keeps its groups": (
        rb"(?:#[^\n]*\s+)*(?i:mesh)\b[^\n]*\b(?i:dimension)\b"
    ),
}
"""What files are that begin so, and that no format reads."""

_KINDS_UNREAD = {
    ".neu": "a Gambit neutral file; OpenFOAM's gambitToFoam keeps its patches",
    ".ccm": "a mesh of STAR-CCM+; its export to CGNS, or OpenFOAM's ccmToFoam, keeps its patches",
    ".vrt .cel .bnd": "a mesh of STAR-CD; OpenFOAM's star4ToFoam keeps its patches",
    ".node .ele": "a mesh of TetGen; OpenFOAM's tetgenToFoam keeps its patches",
    ".cdb": "an archive of Ansys; its export to Fluent's .msh or to CGNS keeps its patches",
    ".bdf .nas .fem": ("a deck of Nastran; gmsh makes a .msh of it, where no GRID has a system CP"),
    ".vol": "a mesh of Netgen; its export to gmsh's .msh keeps its patches",
    ".re2": "a mesh of Nek5000; the .msh or .exo that it was made of is read",
    ".plt .tec .szplt": "a file of Tecplot; ParaView opens it, and saves .vtm with its zones",
    ".case": "EnSight's; ParaView opens it, and saves .vtm with its parts",
    ".foam": "ParaView's mark of an OpenFOAM case: give the folder of the case",
    ".pvd": "ParaView's list of files: give one of them",
    ".stl .obj .ply .off": ("a surface, without cells; gmsh or snappyHexMesh make a mesh of it"),
    ".step .stp .iges .igs .brep .geo": "a geometry; gmsh makes a mesh of it",
}
UNREAD = {name: what for names, what in _KINDS_UNREAD.items() for name in names.split()}
"""What files with other known endings are, and what makes a mesh of them that is read."""

# entry points by which other packages bring formats, named by their endings
PLUGINS = "jaxmorph.formats"


def ending(path: pathlib.Path) -> str:
    """Returns the ending in small letters; that of what a .gz holds."""
    packed = path.suffix.lower() == ".gz"
    return (path.with_suffix("") if packed else path).suffix.lower()


def plugin(path: pathlib.Path) -> Any:
    """Finds the entry point of a format that another package brings; None if there is none."""
    from importlib import metadata

    points = metadata.entry_points(group=PLUGINS)
    return next((point for point in points if f".{point.name}" == ending(path)), None)


def is_folder(path: pathlib.Path) -> bool:
    if any(ending(path) in form.suffixes for form in FORMATS):
        return False
    if path.is_dir() or ending(path).strip(".0123456789") == "":
        return True
    if plugin(path) is not None:
        return False
    if ending(path) in UNREAD:
        raise ValueError(f"{path}: by its ending this is {UNREAD[ending(path)]}.")
    known = ", ".join(f"{form.name} ({', '.join(form.suffixes) or 'folders'})" for form in FORMATS)
    raise ValueError(
        f"{path}: unknown file ending {ending(path)!r}; known are {known}. Write one of them "
        "where the file was made. Or let "
        "meshio, which knows more formats, make one: `meshio convert FILE FILE.vtu`, in Python "
        "jaxmorph.Mesh.from_meshio."
    )
