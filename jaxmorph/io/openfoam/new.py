"""A new polyMesh, in text, for a mesh whose cells have taken the place of those of a case."""

import itertools
import pathlib
import re
from collections.abc import Iterable

import numpy as np
from numpy import ndarray

from jaxmorph._host.cells.topology import ByType
from jaxmorph._host.rows import first_of_equals
from jaxmorph._mesh.faces import Faces, faces_of_cells, joined_faces

from .._format import MeshLike, patch_faces
from .file import Boundary, FoamFile, load_faces, load_file, read_patches
from .plane import Front

MOST_CORNERS = 4
"""Corners of a face of standard cells."""
SOLIDS = {"triangle": "wedge", "quad": "hexahedron"}
"""Cells of one layer, by their faces in front."""
CLASSES = {
    "points": "vectorField",
    "faces": "faceList",
    "owner": "labelList",
    "neighbour": "labelList",
}
_TEXT_HEADER = (
    "FoamFile\n{{\n    version 2.0;\n    format ascii;\n    class {};\n    object {};\n}}\n"
)
_COUNTS_OF_FACES = re.compile(rb"\b(nFaces|startFace)(\s+)\d+")

Sides = dict[str, ndarray]
"""Corners (k, 4) of the faces of each patch, with -1 behind the last one."""


def refuse_patches(topology: pathlib.Path) -> None:
    """Refuses cyclic patches, whose faces have an order, and planes that are no layer's."""
    for patch in read_patches(load_file(topology, "boundary")):
        if patch.size and (patch.type.startswith("cyclic") or patch.type == "wedge"):
            raise ValueError(
                f"the patch {patch.name} is of type {patch.type}, which cases with new cells do "
                "not have; write .msh, of which gmshToFoam makes a case."
            )


def new_files(
    mesh: MeshLike, topology: pathlib.Path, plane: Front | None, old: ndarray
) -> dict[str, bytes]:
    """Makes the files of a polyMesh by name. The case had points `old` (N, 3), perhaps in planes.

    Raises `ValueError` where the nodes of a patch do not tell its faces.
    """
    points = np.asarray(mesh.points, float)
    cells = {kind: np.asarray(ids) for kind, ids in mesh.cells.items()}
    sides = {name: _rows_of_sides(faces.values()) for name, faces in patch_faces(mesh).items()}
    file = load_file(topology, "boundary")
    patches = read_patches(file)
    if plane is not None:
        n = len(points)
        sides = {name: _faces_across(edges, n) for name, edges in sides.items()}
        sides |= _sides_of_planes(topology, patches, plane, len(old), cells, n)
        points = _in_both_planes(points, plane, old)
        cells = {SOLIDS[kind]: np.hstack([ids + n, ids]) for kind, ids in cells.items()}
    of_patches = [sides.get(patch.name, _rows_of_sides([])) for patch in patches]
    faces = _ordered_faces(cells, of_patches)
    inner = len(faces.neighbour)
    rows = np.split(faces.labels, faces.starts[1:-1])
    return {
        "boundary": _boundary(file, inner, of_patches),
        "points": _file_of("points", (f"({x!r} {y!r} {z!r})" for x, y, z in points.tolist())),
        "faces": _file_of("faces", (f"{len(row)}({' '.join(map(str, row))})" for row in rows)),
        "owner": _file_of("owner", map(str, faces.owner.tolist())),
        "neighbour": _file_of("neighbour", map(str, faces.neighbour.tolist())),
    }


def _rows_of_sides(parts: Iterable[ndarray]) -> ndarray:
    widths = [(ids, MOST_CORNERS - ids.shape[1]) for ids in parts]
    rows = [np.pad(ids, ((0, 0), (0, width)), constant_values=-1) for ids, width in widths]
    return np.concatenate([np.zeros((0, MOST_CORNERS), np.int64), *rows])


def _faces_across(edges: ndarray, n: int) -> ndarray:
    """Faces between edges in front and those behind, whose nodes have numbers larger by `n`."""
    first, last = edges[:, :2].T
    return np.stack([first, last, last + n, first + n], axis=1)


def _sides_of_planes(
    topology: pathlib.Path, patches: Boundary, plane: Front, count: int, cells: ByType, n: int
) -> Sides:
    """The faces of patches of type empty: in front, behind, or in both planes."""
    every = {
        False: _rows_of_sides(ids + n for ids in cells.values()),
        True: _rows_of_sides(cells.values()),
    }
    faces = load_faces(topology, patches, count)
    found = {}
    for patch in patches:
        if patch.type == plane.kind and patch.size:
            nodes = faces.nodes(patch.start, patch.end)
            in_front = np.unique(np.isin(nodes, plane.front)).tolist()
            found[patch.name] = np.concatenate([every[side] for side in in_front])
    return found


def _in_both_planes(points: ndarray, plane: Front, old: ndarray) -> ndarray:
    """Points (2 n, 3) of the layer: in front, then behind."""
    places = []
    for nodes, axes in zip((plane.front, plane.back), plane.axes, strict=True):
        one = old[nodes[0]]
        places.append(one - (one @ axes.T) @ axes + points @ axes)
    return np.concatenate(places)


def _ordered_faces(cells: ByType, sides: list[ndarray]) -> Faces:
    """Faces in the order of OpenFOAM: inner ones by owner, then neighbour; those of each patch."""
    parts = []
    count = 0
    for kind, ids in cells.items():
        parts.append(faces_of_cells(kind, ids, count + np.arange(len(ids))))
        count += len(ids)
    faces = joined_faces(parts)
    neighbour = faces.all_neighbours()
    is_inner = neighbour >= 0
    is_turned = is_inner & (neighbour < faces.owner)
    owner = np.where(is_turned, neighbour, faces.owner)
    neighbour = np.where(is_turned, faces.owner, neighbour)
    patch = _patch_of_faces(faces.rows.padded(-1, MOST_CORNERS), is_inner, sides)
    order = np.lexsort([neighbour, owner, patch])
    rows = faces.rows.turned(is_turned).take(order)
    return Faces(rows.values, rows.starts, owner[order], neighbour[order][: is_inner.sum()])


def _patch_of_faces(corners: ndarray, is_inner: ndarray, sides: list[ndarray]) -> ndarray:
    """The number of the patch of each face; -1 for inner ones."""
    outer = np.flatnonzero(~is_inner)
    number = np.repeat(np.arange(len(sides)), [len(rows) for rows in sides])
    every = np.concatenate([*sides, corners[outer]])
    first, place = first_of_equals(np.sort(every, axis=1))
    known = first[place[len(number) :]]
    if len(number) != len(outer) or (known >= len(number)).any():
        raise ValueError(
            f"{len(outer)} outer faces, of which the nodes of patches tell {len(number)}: a case "
            "needs the patch of each."
        )
    patch = np.full(len(corners), -1)
    patch[outer] = number[known]
    return patch


def _boundary(file: FoamFile, start: int, sides: list[ndarray]) -> bytes:
    """The case's own list of patches, with other numbers of faces."""
    counts = [len(rows) for rows in sides]
    starts = itertools.accumulate([start, *counts])
    left = {b"nFaces": iter(counts), b"startFace": starts}

    def counted(found: re.Match[bytes]) -> bytes:
        return b"%s%s%d" % (found[1], found[2], next(left[found[1]]))

    return _COUNTS_OF_FACES.sub(counted, file.data)


def _file_of(name: str, rows: Iterable[str]) -> bytes:
    lines = list(rows)
    head = _TEXT_HEADER.format(CLASSES[name], name)
    return "\n".join([head, f"{len(lines)}", "(", *lines, ")", ""]).encode()
