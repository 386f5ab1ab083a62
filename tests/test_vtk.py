"""VTK's files: VTK itself reads what is written, and what VTK, gmsh and meshio write is read and kept."""

import itertools
import pathlib
import pickle
import struct
import subprocess
import sys
import zlib

import numpy as np
import pytest
import vtk_files
from formats import rewritten
from meshes import bricks, gmsh_session
from runs import over

import jaxmorph as jm
from jaxmorph import io

pyvista = pytest.importorskip("pyvista")


def mixed() -> jm.Mesh:
    """A mesh of every solid type, with patches whose names are awkward."""
    points = np.array([[x, y, z] for z in (0.0, 1.0) for y in (0.0, 1.0) for x in (0.0, 1.0, 2.0)])
    points = np.concatenate([points, [[0.5, 0.5, 2.0], [0.0, 2.0, 0.0]]])
    cells = {
        "hexahedron": [[0, 1, 4, 3, 6, 7, 10, 9]],
        "wedge": [[1, 2, 4, 7, 8, 10], [2, 5, 4, 8, 11, 10]],
        "pyramid": [[6, 7, 10, 9, 12]],
        "tetra": [[3, 4, 13, 9]],
    }
    return jm.Mesh(points, cells, {"far field": [0, 1], "50%20 \u00e4": [2, 3, 4]})


@pytest.mark.parametrize("dtype", [*vtk_files.TYPES, "?"])
@pytest.mark.parametrize("ending", ["vtk", "vtu"])
def test_vtk_reads_all_arrays_that_are_written(tmp_path, ending, dtype):
    mesh = mixed()
    n, cells = len(mesh.points), 5
    at_points, at_cells = (
        (np.arange(n) % 2).astype(dtype),
        (np.arange(3 * cells) % 2).astype(dtype).reshape(-1, 3),
    )
    io.write(
        tmp_path / f"a.{ending}", mesh, point_data={"a b": at_points}, cell_data={"c": at_cells}
    )
    found = pyvista.read(tmp_path / f"a.{ending}")
    np.testing.assert_array_equal(found.points, mesh.points)
    flags = {
        name: np.flatnonzero(found.point_data[name]).tolist()
        for name in found.point_data
        if "patch:" in name
    }
    assert flags == {"patch:far%20field": [0, 1], "patch:50%2520%20%C3%A4": [2, 3, 4]}
    np.testing.assert_array_equal(found.point_data["a b"], at_points)
    np.testing.assert_array_equal(found.cell_data["c"], at_cells)
    again = io.read(tmp_path / f"a.{ending}")
    assert again.patches.keys() == mesh.patches.keys()
    assert all(np.array_equal(nodes, mesh.patches[name]) for name, nodes in again.patches.items())


@pytest.mark.parametrize("large", [2**31, -(2**31) - 1])
def test_numbers_beyond_four_bytes_keep_their_value(tmp_path, large):
    mesh = bricks(1)
    io.write(tmp_path / "a.vtk", mesh, cell_data={"c": np.array([large])})
    assert pyvista.read(tmp_path / "a.vtk").cell_data["c"].tolist() == [large]


@pytest.mark.parametrize("binary", [0, 1])
@pytest.mark.parametrize("dimension", [2, 3])
def test_what_gmsh_writes_is_read(tmp_path, dimension, binary):
    with gmsh_session() as gmsh:
        make = gmsh.model.occ.addRectangle if dimension == 2 else gmsh.model.occ.addBox
        make(0, 0, 0, *(1,) * dimension)
        gmsh.model.occ.synchronize()
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.7)
        gmsh.model.mesh.generate(dimension)
        gmsh.option.setNumber("Mesh.Binary", binary)
        gmsh.option.setNumber("Mesh.SaveAll", 1)
        gmsh.write(str(tmp_path / "a.vtk"))
        count = len(gmsh.model.mesh.getElements(dimension)[1][0])
    read, grid = io.read(tmp_path / "a.vtk"), pyvista.read(tmp_path / "a.vtk")
    np.testing.assert_array_equal(read.points, grid.points[:, :dimension])
    (corners,) = read.cells.values()
    assert len(corners) == count
    np.testing.assert_array_equal(corners, grid.cells_dict[5 if dimension == 2 else 10])


