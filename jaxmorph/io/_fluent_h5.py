"""Fluent's cases in HDF5 (.cas.h5): a copy of the file with other coordinates."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jaxmorph._host.ragged import Ragged
from jaxmorph._mesh.exchange import Parts

from ._fluent import ZONE_KINDS, FaceTable, FaceZone, make_mesh_of_faces
from ._format import Source
from ._tree import Coordinates, TreePoints, open_tree, read_text, take_only

NAME = "Fluent HDF5"
FLUENT_FILE = "a Fluent case in HDF5"


def read(path: Path) -> Parts:
    with open_tree(path, what=FLUENT_FILE) as file:
        if "meshes" not in file:
            missing = f"not {FLUENT_FILE}: there is no group `meshes`"
            kind = "a mesh of HOPR, which is not read" if "ElemInfo" in file else missing
            raise ValueError(f"{path}: this is {kind}.")
        mesh = take_only(file["meshes"], "meshes")[1]
        content = TreePoints.of(path, file, _find_node_arrays, FLUENT_FILE)
        found = _read_faces(mesh), list(_read_face_zones(mesh["faces"]))
        count = int(mesh.attrs["cellCount"].flat[0])
        regions = _read_zone_names(mesh["cells"]["zoneTopology"])
    return make_mesh_of_faces(Source(path, NAME, content), *found, count, regions)


def _find_node_arrays(file: Any) -> Iterator[Coordinates]:
    first = 0
    for array in _sort_sections(take_only(file["meshes"], "meshes")[1]["nodes"]["coords"]):
        n, d = array.shape
        yield Coordinates(array, slice(first, first + n), slice(0, d), by_rows=True)
        first += len(array)


def _sort_sections(group: Any) -> list[Any]:
    return sorted(group.values(), key=lambda section: int(section.attrs["minId"].flat[0]))


def _read_faces(mesh: Any) -> FaceTable:
    faces = mesh["faces"]
    labels, sizes = (
        np.concatenate(
            [section[name][()].ravel() for section in _sort_sections(faces["nodes"])]
        ).astype(np.int64)
        for name in ("nodes", "nnodes")
    )
    cells = np.zeros((len(sizes), 2), np.int64)
    for column, name in enumerate(("c0", "c1")):
        for array in _sort_sections(faces[name]):
            first = int(array.attrs["minId"].flat[0]) - 1
            cells[first : first + len(array), column] = array[()]
    if sizes.min() < 2 or sizes.sum() != len(labels):
        raise ValueError(f"{len(labels)} nodes of faces, {sizes.sum()} expected")
    return FaceTable(Ragged.of(labels, sizes), cells)


def _read_face_zones(faces: Any) -> Iterator[FaceZone]:
    topology = faces["zoneTopology"]
    columns = [
        topology[name][()].astype(int).tolist() for name in ("id", "zoneType", "minId", "maxId")
    ]
    for name, number, kind, first, last in zip(_read_zone_names(topology), *columns, strict=True):
        yield FaceZone(
            number, name, ZONE_KINDS.get(kind, f"kind_{kind}"), np.arange(first - 1, last)
        )


def _read_zone_names(topology: Any) -> list[str]:
    """Reads the names of zones, of which one text holds all."""
    return read_text(np.ravel(topology["name"][()])[0]).split(";")
