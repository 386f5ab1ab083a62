"""Two things of one name in a file: both are kept under names of their own, or the file means them to be one, and says so.

What of a file is no part of the mesh is told too: in `notes` of the mesh's source, which `jaxmorph info` prints.
"""

import json
import shutil

import cgns
import exodus
import foam
import h5py
import meshio
import mfem_meshes
import numpy as np
import plot3d
import pytest
from formats import rewritten
from meshes import bricks
from runs import printed

import jaxmorph as jm
from jaxmorph import io

CUBE = bricks(2)
POINTS, CELLS = np.asarray(CUBE.points), np.asarray(CUBE.cells["hexahedron"])
FACES = np.asarray(jm.boundary_faces(CUBE)["quad"])
LOW = [np.flatnonzero(POINTS[:, axis] == 0) for axis in range(3)]
EDGE = np.intersect1d(LOW[0], LOW[1])


def low(axis):
    """The boundary faces in the plane where a coordinate is 0."""
    return FACES[np.isin(FACES, LOW[axis]).all(axis=1)]


def of_exodus(path):
    """A block of shells, a set of sides and two sets of nodes, of which one has the nodes of the shells."""
    path = path.with_suffix(".e")
    sides = [
        (
            "wall",
            [cell for cell in range(8) if set(CELLS[cell][[0, 1, 5, 4]]) <= set(LOW[1])],
            [0] * 4,
        )
    ]
    nodes = [("wall", LOW[0]), ("wall", LOW[2])]
    exodus.write(
        path, POINTS, [("solid", "hexahedron", CELLS), ("wall", "quad", low(2))], sides, nodes
    )
    wanted = {"wall": LOW[2], "wall_sides_10": LOW[1], "wall_nodes_10": LOW[0]}
    return (
        path,
        wanted,
        ["wall_sides_10", "wall_nodes_10", "nodes_20 has the name and the nodes", "solid"],
    )


def of_med(path):
    path = path.with_suffix(".med")
    corners = CELLS[:, [0, 3, 2, 1, 4, 7, 6, 5]]  # MED's order
    blocks = [("hexahedron", corners), ("quad", low(2))]
    tags = [np.full(len(corners), -2), np.full(4, -1)]
    nodes = np.isin(np.arange(len(POINTS)), LOW[0]).astype(int)
    mesh = meshio.Mesh(
        POINTS, blocks, point_data={"point_tags": nodes}, cell_data={"cell_tags": tags}
    )
    mesh.point_tags, mesh.cell_tags = {1: ["wall"]}, {-1: ["wall"], -2: ["wall", "fluid"]}
    meshio.med.write(path, mesh)
    return path, {"wall": LOW[2], "wall_nodes": LOW[0]}, ["wall_nodes", "wall, fluid"]


def of_gmsh(path, version="2.2", names=None):
    """Groups of one name in all dimensions, two without a name, and a section that is not read."""
    path = path.with_suffix(".msh")
    names = names or ['3 1 "wall"', '2 2 "wall"', '1 2 "wall"']
    lines = np.array([EDGE[:-1], EDGE[1:]]).T
    rows = [
        *((5, 1, row) for row in CELLS),
        *((3, 2, row) for row in low(2)),
        *((1, 2, row) for row in lines),
    ]
    rows += [*((3, 7, row) for row in low(0)), (1, 7, lines[0])]
    numbered = enumerate(rows, start=1)
    elements = [
        f"{k} {kind} 2 {tag} {tag} {' '.join(map(str, row + 1))}"
        for k, (kind, tag, row) in numbered
    ]
    text = [
        f"$MeshFormat\n{version} 0 8\n$EndMeshFormat\n$PhysicalNames\n{len(names)}",
        *names,
        "$EndPhysicalNames",
    ]
    text += [
        f"$Nodes\n{len(POINTS)}",
        *(f"{k} {x} {y} {z}" for k, (x, y, z) in enumerate(POINTS.tolist(), start=1)),
    ]
    text += [
        f"$EndNodes\n$Elements\n{len(rows)}",
        *elements,
        "$EndElements\n$Periodic\n0\n$EndPeriodic\n",
    ]
    path.write_text("\n".join(text))
    wanted = {
        "wall": LOW[2],
        "wall_curve_2": EDGE,
        "physical_7": LOW[0],
        "physical_7_curve_7": EDGE[:2],
    }
    return path, wanted, ["wall_curve_2", "physical_7_curve_7", "as one mesh: wall", "$Periodic"]


