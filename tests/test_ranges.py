"""SU2 and CGNS files by ranges: moved, judged and written as they are whole, whatever the size of a range."""

import json
import re

import cgns
import h5py
import numpy as np
import pytest
from small import bricks
from test_cgns import two_blocks

import jaxmorph as jm
from jaxmorph import io
from jaxmorph._host.cells.topology import boundary_faces
from jaxmorph._host.surface.walls import seen_from_outside
from jaxmorph.cli import main
from jaxmorph.io._boundary import patch_faces
from jaxmorph.io.cgns import layout

PATCHES = ["--moving", "floor", "--fixed", "rest"]
TURN, LIFT = [*PATCHES, "--rotate", "6"], [*PATCHES, "--translate", "0", "0", "0.1", "--free", "sides"]


def box(folder):
    """A box of 27 hexahedra in an SU2 file, with a comment that looks like a keyword in front of each section."""
    mesh = bricks()
    points = np.asarray(mesh.points)
    sides = np.flatnonzero((points[:, :2] == 0).any(axis=1) | (points[:, :2] == 1).any(axis=1))
    patches = mesh.patches | {"rest": np.flatnonzero(points[:, 2] == 1), "sides": sides}
    io.write(folder / "plain.su2", jm.Mesh(points, mesh.cells, patches))
    text = (folder / "plain.su2").read_text()
    text = re.sub("^(NELEM|NPOIN|NMARK)=", r"% NPOIN= 3 here\n\1=", text, flags=re.M)
    (folder / "box.su2").write_text(text.replace("NPOIN= 64\n", "NPOIN= 64 % n= 64\n % x= 1\n"))
    return folder / "box.su2"


def ring(folder):
    """An O-grid of quads and, in its outer layer, triangles."""
    angle, radius = np.meshgrid(np.arange(24) * np.pi / 12, [1.0, 1.1, 1.4, 2.5, 4.0])
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1).reshape(-1, 2)
    ids = np.arange(len(points)).reshape(angle.shape)
    beside = np.roll(ids, -1, axis=1)
    quads = np.stack([ids[:-1], ids[1:], beside[1:], beside[:-1]], axis=-1)
    outer = quads[-1]
    cells = {"quad": quads[:-1].reshape(-1, 4), "triangle": np.concatenate([outer[:, [0, 1, 2]], outer[:, [0, 2, 3]]])}
    io.write(folder / "ring.su2", jm.Mesh(points, cells, {"floor": ids[0], "rest": ids[-1]}))
    return folder / "ring.su2"


def as_cgns(file):
    """The same mesh as a CGNS file of one zone: its cells MIXED, its boundary faces a section and a condition for each patch."""
    mesh = io.read(file)
    points = np.asarray(mesh.points)
    codes = {"line": 3, "triangle": 5, "quad": 7, "hexahedron": 17}
    mixed = [np.insert(np.asarray(each) + 1, 0, codes[kind], axis=1).ravel() for kind, each in mesh.cells.items()]
    count = sum(map(len, mesh.cells.values()))
    with h5py.File(file.with_suffix(".cgns"), "w", track_order=True) as new:
        zone = cgns.zone(cgns.base(new, points.shape[1], points.shape[1]), "all", tuple(points.T), count)
        cgns.elements(zone, "cells", 20, np.concatenate(mixed), 1, count)
        start = count + 1
        for name, faces in patch_faces(mesh).items():
            for kind, corners in faces.items():
                cgns.elements(zone, f"{name} {kind}", codes[kind], corners + 1, start, len(corners))
                cgns.condition(zone, name, [[start], [start + len(corners) - 1]], None, "FaceCenter")
                start += len(corners)
    return file.with_suffix(".cgns")


def two_zones(folder):
    """The box as two zones that say nothing of each other. Each has conditions for nodes, and none at `rest`."""
    mesh = io.read(box(folder))
    points, corners = np.asarray(mesh.points), np.asarray(mesh.cells["hexahedron"])
    is_left = points[corners].mean(axis=1)[:, 0] < 0.5
    with h5py.File(folder / "zones.cgns", "w", track_order=True) as new:
        base = cgns.base(new, 3, 3)
        for name, cells in (("left", corners[is_left]), ("right", corners[~is_left])):
            nodes = np.roll(np.unique(cells), 7)  # not the order of the other zone
            number = np.full(len(points), -1)
            number[nodes] = 1 + np.arange(len(nodes))
            zone = cgns.zone(base, name, tuple(points[nodes].T), len(cells))
            cgns.elements(zone, "cells", 17, number[cells], 1, len(cells))
            for patch in ("floor", "sides"):
                here = number[mesh.patches[patch]]
                cgns.condition(zone, patch, here[None, here > 0], what="PointList")
    return folder / "zones.cgns"


