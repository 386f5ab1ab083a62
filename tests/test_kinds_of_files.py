"""Kinds of files: the table of the pages is made of files that are written here; packed files, plugins, kinds that are not read."""

import gzip
import importlib.metadata
import pathlib
import re
import types

import fluent
import meshio
import numpy as np
import pytest
from exodus import CELLS
from foam import mixed
from formats import ENDINGS, OTHERS, assert_same, rewritten, written
from meshes import bricks, gmsh_session
from plot3d import box
from plot3d import write as write_plot3d
from runs import over

import jaxmorph as jm
from jaxmorph import io
from jaxmorph.cli import main
from jaxmorph.io import _registry
from jaxmorph.io.kinds import FORMATS, UNREAD, Format

PAGE = pathlib.Path(__file__).parents[1] / "docs" / "pages" / "files.md"
MESHES = {form.name: form.suffixes for form in FORMATS}
FILES = {"OpenFOAM": "", "Medit": ".meshb"} | {
    name: endings[0] for name, endings in MESHES.items() if endings
}
FILES["Medit"] = ".meshb"
PATCHES = {
    "SU2": "markers",
    "VTK": "`patch:NAME`, or numbers",
    "gmsh": "physical groups",
    "Fluent": "zones of faces, with kinds",
    "Fluent HDF5": "zones of faces, with kinds",
    "CGNS": "families or conditions, with kinds",
    "MFEM": "attributes, named sets",
    "MED": "groups of elements and of nodes",
    "Exodus": "side sets, node sets, blocks of shells",
    "PLOT3D": "sides, or `.patches`",
    "Medit": "references",
    "Abaqus": "sets of elements and of nodes, surfaces",
    "I-deas": "groups, or properties",
    "XDMF": "numbers of facets",
    "AFLR": "numbers of surfaces",
    "OpenFOAM": "patches, with kinds",
}
"""What becomes patches; all else of the table is found out."""


def row(folder: pathlib.Path, name: str) -> str:
    path = written(folder, FILES[name])
    if name == "VTK":  # another program's
        meshio.write(path, io.read(path).to_meshio())
    mesh, out = io.read(path), folder / f"out{FILES[name]}"
    assert len(mesh.patches) >= 1
    try:
        io.write(out, mesh)
        same = "folder" if out.is_dir() else out.read_bytes() == path.read_bytes()
        back = {"folder": "byte for byte", True: "byte for byte", False: "anew, all kept"}[same]
    except ValueError:
        back = "is not written"
    try:
        io.check_output(folder / f"new{FILES[name]}", bricks(1))
        new = "yes"
    except ValueError:
        new = "no"
    endings = f"`{' '.join(MESHES[name])}`" if MESHES[name] else "a folder"
    return f"| {name} | {endings} | {PATCHES[name]} | {back} | {new} |"


def test_the_table_of_kinds_is_what_files_are(tmp_path):
    for name in FILES:
        (tmp_path / name).mkdir()
    head = ["| kind | endings | patches | comes back | from any mesh |", "|---|---|---|---|---|"]
    table = "\n".join(
        [*head, *(row(tmp_path / name, name) for name in sorted(FILES, key=list(MESHES).index))]
    )
    assert table in PAGE.read_text(), f"the table of {PAGE.name} is\n{table}"


def by_another_reader(path: pathlib.Path) -> np.ndarray:
    if path.suffix != ".unv":
        return meshio.read(path).points
    with gmsh_session() as gmsh:
        gmsh.open(str(path))
        tags, places, _ = gmsh.model.mesh.getNodes()
    labels = re.findall(r"^ *(\d+) .*\n.*\dD", path.read_text(), re.MULTILINE)
    row = {tag: k for k, tag in enumerate(tags.tolist())}
    return places.reshape(-1, 3)[[row[int(label)] for label in labels]]


