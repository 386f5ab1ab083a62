"""Meshes of high order: read as gmsh reads them, moved at all of their nodes, judged as curved cells, and written back."""

import numpy as np
import pytest
from meshes import gmsh_session
from runs import over

import jaxmorph as jm
from jaxmorph import io
from jaxmorph._host.cells.lagrange import lagrange_types, shape_values

gmsh = pytest.importorskip("gmsh")


@pytest.fixture(scope="module", autouse=True)
def session():
    with gmsh_session():
        yield


def disc(order: int, kind: str, *, is_complete: bool = True) -> None:
    """Meshes a disc with a hole, or a ball's shell cut from a box, of curved cells of one kind."""
    gmsh.clear()
    occ = gmsh.model.occ
    for name, value in {
        "RecombineAll": kind == "quad",
        "SecondOrderIncomplete": not is_complete,
    }.items():
        gmsh.option.setNumber(f"Mesh.{name}", value)
    gmsh.option.setNumber("Mesh.MeshSizeMax", 1.2)
    gmsh.option.setNumber("Mesh.MeshSizeMin", 0.5)
    if kind in ("triangle", "quad"):
        surface, _ = occ.cut(
            [(2, occ.addDisk(0, 0, 0, 2, 2))], [(2, occ.addDisk(0.2, 0, 0, 0.7, 0.7))]
        )
        occ.synchronize()
        sides = [tag for _, tag in gmsh.model.getBoundary(surface, oriented=False)]
        inner = min(sides, key=lambda tag: occ.getMass(1, tag))
        gmsh.model.addPhysicalGroup(2, [surface[0][1]], name="fluid")
        dimension = 2
    elif kind == "tetra":
        volume, _ = occ.cut(
            [(3, occ.addBox(-1, -1, -1, 2, 2, 2))], [(3, occ.addSphere(0, 0, 0, 0.6))]
        )
        occ.synchronize()
        sides = [tag for _, tag in gmsh.model.getBoundary(volume, oriented=False)]
        inner = min(
            sides,
            key=lambda tag: occ.getMass(2, tag) if gmsh.model.getType(2, tag) == "Sphere" else 99,
        )
        gmsh.model.addPhysicalGroup(3, [volume[0][1]], name="fluid")
        dimension = 3
    else:  # a quarter of a ring, extruded
        gmsh.option.setNumber("Mesh.RecombineAll", kind == "hexahedron")
        for at in ((0, 0), (1, 0), (2, 0), (0, 2), (0, 1)):
            occ.addPoint(*at, 0)
        lines = (
            occ.addLine(2, 3),
            occ.addCircleArc(3, 1, 4),
            occ.addLine(4, 5),
            occ.addCircleArc(5, 1, 2),
        )
        face = occ.addPlaneSurface([occ.addCurveLoop(lines)])
        made = occ.extrude([(2, face)], 0, 0, 0.7, [2], recombine=True)
        occ.remove([(0, 1)])
        occ.synchronize()
        for line in (lines[0], lines[2]):
            gmsh.model.mesh.setTransfiniteCurve(line, 3)
        for line in (lines[1], lines[3]):
            gmsh.model.mesh.setTransfiniteCurve(line, 4)
        gmsh.model.mesh.setTransfiniteSurface(face)
        sides = [tag for _, tag in gmsh.model.getBoundary([made[1]], oriented=False)]
        inner = next(
            t for t in sides if gmsh.model.getType(2, t) == "Cylinder" and occ.getMass(2, t) < 1.5
        )
        gmsh.model.addPhysicalGroup(3, [made[1][1]], name="fluid")
        dimension = 3
    gmsh.model.addPhysicalGroup(dimension - 1, [inner], name="wall")
    gmsh.model.addPhysicalGroup(dimension - 1, [tag for tag in sides if tag != inner], name="far")
    gmsh.model.mesh.generate(dimension)
    gmsh.model.mesh.setOrder(order)


def save(path, version: float = 4.1, binary: int = 1) -> None:
    gmsh.option.setNumber("Mesh.MshFileVersion", version)
    gmsh.option.setNumber("Mesh.Binary", binary)
    gmsh.write(str(path))


def local(dimension: int):
    """Reference places inside of a triangle or cube for gmsh, and for the lattice of the same shape."""
    rng = np.random.default_rng(0)
    return rng.dirichlet(np.ones(4), 5)[:, :dimension]


