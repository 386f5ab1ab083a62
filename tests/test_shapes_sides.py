"""The sides of airfoils: sections whose nodes are known to be upper or lower ones, as they are and with round-off added."""

import pathlib

import numpy as np
import pytest
from meshes import naca
from runs import over, refusals

import jaxmorph as jm
from jaxmorph import cases, io, shapes


def cusped(count=65, gap=0.0):
    """A section like the RAE 2822: thin, cusped and cambered behind. The upper side comes first, from the nose, then the lower."""
    x = 0.5 * (1 - np.cos(np.linspace(0, np.pi, count)))
    half = 0.155 * np.sqrt(x) * (1 - x) ** 1.5 + 0.5 * gap * x
    line = 0.11 * x**3 * (1 - x)
    lower = np.column_stack([x, line - half])[1 : None if gap else -1]
    return np.concatenate([np.column_stack([x, line + half]), lower])


def inside(x):
    """The inside of rows of `naca` and `cusped`, in triangles from the upper to the lower side."""
    count = len(x) // 2 + 1
    upper = np.arange(count)
    lower = np.append(0, np.arange(count, 2 * count - 1))
    lower[-1] = lower[-1] if lower[-1] < len(x) else count - 1
    ahead = np.column_stack([lower[:-1], lower[1:], upper[:-1]])
    behind = np.column_stack([lower[1:], upper[1:], upper[:-1]])
    triangles = np.concatenate([ahead[1:], behind if len(x) % 2 else behind[:-1]])
    return jm.Mesh(x, {"triangle": triangles}, {"wall": np.arange(len(x))})


def extruded(mesh, layers=3):
    """A wing of wedges, y along the span, layer by layer."""
    count = len(mesh.points)
    flat = np.insert(mesh.points, 1, 0, axis=1)
    points = np.concatenate([flat + np.array([[0, y, 0]]) for y in range(layers)])
    below = np.concatenate([mesh.cells["triangle"] + k * count for k in range(layers - 1)])
    cells = {"wedge": np.hstack([below, below + count])}
    return jm.Mesh(points, cells, {"wall": np.arange(len(points))})


SECTIONS = {
    "cusped": cusped(),
    "cusped and blunt": cusped(gap=0.002),
    "0012 sharp": naca(0.0, 0.4, 0.12, last=0.1036)[:-1],
    "0012 blunt": naca(0.0, 0.4, 0.12),
    "9306 blunt": naca(0.09, 0.3, 0.06),
    "6412 coarse": naca(0.06, 0.4, 0.12, count=15),
}
DOWN = [0.0, -1.0]
"""Up for a mesh inside of its wall."""


def noisy(mesh, seed):
    """The nearest number on either side of each coordinate."""
    away = np.random.default_rng(seed).choice([-np.inf, np.inf], mesh.points.shape)
    return mesh.moved(np.nextafter(mesh.points, away))


@pytest.mark.parametrize("name", SECTIONS)
def test_sides_are_those_of_the_section(name):
    """But for the nodes of nose and tail, which have the side to which they look."""
    x = SECTIONS[name]
    mesh = inside(x)
    upper = shapes.upper_side(mesh, "wall", chord=shapes.Chord(up=DOWN))
    inner = (x[:, 0] > 0.005) & (x[:, 0] < 0.999)
    np.testing.assert_array_equal(upper[inner], (np.arange(len(x)) <= len(x) // 2)[inner])
    turned = mesh.moved(np.asarray(shapes.rotate(x, 0.7, [0.3, 0.2])) * 5)
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, -1.0]])
    nose, tail, down = np.asarray(shapes.rotate(corners, 0.7, [0.3, 0.2])) * 5
    chord = shapes.Chord(nose, tail, down - nose)
    np.testing.assert_array_equal(
        shapes.upper_side(turned, "wall", chord=chord)[inner], upper[inner]
    )
    chord = shapes.Chord([0, 0, 0], [1, 0, 0], [0, 0, -1])
    wing = shapes.upper_side(extruded(mesh), "wall", chord=chord)
    np.testing.assert_array_equal(wing[len(x) : 2 * len(x)][inner], upper[inner])


@pytest.mark.parametrize("name", SECTIONS)
def test_round_off_flips_no_node(name):
    mesh = inside(SECTIONS[name])
    upper = shapes.upper_side(mesh, "wall")
    for seed in range(10):
        np.testing.assert_array_equal(shapes.upper_side(noisy(mesh, seed), "wall"), upper)


def test_a_blunt_tail_is_cut_at_the_chord():
    """A base's nodes look along the chord, so that their height tells."""
    mesh = cases.naca0015(points=2000)
    x = np.asarray(mesh.points)[mesh.patch("airfoil")]
    upper = shapes.upper_side(mesh, "airfoil")
    assert (x[:, 0] == 1).sum() > 2
    np.testing.assert_array_equal(upper, x[:, 1] > -1e-12)


def test_a_tilted_chord_of_a_section_without_a_node_at_its_nose():
    x = naca(0.0, 0.4, 0.12)[1:]
    for seed in range(5):
        away = np.random.default_rng(seed).choice([-np.inf, np.inf], x.shape)
        np.testing.assert_allclose(shapes.Chord.along(np.nextafter(x, away)).nose[1], 0, atol=1e-12)


test_walls_that_are_none_are_refused = refusals(
    (lambda: shapes.upper_side(extruded(inside(cusped())), "wall"), "`chord` is missing"),
    (lambda: shapes.upper_side(inside(cusped()), "tail"), "no patch"),
)


SHARED = pathlib.Path(__file__).parents[2] / "shared" / "cases"


@pytest.mark.skipif(not SHARED.is_dir(), reason="needs the shared cases")
@over("name", ["naca0012-euler/naca0012_inv.su2"], nightly=["naca0012-cgrid/n0012_225-65.su2"])
def test_sides_of_meshes_that_others_made(name):
    mesh = io.read(SHARED / name)
    heights = np.asarray(mesh.points)[mesh.patch("airfoil"), 1]
    upper = shapes.upper_side(mesh, "airfoil")
    np.testing.assert_array_equal(upper, heights >= 0)
    for seed in range(5):
        np.testing.assert_array_equal(shapes.upper_side(noisy(mesh, seed), "airfoil"), upper)
