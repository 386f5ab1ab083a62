"""Every format into every other one: what cannot be written is told before any work, in Python and on the command line."""

import functools
import warnings
from contextlib import nullcontext

import cgns
import exodus
import foam
import h5py
import meshio
import mfem_meshes
import numpy as np
import pytest
import vtk_files
from formats import ENDINGS, OTHERS, SINGLE, rewritten, write, written
from meshes import bricks
from plot3d import write as write_plot3d
from runs import over, refused

import jaxmorph as jm
from jaxmorph import io
from jaxmorph.cli import main

APART = (
    ".vtu",
    ".vtk",
    ".xdmf",
)  # read in a process of its own


@over(
    "source",
    fast=[each for each in ENDINGS if each not in APART],
    slow=[each for each in ENDINGS if each in APART],
)
def test_every_pair_is_decided_before_any_work(tmp_path, capsys, source):
    mesh = io.read(written(tmp_path, source))
    moved = mesh.moved(np.asarray(mesh.points) + 1)
    for to in ENDINGS:
        decide(tmp_path, capsys, mesh, moved, source, to)
    assert {path.name for path in tmp_path.iterdir()} <= {
        f"in{source}",
        "in.h5",
        *(f"out{to}" for to in ENDINGS),
    }


@pytest.mark.parametrize("ending", ENDINGS)
def test_points_that_a_caller_changes_are_written_if_they_are_given_to_moved(tmp_path, ending):
    """A mesh and what it keeps of its file share no array that a caller can write into."""
    mesh = io.read(written(tmp_path, ending))
    with pytest.raises(ValueError, match="read-only"):
        mesh.points[0] += 0.125
    before = np.array(mesh.points)
    places = before + 0.125 * (np.arange(len(before)) == 0)[:, None]
    mesh = mesh.moved(places)
    places[1] = np.nan
    change = np.asarray(rewritten(tmp_path / f"out{ending}", mesh).points) - before
    assert np.count_nonzero(change.any(axis=1)) == 1
    np.testing.assert_allclose(change[0], 0.125)


SQUARE = meshio.Mesh(np.eye(4)[:, 1:] * [1, 1, 0], [("triangle", np.array([[0, 1, 2], [1, 3, 2]]))])


def of_two_columns(path):
    """An Exodus file with z alone in single precision."""
    exodus.solid(path, form="netcdf4")
    with h5py.File(path, "r+") as file:
        z = file["coordz"][()]
        del file["coordz"]
        file["coordz"] = z.astype(">f4")


HELD = {f"double{ending}": (ending, lambda path: write(path, bricks(2))) for ending in ENDINGS}
HELD |= {
    f"single{ending}": (ending, lambda path: write(path, bricks(2), is_single=True))
    for ending in SINGLE
}
HELD |= {
    f"gmsh 4.0 {k}": (
        ".msh",
        lambda path, k=k: meshio.gmsh.write(str(path), SQUARE, "4.0", binary=k > 0),
    )
    for k in (0, 1)
}
HALF = foam.FORMS["binary-32-scalars"]
HELD |= {
    "cgns zones": (".cgns", lambda path: cgns.two_blocks(path, "<f4")),
    "exodus z": (".e", of_two_columns),
    "exodus joined": (".e", lambda path: exodus.solid(path, real="f4", is_joined=True)),
    "openfoam plane": ("", lambda path: foam.write_case(path, *foam.strip(1), HALF)),
    "openfoam wedge": ("", lambda path: foam.write_case(path, *foam.pipe_of()[:3])),
    "openfoam single wedge": ("", lambda path: foam.write_case(path, *foam.pipe_of()[:3], HALF)),
}
HELD |= {
    f"mfem {name}": (".mesh", lambda path, name=name: path.write_text(getattr(mfem_meshes, name)))
    for name in ("SOLID", "FLAT", "TORN")
}


def by_vtk(path, kind, form, is_single):
    """A file of one kind of data set in one form, by VTK's own writer."""
    data = vtk_files.with_arrays(vtk_files.KINDS[kind]())
    data = vtk_files.in_single(data) if is_single else data
    if form[0] == "legacy":
        vtk_files.write_legacy(path, data, form[1], binary=form[2])
    else:
        vtk_files.write(path, data, *form)


VTK_FORMS = [("legacy", 42, False), ("legacy", 51, True), vtk_files.FORMS[0], vtk_files.FORMS[-1]]
ROWS = [("hexahedra", form) for form in VTK_FORMS]
ROWS += [(kind, VTK_FORMS[0]) for kind in vtk_files.KINDS if kind != "hexahedra"]
HELD |= {
    f"vtk {kind} {' '.join(map(str, form))} {'single' if is_single else 'double'}": (
        ".vtk" if form[0] == "legacy" else vtk_files.ENDINGS.get(kind, ".vtu"),
        functools.partial(by_vtk, kind=kind, form=form, is_single=is_single),
    )
    for kind, form in ROWS
    for is_single in (True, False)
}