@pytest.mark.parametrize("ending", OTHERS)
def test_another_reader_finds_the_moved_points(tmp_path, ending, capsys):
    """And all that the file says beside them: text around coordinates is the same."""
    path = written(tmp_path, ending)
    mesh = io.read(path)
    moved = mesh.moved(np.asarray(mesh.points) * 1.25 + 0.123456789)
    again = rewritten(tmp_path / f"out{ending}", moved)
    assert_same(again, moved)
    found = by_another_reader(tmp_path / f"out{ending}")
    assert (
        found.dtype == np.float64 or ending == ".ugrid"
    )  # meshio reads its text in single precision
    np.testing.assert_array_equal(found, np.asarray(moved.points).astype(found.dtype))
    if ending not in (".meshb", ".xdmf"):
        before, after = (each.read_bytes().split() for each in (path, tmp_path / f"out{ending}"))
        assert len(before) == len(after)
        assert sum(a != b for a, b in zip(before, after, strict=True)) <= mesh.points.size


SHAPES = {
    "solids": jm.Mesh(mixed()[0], CELLS, {"low side": [0, 1, 2, 3]}),
    "flat": jm.Mesh(
        [[0, 0.1], [1, 0], [1, 1], [0, 1], [2, 0.3]],
        {"quad": [[0, 1, 2, 3]], "triangle": [[1, 4, 2]]},
        {"low side": [0, 1]},
    ),
    "curved": jm.elevate(
        jm.Mesh(mixed()[0], {"tetra": CELLS["tetra"], "wedge": CELLS["wedge"]}), 2
    ),
}
LINEAR = (".su2", ".cas", ".h5", ".mesh", ".xdmf")  # as meshio writes them


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(
    "ending", [".su2", ".vtu", ".vtk", ".msh", ".cas", ".h5", ".mesh", ".inp", ".xdmf"]
)
def test_every_shape_of_cells_comes_back(tmp_path, ending, shape):
    """Cells of all types, in 2-D and 3-D, of order 1 and 2: the same nodes, none folded, and moved points to the last bit."""
    mesh, path = SHAPES[shape], tmp_path / f"a{ending}"
    cells = {kind: np.asarray(ids) for kind, ids in mesh.cells.items()}
    if ending in LINEAR and shape == "curved":
        pytest.skip("the kind has linear cells alone")
    if ending in (".cas", ".h5"):
        fluent.write(
            path,
            np.asarray(mesh.points),
            cells,
            {"low": [0, 1]},
            "h5" if ending == ".h5" else "text",
        )
    elif ending in (".mesh", ".inp", ".xdmf"):
        try:
            meshio.write(path, jm.Mesh(mesh.points, cells).to_meshio())
        except (KeyError, meshio.WriteError) as error:
            pytest.skip(f"meshio does not write it: {error}")
    else:
        io.write(path, mesh)
    read = io.read(path)
    if mesh.patches and ending in (".su2", ".vtu", ".vtk", ".msh"):
        assert_same(read, mesh)
    for kind, ids in cells.items():
        assert sorted(map(sorted, read.cells[kind].tolist())) == sorted(map(sorted, ids.tolist()))
    np.testing.assert_array_equal(read.points, mesh.points)
    assert not np.asarray(jm.quality(read).is_inverted).any()
    moved = read.moved(np.asarray(read.points) / 3 + 0.123456789)
    assert_same(rewritten(tmp_path / f"b{ending}", moved), moved)


def test_numbers_in_columns_stay_in_them(tmp_path):
    """I-deas's numbers are read by column: 25 wide."""
    mesh = io.read(written(tmp_path, ".unv"))
    io.write(tmp_path / "out.unv", mesh.moved(np.asarray(mesh.points) / 3 - 1e-105))
    for name in ("in", "out"):
        lines = (tmp_path / f"{name}.unv").read_text().splitlines()
        assert {len(line) for line in lines if "D" in line} == {75}
    np.testing.assert_array_equal(
        io.read(tmp_path / "out.unv").points, np.asarray(mesh.points) / 3 - 1e-105
    )


COPIED = (".h5", ".cgns", ".med", ".e")


