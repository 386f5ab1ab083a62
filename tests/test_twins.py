"""Twins of the files that people have: each is read, moved, written, and read by another reader. Nothing else differs."""

import itertools

import adf
import cgns
import exodus
import h5py
import numpy as np
import pytest
from formats import assert_same
from meshes import gmsh_session
from runs import runs
from su2 import BOX, CONTROL, PLAIN

import jaxmorph as jm
from jaxmorph import io


def in_adf(make, *form):
    """A maker of the ADF twin of a CGNS file."""

    def twin(path):
        make(path.with_name("twin.hdf5"))
        adf.twin(path.with_name("twin.hdf5"), path, *form)

    return twin


def empty_ranges(path):
    """Boundary conditions that end before they begin, as HOPR writes them."""
    cgns.unstructured(path)
    with h5py.File(path, "r+") as file:
        cgns.condition(file["Base/all"], "nothing", [[65], [0]])
        cgns.condition(file["Base/all"], "empty faces", [[65], [-1]], None, "FaceCenter")


def one_layer(path):
    """A bump in a channel, one cell thick between two symmetry planes, as extruded airfoils are."""
    x, y, z = np.meshgrid(
        np.linspace(0, 2, 9), [0.0, 0.1], np.linspace(0, 1, 6) ** 2, indexing="ij"
    )
    z = z + 0.1 * (1 - z) * np.sin(np.pi * x / 2) ** 2
    with h5py.File(path, "w", track_order=True) as file:
        base = cgns.base(file, 3, 3)
        zone = cgns.zone(base, "one", (x, y, z))
        for name, places, kind in (
            ("wall", [[1, 1, 1], [9, 2, 1]], "BCWallViscous"),
            ("far", [[1, 1, 6], [9, 2, 6]], "BCFarfield"),
            ("in", [[1, 1, 1], [1, 2, 6]], "BCFarfield"),
            ("out", [[9, 1, 1], [9, 2, 6]], "BCFarfield"),
            ("near", [[1, 1, 1], [9, 1, 6]], "BCSymmetryPlane"),
            ("behind", [[1, 2, 1], [9, 2, 6]], "BCSymmetryPlane"),
        ):
            cgns.condition(zone, name, places, name)
            cgns.node(cgns.node(base, name, "Family_t"), "FamilyBC", "FamilyBC_t", kind)


def by_gmsh(**options):
    """A maker of gmsh's file of a box with two groups of faces."""

    def make(path):
        with gmsh_session() as gmsh:
            box = gmsh.model.occ.addBox(0.25, 0, 0, 1, 1, 1)
            gmsh.model.occ.synchronize()
            gmsh.model.addPhysicalGroup(3, [box], name="fluid")
            gmsh.model.addPhysicalGroup(2, [1], name="wall")
            gmsh.model.addPhysicalGroup(2, [2, 3], name="two sides")
            for name, value in ({"MeshSizeMax": 0.6} | options).items():
                gmsh.option.setNumber(f"Mesh.{name}", value)
            gmsh.model.mesh.generate(3)
            gmsh.write(str(path))

    return make


def zones(path):
    text = PLAIN.replace("lower", "under").replace("0.0 0.0 0", "0.0 -0.5 0")
    path.write_text(f"NZONE= 2\n% the first\nIZONE= 1\n{PLAIN}% the second\nIZONE= 2\n{text}")


def netcdf(**form):
    return lambda path: exodus.solid(path, **form)


def of_cgns(path):
    """All points of a CGNS file in its order."""
    cgns_reader = pytest.importorskip("vtkmodules.vtkIOCGNSReader")
    from vtkmodules.util.numpy_support import vtk_to_numpy

    reader = cgns_reader.vtkCGNSReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    reader.EnableAllBases()
    reader.SetDoublePrecisionMesh(True)
    reader.SetLoadBndPatch(False)
    reader.Update()
    leaves, places = reader.GetOutput().NewIterator(), []
    while not leaves.IsDoneWithTraversal():
        places.append(vtk_to_numpy(leaves.GetCurrentDataObject().GetPoints().GetData()))
        leaves.GoToNextItem()
    return np.concatenate(places)