@pytest.mark.parametrize("name", HELD)
def test_points_as_written_are_the_points_of_the_written_file(tmp_path, name):
    """Bit for bit, in every format and precision: what is judged is what a solver reads. Unmoved, the file is given back."""
    ending, make = HELD[name]
    make(tmp_path / f"in{ending}")
    mesh = io.read(tmp_path / f"in{ending}")
    if ending not in (".vtu", ".vtk", ".vts", ".vtp", ".pvtu", ".vtm", ".xdmf"):  # written anew
        io.write(tmp_path / f"same{ending}", mesh)
        same, old = tmp_path / f"same{ending}", tmp_path / f"in{ending}"
        assert (
            foam.tree(same) == foam.tree(old)
            if old.is_dir()
            else same.read_bytes() == old.read_bytes()
        )
    points = np.array(mesh.points)
    some = np.flatnonzero(np.abs(points[:, -1]) > 1e-3)[
        1:
    ]  # a wedge's axis stays, and one node more
    points[some] += 0.01 * np.sin(points[some] * 7 + 1)
    out, moved = tmp_path / f"out{ending}", mesh.moved(points)
    expected = io.as_written(out, moved)
    np.testing.assert_allclose(expected, points, atol=3e-7)
    np.testing.assert_array_equal(rewritten(out, moved).points, expected)
    np.testing.assert_array_equal(
        io.as_written(tmp_path / "other.su2", moved), points
    )  # all digits


@pytest.mark.parametrize("ending", ["", ".cgns", ".e", ".med", ".xyz"])
def test_rounding_that_takes_the_motion_or_small_cells_is_told(tmp_path, ending):
    """A motion is lost far from the origin, and cells are where their edges shrink to the rounding."""
    mesh = io.read(written(tmp_path, ending, is_single=True))
    base, out = np.asarray(mesh.points), tmp_path / f"out{ending}"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        io.write(out, mesh.moved(base + 0.125))
        io.as_written(tmp_path / "far.su2", mesh.moved(base + 1e-9))
    with pytest.warns(UserWarning, match="a tenth of the motion, which is 1.*another format"):
        np.testing.assert_allclose(io.as_written(out, mesh.moved(base + 1e-9)), base, atol=1e-7)
    squeezed = mesh.moved(1e-8 * base + 0.3)
    with pytest.warns(UserWarning, match=r"a tenth of \d+ edges of cells, the shortest"):
        io.as_written(out, squeezed)


@pytest.mark.filterwarnings("default:.*single precision")
@pytest.mark.parametrize("command", ["deform", "modes"])
def test_a_command_judges_the_rounded_mesh(tmp_path, capsys, command):
    """First cells of 2e-8, moved by 0.4 in single precision, have no height in the file."""
    heights = 2e-8 * 1.9 ** np.arange(25)
    block = np.stack(
        np.meshgrid(np.linspace(0, 1, 4), np.r_[0, heights[heights < 1]], indexing="ij")
    )
    write_plot3d(tmp_path / "layer.xyz", [block], "plain", width=4, is_multiple=False)
    np.savez(tmp_path / "up.npz", displacement=np.tile([0, 0.4], (4, 1)), nodes=np.arange(4))
    words = [
        command,
        str(tmp_path / "layer.xyz"),
        str(tmp_path / "out.xyz"),
        "--moving",
        "jmin",
        "--fixed",
        "jmax",
    ]
    motion = {
        "deform": ["--translate", "0", "0.4", "--no-dry-run"],
        "modes": ["--mode", str(tmp_path / "up.npz")],
    }
    words += motion[command]
    assert main([*words, "--free", "imin", "imax"]) == 1
    told = capsys.readouterr()
    assert "the file holds single precision. Rounding moves nodes by up to 1" in told.err
    assert not list(tmp_path.glob("out*"))
    assert main([*words, "--free", "imin", "imax", "--allow-inverted"]) == 1
    assert capsys.readouterr().err.count("single precision") == 1
    (written_file,) = tmp_path.glob("out*")
    y = np.frombuffer(written_file.read_bytes()[8:], "<f4").reshape(2, -1, 4)[1]
    assert (y[0] == y[1]).any()
    is_flat = y[1:] <= y[:-1]  # a cell has no height at one of its sides
    count = (is_flat[:, 1:] | is_flat[:, :-1]).sum()
    assert f"{count} of 75 cells are inverted" in told.err


@pytest.mark.parametrize("ending", ["", ".su2", ".msh", ".mesh", ".xyz"])
def test_nodes_that_stay_keep_their_digits_in_single_precision(tmp_path, ending):
    """With JAX's x64 mode off, points come back in float32: a node that stays has the text of its file."""
    path = written(tmp_path, ending)
    mesh = io.read(path)
    points = (np.asarray(mesh.points) + 1 / 3).astype(np.float64)
    mesh = rewritten(tmp_path / f"thirds{ending}", mesh.moved(points))
    io.write(tmp_path / f"out{ending}", mesh.moved(np.asarray(mesh.points).astype(np.float32)))
    np.testing.assert_array_equal(io.read(tmp_path / f"out{ending}").points, mesh.points)


