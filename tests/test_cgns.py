"""CGNS: files made here node by node, and VTK's view of the result."""

import os
import shutil
import subprocess

import cgns
import foam
import h5py
import numpy as np
import pytest
from cgns import joined_polyhedra, two_blocks, unstructured
from formats import rewritten
from runs import runs

import jaxmorph as jm
from jaxmorph import cases, io


def test_structured_zones_are_joined_and_written_back(tmp_path):
    mesh = io.read(two_blocks(tmp_path / "a.cgns"))
    assert mesh.points.shape == (4 * 9 + 2 * 9, 3)
    assert len(mesh.cells["hexahedron"]) == 12 + 8
    report = jm.quality(mesh)
    assert int(report.inverted) == 0
    np.testing.assert_allclose(np.abs(np.asarray(report.volume)).sum(), 2, rtol=1e-6)
    at = {name: mesh.points[nodes] for name, nodes in mesh.patches.items()}
    counts = {name: len(nodes) for name, nodes in mesh.patches.items() if name != "unnamed"}
    assert counts == {"inlet": 9, "floor": 18, "c": 12, "e": 6, "f": 2}
    assert (at["inlet"][:, 0] == 0).all()
    assert (at["floor"][:, 2] == 0).all()
    assert (at["e"][:, 0] == 2).all()
    inside = ((at["unnamed"] > 0) & (at["unnamed"] < [2, 1, 1])).all(axis=1)
    assert not inside.any()


def test_unstructured_zones(tmp_path):
    points = unstructured(tmp_path / "a.cgns")
    mesh = io.read(tmp_path / "a.cgns")
    np.testing.assert_array_equal(mesh.points, points)
    assert {kind: corners.tolist() for kind, corners in mesh.cells.items()} == {
        "hexahedron": [[0, 1, 2, 3, 4, 5, 6, 7]], "wedge": [[1, 8, 2, 5, 9, 6]]}  # fmt: skip
    named = {name: nodes.tolist() for name, nodes in mesh.patches.items() if name != "unnamed"}
    assert named == {
        "wall": [0, 1, 2, 3, 8],
        "high": [4, 5, 6, 7],
        "some": [0, 7],
        "old": [1, 2, 4, 5, 6, 7, 8],
    }


def test_a_c_grid_is_joined_along_its_wake_and_not_at_its_wall(tmp_path):
    """One 2-D block round a plate of no thickness: the wake's nodes come twice, the plate's stay two."""
    s = np.array([2, 1.5, 1, 0.5, 0, 0.5, 1, 1.5, 2])
    side = np.array([-1, -1, -1, -1, 0, 1, 1, 1, 1])
    height = np.linspace(0, 1, 4)
    x = s[:, None] - (side == 0)[:, None] * height
    y = side[:, None] * height
    with h5py.File(tmp_path / "a.cgns", "w", track_order=True) as file:
        zone = cgns.zone(cgns.base(file, 2, 2), "c", (x, y))
        cgns.condition(zone, "plate", [[3, 1], [7, 1]])
        cgns.condition(zone, "far", [[1, 4], [9, 4]])
    mesh = io.read(tmp_path / "a.cgns")
    assert len(mesh.points) == 9 * 4 - 3
    assert mesh.cells["quad"].shape == (24, 4)
    assert len(mesh.patch("plate")) == 4
    assert (mesh.points[mesh.patch("unnamed"), 0] == 2).all()


def test_what_is_refused(tmp_path):
    mesh = io.read(two_blocks(tmp_path / "a.cgns"))
    os.utime(tmp_path / "a.cgns", ns=(0, 0))
    with pytest.raises(ValueError, match="has changed since the mesh was read"):
        io.write(tmp_path / "b.cgns", mesh)
    (tmp_path / "c.cgns").write_bytes((tmp_path / "a.cgns").read_bytes()[:3000])
    with pytest.raises(ValueError, match="not a CGNS file in HDF5"):
        io.read(tmp_path / "c.cgns")
    with h5py.File(tmp_path / "d.cgns", "w") as file:
        zone = cgns.zone(cgns.base(file, 3, 3), "n", tuple(np.eye(3)), 1)
        cgns.elements(zone, "curved", 25, [1, 2, 3] * 3, 1, 1)
    with pytest.raises(ValueError, match="zone n: section curved has elements of type 25; linear"):
        io.read(tmp_path / "d.cgns")
    with h5py.File(tmp_path / "e.cgns", "w") as file:
        zone = cgns.zone(cgns.base(file, 2, 2), "linked", tuple(np.zeros((2, 3, 3))))
        del zone["GridCoordinates"]
        zone["GridCoordinates"] = h5py.ExternalLink("a.cgns", "/Base/one/GridCoordinates")
    with pytest.raises(ValueError, match=r"linked/GridCoordinates is a link to a\.cgns"):
        io.read(tmp_path / "e.cgns")
    assert sorted(file.name for file in tmp_path.iterdir()) == [f"{name}.cgns" for name in "acde"]