def blocks(folder):
    two_blocks(folder / "blocks.cgns")
    return folder / "blocks.cgns"


def seam(folder):
    """A 2-D O-grid of one block, whose first and last column are one, with a condition at the inner circle alone."""
    radius, angle = np.meshgrid([1.0, 1.1, 1.4, 2.5], np.arange(13) * np.pi / 6)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    x[-1], y[-1] = x[0], y[0]
    with h5py.File(folder / "seam.cgns", "w", track_order=True) as new:
        zone = cgns.zone(cgns.base(new, 2, 2), "all", (x, y))
        cgns.condition(zone, "floor", [[1, 1], [13, 1]])
    return folder / "seam.cgns"


def oriented(faces):
    """Faces by type, each from its lowest node on, in an order of their own."""
    rolled = {k: [np.roll(row, -row.argmin()).tolist() for row in np.asarray(each)] for k, each in faces.items()}
    return {kind: sorted(each) for kind, each in rolled.items() if each}


def facts(capsys, *arguments):
    """The exit status, and what the command says as JSON."""
    capsys.readouterr()
    status = main([*map(str, arguments), "--json"])
    return status, json.loads(capsys.readouterr().out)


def numbers(said):
    names = ("cells", "inverted", "mean_skewness", "max_skewness", "max_aspect_ratio")
    return [said[when][name] for when in ("before", "after") for name in names] + [said["after"]["min_volume_ratio"]]


@pytest.mark.slow
@pytest.mark.parametrize("make", [ring, box, lambda folder: as_cgns(box(folder))], ids=["ring", "box", "CGNS"])
def test_ranges_move_and_judge_as_the_whole_does(tmp_path, capsys, make):
    file = make(tmp_path)
    turn, ending = TURN if make is ring else LIFT, file.suffix
    first = {path.name for path in tmp_path.iterdir()}
    status, whole = facts(capsys, "deform", file, tmp_path / f"whole{ending}", *turn)
    assert status == 0
    expected, old = io.read(tmp_path / f"whole{ending}").points, io.read(file).points
    assert np.abs(expected - old).max() > 0.05
    for rows in (17, 1000):
        out = tmp_path / f"{rows}{ending}"
        status, said = facts(capsys, "deform", file, out, *turn, "--ranges", rows)
        assert status == 0
        np.testing.assert_allclose(io.read(out).points, expected, rtol=0, atol=1e-12)
        np.testing.assert_allclose(numbers(said), numbers(whole), rtol=1e-9)
        a, b = (re.sub(rb"[-+.\de]+(?=[ \n])", b"", path.read_bytes()) for path in (file, out))
        assert a == b or ending == ".cgns"
    assert {path.name for path in tmp_path.iterdir()} == first | {f"{name}{ending}" for name in ("whole", 17, 1000)}


def test_the_surface_is_that_of_the_whole_mesh(tmp_path):
    whole, mesh = io.read(box(tmp_path)), io.Ranges(tmp_path / "box.su2", 10)
    surface, ids = mesh.surface(), io.global_nodes(mesh.surface())
    np.testing.assert_array_equal(whole.points[ids], surface.points)
    assert {name: ids[each].tolist() for name, each in surface.patches.items()} == {
        name: each.tolist() for name, each in whole.patches.items()
    }
    plan = jm.prepare(whole, "floor", "rest", free="sides")
    u = 0.05 * np.ones((len(plan.moving), 3))
    half = jm.prepare_surface(surface, "floor", "rest", free="sides", nodes=ids, faces=dict(surface.cells))  # pyright: ignore[reportArgumentType]
    for k in range(len(mesh)):
        nodes = np.where(np.isin(mesh.nodes(k), half.surface_nodes), mesh.nodes(k), -1)
        mesh.put(k, np.asarray(jm.deform(half.attach(mesh.read(k), nodes), u)))
    np.testing.assert_allclose(mesh.after, np.asarray(jm.deform(plan, u)), rtol=0, atol=1e-12)
    assert sum(len(part.cells["hexahedron"]) for part, _ in mesh.cells()) == 27
    mesh.write(tmp_path / "ranges.su2")
    io.write(tmp_path / "whole.su2", whole.moved(mesh.after))
    assert (tmp_path / "ranges.su2").read_bytes() == (tmp_path / "whole.su2").read_bytes()


