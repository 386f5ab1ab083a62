"""Meshes of meshio and PyVista become ours and come back with other points, and nothing else changed."""

import sys

import numpy as np
import pytest
from runs import refusals

import jaxmorph as jm

meshio = pytest.importorskip("meshio")
pyvista = pytest.importorskip("pyvista")

POINTS = np.array(
    [[0, 0], [1, 0], [2, 0], [2.5, 1], [1, 1], [0, 1], [0.4, 2], [3.5, 0.5]], dtype=float
)
SPACE = np.column_stack([POINTS, np.full(len(POINTS), 0.25)])
TRIANGLES, QUADS = [[5, 4, 6], [2, 7, 3]], [[0, 1, 4, 5], [1, 2, 3, 4]]
BOTTOM, LEFT = [[0, 1], [1, 2]], [[5, 0]]


def plain():
    return jm.Mesh(
        POINTS, {"triangle": TRIANGLES, "quad": QUADS}, {"wall": [0, 1, 2], "far field": [3, 6, 7]}
    )


def of_gmsh():
    """Blocks in another order than ours, a set, two groups (one without a name), arrays on points and cells."""
    kinds, rows = ("triangle", "line", "quad", "line"), (TRIANGLES, BOTTOM, QUADS, LEFT)
    blocks = [(kind, np.array(ids)) for kind, ids in zip(kinds, rows, strict=True)]
    tags = [np.full(2, 9), np.full(2, 3), np.full(2, 9), np.full(1, 4)]
    return meshio.Mesh(
        SPACE,
        [(kind, np.array(ids)) for kind, ids in blocks],
        point_data={"heat": POINTS[:, 0]},
        cell_data={
            "gmsh:physical": tags,
            "age": [np.arange(2.0), np.zeros(2), np.arange(2.0, 4.0), np.ones(1)],
        },
        cell_sets={"corner": [np.array([], int), np.array([0]), np.array([], int), np.array([0])]},
        field_data={"bottom": np.array([3, 1]), "fluid": np.array([9, 2])},
    )


def patches(mesh):
    return {name: np.asarray(nodes).tolist() for name, nodes in mesh.patches.items()}


def cells(mesh):
    return {kind: np.asarray(corners).tolist() for kind, corners in mesh.cells.items()}


def test_a_mesh_of_meshio_comes_back_as_it_was():
    found = of_gmsh()
    mesh = jm.Mesh.from_meshio(found)
    np.testing.assert_array_equal(mesh.points, POINTS)
    assert cells(mesh) == {"quad": QUADS, "triangle": TRIANGLES}
    assert patches(mesh) == {"corner": [0, 1, 5], "bottom": [0, 1, 2], "physical_4": [0, 5]}
    back = mesh.moved(2 * POINTS).to_meshio(cell_data={"row": np.arange(4)})
    np.testing.assert_array_equal(back.points, SPACE * [2, 2, 1])
    listed, expected = (
        [(block.type, block.data.tolist()) for block in each.cells] for each in (back, found)
    )
    assert listed == expected
    assert back.field_data.keys() == found.field_data.keys()
    assert back.cell_sets.keys() == found.cell_sets.keys()
    for name in ("age", "gmsh:physical"):
        np.testing.assert_array_equal(
            np.concatenate(back.cell_data[name]), np.concatenate(found.cell_data[name])
        )
    rows = dict(zip(("triangle", "bottom", "quad", "left"), back.cell_data["row"], strict=True))
    assert rows["triangle"].tolist() == [2, 3]
    assert rows["quad"].tolist() == [0, 1]
    assert np.isnan(rows["bottom"]).all()
    assert np.isnan(rows["left"]).all()
    assert "row" not in found.cell_data
    assert "patch:bottom" not in found.point_data
    again = jm.Mesh.from_meshio(back)
    assert patches(again) == patches(mesh)
    assert cells(again) == cells(mesh)


@pytest.mark.parametrize("library", ["meshio", "pyvista"])
def test_round_trips(library):
    mesh = plain()
    there = getattr(mesh, f"to_{library}")(
        point_data={"u": POINTS}, cell_data={"u": np.ones((4, 2), np.float32)}
    )
    assert np.asarray(there.point_data["u"]).shape == (8, 3)
    again = getattr(jm.Mesh, f"from_{library}")(there)
    np.testing.assert_array_equal(again.points, mesh.points)
    assert again.points.dtype == np.float64
    assert cells(again) == cells(mesh)
    assert patches(again) == patches(mesh)