def test_polyhedra(tmp_path):
    points = joined_polyhedra(tmp_path / "a.cgns")
    mesh = io.read(tmp_path / "a.cgns")
    np.testing.assert_array_equal(mesh.points, points)
    assert len(mesh.cells["hexahedron"]) == 4
    report = jm.quality(mesh)
    assert int(report.inverted) == 0
    np.testing.assert_allclose(np.asarray(report.volume).sum(), 2, rtol=1e-6)
    assert set(mesh.patches) == {"floor", "unnamed"}
    np.testing.assert_array_equal(mesh.patch("floor"), np.flatnonzero(points[:, 2] == 0))
    inside = ((points > 0) & (points < [2, 1, 1])).all(axis=1)
    np.testing.assert_array_equal(mesh.patch("floor", "unnamed"), np.flatnonzero(~inside))
    good = (tmp_path / "a.cgns").read_bytes()
    for part, value, message in (
        ("cells/ElementConnectivity", 999, "NFACE_n names faces that are in no section NGON_n"),
        (
            "faces/ElementConnectivity",
            2,
            r"\d cells do not close, first cell \d: their faces are damaged",
        ),
        ("faces/ElementStartOffset", 1, "the offsets of section faces do not cut its"),
    ):
        (tmp_path / "a.cgns").write_bytes(good)
        with h5py.File(tmp_path / "a.cgns", "r+") as file:
            file[f"Base/p/{part}/ data"][0] = value
        with pytest.raises(ValueError, match=f"zone p: {message}"):
            io.read(tmp_path / "a.cgns")
    (tmp_path / "a.cgns").write_bytes(good)
    with h5py.File(tmp_path / "a.cgns", "r+") as file:
        del file["Base/p/cells/ElementStartOffset"]
    with pytest.raises(ValueError, match="section cells has no ElementStartOffset"):
        io.read(tmp_path / "a.cgns")


def place_of(file, name):
    """A data set of the first zone, and the group that holds it."""
    places = []
    file.visit(lambda place: places.append(place) if place.endswith(f"{name}/ data") else None)
    return file[places[0]].parent


@pytest.mark.parametrize("name", ["CoordinateX", "Density"])
@pytest.mark.parametrize("how", ["external storage", "virtual", "link"])
def test_data_of_other_files_are_refused_and_never_written(tmp_path, name, how):
    """Whatever the data set is: the file outside keeps its bytes, and so does the input."""
    two_blocks(tmp_path / "a.cgns")
    (tmp_path / "outside.raw").write_bytes(b"precious " * 1000)
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["values"] = np.arange(100.0)
    mesh = io.read(tmp_path / "a.cgns")
    with h5py.File(tmp_path / "a.cgns", "r+") as file:
        group = place_of(file, name)
        shape = group[" data"].shape
        del group[" data"]
        if how == "external storage":
            size = 8 * int(np.prod(shape))
            group.create_dataset(
                " data", shape, "<f8", external=[(str(tmp_path / "outside.raw"), 0, size)]
            )
        elif how == "virtual":
            layout = h5py.VirtualLayout(shape, "<f8")
            layout[...] = h5py.VirtualSource(str(tmp_path / "other.h5"), "values", (100,))[
                : int(np.prod(shape))
            ]
            group.create_virtual_dataset(" data", layout)
        else:
            group[" data"] = h5py.ExternalLink("other.h5", "/values")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(ValueError, match=rf"{name}/ data (keeps its values in|is a link to)"):
        io.read(tmp_path / "a.cgns")
    with pytest.raises(ValueError, match=r"keeps its values in|is a link to|has changed"):
        io.write(tmp_path / "b.cgns", mesh.moved(mesh.points * 2))
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_groups_that_hold_each_other_end(tmp_path):
    two_blocks(tmp_path / "a.cgns")
    with h5py.File(tmp_path / "a.cgns", "r+") as file:
        zone = place_of(file, "Density").parent.parent
        zone["round"] = zone
    assert len(io.read(tmp_path / "a.cgns").points)


