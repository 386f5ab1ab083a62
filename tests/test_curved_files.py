"""Curved cells in files of CGNS and VTK, against gmsh's CGNS writer and VTK's own evaluation; and what is refused."""

import re
import warnings

import numpy as np
import pytest
from formats import rewritten
from meshes import gmsh_session
from runs import all_refused, over

import jaxmorph as jm
from jaxmorph import io
from jaxmorph._host.cells.lagrange import derivatives, lagrange_types, shape_values
from jaxmorph._host.cells.orders import CGNS_ORDER, GMSH

TYPES = lagrange_types()
HIGH = [name for name in TYPES if TYPES[name].order > 1 and TYPES[name].dimension > 1]
IN_VTK = [name for name in HIGH if TYPES[name].shape != "pyramid" or name == "pyramid13"]


def bent(name: str) -> jm.Mesh:
    """One cell of a type, a little off its reference cell."""
    x = TYPES[name].reference
    return jm.Mesh(
        x + 0.03 * np.random.default_rng(0).normal(size=x.shape), {name: np.arange(len(x))[None]}
    )


@pytest.mark.parametrize("name", IN_VTK)
def test_cells_are_the_curved_cells_that_vtk_evaluates(name):
    vtk = pytest.importorskip("vtk")
    mesh = bent(name)
    grid, d = mesh.to_pyvista(), TYPES[name].dimension
    assert np.array_equal(jm.Mesh.from_pyvista(grid).cells[name], mesh.cells[name])
    place = np.random.default_rng(1).dirichlet(np.ones(4))[:d]
    evaluated, at = [0.0] * 3, [*place, 0.0][:3]
    if (
        TYPES[name].shape == "pyramid"
    ):  # VTK's functions of a pyramid are others; those of its base are not
        place, at = np.array([*place[:2], 0]), [*place[:2], 0.0]
    grid.GetCell(0).EvaluateLocation(vtk.reference(0), at, evaluated, [0.0] * len(mesh.points))
    np.testing.assert_allclose(
        evaluated[:d], shape_values(name, place[None])[0] @ mesh.points, atol=1e-12
    )


@over("ending", ["vtu"], nightly=["vtk"])
@over(
    "name",
    ["triangle10", "wedge15"],
    nightly=["hexahedron20", "hexahedron64", "tetra35", "pyramid13"],
)
def test_vtk_files_hold_what_vtk_reads_and_writes(tmp_path, name, ending):
    pyvista = pytest.importorskip("pyvista")
    mesh = bent(name)
    grid = mesh.to_pyvista()
    io.write(tmp_path / f"a.{ending}", mesh)
    assert np.array_equal(
        pyvista.read(tmp_path / f"a.{ending}").cell_connectivity, grid.cell_connectivity
    )
    grid.save(tmp_path / f"b.{ending}")
    for file in (
        "a",
        "b",
    ):  # VTK's own version of the file is newer: last edges of hexahedra stand the other way round
        back = io.read(tmp_path / f"{file}.{ending}")
        assert np.array_equal(back.cells[name], mesh.cells[name])
    again = rewritten(tmp_path / f"c.{ending}", back.moved(back.points + 1))
    assert np.array_equal(again.cells[name], mesh.cells[name])
    np.testing.assert_array_equal(again.points, back.points + 1)


@pytest.mark.parametrize(
    "name", ["quad16", "tetra35", "pyramid30", "wedge18", "hexahedron64", "hexahedron20"]
)
def test_cgns_files_of_gmsh_have_the_curved_cell(tmp_path, name):
    pytest.importorskip("h5py")
    mesh, cell = bent(name), TYPES[name]
    family = {"quad": "Quadrangle", "tetra": "Tetrahedron", "wedge": "Prism"}.get(
        cell.shape, cell.shape.capitalize()
    )
    x = np.zeros((len(mesh.points), 3))
    x[:, : cell.dimension] = mesh.points
    with gmsh_session() as gmsh:
        kind = gmsh.model.mesh.getElementType(family, cell.order, not cell.is_complete)
        entity = gmsh.model.addDiscreteEntity(cell.dimension)
        gmsh.model.mesh.addNodes(cell.dimension, entity, 1 + np.arange(len(x)), x.ravel())
        gmsh.model.mesh.addElementsByType(entity, kind, [1], 1 + np.argsort(GMSH.places(name)))
        gmsh.write(str(tmp_path / "a.cgns"))
    read = io.read(tmp_path / "a.cgns")
    np.testing.assert_array_equal(read.points[read.cells[name]][0], mesh.points)
    again = rewritten(tmp_path / "b.cgns", read.moved(read.points + 1))
    np.testing.assert_array_equal(again.points, read.points + 1)
    assert np.array_equal(again.cells[name], read.cells[name])


