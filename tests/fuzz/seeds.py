"""Small good files of every format, in every form: what the fuzzers damage."""

import itertools
import pathlib
import sys
from collections.abc import Callable

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).parents[1]))

import adf
import exodus
import fluent
import foam
import meshio
import vtk_files
from cgns import joined_polyhedra
from foam import PATCHES, mixed, split, strip
from formats import write
from meshes import bricks
from mfem_meshes import SOLID2, straight
from plot3d import box
from plot3d import write as write_plot3d

import jaxmorph as jm
from jaxmorph import io

Seed = tuple[Callable, pathlib.Path, list[pathlib.Path]]
"""A reader of one argument, the path that it is given, and the files below it that are damaged."""


def mesh_3d() -> jm.Mesh:
    points, _ = mixed()
    return jm.Mesh(points, exodus.CELLS, {"floor": [0, 1, 2, 3], "side": [0, 3, 4, 7]})


def single(path: pathlib.Path, reader: Callable = io.read) -> Seed:
    return reader, path, [path]


def su2(folder: pathlib.Path) -> list[Seed]:
    io.write(folder / "a.su2", mesh_3d())
    text = (folder / "a.su2").read_text()
    (folder / "b.su2").write_text(f"% a comment\n{text}")
    return [single(folder / "a.su2"), single(folder / "b.su2")]


def vtk(folder: pathlib.Path) -> list[Seed]:
    io.write(folder / "a.vtu", mesh_3d())
    io.write(folder / "a.vtk", mesh_3d())
    plain = mesh_3d().to_meshio()
    meshio.vtu.write(str(folder / "b.vtu"), plain, binary=False)
    meshio.vtk.write(str(folder / "b.vtk"), plain, binary=False)
    files = [folder / name for name in ("a.vtu", "a.vtk", "b.vtu", "b.vtk")]
    # not flat ones, of which a damaged z makes a mesh in 3-D
    for k, (kind, make) in enumerate(list(vtk_files.KINDS.items())[:4]):
        data = vtk_files.with_arrays(make(), on_cells=False)
        for form in vtk_files.FORMS[k % 3 :: 3]:
            if form[1] == "LZ4" or (form[0] != "appended raw" and form[1] == "None"):
                continue  # a byte is part of several numbers, and there is no checksum
            files.append(folder / f"{kind}{len(files)}{vtk_files.ENDINGS.get(kind, '.vtu')}")
            vtk_files.write(files[-1], data, *form)
        for version, binary in itertools.product((42, 51), (False, True)):
            files.append(folder / f"{kind}{len(files)}.vtk")
            vtk_files.write_legacy(files[-1], data, version, binary=binary)
    return [single(file) for file in files]


NAMES = '3\n1 7 "low"\n1 9 "both"\n2 1 "fluid"\n'
ENTITIES = "0 2 1 0\n4 0 0 0 2 0 0 2 7 9 0 \n5 0 1.5 0 2 1.5 0 1 9 0 \n1 0 0 0 2 1.5 0 1 1 2 4 -5 \n"
MSH = (
    (
        "e",
        "4.1 0 8\n",
        ENTITIES,
        "2 6 1 12\n1 4 1 3\n1\n2\n3\n0.25 0 0 0.125\n1 0 0 0.5\n2 0 0.5 1\n"
        "2 1 0 3\n10\n11\n12\n0.25 1.5 0\n1 1.25 0\n2 1.5 0.25\n",
        "3 8 1 8\n1 4 1 2\n1 1 2\n2 2 3\n1 5 1 2\n3 10 11\n4 11 12\n"
        "2 1 2 4\n5 1 2 10\n6 2 11 10\n7 2 3 11\n8 3 12 11\n",
    ),
    (
        "f",
        "4 0 8\n",
        ENTITIES,
        "2 6\n4 1 1 3\n1 0.25 0 0 0.125\n2 1 0 0 0.5\n3 2 0 0.5 1\n1 2 0 3\n10 0.25 1.5 0\n11 1 1.25 0\n12 2 1.5 0.25\n",
        "3 8\n4 1 1 2\n1 1 2\n2 2 3\n5 1 1 2\n3 10 11\n4 11 12\n1 2 2 4\n5 1 2 10\n6 2 11 10\n7 2 3 11\n8 3 12 11\n",
    ),
)
"""Texts as gmsh writes them: format, entities, nodes, of which those of a curve have parameters, and elements."""