@pytest.mark.parametrize("is_turned", runs([True], nightly=[False]))
def test_periodic_interfaces_are_pairs(is_turned, tmp_path):
    """Two zones one above the other, whose sides repeat each other, told by both sides or by one."""
    x, y, z = np.meshgrid(np.linspace(0, 0.5, 3), [1, 1.5, 2], [0, 1, 2], indexing="ij")
    if is_turned:
        x, y = y * np.cos(x), y * np.sin(x)
    angles, shift = ((0, 0, 0.5), (0, 0, 0)) if is_turned else ((0, 0, 0), (0.5, 0, 0))
    low, high = [[1, 1, 1], [1, 3, 3]], [[3, 1, 1], [3, 3, 3]]
    with h5py.File(tmp_path / "a.cgns", "w", track_order=True) as file:
        base = cgns.base(file, 3, 3)
        zones = {
            name: cgns.zone(base, name, (x, y, z + above))
            for name, above in (("one", 0), ("two", 2))
        }
        for name, zone in zones.items():
            cgns.periodic(zone, "low", name, low, high, shift, angles)
        cgns.periodic(zones["one"], "high", "one", high, low, -np.array(shift), -np.array(angles))
    mesh = io.read(tmp_path / "a.cgns")
    pairs = io.periodic(mesh)
    assert [(pair.patch, pair.partner) for pair in pairs] == [
        ("one/low", "high"),
        ("two/low", "two/low donor"),
    ]
    assert all(pair.is_rotation == is_turned for pair in pairs)
    sides = [mesh.patch("one/low", "two/low"), mesh.patch("high", "two/low donor")]
    assert [len(side) for side in sides] == [15, 15]
    assert set(mesh.patches) == {"one/low", "high", "two/low", "two/low donor", "unnamed"}
    ends = np.isin(mesh.points[:, 2], (0, 4))
    method = jm.RBF.classic(jm.ThinPlateSpline())
    radius = np.linalg.norm(mesh.points[:, :2], axis=1)
    inner = np.flatnonzero(np.isclose(radius if is_turned else mesh.points[:, 1], 1))
    moving = inner[~ends[inner]]
    plan = jm.prepare(mesh.points, moving, np.flatnonzero(ends), periodic=[
        jm.Periodic(mesh.patch(str(each.patch)), mesh.patch(str(each.partner)), about=each.about, axis=each.axis) for each in pairs
    ], method=method)  # fmt: skip
    pair = jm.Periodic(*sides, axis=pairs[0].axis)
    whole = jm.prepare(mesh.points, moving, np.flatnonzero(ends), periodic=pair, method=method)
    u = 0.05 * np.sin(mesh.points[moving])
    np.testing.assert_allclose(jm.deform(plan, u), jm.deform(whole, u), rtol=0, atol=1e-12)


def same(mesh, other):
    np.testing.assert_array_equal(mesh.points, other.points)
    assert mesh.cells.keys() == other.cells.keys()
    for name, nodes in other.patches.items():
        np.testing.assert_array_equal(mesh.patches[name], nodes)
    volumes = [np.sort(np.asarray(jm.quality(each).volume)) for each in (mesh, other)]
    np.testing.assert_allclose(*volumes, rtol=1e-12)


@pytest.mark.parametrize("form", runs(["parents of version 3"], nightly=["version 3", "parents"]))
def test_polyhedra_in_the_forms_of_other_writers(tmp_path, form):
    """Rows that begin with their count (before version 4 of CGNS), and faces that name their cells, without NFACE_n."""
    joined_polyhedra(tmp_path / "a.cgns")
    joined_polyhedra(tmp_path / "b.cgns")
    with h5py.File(tmp_path / "b.cgns", "r+") as file:
        zone = file["Base/p"]
        faces, cells = zone["faces"], zone["cells"]
        starts, members = (
            cells["ElementStartOffset/ data"][()],
            cells["ElementConnectivity/ data"][()],
        )
        if "parents" in form:
            parents = np.zeros((2, len(faces["ElementStartOffset/ data"]) - 1), np.int32)
            for cell, row in enumerate(np.split(members, starts[1:-1])):
                parents[(row < 0).astype(int), np.abs(row) - 1] = len(parents[0]) + 1 + cell
            cgns.node(faces, "ParentElements", "DataArray_t", parents)
            del zone["cells"]
        for section in (
            each for each in (faces, zone.get("cells")) if each is not None and "version 3" in form
        ):
            rows = np.split(
                section["ElementConnectivity/ data"][()], section["ElementStartOffset/ data"][1:-1]
            )
            del section["ElementStartOffset"], section["ElementConnectivity"]
            counted = np.concatenate([[len(row), *row] for row in rows]).astype(np.int32)
            cgns.node(section, "ElementConnectivity", "DataArray_t", counted)
    mesh = io.read(tmp_path / "b.cgns")
    same(mesh, io.read(tmp_path / "a.cgns"))
    same(
        rewritten(tmp_path / "c.cgns", mesh.moved(mesh.points * np.pi)),
        mesh.moved(mesh.points * np.pi),
    )


