"""OpenFOAM's polyMesh: every form of the files, every shape of cell, and OpenFOAM's and VTK's own view of the result."""

import json
import re
import shutil

import foam
import numpy as np
import pytest
from foam import PATCHES, mixed, split, strip
from formats import rewritten
from meshes import bricks
from runs import over

import jaxmorph as jm
from jaxmorph import cases, io
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
    assert [name for name in after if after[name] != before[name]] == [
        next(n for n in before if "points" in n)
    ]
    np.testing.assert_array_equal(io.read(tmp_path / "b").points, moved)
    io.write(tmp_path / "a" / "0.5", mesh.moved(moved))
    assert any("0.5/polyMesh has others" in note for note in io.read(tmp_path / "a").source.notes)
    again = io.read(tmp_path / "a" / "0.5")
    assert not any("has others" in note for note in again.source.notes)
    np.testing.assert_array_equal(again.points, moved)
    assert again.cells.keys() == mesh.cells.keys()
    assert {
        name: text for name, text in foam.tree(tmp_path / "a").items() if "0.5" not in name
    } == before


@pytest.mark.parametrize("form", ["ascii", "binary", "binary-64-labels", "binary-big-endian-gz"])
def test_a_list_of_equal_numbers_is_one_number_in_braces(tmp_path, form):
    """As OpenFOAM writes the owners of the faces of one cell."""
    grid = bricks(1)
    sides = [("all", "wall", lambda face: True)]
    cells = foam.hexahedra(grid.cells["hexahedron"])
    form = foam.FORMS[form]
    foam.write_case(tmp_path / "a", np.asarray(grid.points), cells, sides, form)
    plain = io.read(tmp_path / "a")
    kind = f"{form.order}i{form.label // 8}"
    zero = np.zeros(1, kind).tobytes() if form.binary else b"0"
    folder = tmp_path / "a" / "constant" / "polyMesh"
    foam.write_file(folder, "owner", "labelList", b"6{" + zero + b"}", form)
    mesh = io.read(tmp_path / "a")
    np.testing.assert_array_equal(mesh.cells["hexahedron"], plain.cells["hexahedron"])
    foam.write_file(folder, "owner", "labelList", b"7{" + zero + b"}", form)
    with pytest.raises(ValueError, match="faces, owner and neighbour do not fit together"):
        io.read(tmp_path / "a")


@pytest.mark.parametrize("end", [" // x)", "\n\n// the end (1 2 3)\n// ) of the file //\n"])
def test_comments_at_the_end_may_hold_parentheses(tmp_path, end):
    points, cells = mixed()
    foam.write_case(tmp_path / "a", points, cells, PATCHES)
    for name in ("points", "faces", "owner"):
        file = tmp_path / "a" / "constant" / "polyMesh" / name
        file.write_text(file.read_text().rstrip() + end)
    mesh = io.read(tmp_path / "a")
    np.testing.assert_array_equal(mesh.points, points)
    np.testing.assert_array_equal(
        rewritten(tmp_path / "b", mesh.moved(points + 1)).points, points + 1
    )
    assert (tmp_path / "b" / "constant" / "polyMesh" / "points").read_text().endswith(end)


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
    moved = io.read(tmp_path / "a").moved(
        points + np.random.default_rng(9).integers(-4, 5, points.shape) / 8
    )
    found = rewritten(tmp_path / "b", moved)
    pieces = np.sort(np.asarray(found.cells["tetra"]), axis=1)
    assert len(np.unique(pieces, axis=0)) < len(pieces)
    assert found.cell_counts == {"polyhedron": 1}