def gmsh(folder: pathlib.Path) -> list[Seed]:
    io.write(folder / "a.msh", mesh_3d())
    mesh = meshio.gmsh.read(str(folder / "a.msh"))
    meshio.gmsh.write(str(folder / "b.msh"), mesh, fmt_version="2.2", binary=False)
    box = bricks(2)
    mesh = meshio.Mesh(np.asarray(box.points), [("hexahedron", np.asarray(box.cells["hexahedron"]))])
    for name, binary in (("c.msh", True), ("d.msh", False)):
        meshio.gmsh.write(str(folder / name), mesh, fmt_version="4.1", binary=binary)
    for name, head, *parts in MSH:
        keys = ("MeshFormat", "PhysicalNames", "Entities", "Nodes", "Elements")
        sections = zip(keys, (head, NAMES, *parts), strict=True)
        text = "".join(f"${key}\n{content}$End{key}\n" for key, content in sections)
        (folder / f"{name}.msh").write_text(text)
    return [single(folder / f"{name}.msh") for name in "abcdef"]


def cgns_files(folder: pathlib.Path) -> list[Seed]:
    joined_polyhedra(folder / "a.cgns")
    write(folder / "b.cgns", bricks(2))
    return [single(folder / f"{name}.cgns") for name in "ab"]


def adf_files(folder: pathlib.Path) -> list[Seed]:
    cgns_files(folder)
    seeds = []
    for k, (version, order, pieces) in enumerate((("A", "<", 1), ("A", ">", 3), ("B", "<", 2), ("B", ">", 1))):
        for name in "ab":
            adf.twin(folder / f"{name}.cgns", folder / f"{name}{k}.cgns", version, order, pieces)
            seeds.append(single(folder / f"{name}{k}.cgns"))
    return seeds


def exodus_files(folder: pathlib.Path) -> list[Seed]:
    for form in exodus.FORMS:
        exodus.solid(folder / f"{form}.e", form=form)
    return [single(folder / f"{form}.e") for form in exodus.FORMS]


def fluent_files(folder: pathlib.Path) -> list[Seed]:
    mesh, seeds = mesh_3d(), []
    for name, form in (("a.msh", "text"), ("b.msh", "double"), ("c.cas", "float"), ("d.cas.h5", "h5")):
        cells = {kind: np.asarray(ids) for kind, ids in mesh.cells.items()}
        fluent.write(folder / name, np.asarray(mesh.points), cells, {"floor": np.arange(4)}, form)
        seeds.append(single(folder / name))
    return seeds


def mfem_files(folder: pathlib.Path) -> list[Seed]:
    """Order 1 and 2: from order 3 on one number of the file makes several of the mesh."""
    for name, text in {"straight": straight(mesh_3d(), "floor"), "solid": SOLID2}.items():
        (folder / f"{name}.mesh").write_text(text)
    return [single(folder / f"{name}.mesh") for name in ("straight", "solid")]


def med(folder: pathlib.Path) -> list[Seed]:
    write(folder / "a.med", bricks(2))
    return [single(folder / "a.med")]


def plot3d(folder: pathlib.Path) -> list[Seed]:
    seeds = []
    for k, (form, order) in enumerate(itertools.product(("text", "records", "plain"), "<>")):
        write_plot3d(folder / f"{k}.xyz", [block + 0.123 for block in box(3, 2, 4)], form, order)
        seeds.append(single(folder / f"{k}.xyz"))
    beside = folder / "0.xyz.patches"
    beside.write_text("wall 1 kmin # a comment\nfar 2 1 2 1 1 1 3\n")
    return [*seeds, (io.read, folder / "0.xyz", [beside])]


def openfoam(folder: pathlib.Path) -> list[Seed]:
    for name, form in foam.FORMS.items():
        for make in (mixed, split):
            foam.write_case(folder / f"{name}-{make.__name__}", *make(), PATCHES, form)
    points, cells, patches = strip(2, around=5)
    foam.write_case(folder / "plane", points, cells, patches)
    return [(io.read, case, sorted((case / "constant" / "polyMesh").iterdir())) for case in sorted(folder.iterdir())]


