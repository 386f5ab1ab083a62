"""MED files of Salome and Code_Aster, in HDF5: copies with other coordinates."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray

from jaxmorph._host.cells.topology import CORNERS, digits, pairs_of
from jaxmorph._mesh.exchange import Grid, Parts

from ._format import of_grid
from ._tree import Coordinates, TreePoints, open_tree, read_labels, read_text, take_only

NAME = "MED"
MED_FILE = "a MED file"
MED_TYPES = pairs_of(
    "PO1 vertex SE2 line TR3 triangle QU4 quad TE4 tetra PY5 pyramid PE6 wedge HE8 hexahedron"
)
MED_PLACES = pairs_of("tetra 0213 pyramid 03214 wedge 021354 hexahedron 03214765")
"""Types of cells by MED's, and the places of MED's corners in VTK's order."""


def read(path: Path) -> Parts:
    """Reads points, cells and patches: groups of lower dimension, and of nodes (`NAME_nodes`)."""
    with open_tree(path, what=MED_FILE) as file:
        name, step = _find_step(file)
        content = TreePoints.of(path, file, _find_coordinate_array, MED_FILE)
        n = len(content.points)
        blocks = []
        families = []
        for kind, group in step["MAI"].items():
            if kind not in MED_TYPES:
                raise ValueError(
                    f"{path}: elements of type {kind}; linear ones are read "
                    f"({', '.join(MED_TYPES)})."
                )
            ours = MED_TYPES[kind]
            corners = group["NOD"][()].reshape(CORNERS.get(ours, 1), -1).T.astype(np.int64) - 1
            if ours in MED_PLACES:
                corners = corners[:, *digits(MED_PLACES[ours])]
            blocks.append((ours, corners))
            families.append(_read_families(group, len(corners)))
        of_nodes = [_read_families(step["NOE"], n)]
        cells = _read_groups_of_families(file, name, "ELEME", families)
        nodes = _read_groups_of_families(file, name, "NOEUD", of_nodes)
        sets = {"cell_sets": cells, "point_sets": {group: rows[0] for group, rows in nodes.items()}}
        grid = Grid(content.points, blocks, {}, {}, **sets, own=("elements", "nodes"))
        return of_grid(path, NAME, content, grid, labels=read_labels(step["NOE"], "NUM", n))


def _find_coordinate_array(file: Any) -> Iterator[Coordinates]:
    array = _find_step(file)[1]["NOE"]["COO"]
    n = int(array.attrs["NBR"])
    yield Coordinates(array, slice(0, n), slice(0, array.size // n))


def _read_families(group: Any, count: int) -> ndarray:
    families = group["FAM"][()] if "FAM" in group else np.zeros(count, int)
    if len(families) != count:
        raise ValueError("families of other elements than there are")
    return families


def _find_step(file: Any) -> tuple[str, Any]:
    name, mesh = take_only(file["ENS_MAA"], "meshes")
    return name, mesh if "NOE" in mesh else take_only(mesh, "steps of time")[1]


def _read_groups_of_families(
    file: Any, name: str, kind: str, of_blocks: list[ndarray]
) -> dict[str, list[ndarray]]:
    """Reads the members of each group, rows in each block, from the families of their rows."""
    families = file["FAS"][name] if "FAS" in file and name in file["FAS"] else {}
    groups: dict[str, list[int]] = {}
    for family in families.get(kind, {}).values():
        for characters in family["GRO"]["NOM"][()] if "GRO" in family else ():
            groups.setdefault(read_text(np.asarray(characters, np.uint8)), []).append(
                int(family.attrs["NUM"])
            )
    return {
        group: [np.flatnonzero(np.isin(own, ids)) for own in of_blocks]
        for group, ids in groups.items()
    }