def test_cell_arrays_are_where_vtk_measures_them():
    """Areas of ours beside those that VTK computes, in a new grid and in one whose cells are in another order."""
    mesh = plain()
    types = np.array([5, 9, 3, 9, 5], np.uint8)
    ids = np.concatenate(
        [[3, *TRIANGLES[0]], [4, *QUADS[0]], [2, *BOTTOM[0]], [4, *QUADS[1]], [3, *TRIANGLES[1]]]
    )
    mixed = pyvista.UnstructuredGrid(ids, types, SPACE)
    mixed.cell_data["marker"] = np.array([0, 0, 7, 0, 0])
    mixed.cell_data["age"] = np.arange(5.0)
    other = jm.Mesh.from_pyvista(mixed)
    assert patches(other) == {"marker_7": [0, 1]}
    assert cells(other) == cells(mesh)
    for each in (mesh, other):
        moved = each.moved(POINTS @ np.array([[1, 0.3], [0, 2]]))
        grid = moved.to_pyvista(cell_data={"mine": np.asarray(jm.quality(moved).volume)})
        measured = np.asarray(grid.compute_cell_sizes(length=False, volume=False).cell_data["Area"])
        mine = np.asarray(grid.cell_data["mine"])
        np.testing.assert_allclose(mine[measured > 0], measured[measured > 0], rtol=1e-6)
        assert np.isnan(mine[measured == 0]).all()
        assert (measured > 0).sum() == 4
    assert np.asarray(grid.cell_data["age"]).tolist() == [0, 1, 2, 3, 4]
    np.testing.assert_array_equal(np.asarray(grid.points)[:, 2], 0.25)
    np.testing.assert_array_equal(mixed.points, SPACE)


def test_other_data_sets_of_pyvista():
    grid = pyvista.StructuredGrid(
        *np.meshgrid(np.arange(3.0), np.arange(2.0), np.arange(4.0), indexing="ij")
    )
    mesh = jm.Mesh.from_pyvista(grid)
    np.testing.assert_allclose(np.asarray(jm.quality(mesh).volume), np.ones(6), rtol=1e-12)
    assert patches(mesh) == {"boundary": list(range(24))}
    surface = jm.Mesh.from_pyvista(pyvista.Sphere(theta_resolution=8, phi_resolution=8))
    assert list(surface.cells) == ["triangle"]
    assert surface.points.shape[1] == 3


def test_polyhedra_and_voxels_of_pyvista():
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    faces = [4, 3, 0, 2, 1, 3, 0, 1, 3, 3, 1, 2, 3, 3, 0, 3, 2]
    grid = pyvista.UnstructuredGrid(
        np.array([len(faces), *faces]), np.array([42], np.uint8), corners
    )
    mesh = jm.Mesh.from_pyvista(grid)
    np.testing.assert_allclose(np.asarray(jm.quality(mesh).volume), [1 / 6])
    voxels = jm.Mesh.from_pyvista(pyvista.ImageData(dimensions=(3, 2, 2)))
    np.testing.assert_allclose(np.asarray(jm.quality(voxels).volume), [1, 1])


POLYGON = pyvista.UnstructuredGrid(
    np.array([5, 0, 1, 2, 3, 4]), np.array([7], np.uint8), np.eye(5, 3)
)
CURVED = meshio.Mesh(SPACE, [("triangle21", [[*range(8), *range(8), *range(5)]])])
TORN = meshio.Mesh(np.where(np.arange(8)[:, None] == 3, np.nan, SPACE), [("quad", QUADS)])
test_what_cannot_be_taken_is_named = refusals(
    (lambda: jm.Mesh.from_pyvista(POLYGON), "type polygon are not supported"),
    (
        lambda: jm.Mesh.from_pyvista(pyvista.MultiBlock([POLYGON])),
        "single grid of PyVista, not a MultiBlock",
    ),
    (lambda: jm.Mesh.from_meshio(CURVED), "type triangle21 are not supported"),
    (lambda: jm.Mesh.from_meshio(TORN), "point 3 is not finite"),
    (
        lambda: plain().to_meshio(cell_data={"u": np.zeros(3)}),
        r"'u' has shape \(3,\); expected one row for each of 4 cells",
    ),
)


@pytest.mark.parametrize(("library", "extra"), [("meshio", "io"), ("pyvista", "plot")])
def test_a_missing_extra_is_named(monkeypatch, library, extra):
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ImportError, match=rf"needs {library}: pip install 'jaxmorph\[{extra}\]'"):
        getattr(plain(), f"to_{library}")()