def tables(folder: pathlib.Path) -> list[Seed]:
    mesh = bricks(2)
    nodes, rng = mesh.patch("floor"), np.random.default_rng(0)
    values = rng.normal(size=(len(nodes), 3))

    def displacement(path: pathlib.Path) -> np.ndarray:
        return io.read_displacement(path, mesh, nodes)

    def sensitivity(path: pathlib.Path) -> np.ndarray:
        return io.read_sensitivity(path, mesh)

    np.savez(folder / "a.npz", displacement=values, ids=nodes)
    np.savez_compressed(folder / "b.npz", position=values)
    rows = "".join(f"{node} {x!r} {y!r} {z!r}\n" for node, (x, y, z) in zip(nodes, values.tolist(), strict=True))
    (folder / "a.dat").write_text(rows)
    (folder / "a.csv").write_text("id,x,y,z\n" + rows.replace(" ", ","))
    every = rng.normal(size=np.shape(mesh.points))
    io.write_sensitivity(folder / "s.csv", np.arange(len(every)), every)
    io.write_sensitivity(folder / "s.npz", np.arange(len(every)), every)
    return [
        *(single(folder / name, displacement) for name in ("a.npz", "b.npz", "a.dat", "a.csv")),
        *(single(folder / name, sensitivity) for name in ("s.csv", "s.npz")),
    ]


def surfaces(folder: pathlib.Path) -> list[Seed]:
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    mesh = jm.Mesh(corners, {"quad": [[0, 1, 2, 3]]})

    def between(path: pathlib.Path) -> np.ndarray:
        return io.read_displacement(path, mesh, np.arange(4), before=path)

    vertices = "".join(f"v {x} {y} {z}\n" for x, y, z in corners.tolist())
    (folder / "a.obj").write_text(vertices + "f 1 2 3\nf 1/1 3/2 4/3\n")
    np.savez(folder / "a.npz", points=corners, triangles=triangles)
    surface = meshio.Mesh(corners, [("triangle", triangles)])
    for name, binary in (("a.stl", True), ("b.stl", False)):
        meshio.write(folder / name, surface, file_format="stl", binary=binary)
    return [single(folder / name, between) for name in ("a.obj", "a.npz", "a.stl", "b.stl")]


def plans(folder: pathlib.Path) -> list[Seed]:
    mesh = bricks(2)
    top = np.flatnonzero(np.asarray(mesh.points)[:, 2] == 1)
    jm.save(folder / "a.npz", jm.prepare(np.asarray(mesh.points), mesh.patch("floor"), top))
    return [single(folder / "a.npz", jm.load)]


def boxes(folder: pathlib.Path) -> list[Seed]:
    text = "low = [0, 0.5]\nhigh = [1.0, 2]\npoints = [4, 3]\n[[moved]]\nat = [1, 1]\nby = [0.25, -1e-1]\n"
    (folder / "a.toml").write_text(text)
    return [single(folder / "a.toml", lambda path: io.read_box(path, 2)[1])]


def fields(folder: pathlib.Path) -> list[Seed]:
    seeds = []
    for name in ("ascii", "binary", "ascii-gz"):
        foam.write_case(folder / name, *mixed(), PATCHES, foam.FORMS[name])
        mesh = io.read(folder / name)
        path = folder / name / "1" / "pointSensVec"
        foam.write_point_vectors(path, np.random.default_rng(0).normal(size=(12, 3)), foam.FORMS[name])
        path = path if path.is_file() else path.with_name("pointSensVec.gz")
        seeds.append(single(path, lambda path, mesh=mesh: io.read_sensitivity(path, mesh)))
    return seeds


FORMATS = {
    "SU2": su2,
    "VTK": vtk,
    "gmsh": gmsh,
    "Fluent": fluent_files,
    "CGNS": cgns_files,
    "ADF": adf_files,
    "Exodus": exodus_files,
    "MFEM": mfem_files,
    "MED": med,
    "PLOT3D": plot3d,
    "OpenFOAM": openfoam,
    "tables": tables,
    "surfaces": surfaces,
    "plans": plans,
    "boxes": boxes,
    "fields": fields,
}