def of_gmsh(path):
    """Points by the tags of their nodes, which are those of the file's order."""
    with gmsh_session() as gmsh:
        gmsh.open(str(path))
        tags, places, _ = gmsh.model.mesh.getNodes()
        return places.reshape(-1, 3)[np.argsort(tags)]


def of_su2(path):
    """The rows behind each NPOIN=, without the index at their end."""
    lines, places = path.read_text().splitlines(), []
    for at, line in enumerate(lines):
        if line.startswith("NPOIN="):
            rows = lines[at + 1 : at + 1 + int(line.split()[1])]
            places += [[float(word) for word in row.split()[:2]] for row in rows]
    return np.array(places)


def of_exodus(path):
    seen = exodus.of_vtk(path)
    places = np.zeros((12, 3))
    for corners, ids in seen.values():
        places[ids] = corners
    return places


def of_legacy(path):
    legacy = pytest.importorskip("vtkmodules.vtkIOLegacy")
    from vtkmodules.util.numpy_support import vtk_to_numpy

    reader = legacy.vtkUnstructuredGridReader()
    reader.SetFileName(str(path))
    reader.Update()
    return vtk_to_numpy(reader.GetOutput().GetPoints().GetData())


KINDS = {
    "CGNS, blocks": (cgns.two_blocks, "a.cgns", of_cgns),
    "CGNS, polyhedra": (cgns.joined_polyhedra, "a.cgns", None),
    "CGNS, empty ranges": (empty_ranges, "a.cgns", of_cgns),
    "CGNS, one layer of cells": (one_layer, "a.cgns", of_cgns),
    "ADF, little-endian": (in_adf(cgns.two_blocks, "A", "<"), "a.cgns", of_cgns),
    "ADF, big-endian": (in_adf(cgns.two_blocks, "A", ">"), "a.cgns", of_cgns),
    "ADF, version B": (in_adf(cgns.unstructured, "B", "<"), "a.cgns", of_cgns),
    "ADF, in pieces": (in_adf(one_layer, "A", "<", 3), "a.cgns", of_cgns),
    "ADF, empty ranges": (in_adf(empty_ranges, "B", ">", 2), "a.cgns", of_cgns),
    "ADF, polyhedra": (in_adf(cgns.joined_polyhedra), "a.cgns", None),
    "gmsh 4.1, all saved": (by_gmsh(MshFileVersion=4.1, SaveAll=1), "a.msh", of_gmsh),
    "gmsh 4.1, binary, all saved": (
        by_gmsh(MshFileVersion=4.1, Binary=1, SaveAll=1),
        "a.msh",
        of_gmsh,
    ),
    "gmsh 4.0, text": (by_gmsh(MshFileVersion=4.0), "a.msh", of_gmsh),
    "gmsh's legacy VTK, binary": (by_gmsh(Binary=1), "a.vtk", of_legacy),
    "MED": (by_gmsh(), "a.med", of_gmsh),
    "SU2, two zones": (zones, "a.su2", of_su2),
    "SU2, a box": (
        lambda path: path.write_text(PLAIN + BOX.format(control=CONTROL)),
        "a.su2",
        of_su2,
    ),
    **{f"Exodus, {form}": (netcdf(form=form), "a.e", of_exodus) for form in exodus.FORMS},
    **{
        f"Exodus, joined, {form}": (netcdf(form=form, is_joined=True), "a.e", of_exodus)
        for form in exodus.FORMS
    },
}
BREADTH = (
    "ADF, big-endian",
    "ADF, version B",
    "gmsh 4.0, text",
    "Exodus, cdf1",
    "Exodus, cdf2",
    "Exodus, joined, cdf1",
)
"""Kinds that differ by a form alone, which the tests of the format hold."""


def of_zones(path):
    """The meshes of a file: several where it has zones that are meshes of their own."""
    return io.read_zones(path) if path.suffix == ".su2" else (io.read(path),)