@over("binary", [True], nightly=[False])
def test_no_damage_of_sizes_is_taken(tmp_path, binary):
    """A number more or less in any section is told."""
    mixed().to_pyvista().save(tmp_path / "a.vtk", binary=binary)
    data = (tmp_path / "a.vtk").read_bytes()
    for word in (b"POINTS ", b"CELLS ", b"CELL_TYPES ", b"POINT_DATA "):
        at = data.index(b"\n" + word) + 1 + len(word)
        end = min(data.index(sign, at) for sign in (b" ", b"\n") if sign in data[at : at + 9])
        for step in (-1, 1):
            count = b"%d" % (int(data[at:end]) + step)
            (tmp_path / "b.vtk").write_bytes(data[:at] + count + data[end:])
            with pytest.raises(ValueError, match=r"b\.vtk: (a damaged file|no mesh)"):
                io.read(tmp_path / "b.vtk")


FORMS = [("xml", *form) for form in vtk_files.FORMS] + [
    ("legacy", version, binary) for version, binary in itertools.product((42, 51), (False, True))
]


def foreign(folder: pathlib.Path, kind: str, form: tuple, name: str = "a") -> pathlib.Path:
    """A file of a kind of data set in one form, by VTK's writer."""
    data = vtk_files.with_arrays(vtk_files.KINDS[kind]())
    if form[0] == "legacy":
        vtk_files.write_legacy(folder / f"{name}.vtk", data, form[1], binary=form[2])
        return folder / f"{name}.vtk"
    path = folder / f"{name}{vtk_files.ENDINGS.get(kind, '.vtu')}"
    vtk_files.write(path, data, *form[1:])
    return path


@pytest.mark.parametrize("form", FORMS[:19:3] + FORMS[19:], ids=str)
@pytest.mark.parametrize("kind", vtk_files.KINDS)
def test_all_that_a_file_says_is_kept(tmp_path, kind, form):
    """VTK finds the same arrays, field data and cells in both files, and points to the last bit where they were moved to."""
    path = foreign(tmp_path, kind, form)
    mesh, d = io.read(path), 2 if kind in ("pixels", "surface") else 3
    assert mesh.points.shape[1] == d
    assert (
        mesh.patch("floor").tolist()
        == np.flatnonzero(vtk_files.places(vtk_files.read(path))[:, 1] == 0).tolist()
    )
    moved = mesh.moved(mesh.points * 1.1 + 0.123456789)
    out = path.with_stem("b")
    io.write(out, moved)
    before, after = vtk_files.read(path), vtk_files.read(out)
    assert vtk_files.said(before) == vtk_files.said(after)
    expected = vtk_files.places(before).copy()
    expected[:, :d] = expected[:, :d] * 1.1 + 0.123456789
    np.testing.assert_array_equal(vtk_files.places(after), expected)


@pytest.mark.parametrize("form", FORMS[:9] + FORMS[-4:], ids=str)
def test_the_form_of_a_file_is_kept(tmp_path, form):
    """Text, binary, appended, raw, compressed, the type of headers: an unmoved mesh written is the same file, but for its notes."""
    path = foreign(tmp_path, "hexahedra", form)
    io.write(path.with_stem("b"), io.read(path))
    first, second = path.read_bytes(), path.with_stem("b").read_bytes()
    assert first.split(b"<FieldData>")[0][:120] == second.split(b"<FieldData>")[0][:120]
    for mark in (
        b'format="appended"',
        b'format="binary"',
        b'format="ascii"',
        b'encoding="raw"',
        b"BINARY",
        b"ASCII",
    ):
        assert (mark in first) == (mark in second)