@pytest.mark.parametrize("entry", ["1(wall)", "List<word> 2(wall near)", '( "wall" )', ""])
def test_patches_by_the_groups_of_the_case(tmp_path, capsys, entry):
    foam.write_case(tmp_path / "a", *split(), PATCHES)
    boundary = tmp_path / "a" / "constant" / "polyMesh" / "boundary"
    boundary.write_text(
        boundary.read_text().replace("inGroups 1(wall);", entry and f"inGroups {entry};")
    )
    mesh = io.read(tmp_path / "a")
    walls = {"wall": ("floor",)} if entry else {}
    near = {"near": ("floor",)} if "near" in entry else {}
    assert mesh.groups == walls | near | {"patch": ("rest", "none")}
    for group, names in mesh.groups.items():
        np.testing.assert_array_equal(mesh.patch(group), mesh.patch(*names))
        assert mesh.patch_names(group, "floor")[: len(names)] == names
    with pytest.raises(
        ValueError, match=r"this mesh has: 'floor', 'rest', 'none', and the groups .*'patch'"
    ):
        mesh.patch("roof")
    assert main(["info", str(tmp_path / "a"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["groups"] == {
        group: list(names) for group, names in mesh.groups.items()
    }


@pytest.mark.parametrize("normal", [0, 1, 2])
def test_cases_in_2d_move_both_planes_alike(tmp_path, normal):
    points, cells, patches = strip(normal)
    mesh = io.read(foam.write_case(tmp_path / "a", points, cells, patches))
    assert {kind: len(corners) for kind, corners in mesh.cells.items()} == {
        "quad": 27,
        "triangle": 2,
    }
    assert {name: len(nodes) for name, nodes in mesh.patches.items()} == {"far": 14, "hole": 14}
    (plane,) = [name for name, kind, _ in patches if kind == "empty"]
    with pytest.raises(ValueError, match=f"'{plane}' .empty. is no patch, for the mesh is in 2-D"):
        mesh.patch("hole", plane)
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
    foam.write_case(
        tmp_path / "wedge", points, cells, [("w", "wedge", patches[0][2]), *patches[1:]]
    )
    foam.write_case(tmp_path / "oblique", points + points[:, [2, 0, 1]], cells, patches)
    across = [("sides", "patch", patches[0][2]), ("far", "empty", patches[1][2]), patches[2]]
    foam.write_case(tmp_path / "across", points, cells, across)
    foam.write_case(tmp_path / "a", *mixed(), PATCHES)
    (tmp_path / "nothing").mkdir()
    mesh, triangle = io.read(tmp_path / "a"), jm.Mesh(np.zeros((3, 2)), {"triangle": [[0, 1, 2]]})
    io.write(tmp_path / "a" / "1", mesh)
    for new, name, message in (
        (None, "across", "across: patches of type empty, .* across 0 of the axes.* another type"),
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
    with pytest.raises(
        ValueError, match="12 vectors expected, one for each point of the case, found 11"
    ):
        io.read_sensitivity(file, mesh)
    with pytest.raises(ValueError, match="needs a mesh that was read from an OpenFOAM case"):
        io.read_sensitivity(file, jm.Mesh(mesh.points, mesh.cells))
    text = file.read_text()
    for old, new, message in (
        ("pointVectorField", "volVectorField", "expected, found volVectorField"),
        (
            "nonuniform List<vector>",
            "uniform (0 0 0); //",
            "found pointVectorField with one value for all points",
        ),
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


@over("region", ["fluid"], nightly=["solid"])
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
    words = [
        str(case / "constant" / region),
        str(case / "3"),
        "--moving",
        ".*",
        "--translate",
        "0",
        "0",
        "1",
    ]
    assert main(["deform", *words]) == 0
    capsys.readouterr()
    new = {name for name in foam.tree(case) if name not in before}
    assert new == {f"{time}/{region}/polyMesh/points" for time in "123"}
    np.testing.assert_array_equal(io.read(case / "2" / region).points, points + 1)
    io.write(tmp_path / "new", mesh.moved(points))
    after = {
        name: text for name, text in foam.tree(tmp_path / "new").items() if before[name] != text
    }
    assert list(after) == [f"constant/{region}/polyMesh/points"]
    np.testing.assert_array_equal(io.read(tmp_path / "new" / "constant" / region).points, points)


def test_a_case_of_regions_names_them(tmp_path, capsys):
    two_regions(tmp_path / "case")
    io.write(tmp_path / "case" / "1", io.read(tmp_path / "case" / "constant" / "fluid"))
    told = r"case: no OpenFOAM case.* Its regions, fluid, solid, have meshes .*: \S+case/constant/fluid\."
    with pytest.raises(ValueError, match=told):
        io.read(tmp_path / "case")
    assert main(["info", str(tmp_path / "case")]) == 2
    assert "fluid, solid" in capsys.readouterr().err
    with pytest.raises(ValueError, match=r"Its regions, fluid, have .*: \S+case/1/fluid\."):
        io.read(tmp_path / "case" / "1")


def turned(points):
    """The brick from 1 to 2 bent to a quarter of a ring: a rotation leads from one end to the other."""
    x, y, z = points.T
    return np.stack([(1 + y) * np.cos(np.pi / 2 * x), (1 + y) * np.sin(np.pi / 2 * x), z], axis=1)


@pytest.fixture(params=["translation", "rotation"])
def cyclic(request, tmp_path):
    """Bricks in the unit cube, cyclic from x = 0 to x = 1, straight or bent."""
    mesh = cases.bricks(cells=3)
    flat = np.asarray(mesh.points)
    cells = foam.hexahedra(mesh.cells["hexahedron"])

    def at(x):
        return lambda face: bool(np.allclose(flat[face, 0], x))

    patches = [
        ("in", "cyclic", at(0)),
        ("out", "cyclic", at(1)),
        ("walls", "wall", lambda face: True),
    ]
    points = flat if request.param == "translation" else turned(flat)
    foam.write_case(tmp_path / "case", points, cells, patches)
    boundary = tmp_path / "case" / "constant" / "polyMesh" / "boundary"
    text = boundary.read_text()
    for name, other in (("in", "out"), ("out", "in")):
        text = re.sub(rf'("{name}"\s*\{{)', rf"\1 neighbourPatch {other};", text)
    boundary.write_text(text)
    return tmp_path / "case", flat, points, request.param


def test_patches_that_move_alike_match(cyclic, tmp_path):
    folder, flat, points, kind = cyclic
    mesh = io.read(folder)
    bumped = flat.copy()
    bumped[:, 2] += 0.1 * np.sin(2 * np.pi * flat[:, 0]) + 0.1 * flat[:, 1] ** 2
    moved = bumped if kind == "translation" else turned(bumped)
    io.write(tmp_path / "alike", mesh.moved(moved))
    turn = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]])
    if kind == "rotation":
        io.write(tmp_path / "rigid", mesh.moved(points @ turn.T + 1))


def test_patches_that_drift_apart_are_an_error(cyclic, tmp_path):
    """One patch's inner face grows by a known way: a node of it moves by 0.02, a face's middle by a quarter of that."""
    folder, flat, points, _ = cyclic
    mesh = io.read(folder)
    here = np.flatnonzero(np.all(np.isclose(flat, [0, 1 / 3, 1 / 3]), axis=1))
    moved = points.copy()
    moved[here, 2] += 0.02
    told = r"'in' and 'out' no longer match: \d of 9 pairs.*Hold both patches fixed"
    with pytest.raises(ValueError, match=told) as error:
        io.write(tmp_path / "apart", mesh.moved(moved))
    assert float(re.findall(r"up to ([\d.]+) of", str(error.value))[0]) == pytest.approx(
        0.02 / 4 / (1 / 3), rel=1.3
    )
    assert not (tmp_path / "apart").exists()
    with pytest.raises(ValueError, match="no longer match"):
        io.write(folder / "1", mesh.moved(moved))


@pytest.mark.slow
def test_cyclic_patches_are_periodic(cyclic, tmp_path):
    """The file's own pairs, held as such: walls that move in any way leave a mesh that matches."""
    folder, _, points, _ = cyclic
    mesh = io.read(folder)
    (pair,) = io.periodic(mesh)
    assert (pair.patch, pair.partner) == ("in", "out")
    assert io.periodic(mesh.moved(points))
    assert not io.periodic(cases.bricks(cells=3))
    plan = jm.prepare(mesh, "walls", periodic=pair, method=jm.RBF.classic(jm.ThinPlateSpline()))
    u = 0.05 * np.random.default_rng(0).normal(size=(plan.n_moving, 3))
    moved = np.asarray(jm.deform(plan, u))
    assert np.abs(moved - points)[mesh.patch("in", "out")].max() > 0.01
    io.write(tmp_path / "moved", mesh.moved(moved))


def test_a_decomposed_case_is_warned_of(cyclic, tmp_path):
    folder, _, points, _ = cyclic
    mesh = io.read(folder)
    for k in range(2):
        (folder / f"processor{k}").mkdir()
    with pytest.warns(UserWarning, match=r"2 folders processor\* are not copied. Run decomposePar"):
        io.write(tmp_path / "new", mesh.moved(points + 1))
    with pytest.warns(UserWarning, match=r"2 folders processor\* keep the old points"):
        io.write(folder / "1", mesh.moved(points + 1))
