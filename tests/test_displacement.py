"""Displacements from files: by node id, and from one surface to another."""

import decks
import exodus
import h5py
import meshio
import numpy as np
import pytest
from formats import floor_of, written
from meshes import bricks, ring, wedges

import jaxmorph as jm
from jaxmorph import io


def sphere(count=400, seed=1):
    """A closed surface of triangles with some long thin ones."""
    from scipy.spatial import ConvexHull

    points = np.random.default_rng(seed).normal(size=(count, 3)) * [1, 1, 0.02]
    points /= np.linalg.norm(points, axis=1)[:, None]
    return points * [3, 1, 1], ConvexHull(points).simplices.astype(np.int64)


def write_surface(path, points, triangles, form):
    if form == "npz":
        np.savez(path, points=points, triangles=triangles)
    elif form == "obj":
        rows = [f"v {a!r} {b!r} {c!r}" for a, b, c in points.tolist()]
        rows += [f"f {a}/1/1 {b}//2 {c}" for a, b, c in (triangles + 1).tolist()]
        path.write_text("# a surface\no thing\n" + "\n".join(rows) + "\n")
    else:
        mesh = meshio.Mesh(points, [("triangle", triangles)])
        meshio.write(path, mesh, file_format="stl", binary=form == "binary.stl")


def cloud(points):
    return jm.Mesh(points, {}, {"all": np.arange(len(points))})


@pytest.mark.parametrize("form", ["npz", "obj", "ascii.stl", "binary.stl"])
def test_an_affine_motion_between_two_surfaces(tmp_path, form):
    points, triangles = sphere()
    matrix, shift = (
        np.array([[1.1, 0.2, 0], [0, 0.9, 0.1], [0.3, 0, 1]]),
        np.array([0.1, 0.2, -0.3]),
    )
    names = [tmp_path / f"{name}.{form}" for name in ("before", "after")]
    write_surface(names[0], points, triangles, form)
    write_surface(names[1], points @ matrix + shift, triangles, form)
    weights = np.random.default_rng(0).dirichlet([1, 1, 1], len(triangles))
    inside = np.einsum("tc,tcd->td", weights, points[triangles])
    x = np.concatenate([points, inside])
    u = io.read_displacement(names[1], cloud(x), np.arange(len(x)), before=names[0])
    single = form == "binary.stl"
    np.testing.assert_allclose(u, x @ matrix + shift - x, atol=2e-6 if single else 1e-13)
    if form in ("npz", "obj"):
        np.testing.assert_array_equal(u[: len(points)], (points @ matrix + shift) - points)


def test_the_closest_place_is_the_one_that_vtk_finds(tmp_path):
    pyvista = pytest.importorskip("pyvista")
    points, triangles = sphere()
    np.savez(tmp_path / "a.npz", points=points, triangles=triangles)
    x = points[::3] + 0.02 * np.random.default_rng(0).normal(size=(len(points[::3]), 3))
    np.savez(tmp_path / "b.npz", points=2 * points, triangles=triangles)
    u = io.read_displacement(
        tmp_path / "b.npz", cloud(x), np.arange(len(x)), before=tmp_path / "a.npz"
    )
    surface = pyvista.PolyData(points, np.insert(triangles, 0, 3, axis=1).ravel())
    place = surface.find_closest_cell(x, return_closest_point=True)[1]
    np.testing.assert_allclose(
        np.linalg.norm(u - x, axis=1), np.linalg.norm(place - x, axis=1), rtol=1e-6, atol=1e-9
    )
    np.testing.assert_allclose(u, place, atol=1e-6)


