"""Polyhedra and polygons are judged whole, under the numbers of their file; what inverts a cell depends on who solves on it."""

import gzip
import json
import re
import shutil

import foam
import numpy as np
import pytest
from cgns import joined_polyhedra
from foam import PATCHES, mixed, split
from meshes import blocks, lattice

import jaxmorph as jm
from jaxmorph import cases, io
from jaxmorph._mesh.faces import Faces
from jaxmorph._mesh.polyhedra import tetrahedra
from jaxmorph.cli import main

HANGING = [[0, 1, 4, 7, 6], [1, 2, 5, 4], [4, 5, 8, 7], [2, 9, 10, 5], [5, 10, 8]]
"""A pentagon (a square with a hanging node in its right side), two small squares, a quad and a triangle."""

CORNERS = np.array(
    [
        [0, 0],
        [1, 0],
        [1.5, 0],
        [9, 9],
        [1, 0.5],
        [1.5, 0.5],
        [0, 1],
        [1, 1],
        [1.5, 1],
        [2, 0.1],
        [2.2, 0.7],
    ]
)


def slab(folder):
    """Writes the cells of HANGING as a 2-D case, one layer thick."""
    used = [k for k in range(len(CORNERS)) if k != 3]
    new, n = {k: i for i, k in enumerate(used)}, len(used)
    points = np.concatenate([np.column_stack([CORNERS[used], np.full(n, z)]) for z in (0, 0.1)])
    cells = []
    for corners in HANGING:
        base = [new[k] for k in corners]
        sides = [[a, b, b + n, a + n] for a, b in zip(base, base[1:] + base[:1], strict=True)]
        cells.append([base[::-1], [k + n for k in base], *sides])
    empty = ("sides", "empty", lambda face: np.ptp(points[face, 2]) == 0)
    foam.write_case(folder, points, cells, [empty, ("rim", "patch", lambda face: True)])
    return [CORNERS[corners] for corners in HANGING]


def shoelace(x):
    y = np.roll(x, -1, axis=0)
    return (x[:, 0] * y[:, 1] - y[:, 0] * x[:, 1]).sum() / 2


def test_polygons_of_a_2d_case_are_whole(tmp_path, capsys):
    polygons = slab(tmp_path / "a")
    mesh = io.read(tmp_path / "a")
    assert mesh.cell_counts == {"triangle": 1, "quad": 3, "polygon": 1}
    found = jm.face_quality(mesh)
    np.testing.assert_allclose(
        found.volume, [shoelace(polygon) for polygon in polygons], rtol=1e-12
    )
    assert not found.is_inverted.any()
    assert main(["info", str(tmp_path / "a")]) == 0
    assert "3 quad, 1 triangle, 1 polygon\n" in capsys.readouterr().out
    assert main(["quality", str(tmp_path / "a"), "--max-skewness", "0.9"]) == 2
    said = "1 of 5 cells are polygons, of which skewness is not defined. Limits on face skewness"
    assert said in capsys.readouterr().err
    # the hanging node is drawn into the pentagon: not convex, but seen from its centre
    moved, node = mesh.points.copy(), int(np.flatnonzero((mesh.points == [1, 0.5]).all(axis=1))[0])
    for place, is_inverted in ((0.75, False), (-0.5, True), (1.6, True)):
        moved[node, 0] = place
        assert jm.face_quality(mesh, moved).is_inverted.any() == is_inverted
    io.write(tmp_path / "b", mesh.moved(moved))
    assert main(["quality", str(tmp_path / "a"), str(tmp_path / "b")]) == 1
    assert re.search(
        r"of 5 cells are inverted, .*, by volumes and face pyramids\.", capsys.readouterr().err
    )


@pytest.mark.parametrize("kind", ["OpenFOAM", "CGNS"])
def test_polyhedra_are_whole(tmp_path, kind):
    """A cube and four small ones against its side, which makes it a polyhedron of nine faces."""
    if kind == "OpenFOAM":
        foam.write_case(tmp_path / "a", *split(), PATCHES)
        mesh = io.read(tmp_path / "a")
    else:
        joined_polyhedra(tmp_path / "a.cgns")
        mesh = io.read(tmp_path / "a.cgns")
    assert mesh.cell_counts == {"hexahedron": 4, "polyhedron": 1}
    found = jm.face_quality(mesh)
    np.testing.assert_allclose(found.volume, [1] + [0.25] * 4, rtol=1e-12)
    np.testing.assert_allclose(found.centroid[0], 0.5, rtol=1e-12)
    pyramids = np.array([1 / 6] * 5 + [1 / 24] * 4)
    # all pyramids of a box are alike
    np.testing.assert_allclose(
        found.pyramid, [pyramids.min() / pyramids.mean(), 1, 1, 1, 1], rtol=1e-12
    )
    # lines of centres are (1, 0.25, 0.25), and pass 0.125 by a face's centre
    assert found.non_orthogonality.max() == pytest.approx(
        np.degrees(np.arctan(np.sqrt(2) / 4)), rel=1e-9
    )
    assert found.skewness[0] == found.skewness.max() == pytest.approx(0.125 / 0.25, rel=1e-9)
    assert jm.face_quality(jm.Mesh(mesh.points, mesh.cells)).skewness[4:].max() != pytest.approx(
        0.5
    )
    cosines = [1 / np.linalg.norm([1, 0.25, 0.25])] * 4 + [1.0] * 4
    assert found.mean_non_orthogonality == pytest.approx(
        np.degrees(np.arccos(np.mean(cosines))), rel=1e-9
    )
    np.testing.assert_array_equal(np.sort(mesh.cell_ids[:4]), [1, 2, 3, 4])
    assert set(mesh.cell_ids[4:]) == {0}


