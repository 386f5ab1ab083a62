"""Vectors at OpenFOAM's points: dJ/d(points) as its adjoint solver writes them."""

import dataclasses
import pathlib
import re

import numpy as np
from jaxtyping import Float

from jaxmorph import Mesh

from .._format import source_of
from .case import NAME
from .file import load

_INTERNAL = re.compile(rb"internalField\s+(nonuniform\s+List<vector>|uniform)")
_END = re.compile(rb"\)\s*\)\s*;")


def is_foam_file(path: pathlib.Path) -> bool:
    """Checks whether a file is an OpenFOAM file, by its ending or its header."""
    if path.suffix == ".gz":
        return True
    with path.open("rb") as file:
        return b"FoamFile" in file.read(1 << 14)


def read_point_vectors(path: pathlib.Path, mesh: Mesh) -> Float[np.ndarray, "n d"]:
    """Reads a `pointVectorField` for the nodes of a case's mesh; in 2-D both planes add up.

    It raises `ValueError` for other classes of fields, other numbers of points, and meshes from
    elsewhere.
    """
    source = source_of(mesh, NAME)
    if source is None:
        raise ValueError(f"{path}: a file of OpenFOAM; it needs a mesh that was read from an OpenFOAM case.")
    file = load(path.parent, path.name)
    kind = file.header.get("class", "")
    entry = _INTERNAL.search(file.data, file.end)
    if kind != "pointVectorField" or entry is None or entry[1] == b"uniform":
        found = f"{kind or 'no class'}{' with one value for all points' if kind == 'pointVectorField' else ''}"
        raise file.error(f"a pointVectorField with a list of vectors expected, found {found}")
    stop = None if file.is_binary else _END.search(file.data, entry.end())
    data = file.data if stop is None else file.data[: stop.end()]
    values = dataclasses.replace(file, data=data, end=entry.end()).numbers("scalar", 3)
    content = source.content
    if len(values) != len(content.points):
        raise file.error(f"{len(content.points)} vectors expected, one for each point of the case, found {len(values)}")
    return values if content.plane is None else content.plane.added(values)
