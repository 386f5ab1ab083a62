"""MFEM's meshes: every type of cells, order and order of numbers, as MFEM wrote them; written back, and refused."""

import mfem_meshes
import numpy as np
import pytest
from formats import rewritten
from meshes import bricks, mixed

import jaxmorph as jm
from jaxmorph import io
from jaxmorph._host.cells.lagrange import PLACES, lagrange_types

FILES = {name: getattr(mfem_meshes, name) for name in ("SOLID", "FLAT", "TORN")}
DATA = "FiniteElementCollection: H1_2D_P2"


def saved(folder, text: str, name: str = "a.mesh"):
    (folder / name).write_text(text)
    return folder / name


def corners_of(text: str) -> dict[int, list[list[int]]]:
    """Corners of the cells, by MFEM's number of the type, out of the text."""
    lines = text.split("elements\n")[1].split("boundary")[0].split("\n")
    rows = [list(map(int, line.split())) for line in lines if line]
    table: dict[int, list[list[int]]] = {}
    for row in rows[1:]:
        table.setdefault(row[1], []).append(row[2:])
    return table


@pytest.mark.parametrize("name", FILES)
def test_nodes_are_where_the_map_takes_them(tmp_path, name):
    mesh = io.read(saved(tmp_path, FILES[name]))
    d = mesh.points.shape[1]
    places, seen = np.array(mfem_meshes.CORNER_PLACES[d], float), 0
    table = corners_of(FILES[name])
    numbers = {"triangle": 2, "quad": 3, "tetra": 4, "hexahedron": 5, "wedge": 6}
    for kind, ids in mesh.cells.items():
        cell = lagrange_types()[kind]
        for row, corners in zip(ids, table[numbers[cell.shape]], strict=True):
            assert row[: cell.corners].tolist() == corners
            at = places[corners]
            axes = [
                at[PLACES[cell.shape].index(tuple(unit))] - at[0]
                for unit in np.eye(d, dtype=int).tolist()
            ]
            np.testing.assert_allclose(
                mesh.points[row], mfem_meshes.moved(at[0] + cell.reference @ axes), atol=1e-8
            )
            seen += 1
    assert seen == 3
    assert int(jm.quality(mesh).inverted) == 0
    assert len(np.unique(np.concatenate([ids.ravel() for ids in mesh.cells.values()]))) == len(
        mesh.points
    )


@pytest.mark.parametrize("name", FILES)
def test_files_come_back_and_move(tmp_path, name):
    path = saved(
        tmp_path,
        "".join(FILES[name].partition("elements\n")[:2])
        + "# cells\n"
        + FILES[name].partition("elements\n")[2],
    )
    mesh = io.read(path)
    io.write(tmp_path / "same.mesh", mesh)
    assert (tmp_path / "same.mesh").read_bytes() == path.read_bytes()
    far = np.asarray(mesh.points)[:, 0] > 1.5
    points = np.array(mesh.points)
    points[far] += 0.01 * np.cos(2 * points[far])
    again = rewritten(tmp_path / "moved.mesh", mesh.moved(points))
    np.testing.assert_allclose(again.points, points, rtol=0, atol=1e-13)
    old, new = (
        text.split("Ordering")[1].split()
        for text in (path.read_text(), (tmp_path / "moved.mesh").read_text())
    )
    assert (
        0.2 < np.mean([a == b for a, b in zip(old, new, strict=True)]) < 0.95
    )  # digits of cells that stay are kept
    assert (tmp_path / "moved.mesh").read_text().split("Ordering")[0] == path.read_text().split(
        "Ordering"
    )[0]


def test_comments_between_vertices_stay(tmp_path):
    text = mfem_meshes.straight(bricks(2), "floor")
    first = text[text.index("vertices") :].split("\n")[3]
    mesh = io.read(saved(tmp_path, text.replace(f"\n{first}\n", f"\n# 1 2 3\n{first}\n # four\n")))
    io.write(tmp_path / "same.mesh", mesh)
    assert (tmp_path / "same.mesh").read_text() == (tmp_path / "a.mesh").read_text()
    io.write(tmp_path / "b.mesh", mesh.moved(np.asarray(mesh.points) + 0.25))
    assert "\n# 1 2 3\n0.25 0.25 0.25\n # four\n" in (tmp_path / "b.mesh").read_text()
    np.testing.assert_array_equal(
        io.read(tmp_path / "b.mesh").points, np.asarray(mesh.points) + 0.25
    )