def assert_coordinates_alone_differ(before, after, old, new):
    """What differs is a word, or eight bytes, that was a coordinate of the file and is one of the new ones."""
    if b"\0" not in before:
        pairs = itertools.zip_longest(before.split(), after.split())
        words = [(a, b) for a, b in pairs if a != b]
        assert {float(a) for a, _ in words} <= set(old.ravel().tolist())
        assert {float(b) for _, b in words} <= set(new.ravel().tolist())
        return
    assert len(before) == len(after)
    a, b = (np.frombuffer(each, np.uint8) for each in (before, after))
    may = np.zeros(len(a), bool)
    for order in "<>":
        values = [
            np.lib.stride_tricks.sliding_window_view(each, 8).copy().view(f"{order}f8")[:, 0]
            for each in (a, b)
        ]
        starts = np.isin(values[0], old) & np.isin(values[1], new)
        for k in range(8):
            may[k : len(a) - 7 + k] |= starts
    assert may[a != b].all()


@pytest.mark.parametrize(
    "kind", runs([name for name in KINDS if name not in BREADTH], nightly=BREADTH)
)
def test_coordinates_change_and_nothing_else(tmp_path, kind):
    make, name, oracle = KINDS[kind]
    path, moved = tmp_path / name, tmp_path / f"moved-{name}"
    make(path)
    meshes = of_zones(path)
    old = np.concatenate([mesh.in_file_order(mesh.points) for mesh in meshes])
    for mesh in meshes:
        d = mesh.points.shape[1]
        np.testing.assert_array_equal(
            mesh.in_file_order(mesh.points)[:, :d], mesh.points[mesh.file_nodes]
        )
        assert set(mesh.kinds) <= set(mesh.patches)
    if oracle is not None:
        np.testing.assert_array_equal(oracle(path), old)
    # nodes on one side stay, bit for bit
    points = [
        np.where(mesh.points[:, :1] > 0.4, mesh.points * np.pi + 0.01, mesh.points)
        for mesh in meshes
    ]
    new = np.concatenate(
        [mesh.in_file_order(places) for mesh, places in zip(meshes, points, strict=True)]
    )
    changed = [mesh.moved(places) for mesh, places in zip(meshes, points, strict=True)]
    io.write_zones(moved, changed) if len(meshes) > 1 else io.write(moved, *changed)
    if oracle is not None:
        np.testing.assert_array_equal(oracle(moved), new)
    for mesh, again in zip(changed, of_zones(moved), strict=True):
        assert_same(again, mesh)
        assert again.kinds == mesh.kinds
    if path.suffix != ".vtk":  # written anew
        io.write(tmp_path / f"same-{name}", next(iter(meshes)))
        assert (tmp_path / f"same-{name}").read_bytes() == path.read_bytes()
        assert_coordinates_alone_differ(path.read_bytes(), moved.read_bytes(), old, new)


@pytest.mark.parametrize("is_adf", runs(slow=[False], nightly=[True]))
def test_one_layer_of_cells_stays_one(tmp_path, is_adf):
    """The kinds of the file say what is fixed and what are planes; planes stay planes, and move alike bit for bit."""
    (in_adf(one_layer) if is_adf else one_layer)(tmp_path / "a.cgns")
    mesh = io.read(tmp_path / "a.cgns")
    with pytest.warns(
        UserWarning, match="By their kinds in the file `fixed` are 'far' .* `symmetry` are"
    ):
        plan = jm.prepare(mesh, "wall")
    u = 0.05 * np.sin(np.pi * mesh.points[plan.moving, :1] / 2) ** 2 * [0.0, 0, 1]
    points = np.asarray(jm.deform(plan, u))
    places = mesh.in_file_order(points).reshape(6, 2, 9, 3)
    near, behind = places[:, 0], places[:, 1]
    np.testing.assert_array_equal(near[..., 1], 0)
    np.testing.assert_array_equal(behind[..., 1], 0.1)
    np.testing.assert_array_equal(near[..., [0, 2]], behind[..., [0, 2]])
    assert np.abs(points - mesh.points).max() > 0.04
    assert int(jm.quality(mesh, points).inverted) == 0
