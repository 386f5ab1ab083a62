"""What files say beside cells and patches: kinds of patches, nodes that zones share, faces."""

import json
import warnings

import adf
import cgns
import foam
import h5py
import meshio
import numpy as np
import pytest
from cgns import two_blocks, unstructured
from foam import strip
from meshes import bricks, square
from plot3d import box
from plot3d import write as write_plot3d

import jaxmorph as jm
from jaxmorph import io
from jaxmorph.cli import main


def tunnel(path, symmetry="BCSymmetryPlane"):
    """A box in one zone: its floor moves; a far field above, a symmetry plane at the side, families for two of them."""
    axes = np.linspace(0, 1, 5), np.linspace(0, 1, 4), np.linspace(0, 1, 5)
    with h5py.File(path, "w", track_order=True) as file:
        base = cgns.base(file, 3, 3)
        zone = cgns.zone(base, "one", tuple(np.meshgrid(*axes, indexing="ij")))
        cgns.condition(zone, "low", [[1, 1, 1], [5, 4, 1]])
        cgns.condition(zone, "high", [[1, 1, 5], [5, 4, 5]], "far")
        cgns.condition(zone, "in", [[1, 1, 1], [1, 4, 5]], "far")
        cgns.condition(zone, "out", [[5, 1, 1], [5, 4, 5]], "far")
        cgns.condition(zone, "near side", [[1, 1, 1], [5, 1, 5]], "mirror")
        cgns.condition(zone, "other side", [[1, 4, 1], [5, 4, 5]], "unknown")
        cgns.node(cgns.node(base, "far", "Family_t"), "FamilyBC", "FamilyBC_t", "BCFarfield")
        cgns.node(cgns.node(base, "mirror", "Family_t"), "FamilyBC", "FamilyBC_t", symmetry)


