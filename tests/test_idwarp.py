"""IDWarp's calls: what its own tests assert of surfaces, derivatives and processes, on generated meshes."""

import os
import pathlib
import subprocess
import sys
import warnings

import adf
import idwarp_meshes as meshes
import jax
import numpy as np
import plot3d
import pytest
from runs import all_refused, mpi_run, runs

import jaxmorph as jm
from jaxmorph import cases, io
from jaxmorph.io._format import Source

MPI = pytest.importorskip("mpi4py.MPI")
pytest.importorskip("h5py")
idwarp = pytest.importorskip("jaxmorph.integrations.idwarp")
USMesh, MultiUSMesh = idwarp.USMesh, idwarp.MultiUSMesh
surface_room = pytest.importorskip("jaxmorph.integrations.idwarp._surface")
ROOT = pathlib.Path(__file__).resolve().parents[1]
PLANES = {1: [[[0, 0, 0], [1, 0, 0]]], 2: [[[0, 0, 0], [1, 0, 0]], [[0, 0, 0], [0, 1, 0]]]}


@pytest.fixture(scope="module")
def grids(tmp_path_factory):
    """The file of each kind, and its nodes in the order of the file."""
    folder = tmp_path_factory.mktemp("grids")
    return {
        kind: (folder / name, write(folder / name))
        for kind, (name, _, write) in meshes.FILES.items()
    }


def opened(grids, kind, **options):
    """The mesh of a file; exact weights by distance, which compile fast, unless `useRotations=None` asks for the default."""
    walls = {"specifiedSurfaces": ["kmin" if kind == "plot3d" else "Floor"]}
    settled = {
        "gridFile": str(grids[kind][0]),
        "fileType": meshes.FILES[kind][1],
        "useRotations": False,
    }
    return USMesh(options=settled | walls | options, comm=MPI.COMM_SELF)


def warped(mesh, motion=meshes.bump):
    """Moves the mesh by a motion of its surface; returns the nodes in the order of the file."""
    mesh.setSurfaceCoordinates(motion(mesh.getSurfaceCoordinates()))
    mesh.warpMesh()
    return mesh.getCommonGrid().reshape(-1, 3)


