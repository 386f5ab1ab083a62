"""Every format into every other one: what cannot be written is told before any work, in Python and on the command line."""

import exodus
import h5py
import numpy as np
import pytest
from formats import ENDINGS, written
from meshes import bricks

import jaxmorph as jm
from jaxmorph import io
from jaxmorph.cli import main


@pytest.mark.parametrize("source", ENDINGS)
def test_every_pair_is_decided_before_any_work(tmp_path, capsys, source):
    mesh = io.read(written(tmp_path, source))
    moved = mesh.moved(np.asarray(mesh.points) + 1)
    for to in ENDINGS:
        decide(tmp_path, capsys, mesh, moved, source, to)
    assert {path.name for path in tmp_path.iterdir()} <= {f"in{source}", *(f"out{to}" for to in ENDINGS)}


@pytest.mark.parametrize("ending", ENDINGS)
def test_points_that_a_caller_changes_in_place_are_written(tmp_path, ending):
    """As NumPy's users move nodes: what a mesh keeps of its file must not share their array."""
    mesh = io.read(written(tmp_path, ending))
    before = np.array(mesh.points)
    mesh.points[0] += 0.125
    io.write(tmp_path / f"out{ending}", mesh)
    change = np.asarray(io.read(tmp_path / f"out{ending}").points) - before
    assert np.count_nonzero(change.any(axis=1)) == 1
    np.testing.assert_allclose(change[0], 0.125)


@pytest.mark.parametrize("ending", ["", ".su2", ".msh", ".mesh", ".xyz"])
def test_nodes_that_stay_keep_their_digits_in_single_precision(tmp_path, ending):
    """With JAX's x64 mode off, points come back in float32: a node that stays has the text of its file."""
    path = written(tmp_path, ending)
    mesh = io.read(path)
    points = (np.asarray(mesh.points) + 1 / 3).astype(np.float64)
    io.write(tmp_path / f"thirds{ending}", mesh.moved(points))
    mesh = io.read(tmp_path / f"thirds{ending}")
    io.write(tmp_path / f"out{ending}", mesh.moved(np.asarray(mesh.points).astype(np.float32)))
    np.testing.assert_array_equal(io.read(tmp_path / f"out{ending}").points, mesh.points)


@pytest.mark.parametrize("ending", [".msh", ".vtu", ".vtk"])
def test_other_cells_than_the_file_had_are_written(tmp_path, ending):
    """The pieces of curved cells, or some of the cells: the file is not given back in their place."""
    io.write(tmp_path / f"in{ending}", jm.elevate(bricks(2), 2))
    mesh = io.read(tmp_path / f"in{ending}")
    fewer = {kind: corners[1:] for kind, corners in mesh.linear.cells.items()}
    for other in (mesh.linear, jm.Mesh(mesh.points, fewer, None, mesh.source)):
        io.write(tmp_path / f"out{ending}", other)
        back = io.read(tmp_path / f"out{ending}").cells
        assert {kind: len(corners) for kind, corners in back.items()} == {k: len(c) for k, c in other.cells.items()}
    io.write(tmp_path / f"same{ending}", mesh)
    assert (tmp_path / f"same{ending}").read_bytes() == (tmp_path / f"in{ending}").read_bytes()


def decide(tmp_path, capsys, mesh, moved, source, to):
    out, patch = tmp_path / f"out{to}", next(iter(mesh.patches))
    words = ["deform", str(tmp_path / f"in{source}"), str(out), "--moving", patch, "--translate", "0", "0", "1e-3"]
    refusal = ""
    try:
        io.check_output(out, mesh)
    except ValueError as error:
        refusal = str(error)
    if refusal:
        assert refusal.startswith(f"{out}: only a mesh that was read from")
        with pytest.raises(ValueError, match="only a mesh that was read from"):
            io.write(out, moved)
        assert main(words) == 2
        told = capsys.readouterr()
        assert "only a mesh that was read from" in told.err
        assert not told.out
    else:
        io.write(out, moved)
        np.testing.assert_array_equal(io.read(out).points, moved.points)
    one_way = (".cgns", "", ".med", ".e", ".xyz", ".mesh")
    assert bool(refusal) == (to in one_way and source != to)


@pytest.mark.parametrize(
    ("ending", "kind"), [(".e", "an Exodus file"), (".med", "a MED file"), (".cgns", "a CGNS file")]
)
def test_a_format_of_copies_takes_its_own_whole_files(tmp_path, ending, kind):
    path = tmp_path / f"a{ending}"
    with pytest.raises(ValueError, match=rf"only a mesh that was read from an? {kind.split()[1]} file"):
        io.write(path, bricks(2))
    path.write_bytes(b"no file of this kind")
    with pytest.raises(ValueError, match=rf"a\{ending}: not {kind}"):
        io.read(path)
    whole = written(tmp_path, ending)
    if ending == ".e":
        exodus.solid(whole, form="netcdf4")
    with h5py.File(whole, "r+") as file:
        file["other"] = h5py.ExternalLink("b.h5", "/points")
    with pytest.raises(ValueError, match=r"is a link to b\.h5"):
        io.read(whole)


@pytest.mark.parametrize("ending", [".su2", ".msh"])
def test_a_patch_that_faces_cannot_express_is_told_before_any_work(tmp_path, ending):
    mesh = bricks(2)
    inner = np.flatnonzero((np.asarray(mesh.points) == 0.5).all(axis=1))
    for patches, message in (({"inside": inner}, "on no boundary face"), ({'"a\n': [0, 1, 2]}, "cannot be")):
        loose = jm.Mesh(mesh.points, mesh.cells, patches)
        for refused in (io.check_output, io.write):
            with pytest.raises(ValueError, match=message):
                refused(tmp_path / f"a{ending}", loose)
    assert not list(tmp_path.iterdir())
