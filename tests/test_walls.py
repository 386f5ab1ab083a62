"""Which surface nodes make one wall, by faces and without them."""

import functools

import numpy as np
import pytest
from meshes import circle, sphere
from runs import over

import jaxmorph as jm
from benchmarks import faults
from jaxmorph import cases
from jaxmorph._host.surface.walls import walls


def parts(mesh, moving, fixed=(), with_faces=True):
    """For each patch the set of walls that its nodes are on; nodes of two patches are left out. Also all labels."""
    ids = mesh.patch(*moving)
    nodes = np.concatenate([ids, np.setdiff1d(mesh.patch(*fixed), ids)])
    faces = None
    if with_faces:
        row = np.full(len(mesh.points), -1)
        row[nodes] = np.arange(len(nodes))
        outer = jm.boundary_faces(mesh)
        rows = {kind: row[corners] for kind, corners in outer.items()}
        faces = {kind: corners[(corners >= 0).all(axis=1)] for kind, corners in rows.items()}
    label = walls(mesh.points[nodes], len(ids), faces)
    place = dict(zip(nodes.tolist(), label.tolist(), strict=True))
    times = np.bincount(np.concatenate(list(mesh.patches.values())), minlength=len(mesh.points))
    single = {
        name: [node for node in mesh.patch(name).tolist() if times[node] == 1]
        for name in (*moving, *fixed)
    }
    return {name: {place[node] for node in nodes} for name, nodes in single.items()}, label


def mirrored(mesh):
    """The same mesh with cells numbered clockwise."""
    points = mesh.points * np.where(np.arange(mesh.points.shape[1]) == 0, -1, 1)
    return jm.Mesh(points, mesh.cells, mesh.patches)


@pytest.mark.parametrize("with_faces", [True, False])
@over("points stations span", [(2000, 13, 2.0), (1000, 9, 2.0)], nightly=[(4000, 40, 6.0)])
def test_a_structured_wing_is_one_wall(with_faces, points, stations, span):
    mesh = cases.wing(points=points, stations=stations, span=span)
    found, _ = parts(mesh, ["wing"], ["farfield"], with_faces)
    assert len(found["wing"]) == 1
    assert not found["wing"] & found["farfield"]


@pytest.mark.parametrize("with_faces", [True, False])
def test_walls_that_touch_are_apart(with_faces):
    found, _ = parts(faults.channel(), ["inner"], ["outer", "inlet", "outlet"], with_faces)
    assert len(found["inner"]) == 1
    assert not found["inner"] & (found["outer"] | found["inlet"] | found["outlet"])
    if with_faces:  # sharp corners that hold the mesh part walls of one kind too
        assert [len(found[name]) for name in ("outer", "inlet", "outlet")] == [1, 1, 1]
        assert len(set.union(*found.values())) == 4


@pytest.mark.parametrize(
    "turn", [lambda mesh: mesh, mirrored], ids=["counter-clockwise", "clockwise"]
)
@pytest.mark.parametrize("kind", ["hexahedron", "wedge", "tetra", "pyramid", "mixed"])
def test_a_box_has_six_walls_whatever_its_cells(kind, turn):
    mesh = turn(cases.bricks(kind, cells=3))
    found, label = parts(mesh, ["floor"], ["lid", "sides"])
    assert label.max() + 1 == 6
    assert {len(found[name]) for name in ("floor", "lid")} == {1}
    assert len(found["sides"]) == 4


@pytest.mark.parametrize(
    "turn", [lambda mesh: mesh, mirrored], ids=["counter-clockwise", "clockwise"]
)
@pytest.mark.parametrize(
    "make",
    [
        lambda: faults.sharp_o_grid(around=64, layers=16),
        lambda: cases.naca4("4412", points=2000, sharp=True),
        lambda: cases.naca4("4412", points=2000),
    ],
    ids=["sharp O", "sharp C", "blunt C"],
)
def test_an_airfoil_is_one_wall_round_its_edge(make, turn):
    found, _ = parts(turn(make()), ["airfoil"], ["farfield"])
    assert len(found["airfoil"]) == 1
    assert not found["airfoil"] & found["farfield"]


def extruded(outline, stations, span):
    layers = [
        np.column_stack([outline, np.full(len(outline), z)]) for z in np.linspace(0, span, stations)
    ]
    return np.concatenate(layers)


def blades(stations):
    """Sections of one blade follow each other across their planes, those of two blades lie beside each other."""
    blade = faults.cascade(around=120, layers=10)
    outline = blade.points[blade.patch("blade")]
    return [extruded(outline + np.array([0, shift]), stations, 4.0) for shift in (0, 0.5)]


@pytest.mark.parametrize(
    ("make", "moving"),
    [
        *[(functools.partial(blades, stations), 2) for stations in (2, 5, 8)],
        (lambda: [circle(40), circle(40) + np.array([2.5, 0]), 9 * circle(40)], 2),  # closed curves
        (
            lambda: [sphere(900)[:1] * 0.1, sphere(900), 4 * sphere(900)],
            1,
        ),  # a body in a far field, one node of neither
    ],
)
def test_bodies_are_walls_of_their_own_without_faces(make, moving):
    bodies = make()
    label = walls(np.concatenate(bodies), sum(map(len, bodies[:moving])))
    assert [len(set(each)) for each in np.split(label, np.cumsum([*map(len, bodies)])[:-1])] == [
        1
    ] * len(bodies)
    assert label.max() == len(bodies) - 1


@pytest.mark.parametrize("with_faces", [True, False])
def test_order_does_not_matter(with_faces):
    mesh = cases.wing(points=1000, stations=6)
    order = np.random.default_rng(0).permutation(len(mesh.points))
    place = np.argsort(order)
    cells, patches = (
        {name: place[ids] for name, ids in each.items()} for each in (mesh.cells, mesh.patches)
    )
    shuffled = jm.Mesh(mesh.points[order], cells, patches)
    one, other = (parts(each, ["wing"], ["farfield"], with_faces)[1] for each in (mesh, shuffled))
    assert sorted(np.bincount(one)) == sorted(np.bincount(other))


def bumped(mesh, method=None, *, whole=True):
    """The channel with its inner wall raised by half the gap: smallest corner Jacobian, relative to the one before."""
    inner = mesh.patch("inner")
    fixed = np.setdiff1d(mesh.patch("outer", "inlet", "outlet"), inner)
    x = mesh.points[inner, 0]
    u = np.column_stack([0 * x, 0.1 * np.sin(np.pi * x) ** 2])  # the gap is 0.2
    plan = jm.prepare(mesh if whole else mesh.points, inner, fixed, method=method)
    return jm.quality(mesh, jm.deform(plan, u))


@pytest.mark.nightly
@pytest.mark.parametrize(
    "whole", [True, pytest.param(False, marks=pytest.mark.slow)], ids=["mesh", "points"]
)
def test_half_a_gap_is_closed_in_one_step(whole):
    """Graph mapping alone keeps half of each cell; a layer over both walls at once once inverted dozens."""
    report = bumped(faults.channel(), whole=whole)
    assert int(report.inverted) == 0
    assert float(report.min_jacobian_ratio) > 0.4
