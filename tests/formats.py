"""A small mesh in a file of each format, and what two meshes have alike."""

import pathlib
import tempfile

import cgns
import decks
import exodus
import fluent
import foam
import h5py
import meshio
import mfem_meshes
import numpy as np
from foam import PATCHES, mixed
from meshes import bricks, gmsh_session
from plot3d import write as write_plot3d

import jaxmorph as jm
from jaxmorph import io
from jaxmorph._host.cells.topology import FACES
from jaxmorph.io.kinds import FORMATS

ENDINGS = [
    ".vtk",
    *((form.suffixes or ("",))[0] for form in FORMATS if form.name != "Medit"),
    ".meshb",
]
"""Endings of files that are written back."""
SINGLE = ["", ".cas", ".h5", ".cgns", ".med", ".e", ".xyz", ".vtu", ".vtk"]
"""Endings of formats that have files in single precision."""


def floor_of(corners: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """The faces of hexahedra between some nodes."""
    faces = np.concatenate([corners[:, list(face)] for face in FACES["hexahedron"]])
    return faces[np.isin(faces, nodes).all(axis=1)]


def by_gmsh(path: pathlib.Path, points: np.ndarray, corners: np.ndarray, nodes: np.ndarray) -> None:
    with tempfile.TemporaryDirectory() as folder, gmsh_session() as gmsh:
        io.write(f"{folder}/a.msh", jm.Mesh(points, {"hexahedron": corners}, {"floor": nodes}))
        gmsh.open(f"{folder}/a.msh")
        gmsh.option.setNumber("Mesh.SaveAll", 1)
        gmsh.option.setNumber("Mesh.SaveGroupsOfElements", 1)
        gmsh.write(str(path))


def by_meshio(
    path: pathlib.Path, points: np.ndarray, corners: np.ndarray, nodes: np.ndarray
) -> None:
    faces = floor_of(corners, nodes)
    array = {".meshb": "medit:ref", ".xdmf": "marker"}.get(path.suffix)
    numbers = {array: [np.full(len(faces), 2), np.full(len(corners), 1)]} if array else {}
    sets = {} if array else {"floor": [np.arange(len(faces)), []]}
    mesh = meshio.Mesh(
        points, [("quad", faces), ("hexahedron", corners)], cell_data=numbers, cell_sets=sets
    )
    meshio.write(path, mesh)


def by_hand(path: pathlib.Path, points: np.ndarray, corners: np.ndarray, nodes: np.ndarray) -> None:
    decks.WRITERS[path.suffix](
        path,
        decks.Deck(1 + np.arange(len(points)), points, 1 + corners, 1 + floor_of(corners, nodes)),
    )


OTHERS = dict.fromkeys((".meshb", ".inp", ".xdmf"), by_meshio) | {
    ".unv": by_gmsh,
    ".ugrid": by_hand,
}
"""Writers of kinds that other libraries read, by their endings."""


def write(path: pathlib.Path, mesh: jm.Mesh, *, is_single: bool = False) -> None:
    """Writes a mesh of hexahedra with a patch `floor` in the format of the path's ending."""
    points, corners, real = (
        np.asarray(mesh.points),
        np.asarray(mesh.cells["hexahedron"]),
        "f4" if is_single else "f8",
    )
    if path.suffix == "":
        foam.write_case(
            path, *mixed(), PATCHES, foam.FORMS["binary-32-scalars" if is_single else "ascii"]
        )
    elif path.suffix == ".cgns":
        cgns.write(path, mesh, f"<{real}")
    elif path.suffix == ".med":
        tags = np.isin(np.arange(len(points)), mesh.patch("floor")).astype(int)
        in_order = [("hexahedron", corners[:, [0, 3, 2, 1, 4, 7, 6, 5]])]  # MED's
        tagged = meshio.Mesh(points, in_order, point_data={"point_tags": tags})
        tagged.point_tags = {1: ["floor"]}
        meshio.med.write(path, tagged)
        if is_single:
            with h5py.File(path, "r+") as file:
                (step,) = file["ENS_MAA"]["mesh"].values()
                values, attributes = step["NOE"]["COO"][()], dict(step["NOE"]["COO"].attrs)
                del step["NOE"]["COO"]
                step["NOE"].create_dataset("COO", data=values.astype("f4")).attrs.update(attributes)
    elif path.suffix == ".e":
        sets = [("floor", mesh.patch("floor"))]
        exodus.write(path, points, [("box", "hexahedron", corners)], node_sets=sets, real=real)
    elif path.suffix in OTHERS:
        OTHERS[path.suffix](path, points, corners, mesh.patch("floor"))
    elif path.suffix == ".h5":
        real = "f4" if is_single else "f8"
        fluent.write(
            path, points, {"hexahedron": corners}, {"floor": mesh.patch("floor")}, "h5", real=real
        )
    elif path.suffix == ".cas":
        fluent.write(
            path,
            points,
            {"hexahedron": corners},
            {"floor": mesh.patch("floor")},
            "float" if is_single else "text",
        )
    elif path.suffix == ".mesh":
        path.write_text(mfem_meshes.straight(mesh, "floor"))
    elif path.suffix == ".xyz":
        grid = np.stack(np.meshgrid(*(np.linspace(0, 1, 3),) * 3, indexing="ij"))
        write_plot3d(path, [grid], "records" if is_single else "text", width=4 if is_single else 8)
    elif is_single:
        meshio.write(path, meshio.Mesh(points.astype(np.float32), [("hexahedron", corners)]))
    else:
        io.write(path, mesh)


def written(folder: pathlib.Path, ending: str, *, is_single: bool = False) -> pathlib.Path:
    path = folder / f"in{ending}"
    write(path, bricks(2), is_single=is_single)
    return path


def assert_same(a: jm.Mesh, b: jm.Mesh) -> None:
    """The same points to the last bit, and the same cells and patches in one order."""
    assert np.asarray(a.points).tobytes() == np.asarray(b.points).tobytes()
    for one, other in ((a.cells, b.cells), (a.patches, b.patches)):
        assert list(one) == list(other)
        for name in one:
            np.testing.assert_array_equal(one[name], other[name])


def rewritten(path: pathlib.Path, mesh: jm.Mesh) -> jm.Mesh:
    """What is read of the file that a mesh is written to."""
    io.write(path, mesh)
    return io.read(path)