def test_patches_are_attributes_and_named_sets(tmp_path):
    mesh = io.read(saved(tmp_path, mfem_meshes.SOLID))
    assert list(mesh.patches) == ["boundary_3", "boundary_5", "boundary_9"]
    assert len(mesh.patch("boundary_5")) == 9  # a quad of order 2
    assert len(mesh.patch("boundary_3")) == 9 + 6 - 3  # with a triangle beside it
    text = mfem_meshes.straight(bricks(2), "floor")
    straight = io.read(saved(tmp_path, text))
    np.testing.assert_array_equal(straight.points, bricks(2).points)
    np.testing.assert_array_equal(straight.patch("floor"), bricks(2).patch("floor"))
    assert list(straight.patches) == ["boundary_2", "boundary_4"]
    assert straight.groups == {"floor": ("boundary_4",)}
    points = np.array(straight.points)
    points[4] += 0.1
    np.testing.assert_array_equal(
        rewritten(tmp_path / "moved.mesh", straight.moved(points)).points, points
    )
    side = next(iter(jm.boundary_faces(mixed()).values()))[0]
    every = jm.Mesh(mixed().points, mixed().cells, {"side": side})
    again = io.read(saved(tmp_path, mfem_meshes.straight(every, "side"), "b.mesh"))
    assert again.cell_counts == every.cell_counts
    np.testing.assert_array_equal(again.patch("side"), np.sort(side))


def test_older_names_of_the_spaces(tmp_path):
    text = mfem_meshes.SOLID.replace("H1_3D_P2", "Quadratic")
    assert text != mfem_meshes.SOLID
    mesh = io.read(saved(tmp_path, text))
    np.testing.assert_array_equal(mesh.points, io.read(saved(tmp_path, mfem_meshes.SOLID)).points)


def test_a_mesh_in_space_that_lies_in_a_plane_has_two_coordinates(tmp_path):
    rows = "0 0 1\n1 0 1\n1 1 1\n0 1 1\n2 0.5 1\n2 2 1\n"
    head = mfem_meshes.FLAT.split("nodes")[0]
    mesh = io.read(saved(tmp_path, f"{head.rstrip()}\n3\n{rows}"))
    assert mesh.points.shape == (6, 2)
    io.write(tmp_path / "moved.mesh", mesh.moved(mesh.points + 0.25))
    assert (tmp_path / "moved.mesh").read_text().endswith("2.25 0.75 1\n2.25 2.25 1\n")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            ("H1_2D_P2", "H1_2D_P3"),
            "nodes of H1_2D_P3 are not read; H1 and L2_T1 of order 1 and 2 are",
        ),
        (("H1_2D_P2", "H1Pos_2D_P4"), "nodes of H1Pos_2D_P4 are not read"),
        (("H1_2D_P2", "NURBS"), "nodes of NURBS are not read"),
        (
            ("H1_2D_P2", "H1_2D_P1"),
            "6 nodes of 2 or 3 coordinates expected, found 30 numbers for 2",
        ),
        (
            ("v1.0", "v2.0"),
            "MFEM mesh v1.0 to v1.3 expected in the first line, found 'MFEM mesh v2.0'",
        ),
        (("MFEM mesh", "MFEM NC mesh"), "expected in the first line"),
        (("1 2 1 4 2", "1 2 1 4 9"), "there are nodes 0 to 5, and others here"),
        (("1 2 1 4 2", "1 12 1 4 2"), "line 8: element type 12 is not known"),
        (("1 2 1 4 2", "1 2 1 4"), "line 8: an element of type 2 has 3 nodes"),
        (("1 2 1 4 2", "1 1 1 4"), "cells of 2-D alone, or of 3-D alone, expected"),
        (("elements\n3", "elements\n4"), "a number of elements expected, and as many rows"),
        (
            (mfem_meshes.FLAT, "MFEM mesh v1.0\n"),
            "no elements, boundary, vertices in this file; it is cut short",
        ),
        (("boundary\n", "frontier\n"), "no boundary in this file"),
        (("v1.0", "v1.2"), "no line mfem_mesh_end in this file; it is cut short"),
        (("vertices\n6", "vertices\n600000"), "600000 vertices do not fit into a file of"),
        (
            ("Ordering: 1", "Ordering: 7"),
            "FiniteElementSpace with its FiniteElementCollection, VDim and Ordering expected",
        ),
    ],
)
def test_what_is_not_read_is_told(tmp_path, change, words):
    assert change[0] in mfem_meshes.FLAT
    with pytest.raises(ValueError, match=words):
        io.read(saved(tmp_path, mfem_meshes.FLAT.replace(*change, 1)))


def test_torn_and_periodic_meshes_are_told(tmp_path):
    head, numbers = mfem_meshes.TORN.split("Ordering: 0\n\n")
    words = numbers.split()
    words[0] = repr(float(words[0]) + 0.5)
    with pytest.raises(
        ValueError, match=r"nodes of cells that meet are 0\.5 apart; periodic meshes are not read"
    ):
        io.read(saved(tmp_path, f"{head}Ordering: 0\n\n{' '.join(words)}\n"))
    with pytest.raises(
        ValueError, match="only a mesh that was read from an MFEM file can be written to one"
    ):
        io.write(tmp_path / "new.mesh", bricks(2))