@pytest.mark.parametrize("is_adf", [False, True])
def test_kinds_of_cgns_are_those_of_conditions_and_families(is_adf, tmp_path, capsys):
    tunnel(tmp_path / "a.cgns")
    path = tmp_path / "a.cgns"
    if is_adf:
        path = tmp_path / "b.cgns"
        adf.twin(tmp_path / "a.cgns", path)
    mesh = io.read(path)
    assert mesh.kinds == {"low": "BCWall", "far": "BCFarfield", "mirror": "BCSymmetryPlane"}
    assert io.symmetry(mesh) == ("mirror",)
    assert main(["info", str(path)]) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["mirror", "25", "nodes", "BCSymmetryPlane"] in lines
    assert ["unknown", "25", "nodes"] in lines
    assert main(["info", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["kinds"] == dict(mesh.kinds)


def test_conditions_of_one_family_that_differ_are_both_told(tmp_path):
    two_blocks(tmp_path / "a.cgns")
    with h5py.File(tmp_path / "a.cgns", "r+") as file:
        for place, kind in (("one/ZoneBC/b", "BCWallViscous"), ("two/ZoneBC/d", "BCWallInviscid")):
            del file[f"Base/{place}/ data"]
            file[f"Base/{place}/ data"] = np.frombuffer(kind.encode(), np.int8)
    mesh = io.read(tmp_path / "a.cgns")
    assert mesh.kinds == {
        "floor": "BCWallViscous, BCWallInviscid",
        "c": "BCWall",
        "e": "BCWall",
        "f": "BCWall",
    }
    assert io.symmetry(mesh) == ()


def prepared(mesh):
    """A plan of the floor alone, and what was told."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        plan = jm.prepare(mesh, "low")
    return plan, [str(each.message) for each in told if each.category is UserWarning]


def test_other_patches_are_taken_from_their_kinds(tmp_path):
    """The far field stays and the mirror slides, as if both were named; the patch of no kind is told as before."""
    tunnel(tmp_path / "a.cgns")
    mesh = io.read(tmp_path / "a.cgns")
    plan, (first, second) = prepared(mesh)
    assert first == (
        "No patches beside `moving` are named. By their kinds in the file `fixed` are 'far' (BCFarfield) and `symmetry` are "
        "'mirror' (BCSymmetryPlane). Name the patches to choose otherwise."
    )
    assert "'unknown'" in second
    assert "'mirror'" not in second
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        same = jm.prepare(mesh, "low", "far", symmetry="mirror")
    np.testing.assert_array_equal(plan.fixed, same.fixed)
    u = 0.05 * np.sin(3 * mesh.points[plan.moving]) * [0, 0, 1]
    np.testing.assert_array_equal(jm.deform(plan, u), jm.deform(same, u))


def test_a_symmetry_patch_in_no_list_slides_as_by_the_command_line(tmp_path, capsys):
    tunnel(tmp_path / "a.cgns")
    mesh = io.read(tmp_path / "a.cgns")
    with pytest.warns(UserWarning, match=r"^By their kinds in the file `symmetry` are 'mirror'"):
        boundary = jm.Boundary(mesh, "low", "far", free="unknown")
    assert len(boundary.planes) == 1
    lists = [
        "--moving",
        "low",
        "--fixed",
        "far",
        "--free",
        "unknown",
        "--method",
        "inverse-distance",
        "--translate",
        "0",
        "0",
        "0.1",
    ]
    out = str(tmp_path / "b.cgns")
    assert main(["deform", str(tmp_path / "a.cgns"), out, *lists]) == 0
    capsys.readouterr()
    plan = jm.prepare(boundary, method=jm.InverseDistance())
    moved = jm.deform(plan, np.tile([0.0, 0, 0.1], (len(plan.moving), 1)))
    np.testing.assert_allclose(io.read(out).points, moved, rtol=0, atol=1e-13)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        for more in ({"free": "mirror"}, {"sliding": "mirror"}, {"symmetry": "mirror"}):
            jm.Boundary(mesh, "low", "far", **more)
        assert not jm.Boundary(mesh, "low", mesh.patch("far")).planes  # ids may hold any patch
    assert not any("kinds in the file" in str(each.message) for each in told)


@pytest.mark.slow
def test_what_is_named_is_not_added_to(tmp_path):
    tunnel(tmp_path / "a.cgns")
    mesh = io.read(tmp_path / "a.cgns")
    with pytest.warns(UserWarning, match="neither moving, fixed nor on a symmetry plane") as told:
        plan = jm.prepare(mesh, "low", symmetry="mirror", method=jm.InverseDistance())
    assert len(plan.fixed) == 0
    assert not any("kinds" in str(each.message) for each in told)
    with pytest.warns(UserWarning, match="neither moving, fixed nor on a symmetry plane") as told:
        plan = jm.prepare(mesh, mesh.patch("low"), method=jm.InverseDistance())
    assert not any("kinds" in str(each.message) for each in told)


@pytest.mark.nightly
def test_a_bent_symmetry_patch_is_left_to_the_caller(tmp_path):
    tunnel(tmp_path / "a.cgns")
    mesh = io.read(tmp_path / "a.cgns")
    points = mesh.points + 0.05 * np.sin(3 * mesh.points[:, [2]]) * [0, 1, 0]
    plan, (first, second) = prepared(mesh.moved(points))
    assert "'mirror' (BCSymmetryPlane)" not in first
    assert "'mirror'" in second
    assert plan.images is None


def test_an_overset_patch_is_not_fixed_but_follows(tmp_path):
    """It lies inside of another grid: a grid that nothing else holds turns with its wall."""
    foam.write_case(tmp_path / "case", *foam.mixed(), foam.PATCHES)
    file = tmp_path / "case" / "constant" / "polyMesh" / "boundary"
    file.write_text(file.read_text().replace("type patch", "type overset"))
    mesh = io.read(tmp_path / "case")
    assert "overset" in mesh.kinds.values()
    with pytest.warns(UserWarning, match="neither moving, fixed nor on a symmetry plane") as told:
        plan = jm.prepare(mesh, "floor", method=jm.InverseDistance())
    assert len(plan.fixed) == 0
    assert not any("kinds in the file" in str(each.message) for each in told)


def test_every_format_has_the_nodes_of_its_file(tmp_path):
    """Blocks of PLOT3D share nodes, planes of an OpenFOAM case are one; elsewhere nodes are those of the file."""
    write_plot3d(tmp_path / "a.xyz", box(3, 2, 4), "plain", "<")
    mesh = io.read(tmp_path / "a.xyz")
    assert len(mesh.file_nodes) == 48
    assert len(mesh.points) < 48
    np.testing.assert_array_equal(mesh.in_file_order(mesh.points), mesh.points[mesh.file_nodes])
    points, cells, patches = strip(2, around=5)
    foam.write_case(tmp_path / "plane", points, cells, patches)
    mesh = io.read(tmp_path / "plane")
    assert "empty" not in mesh.kinds.values()
    np.testing.assert_array_equal(mesh.in_file_order(mesh.points), points)
    moved = mesh.in_file_order(np.asarray(mesh.points) * 2)
    flat = [axis for axis in range(3) if np.array_equal(moved[:, axis], points[:, axis])]
    axes = [axis for axis in range(3) if axis not in flat]
    np.testing.assert_array_equal(moved[:, axes], (mesh.points * 2)[mesh.file_nodes])
    io.write(tmp_path / "a.su2", bricks(2))
    mesh = io.read(tmp_path / "a.su2")
    np.testing.assert_array_equal(mesh.file_nodes, np.arange(len(mesh.points)))
    np.testing.assert_array_equal(mesh.in_file_order(mesh.points), mesh.points)
    io.write(tmp_path / "a.vtu", square(2))
    mesh = io.read(tmp_path / "a.vtu")
    io.write(tmp_path / "b.vtu", mesh.moved(mesh.points * 2))
    np.testing.assert_array_equal(
        mesh.in_file_order(mesh.points * 2), meshio.read(tmp_path / "b.vtu").points
    )
    with pytest.raises(ValueError, match="has shape"):
        mesh.in_file_order(mesh.points[:3])


def test_boundary_faces_of_patches(tmp_path):
    """Their areas are those of the box, and they look outwards."""
    tunnel(tmp_path / "a.cgns")
    mesh = io.read(tmp_path / "a.cgns")

    def areas(faces):
        a, b, c, d = (mesh.points[faces[:, k]] for k in range(4))
        return np.cross(c - a, d - b).sum(axis=0) / 2

    np.testing.assert_allclose(
        areas(jm.boundary_faces(mesh, "low")["quad"]), [0, 0, -1], atol=1e-12
    )
    np.testing.assert_allclose(
        areas(jm.boundary_faces(mesh, "mirror")["quad"]), [0, -1, 0], atol=1e-12
    )
    assert len(jm.boundary_faces(mesh, "low", "mirror")["quad"]) == 12 + 16
    np.testing.assert_allclose(areas(jm.boundary_faces(mesh)["quad"]), 0, atol=1e-12)
    assert len(jm.boundary_faces(mesh)["quad"]) == 2 * (12 + 12 + 16)
    with pytest.raises(ValueError, match="nowhere"):
        jm.boundary_faces(mesh, "nowhere")
    with pytest.raises(ValueError, match="no cells of 3 dimensions"):
        jm.boundary_faces(jm.Mesh(mesh.points))
    flat = jm.Mesh([[0.0, 0], [1, 0], [0, 1]], {"triangle": [[0, 1, 2]]}, {"low": [0, 1]})
    np.testing.assert_array_equal(jm.boundary_faces(flat, "low")["line"], [[0, 1]])


def test_unstructured_kinds(tmp_path):
    unstructured(tmp_path / "a.cgns")
    assert io.read(tmp_path / "a.cgns").kinds == {
        "high": "BCWall",
        "some": "BCWall",
        "old": "BCWall",
    }