@pytest.mark.slow
def test_a_curve_carries_a_mesh_in_2d(tmp_path):
    mesh = ring(12, (1, 1.5, 2))
    nodes = mesh.patch("wall")
    lines = np.stack([nodes, np.roll(nodes, -1)], axis=1)
    at = np.column_stack([mesh.points[nodes], np.zeros(len(nodes))])
    rows = [f"v {x!r} {y!r} 0\n" for x, y, _ in at.tolist()]
    (tmp_path / "a.obj").write_text("".join(rows) + f"l {' '.join(map(str, [*range(1, 13), 1]))}\n")
    np.savez(tmp_path / "c.npz", points=at, lines=lines)
    np.savez(tmp_path / "d.npz", points=at * [1.1, 0.9, 1], lines=lines)
    u = io.read_displacement(tmp_path / "d.npz", mesh, nodes, before=tmp_path / "c.npz")
    np.testing.assert_allclose(u, mesh.points[nodes] * [0.1, -0.1], atol=1e-15)
    u = io.read_displacement(tmp_path / "d.npz", mesh, nodes, before=tmp_path / "a.obj")
    np.testing.assert_allclose(u, mesh.points[nodes] * [0.1, -0.1], atol=1e-15)
    with pytest.raises(ValueError, match="give the surface before the motion too"):
        io.read_displacement(tmp_path / "a.obj", mesh, nodes)


def test_arrays_by_node_id(tmp_path):
    mesh = wedges()
    moving = mesh.patch("roof")
    u = np.random.default_rng(0).random((6, 3))
    np.savez(tmp_path / "a.npz", ids=moving[::-1], displacement=u[::-1])
    np.testing.assert_array_equal(io.read_displacement(tmp_path / "a.npz", mesh, moving), u)
    np.savez(tmp_path / "b.npz", position=mesh.points[moving] + u)
    np.testing.assert_allclose(
        io.read_displacement(tmp_path / "b.npz", mesh, moving), u, atol=1e-15
    )
    rows = [
        f"{i}, {x!r}, {y!r}, {z!r}\n"
        for i, (x, y, z) in zip(moving.tolist(), u.tolist(), strict=True)
    ]
    (tmp_path / "c.csv").write_text("PointID, x, y, z\n" + "".join(rows[::-1]))
    np.testing.assert_array_equal(
        io.read_displacement(tmp_path / "c.csv", mesh, moving, is_position=False), u
    )
    np.testing.assert_array_equal(
        io.read_displacement(tmp_path / "c.csv", mesh, moving), u - mesh.points[moving]
    )
    for arrays, message in (
        (
            {"ids": moving + 1, "displacement": u},
            "node ids are not of the moving patches .first 12., and 1 of the 6",
        ),
        ({"ids": moving * 0, "displacement": u}, "5 of its 6 node ids come a second time"),
        ({"displacement": u[:5]}, r"shape \(6, 3\) expected, found shape \(5, 3\)"),
        ({"displacement": u, "position": u}, "one array displacement or position expected"),
        ({"ids": moving * 1.0, "displacement": u}, "ids must be whole numbers"),
        ({"displacement": u * np.nan}, "finite values"),
    ):
        np.savez(tmp_path / "bad.npz", **arrays)
        with pytest.raises(ValueError, match=message):
            io.read_displacement(tmp_path / "bad.npz", mesh, moving)


def numbered(folder, ending):
    """A file that numbers its nodes otherwise than from 0, and the numbers."""
    path = written(folder, ending)
    n = len(bricks(2).points)
    if ending == ".e":
        points, cells = bricks(2).points, bricks(2).cells["hexahedron"]
        exodus.write(path, np.asarray(points), [("box", "hexahedron", cells)], form="netcdf4")
    labels = 1 + np.arange(n) if ending == ".msh" else 100 + np.arange(n)[::-1]
    if ending in decks.WRITERS:
        points, cells = np.asarray(bricks(2).points), np.asarray(bricks(2).cells["hexahedron"])
        faces = floor_of(cells, np.asarray(bricks(2).patches["floor"]))
        decks.WRITERS[ending](path, decks.Deck(labels, points, labels[cells], labels[faces]))
    elif ending != ".msh":
        with h5py.File(path, "r+") as file:
            if ending == ".e":
                file["node_num_map"] = labels
            else:
                (step,) = file["ENS_MAA"]["mesh"].values()
                step["NOE"]["NUM"] = labels
    return path, labels