def test_cells_of_several_types_have_the_numbers_of_the_case(tmp_path):
    points, cells = mixed()
    order = [3, 1, 0, 2]  # tetrahedron, wedge, hexahedron, pyramid
    foam.write_case(tmp_path / "a", points, [cells[k] for k in order], PATCHES)
    mesh = io.read(tmp_path / "a")
    assert list(mesh.cells) == ["hexahedron", "pyramid", "tetra", "wedge"]
    np.testing.assert_array_equal(mesh.cell_ids, [2, 3, 0, 1])
    in_order = jm.quality(mesh).volume
    np.testing.assert_allclose(
        jm.face_quality(mesh).volume[mesh.cell_ids], in_order, rtol=0.02
    )  # warped faces


@pytest.mark.parametrize("turned", [False, True])
def test_a_corner_that_is_not_convex_is_seen_by_finite_elements_alone(turned):
    points = np.array([[0, 0], [1, 0], [0.45, 0.45], [0, 1], [-1, 0], [-1, 1]])
    cells = np.array([[0, 1, 2, 3], [4, 0, 3, 5]])
    mesh = jm.Mesh(points, {"quad": cells[:, ::-1] if turned else cells})
    assert np.asarray(jm.quality(mesh).is_inverted).tolist() == [True, False]
    assert not jm.face_quality(mesh).is_inverted.any()
    points[2] = -0.5
    assert jm.face_quality(mesh.moved(points)).is_inverted[0]
    assert not jm.face_quality(mesh.moved(points)).is_inverted[1]
    points[0] = np.nan
    assert jm.face_quality(mesh.moved(points)).is_inverted.all()


@pytest.mark.parametrize("flat", [0.0, 1e-9, -1e-9, 3e-5])
def test_a_flat_corner_has_no_sign_to_lose(flat):
    """A corner of 180 degrees, to the digits of a file: its Jacobian says nothing, those of the others do."""
    points = np.array([[0, 0], [1, 0], [0.5 + flat, 0.5], [0, 1]])
    mesh = jm.Mesh(points, {"quad": [[0, 1, 2, 3]]})
    pushed = jm.quality(mesh, points - np.eye(4)[:, [2, 2]] * 0.01)
    assert int(pushed.inverted) == 0
    assert 0.5 < float(pushed.min_jacobian_ratio) < 1
    assert int(jm.quality(mesh, points * [1, 1] - np.eye(4)[:, [2, 2]] * 0.6).inverted) == 1
    angle = 0.01  # of a corner that is not flat
    points[2] = [0.5 + angle, 0.5]
    assert (
        int(jm.quality(jm.Mesh(points, mesh.cells), points - np.eye(4)[:, [2, 2]] * 0.02).inverted)
        == 1
    )


