"""XDMF as FEniCS, dolfinx and PETSc write it: numbers of facets are patches, from the same file or a second one."""

import numpy as np
import pytest
from formats import assert_same, rewritten
from xdmf import (
    CELLS,
    NAMES,
    POINTS,
    Writer,
    in_mixed_cells,
    in_own_grid,
    in_renumbered_file,
    in_second_file,
)

import jaxmorph as jm
from jaxmorph import io
from jaxmorph.cli import main


@pytest.mark.parametrize("make", [in_own_grid, in_mixed_cells, in_second_file, in_renumbered_file])
@pytest.mark.parametrize("form", ["XML", "HDF"])
@pytest.mark.parametrize("real", ["f4", "f8"])
def test_numbers_of_facets_are_patches(tmp_path, form, real, make):
    """The nodes of each number, whatever holds it; written back, all is there and points are those written."""
    path, tags = make(Writer(tmp_path, form, real))
    mesh = io.read(path, tags=tags)
    assert {name.replace("patch_", "tags_") for name in mesh.patches} == {*NAMES}
    for name, nodes in NAMES.items():
        old = name if name in mesh.patches else name.replace("tags_", "patch_")
        np.testing.assert_array_equal(mesh.patches[old], nodes)
    np.testing.assert_array_equal(np.asarray(mesh.points).astype(real), POINTS.astype(real))
    np.testing.assert_array_equal(
        np.sort(mesh.cells["hexahedron"], axis=None), np.sort(CELLS, axis=None)
    )
    moved = io.read(path).moved(np.asarray(mesh.points) + 1 / 3)
    again = rewritten(tmp_path / "c.xdmf", moved)
    np.testing.assert_array_equal(again.points, io.as_written(tmp_path / "c.xdmf", moved))
    assert_same(again, moved)
    if (form, real) == ("XML", "f8"):
        io.write(tmp_path / "same.xdmf", io.read(path))
        assert (tmp_path / "same.xdmf").read_bytes() == path.read_bytes()


@pytest.mark.filterwarnings("default:.*boundary faces")
def test_tags_of_a_second_file_on_the_command_line(tmp_path, capsys):
    path, tags = in_renumbered_file(Writer(tmp_path, "HDF"))
    assert main(["info", str(path)]) == 0
    assert "--tags FILE reads it" in " ".join(capsys.readouterr().out.split())
    words = [
        "--moving",
        "tags_7",
        "--free",
        "tags_3",
        "--translate",
        "0",
        "0",
        "0.01",
        "--no-dry-run",
    ]
    files = [str(path), str(tmp_path / "out.vtu"), "--tags", str(tags)]
    assert main(["deform", *files, *words]) in (0, 1)
    assert main(["info", str(path), "--tags", str(tags), "--json"]) == 0
    assert '"tags_7": 9' in capsys.readouterr().out


def whole(body):
    return f"<Xdmf><Domain>{body}</Domain></Xdmf>"


REFUSED = {
    "no XML": (lambda mesh: "HDF", "not an XDMF file, or a damaged one"),
    "no grid": (lambda mesh: whole(""), "with a Grid in its Domain"),
    "in space": (
        lambda mesh: whole(f'<Grid GridType="Collection">{mesh}{mesh}</Grid>'),
        "2 grids in space",
    ),
    "lattice": (
        lambda mesh: whole(mesh.replace('"XYZ"', '"ORIGIN_DXDYDZ"')),
        "of the type ORIGIN_DXDYDZ",
    ),
    "slab": (
        lambda mesh: whole(mesh.replace("<DataItem", '<DataItem ItemType="HyperSlab"')),
        "of the type HyperSlab",
    ),
    "short": (
        lambda mesh: whole(mesh.replace('Dimensions="27 3"', 'Dimensions="28 3"')),
        "81 numbers",
    ),
    "missing": (
        lambda mesh: whole(mesh.replace('Format="XML">', 'Format="HDF">b.h5:/')),
        "not beside it",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_read_is_said(tmp_path, name):
    make, message = REFUSED[name]
    (tmp_path / "a.xdmf").write_text(make(Writer(tmp_path, "XML").mesh()))
    with pytest.raises(ValueError, match=rf"a\.xdmf: .*{message}"):
        io.read(tmp_path / "a.xdmf")


def test_a_time_series_is_read_at_its_first_step(tmp_path):
    writer = Writer(tmp_path, "XML")
    step = writer.mesh()
    body = f'<Grid GridType="Collection" CollectionType="Temporal">{step}{step}</Grid>'
    (tmp_path / "a.xdmf").write_text(whole(body))
    mesh = io.read(tmp_path / "a.xdmf")
    assert "2 steps, of which the first is read" in " ".join(mesh.source.notes)
    with pytest.raises(ValueError, match="a time series of 2 steps is not written"):
        io.write(tmp_path / "b.xdmf", mesh)


def test_tags_that_belong_to_no_mesh_are_refused(tmp_path):
    """Of another mesh, of two nodes at one place, in a file without any, and beside another format."""
    path, tags = in_second_file(Writer(tmp_path, "XML"))
    with pytest.raises(ValueError, match=r"a\.xdmf: no grid of facets"):
        io.read(path, tags=path)
    tags.write_text(tags.read_text().replace("0.3333333333333333", "0.25"))
    with pytest.raises(ValueError, match=r"b\.xdmf: \d+ corners of 48 facets are not each at one"):
        io.read(path, tags=tags)
    io.write(tmp_path / "a.su2", jm.Mesh(POINTS, {"hexahedron": CELLS}))
    with pytest.raises(ValueError, match="`tags` are for XDMF"):
        io.read(tmp_path / "a.su2", tags=tags)
