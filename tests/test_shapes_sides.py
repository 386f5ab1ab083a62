"""The sides of airfoils: sections whose nodes are known to be upper or lower ones, as they are and with round-off added."""

import pathlib

import numpy as np
import pytest
from meshes import naca
from runs import over, refusals

from jaxmorph import cases, io, shapes


def cusped(count=65, gap=0.0, spacing=np.pi):
    """A section like the RAE 2822: thin, cusped and cambered behind. The upper side comes first, from the nose, then the lower."""
    x = (
        0.5 * (1 - np.cos(np.linspace(0, np.pi, count)))
        if spacing == np.pi
        else np.linspace(0, 1, count) ** 1.5
    )
    half = 0.155 * np.sqrt(x) * (1 - x) ** 1.5 + 0.5 * gap * x
    line = 0.11 * x**3 * (1 - x)
    lower = np.column_stack([x, line - half])[1 : None if gap else -1]
    return np.concatenate([np.column_stack([x, line + half]), lower])


def extruded(section, layers=3):
    """Nodes of a wing with a section, and its quads."""
    count = len(section)
    points = np.concatenate(
        [np.column_stack([section[:, 0], np.full(count, y), section[:, 1]]) for y in range(layers)]
    )
    here, ahead = np.arange(count), np.roll(np.arange(count), -1)
    quads = [
        np.column_stack([here, ahead, ahead + count, here + count]) + k * count
        for k in range(layers - 1)
    ]
    return points, np.concatenate(quads)


def around(x):
    """Rows of `naca` and `cusped` in the order of the wall, counter-clockwise from the tail."""
    count = len(x) // 2 + 1
    return np.concatenate([np.arange(count)[::-1], np.arange(count, len(x))])


SECTIONS = {
    "cusped": cusped(),
    "cusped, coarse behind": cusped(81, spacing=1.5),
    "cusped and blunt": cusped(gap=0.002),
    "0012 sharp": naca(0.0, 0.4, 0.12, last=0.1036)[:-1],
    "0012 blunt": naca(0.0, 0.4, 0.12),
    "9306 blunt": naca(0.09, 0.3, 0.06),
    "6412 coarse": naca(0.06, 0.4, 0.12, count=15),
}
NOSE, CHORD = shapes.Chord(), shapes.Chord([0, 0, 0], [1, 0, 0], [0, 0, 1])


def noisy(x, seed):
    """The nearest number on either side of each coordinate."""
    return np.nextafter(x, np.random.default_rng(seed).choice([-np.inf, np.inf], x.shape))


def is_upper(x):
    return np.arange(len(x)) <= len(x) // 2


@pytest.mark.parametrize("name", SECTIONS)
def test_sides_are_those_of_the_section(name):
    x = SECTIONS[name]
    upper, loop, mixed = is_upper(x), around(x), np.random.default_rng(0).permutation(len(x))
    np.testing.assert_array_equal(shapes.upper_side(x, NOSE), upper)
    np.testing.assert_array_equal(shapes.upper_side(x, NOSE, wall=loop), upper)
    np.testing.assert_array_equal(shapes.upper_side(x, NOSE, wall=np.roll(loop[::-1], 7)), upper)
    np.testing.assert_array_equal(shapes.upper_side(x[mixed], NOSE), upper[mixed])
    flipped = shapes.upper_side(x * [1, -1], shapes.Chord(up=[0.0, -1.0]))
    np.testing.assert_array_equal(flipped, upper)
    turned = np.asarray(shapes.rotate(x, 0.7, [0.3, 0.2])) * 5
    ends = np.asarray(shapes.rotate(np.array([[0.0, 0.0], [1.0, 0.0]]), 0.7, [0.3, 0.2])) * 5
    np.testing.assert_array_equal(shapes.upper_side(turned, shapes.Chord(*ends)), upper)


@pytest.mark.parametrize("name", SECTIONS)
def test_round_off_flips_no_node(name):
    x = SECTIONS[name]
    upper, loop = shapes.upper_side(x), around(x)
    for seed in range(10):
        near = noisy(x, seed)
        np.testing.assert_array_equal(shapes.upper_side(near), upper)
        np.testing.assert_array_equal(shapes.upper_side(near, wall=loop), upper)