def of_cgns(path, families=(None, None), types=("BCWall", "BCWall"), name="wall"):
    """Conditions of one name in two zones at z = 0; each may have a family."""
    path = path.with_suffix(".cgns")
    one = np.stack(np.meshgrid(*[np.linspace(0, 1, 3)] * 3, indexing="ij"))
    with h5py.File(path, "w", track_order=True) as file:
        root = cgns.base(file, 3, 3)
        for k in range(2):
            group = cgns.zone(root, f"zone{k + 1}", one + np.array([k, 0, 0])[:, None, None, None])
            cgns.condition(group, name, [[1, 1, 1], [3, 3, 1]], families[k])
            data = group[f"ZoneBC/{name}"]
            del data[" data"]
            data.create_dataset(" data", data=np.frombuffer(types[k].encode(), np.int8))
    return path


def of_su2(path):
    """SU2 finds a marker's settings by its tag: markers of one tag are one boundary."""
    path = path.with_suffix(".su2")
    io.write(path, jm.Mesh(POINTS, CUBE.cells, {"wall": LOW[0], "other": LOW[2]}))
    path.write_text(path.read_text().replace("MARKER_TAG= other", "MARKER_TAG= wall"))
    return path, {"wall": np.union1d(LOW[0], LOW[2])}, ["the 2 markers wall are one patch"]


def of_mfem(path):
    path = path.with_suffix(".mesh")
    path.write_text(mfem_meshes.straight(CUBE, "floor").replace('"floor" 1 4', '"boundary_2" 1 4'))
    return path, {"boundary_4": LOW[2]}, ["the group boundary_2 (boundary_4)", "fluid"]


def of_openfoam(path):
    """A group of the name of another patch, faces of a zone, and a second region."""
    foam.write_case(path, *foam.mixed(), foam.PATCHES)
    shutil.copytree(path / "constant" / "polyMesh", path / "constant" / "solid" / "polyMesh")
    boundary = path / "constant" / "polyMesh" / "boundary"
    boundary.write_text(boundary.read_text().replace("nFaces", "inGroups 1(rest); nFaces", 1))
    head = "FoamFile { version 2.0; format ascii; class regIOobject; object faceZones; }\n// 7\n"
    (boundary.parent / "faceZones").write_text(
        head + "\n2\n(\nwall { type faceZone; }\nfan { type faceZone; }\n)\n"
    )
    (boundary.parent / "cellZones").write_text(head + "\n0()\n")
    notes = ["2 faceZones are not read", "the regions solid", "the group rest"]
    return path, {"floor": range(4), "rest": range(12)}, notes


def of_plot3d(path):
    path = path.with_suffix(".xyz")
    plot3d.write(path, plot3d.box(3, 3, 3), "text", blank=True)
    path.write_text(path.read_text().replace("1 1 1 1", "1 0 0 1", 1))
    return path, {}, ["2 nodes are blank"]


TWO_TYPES, WITH_FAMILY = {"types": ("BCWall", "BCInflow")}, {"families": (None, "wall")}
KINDS = [
    lambda path: (of_cgns(path), {"wall": (0, 2)}, ["the boundary conditions wall of 2 zones"]),
    lambda path: (
        of_cgns(path, **TWO_TYPES),
        {"wall": (0, 1), "wall_zone2": (1, 2)},
        ["wall_zone2"],
    ),
    lambda path: (
        of_cgns(path, **WITH_FAMILY),
        {"wall_zone1": (0, 1), "wall": (1, 2)},
        ["called as another patch"],
    ),
]
KINDS += [of_exodus, of_med, of_gmsh, of_su2, of_mfem, of_openfoam, of_plot3d]


@pytest.mark.parametrize("make", KINDS)
def test_nothing_of_one_name_is_merged_or_lost_silently(tmp_path, capsys, make):
    path, wanted, told = make(tmp_path / "in")
    mesh = io.read(path)
    for name, nodes in wanted.items():
        found = mesh.patches[name]
        if isinstance(nodes, tuple):  # from and to which x, at z = 0
            x, _, z = mesh.points.T
            nodes = np.flatnonzero((z == 0) & (x >= nodes[0]) & (x <= nodes[1]))
        np.testing.assert_array_equal(found, nodes, err_msg=name)
    for part in told:
        assert any(part in note for note in mesh.source.notes), (part, mesh.source.notes)
    said = " ".join(printed(capsys, ["info", str(path)]).split())
    assert all(note in said for note in mesh.source.notes)
    assert json.loads(printed(capsys, ["info", str(path), "--json"]))["notes"] == list(
        mesh.source.notes
    )
    out = tmp_path / f"out{path.suffix}"
    io.write(out, mesh)
    assert (
        foam.tree(out) == foam.tree(path)
        if path.is_dir()
        else out.read_bytes() == path.read_bytes()
    )
    again = io.read(out)
    assert mesh.patches.keys() == again.patches.keys()
    assert len(again.source.notes) == len(mesh.source.notes)


