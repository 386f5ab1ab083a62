"""Boundaries that are not what they are said to be, and what moved ones are judged by."""

import re

import jax
import numpy as np
import pytest
from cases import full
from meshes import box_with_hole, drum, joined, ring, sector
from runs import refusals

import jaxmorph as jm

TPS = full(jm.ThinPlateSpline(), 1)
AXIS = jm.Revolution((0, 0, 3))
LEFT = box_with_hole().patch("left")


def with_empty_patch():
    mesh = ring()
    return jm.Mesh(mesh.points, mesh.cells, dict(mesh.patches) | {"none": []})


test_what_is_empty_has_a_sentence = refusals(
    (lambda _: jm.prepare(with_empty_patch(), "wall", "none"), "'none', have no nodes"),
    (lambda _: jm.prepare(with_empty_patch(), "none", "far"), "`moving` is empty: name the nodes"),
    (lambda _: jm.Facets(np.zeros((3, 2)), np.array([[0, 1], [1, 2]])), "has no extent"),
    (
        lambda folder: jm.export(
            jm.prepare(ring(), "wall", "far", method=jm.DelaunayGraph()), folder, nodes=[]
        ),
        "a process without points needs no plan",
    ),
    of=lambda: ("empty.plan",),
)


def arc():
    """The upper half of a ring: its outer polygon has two ends."""
    mesh = ring(16, (1, 1.5, 2), ("inner", "outer"))
    upper = mesh.points[:, 1] > -1e-9
    place = np.cumsum(upper) - 1
    quads = mesh.cells["quad"][upper[mesh.cells["quad"]].all(axis=1)]
    patches = {name: place[nodes[upper[nodes]]] for name, nodes in mesh.patches.items()}
    return jm.Mesh(mesh.points[upper], {"quad": place[quads]}, patches)


def on_box(*lists, **keywords):
    return lambda: jm.prepare(box_with_hole(), *lists, method=TPS, **keywords)


def on_drum(*lists, **keywords):
    return lambda: jm.prepare(drum(), *lists, method=TPS, **keywords)


def on_pairs(of, move=slice(None)):
    points, moving, fixed, sides, _ = sector(2)
    return lambda: jm.prepare(points, moving[move], fixed, periodic=of(*sides), method=TPS)


def on_sector(move=slice(None), **keywords):
    return on_pairs(lambda *sides: jm.Periodic(*sides, **keywords), move)


def flattened():
    mesh = box_with_hole()
    points = np.array(mesh.points)
    points[mesh.patch("left")] = (-4, 0)
    return jm.prepare(mesh.moved(points), "hole", sliding="left", method=TPS)


def halves(name):
    bricks, nodes = drum(), drum().patch(name)
    return [jm.Slide(nodes[bricks.points[nodes, 0] * side >= -1e-9], AXIS) for side in (1, -1)]


test_what_a_boundary_is_not = refusals(
    (
        on_box("hole", sliding=jm.Slide("left", jm.Plane((1, 0), (0, 0)))),
        r"'left' does not lie on its surface: 9 of 9 nodes are off, the worst is node \d+ at \(-4, .*, 4 away.*Give the right",
    ),
    (
        on_drum("hub", sliding=jm.Slide("shroud", jm.Revolution((0, 0, 1), (0.1, 0, 0)))),
        r"'shroud' does not lie on its surface: \d+ of 60 nodes are off, the worst is node \d+ at \(.*, 0\.2 away",
    ),
    (
        on_sector(rotation=1.0),
        r"5 of 5 nodes of the first have no partner, the worst is node \d+ at \(.*Check `translation`, or `rotation`",
    ),
    (
        on_sector(slice(None, -1), rotation=np.pi / 2),
        r"1 periodic pairs .* node \d+ at \(.*\) is in `moving`, its partner \d+ in neither list. Name both nodes, or none",
    ),
    (
        on_box(("hole", "left"), "right", sliding=("left", "top")),
        r"all 9 nodes of the sliding patch 'left' are in `moving`, first node \d+ at \(-4, -4\): the patch would not slide",
    ),
    (
        on_box(LEFT[-3:], "right", sliding=("left", "top")),
        r"1 moving nodes are corners of sliding patches and cannot move, the first is node \d+ at \(-4, 4\)\. Remove them from",
    ),
    (
        on_box("hole", ("left", "right"), sliding=("left", "top")),
        r"the patch 'left' is named in `sliding` and in `fixed`: it would not slide. Remove it from one list",
    ),
    (
        on_box("hole", "right", sliding="left", symmetry="left"),
        "'left' is named in `sliding` and in `symmetry`",
    ),
    (
        on_box("hole", box_with_hole().patch("left", "right"), sliding=("left", "top")),
        r"all 9 nodes of the sliding patch 'left' are in `fixed`, first node \d+ at \(-4, .*\): the patch would not slide\.",
    ),
    (on_pairs(lambda a, b: joined(2, (a[1:], b))), "1 of 5 nodes of the second have no partner"),
    (on_pairs(lambda a, b: jm.Periodic(a, a)), "the translation is zero"),
    (on_sector(translation=(1, 0), rotation=1.0), "a translation or a rotation, not both"),
    (on_box("hole", periodic="lower"), r"pairs such as jm.Periodic\('lower', 'upper'"),
    (
        lambda: jm.prepare(box_with_hole().points, [0], sliding=jm.Slide([5, 6])),
        "but points alone have no faces",
    ),
    (
        lambda: jm.Slide("left", "top"),
        r"a patch slides on a jm\.Plane, a jm\.Revolution or its own faces",
    ),
    (
        on_box("hole", sliding=jm.Slide("left", AXIS)),
        "a surface of revolution has an axis in 3-D, and none in 2-D",
    ),
    (
        on_box("hole", sliding="hole"),
        "all 8 nodes of the sliding patch 'hole' are in `moving`, first node 30 at",
    ),
    (
        on_box("hole", sliding=["left", jm.Slide("left", jm.Plane((1, 0), (-4, 0)))]),
        "'left' comes twice in `sliding`",
    ),
    (
        on_box("hole", sliding=[*map(jm.Slide, (LEFT[:5], LEFT[4:]))]),
        r"at 1 nodes without an edge, .* node 4 at \(-4, 0\)",
    ),
    (flattened, r"all 9 nodes of the sliding patch 'left' stand at \(-4, 0\)"),
    (
        lambda: jm.Revolution((1, 0, 0), profile=[(1, 1), (0, 1)]),
        "places along the axis, ascending, and radii",
    ),
    (
        on_drum("hub", ("bottom", "top"), sliding=halves("shroud")),
        r"meet at 10 nodes without an edge, the worst is node \d+ at \(.*Let both slide as one patch, jm\.Slide\(\(first",
    ),
)