def test_sides_of_a_mesh_are_those_of_its_nodes():
    mesh = cases.naca4("4412", points=2000)
    nodes, loop = mesh.patch("airfoil"), shapes.wall_loop(mesh, "airfoil")
    upper = shapes.upper_side(mesh.points, wall=loop)
    assert not upper[np.setdiff1d(np.arange(len(mesh.points)), nodes)].any()
    np.testing.assert_array_equal(shapes.upper_side(np.asarray(mesh.points)[nodes]), upper[nodes])


def test_coincident_nodes_of_a_cut_have_a_side_each_along_the_wall():
    x = cusped()
    tail = len(x) // 2
    cut = np.concatenate([x, x[tail : tail + 1]])
    loop = np.append(around(x), len(x))  # the lower side ends at the copy
    for shift, seed in ((0, 0), (5, 1), (60, 2)):
        upper = shapes.upper_side(noisy(cut, seed), wall=np.roll(loop, shift))
        np.testing.assert_array_equal(upper, np.append(is_upper(x), False))
    assert shapes.upper_side(cut)[[tail, -1]].all()  # points alone: both are the tail


def test_a_wing_is_told_apart_by_its_faces():
    x = cusped()
    points, quads = extruded(x[around(x)])
    rows = np.tile(is_upper(x)[around(x)], 3)
    upper = shapes.upper_side(points, CHORD, wall=quads)
    np.testing.assert_array_equal(shapes.upper_side(points, CHORD, wall=quads[:, ::-1]), upper)
    edge = (points[:, 0] == 0) | (points[:, 0] == 1)
    np.testing.assert_array_equal(upper[~edge], rows[~edge])
    np.testing.assert_array_equal(shapes.upper_side(noisy(points, 0), CHORD, wall=quads), upper)


@pytest.mark.slow
def test_a_cusped_section_is_fitted_on_its_own_sides():
    x = cusped(81, spacing=1.5)
    for wall in (None, around(x)):
        _, result = shapes.fit_cst(x, 8, chord=NOSE, wall=wall)
        assert float(result.max_residual) < 2e-3


def test_a_tilted_chord_of_a_section_without_a_node_at_its_nose():
    x = naca(0.0, 0.4, 0.12)[1:]
    for seed in range(5):
        chord = shapes.Chord.along(noisy(x, seed))
        np.testing.assert_allclose(chord.nose[1], 0, atol=1e-12)
        np.testing.assert_array_equal(shapes.upper_side(noisy(x, seed)), np.arange(len(x)) < 60)


test_walls_that_are_none_are_refused = refusals(
    (lambda: shapes.upper_side(cusped(), wall=[0, 1]), "three different nodes"),
    (lambda: shapes.upper_side(cusped(), wall=[0, 1, 2, 0]), "three different nodes"),
    (lambda: shapes.upper_side(cusped(), wall=[0, 1, 500]), "not in 0 to 127"),
    (lambda: shapes.upper_side(np.linspace([0, 0], [1, 0.5], 9)), "two sides"),
    (lambda: shapes.upper_side(extruded(cusped())[0], CHORD), "`wall` is missing"),
    (lambda: shapes.fit_cst(cusped(), 3, wall=np.arange(100)), "100 of 128 points"),
)


SHARED = pathlib.Path(__file__).parents[2] / "shared" / "cases"


@pytest.mark.skipif(not SHARED.is_dir(), reason="needs the shared cases")
@over("name", ["naca0012-euler/naca0012_inv.su2"], nightly=["naca0012-cgrid/n0012_225-65.su2"])
def test_sides_of_meshes_that_others_made(name):
    mesh = io.read(SHARED / name)
    nodes, points = mesh.patch("airfoil"), np.asarray(mesh.points)
    upper = shapes.upper_side(points, wall=shapes.wall_loop(mesh, "airfoil"))[nodes]
    np.testing.assert_array_equal(shapes.upper_side(points[nodes]), upper)
    off = points[nodes, 1] != 0
    np.testing.assert_array_equal(upper[off], points[nodes, 1][off] > 0)
    assert upper[~off].all()  # nose and tail
    for seed in range(5):
        np.testing.assert_array_equal(shapes.upper_side(noisy(points[nodes], seed)), upper)
