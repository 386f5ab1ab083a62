"""gmsh's files as gmsh writes them: what its own Python module reads of each is read here, and all but coordinates stays."""

import contextlib
import itertools
import re

import numpy as np
import pytest
from formats import assert_same
from meshes import gmsh_session
from runs import runs

import jaxmorph as jm
from jaxmorph import io
from jaxmorph.cli import main

gmsh = pytest.importorskip("gmsh")
FORMS = [(1.0, 0), (2.2, 0), (2.2, 1), (4.0, 0), (4.1, 0), (4.1, 1)]
VARIANTS = (
    "plain",
    "all",
    "two groups",
    "parametric",
    "partitioned",
    "ghosts",
    "periodic",
    "nameless",
    "corners",
)
READ = [
    *((3, form, "plain") for form in FORMS),
    *((3, (4.1, 1), variant) for variant in VARIANTS[1:]),
]


@pytest.fixture(scope="module", autouse=True)
def session():
    with gmsh_session():
        yield


def write(path, dimension: int, version: float, binary: int, variant: str) -> None:
    """Meshes a square or cube of several groups, and lets gmsh write it."""
    gmsh.clear()
    make = gmsh.model.occ.addRectangle if dimension == 2 else gmsh.model.occ.addBox
    box = make(0, 0, 0.5, *(1,) * dimension)
    gmsh.model.occ.synchronize()
    sides = [tag for _, tag in gmsh.model.getBoundary([(dimension, box)], oriented=False)]
    gmsh.model.addPhysicalGroup(dimension, [box], name="" if variant == "nameless" else "the fluid")
    gmsh.model.addPhysicalGroup(
        dimension - 1, sides[:2], name="" if variant == "nameless" else "two sides"
    )
    if variant == "two groups":
        gmsh.model.addPhysicalGroup(dimension - 1, sides[:1], name="a side")
        gmsh.model.addPhysicalGroup(dimension, [box], name="all")
    if variant == "corners":
        gmsh.model.addPhysicalGroup(0, [1, 2], name="corners")
    if variant == "periodic":
        x = [1 if k in (0, 5, 10, 15) else 0 for k in range(16)]
        x[3] = 1  # moved by 1 along x
        at = {
            round(gmsh.model.occ.getCenterOfMass(dimension - 1, side)[0], 6): side for side in sides
        }
        gmsh.model.mesh.setPeriodic(dimension - 1, [at[1.0]], [at[0.0]], x)
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.6)
    gmsh.model.mesh.generate(dimension)
    gmsh.option.setNumber("Mesh.PartitionCreateGhostCells", variant == "ghosts")
    if variant in ("partitioned", "ghosts"):
        gmsh.model.mesh.partition(3)
    options = {"MshFileVersion": version, "Binary": binary, "SaveAll": variant == "all"}
    # gmsh itself cannot open a file of version 1 with parameters
    for name, value in (
        options | {"SaveParametric": variant == "parametric" and version > 1}
    ).items():
        gmsh.option.setNumber(f"Mesh.{name}", value)
    gmsh.write(str(path))


def rows(values) -> np.ndarray:
    """Distinct rows of numbers in ascending order."""
    return np.unique(np.asarray(values).reshape(len(values), -1), axis=0)


def oracle(path, dimension: int):
    """What gmsh reads: places of nodes, of the corners of each cell, and of the nodes of each group by dimension and name."""
    gmsh.clear()
    gmsh.open(str(path))
    tags, places, _ = gmsh.model.mesh.getNodes()
    places = places.reshape(-1, 3)[:, :dimension]
    at = dict(zip(tags.tolist(), places, strict=True))
    kinds, _, nodes = gmsh.model.mesh.getElements(dimension)
    (cells,) = (ids for kind, ids in zip(kinds, nodes, strict=True) if kind in (2, 4))
    corners = np.array([at[tag] for tag in cells.tolist()]).reshape(-1, dimension + 1, dimension)
    groups = {}
    for level, tag in gmsh.model.getPhysicalGroups():
        found = gmsh.model.mesh.getNodesForPhysicalGroup(level, tag)[1].reshape(-1, 3)[
            :, :dimension
        ]
        if level < dimension and len(found):
            groups[gmsh.model.getPhysicalName(level, tag) or f"physical_{tag}"] = rows(found)
    return places, corners, groups


