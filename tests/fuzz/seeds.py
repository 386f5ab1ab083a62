"""Small good files of every format, in every form: what the fuzzers damage."""

import itertools
import pathlib
import sys
from collections.abc import Callable

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).parents[1]))

import adf
import decks
import exodus
import fluent
import foam
import meshio
import vtk_files
from cgns import joined_polyhedra
from foam import PATCHES, mixed, split, strip
from formats import floor_of, write
from meshes import bricks, gmsh_session
from mfem_meshes import SOLID, straight
from plot3d import box
from plot3d import write as write_plot3d
from xdmf import Writer, in_own_grid

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


FORMS_OF_GMSH = ((1, 0, 0), (4, 0, 0), (4, 0, 1), *itertools.product((2.2, 4.1), (0, 1), (0, 1)))
"""Versions, text or binary, without or with the parameters of nodes."""


def gmsh(folder: pathlib.Path) -> list[Seed]:
    """By gmsh in every version, with parameters of nodes and named groups, and by this package."""
    io.write(folder / "a.msh", mesh_3d())
    files = [folder / "a.msh"]
    with gmsh_session() as gmsh:
        gmsh.model.occ.addBox(0, 0, 0, 1, 1.5, 2)
        gmsh.model.occ.synchronize()
        for tags, dimension, name in (([1, 2], 2, "low"), ([2], 2, "both"), ([1], 3, "fluid")):
            gmsh.model.addPhysicalGroup(dimension, tags, name=name)
        for key in ("MeshSizeMin", "MeshSizeMax"):
            gmsh.option.setNumber(f"Mesh.{key}", 1)
        gmsh.model.mesh.generate(3)
        for version, binary, parametric in FORMS_OF_GMSH:
            for key, value in (
                ("MshFileVersion", version),
                ("Binary", binary),
                ("SaveParametric", parametric),
            ):
                gmsh.option.setNumber(f"Mesh.{key}", value)
            files.append(folder / f"{len(files)}.msh")
            gmsh.write(str(files[-1]))
    return [single(file) for file in files]


def cgns_files(folder: pathlib.Path) -> list[Seed]:
    joined_polyhedra(folder / "a.cgns")
    write(folder / "b.cgns", bricks(2))
    return [single(folder / f"{name}.cgns") for name in "ab"]


def adf_files(folder: pathlib.Path) -> list[Seed]:
    cgns_files(folder)
    seeds = []
    for k, (version, order, pieces) in enumerate(
        (("A", "<", 1), ("A", ">", 3), ("B", "<", 2), ("B", ">", 1))
    ):
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
    for name, form in (
        ("a.msh", "text"),
        ("b.msh", "double"),
        ("c.cas", "float"),
        ("d.cas.h5", "h5"),
    ):
        cells = {kind: np.asarray(ids) for kind, ids in mesh.cells.items()}
        fluent.write(folder / name, np.asarray(mesh.points), cells, {"floor": np.arange(4)}, form)
        seeds.append(single(folder / name))
    return seeds


def mfem_files(folder: pathlib.Path) -> list[Seed]:
    """Order 1 and 2: from order 3 on one number of the file makes several of the mesh."""
    for name, text in {"straight": straight(mesh_3d(), "floor"), "solid": SOLID}.items():
        (folder / f"{name}.mesh").write_text(text)
    return [single(folder / f"{name}.mesh") for name in ("straight", "solid")]


def med(folder: pathlib.Path) -> list[Seed]:
    write(folder / "a.med", bricks(2))
    return [single(folder / "a.med")]


def xdmf(folder: pathlib.Path) -> list[Seed]:
    """With arrays in the XML and beside it, and with numbers of facets in a second grid."""
    write(folder / "a.xdmf", bricks(2))
    seeds = [(io.read, folder / "a.xdmf", [folder / "a.xdmf", folder / "a.h5"])]
    for name, form in (("b", "XML"), ("c", "HDF")):
        (folder / name).mkdir()
        path, _ = in_own_grid(Writer(folder / name, form))
        seeds.append((io.read, path, sorted((folder / name).iterdir())))
    return seeds


def plot3d(folder: pathlib.Path) -> list[Seed]:
    seeds = []
    for k, (form, order) in enumerate(itertools.product(("text", "records", "plain"), "<>")):
        write_plot3d(folder / f"{k}.xyz", [block + 0.123 for block in box(3, 2, 4)], form, order)
        seeds.append(single(folder / f"{k}.xyz"))
    beside = folder / "0.xyz.patches"
    beside.write_text("wall 1 kmin # a comment\nfar 2 1 2 1 1 1 3\n")
    return [*seeds, (io.read, folder / "0.xyz", [beside])]


def deck_files(kind: str) -> Callable[[pathlib.Path], list[Seed]]:
    def make(folder: pathlib.Path) -> list[Seed]:
        points = np.asarray(bricks(2).points) + 0.1
        corners = np.asarray(bricks(2).cells["hexahedron"])
        faces = floor_of(corners, np.flatnonzero(points[:, 2] == 0.1))
        files = []
        for ending in (each for each in decks.WRITERS if each.endswith(kind)):
            files.append(folder / f"a{ending}")
            decks.WRITERS[ending](files[-1], decks.in_order("plain", points, corners, faces))
        return [single(file) for file in files]

    return make


def openfoam(folder: pathlib.Path) -> list[Seed]:
    for name, form in foam.FORMS.items():
        for make in (mixed, split):
            foam.write_case(folder / f"{name}-{make.__name__}", *make(), PATCHES, form)
    points, cells, patches = strip(2, around=5)
    foam.write_case(folder / "plane", points, cells, patches)
    return [
        (io.read, case, sorted((case / "constant" / "polyMesh").iterdir()))
        for case in sorted(folder.iterdir())
    ]


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
    rows = "".join(
        f"{node} {x!r} {y!r} {z!r}\n"
        for node, (x, y, z) in zip(nodes, values.tolist(), strict=True)
    )
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
        foam.write_point_vectors(
            path, np.random.default_rng(0).normal(size=(12, 3)), foam.FORMS[name]
        )
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
    "Abaqus": deck_files(".inp"),
    "I-deas": deck_files(".unv"),
    "Medit": deck_files(".meshb"),
    "Medit's text": deck_files(".mesh"),
    "AFLR": deck_files(".ugrid"),
    "XDMF": xdmf,
    "OpenFOAM": openfoam,
    "tables": tables,
    "surfaces": surfaces,
    "plans": plans,
    "boxes": boxes,
    "fields": fields,
}