@pytest.mark.parametrize(
    "make",
    [lambda folder: as_cgns(ring(folder)), lambda folder: as_cgns(box(folder)), two_zones, blocks, seam],
    ids=["ring", "box", "two zones", "two blocks", "a block with a seam"],
)
def test_cgns_by_ranges_is_the_whole_file(tmp_path, make, monkeypatch):
    """Surface, cells and what is written, whatever is read together."""
    monkeypatch.setattr(layout, "ROWS", 7)
    file = make(tmp_path)
    whole, mesh = io.read(file), io.Ranges(file, 10)
    np.testing.assert_array_equal(mesh.before, whole.points)
    assert {name: each.tolist() for name, each in mesh.patches.items()} == {
        name: np.unique(each).tolist() for name, each in whole.patches.items()
    }
    parts = [part for part, _ in mesh.cells()]
    for kind, corners in whole.cells.items():
        here = [io.global_nodes(part)[np.asarray(part.cells[kind])] for part in parts if kind in part.cells]
        np.testing.assert_array_equal(np.concatenate(here), corners)
    surface, cells = mesh.surface(), {kind: np.asarray(each) for kind, each in whole.cells.items()}
    outer = seen_from_outside(np.asarray(whole.points), boundary_faces(cells, len(whole.points)))
    ids = io.global_nodes(surface)
    assert oriented({kind: ids[np.asarray(each)] for kind, each in surface.cells.items()}) == oriented(outer)
    assert sum(len(np.asarray(part.between)) for part in parts) % 2 == 0
    for k in range(len(mesh)):
        mesh.put(k, mesh.read(k) * (1 + (mesh.nodes(k) % 3 == 0)[:, None]))
    mesh.write(tmp_path / "ranges.cgns")
    io.write(tmp_path / "whole.cgns", whole.moved(np.array(mesh.after)))
    assert (tmp_path / "ranges.cgns").read_bytes() == (tmp_path / "whole.cgns").read_bytes()
    with h5py.File(file, "r+") as changed:
        zone = next(name for name in changed["Base"] if "GridCoordinates" in changed["Base"][name])  # pyright: ignore
        changed[f"Base/{zone}/GridCoordinates/CoordinateX/ data"][...] = 5.0  # pyright: ignore
    with pytest.raises(ValueError, match="has changed since"):
        mesh.write(tmp_path / "ranges.cgns")


def test_a_boundary_without_markers_is_found(tmp_path):
    file = ring(tmp_path)
    faces = io.Ranges(file, 9).surface().cells["line"]
    text = file.read_text()
    file.write_text(text.replace("NMARK= 2", "NMARK= 1")[: text.index("MARKER_TAG= rest")])
    mesh = io.Ranges(file, 9)
    assert list(mesh.patches) == ["floor"]
    np.testing.assert_array_equal(mesh.surface().cells["line"], faces)


def test_faces_between_ranges_are_counted(tmp_path):
    """27 cubes, 9 a range, in the order of the file: a plane of 9 faces between each two."""
    mesh = io.Ranges(box(tmp_path), 9)
    between = [np.asarray(part.between) for part, _ in mesh.cells()]
    assert sorted(map(len, between)) == [9, 9, 18]


@pytest.mark.slow
def test_bad_cells_are_not_written(tmp_path, capsys):
    status, said = facts(
        capsys, "deform", ring(tmp_path), tmp_path / "out.su2", *PATCHES, "--translate", "3.5", "0", "--ranges", 20
    )
    assert status == 1
    assert said["after"]["inverted"] > 0
    assert [path.name for path in tmp_path.iterdir()] == ["ring.su2"]


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (["--ranges", "0"], "--ranges must be 1 or more"),
        (["--ranges", "9", "--chunk", "5"], "--chunk is not for --ranges"),
        (["--ranges", "9", "--decomposed"], "--ranges is not for --decomposed"),
        (["--ranges", "9", "--method", "elasticity"], "--ranges is not for elasticity"),
    ],
)
def test_what_needs_the_whole_mesh_is_refused(tmp_path, capsys, flags, says):
    assert (
        main(["deform", str(ring(tmp_path)), str(tmp_path / "out.su2"), *PATCHES, "--translate", "0", "0.1", *flags])
        == 2
    )
    assert says in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["ring.su2"]


def test_files_that_ranges_cannot_take(tmp_path):
    file = ring(tmp_path)
    text = file.read_text()
    file.write_text(text.replace("NPOIN= 120", "NPOIN= 121"))
    with pytest.raises(ValueError, match="NPOIN= 121, but 120 rows of points follow"):
        io.Ranges(file, 9)
    file.write_bytes(b"")
    with pytest.raises(ValueError, match="the file is empty"):
        io.Ranges(file, 9)
    with pytest.raises(ValueError, match=r"SU2 and CGNS files \(.su2, .cgns\)"):
        io.Ranges(tmp_path / "a.vtu", 9)
    with h5py.File(tmp_path / "a.cgns", "w", track_order=True) as new:
        zone = cgns.zone(cgns.base(new, 3, 3), "all", tuple(np.zeros((3, 4))), 1)
        cgns.polygons(zone, "faces", 22, [[1, 2, 3]], 1)
    with pytest.raises(ValueError, match="polyhedra are not read by ranges; take --chunk"):
        io.Ranges(tmp_path / "a.cgns", 9)