def test_before_and_after_are_judged_alike(tmp_path, capsys):
    """A cell that is inverted from the start is so before and after; one that the motion inverts is the fault."""
    points, quads = lattice(np.arange(4.0), np.arange(3.0)), blocks(np.arange(12).reshape(4, 3))
    points[0] = [0.8, 0.8]  # the first cell is not convex
    mesh = jm.Mesh(points, {"quad": quads}, {"rim": [0, 1, 2, 3, 5, 6, 8, 9, 10, 11]})
    for name, place in (("a", None), ("b", [1.1, 1.05]), ("c", [2.5, 1.5])):
        if place:
            points[4] = place
        io.write(tmp_path / f"{name}.su2", mesh.moved(points.copy()))
    a, b, c = (str(tmp_path / f"{name}.su2") for name in "abc")
    expected = {b: (1, 1, 0), c: (1, 3, 1)}
    for file, (before, after, status) in expected.items():
        assert main(["quality", a, file]) == status
        row = re.search(r"inverted cells +(\d+) +(\d+)\n", capsys.readouterr().out)
        assert (int(row[1]), int(row[2])) == (before, after), file
    assert main(["quality", a, c, "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["after"]["inverted_by"] == "corner Jacobians"


@pytest.mark.parametrize("dimension", [2, 3])
def test_whole_cells_are_measured_as_checkmesh_does(tmp_path, dimension):
    foam.need_openfoam()
    if dimension == 2:
        slab(tmp_path / "a")
    else:
        foam.write_case(tmp_path / "a", *split(), PATCHES)
    done, found = (
        foam.run(tmp_path / "a", "checkMesh", "-constant"),
        jm.face_quality(io.read(tmp_path / "a")),
    )
    expected = re.search(r"non-orthogonality Max: (\S+) average: (\S+)", done).groups()
    measured = [found.non_orthogonality.max(), found.mean_non_orthogonality]
    np.testing.assert_allclose(measured, [*map(float, expected)], rtol=2e-5)
    assert f"cells:            {len(found.volume)}\n" in done
    skewness = float(re.search(r"Max skewness = (\S+)", done)[1].rstrip(","))
    assert skewness == pytest.approx(found.skewness.max(), rel=2e-5)


@pytest.mark.parametrize("build", [split, mixed])
def test_the_face_aspect_ratio_of_whole_cells_is_that_of_their_faces(tmp_path, build):
    """checkMesh's formula, from Newell's area vectors of the case's own lists of faces."""
    points, cells = build()
    stretched = np.asarray(points) * [1.0, 2.0, 0.3]
    foam.write_case(tmp_path / "a", stretched, cells, PATCHES)
    expected = []
    for faces in cells:
        x = [stretched[face] for face in faces]
        areas = np.array(
            [np.cross(corners, np.roll(corners, -1, axis=0)).sum(axis=0) / 2 for corners in x]
        )
        volume = (
            sum(area @ corners.mean(axis=0) for area, corners in zip(areas, x, strict=True)) / 3
        )
        seen = np.abs(areas).sum(axis=0)
        expected.append(max(seen.max() / seen.min(), seen.sum() / 6 / abs(volume) ** (2 / 3)))
    found = jm.face_quality(io.read(tmp_path / "a")).aspect_ratio
    np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize("turned", [False, True])
def test_a_mesh_turned_inside_out_as_a_whole_is_inverted(turned):
    """However it numbers its cells: no neighbour is left that could tell."""
    mesh = cases.naca0015(points=300)
    cells = {
        kind: np.asarray(ids)[:, ::-1] if turned else ids
        for kind, ids in mesh.cells.items()
        if kind == "quad"
    }
    mesh = jm.Mesh(mesh.points, cells)
    assert not jm.face_quality(mesh).is_inverted.any()
    assert not jm.face_quality(
        mesh, np.array(mesh.points) @ [[0.8, 0.6], [-0.6, 0.8]]
    ).is_inverted.any()
    assert jm.face_quality(mesh, mesh.points * [1, -1]).is_inverted.all()


def test_polyhedra_are_cut_alike_however_they_are_numbered():
    """Two prisms on a regular hexagon: all fans and all apexes are equally good."""
    angle = np.pi / 3 * np.arange(6)
    points = np.concatenate(
        [np.stack([np.cos(angle), np.sin(angle), 0 * angle + z], axis=1) for z in range(3)]
    )
    starts = [(6 * c + k, 6 * c + (k + 1) % 6) for c in (0, 1) for k in range(6)]
    around = [[here, after, after + 6, here + 6] for here, after in starts]
    sides = [[*range(6, 12)], *around, [*range(5, -1, -1)], [*range(12, 18)]]
    owner, neighbour = np.array([0, *[0] * 6, *[1] * 6, 0, 1]), np.array([1, *[-1] * 14])
    random, found = np.random.default_rng(0), []
    for _ in range(5):
        new = random.permutation(18)
        old = np.argsort(new)
        turned = [np.roll(new[side], random.integers(6)) for side in sides]
        faces = Faces(np.concatenate(turned), np.cumsum([0, *map(len, turned)]), owner, neighbour)
        corners, cell = tetrahedra(faces, np.arange(2), points[old])
        volumes = np.linalg.det(points[old][corners[:, 1:]] - points[old][corners[:, :1]]) / 6
        np.testing.assert_allclose(np.bincount(cell, volumes), 1.5 * 3**0.5)
        found.append(sorted(np.sort(old[corners], axis=1).tolist()))
    assert all(each == found[0] for each in found)


@pytest.mark.parametrize("sides", [(1.0, 1.0, 1.0), (3.0, 0.5, 2.0), (0.1, 0.2, 7.0)])
def test_the_face_aspect_ratio_of_boxes_and_prisms_has_a_closed_form(sides):
    a, b, c = sides
    box = [[0, 0, 0], [a, 0, 0], [a, b, 0], [0, b, 0], [0, 0, c], [a, 0, c], [a, b, c], [0, b, c]]
    prism = [box[k] for k in (0, 1, 3, 4, 5, 7)]
    seen = {"hexahedron": (2 * b * c, 2 * a * c, 2 * a * b), "wedge": (2 * b * c, 2 * a * c, a * b)}
    volumes = {"hexahedron": a * b * c, "wedge": a * b * c / 2}
    for kind, corners in (("hexahedron", box), ("wedge", prism)):
        mesh = jm.Mesh(np.array(corners), {kind: np.arange(len(corners))[None]})
        expected = max(
            max(seen[kind]) / min(seen[kind]), sum(seen[kind]) / 6 / volumes[kind] ** (2 / 3)
        )
        np.testing.assert_allclose(jm.face_quality(mesh).aspect_ratio, [expected], rtol=1e-12)
    flat = jm.Mesh(np.array(box)[:4, :2], {"quad": [[0, 1, 2, 3]]})
    np.testing.assert_allclose(jm.face_quality(flat).aspect_ratio, [max(a / b, b / a)], rtol=1e-12)


@pytest.mark.nightly
def test_a_snapped_mesh_is_judged_as_checkmesh_does(tmp_path, capsys):
    """OpenFOAM's flange, 19,314 cells of which 1,544 are polyhedra and some have collapsed corners: moved, and not refused."""
    foam.need_openfoam()
    case = tmp_path / "a"
    shutil.copytree(foam.EXAMPLES / "mesh" / "snappyHexMesh" / "flange", case)
    for file in case.rglob("*Dict.gz"):
        file.with_suffix("").write_bytes(gzip.decompress(file.read_bytes()))
    shutil.copy(
        foam.EXAMPLES / "resources" / "geometry" / "flange.stl.gz", case / "constant" / "triSurface"
    )
    for command in (["blockMesh"], ["surfaceFeatureExtract"], ["snappyHexMesh", "-overwrite"]):
        foam.run(case, *command)
    for name in ("0", "log.blockMesh"):
        shutil.rmtree(case / name, ignore_errors=True)
    fixed = [patch for patch in io.read(case).patches if patch != "flange_patch3"]
    flags = [
        "--moving",
        "flange_patch3",
        "--fixed",
        *fixed,
        "--translate",
        "0",
        "0",
        "2e-4",
        "--json",
    ]
    assert main(["deform", str(case), str(tmp_path / "b"), *flags]) == 0
    after = json.loads(capsys.readouterr().out)["after"]
    done = foam.run(tmp_path / "b", "checkMesh", "-constant")
    assert "Face pyramids OK." in done
    expected = re.search(r"non-orthogonality Max: (\S+) average: (\S+)", done).groups()
    found = [after["max_non_orthogonality"], after["mean_non_orthogonality"]]
    np.testing.assert_allclose(found, [*map(float, expected)], rtol=2e-5)
    assert (after["cells"], after["inverted"]) == (19314, 0)


def test_whole_cells_are_drawn_in_the_colour_of_their_value(tmp_path):
    """All pieces of a polyhedron have its value; values of pieces are taken as well, and no other number of them."""
    plot = pytest.importorskip("jaxmorph.plot")
    joined_polyhedra(tmp_path / "a.cgns")
    mesh = io.read(tmp_path / "a.cgns")
    whole, pieces = jm.face_quality(mesh).volume, len(mesh.cell_ids)
    assert len(whole) < pieces
    drawn = [plot.surface(mesh, values=values) for values in (whole, whole[mesh.cell_ids])]
    for plotter in drawn:
        centres, values = plotter.mesh.cell_centers().points, plotter.mesh.cell_data["values"]
        outer = (
            np.abs(centres[:, 0] - 1) > 1e-9
        )  # faces between the cube and the others are of either
        of_cube = centres[outer, 0] < 1
        np.testing.assert_allclose(values[outer], np.where(of_cube, 1, 0.25), rtol=1e-12)
        assert {*of_cube.tolist()} == {False, True}
    with pytest.raises(
        ValueError, match=rf"shape \(6,\); this mesh has 5 cells, in {pieces} pieces"
    ):
        plot.surface(mesh, values=np.ones(6))
    slab(tmp_path / "a")
    mesh = io.read(tmp_path / "a")
    whole = jm.face_quality(mesh).volume
    assert len(whole) < len(mesh.cell_ids)
    colours = plot.mesh(mesh, values=whole).collections[0].get_array()
    np.testing.assert_array_equal(colours, whole[mesh.cell_ids])
