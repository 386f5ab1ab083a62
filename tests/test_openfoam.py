"""OpenFOAM's polyMesh: every form of the files, every shape of cell, and OpenFOAM's and VTK's own view of the result."""

import json
import shutil

import foam
import numpy as np
import pytest
from foam import PATCHES, mixed, split, strip
from formats import rewritten
from scipy.spatial import ConvexHull

import jaxmorph as jm
from jaxmorph import io
from jaxmorph.cli import main


@pytest.mark.parametrize("form", foam.FORMS)
def test_every_form_comes_back_as_it_was(tmp_path, form):
    points, cells = mixed()
    foam.write_case(tmp_path / "a", points, cells, PATCHES, foam.FORMS[form])
    before = foam.tree(tmp_path / "a")
    mesh = io.read(tmp_path / "a")
    exact = points if foam.FORMS[form].scalar == 64 else points.astype(np.float32)
    np.testing.assert_array_equal(mesh.points, exact)
    assert {kind: len(corners) for kind, corners in mesh.cells.items()} == dict.fromkeys(
        ("tetra", "pyramid", "wedge", "hexahedron"), 1
    )
    assert {name: nodes.tolist() for name, nodes in mesh.patches.items()} == {
        "floor": [0, 1, 2, 3], "rest": list(range(12)), "none": []}  # fmt: skip
    io.write(tmp_path / "same", mesh)
    assert foam.tree(tmp_path / "same") == before
    moved = (mesh.points * np.pi).astype(exact.dtype)
    io.write(tmp_path / "b", mesh.moved(moved))
    after = foam.tree(tmp_path / "b")
    assert [name for name in after if after[name] != before[name]] == [next(n for n in before if "points" in n)]
    np.testing.assert_array_equal(io.read(tmp_path / "b").points, moved)
    io.write(tmp_path / "a" / "0.5", mesh.moved(moved))
    again = io.read(tmp_path / "a" / "0.5")
    np.testing.assert_array_equal(again.points, moved)
    assert again.cells.keys() == mesh.cells.keys()
    assert {name: text for name, text in foam.tree(tmp_path / "a").items() if "0.5" not in name} == before


@pytest.mark.parametrize("end", [" // x)", "\n\n// the end (1 2 3)\n// ) of the file //\n"])
def test_comments_at_the_end_may_hold_parentheses(tmp_path, end):
    points, cells = mixed()
    foam.write_case(tmp_path / "a", points, cells, PATCHES)
    for name in ("points", "faces", "owner"):
        file = tmp_path / "a" / "constant" / "polyMesh" / name
        file.write_text(file.read_text().rstrip() + end)
    mesh = io.read(tmp_path / "a")
    np.testing.assert_array_equal(mesh.points, points)
    np.testing.assert_array_equal(rewritten(tmp_path / "b", mesh.moved(points + 1)).points, points + 1)
    assert (tmp_path / "b" / "constant" / "polyMesh" / "points").read_text().endswith(end)


def test_cells_have_the_volumes_of_their_hulls(tmp_path):
    points, cells = mixed()
    mesh = io.read(foam.write_case(tmp_path / "a", points, cells, PATCHES))
    report = jm.quality(mesh)
    assert int(report.inverted) == 0
    for kind, at in (("tetra", 3), ("pyramid", 2), ("wedge", 1), ("hexahedron", 0)):
        assert sorted(mesh.cells[kind][0].tolist()) == sorted({n for face in cells[at] for n in face})
    flat, cells = np.round(points), mixed()[1]
    volumes = np.asarray(jm.quality(io.read(foam.write_case(tmp_path / "flat", flat, cells, PATCHES))).volume)
    hulls = [ConvexHull(flat[sorted({n for face in faces for n in face})]).volume for faces in cells]
    np.testing.assert_allclose(np.sort(volumes), np.sort(hulls), rtol=1e-6)