@over(
    "ending",
    [".su2", ".vtu"],
    nightly=[ending for ending in ENDINGS if ending not in ("", ".su2", ".vtu")],
)
def test_a_packed_file_is_what_is_in_it(tmp_path, ending):
    path = written(tmp_path, ending)
    packed = tmp_path / f"in{ending}.gz"
    packed.write_bytes(gzip.compress(path.read_bytes()))
    if ending in (*COPIED, ".xdmf"):
        with pytest.raises(ValueError, match=rf"in\{ending}\.gz: "):
            io.read(packed)
        return
    mesh, plain = io.read(packed), io.read(path)
    assert_same(mesh, plain)
    out = tmp_path / f"out{ending}"
    io.write(out, plain)
    io.write(f"{out}.gz", mesh)
    assert gzip.decompress(pathlib.Path(f"{out}.gz").read_bytes()) == out.read_bytes()
    moved = mesh.moved(np.asarray(mesh.points) + 0.125)
    assert_same(rewritten(pathlib.Path(f"{out}.gz"), moved), moved)
    for damaged in (
        packed.read_bytes()[:-9],
        b"no such file",
        gzip.compress(b"\0" * 300_000_000, 9),
    ):
        packed.write_bytes(damaged)
        with pytest.raises(ValueError, match=rf"in\{ending}\.gz: "):
            io.read(packed)