@pytest.mark.parametrize("ending", [".msh", ".vtu", ".vtk", ".cgns"])
def test_other_cells_than_the_file_had_are_written(tmp_path, ending):
    """The pieces of curved cells, or some of the cells: the file is not given back in their place."""
    mesh = rewritten(tmp_path / f"in{ending}", jm.elevate(bricks(2), 2))
    fewer = {kind: corners[1:] for kind, corners in mesh.linear.cells.items()}
    for other in (mesh.linear, jm.Mesh(mesh.points, fewer, None, mesh.source)):
        back = rewritten(tmp_path / f"out{ending}", other).cells
        assert {kind: len(corners) for kind, corners in back.items()} == {
            k: len(c) for k, c in other.cells.items()
        }
    io.write(tmp_path / f"same{ending}", mesh)
    assert (tmp_path / f"same{ending}").read_bytes() == (tmp_path / f"in{ending}").read_bytes()


def decide(tmp_path, capsys, mesh, moved, source, to):
    out, patch = tmp_path / f"out{to}", next(iter(mesh.patches))
    words = [
        "deform",
        str(tmp_path / f"in{source}"),
        str(out),
        "--moving",
        patch,
        "--translate",
        "0",
        "0",
        "1e-3",
    ]
    refusal = ""
    try:
        io.check_output(out, mesh)
    except ValueError as error:
        refusal = str(error)
    early = pytest.raises(ValueError, match="only a mesh that") if refusal else nullcontext()
    with early:  # by the kinds of the two files
        assert io.check_output(out, tmp_path / f"in{source}") == io.check_output(out, mesh)
    if refusal:
        assert refusal.startswith(f"{out}: only a mesh that was read from")
        with pytest.raises(ValueError, match="only a mesh that was read from"):
            io.write(out, moved)
        assert main(words) == 2
        told = capsys.readouterr()
        assert "only a mesh that was read from" in told.err
        assert not told.out
    else:
        back = rewritten(out, moved)
        np.testing.assert_array_equal(back.points, moved.points)
        # of a CGNS file faces without a condition are a patch, too
        patches = {name: back.patches[name] for name in back.patches if name != "unnamed"}
        known = {name: mesh.patches[name] for name in mesh.patches if name != "unnamed"}
        for those, these in ((back.cells, mesh.cells), (patches, known)):
            lists = (
                {name: ids.tolist() for name, ids in each.items() if len(ids)}
                for each in (those, these)
            )
            assert next(lists) == next(lists)
    one_way = (".cas", ".h5", "", ".med", ".e", ".xyz", ".mesh", *OTHERS)
    assert bool(refusal) == (to in one_way and source != to)


MOVES = ("--moving", "floor", "--fixed", "roof")
UNWRITTEN = {
    "deform": (["deform", "in.su2", "out.e", *MOVES, "--translate", "0", "0", "1"], "an Exodus"),
    "modes": (["modes", "in.su2", "out.med", *MOVES, "--mode", "in.su2"], "a MED"),
    "convert": (["convert", "in.su2", "out.mesh"], "an MFEM"),
    "convert to files": (["convert", "in.su2", "out.vtm"], r"\.vtm files name other files"),
    "su2 def": (["su2", "def", "in.cfg"], "a PLOT3D"),
    "su2 def -o": (["su2", "def", "in.cfg", "-o", "out.med"], "a MED"),
    "parts": (
        ["deform", "case", "out.su2", *MOVES, "--translate", "0", "0", "1", "--decomposed"],
        "a decomposed case is written to a new folder",
    ),
}


@pytest.mark.parametrize("name", UNWRITTEN)
def test_a_kind_that_is_not_written_is_told_before_reading(tmp_path, capsys, monkeypatch, name):
    """By every command that writes a mesh; a file that would be read is damaged here."""
    words, told = UNWRITTEN[name]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "in.su2").write_text("NDIME= 3\nNELEM= 9\n")
    (tmp_path / "in.cfg").write_text("MESH_FILENAME= in.su2\nMESH_OUT_FILENAME= out.xyz\n")
    (tmp_path / "case" / "constant" / "polyMesh").mkdir(parents=True)
    refused(capsys, words, told)


@pytest.mark.parametrize(("ending", "what"), [(".e", "an Exodus"), (".med", "a MED")])
def test_a_format_of_copies_takes_its_own_whole_files(tmp_path, ending, what):
    path = tmp_path / f"a{ending}"
    with pytest.raises(ValueError, match=rf"only a mesh that was read from {what} file"):
        io.write(path, bricks(2))
    path.write_bytes(b"no file of this kind")
    with pytest.raises(ValueError, match=rf"a\{ending}: not {what} file"):
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
    for patches, message in (
        (
            {"inside": inner},
            rf"'inside': {len(inner)} of {len(inner)} nodes \(first {inner[0]}\) are on no boundary face",
        ),
        ({'"a\n': [0, 1, 2]}, "cannot be"),
        *([({"a=b": [0, 1, 2]}, "cannot be the tag")] if ending == ".su2" else []),
    ):
        loose = jm.Mesh(mesh.points, mesh.cells, patches)
        for call in (io.check_output, io.write):
            with pytest.raises(ValueError, match=message):
                call(tmp_path / f"a{ending}", loose)
    assert not list(tmp_path.iterdir())