def test_polyhedra_are_those_of_openfoam(tmp_path):
    """A cube whose top is two triangles is cut, a cube given by its faces is a hexahedron; each volume is VTK's."""
    path = foreign(tmp_path, "polyhedra", FORMS[0])
    mesh = io.read(path)
    assert mesh.polyhedra is not None
    assert mesh.polyhedra.cut.tolist() == [0]
    assert len(mesh.cells["hexahedron"]) == 2
    volumes = np.bincount(mesh.cell_ids, np.asarray(jm.quality(mesh).volume))
    sizes = pyvista.wrap(vtk_files.read(path)).compute_cell_sizes().cell_data["Volume"]
    np.testing.assert_allclose(volumes, sizes[:3], rtol=1e-12)
    ids = mesh.cell_ids.astype(float)
    io.write(tmp_path / "b.vtu", mesh, cell_data={"number": ids})
    found = pyvista.read(tmp_path / "b.vtu").cell_data["number"]
    np.testing.assert_array_equal(found, [0, 1, 2, np.nan, np.nan])


def test_pieces_and_blocks_are_one_mesh(tmp_path):
    """Pieces of one file, of a .pvtu and of a .vtm give all cells; blocks of a boundary are patches."""
    from vtkmodules.vtkCommonDataModel import vtkMultiBlockDataSet
    from vtkmodules.vtkIOXML import vtkXMLMultiBlockDataWriter

    cells = [(12, vtk_files.cube(x)) for x in range(3)]
    for k, cell in enumerate(cells):
        vtk_files.write(tmp_path / f"p{k}.vtu", vtk_files.unstructured(vtk_files.BOX, [cell]))
    names = "".join(f'<Piece Source="p{k}.vtu"/>' for k in range(3))
    points = '<PPoints><PDataArray type="Float64" NumberOfComponents="3"/></PPoints>'
    text = f'<VTKFile type="PUnstructuredGrid"><PUnstructuredGrid>{points}{names}</PUnstructuredGrid></VTKFile>'
    (tmp_path / "a.pvtu").write_text(text)
    assert len(io.read(tmp_path / "a.pvtu").cells["hexahedron"]) == 3
    blocks = vtkMultiBlockDataSet()
    blocks.SetBlock(0, vtk_files.unstructured(vtk_files.BOX, cells))
    low = [(9, [0, 1, 5, 4]), (9, [1, 2, 6, 5]), (9, [2, 3, 7, 6])]
    blocks.SetBlock(1, vtk_files.unstructured(vtk_files.BOX[:8], low))
    for k, name in enumerate(("inside", "low wall")):
        blocks.GetMetaData(k).Set(vtkMultiBlockDataSet.NAME(), name)
    writer = vtkXMLMultiBlockDataWriter()
    writer.SetInputData(blocks)
    writer.SetFileName(str(tmp_path / "b.vtm"))
    writer.Write()
    mesh = io.read(tmp_path / "b.vtm")
    assert len(mesh.cells["hexahedron"]) == 3
    assert {name: nodes.tolist() for name, nodes in mesh.patches.items()} == {
        "low wall": [*range(8)]
    }
    assert rewritten(tmp_path / "c.vtu", mesh.moved(mesh.points + 1)).patch(
        "low wall"
    ).tolist() == [*range(8)]
    with pytest.raises(
        ValueError, match=r"c\.vtm: \.vtm files name other files, and are not written; write \.vtu"
    ):
        io.write(tmp_path / "c.vtm", mesh)


def test_a_mesh_is_kept_by_pickle(tmp_path):
    mesh = io.read(foreign(tmp_path, "polyhedra", FORMS[0]))
    again = pickle.loads(pickle.dumps(mesh))
    for name, each in (("b", mesh), ("c", again)):
        io.write(tmp_path / f"{name}.vtu", each)
    found = [vtk_files.read(tmp_path / f"{name}.vtu") for name in "bc"]
    assert vtk_files.said(found[0]) == vtk_files.said(found[1])


@pytest.mark.nightly
def test_only_what_a_file_needs_is_imported():
    code = "import sys, jaxmorph.cli, jaxmorph.io; print(sorted(name for name in sys.modules if 'vtk' in name.split('.')[0]))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def packed(values: np.ndarray) -> str:
    """Numbers in base64 as VTK packs them: a header of one block, and the block."""
    import base64

    data = zlib.compress(values.tobytes(), 9)
    head = struct.pack("<4Q", 1, values.nbytes, 0, len(data))
    return base64.b64encode(head).decode() + base64.b64encode(data).decode()


