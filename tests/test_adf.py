"""CGNS in ADF: twins of files in HDF5, made here and by cgnslib, which judges what is written."""

import shutil
import subprocess

import adf
import cgns
import h5py
import numpy as np
import pytest
from cgns import joined_polyhedra, two_blocks, unstructured
from formats import assert_same, rewritten
from runs import runs

import jaxmorph as jm
from jaxmorph import io

FILES = {"blocks": two_blocks, "elements": unstructured, "polyhedra": joined_polyhedra}
FORMS = [(version, order, pieces) for version in "AB" for order in "<>" for pieces in (1, 3)]


def program(name):
    """Finds a program of cgnslib, or skips the test."""
    if shutil.which(name) is None:
        pytest.skip(f"apt-get install cgns-convert brings {name}")
    return name


@pytest.mark.parametrize(
    ("form", "name"),
    runs(
        [*((form, "elements") for form in FORMS), (FORMS[0], "blocks"), (FORMS[-1], "polyhedra")],
        nightly=[
            *((form, "blocks") for form in FORMS[1:]),
            *((form, "polyhedra") for form in FORMS[:-1]),
        ],
    ),
    ids=str,
)
def test_every_form_is_the_mesh_of_its_twin(form, name, tmp_path):
    FILES[name](tmp_path / "h.cgns")
    adf.twin(tmp_path / "h.cgns", tmp_path / "a.cgns", *form)
    mesh = io.read(tmp_path / "a.cgns")
    assert_same(mesh, io.read(tmp_path / "h.cgns"))
    io.write(tmp_path / "same.cgns", mesh)
    assert (tmp_path / "same.cgns").read_bytes() == (tmp_path / "a.cgns").read_bytes()
    moved = mesh.points * np.pi
    moved[0] = mesh.points[0]
    assert_same(rewritten(tmp_path / "b.cgns", mesh.moved(moved)), mesh.moved(moved))


@pytest.mark.parametrize("make", FILES.values(), ids=FILES)
def test_cgnslib_agrees(make, tmp_path):
    """Its converter makes the file, and its comparison finds the moved file and the moved one in HDF5 alike to the last bit."""
    make(tmp_path / "h.cgns")
    subprocess.run(
        [program("hdf2adf"), "h.cgns", "a.cgns"], cwd=tmp_path, check=True, capture_output=True
    )
    mesh, twin = io.read(tmp_path / "a.cgns"), io.read(tmp_path / "h.cgns")
    assert_same(mesh, twin)
    for each, name in ((mesh, "moved.cgns"), (twin, "right.cgns")):
        io.write(tmp_path / name, each.moved(each.points * np.pi))
    subprocess.run(
        [program("adf2hdf"), "moved.cgns", "back.cgns"],
        cwd=tmp_path,
        check=True,
        capture_output=True,
    )
    words = [program("cgnsdiff"), "-d", "back.cgns", "right.cgns"]
    done = subprocess.run(words, cwd=tmp_path, check=True, capture_output=True, text=True)
    assert done.stdout == ""
    words = [program("cgnsdiff"), "-d", "moved.cgns", "a.cgns"]
    done = subprocess.run(words, cwd=tmp_path, check=True, capture_output=True, text=True)
    assert all("/Coordinate" in line for line in done.stdout.splitlines())
    assert len(done.stdout.splitlines()) == 3 * (2 if make is two_blocks else 1)


@pytest.mark.parametrize("form", FORMS, ids=str)
def test_cgnslib_reads_what_these_tests_write(form, tmp_path):
    """The writer of these tests is right: cgnslib finds the same nodes in its files."""
    two_blocks(tmp_path / "h.cgns")
    adf.twin(tmp_path / "h.cgns", tmp_path / "a.cgns", *form)
    subprocess.run(
        [program("adf2hdf"), "a.cgns", "b.cgns"], cwd=tmp_path, check=True, capture_output=True
    )
    words = [program("cgnsdiff"), "-d", "b.cgns", "h.cgns"]
    assert (
        subprocess.run(words, cwd=tmp_path, check=True, capture_output=True, text=True).stdout == ""
    )