def dot_is_equal(mesh, seed=0):
    """Forward against reverse, in the order of the file and in a solver's own."""
    random = np.random.default_rng(seed)
    count = len(mesh.getCommonGrid())
    mesh.setExternalMeshIndices(random.integers(0, count, 2 * count // 3))
    tangent = random.normal(size=mesh.getSurfaceCoordinates().shape)
    for is_solvers in (True, False):
        change = mesh.warpDerivFwd(tangent, solverVec=is_solvers)
        cotangent = random.normal(size=change.shape)
        assert len(change) == (2 * count // 3 if is_solvers else count)
        mesh.warpDeriv(cotangent, solverVec=is_solvers)
        scale = np.linalg.norm(change) * np.linalg.norm(cotangent)
        assert abs(np.vdot(change, cotangent) - np.vdot(tangent, mesh.getdXs())) < 1e-12 * scale


@pytest.mark.parametrize(
    ("kind", "count"),
    runs([("structured", 1)], nightly=[("unstructured", 2), ("plot3d", 1), ("openfoam", 1)]),
)
def test_walls_planes_and_derivatives(grids, kind, count, capsys):
    nodes = grids[kind][1]
    mesh = opened(grids, kind, symmetryPlanes=PLANES[count])
    assert np.array_equal(mesh.getCommonGrid(), nodes.ravel())
    assert np.array_equal(mesh.getWarpGrid(), nodes.ravel())
    assert mesh.warp.griddata.warpmeshdof == nodes.size
    surface = mesh.getSurfaceCoordinates()
    floor = nodes[meshes.on(nodes, "floor")]
    assert np.array_equal(np.unique(surface, axis=0), np.unique(floor, axis=0))
    assert len(surface) == len(np.unique(floor, axis=0))

    moved = warped(mesh)
    wall = meshes.on(nodes, "floor")
    np.testing.assert_allclose(moved[wall], meshes.bump(nodes[wall]), atol=1e-15)
    held = np.setdiff1d(
        np.concatenate([meshes.on(nodes, name) for name in ("lid", "xmax", "ymax")]), wall
    )
    assert np.array_equal(moved[held], nodes[held])
    for name, axis in (("sym0", 0), ("sym1", 1))[:count]:
        assert np.array_equal(
            moved[meshes.on(nodes, name), axis], nodes[meshes.on(nodes, name), axis]
        )
    if count == 1:  # the other side is no plane of symmetry then: it is fixed
        side = np.setdiff1d(meshes.on(nodes, "sym1"), wall)
        assert np.array_equal(moved[side], nodes[side])
    inner = (nodes > 0).all(axis=1) & (nodes < 1).all(axis=1)
    assert (np.abs(moved - nodes)[inner].max(axis=1) > 1e-4).all()
    _, copies = np.unique(nodes, axis=0, return_inverse=True)
    first = np.unique(copies, return_index=True)[1]
    assert np.array_equal(moved, moved[first][copies.ravel()])

    dot_is_equal(mesh)
    assert (
        mesh.verifyWarpDeriv(np.linspace(0, 1, nodes.size), solverVec=False, dofStart=0, dofEnd=5)
        < 1e-7
    )
    assert capsys.readouterr().out.count("surface coordinate") == 5


@pytest.mark.slow
def test_a_cube_inflates(grids):
    """IDWarp's case: each coordinate of a closed surface times a number of its own."""
    mesh = opened(
        grids,
        "structured",
        specifiedSurfaces=list(meshes.SIDES),
        symmetryPlanes=[],
        useRotations=None,
    )
    moved = warped(mesh, lambda x: x * [1.1, 1.2, 1.3])
    np.testing.assert_allclose(moved, grids["structured"][1] * [1.1, 1.2, 1.3], atol=1e-9)


@pytest.mark.parametrize("kind", runs(["structured"], nightly=["plot3d", "openfoam"]))
def test_the_calls_of_idwarps_own_test(grids, kind, capsys):
    """Its options, in the spelling of its versions, then a shear along the span: to the letter what its test calls."""
    options = {
        "gridFile": None,
        "aExp": 3.0,
        "bExp": 5.0,
        "LdefFact": 1.0,
        "alpha": 0.25,
        "errTol": 0.0005,
    }
    options |= {
        "evalMode": "fast",
        "symmTol": 1e-6,
        "useRotations": True,
        "bucketSize": 8,
        "fileType": None,
    }
    options |= {"specifiedSurfaces": ["kmin"]} if kind == "plot3d" else {}
    options.update({"gridFile": str(grids[kind][0]), "fileType": meshes.FILES[kind][1].lower()})
    options.update({"symmetryPlanes": PLANES[1]})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        mesh = USMesh(options=options, comm=MPI.COMM_SELF, debug=True)
    coords, start = mesh.getSurfaceCoordinates(), mesh.getCommonGrid().reshape(-1, 3)
    warped(mesh, lambda x: x + 0.05 * x[:, :1] * [0, 1, 0])
    moved, wall = mesh.getWarpGrid().reshape(-1, 3), meshes.on(start, "floor")
    np.testing.assert_allclose(moved[wall, 1], start[wall, 1] + 0.05 * start[wall, 0], atol=1e-15)
    seed = np.linspace(0, 1.0, mesh.warp.griddata.warpmeshdof)
    mesh.warpDeriv(seed, solverVec=False)
    assert mesh.getdXs().shape == coords.shape
    assert mesh.verifyWarpDeriv(seed, solverVec=False, dofStart=0, dofEnd=5) < 1e-6
    assert capsys.readouterr().out.count("surface coordinate") == 5


def test_options_are_those_of_baseclasses(grids, capsys):
    mesh = opened(grids, "structured", symmetryPlanes=PLANES[1])
    assert mesh.getOption("SYMMTOL") == 1e-6
    assert mesh.getOption("filetype") == "CGNS"
    mesh.setOption("useRotations", True)
    mesh.setOption("errtol", 1e-3)
    mesh.printOptions()
    told = capsys.readouterr().out
    assert "useRotations: True" in told
    assert "errTol: 0.001" in told
    other = opened(grids, "structured", symmetryPlanes=PLANES[1], useRotations=True)
    assert np.array_equal(warped(mesh), warped(other))
    all_refused(
        (lambda: mesh.setOption("useRotations", False), "surface is defined"),
        (lambda: mesh.setOption("gridFile", "other.cgns"), "grid is read"),
        (lambda: mesh.setOption("errTol", "small"), "errTol"),
        (lambda: mesh.setOption("nonsense", 1), "no option nonsense"),
        (lambda: mesh.getOption("nonsense"), "no option nonsense"),
    )


@pytest.mark.slow
def test_planes_that_face_each_other_as_dafoam_gives_them(grids):
    """Normals of whatever length; of an airfoil both sides of one layer of cells are symmetry planes."""
    nodes = grids["openfoam"][1]
    planes = [[[0, 0, 0], [0.1, 0, 0]], [[1, 0, 0], [0.1, 0, 0]]]
    mesh = opened(grids, "openfoam", symmetryPlanes=planes, specifiedSurfaces=None)
    moved = warped(mesh, lambda x: x + 0.1 * np.sin(np.pi * x[:, 1:2]) * [0, 0, 1])
    for name in ("sym0", "xmax"):
        rows = meshes.on(nodes, name)
        assert np.array_equal(moved[rows, 0], nodes[rows, 0])
        assert np.abs(moved[rows] - nodes[rows]).max() > 0.05
    dot_is_equal(mesh)


@pytest.mark.nightly
@pytest.mark.parametrize("is_turning", [True, None])
def test_the_method_is_idwarps_or_the_default(grids, is_turning):
    """`useRotations` asks for IDWarp's; without it the mesh moves as `prepare` moves it."""
    options = {"useRotations": is_turning, "symmetryPlanes": PLANES[2]}
    mesh = opened(grids, "unstructured", **options)
    moved = warped(mesh)
    file = io.read(grids["unstructured"][0])
    method = jm.InverseDistance(rotations=True) if is_turning else None
    planes = [jm.Plane([1, 0, 0], [0, 0, 0]), jm.Plane([0, 1, 0], [0, 0, 0])]
    plan = jm.prepare(file, "floor", ["lid", "xmax", "ymax"], method=method, symmetry=planes)
    expected = jm.deform(plan, meshes.bump(plan.moving_points) - plan.moving_points)
    np.testing.assert_allclose(moved, expected, atol=1e-12)
    dot_is_equal(mesh)
    assert mesh.verifyWarpDeriv(dofStart=30, dofEnd=33) < 1e-6


def faces_of():
    """The floor's faces as solvers give them: each with corners of its own, of which many are at one place."""
    points = np.array(meshes.floor_faces(meshes.cube()))
    return points, np.arange(len(points)), np.full(len(points) // 4, 4)


def test_a_solvers_own_points_move_the_wall(grids):
    nodes = grids["unstructured"][1]
    mesh = opened(grids, "unstructured", symmetryPlanes=PLANES[2], specifiedSurfaces=None)
    own = opened(grids, "unstructured", symmetryPlanes=PLANES[2])
    definition = faces_of()
    mesh.setSurfaceDefinition(*definition, np.zeros(len(definition[2])))
    assert np.array_equal(mesh.getSurfaceCoordinates(), definition[0])
    np.testing.assert_allclose(warped(mesh), warped(own), atol=1e-14)
    dot_is_equal(mesh)
    # all points at one place together have the derivative of the node there
    seed = np.random.default_rng(1).normal(size=nodes.size)
    for each in (mesh, own):
        each.warpDeriv(seed, solverVec=False)
    place = {
        tuple(point): row for row, point in enumerate(nodes[meshes.on(nodes, "floor")].tolist())
    }
    total = np.zeros((len(place), 3))
    np.add.at(total, [place[tuple(point)] for point in definition[0].tolist()], mesh.getdXs())
    np.testing.assert_allclose(total, own.getdXs(), atol=1e-12)


@pytest.mark.parametrize(("count", "has_faces"), [(3, True), (8, False)], ids=["faces", "points"])
def test_points_that_are_no_nodes_move_the_wall_by_a_linear_map(grids, count, has_faces):
    """A motion that is affine on the surface reaches the wall exactly by faces; a shift does by points alone."""
    nodes = grids["unstructured"][1]
    mesh = opened(grids, "unstructured", symmetryPlanes=[])
    x = np.linspace(0, 1, count)
    points = np.array([(a, b, 0.0) for a in x for b in x])
    ids = np.arange(count * count).reshape(count, count)
    quads = np.stack([ids[:-1, :-1], ids[1:, :-1], ids[1:, 1:], ids[:-1, 1:]], axis=-1).reshape(
        -1, 4
    )
    quads = quads if has_faces else quads[:0]
    mesh.setSurfaceDefinition(points, quads.ravel(), np.full(len(quads), 4))
    matrix = np.array([[0.1, 0.2, 0], [-0.1, 0.05, 0], [0.3, -0.2, 0]]) * has_faces
    motion = lambda places: places + places @ matrix.T + [0.01, 0.02, 0.03]  # noqa: E731
    moved, wall = warped(mesh, motion), meshes.on(nodes, "floor")
    np.testing.assert_allclose(moved[wall], motion(nodes[wall]), atol=1e-14)
    dot_is_equal(mesh)
    assert mesh.verifyWarpDeriv(dofEnd=4) < 1e-7


def test_a_definition_from_a_file_of_blocks(grids, tmp_path):
    x = np.linspace(0, 1, meshes.CELLS + 1)
    blocks = [np.stack(np.meshgrid(part, x, [0.0], indexing="ij")) for part in (x[:3], x[2:])]
    plot3d.write(tmp_path / "surface.xyz", blocks, "text")
    mesh = opened(grids, "plot3d", symmetryPlanes=[], specifiedSurfaces=None)
    mesh.setSurfaceDefinitionFromFile(str(tmp_path / "surface.xyz"))
    surface = mesh.getSurfaceCoordinates()
    assert np.array_equal(
        surface, np.concatenate([block.reshape(3, -1, order="F").T for block in blocks])
    )
    nodes, moved = grids["plot3d"][1], warped(mesh, lambda x: x + np.array([0, 0, 0.1]))
    wall = meshes.on(nodes, "floor")
    np.testing.assert_allclose(moved[wall], nodes[wall] + [0, 0, 0.1], atol=1e-8)


@pytest.mark.nightly
def test_several_grids_of_one_file_move_each_by_itself(tmp_path):
    """Oracle: each grid alone in a file. The third has no options and stays; its faces on the surface move nothing."""
    path = tmp_path / "overset.cgns"
    nodes, (points, zones) = meshes.write_overset(path), meshes.overset_floors()
    options = {
        "tip": {"useRotations": False, "gridFile": "elsewhere"},
        "wing": {"useRotations": True},
    }
    mesh = MultiUSMesh(str(path), options, comm=MPI.COMM_SELF)
    assert len(mesh.meshes) == 2
    indices = np.random.default_rng(3).permutation(nodes.size)
    mesh.setExternalMeshIndices(indices)
    assert np.array_equal(mesh.getSolverGrid(), nodes.ravel()[indices])
    mesh.setSurfaceDefinition(
        points, np.arange(len(points)).reshape(-1, 4), np.full(len(zones), 4), zones
    )
    assert np.array_equal(mesh.getSurfaceCoordinates(), points)

    def motion(x):
        return x + 0.1 * np.sin(2 * x[:, :1]) * [0, 0, 1] + 0.05 * x[:, 1:2] * [1, 0, 0] * x[:, :1]

    mesh.setSurfaceCoordinates(motion(points))
    mesh.warpMesh()
    moved = np.empty(nodes.size)
    moved[indices] = mesh.getSolverGrid()
    grids, count = mesh.getWarpGrid()
    assert np.array_equal(moved, np.concatenate([*grids, nodes.ravel()[count:]]))
    for grid, (name, own) in zip(grids, {"wing": [0, 1], "tip": [2]}.items(), strict=True):
        start = meshes.write_overset(tmp_path / f"{name}.cgns", [name])
        alone = USMesh(options[name] | {"gridFile": str(tmp_path / f"{name}.cgns")}, MPI.COMM_SELF)
        corners = points[np.repeat(np.isin(zones, own), 4)]
        alone.setSurfaceDefinition(corners, np.arange(len(corners)), np.full(len(corners) // 4, 4))
        np.testing.assert_allclose(grid.reshape(-1, 3), warped(alone, motion), atol=1e-12)
        floor = start[:, 2] == 0
        np.testing.assert_allclose(grid.reshape(-1, 3)[floor], motion(start[floor]), atol=1e-14)
    random = np.random.default_rng(0)
    tangent, seed = random.normal(size=points.shape), random.normal(size=nodes.size)
    change, back = mesh.warpDerivFwd(tangent), mesh.warpDeriv(seed)
    assert np.array_equal(back, mesh.getdXs())
    assert abs(change @ seed - np.vdot(tangent, back)) < 1e-12 * np.linalg.norm(
        change
    ) * np.linalg.norm(seed)
    mesh.writeGrid(str(tmp_path / "moved"))
    written = io.read(tmp_path / "moved.cgns")
    assert np.array_equal(written.in_file_order(written.points).ravel(), moved)
    adf.twin(path, tmp_path / "older.cgns")
    older = MultiUSMesh(str(tmp_path / "older.cgns"), {"tip": options["tip"]}, MPI.COMM_SELF)
    assert np.array_equal(older.getWarpGrid()[0][0], start.ravel())


@pytest.mark.parametrize("step", runs([1e-200], nightly=[1e-40]))
def test_complex_steps_are_the_forward_product(grids, step, tmp_path):
    """As IDWarp's own tests take them: a step of all coordinates at once, and the derivative as the imaginary part over it."""
    settled = {
        "gridFile": str(grids["structured"][0]),
        "specifiedSurfaces": ["Floor"],
        "useRotations": False,
    }
    mesh, real = (kind(options=settled, comm=MPI.COMM_SELF) for kind in (idwarp.USMesh_C, USMesh))
    points, random = real.getSurfaceCoordinates(), np.random.default_rng(0)
    assert np.array_equal(mesh.getSurfaceCoordinates(), points.astype(complex))
    tangent = random.normal(size=points.shape)
    mesh.setSurfaceCoordinates(meshes.bump(points) + 1j * step * tangent)
    mesh.warpMesh()
    real.setSurfaceCoordinates(meshes.bump(points))
    change = real.warpDerivFwd(tangent, solverVec=False)
    assert np.array_equal(mesh.getWarpGrid().real, real.getWarpGrid())
    np.testing.assert_allclose(mesh.getCommonGrid().imag / step, change, atol=1e-13)
    order = random.permutation(len(change))
    mesh.setExternalMeshIndices(order)
    np.testing.assert_allclose(mesh.getSolverGrid().imag / step, change[order], atol=1e-13)
    np.testing.assert_array_equal(mesh.getSurfaceCoordinates().imag, step * tangent)
    mesh.writeGrid(str(tmp_path / "moved.cgns"))
    written = io.read(tmp_path / "moved.cgns")
    assert np.array_equal(written.in_file_order(written.points).ravel(), real.getCommonGrid())
    with pytest.raises(ValueError, match="coordinates"):
        real.setSurfaceCoordinates(points + 1j)


@pytest.mark.nightly
def test_several_grids_take_complex_steps(tmp_path):
    path, step = str(tmp_path / "overset.cgns"), 1e-200
    nodes, (points, zones) = meshes.write_overset(path), meshes.overset_floors()
    options = {"wing": {"useRotations": False}, "tip": {"useRotations": False}}
    mesh, real = (
        kind(path, options, MPI.COMM_SELF) for kind in (idwarp.MultiUSMesh_C, MultiUSMesh)
    )
    for each in (mesh, real):
        each.setExternalMeshIndices(np.arange(nodes.size).tolist())
        each.setSurfaceDefinition(
            points.tolist(), np.arange(len(points)).tolist(), [4] * len(zones), zones.tolist()
        )
    tangent = np.random.default_rng(0).normal(size=points.shape)
    mesh.setSurfaceCoordinates(meshes.bump(points) + 1j * step * tangent)
    mesh.warpMesh()
    real.setSurfaceCoordinates(meshes.bump(points))
    change = real.warpDerivFwd(tangent)
    assert np.array_equal(mesh.getSolverGrid().real, real.getSolverGrid())
    np.testing.assert_allclose(mesh.getSolverGrid().imag / step, change, atol=1e-13)
    faces = np.repeat(np.isin(zones, [0, 1, 2]), 4)  # the last grid stays
    np.testing.assert_allclose(
        mesh.getSurfaceCoordinates().imag / step, tangent * faces[:, None], rtol=1e-15
    )
    assert np.abs(change).max() > 1
    mesh.writeGrid(str(tmp_path / "moved"))
    assert (tmp_path / "moved.cgns").exists()


def test_several_grids_refuse_nonsense(tmp_path):
    path = str(tmp_path / "overset.cgns")
    meshes.write_overset(path)
    for grids, message in (
        ({"hull": {}}, "no grid hull; it has wing, tip, far"),
        ({}, "optionsDict"),
    ):
        with pytest.raises(ValueError, match=message):
            MultiUSMesh(path, grids, MPI.COMM_SELF)
    with pytest.raises(ValueError, match="dtype"):
        MultiUSMesh(path, {"tip": {}}, MPI.COMM_SELF, dtype="D")
    mesh = MultiUSMesh(path, {"tip": {}}, MPI.COMM_SELF)
    square = np.array([[0.0, 0.5, 0], [1, 0.5, 0], [1, 1.5, 0], [0, 1.5, 0]])
    all_refused(
        (mesh.getSolverGrid, "setExternalMeshIndices"),
        (mesh.getSurfaceCoordinates, "setSurfaceDefinition"),
        (lambda: mesh.setSurfaceDefinition(square, [0, 1, 2, 3], [4], [7]), "cgnsBlockIDs"),
        (lambda: mesh.setSurfaceDefinition(square, [0, 1, 2, 3], [4]), "cgnsBlockIDs"),
        (lambda: mesh.warpDeriv(np.zeros(3), solverVec=False), "solverVec"),
    )


@pytest.mark.parametrize("kind", runs(["structured"], nightly=["openfoam"]))
def test_walls_and_planes_of_the_file_are_the_default(grids, kind):
    """Types of OpenFOAM's patches, and of CGNS's families, say what they are."""
    mesh = opened(grids, kind, specifiedSurfaces=None)
    nodes = grids[kind][1]
    floor = nodes[meshes.on(nodes, "floor")]
    assert np.array_equal(np.unique(mesh.getSurfaceCoordinates(), axis=0), np.unique(floor, axis=0))
    moved = warped(mesh)
    for name, axis in (("sym0", 0), ("sym1", 1)):
        rows = meshes.on(nodes, name)
        assert np.array_equal(moved[rows, axis], nodes[rows, axis])
        assert np.abs(moved[rows] - nodes[rows]).max() > 0.01


@pytest.mark.slow
def test_nodes_between_overset_grids_are_free(tmp_path):
    nodes = meshes.write_unstructured(
        tmp_path / "mesh.cgns", {"xmax": "Overset_outer", "floor": "wing_wall"}
    )
    mesh = USMesh({"gridFile": str(tmp_path / "mesh.cgns"), "useRotations": False}, MPI.COMM_SELF)
    change = warped(mesh, lambda x: x + 0.1 * x[:, 1:2] * np.array([0, 0, 1])) - nodes
    others = np.concatenate([meshes.on(nodes, name) for name in ("lid", "ymax", "floor", "sym1")])
    assert (change[np.setdiff1d(meshes.on(nodes, "xmax"), others), 2] > 1e-3).all()
    assert not change[np.setdiff1d(meshes.on(nodes, "ymax"), meshes.on(nodes, "floor"))].any()


@pytest.mark.nightly
def test_a_grid_between_overset_patches_turns_with_its_wall(tmp_path):
    """Nothing is fixed there: a turn of the wall about a line in it, and a shift, are those of the grid."""
    names = {name: f"overset_{k}" for k, name in enumerate(meshes.SIDES)} | {"floor": "wing_wall"}
    nodes = meshes.write_unstructured(tmp_path / "mesh.cgns", names)
    mesh = USMesh({"gridFile": str(tmp_path / "mesh.cgns")}, MPI.COMM_SELF)
    turn = np.array([[0.8, 0, 0.6], [0, 1, 0], [-0.6, 0, 0.8]])
    motion = lambda x: x @ turn.T + [0.1, 0.2, 0.3]  # noqa: E731
    np.testing.assert_allclose(warped(mesh, motion), motion(nodes), atol=1e-12)
    dot_is_equal(mesh)


def test_planes_hold_nodes_within_symmtol(grids):
    planes = [[[3e-5, 0, 0], [1, 0, 0]]]
    with pytest.raises(ValueError, match="holds no node"):
        opened(grids, "unstructured", symmetryPlanes=planes).getSurfaceCoordinates()
    mesh = opened(grids, "unstructured", symmetryPlanes=planes, symmTol=1e-4)
    assert len(mesh.getSurfaceCoordinates()) == (meshes.CELLS + 1) ** 2


@pytest.mark.parametrize(
    "kind", runs(["unstructured", "openfoam"], nightly=["structured", "plot3d"])
)
def test_grids_are_written(grids, kind, tmp_path):
    path, nodes = grids[kind]
    mesh = opened(grids, kind, symmetryPlanes=PLANES[2])
    warped(mesh)
    written = tmp_path / path.name
    mesh.writeGrid(str(written))
    new, old = io.read(written), io.read(path)
    assert np.array_equal(new.in_file_order(new.points).ravel(), mesh.getCommonGrid())
    assert np.array_equal(old.in_file_order(old.points), nodes)
    for name in (str(path), None):
        with pytest.raises(ValueError, match=r"fileName|was read from|exists"):
            mesh.writeGrid(name)


def test_numbers_are_doubles_whatever_the_mode_is(grids):
    with jax.enable_x64(False):
        mesh = opened(grids, "structured", symmetryPlanes=PLANES[1])
        warped(mesh)
        dot_is_equal(mesh)
        assert jax.numpy.ones(1).dtype == np.float32
    assert mesh.getCommonGrid().dtype == np.float64


def test_options_without_a_counterpart_are_named_once(grids):
    options = {
        "gridFile": str(grids["structured"][0]),
        "ldefFact": 2.0,
        "errTol": 1e-3,
        "aExp": 3.0,
        "symmTol": 1e-6,
    }
    with pytest.warns(UserWarning, match="aExp, LdefFact, errTol") as told:
        USMesh(options=options, comm=MPI.COMM_SELF)
    assert len(told) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        USMesh(
            options={"gridFile": options["gridFile"], "aExp": 3.0, "useRotations": True},
            comm=MPI.COMM_SELF,
        )


REFUSED = [
    ({"nonsense": 1}, "nonsense"),
    ({"gridFile": None}, "gridFile"),
    ({"fileType": 2}, "fileType"),
    ({"symmTol": "small"}, "symmTol"),
    ({"useRotations": 1}, "useRotations"),
    ({"specifiedSurfaces": [3]}, "specifiedSurfaces"),
    ({"specifiedSurfaces": ["roof"]}, "specifiedSurfaces.*roof.*floor"),
    ({"symmetrySurfaces": ["roof"]}, "symmetrySurfaces.*roof"),
    ({"symmetryPlanes": [[0, 0, 0]]}, "symmetryPlanes"),
    ({"specifiedSurfaces": None}, "no patch is a wall.*specifiedSurfaces"),
]


@pytest.mark.parametrize(("wrong", "message"), REFUSED)
def test_wrong_options_are_refused_by_name(grids, wrong, message):
    with pytest.raises(ValueError, match=message):
        opened(grids, "unstructured", **wrong).getSurfaceCoordinates()


def test_wrong_numbers_are_refused_by_name(grids, tmp_path):
    io.write(tmp_path / "flat.su2", cases.naca0015(points=300))
    mesh = opened(grids, "structured")
    (points, conn, sizes), count = faces_of(), len(mesh.getCommonGrid())
    define = mesh.setSurfaceDefinition
    all_refused(
        (lambda: USMesh(comm=MPI.COMM_SELF), "options"),
        (lambda: USMesh(options={"gridFile": "a.cgns"}, comm="world"), "comm"),
        (
            lambda: USMesh(options={"gridFile": str(tmp_path / "flat.su2")}, comm=MPI.COMM_SELF),
            "2-D",
        ),
        (lambda: define(points[:, :2], conn, sizes), "pts"),
        (lambda: define(points, conn + 1, sizes), "conn"),
        (lambda: define(points, conn, sizes + 1), "faceSizes"),
        (lambda: define(points, conn * 0.5, sizes), "conn"),
        (lambda: define(points + 50, conn, sizes), "no patch of the mesh lies on the surface"),
        (lambda: define(points[:0], conn[:0], sizes[:0]), "no points"),
        (lambda: mesh.setSurfaceCoordinates(np.zeros((3, 3))), "coordinates"),
        (lambda: mesh.setSurfaceCoordinates(mesh.getSurfaceCoordinates() * np.nan), "coordinates"),
        (lambda: mesh.getSolverGrid(), "setExternalMeshIndices"),
        (lambda: mesh.setExternalMeshIndices([count]), "indices"),
        (lambda: mesh.setExternalMeshIndices([0.5]), "indices"),
        (lambda: mesh.warpDeriv(np.zeros(4), solverVec=False), "dXv"),
        (lambda: mesh.warpDerivFwd(np.zeros((2, 3)), solverVec=False), "dXs"),
        (lambda: mesh.setSurfaceDefinitionFromFile(str(grids["plot3d"][0])), "surface in 3-D"),
    )


@pytest.mark.nightly
def test_the_extra_says_what_else_it_needs():
    """mpi4py without an MPI library is no ImportError of its own."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "MPI4PY_LIBMPI": "/nowhere/libmpi.so"}
    code = "import jaxmorph.integrations.idwarp"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=False
    )
    if done.returncode == 0:
        pytest.skip("this mpi4py is built for one MPI library")
    assert "ImportError: pieces over MPI need mpi4py and an MPI library: pip install" in done.stderr


@pytest.mark.nightly
def test_two_processes_have_what_one_has(grids, tmp_path):
    for kind, (name, _, write) in meshes.FILES.items():
        write(tmp_path / name, **({"parts": True} if kind == "openfoam" else {}))
    meshes.write_overset(tmp_path / "overset.cgns")
    for count in (1, 2):
        mpi_run(count, "mpi_idwarp", str(tmp_path))
    for kind in ("structured", "unstructured", "plot3d", "openfoam", "overset"):
        one, two = (np.load(tmp_path / f"{kind}-{count}.npz") for count in (1, 2))
        assert (
            set(one)
            == set(two)
            == {"grid", "dXs", "change", *(["solver"] if kind != "overset" else [])}
        )
        for name in one:
            np.testing.assert_allclose(
                two[name], one[name], rtol=0, atol=1e-10 * np.abs(one[name]).max(), err_msg=name
            )
    old, new = io.Decomposed(tmp_path / "case"), io.Decomposed(tmp_path / "moved")
    assert len(old) == len(new) == 2
    assert np.abs(np.asarray(new.read(1).points) - np.asarray(old.read(1).points)).max() > 0.01


@pytest.mark.parametrize(
    ("name", "kind", "becomes"),
    [("sym_overset", "", "overset"), ("asymmetric_part", "", ""), ("symm", "", "symmetry"), ("sym", "overset", "overset"),
     ("overset", "BCSymmetryPlane", "symmetry"), ("near_overset", "UserDefined", "overset"), ("side", "symmetryPlane", "symmetry")],
)  # fmt: skip
def test_patches_are_sorted_by_kind_then_by_name(name, kind, becomes):
    """What the file says counts; a name counts by the beginnings of its words."""
    points = np.stack(np.meshgrid([0.0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1).reshape(-1, 3)
    source = Source(pathlib.Path("a.cgns"), "CGNS", None, kinds={name: kind} if kind else {})
    mesh = jm.Mesh(
        points,
        {"hexahedron": np.array([[0, 4, 6, 2, 1, 5, 7, 3]])},
        {name: np.array([0, 2, 4, 6])},
        source,
    )
    options = {"specifiedSurfaces": None, "symmetrySurfaces": None, "symmetryPlanes": None}
    found = surface_room.patches_by_kind(mesh, options)
    assert {kind for kind, names in found.items() if name in names} == ({becomes} - {""})