@pytest.mark.parametrize("form", ["txt", "npz"])
@pytest.mark.parametrize("ending", [".msh", ".inp", ".unv", ".e", ".med"])
def test_ids_are_rows_or_the_file_s_own_numbers(tmp_path, ending, form):
    """Of displacements and of sensitivities, in any order; others are told, with both ranges."""
    path, labels = numbered(tmp_path, ending)
    mesh = io.read(path)
    every = np.arange(len(labels))
    u = np.random.default_rng(0).normal(size=(len(labels), 3))
    floor = mesh.patch("floor") if "floor" in mesh.patches else every[::2]
    for nodes in (floor, every):
        for ids in (nodes, labels[nodes]):
            order = np.random.default_rng(1).permutation(len(nodes))
            file = tmp_path / f"a.{form}"
            table = {"displacement": u[nodes][order], "ids": ids[order]}
            if form == "npz":
                np.savez(file, **table)
            else:
                np.savetxt(
                    file, np.c_[table["ids"], table["displacement"]], fmt=["%d", *["%.17g"] * 3]
                )
            found = io.read_displacement(file, mesh, nodes, is_position=False)
            np.testing.assert_array_equal(found, u[nodes])
    if form == "txt":
        np.testing.assert_array_equal(io.read_sensitivity(file, mesh), u)
        np.savetxt(file, np.c_[5000 + every, u])
        own = f"own, {labels.min()} to {labels.max()}"
        with pytest.raises(ValueError, match=f"Ids count the nodes from 0, or are all .* {own}"):
            io.read_displacement(file, mesh, every)


def test_surfaces_that_do_not_fit(tmp_path):
    points, triangles = sphere()
    np.savez(tmp_path / "a.npz", points=points, triangles=triangles)
    np.savez(tmp_path / "b.npz", points=points, triangles=triangles[:-1])
    (tmp_path / "c.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n")
    (tmp_path / "d.obj").write_text("v 0 0 0\nv 1 0 x\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "e.stl").write_text("solid a\nendsolid\n")
    (tmp_path / "f.npz").write_bytes(b"text")
    (tmp_path / "g.ply").write_bytes(b"ply")
    for name, message in (
        ("b.npz", "differ in connectivity"),
        ("c.obj", "a face names a point that is not among the 3"),
        ("d.obj", "a vertex holds something that is not a number"),
        ("e.stl", "not a surface, or a damaged one"),
        ("f.npz", "not an NPZ file"),
        ("g.ply", "found the ending '.ply'"),
    ):
        with pytest.raises(ValueError, match=message):
            io.read_displacement(
                tmp_path / name, cloud(points), np.arange(400), before=tmp_path / "a.npz"
            )
    with pytest.raises(
        ValueError, match=r"400 of 400 moving nodes are off this surface by more than .*units"
    ):
        io.read_displacement(
            tmp_path / "a.npz", cloud(1000 * points + 99), np.arange(400), before=tmp_path / "a.npz"
        )
    with pytest.raises(ValueError, match="a mesh in 2-D takes lines"):
        io.read_displacement(tmp_path / "a.npz", ring(), np.arange(3), before=tmp_path / "a.npz")


def test_polygons_are_cut_into_triangles(tmp_path):
    """A cube of quads, one of them with a middle node more, carries as its triangles do."""
    cube = np.array(
        [[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)] + [[0.5, 0, 0]], float
    )
    faces = ["1 9 2 4 3", "5 6 8 7", "1 2 6 5", "3 4 8 7", "1 3 7 5", "2 4 8 6"]
    for name, points in (("a", cube), ("b", cube * [1, 2, 3])):
        rows = [f"v {x} {y} {z}" for x, y, z in points] + [f"f {face}" for face in faces]
        (tmp_path / f"{name}.obj").write_text("\n".join(rows))
    x = np.array([[0.3, 0.4, 0], [0.2, 0.7, 1], [1, 0.25, 0.5], [0.9, 0.9, 0], [0.5, 0, 0]])
    u = io.read_displacement(tmp_path / "b.obj", cloud(x), np.arange(5), before=tmp_path / "a.obj")
    np.testing.assert_allclose(u, x * [0, 1, 2], atol=1e-15)