@pytest.mark.parametrize("name", ["wedge40", "wedge75"])
def test_cgns_order_of_wedges(name):
    """gmsh writes no such wedges: base, sides and top in the order of the SIDS, each by its own corners."""
    lattice = CGNS_ORDER.lattice("wedge", TYPES[name].order)
    p, inner = TYPES[name].order, lattice[6 + 9 * (TYPES[name].order - 1) :]
    faces = [
        inner[:, 2] == 0,
        inner[:, 1] == 0,
        inner[:, :2].sum(axis=1) == p,
        inner[:, 0] == 0,
        inner[:, 2] == p,
    ]
    rows = [int(np.flatnonzero(face)[0]) for face in faces]
    assert rows == sorted(rows)
    assert (
        sum(face.sum() for face in faces) + np.any(faces, axis=0).argmin()
        >= len(inner) - (p - 1) ** 2
    )


@pytest.mark.parametrize("name", HIGH)
def test_shape_functions_give_derivatives_and_linear_fields(name):
    cell = TYPES[name]
    place = np.random.default_rng(2).dirichlet(np.ones(4), 3)[:, : cell.dimension]
    at_place = place.copy()
    if cell.shape == "pyramid":
        at_place[:, :2] *= (
            1 - at_place[:, 2:]
        )  # places of a pyramid are x / (1 - z), y / (1 - z), z
    np.testing.assert_allclose(shape_values(name, place) @ cell.reference, at_place, atol=1e-12)
    slopes = np.einsum("snd,ne->sed", derivatives(name, place), cell.reference)
    np.testing.assert_allclose(
        slopes, np.broadcast_to(np.eye(cell.dimension), slopes.shape), atol=1e-11
    )


def test_bad_files_are_refused_in_a_sentence(tmp_path):
    io.write(tmp_path / "a.msh", jm.elevate(square(), 2))
    data = (tmp_path / "a.msh").read_bytes()
    assert len(io.read(tmp_path / "a.msh").points) == 9
    (tmp_path / "short.msh").write_bytes(data.replace(b"$EndElements", b"")[:-40])
    with pytest.raises(ValueError, match=r"short\.msh"):
        io.read(tmp_path / "short.msh")
    text = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n3\n1 0 0 0\n2 1 0 0\n3 0 1 0\n$EndNodes\n"
    for number, count, words in ((25, 21, "type 25;"), (9, 5, "numbers, ")):
        row = " ".join(map(str, [1, number, 2, 0, 1, *([1, 2, 3] * 7)[:count]]))
        (tmp_path / "b.msh").write_text(f"{text}$Elements\n1\n{row}\n$EndElements\n")
        with pytest.raises(ValueError, match=words):
            io.read(tmp_path / "b.msh")
    curved, five = jm.elevate(square(), 2), {"triangle6": np.arange(5)[None]}
    all_refused(
        (
            lambda: io.write(tmp_path / "a.su2", curved),
            "SU2's files hold linear cells, not triangle6",
        ),
        (
            lambda: io.write(tmp_path / "a.vtu", bent("pyramid14")),
            re.escape("VTK has no cells of type pyramid14"),
        ),
        (
            lambda: jm.Mesh(np.zeros((6, 2)), five),
            r"type 'triangle6' have shape \(1, 5\); expected \(k, 6\)",
        ),
    )


@pytest.mark.parametrize(("name", "ending"), [("quad9", "msh"), ("hexahedron20", "vtu")])
def test_a_cell_that_names_a_node_twice_is_told_when_it_is_read(tmp_path, name, ending):
    """Where an edge's middle is its first corner, both derivatives along the edge cannot agree: det J changes its sign."""
    mesh = bent(name)
    ids = np.array(mesh.cells[name])
    ids[0, TYPES[name].corners] = ids[0, 0]
    io.write(tmp_path / f"a.{ending}", jm.Mesh(mesh.points, {name: ids}))
    with pytest.warns(
        UserWarning, match=rf"1 of 1 cells of type {name} name a node twice, first cell 0 near \("
    ):
        read = io.read(tmp_path / f"a.{ending}")
    assert jm.proof(read).invalid == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rewritten(tmp_path / f"b.{ending}", mesh)


def square() -> jm.Mesh:
    return jm.Mesh(
        np.array([(0.0, 0), (1, 0), (1, 1), (0, 1)]),
        {"triangle": [[0, 1, 2], [0, 2, 3]]},
        {"low": [0, 1]},
    )
