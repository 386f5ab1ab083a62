"""Endings of files, known before a format is imported."""

import pathlib

MESHES = {
    "SU2": (".su2",),
    "VTK": (".vtu", ".vtk", ".vts", ".vtp", ".pvtu", ".vtm"),
    "gmsh": (".msh",),
    "CGNS": (".cgns",),
    "MFEM": (".mesh",),
    "MED": (".med",),
    "Exodus": (".e", ".exo", ".ex2", ".exoii", ".g"),
    "PLOT3D": (".xyz", ".p3d", ".p3dfmt", ".x", ".g"),
    "OpenFOAM": (),
}
"""Endings of meshes by the name of their format; a case of OpenFOAM is a folder."""

SENSITIVITIES, GRADIENTS, LATTICES = (".csv", ".npz"), (".csv", ".json"), (".vts",)


def is_folder(path: pathlib.Path) -> bool:
    """Tells whether a mesh of this name is a folder. Raises `ValueError` for an unknown ending."""
    if any(path.suffix.lower() in endings for endings in MESHES.values()):
        return False
    if path.is_dir() or path.suffix.strip(".0123456789") == "":
        return True
    known = ", ".join(f"{name} ({', '.join(endings) or 'folders'})" for name, endings in MESHES.items())
    raise ValueError(
        f"{path}: unknown file ending {path.suffix!r}; known are {known}. Write one of them where the file was made. Or let "
        "meshio, which knows more formats, make one: `meshio convert FILE FILE.vtu`, in Python jaxmorph.Mesh.from_meshio."
    )