def test_a_region_of_cells_is_no_patch_and_families_above_are_groups(tmp_path):
    """gmsh has a condition for the volume too, and names a physical group as the family of families."""
    cgns.unstructured(tmp_path / "a.cgns")
    with h5py.File(tmp_path / "a.cgns", "r+") as file:
        cgns.condition(file["Base/all"], "fluid", [[1], [2]], "V_1", "CellCenter")
        cgns.node(cgns.node(file["Base"], "wall", "Family_t"), "solid", "FamilyName_t", "solid")
    mesh = io.read(tmp_path / "a.cgns")
    assert list(mesh.patches) == ["wall", "high", "some", "old", "unnamed"]
    np.testing.assert_array_equal(mesh.patch("solid"), mesh.patch("wall"))


def test_zones_join_under_a_condition(tmp_path):
    """Where the file says that zones meet, a condition that lies there, as gmsh writes it, does not part them."""
    cgns.two_blocks(tmp_path / "a.cgns")
    cgns.two_blocks(tmp_path / "b.cgns")
    with h5py.File(tmp_path / "b.cgns", "r+") as file:
        for zone, other, places in (
            ("one", "two", [[4, 1, 1], [4, 3, 3]]),
            ("two", "one", [[1, 1, 1], [1, 3, 3]]),
        ):
            cgns.condition(file[f"Base/{zone}"], "between", places)
            found = cgns.node(
                file[f"Base/{zone}"], "ZoneGridConnectivity", "ZoneGridConnectivity_t"
            )
            joint = cgns.node(found, "between", "GridConnectivity1to1_t", other)
            cgns.node(joint, "PointRange", "IndexRange_t", np.array(places, np.int32))
    same(io.read(tmp_path / "b.cgns"), io.read(tmp_path / "a.cgns"))


def test_sections_are_patches_where_there_are_no_conditions(tmp_path):
    """SU2 takes its markers so."""
    points = cgns.unstructured(tmp_path / "a.cgns")
    with h5py.File(tmp_path / "a.cgns", "r+") as file:
        del file["Base/all/ZoneBC"]
    mesh = io.read(tmp_path / "a.cgns")
    assert list(mesh.patches) == ["sides", "ends", "unnamed"]
    np.testing.assert_array_equal(mesh.patch("sides"), np.arange(8))
    np.testing.assert_array_equal(mesh.patch("ends"), [1, 2, 8])
    assert len(points) == 10


@pytest.mark.parametrize("is_list", [False, True])
def test_faces_of_a_block_one_cell_thick(tmp_path, is_list):
    """Faces in one row lie across the axis in which they are behind the last cell, or which has several cells."""
    x, y, z = np.meshgrid(np.linspace(0, 1, 4), np.linspace(0, 1, 5), [0, 1], indexing="ij")
    wanted = {
        "imin": ([[1, 1, 1], [1, 4, 1]], x == 0),
        "imax": ([[4, 1, 1], [4, 4, 1]], x == 1),
        "jmin": ([[1, 1, 1], [3, 1, 1]], y == 0),
        "kmax": ([[1, 1, 2], [3, 4, 2]], z == 1),
    }
    with h5py.File(tmp_path / "a.cgns", "w", track_order=True) as file:
        zone = cgns.zone(cgns.base(file, 3, 3), "one", (x, y, z))
        for name, (places, _) in wanted.items():
            low, high = np.array(places)
            each = np.stack(
                np.meshgrid(*map(np.arange, low, high + 1), indexing="ij"), axis=-1
            ).reshape(-1, 3)
            what = {"what": "PointList"} if is_list else {}
            cgns.condition(zone, name, each if is_list else places, None, "FaceCenter", **what)
    mesh = io.read(tmp_path / "a.cgns")
    for name, (_, nodes) in wanted.items():
        np.testing.assert_array_equal(mesh.patch(name), np.flatnonzero(nodes.ravel(order="F")))