HOSTILE = {
    "a.mesh": "MeshVersionFormatted 2\nDimension 3\nVertices\n9999999999\n0 0 0 1\n",
    "a.cas": "(2 3)(10 (0 1 ffffffff 0 3))(10 (1 1 ffffffff 1 3)(0 0 0))(13 (1 1 2 3 3)(1 2 3 1 0))",
    "a.unv": "    -1\n  2411\n         1         1         1        11\n   0.0D+00   0.0D+00   1.0D+00\n",
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_file_that_asks_for_gigabytes_is_refused(tmp_path, name):
    """By its name, in a process that may not take them."""
    (tmp_path / name).write_text(HOSTILE[name])
    with pytest.raises(ValueError, match=rf"{name}[:,]"):
        io.read(tmp_path / name)


@pytest.mark.parametrize("ending", UNREAD)
def test_a_known_kind_is_told_by_its_name(tmp_path, ending, capsys):
    with pytest.raises(ValueError, match=f"by its ending this is {UNREAD[ending][:9]}"):
        io.read(tmp_path / f"a{ending}")
    assert main(["info", str(tmp_path / f"a{ending}")]) == 2
    assert UNREAD[ending] in capsys.readouterr().err.replace("\n", " ")


@pytest.mark.parametrize("ending", MESHES["PLOT3D"])
def test_every_ending_of_plot3d(tmp_path, ending):
    forms = {".p3dfmt": "text", ".fmt": "text", ".p2dfmt": "text", ".ufmt": "records"}
    write_plot3d(tmp_path / f"a{ending}", box(3, 2, 4), forms.get(ending, "plain"), "<")
    mesh = io.read(tmp_path / f"a{ending}")
    io.write(tmp_path / f"b{ending}", mesh)
    assert (tmp_path / f"b{ending}").read_bytes() == (tmp_path / f"a{ending}").read_bytes()


def recognised(path: pathlib.Path) -> bool:
    """Whether one format alone has files that begin so."""
    first = path.read_bytes()[:4096].lstrip() if path.is_file() else b""
    return sum(each.recognises(first) for each in _registry.FORMATS) == 1


@pytest.mark.parametrize("ending", [ending for ending in ENDINGS if ending != ".xdmf"])
def test_a_file_is_known_by_its_first_bytes(tmp_path, ending, monkeypatch):
    """Under another's ending and under an unknown one, whatever the order of the formats; others are told."""
    path = written(tmp_path, ending)
    known = _registry.format_of(path).name
    assert _registry.format_to_write(tmp_path / f"new{ending}", None).name == known
    last = Format("Last", "_last", begins=b"last ")
    monkeypatch.setattr(_registry, "FORMATS", (*_registry.FORMATS[::-1], last))
    assert _registry.format_of(path).name == known
    assert _registry.format_to_write(tmp_path / f"new{ending}", None).name == known
    if not recognised(path):
        return
    for other in (".dat", ".msh", ".mesh", ".su2"):
        renamed = path.rename(tmp_path / f"a{other}")
        path = renamed
        mesh = io.read(renamed)
        assert mesh.source.format == known
        assert_same(rewritten(tmp_path / f"b{other}", mesh), mesh) if other != ".dat" else None


FOREIGN = {
    "UCD": "# a comment\n9 4 0 0 0\n1 0 0 0\n",
    "FreeFem": "4 2 4\n0 0 1\n1 0 1\n",
    "GiD": 'MESH "a" dimension 3 ElemType Tetrahedra Nnode 4\nCoordinates\n',
}


@pytest.mark.parametrize("name", FOREIGN)
@pytest.mark.parametrize("ending", [".msh", ".inp", ".mesh", ".dat"])
def test_a_kind_that_is_not_read_is_told_by_its_first_bytes(tmp_path, name, ending):
    (tmp_path / f"a{ending}").write_text(FOREIGN[name])
    with pytest.raises(ValueError, match=f"by its first bytes this is a .*{name}"):
        io.read(tmp_path / f"a{ending}")


def test_an_ending_alone_tells_kinds_in_hdf5_apart(tmp_path):
    path = written(tmp_path, ".med").rename(tmp_path / "a.dat")
    with pytest.raises(ValueError, match=r"may be .*MED \(\.med\).*: give it that ending"):
        io.read(path)


def test_another_package_brings_a_format(tmp_path, monkeypatch):
    """An entry point of the group `jaxmorph.formats`, called as its ending, is an object that reads and writes."""

    def read(path):
        rows = np.loadtxt(path)
        return jm.Mesh(rows, {"triangle": [[0, 1, 2]]}, {"wall": [0, 1]}, source=path.name)

    plugin = types.SimpleNamespace(
        read=read, write=lambda path, mesh: np.savetxt(path, np.asarray(mesh.points))
    )
    point = types.SimpleNamespace(name="rows", load=lambda: plugin)
    monkeypatch.setattr(
        importlib.metadata, "entry_points", lambda group: [point] * (group == "jaxmorph.formats")
    )
    np.savetxt(tmp_path / "a.rows", [[0.0, 0], [1, 0], [0, 1]])
    mesh = io.read(tmp_path / "a.rows")
    moved = mesh.moved(np.asarray(mesh.points) + 1)
    assert_same(rewritten(tmp_path / "b.rows", moved), moved)
    del plugin.write
    with pytest.raises(
        ValueError, match=r"c\.rows: files of the format rows are read, and not written"
    ):
        io.write(tmp_path / "c.rows", mesh)


def test_convert_tells_what_is_lost(tmp_path, capsys):
    path = written(tmp_path, ".cas")
    assert main(["convert", str(path), str(tmp_path / "a.vtu")]) == 0
    assert "kinds of patches are lost: wall, pressure-far-field" in capsys.readouterr().err
    assert_same(io.read(tmp_path / "a.vtu"), io.read(path))
    io.write(tmp_path / "heat.vtu", io.read(path), cell_data={"heat": np.zeros(8)})
    assert main(["convert", str(tmp_path / "heat.vtu"), str(tmp_path / "heat.su2")]) == 0
    assert "arrays are lost: heat." in capsys.readouterr().err
    assert main(["convert", str(tmp_path / "a.vtu"), str(tmp_path / "b.cas")]) == 2
    assert "only a mesh that was read from a Fluent file" in capsys.readouterr().err
    assert not (tmp_path / "b.cas").exists()
    assert main(["convert", str(path), str(tmp_path / "b.cas")]) == 0
    assert "lost" not in capsys.readouterr().err
    assert (tmp_path / "b.cas").read_bytes() == path.read_bytes()