def test_equal_names_that_no_solver_tells_apart_are_refused(tmp_path):
    path = of_mfem(tmp_path / "in")[0]
    path.write_text(path.read_text().replace('1\n"boundary_2" 1 4', '2\n"a" 1 4\n"a" 1 2'))
    with pytest.raises(
        ValueError, match=r"in\.mesh: two sets of boundary attributes are called 'a'"
    ):
        io.read(path)
    path = of_openfoam(tmp_path / "case")[0]
    boundary = path / "constant" / "polyMesh" / "boundary"
    boundary.write_text(boundary.read_text().replace("floor", "rest"))
    with pytest.raises(ValueError, match="boundary: 2 patches are called rest"):
        io.read(path)


@pytest.mark.parametrize("named", [True, False])
def test_names_of_gmsh_2_0_have_no_dimension(tmp_path, named):
    """gmsh 2.0 wrote a tag and a name: gmsh reads it so where the version is 2.0, and only there."""
    names = ['1 "fluid"', '2 "floor"'] if named else ['3 1 "fluid"', '2 2 "floor"']
    path = of_gmsh(tmp_path / "in", "2", names)[0]
    mesh = io.read(path)
    np.testing.assert_array_equal(mesh.patch("floor"), LOW[2])
    wanted = {"floor_curve_2": EDGE} if named else {"physical_2": EDGE}
    for name, nodes in wanted.items():
        np.testing.assert_array_equal(mesh.patch(name), nodes)
    io.write(tmp_path / "same.msh", mesh)
    assert (tmp_path / "same.msh").read_bytes() == path.read_bytes()
    again = rewritten(tmp_path / "moved.msh", mesh.moved(POINTS + 1))
    np.testing.assert_array_equal(again.points, POINTS + 1)
    assert again.patches.keys() == mesh.patches.keys()
    if named:
        with pytest.raises(
            ValueError, match=r"in\.msh, line 6: a dimension, a tag and a name expected"
        ):
            io.read(of_gmsh(tmp_path / "in", "2.2", names)[0])


@pytest.mark.parametrize("kind", [5, 7, 20])
def test_a_surface_in_a_base_of_volumes_is_read(tmp_path, kind):
    """Surface meshers leave the cell dimension at 3 where no cell has it."""
    quads = FACES[np.argsort(FACES[:, 0])]
    rows = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]) if kind == 5 else quads
    values = np.column_stack([np.full(len(rows), 7), rows + 1]) if kind == 20 else rows + 1
    with h5py.File(tmp_path / "a.cgns", "w", track_order=True) as file:
        zone = cgns.zone(cgns.base(file, 3, 3), "skin", tuple(POINTS.T), len(values))
        cgns.elements(zone, "faces", kind, values, 1, len(values))
        cgns.condition(zone, "top", [[1], [4]], None, "FaceCenter")
    mesh = io.read(tmp_path / "a.cgns")
    assert mesh.cell_counts == ({"triangle": 48} if kind == 5 else {"quad": 24})
    assert mesh.points.shape == (27, 3)
    assert any("as one mesh: top" in note for note in mesh.source.notes)
    area = np.asarray(jm.quality(mesh).volume).sum()
    np.testing.assert_allclose(area, 6, rtol=1e-6)
    np.testing.assert_array_equal(
        rewritten(tmp_path / "b.cgns", mesh.moved(POINTS * np.pi)).points, POINTS * np.pi
    )
    with h5py.File(tmp_path / "a.cgns", "r+") as file:
        file["Base/skin/faces/ElementRange/ data"][1] = len(values) + 1
    with pytest.raises(ValueError, match=r"section faces has .* elements, and the range of"):
        io.read(tmp_path / "a.cgns")


def of_meshio(numbers, **more):
    """The cube with the faces of two planes, and an array of their numbers."""
    blocks = [("hexahedron", CELLS), ("quad", low(2)), ("quad", low(0))]
    arrays = {name: [np.zeros(8, int), np.full(4, 3), np.full(4, 5)] for name in numbers}
    return meshio.Mesh(POINTS, blocks, cell_data=arrays, **more)


