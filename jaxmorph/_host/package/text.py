"""What users write: endings of files, TOML, mistyped names. It needs no NumPy."""

import difflib
import json
import pathlib
import re
import tomllib
from collections.abc import Iterable
from typing import Any

MESHES = {
    "SU2": (".su2",),
    "VTK": (".vtu", ".vtk", ".vts", ".vtp", ".pvtu", ".vtm"),
    "gmsh": (".msh",),
    "Fluent": (".cas", ".msh", ".h5"),
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
    if any(path.suffix.lower() in endings for endings in MESHES.values()):
        return False
    if path.is_dir() or path.suffix.strip(".0123456789") == "":
        return True
    known = ", ".join(f"{name} ({', '.join(endings) or 'folders'})" for name, endings in MESHES.items())
    raise ValueError(
        f"{path}: unknown file ending {path.suffix!r}; known are {known}. Write one of them where the file was made. Or let "
        "meshio, which knows more formats, make one: `meshio convert FILE FILE.vtu`, in Python jaxmorph.Mesh.from_meshio."
    )


def read(name: str, content: bytes) -> dict[str, Any]:
    try:
        text = content.decode()
        return tomllib.loads(text.replace("\r\n", "\n"))
    except ValueError as error:  # also for letters that are not UTF-8, and for numbers of thousands of digits
        raise ValueError(f"{name}: not TOML ({error}).") from None
    except RecursionError:
        keys = re.split(r"(?m)^[ \t]*([\w-]+)[ \t]*=", content.decode())[1:]
        values = {key: value.count("[") + value.count("{") for key, value in zip(keys[::2], keys[1::2], strict=True)}
        deepest = max(values, key=values.__getitem__, default="the file")
        raise ValueError(f"{name}: {deepest} is nested too deep: thousands of brackets in each other.") from None


def written(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(written, value))}]"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(key)} = {written(entry)}" for key, entry in value.items()) + " }"
    return json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007f")


def similar(word: str, known: Iterable[str]) -> str | None:
    """The known word that was probably meant, in small letters or capitals; None if none."""
    words = {other.lower(): other for other in known}
    near = difflib.get_close_matches(word.lower(), list(words), n=1)
    return words[near[0]] if near else None