def of_gmsh(shape: str, x: np.ndarray) -> np.ndarray:
    """Reference places (s, d) in the unit cell, as gmsh has them (s, 3)."""
    at = np.zeros((len(x), 3))
    at[:, : x.shape[1]] = x if shape in ("triangle", "tetra") else 2 * x - 1
    if shape == "wedge":
        at[:, :2] = x[:, :2]
    return at


def volumes(number: int) -> np.ndarray:
    """Volumes of gmsh's curved cells, by its own quadrature."""
    places, weights = gmsh.model.mesh.getIntegrationPoints(number, "Gauss12")
    return gmsh.model.mesh.getJacobians(number, places)[1].reshape(-1, len(weights)) @ weights


CASES = [
    ("triangle", 3),
    ("quad", 4),
    ("tetra", 2),
    ("tetra", 4),
    ("hexahedron", 2),
    ("hexahedron", 3),
    ("wedge", 2),
]


@over("kind order", [case for case in CASES if case != ("tetra", 4)], nightly=[("tetra", 4)])
def test_cells_are_the_curved_cells_that_gmsh_evaluates(tmp_path, kind, order):
    disc(order, kind)
    save(tmp_path / "a.msh")
    mesh = io.read(tmp_path / "a.msh")
    (name,) = mesh.cells
    cell = lagrange_types()[name]
    assert (cell.shape, cell.order) == (kind, order)
    names = {"wedge": "Prism", "quad": "Quadrangle", "tetra": "Tetrahedron"}
    number = gmsh.model.mesh.getElementType(names.get(kind, kind.capitalize()), order)
    x = local(cell.dimension)
    _, _, places = gmsh.model.mesh.getJacobians(number, of_gmsh(kind, x).ravel())
    evaluated = np.einsum("sn,knd->ksd", shape_values(name, x), mesh.points[mesh.cells[name]])
    expected = places.reshape(-1, len(x), 3)[:, :, : cell.dimension]
    np.testing.assert_allclose(evaluated, expected, atol=1e-12)
    # volume and validity of the curved cells
    report = jm.quality(mesh)
    tags = gmsh.model.mesh.getElements(cell.dimension)[1][0]
    bound = gmsh.model.mesh.getElementQualities(tags, "minDetJac")
    np.testing.assert_allclose(report.volume, volumes(number), rtol=1e-9)
    assert np.array_equal(np.asarray(report.is_inverted), bound < 0)


@over("version binary", [(2.2, 1), (4.1, 0)], nightly=[(2.2, 0), (4.1, 1)])
@over("kind order", [("triangle", 3)], nightly=[("hexahedron", 2)])
def test_gmsh_files_move_and_come_back(tmp_path, kind, order, version, binary):
    disc(order, kind)
    save(tmp_path / "a.msh", version, binary)
    mesh = io.read(tmp_path / "a.msh")
    wall = mesh.points[mesh.patch("wall")]
    plan = jm.prepare(mesh, "wall", "far")
    u = 0.05 * np.sin(3 * wall[:, ::-1])
    moved = np.asarray(jm.deform(plan, u))
    np.testing.assert_allclose(moved[mesh.patch("wall")], wall + u, atol=1e-12)
    assert int(jm.quality(mesh, moved).inverted) == 0
    io.write(tmp_path / "same.msh", mesh)
    assert (tmp_path / "same.msh").read_bytes() == (tmp_path / "a.msh").read_bytes()
    io.write(tmp_path / "b.msh", mesh.moved(moved))
    gmsh.open(str(tmp_path / "b.msh"))
    dimension = mesh.points.shape[1]
    number = gmsh.model.mesh.getElements(dimension)[0][0]
    np.testing.assert_allclose(jm.quality(mesh.moved(moved)).volume, volumes(number), rtol=1e-9)


@pytest.mark.parametrize(
    ("order", "is_complete", "words"),
    [
        (5, True, "elements of type 28; elements of order 1 to 4 are read"),
        (3, False, "with all inner nodes"),
    ],
)
def test_orders_that_are_not_read_are_told_in_one_sentence(tmp_path, order, is_complete, words):
    disc(order, "triangle", is_complete=is_complete)
    save(tmp_path / "a.msh")
    with pytest.raises(ValueError, match=words):
        io.read(tmp_path / "a.msh")
