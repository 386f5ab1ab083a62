"""A mesh and its cells in one order, whatever happens to it."""

import equinox as eqx
import jax
import numpy as np
import pytest

import jaxmorph as jm
from jaxmorph import io

POINTS = np.array(
    [[0, 0], [1, 0], [2, 0], [2.5, 1], [1, 1], [0, 1], [0.4, 2], [3.5, 0.5]], dtype=float
)
CELLS = {"triangle": [[5, 4, 6], [2, 7, 3]], "quad": [[0, 1, 4, 5], [1, 2, 3, 4]]}
BOUNDARY = {"wall": [0, 1, 2], "rest": [0, 5, 6, 4, 3, 7, 2]}


def mixed():
    return jm.Mesh(POINTS, CELLS, BOUNDARY)


def test_cells_keep_their_order_under_jit():
    """JAX sorts the keys of a dict: per-cell arrays of a mesh that went through it must name the same cells."""
    mesh = mixed()
    leaves, structure = jax.tree.flatten(mesh)
    again = jax.tree.unflatten(structure, leaves)
    assert (
        list(again.cells)
        == list(mesh.cells)
        == list(mesh.moved(POINTS + 1).cells)
        == ["quad", "triangle"]
    )
    here, there = jm.quality(mesh), eqx.filter_jit(jm.quality)(mesh)
    assert here.types == there.types == (("quad", 2), ("triangle", 2))
    np.testing.assert_allclose(here.volume, [1, 1.25, 0.5, 0.625], rtol=1e-14)
    for name in ("volume", "skewness", "aspect_ratio", "centroid"):
        np.testing.assert_allclose(getattr(there, name), getattr(here, name), rtol=1e-14)
    other = jm.Mesh(POINTS, dict(reversed(CELLS.items())), BOUNDARY)
    assert jax.tree.structure(other) == jax.tree.structure(mesh)


def test_a_file_that_names_its_triangles_first_stays_so(tmp_path):
    """The file's own order of elements is kept in the file; the arrays per cell are the mesh's."""
    elements = ["5 5 4 6 0", "9 0 1 4 5 1", "5 2 7 3 2", "9 1 2 3 4 3"]
    rows = [f"{x} {y} {i}" for i, (x, y) in enumerate(POINTS)]
    marker = ["NMARK= 1", "MARKER_TAG= wall", "MARKER_ELEMS= 2", "3 0 1", "3 1 2"]
    text = ["NDIME= 2", "NELEM= 4", *elements, "NPOIN= 8", *rows, *marker]
    (tmp_path / "in.su2").write_text("\n".join(text) + "\n")
    mesh = io.read(tmp_path / "in.su2")
    assert {kind: ids.tolist() for kind, ids in mesh.cells.items()} == CELLS
    assert list(mesh.cells) == ["quad", "triangle"]
    io.write(tmp_path / "out.su2", mesh.moved(POINTS + 0.5))
    lines = (tmp_path / "out.su2").read_text().splitlines()
    assert [line for line in lines if line in elements] == elements


@pytest.mark.parametrize("written", [False, True])
def test_cell_data_goes_to_its_cells(tmp_path, written):
    """Also into a file whose blocks stand in another order than the mesh's."""
    meshio = pytest.importorskip("meshio")
    mesh, path = mixed(), tmp_path / "in.vtu"
    if written:
        space = np.column_stack([POINTS, np.zeros(len(POINTS))])
        meshio.Mesh(space, [(kind, np.array(ids)) for kind, ids in CELLS.items()]).write(path)
        assert [block.type for block in meshio.read(path).cells] == ["triangle", "quad"]
        mesh = io.read(path)
    areas = np.asarray(jm.quality(mesh).volume)
    io.write(tmp_path / "out.vtu", mesh, cell_data={"area": areas})
    found = meshio.read(tmp_path / "out.vtu")
    told = {
        tuple(ids): area
        for block, values in zip(found.cells, found.cell_data["area"], strict=True)
        for ids, area in zip(block.data.tolist(), values.tolist(), strict=True)
    }
    expected = {(0, 1, 4, 5): 1, (1, 2, 3, 4): 1.25, (5, 4, 6): 0.5, (2, 7, 3): 0.625}
    assert told == pytest.approx(expected)


def test_one_type_under_two_names_is_refused():
    with pytest.raises(ValueError, match="have several names"):
        jm.Mesh(POINTS, {"tri": [[0, 1, 2]], "triangle": [[2, 3, 4]]})