def assert_as_gmsh_reads(path, mesh, dimension: int) -> None:
    places, corners, groups = oracle(path, dimension)
    assert mesh.points.shape == places.shape
    np.testing.assert_array_equal(rows(mesh.points), rows(places))
    (cells,) = mesh.cells.values()
    np.testing.assert_array_equal(rows(np.asarray(mesh.points)[cells]), rows(corners))
    assert set(mesh.patches) == (set(groups) or {"boundary"})
    for name, expected in groups.items():
        np.testing.assert_array_equal(rows(np.asarray(mesh.points)[mesh.patch(name)]), expected)


def outside_of_nodes(data: bytes) -> tuple[bytes, bytes]:
    before, _, rest = re.split(rb"(\$(?:(?:Parametric)?Nodes|NOD))\n", data, maxsplit=1)
    return before, rest[re.search(rb"\$E(?:nd|ND)", rest).start() :]


REST = [case for case in itertools.product((3, 2), FORMS, VARIANTS) if case not in READ]


@pytest.mark.parametrize(("dimension", "form", "variant"), runs(READ, nightly=REST))
def test_what_gmsh_writes_is_read_as_gmsh_reads_it(tmp_path, dimension, form, variant):
    path = tmp_path / "a.msh"
    write(path, dimension, *form, variant)
    mesh = io.read(path)
    assert_as_gmsh_reads(path, mesh, dimension)
    io.write(tmp_path / "same.msh", mesh)
    assert (tmp_path / "same.msh").read_bytes() == path.read_bytes()
    # gmsh places nodes of a periodic side by those of the other one: these must go the same way
    moved = mesh.moved(
        np.asarray(mesh.points) * np.pi if variant != "periodic" else np.asarray(mesh.points) + 8
    )
    io.write(tmp_path / "b.msh", moved)
    assert_as_gmsh_reads(tmp_path / "b.msh", moved, dimension)
    assert outside_of_nodes((tmp_path / "b.msh").read_bytes()) == outside_of_nodes(
        path.read_bytes()
    )
    np.testing.assert_array_equal(io.read(tmp_path / "b.msh").points, moved.points)


@pytest.mark.nightly
def test_bytes_that_are_put_in_make_no_other_mesh(tmp_path):
    """Four bytes twice, anywhere among the elements of a binary file of version 2.2."""
    path = tmp_path / "a.msh"
    write(path, 3, 2.2, 1, "two groups")
    data, mesh = path.read_bytes(), io.read(path)
    start = data.index(b"\n", data.index(b"$Elements\n") + 10) + 1
    # the step has no factor in common with a record's ten numbers: all places in records come
    for at in range(start, data.index(b"$EndElements"), 4 * 301):
        path.write_bytes(data[:at] + data[at : at + 4] + data[at:])
        with contextlib.suppress(ValueError):
            assert_same(io.read(path), mesh)


def two_tetrahedra(path, order, in_one):
    """A binary file of version 2.2: two triangles and two tetrahedra, each behind a head of its own, or by type."""
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1.0]])
    nodes = np.zeros(5, np.dtype([("id", f"{order}i4"), ("x", f"{order}f8", 3)]))
    nodes["id"] = 1 + np.arange(5)
    nodes["x"] = points
    rows = {
        2: [[1, 1, 1, 1, 2, 3], [2, 1, 1, 1, 2, 4]],
        4: [[3, 2, 2, 1, 2, 3, 4], [4, 2, 2, 5, 3, 2, 4]],
    }
    words = []
    for kind, of_kind in rows.items():
        for some in [of_kind] if in_one else [[row] for row in of_kind]:
            words += [kind, len(some), 2, *(word for row in some for word in row)]
    one = np.array([1], f"{order}i4").tobytes()
    parts = [b"$MeshFormat\n2.2 1 8\n", one, b"\n$EndMeshFormat\n$Nodes\n5\n", nodes.tobytes()]
    parts += [b"\n$EndNodes\n$Elements\n4\n", np.array(words, f"{order}i4").tobytes()]
    path.write_bytes(b"".join([*parts, b"\n$EndElements\n"]))