def test_bases(tmp_path):
    """The base of the cells of the highest dimension is read; a range of 1e12 elements takes no memory."""
    cgns.unstructured(tmp_path / "a.cgns")
    with h5py.File(tmp_path / "a.cgns", "r+") as file:
        cgns.node(file, "Empty", "CGNSBase_t", np.array([3, 3], np.int32))
        wall = cgns.node(file, "Surface", "CGNSBase_t", np.array([2, 3], np.int32))
        cgns.elements(cgns.zone(wall, "wall", tuple(np.eye(3)), 1), "faces", 5, [1, 2, 3], 1, 1)
    assert len(io.read(tmp_path / "a.cgns").points) == 10
    with h5py.File(tmp_path / "a.cgns", "r+") as file:
        more = cgns.node(file, "More", "CGNSBase_t", np.array([3, 3], np.int32))
        file.copy("Base/all", more, "all")
    with pytest.raises(ValueError, match=r"2 bases of 3-D cells in this file \(Base, More\)"):
        io.read(tmp_path / "a.cgns")
    with h5py.File(tmp_path / "a.cgns", "r+") as file:
        del file["More"]
        values = file["Base/all/ZoneBC/high/PointRange"]
        del values[" data"]
        values[" data"] = np.array([[1], [10**12]])
    with pytest.raises(
        ValueError, match="condition high: 999999999995 of its 1000000000000 elements are not there"
    ):
        io.read(tmp_path / "a.cgns")


def test_names_that_are_not_utf_8(tmp_path):
    cgns.two_blocks(tmp_path / "a.cgns")
    with h5py.File(tmp_path / "a.cgns", "r+") as file:
        conditions = file["Base/one/ZoneBC"]
        conditions[b"sym\xe9trie"] = conditions["c"]
        del conditions["c"]
    mesh = io.read(tmp_path / "a.cgns")
    assert "sym\xe9trie" in mesh.patches
    same(
        rewritten(tmp_path / "b.cgns", mesh.moved(mesh.points * np.pi)),
        mesh.moved(mesh.points * np.pi),
    )


def drum_of_wedges() -> jm.Mesh:
    """Triangles and quads in one patch."""
    mesh = cases.bricks("wedge", cells=3)
    return jm.Mesh(mesh.points, mesh.cells, {"all": mesh.patch("floor", "lid", "sides")})


NEW = {
    "quad": lambda: cases.bodies({"wall": (-1.0, 1.0, -0.5, 0.5)}, box=(-3.0, 3.0, -3.0, 3.0)),
    "mixed": lambda: jm.Mesh(*foam_mixed(), {"floor": np.arange(4)}),
    "wedge": drum_of_wedges,
    "hexahedron27": lambda: jm.elevate(cases.bricks("hexahedron", cells=3), 2),
    "wedge40": lambda: jm.elevate(cases.bricks("wedge", cells=3), 3),
    "single": lambda: single(cases.bricks("tetra", cells=3)),
}


def single(mesh: jm.Mesh) -> jm.Mesh:
    return jm.Mesh(np.asarray(mesh.points, np.float32), mesh.cells, mesh.patches)


def foam_mixed():
    points, _ = foam.mixed()
    cells = {
        "hexahedron": [[0, 1, 2, 3, 4, 5, 6, 7]],
        "pyramid": [[4, 5, 6, 7, 10]],
        "tetra": [[6, 11, 7, 10]],
        "wedge": [[1, 8, 2, 5, 9, 6]],
    }
    return points, {kind: np.array(ids) for kind, ids in cells.items()}


@pytest.mark.parametrize("name", NEW)
def test_new_files(tmp_path, name):
    """A mesh from elsewhere comes back as it was, and the library of CGNS finds no fault."""
    mesh = NEW[name]()
    io.write(tmp_path / "a.cgns", mesh)
    same(io.read(tmp_path / "a.cgns"), mesh.moved(np.asarray(mesh.points, float)))
    assert io.read(tmp_path / "a.cgns").kinds == {}
    if shutil.which("cgnscheck"):
        command = ["cgnscheck", "-w0", str(tmp_path / "a.cgns")]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        assert "ERROR" not in done.stdout + done.stderr


def test_names_that_conditions_cannot_have(tmp_path):
    mesh = cases.bricks("tetra", cells=3)
    for name in ("a/b", " ", 33 * "a"):
        patches = {name: mesh.patches["floor"]}
        with pytest.raises(ValueError, match="cannot be the name of a boundary condition"):
            io.check_output(tmp_path / "a.cgns", jm.Mesh(mesh.points, mesh.cells, patches))
    with pytest.raises(ValueError, match="without cells"):
        io.check_output(tmp_path / "a.cgns", jm.Mesh(mesh.points))
