"""New cells in files of the kind that the old ones came from: cases of OpenFOAM, and CGNS."""

import functools

import cgns
import foam
import h5py
import numpy as np
import pytest

import jaxmorph as jm
from jaxmorph import cases, io
from jaxmorph._host.cells.topology import FACES

pytest.importorskip("gmsh")

BOXES = {"upper": (-2.0, -1.0, 0.5, 1.5), "lower": (-0.5, 0.5, -1.5, -0.5)}


def written(case, mesh: jm.Mesh, more=()):
    """A case of a 3-D mesh, whose patches have a type each."""
    cells = [
        [[row[k] for k in face] for face in FACES[kind]]
        for kind, ids in mesh.cells.items()
        for row in np.asarray(ids).tolist()
    ]
    patches = {name: {*nodes.tolist()} for name, nodes in mesh.patches.items()}
    tests = [(name, "wall", nodes.issuperset) for name, nodes in patches.items()]
    return foam.write_case(case, np.asarray(mesh.points), cells, [*more, *tests])


def layer(mesh: jm.Mesh, normal: int) -> tuple[jm.Mesh, list]:
    """One layer of hexahedra, its nodes mixed up, and a patch for each of its planes."""
    flat = np.asarray(mesh.points)
    n = len(flat)
    order = np.random.default_rng(normal).permutation(2 * n)
    points = np.empty((2 * n, 3))
    points[order] = np.insert(np.tile(flat, (2, 1)), normal, np.repeat([0.1, 0.3], n), axis=1)
    quads = np.asarray(mesh.cells["quad"])
    ends = [quads, quads + n]
    corners = order[np.hstack(ends[:: -1 if normal == 1 else 1])]
    patches = {name: order[np.concatenate([ids, ids + n])] for name, ids in mesh.patches.items()}
    planes = [
        (name, "empty", {*np.flatnonzero(points[:, normal] == z).tolist()}.issuperset)
        for name, z in (("low", 0.1), ("high", 0.3))
    ]
    return jm.Mesh(points, {"hexahedron": corners}, patches), planes


@functools.cache
def dented(kind: str) -> tuple[jm.Mesh, np.ndarray]:
    mesh = cases.bricks(kind, cells=5)
    x = np.asarray(mesh.points)
    low, high = x.min(axis=0), x.max(axis=0)
    bump = np.prod(np.sin(np.pi * (x - low) / (high - low)), axis=1)
    return mesh, x + 0.26 * (high - low) * bump[:, None]


def assert_same(back: jm.Mesh, mesh: jm.Mesh) -> None:
    """Equal points, patches and kinds, and cells, whose corners may begin with another one."""
    np.testing.assert_array_equal(back.points, mesh.points)
    assert {*back.cells} == {*mesh.cells}
    for kind, ids in mesh.cells.items():
        own, other = (np.sort(np.asarray(each), axis=1) for each in (back.cells[kind], ids))
        np.testing.assert_array_equal(own, other)
    assert {*back.patches} == {*mesh.patches}
    for name, nodes in mesh.patches.items():
        np.testing.assert_array_equal(back.patches[name], np.unique(nodes))
    assert back.kinds == mesh.kinds


@pytest.mark.parametrize("kind", ["hexahedron", "tetra", "wedge"])
def test_a_case_of_openfoam_gets_new_cells(tmp_path, kind):
    mesh, points = dented(kind)
    old = io.read(written(tmp_path / "old", mesh))
    new = jm.remesh(old, points, target=0.4).mesh
    assert new.cells["tetra"].shape[0] > 0
    io.write(tmp_path / "new", new.moved(1.5 * np.asarray(new.points)))
    back = io.read(tmp_path / "new")
    assert_same(back, new.moved(1.5 * np.asarray(new.points)))
    assert back.groups == old.groups
    assert (tmp_path / "new" / "system" / "controlDict").is_file()
    again = jm.remesh(back, back.points, cells=[len(back.cell_ids) - 1]).mesh
    io.write(tmp_path / "again", again)
    assert_same(io.read(tmp_path / "again"), again)
    foam.need_openfoam()
    assert foam.verdict(tmp_path / "new") == foam.verdict(tmp_path / "again") == ["Mesh OK."]


@pytest.mark.parametrize("normal", [0, 1, 2])
def test_a_case_in_2d_gets_new_cells(tmp_path, normal):
    flat = cases.bodies(BOXES, box=(-4.0, 4.0, -3.0, 3.0))
    mesh, planes = layer(flat, normal)
    old = io.read(written(tmp_path / "old", mesh, planes))
    plan = jm.prepare(old, "upper", ("lower", "farfield"))
    points = jm.deform(plan, np.tile([1.2, 0.0], (plan.n_moving, 1)))
    new = jm.remesh(old, points, target=0.45).mesh
    assert len(new.cells["triangle"])
    io.write(tmp_path / "new", new)
    assert_same(io.read(tmp_path / "new"), new)
    foam.need_openfoam()
    assert foam.verdict(tmp_path / "new") == ["Mesh OK."]


def test_cases_that_cannot_have_new_cells_are_refused(tmp_path):
    mesh, points = dented("hexahedron")
    case = written(tmp_path / "old", mesh)
    new = jm.remesh(io.read(case), points, target=0.4).mesh
    with pytest.raises(ValueError, match="goes into a new folder"):
        io.check_output(case / "1", new)
    with pytest.raises(ValueError, match="only a mesh that was read from an OpenFOAM case"):
        io.check_output(tmp_path / "new", jm.remesh(mesh, points, target=0.4).mesh)
    boundary = case / "constant" / "polyMesh" / "boundary"
    boundary.write_text(boundary.read_text().replace("type wall", "type cyclicAMI", 1))
    with pytest.raises(ValueError, match="floor is of type cyclicAMI"):
        io.check_output(tmp_path / "new", new)
    boundary.write_text(boundary.read_text().replace("type cyclicAMI", "type wall"))
    patches = {name: new.patches[name] for name in ("floor", "sides")}
    with pytest.raises(ValueError, match="a case needs the patch of each"):
        io.write(tmp_path / "new", jm.Mesh(new.points, new.cells, patches, new.source))
    assert not (tmp_path / "new").exists()


def test_zones_of_a_case_are_told(tmp_path):
    mesh, points = dented("tetra")
    case = written(tmp_path / "old", mesh)
    zones = b"1(inner { type cellZone; cellLabels List<label> 2(0 1); })"
    foam.write_file(
        case / "constant" / "polyMesh", "cellZones", "regIOobject", zones, foam.FORMS["ascii"]
    )
    new = jm.remesh(io.read(case), points, target=0.4).mesh
    with pytest.warns(UserWarning, match="cellZones are of the old cells"):
        io.write(tmp_path / "new", new)
    assert not (tmp_path / "new" / "constant" / "polyMesh" / "cellZones").exists()


def test_kinds_of_conditions_stay_in_cgns(tmp_path):
    mesh, points = dented("tetra")
    io.write(tmp_path / "plain.cgns", mesh)
    with h5py.File(tmp_path / "plain.cgns", "r+") as file:
        family = file["Base/floor"]
        del family["FamilyBC"]
        cgns.node(family, "FamilyBC", "FamilyBC_t", "BCWallViscous")
    old = io.read(tmp_path / "plain.cgns")
    assert old.kinds == {"floor": "BCWallViscous"}
    new = jm.remesh(old, points, target=0.4).mesh
    io.write(tmp_path / "new.cgns", new)
    assert_same(io.read(tmp_path / "new.cgns"), new)