@pytest.mark.parametrize("in_one", [False, True])
@pytest.mark.parametrize("order", ["<", ">"])
def test_bytes_at_every_place_make_no_other_mesh(tmp_path, order, in_one):
    """One to eight bytes twice, or left out, at each place among the elements of a small file."""
    path = tmp_path / "a.msh"
    two_tetrahedra(path, order, in_one)
    data, mesh = path.read_bytes(), io.read(path)
    assert len(mesh.cells["tetra"]) == 2
    assert [len(nodes) for nodes in mesh.patches.values()] == [4]
    start = data.index(b"\n", data.index(b"$Elements\n") + 10) + 1
    for at in range(start, data.index(b"$EndElements")):
        for size in (1, 4, 8):
            for changed in (
                data[:at] + data[at : at + size] + data[at:],
                data[:at] + data[at + size :],
            ):
                path.write_bytes(changed)
                with contextlib.suppress(ValueError):
                    assert_same(io.read(path), mesh)


@pytest.mark.parametrize("is_one_group", [False, True])
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize(("version", "binary"), [form for form in FORMS if form[0] > 1])
def test_periodic_sides_are_pairs_of_patches(
    tmp_path, capsys, version, binary, dimension, is_one_group
):
    """Of a surface each, or of two in one group; the pair leads from the origin to its image."""
    path = tmp_path / "a.msh"
    make_periodic(path, dimension, is_one_group, version, binary)
    mesh = io.read(path)
    (pair,) = io.periodic(mesh)
    assert (pair.patch, pair.partner) == ("low", "high")
    x = np.asarray(mesh.points)[:, 0]
    assert (x[mesh.patch("low")] == 0).all()
    assert (x[mesh.patch("high")] == 1).all()
    if (version, binary, dimension) != (4.1, 0, 2):
        return
    jm.prepare(mesh, "wall", periodic=pair, method=jm.RBF.classic(jm.ThinPlateSpline()))
    assert main(["info", str(path)]) == 0
    assert "--periodic low high" in capsys.readouterr().out


def make_periodic(path, dimension, is_one_group, version, binary):
    """A box, or two side by side, whose side at x = 1 is the image of the one at 0."""
    gmsh.clear()
    occ = gmsh.model.occ
    make = occ.addRectangle if dimension == 2 else occ.addBox
    boxes = [make(0, y, 0, *(1,) * dimension) for y in range(1 + is_one_group)]
    occ.fragment([(dimension, boxes[0])], [(dimension, box) for box in boxes[1:]])
    occ.synchronize()
    level = dimension - 1
    outer = gmsh.model.getBoundary(gmsh.model.getEntities(dimension), oriented=False)
    middle = {side: occ.getCenterOfMass(*side) for side in outer}
    sides = {}
    for name, place in (("low", 0), ("high", 1)):
        found = [side for side in outer if abs(middle[side][0] - place) < 1e-6]
        sides[name] = [tag for _, tag in sorted(found, key=lambda side: middle[side][1])]
    shift = [1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
    gmsh.model.mesh.setPeriodic(level, sides["high"], sides["low"], shift)
    sides["wall"] = [tag for _, tag in outer if tag not in sides["low"] + sides["high"]]
    for name, tags in sides.items():
        gmsh.model.addPhysicalGroup(level, tags, name=name)
    gmsh.model.addPhysicalGroup(dimension, [tag for _, tag in gmsh.model.getEntities(dimension)])
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.6)
    gmsh.model.mesh.generate(dimension)
    for name, value in (("MshFileVersion", version), ("Binary", binary)):
        gmsh.option.setNumber(f"Mesh.{name}", value)
    gmsh.write(str(path))