def heap(links=None):
    """A root with one child of each kind, for damage by hand; `links` is what a node of the kind LK says."""
    made = adf.Heap("A", "<")
    leaf = made.node("Version", b"CGNSLibraryVersion_t", np.array([3.4], np.float32), [])
    children = [leaf]
    if links is not None:
        at = made.part(b"DaTa", links, b"dEnD")
        children.append(
            (b"away".ljust(32), made.add(made.head("away", b"", [], b"LK", [len(links)], 1, at)))
        )
    return made, made.node("ADF MotherNode", b"Root Node of ADF File", None, children)[1]


def test_hostile_files_are_refused(tmp_path):
    """What lies beyond the file, nodes in a circle, parts on each other, links, and numbers of unknown machines."""
    path = tmp_path / "a.cgns"

    def refused(data, message):
        path.write_bytes(data)
        with pytest.raises(ValueError, match=message) as raised:
            io.read(path)
        assert str(path) in str(raised.value)

    made, root = heap()
    good = made.finish(root)
    refused(good, "no CGNS base with zones")
    refused(good[:150], "a place 0 beyond the 150 bytes")
    refused(good[:100] + b"N" + good[101:], "numbers of format 'N'; IEEE's formats are read")
    refused(good[:112] + b"06" + good[114:], "long numbers of 6 bytes")
    refused(good[:134] + made.pointer(10**9) + good[146:], "beyond the")
    refused(good[:134] + b"0000000x0000" + good[146:], "where hexadecimal digits should stand")
    table = good.index(b"SNTb") + 16
    entry = slice(table + 32, table + 44)
    refused(
        good[: entry.start] + made.pointer(root) + good[entry.stop :],
        "stands at two places of the tree",
    )
    many = good[: root + 68] + b"FFFFFFFF" + good[root + 76 :]
    refused(many, "a table of 188978560980 bytes in 132")
    leaf = good.index(b"NoDeVersion")
    huge = good[: leaf + 130] + b"FFFFFFFF" + good[leaf + 138 :]
    refused(huge, "less data than its shape")
    refused(good.replace(b"dEnD", b"dEnE"), "where b'dend' should stand")
    refused(
        good[: leaf + 230] + made.pointer(table - 16) + good[leaf + 242 :],
        "where b'data' should stand",
    )
    for target in (b"other.cgns>/Base", b">/Base"):
        made, root = heap(target)
        refused(
            made.finish(root),
            rf"/away is a link to {target.decode()}\. .* `cgnsconvert -l` makes one",
        )
    made, root = heap()
    data = made.part(b"DaTa", np.float32(1).tobytes(), b"dEnD")
    twice = [
        (x.ljust(32), made.add(made.head(x.decode(), b"", [], b"R4", [1], 1, data)))
        for x in (b"a", b"b")
    ]
    refused(
        made.finish(made.node("ADF MotherNode", b"", None, twice)[1]),
        "parts of the file lie in one another",
    )


@pytest.mark.parametrize("is_adf", [False, True])
def test_empty_conditions_are_empty_patches(is_adf, tmp_path):
    """A range that ends before the first node, as some preprocessors write it, in blocks and between elements."""
    two_blocks(tmp_path / "a.cgns")
    unstructured(tmp_path / "b.cgns")
    with h5py.File(tmp_path / "a.cgns", "r+") as file:
        cgns.condition(file["Base/one"], "nothing", [[4, 0, 1], [4, -1, 3]])
        cgns.condition(file["Base/one"], "back", [[1, 3, 3], [1, 1, 1]])
    with h5py.File(tmp_path / "b.cgns", "r+") as file:
        cgns.condition(file["Base/all"], "nothing", [[65], [0]])
        cgns.condition(file["Base/all"], "faces", [[1], [0]], None, "FaceCenter")
        cgns.condition(file["Base/all"], "list", np.zeros((0, 1)), None, "FaceCenter", "PointList")
    for name, empty in (("a", ["nothing"]), ("b", ["nothing", "faces", "list"])):
        if is_adf:
            adf.twin(tmp_path / f"{name}.cgns", tmp_path / f"{name}.adf.cgns")
        mesh = io.read(tmp_path / f"{name}.adf.cgns" if is_adf else tmp_path / f"{name}.cgns")
        assert [len(mesh.patches[each]) for each in empty] == [0] * len(empty)
        if name == "a":
            np.testing.assert_array_equal(mesh.patches["back"], mesh.patches["inlet"])
        with pytest.raises(ValueError, match="`moving` is empty"):
            jm.prepare(mesh, "nothing", "wall" if name == "b" else "floor")