def hostile(kind: str) -> bytes:
    """A small file whose numbers ask for gigabytes."""
    n, zeros = 10**8, packed(np.zeros(3 * 10**7))
    tag = '<DataArray type="{}" Name="{}" NumberOfComponents="{}" format="{}">{}</DataArray>'
    points = tag.format(
        "Float64",
        "Points",
        3,
        "binary",
        zeros if kind in ("bomb", "points") else packed(np.zeros(9)),
    )
    if kind == "offsets":
        lists = tag.format("Int64", "connectivity", 1, "ascii", "0 1 2") + tag.format(
            "UInt8", "types", 1, "ascii", "5"
        )
        lists += tag.format("Int64", "offsets", 1, "binary", packed(np.array([10**12])))
        return (
            hostile("cells")
            .replace(b'NumberOfCells="%d"' % n, b'NumberOfCells="1"')
            .partition(b"<Cells>")[0]
            + (f"<Cells>{lists}</Cells></Piece></UnstructuredGrid></VTKFile>").encode()
        )
    counts = {
        "bomb": (10**7, 0),
        "points": (n, 0),
        "cells": (3, n),
        "components": (3, 0),
        "field": (3, 0),
    }
    if kind in counts:
        count, cells = counts[kind]
        more = tag.format(
            "Float64", "a", n if kind == "components" else 1, "binary", packed(np.zeros(3))
        )
        field = tag.format("Float64", "f", 1, "ascii", "0").replace(
            "<DataArray", f'<DataArray NumberOfTuples="{n}"'
        )
        return (
            '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64" '
            f'compressor="vtkZLibDataCompressor"><UnstructuredGrid><FieldData>{field * (kind == "field")}</FieldData>'
            f'<Piece NumberOfPoints="{count}" NumberOfCells="{cells}"><PointData>{more * (kind == "components")}</PointData>'
            f"<Points>{points}</Points><Cells>{tag.format('Int64', 'offsets', 1, 'ascii', '0')}</Cells></Piece>"
            "</UnstructuredGrid></VTKFile>"
        ).encode()
    sections = {
        "legacy points": f"POINTS {n} double\n",
        "legacy cells": f"POINTS 1 double\n0 0 0\nCELLS {n} {4 * n}\n",
        "legacy field": f"FIELD f 1\na {n} 1 double\n",
        "legacy grid": f"DIMENSIONS {n} 9 9\n",
    }
    kind_of_grid = "STRUCTURED_POINTS" if kind == "legacy grid" else "UNSTRUCTURED_GRID"
    return (
        f"# vtk DataFile Version 4.2\nt\nASCII\nDATASET {kind_of_grid}\n{sections[kind]}".encode()
    )


KINDS_OF_HOSTILE = ("bomb", "points", "cells", "components", "field", "offsets")
KINDS_OF_HOSTILE += ("legacy points", "legacy cells", "legacy field", "legacy grid")


@pytest.mark.nightly
@pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="memory is limited as Linux does it"
)
def test_a_hostile_file_costs_no_memory(tmp_path):
    """Each is refused with its name, in a process that may take 300 MB more than its imports."""
    for kind in KINDS_OF_HOSTILE:
        (tmp_path / f"{kind}{'.vtk' if 'legacy' in kind else '.vtu'}").write_bytes(hostile(kind))
    code = f"""
import pathlib, resource
from jaxmorph import io
from vtkmodules import vtkIOXML, vtkIOLegacy, vtkFiltersCore
from vtkmodules.util import numpy_support
used = int(pathlib.Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + 3 * 10**8, -1))
for path in sorted(pathlib.Path({str(tmp_path)!r}).iterdir()):
    try:
        io.read(path)
    except ValueError as error:
        assert path.name in str(error)
        print(path.name, "refused")
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.count("refused") == len(KINDS_OF_HOSTILE), done.stdout