def test_polyhedra_are_judged_by_pieces_between_their_own_nodes(tmp_path):
    points, cells = split()
    mesh = io.read(foam.write_case(tmp_path / "a", points, cells, PATCHES))
    assert len(mesh.points) == len(points)
    assert len(mesh.cells["hexahedron"]) == 4
    assert list(mesh.cells) == ["hexahedron", "tetra"]
    volume = np.asarray(jm.quality(mesh).volume)
    np.testing.assert_allclose([volume[:4].sum(), volume[4:].sum()], [1, 1], rtol=1e-6)
    assert volume.min() > 0.01
    middle = int(np.flatnonzero((points == [1, 0.5, 0.5]).all(axis=1))[0])
    for place, inverted in ((0.6, False), (1.4, False), (-0.5, True), (2.5, True)):
        moved = mesh.points.copy()
        moved[middle, 0] = place
        assert (int(jm.quality(mesh, moved).inverted) > 0) == inverted


def test_pieces_of_a_polyhedron_may_coincide(tmp_path):
    """A cube with four nodes on its edges: where two of its faces cut off the same triangle, a file with its points is read."""
    unit = [(x, y, z) for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
    points = np.array([*unit, (0.5, 0, 0), (0.5, 1, 0), (0.5, 0, 1), (0.5, 1, 1)])
    cell = [
        [0, 3, 9, 2, 1, 8],
        [4, 10, 5, 6, 11, 7],
        [0, 8, 1, 5, 10, 4],
        [1, 2, 6, 5],
        [2, 9, 3, 7, 11, 6],
        [3, 0, 4, 7],
    ]
    foam.write_case(tmp_path / "a", points, [cell], [("all", "wall", lambda face: True)])
    moved = io.read(tmp_path / "a").moved(points + np.random.default_rng(9).integers(-4, 5, points.shape) / 8)
    found = rewritten(tmp_path / "b", moved)
    pieces = np.sort(np.asarray(found.cells["tetra"]), axis=1)
    assert len(np.unique(pieces, axis=0)) < len(pieces)
    assert found.cell_counts == {"polyhedron": 1}


@pytest.mark.parametrize("entry", ["1(wall)", "List<word> 2(wall near)", '( "wall" )', ""])
def test_patches_by_the_groups_of_the_case(tmp_path, capsys, entry):
    foam.write_case(tmp_path / "a", *split(), PATCHES)
    boundary = tmp_path / "a" / "constant" / "polyMesh" / "boundary"
    boundary.write_text(boundary.read_text().replace("inGroups 1(wall);", entry and f"inGroups {entry};"))
    mesh = io.read(tmp_path / "a")
    walls = {"wall": ("floor",)} if entry else {}
    near = {"near": ("floor",)} if "near" in entry else {}
    assert mesh.groups == walls | near | {"patch": ("rest", "none")}
    for group, names in mesh.groups.items():
        np.testing.assert_array_equal(mesh.patch(group), mesh.patch(*names))
        assert mesh.patch_names(group, "floor")[: len(names)] == names
    with pytest.raises(ValueError, match=r"this mesh has: 'floor', 'rest', 'none', and the groups .*'patch'"):
        mesh.patch("roof")
    assert main(["info", str(tmp_path / "a"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["groups"] == {group: list(names) for group, names in mesh.groups.items()}


@pytest.mark.parametrize("normal", [0, 1, 2])
def test_cases_in_2d_move_both_planes_alike(tmp_path, normal):
    points, cells, patches = strip(normal)
    mesh = io.read(foam.write_case(tmp_path / "a", points, cells, patches))
    assert {kind: len(corners) for kind, corners in mesh.cells.items()} == {"quad": 27, "triangle": 2}
    assert {name: len(nodes) for name, nodes in mesh.patches.items()} == {"far": 14, "hole": 14}
    np.testing.assert_allclose(np.linalg.norm(mesh.points[mesh.patch("hole")], axis=1), 1)
    area = np.asarray(jm.quality(mesh).area)
    assert area.min() > 0
    np.testing.assert_allclose(area.sum(), 7 * np.sin(np.pi / 7) * 1.25, rtol=1e-6)
    again = rewritten(tmp_path / "b", mesh.moved(mesh.points * [1.1, 0.7]))
    np.testing.assert_array_equal(again.points, mesh.points * [1.1, 0.7])
    expected = points * np.insert([1.1, 0.7], normal, 1)
    np.testing.assert_array_equal(again.source.content.points, expected)


def test_what_is_refused(tmp_path):
    points, cells, patches = strip(2)
    foam.write_case(tmp_path / "wedge", points, cells, [("w", "wedge", patches[0][2]), *patches[1:]])
    foam.write_case(tmp_path / "oblique", points + points[:, [2, 0, 1]], cells, patches)
    across = [("sides", "patch", patches[0][2]), ("far", "empty", patches[1][2]), patches[2]]
    foam.write_case(tmp_path / "across", points, cells, across)
    foam.write_case(tmp_path / "a", *mixed(), PATCHES)
    (tmp_path / "nothing").mkdir()
    mesh, triangle = io.read(tmp_path / "a"), jm.Mesh(np.zeros((3, 2)), {"triangle": [[0, 1, 2]]})
    io.write(tmp_path / "a" / "1", mesh)
    for new, name, message in (
        (None, "across", "across: patches of type empty have 0 faces in front of 29 cells, .* another type"),
        (None, "wedge", r"patches of type wedge \(w\)"),
        (None, "oblique", "two planes across 0 of the axes"),
        (None, "nothing", "there is no folder constant/polyMesh"),
        (mesh, "a", "exists; name a new folder"),
        (mesh, "a/constant/new", "cannot be inside"),
        (mesh, "0.5", "must be one of the case"),
        (mesh, "across", "exists; name a new folder"),
        (mesh, "no/b", "there is no folder"),
        (triangle, "b", "only a mesh that was read from an OpenFOAM case"),
        (io.read(tmp_path / "a" / "1"), "a/1", "the mesh was read from this folder"),
    ):
        with pytest.raises(ValueError, match=message):
            io.read(tmp_path / name) if new is None else io.write(tmp_path / name, new)


@pytest.mark.parametrize("form", ["ascii", "binary", "ascii-gz"])
@pytest.mark.parametrize("make", [mixed, split])
def test_vtk_sees_the_same_mesh(tmp_path, form, make):
    pyvista = pytest.importorskip("pyvista")
    points, cells = make()
    mesh = io.read(foam.write_case(tmp_path / "a", points, cells, PATCHES, foam.FORMS[form]))
    io.write(tmp_path / "b", mesh.moved(mesh.points * [1, 2, 3] + 1e-3))
    (tmp_path / "b" / "b.foam").touch()
    seen = pyvista.OpenFOAMReader(tmp_path / "b" / "b.foam").read()["internalMesh"]
    np.testing.assert_allclose(seen.points, points * [1, 2, 3] + 1e-3, rtol=1e-6)
    assert seen.n_cells == len(cells)
    volume = np.asarray(jm.quality(mesh.moved(mesh.points * [1, 2, 3])).volume).sum()
    sizes = np.abs(seen.compute_cell_sizes()["Volume"])
    np.testing.assert_allclose(volume, sizes.sum(), rtol=2e-3 if make is mixed else 1e-6)


@pytest.mark.parametrize("form", ["ascii", "ascii-gz", "binary", "binary-big-endian-gz"])
@pytest.mark.parametrize("plane", [True, False])
def test_sensitivities_at_points(tmp_path, form, plane):
    """g . dx over all points of the case is what read_sensitivity gives . dx over the nodes of the mesh."""
    points, cells, patches = strip(1) if plane else (*mixed(), PATCHES)
    mesh = io.read(foam.write_case(tmp_path / "a", points, cells, patches))
    g = np.random.default_rng(3).normal(size=points.shape)
    file = tmp_path / "a" / "7" / "pointSensVecas1ESI"
    foam.write_point_vectors(file, g, foam.FORMS[form])
    dx = np.random.default_rng(4).normal(size=mesh.points.shape)
    moved = rewritten(tmp_path / "b", mesh.moved(mesh.points + dx)).source.content.points
    found = io.read_sensitivity(next(file.parent.glob("pointSens*")), mesh)
    np.testing.assert_allclose(np.vdot(found, dx), np.vdot(g, moved - points), rtol=1e-9)


def test_sensitivities_that_are_none(tmp_path):
    mesh = io.read(foam.write_case(tmp_path / "a", *mixed(), PATCHES))
    file = tmp_path / "s"
    foam.write_point_vectors(file, np.ones((11, 3)))
    with pytest.raises(ValueError, match="12 vectors expected, one for each point of the case, found 11"):
        io.read_sensitivity(file, mesh)
    with pytest.raises(ValueError, match="needs a mesh that was read from an OpenFOAM case"):
        io.read_sensitivity(file, jm.Mesh(mesh.points, mesh.cells))
    text = file.read_text()
    for old, new, message in (
        ("pointVectorField", "volVectorField", "expected, found volVectorField"),
        ("nonuniform List<vector>", "uniform (0 0 0); //", "found pointVectorField with one value for all points"),
    ):
        file.write_text(text.replace(old, new))
        with pytest.raises(ValueError, match=message):
            io.read_sensitivity(file, mesh)


def two_regions(case):
    """A case of two regions: constant/fluid/polyMesh and constant/solid/polyMesh."""
    for name in ("fluid", "solid"):
        foam.write_case(case.parent / name, *mixed(), PATCHES)
        shutil.move(case.parent / name / "constant", case / "constant" / name)
    shutil.move(case.parent / "fluid" / "system", case / "system")


@pytest.mark.parametrize("region", ["fluid", "solid"])
def test_the_points_of_a_region_go_to_the_region(tmp_path, capsys, region):
    """Into a time, which is read again, and into a new case; by Python and by the command line."""
    case = tmp_path / "case"
    two_regions(case)
    before = foam.tree(case)
    mesh = io.read(case / "constant" / region)
    points = mesh.points + 0.25
    io.write(case / "1", mesh.moved(points))
    again = io.read(case / "1" / region)
    np.testing.assert_array_equal(again.points, points)
    assert again.patches.keys() == mesh.patches.keys()
    with pytest.raises(ValueError, match="the mesh was read from this folder"):
        io.write(case / "1", again)
    io.write(case / "2", again.moved(points + 1))
    words = [str(case / "constant" / region), str(case / "3"), "--moving", ".*", "--translate", "0", "0", "1"]
    assert main(["deform", *words]) == 0
    capsys.readouterr()
    new = {name for name in foam.tree(case) if name not in before}
    assert new == {f"{time}/{region}/polyMesh/points" for time in "123"}
    np.testing.assert_array_equal(io.read(case / "2" / region).points, points + 1)
    io.write(tmp_path / "new", mesh.moved(points))
    after = {name: text for name, text in foam.tree(tmp_path / "new").items() if before[name] != text}
    assert list(after) == [f"constant/{region}/polyMesh/points"]
    np.testing.assert_array_equal(io.read(tmp_path / "new" / "constant" / region).points, points)


def test_a_case_of_regions_names_them(tmp_path, capsys):
    two_regions(tmp_path / "case")
    io.write(tmp_path / "case" / "1", io.read(tmp_path / "case" / "constant" / "fluid"))
    told = r"case: no OpenFOAM case.* It has 2 regions, fluid, solid, each .*: \S+case/constant/fluid\."
    with pytest.raises(ValueError, match=told):
        io.read(tmp_path / "case")
    assert main(["info", str(tmp_path / "case")]) == 2
    assert "fluid, solid" in capsys.readouterr().err
    with pytest.raises(ValueError, match=r"It has one region, fluid, .*: \S+case/1/fluid\."):
        io.read(tmp_path / "case" / "1")