def test_numbers_of_faces_are_patches_or_are_told(tmp_path, capsys):
    for name in ("ModelFaceID", "facet_tags", "name_to_read", "CellEntityIds"):
        mesh = jm.Mesh.from_meshio(of_meshio([name, "other"]))
        found = {patch: nodes.tolist() for patch, nodes in mesh.patches.items()}
        assert found == {f"{name}_3": LOW[2].tolist(), f"{name}_5": LOW[0].tolist()}
        assert [note for note in mesh.source.notes if name in note] == []
        assert any("the array other numbers faces (3, 5)" in note for note in mesh.source.notes)
    flags = np.isin(np.arange(len(POINTS)), EDGE).astype(int)
    ids = {"GlobalNodeID": np.arange(27), "tags": flags, "pressure": np.zeros(27)}
    meshio.vtu.write(tmp_path / "a.vtu", of_meshio(["surface_id"], point_data=ids))
    mesh = io.read(tmp_path / "a.vtu")
    assert list(mesh.patches) == ["boundary"]
    said = " ".join(printed(capsys, ["info", str(tmp_path / "a.vtu")]).split())
    told = "the array surface_id numbers faces (3, 5): these are no patches. They are where it is called patch"
    assert told in said
    assert "the array tags numbers nodes (0, 1)" in said
    assert "GlobalNodeID" not in said
    assert "pressure" not in said


def test_sets_of_meshio_are_patches():
    """Point sets and cell sets; of one name both are kept; sets of cells are told."""
    empty = np.zeros(0, int)
    sets = {"wall": [empty, np.arange(4), empty], "fluid": [np.arange(8), empty, empty]}
    mesh = jm.Mesh.from_meshio(
        of_meshio([], cell_sets=sets, point_sets={"wall": EDGE, "corner": [0]})
    )
    for name, nodes in {"wall": LOW[2], "wall_points": EDGE, "corner": [0]}.items():
        np.testing.assert_array_equal(mesh.patch(name), nodes)
    assert list(mesh.patches) == ["wall", "wall_points", "corner"]
    assert any("as one mesh: fluid" in note for note in mesh.source.notes)
    again = jm.Mesh.from_meshio(mesh.to_meshio())
    assert again.patches.keys() == mesh.patches.keys()


def test_a_condition_called_unnamed_stays_by_itself(tmp_path):
    mesh = io.read(of_cgns(tmp_path / "a", name="unnamed"))
    assert list(mesh.patches) == ["unnamed", "unnamed_faces"]
    assert (mesh.points[mesh.patch("unnamed"), 2] == 0).all()


def test_what_a_cgns_file_has_beside_its_mesh_is_told(tmp_path):
    """Another base, a section of no condition, later coordinates, an interface without equal nodes; faces without a name."""
    cgns.unstructured(tmp_path / "a.cgns")
    with h5py.File(tmp_path / "a.cgns", "r+", track_order=True) as file:
        skin = cgns.node(file, "Surface", "CGNSBase_t", np.array([2, 3], np.int32))
        cgns.elements(cgns.zone(skin, "wall", tuple(np.eye(3)), 1), "faces", 5, [1, 2, 3], 1, 1)
        zone = file["Base/all"]
        cgns.elements(zone, "fan", 7, [2, 9, 10, 6], 6, 1)
        file.copy(zone["GridCoordinates"], zone, "GridCoordinates2")
        zone["GridCoordinates2"].attrs["name"] = np.bytes_("GridCoordinates2")
        found = cgns.node(zone, "ZoneGridConnectivity", "ZoneGridConnectivity_t")
        cgns.node(found, "slip", "GridConnectivity_t", "all")
    notes = " ".join(io.read(tmp_path / "a.cgns").source.notes)
    for part in (
        "the base Surface of 2-D cells",
        "the sections fan",
        "of the zones all the first",
        "all/slip",
    ):
        assert part in notes, notes


def test_faces_without_names_are_told():
    mesh = jm.Mesh.from_meshio(of_meshio([]))
    assert list(mesh.patches) == ["boundary"]
    assert mesh.source.notes == (
        "8 faces, edges or points of the file have no names, and are no patches.",
    )


@pytest.mark.parametrize(("form", "width"), [("records", 8), ("plain", 4)])
def test_blank_nodes_of_binary_grids_are_told(tmp_path, form, width):
    plot3d.write(tmp_path / "a.xyz", plot3d.box(3, 3, 3), form, ">", width, blank=True)
    assert io.read(tmp_path / "a.xyz").source.notes == ()
    data = (tmp_path / "a.xyz").read_bytes()
    at = data.rindex(b"\0\0\0\1" * 27)
    (tmp_path / "a.xyz").write_bytes(data[:at] + b"\0" * 12 + data[at + 12 :])
    assert io.read(tmp_path / "a.xyz").source.notes == (
        "3 nodes are blank (IBLANK 0), and are read as all others.",
    )
