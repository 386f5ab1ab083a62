"""PLOT3D grids in every form, and VTK's view of the result."""

import itertools

import numpy as np
import pytest
from plot3d import box, write
from runs import runs

import jaxmorph as jm
from jaxmorph import io

FORMS = [
    *(("text", "<", 8, blank) for blank in (False, True)),
    *itertools.product(("records", "plain"), "<>", (4, 8), (False, True)),
]


@pytest.mark.parametrize(("form", "order", "width", "blank"), FORMS)
@pytest.mark.parametrize(
    ("is_multiple", "counts"), runs([(True, (4, 3, 5))], nightly=[(False, (4, 3))])
)
def test_every_form_comes_back_as_it_was(tmp_path, form, order, width, blank, counts, is_multiple):
    blocks = box(*counts) if is_multiple else box(*counts)[:1]
    mesh = io.read(write(tmp_path / "a.xyz", blocks, form, order, width, is_multiple, blank))
    size = int(np.prod(counts))
    assert len(mesh.points) == len(blocks) * size - (len(blocks) - 1) * size // counts[0]
    first = blocks[0].reshape(len(counts), -1, order="F").T
    exact = first if width == 8 else first.astype(np.float32)
    np.testing.assert_array_equal(mesh.points[:size], exact)
    assert sum(map(len, mesh.cells.values())) == len(blocks) * np.prod(np.array(counts) - 1)
    io.write(tmp_path / "same.xyz", mesh)
    assert (tmp_path / "same.xyz").read_bytes() == (tmp_path / "a.xyz").read_bytes()
    points = mesh.points * np.pi
    io.write(tmp_path / "b.xyz", mesh.moved(points))
    rounded = points if width == 8 else points.astype(np.float32)
    np.testing.assert_array_equal(io.read(tmp_path / "b.xyz").points, rounded)
    if form != "text":
        assert (tmp_path / "b.xyz").stat().st_size == (tmp_path / "a.xyz").stat().st_size


def test_patches_by_side_and_by_ranges(tmp_path):
    mesh = io.read(write(tmp_path / "a.p3d", box(4, 3, 5), "records"))
    sides = {
        f"block{block}_{axis}{end}" for block in (1, 2) for axis in "ijk" for end in ("min", "max")
    }
    # the blocks meet at the last i of the first one and at the first j of the second one
    assert set(mesh.patches) == sides - {"block1_imax", "block2_jmin"}
    assert (mesh.points[mesh.patch("block1_imin"), 0] == 0).all()
    assert (mesh.points[mesh.patch("block2_jmax"), 0] == 2).all()
    assert int(jm.quality(mesh).inverted) == 0
    (tmp_path / "a.p3d.patches").write_text(
        "# walls\nwall 1 KMIN\nwall 2 kmin # the other\n\npart 1 1 2 3 1 5 5\n"
    )
    mesh = io.read(tmp_path / "a.p3d")
    assert set(mesh.patches) == {"wall", "part", "unnamed"}
    assert (mesh.points[mesh.patch("wall"), 2] == 0).all()
    assert len(mesh.patch("wall")) == 7 * 3
    assert len(mesh.patch("part")) == 2 * 3
    for line in (
        "wall",
        "wall 3 kmin",
        "wall 0 kmin",
        "wall 1 lmin",
        "wall 1 1 9 1 1 1 1",
        "wall 1 1 2",
    ):
        (tmp_path / "a.p3d.patches").write_text(f"\n{line}\n")
        with pytest.raises(
            ValueError, match=r"a.p3d.patches, line 2: .*; blocks are 4 x 3 x 5, 3 x 4 x 5"
        ):
            io.read(tmp_path / "a.p3d")


@pytest.mark.parametrize("form", ["text", "records", "plain"])
def test_vtk_sees_the_moved_grid(tmp_path, form):
    pyvista = pytest.importorskip("pyvista")
    blocks = box(4, 3, 5)
    mesh = io.read(write(tmp_path / "a.xyz", blocks, form))
    io.write(tmp_path / "b.xyz", mesh.moved(mesh.points @ [[1, 0.5, 0], [0, 1, 0.25], [0, 0, 2]]))
    if form == "text":
        (tmp_path / "b.xyz").write_text((tmp_path / "b.xyz").read_text().replace("D", "e"))
    reader = pyvista.MultiBlockPlot3DReader(tmp_path / "b.xyz")
    reader.reader.SetAutoDetectFormat(form != "text")
    reader.reader.SetBinaryFile(form != "text")
    reader.reader.SetMultiGrid(True)
    found = reader.read()
    assert len(found) == 2
    for seen, block in zip(found, blocks, strict=True):
        expected = block.reshape(3, -1, order="F").T @ [[1, 0.5, 0], [0, 1, 0.25], [0, 0, 2]]
        np.testing.assert_allclose(seen.points, expected, rtol=1e-6)


def test_what_is_no_grid(tmp_path):
    write(tmp_path / "a.xyz", box(4, 3, 5), "records")
    whole = (tmp_path / "a.xyz").read_bytes()
    for content in (
        b"",
        whole[:-1],
        whole[:40],
        whole + b"\0",
        b"3 3\n",
        b"2 2 2 2\n1 2 3\n",
        b"\0" * 100,
    ):
        (tmp_path / "b.xyz").write_bytes(content)
        with pytest.raises(ValueError, match="not a whole PLOT3D grid"):
            io.read(tmp_path / "b.xyz")
    write(tmp_path / "c.xyz", box(4, 3), "text")
    text = (tmp_path / "c.xyz").read_text()
    for word, message in (
        ("nan", "lines from 1: something that is not a number|not finite"),
        ("3*1.", "lines from 1"),
    ):
        (tmp_path / "b.xyz").write_text(text.replace("1.00000000000000000D+00", word, 1))
        with pytest.raises(ValueError, match=message):
            io.read(tmp_path / "b.xyz")
    with pytest.raises(ValueError, match="only a mesh that was read from a PLOT3D file"):
        io.write(tmp_path / "d.xyz", jm.Mesh(np.zeros((3, 2)), {"triangle": [[0, 1, 2]]}))
