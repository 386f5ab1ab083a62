"""What users write: endings of files, TOML, mistyped names. It needs no NumPy."""

import contextlib
import difflib
import pathlib
import re
import tomllib
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

_ENDINGS = {
    "SU2": ".su2",
    "VTK": ".vtu .vtk .vts .vtp .pvtu .vtm",
    "gmsh": ".msh .msh2 .msh4",
    "Fluent": ".cas .msh",
    "Fluent HDF5": ".h5",
    "CGNS": ".cgns",
    "MFEM": ".mesh",
    "MED": ".med",
    "Exodus": ".e .exo .ex2 .exoii .g",
    "PLOT3D": ".xyz .p3d .p3dfmt .x .g .grd .fmt .ufmt .bin .p2d .p2dfmt",
    "Medit": ".mesh .meshb",
    "Abaqus": ".inp .msh",
    "I-deas": ".unv",
    "XDMF": ".xdmf .xmf",
    "AFLR": ".ugrid",
    "OpenFOAM": "",
}
MESHES = {name: tuple(endings.split()) for name, endings in _ENDINGS.items()}
"""Endings of meshes by the name of their format; a case of OpenFOAM is a folder."""

SENSITIVITIES = (".csv", ".npz")
GRADIENTS = (".csv", ".json")
LATTICES = (".vts",)

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
    if any(ending(path) in endings for endings in MESHES.values()):
        return False
    if path.is_dir() or ending(path).strip(".0123456789") == "":
        return True
    if plugin(path) is not None:
        return False
    if ending(path) in UNREAD:
        raise ValueError(f"{path}: by its ending this is {UNREAD[ending(path)]}.")
    known = ", ".join(
        f"{name} ({', '.join(endings) or 'folders'})" for name, endings in MESHES.items()
    )
    raise ValueError(
        f"{path}: unknown file ending {ending(path)!r}; known are {known}. Write one of them "
        "where the file was made. Or let "
        "meshio, which knows more formats, make one: `meshio convert FILE FILE.vtu`, in Python "
        "jaxmorph.Mesh.from_meshio."
    )


def parse_toml(name: str, content: bytes) -> dict[str, Any]:
    try:
        text = content.decode()
        return tomllib.loads(text.replace("\r\n", "\n"))
    except (
        ValueError
    ) as error:  # also for letters that are not UTF-8, and for numbers of thousands of digits
        raise ValueError(f"{name}: not TOML ({error}).") from None
    except RecursionError:
        keys = re.split(r"(?m)^[ \t]*([\w-]+)[ \t]*=", content.decode())[1:]
        values = {
            key: value.count("[") + value.count("{")
            for key, value in zip(keys[::2], keys[1::2], strict=True)
        }
        deepest = max(values, key=values.__getitem__, default="the file")
        raise ValueError(
            f"{name}: {deepest} is nested too deep: thousands of brackets in each other."
        ) from None


def similar(word: str, known: Iterable[str]) -> str | None:
    """The known word that was probably meant, in small letters or capitals; None if none."""
    words = {other.lower(): other for other in known}
    near = difflib.get_close_matches(word.lower(), list(words), n=1)
    return words[near[0]] if near else None


SHOWN_NAMES = 12  # names that an error lists


def patch_names(
    names: Sequence[str], patches: Collection[str], groups: Mapping[str, Sequence[str]]
) -> tuple[str, ...]:
    """Lists patches of names: a patch, a group, or the matches of a whole regular expression.

    `groups` has lists of patches by name. **Raises:** `ValueError` for a name without any, with the
    names that there are.
    """
    listed: list[str] = []
    for name in names:
        found = [patch for patch in groups.get(name, ()) if patch in patches]
        if name in patches:
            found = [name]
        elif name not in groups:
            with contextlib.suppress(re.error):
                found = [patch for patch in patches if re.fullmatch(name, patch)]
            if not found:
                known = _known(patches, groups)
                raise ValueError(
                    f"no patch is called {name!r}{_suggest(name, [*patches, *groups])}; {known}."
                )
        listed += found
    return tuple(dict.fromkeys(listed))


def _suggest(name: str, known: Sequence[str]) -> str:
    shell = re.sub(r"(?<![.\])])\*", ".*", name)
    if (
        shell != name
        and not re.search(r"[\[(\\]", shell)
        and any(re.fullmatch(shell, patch) for patch in known)
    ):
        return f" (patterns are regular expressions: {shell!r})"
    near = similar(name, known)
    return f" (did you mean {near!r}?)" if near else ""


def _known(patches: Collection[str], groups: Mapping[str, Sequence[str]]) -> str:
    names = [repr(name) for name in patches]
    more = f" and {len(names) - SHOWN_NAMES} more" if len(names) > SHOWN_NAMES else ""
    of_groups = f", and the groups {', '.join(map(repr, groups))}" if groups else ""
    return f"this mesh has: {', '.join(names[:SHOWN_NAMES]) or 'none'}{more}{of_groups}"


def decoded(raw: bytes) -> str:
    """Decodes a name in a file: UTF-8, or else Latin-1, which older programs write."""
    try:
        return raw.decode()
    except UnicodeDecodeError:
        return raw.decode("latin-1")