@pytest.mark.nightly
def test_a_moved_boundary_is_judged():
    mesh = arc()
    base, inner, outer = mesh.points, mesh.patch("inner"), mesh.patch("outer")
    plan = jm.prepare(
        mesh,
        "inner",
        sliding="outer",
        free=np.arange(len(base)),
        method=full(jm.ThinPlateSpline(), 1),
    )
    turned = [
        np.asarray(jm.shapes.rotate(base[inner], angle, about=(0, 0))) - base[inner]
        for angle in (0.02, 0.9)
    ]
    few, many = (jm.inspect(plan, u) for u in turned)
    assert not few.warnings
    assert len(many.ended) > 1
    assert set(many.ended) < set(outer[1:-1])
    assert f"{len(many.ended)} sliding nodes come to the end of their surface" in str(many)
    judged = jm.boundary_quality(plan, jm.deform(plan, turned[0]))
    assert judged.off_surface < 1e-14
    assert judged.mismatch == judged.off_plane == 0
    lifted = np.array(base)
    lifted[outer[3]] *= 1.1
    judged = jm.boundary_quality(plan, lifted)
    assert judged.off_surface == pytest.approx(0.2 * np.cos(np.pi / 16), rel=0.03)
    assert judged.nodes == {"off_surface": outer[3]}
    assert (
        f"sliding nodes at most {judged.off_surface:.2g} off their surface (node {outer[3]})"
        in str(judged)
    )


@pytest.mark.slow
def test_pairs_and_planes_are_judged():
    points, moving, fixed, sides, u = sector(2)
    plan = jm.prepare(points, moving, fixed, method=TPS, periodic=joined(2, sides))
    assert jm.boundary_quality(plan, jm.deform(plan, u)).mismatch < 1e-14
    torn = np.array(points)
    torn[sides[1][2]] += [0.3, 0.4]
    judged = jm.boundary_quality(plan, torn)
    assert judged.mismatch == pytest.approx(0.5, rel=1e-12)
    assert judged.nodes == {"mismatch": sides[0][2]}
    off = np.array(u)
    off[np.isin(moving, sides[0])] += 0.1
    told = re.search(
        r"moving nodes do not go where `u` sends them.*?by ([\d.]+):", str(jm.inspect(plan, off))
    )
    assert float(told[1]) > 0.04


@pytest.mark.parametrize("of_mesh", [True, False], ids=["mesh", "points"])
def test_a_boundary_and_a_mesh_are_what_was_checked(of_mesh):
    """No array of theirs can be written into, none is the caller's, and a second mesh takes no copy."""
    mesh = box_with_hole()
    points = np.array(mesh.points)
    cells = {kind: np.array(ids) for kind, ids in mesh.cells.items()}
    patches = {name: np.array(ids) for name, ids in mesh.patches.items()}
    lists = [np.array(mesh.patch(name)) for name in ("hole", "right")]
    plane = jm.Plane([-1.0, 0.0], points[LEFT[0]])
    sliding = [jm.Slide("bottom")] if of_mesh else []
    copy = jm.Mesh(points, cells, patches)
    boundary = jm.Boundary(copy if of_mesh else points, *lists, symmetry=plane, sliding=sliding)
    for given in (points, *cells.values(), *patches.values(), *lists):
        given[...] = 0
    held = [leaf for leaf in jax.tree.leaves([*vars(boundary).values(), copy]) if np.ndim(leaf)]
    assert len(held) > 8
    for array in held:
        assert not isinstance(array, np.ndarray) or not array.flags.writeable
    np.testing.assert_array_equal(boundary.points, mesh.points)
    np.testing.assert_array_equal(boundary.moving, mesh.patch("hole"))
    np.testing.assert_array_equal(copy.cells["quad"], mesh.cells["quad"])
    again = jm.Mesh(copy.points, copy.cells, copy.patches)
    assert np.shares_memory(again.points, copy.points)
    assert np.shares_memory(again.moved(copy.points).points, copy.points)
    assert np.shares_memory(jm.Boundary(copy, "hole", "right").points, copy.points)
    back = copy.points[::-1]
    assert np.shares_memory(again.moved(back).points, copy.points)