@pytest.mark.parametrize(("version", "binary"), [form for form in FORMS if form[0] > 4])
def test_a_file_without_entities_is_read(tmp_path, version, binary):
    """Its elements are in no group."""
    write(tmp_path / "whole.msh", 3, version, binary, "all")
    data = (tmp_path / "whole.msh").read_bytes()
    start, stop = data.index(b"$Entities"), data.index(b"$EndEntities\n") + len(b"$EndEntities\n")
    (tmp_path / "a.msh").write_bytes(data[:start] + data[stop:])
    mesh = io.read(tmp_path / "a.msh")
    assert list(mesh.patches) == ["boundary"]
    assert_as_gmsh_reads(tmp_path / "a.msh", mesh, 3)


def test_a_second_mesh_in_the_file_is_told(tmp_path):
    """gmsh writes the mesh again with each view that it adds to a file; half of such a file would move."""
    write(tmp_path / "a.msh", 2, 4.1, 0, "plain")
    data = (tmp_path / "a.msh").read_bytes()
    (tmp_path / "a.msh").write_bytes(data + data[data.index(b"$Nodes") :])
    with pytest.raises(
        ValueError, match=r"in \$Nodes \(a second one; gmsh adds a view without the mesh"
    ):
        io.read(tmp_path / "a.msh")


def test_parameters_of_nodes_stay(tmp_path):
    """Between the coordinates in the text of a file, parameters of the nodes keep their digits."""
    for version in (2.2, 4.0, 4.1):
        path = tmp_path / f"{version}.msh"
        write(path, 2, version, 0, "parametric")
        mesh = io.read(path)
        io.write(tmp_path / "b.msh", mesh.moved(np.asarray(mesh.points) + 10.0))
        column = {2.2: slice(4, None), 4.0: slice(4, None), 4.1: slice(3, None)}[version]
        kept = [
            [line.split()[column] for line in file.read_text().splitlines()]
            for file in (path, tmp_path / "b.msh")
        ]
        assert kept[0] == kept[1]


def test_a_file_of_the_other_byte_order_is_read_as_gmsh_reads_it(tmp_path):
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1.5, 0]])
    nodes = b"".join(
        np.array([k + 5], ">i4").tobytes() + x.astype(">f8").tobytes() for k, x in enumerate(points)
    )
    cells = np.array([2, 2, 2, 1, 7, 1, 5, 6, 7, 2, 7, 1, 6, 8, 7], ">i4").tobytes()
    data = (
        b"$MeshFormat\n2.2 1 8\n"
        + np.array([1], ">i4").tobytes()
        + b"\n$EndMeshFormat\n$Nodes\n4\n"
        + nodes
    )
    (tmp_path / "a.msh").write_bytes(
        data + b"\n$EndNodes\n$Elements\n2\n" + cells + b"\n$EndElements\n"
    )
    mesh = io.read(tmp_path / "a.msh")
    assert_as_gmsh_reads(tmp_path / "a.msh", mesh, 2)
    io.write(tmp_path / "b.msh", mesh.moved(np.asarray(mesh.points) * np.pi))
    np.testing.assert_array_equal(
        io.read(tmp_path / "b.msh").points, np.asarray(mesh.points) * np.pi
    )


@pytest.mark.parametrize(("version", "binary"), FORMS)
def test_tags_far_apart_take_no_memory(tmp_path, version, binary):
    """gmsh's tags need not follow each other: a table as long as the largest would take gigabytes."""
    gmsh.clear()
    gmsh.model.addDiscreteEntity(2, 1)
    gmsh.model.mesh.addNodes(2, 1, [7, 10**9, 3], [0, 0, 0, 1, 0, 0, 0, 1, 0])
    gmsh.model.mesh.addElementsByType(1, 2, [10**9], [3, 7, 10**9])
    for name, value in (
        ("MshFileVersion", version),
        ("Binary", binary),
        ("SaveAll", 1),
        ("SaveParametric", 0),
    ):
        gmsh.option.setNumber(f"Mesh.{name}", value)
    gmsh.write(str(tmp_path / "a.msh"))
    assert_as_gmsh_reads(tmp_path / "a.msh", io.read(tmp_path / "a.msh"), 2)
