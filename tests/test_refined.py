"""Outer faces of curved meshes, and their cells in linear pieces."""

import numpy as np
import pytest
from meshes import bricks, square
from scipy.interpolate import BarycentricInterpolator

import jaxmorph as jm
from jaxmorph import cases


@pytest.mark.parametrize("kind", ["tetra", "pyramid", "wedge", "hexahedron"])
@pytest.mark.parametrize("order", [1, 2, 3])
def test_pieces_fill_their_cells(kind, order):
    """Each cell's pieces have its volume, and no piece has nodes of its own on a side that two cells share."""
    mesh = cases.bricks(kind, cells=3)
    mesh = mesh if order == 1 else jm.elevate(mesh, order)
    fine, owner = mesh.refined(3)
    volumes = np.asarray(jm.quality(fine).volume)
    assert volumes.sum() == pytest.approx(1, rel=1e-12)
    of_cells = np.bincount(owner, volumes)
    np.testing.assert_allclose(of_cells, np.asarray(jm.quality(mesh).volume), rtol=1e-9)
    assert len(np.unique(np.round(fine.points, 9), axis=0)) == len(fine.points)
    closed = np.concatenate([*jm.boundary_faces(fine).values()], axis=None)
    assert np.isin(np.round(fine.points[closed], 9), [0, 1]).any(axis=1).all()


def test_pieces_follow_curved_edges():
    mesh = jm.elevate(square(), 3)
    x = np.asarray(mesh.points)
    bent = mesh.moved(np.stack([x[:, 0], x[:, 1] + 0.1 * x[:, 0] ** 3], axis=1))
    ((kind, ids),) = bent.cells.items()
    fine, _ = bent.refined(5)
    first, second, *inner = ids[0, [0, 1, 4, 5]]
    nodes = np.asarray(bent.points)[[first, *inner, second]]
    on_edge = BarycentricInterpolator(np.linspace(0, 1, 4), nodes)(np.linspace(0, 1, 6))
    assert kind == "quad16"
    assert np.abs(fine.points[:, None] - on_edge).sum(axis=2).min(axis=0).max() < 1e-12


def test_skin_has_the_faces_of_boundary_faces_and_their_cells():
    mesh = bricks(3)
    skin, owner = mesh.skin()
    faces = jm.boundary_faces(mesh)["quad"]
    assert {*map(frozenset, skin.cells["quad"].tolist())} == {*map(frozenset, faces.tolist())}
    owners = mesh.cells["hexahedron"][owner]
    assert (owners[:, :, None] == skin.cells["quad"][:, None]).any(axis=1).all()
    (name, nodes), *_ = mesh.patches.items()
    some = mesh.skin(name)[0].cells["quad"]
    assert len(some)
    assert np.isin(some, nodes).all()
    with pytest.raises(ValueError, match="no patch is called 'nowhere'"):
        mesh.skin("nowhere")


def test_skin_of_a_curved_mesh_is_curved():
    mesh = jm.elevate(bricks(2), 2)
    skin, owner = mesh.skin()
    assert [*skin.cells] == ["quad9"]
    assert len(owner) == 24
    fine, face = skin.refined(2)
    np.testing.assert_array_equal(np.bincount(face), np.full(24, 4))
    assert jm.judge(fine).ok


def test_cells_of_lower_dimension_have_no_skin():
    mesh = square()
    more = jm.Mesh(mesh.points, {"line": [[0, 1]], **mesh.cells})
    assert np.array_equal(more.skin()[1], mesh.skin()[1] + 1)
    assert not jm.Mesh(mesh.points).refined(2)[0].cells
    assert mesh.moved(np.asarray(mesh.points, np.float32)).refined(2)[0].points.dtype == np.float32
    with pytest.raises(ValueError, match="`steps` must be a whole number of at least 1"):
        mesh.refined(0)


def test_polyhedra_have_faces_of_their_own():
    """Pieces of a polyhedron meet the whole cell beside it in no common face."""
    pyvista = pytest.importorskip("pyvista")
    angles = np.linspace(0, 2 * np.pi, 6)[:5]
    ring = np.column_stack([np.cos(angles), np.sin(angles)])
    points = np.concatenate([np.insert(ring, 2, z, axis=1) for z in (0, 1)])
    sides = [[k, (k + 1) % 5, (k + 1) % 5 + 5, k + 5] for k in range(5)]
    faces = [[4, 3, 2, 1, 0], [5, 6, 7, 8, 9], *sides]
    stream = [len(faces), *(entry for face in faces for entry in (len(face), *face))]
    grid = pyvista.UnstructuredGrid(
        np.array([len(stream), *stream]), np.array([42], np.uint8), points
    )
    with pytest.raises(
        ValueError, match=r"has polyhedra or polygons: jm.boundary_faces\(mesh\) lists"
    ):
        jm.Mesh.from_pyvista(grid).skin()
