"""The k-d tree reduction (section 2.1 of the paper) against a plain reference, and its options one by one."""

import itertools

import numpy as np
import pytest
from cases import body
from meshes import lattice, naca
from runs import refusals
from scipy.spatial.distance import cdist, pdist

import jaxmorph as jm
from jaxmorph import cases as jm_cases
from jaxmorph._host.package.rounding import roundoff
from jaxmorph._host.sources.farthest import Filled


def reference(points, leaves, local):
    """The five steps in plain Python: split the fullest box at the median of its longest side, search from its corners."""
    boxes = [sorted(map(tuple, points))]
    while len(boxes) < leaves:
        fullest = max(boxes, key=len)
        boxes.remove(fullest)
        sides = [
            max(p[k] for p in fullest) - min(p[k] for p in fullest) for k in range(len(points[0]))
        ]
        along = sorted(fullest, key=lambda p: p[sides.index(max(sides))])
        boxes += [along[: (len(along) + 1) // 2], along[(len(along) + 1) // 2 :]]
    found = set()
    for box in boxes:
        low, high = np.min(box, axis=0), np.max(box, axis=0)
        for corner in local:
            search = (low + high) / 2 + (high - low) / 2 * np.array(corner)
            found.add(min(range(len(points)), key=lambda i: sum((points[i] - search) ** 2)))
    return sorted(found)


LOCAL = {
    jm.Centre(): lambda d: [(0,) * d],
    jm.Corners(): lambda d: list(itertools.product((-1, 1), repeat=d)),
    jm.GaussPoints(): lambda d: list(itertools.product((-(3**-0.5), 3**-0.5), repeat=d)),
}


@pytest.mark.parametrize("search", LOCAL, ids=lambda search: type(search).__name__)
@pytest.mark.parametrize(("dimension", "leaves"), [(2, 1), (2, 2), (2, 8), (3, 1), (3, 4), (3, 16)])
def test_against_the_reference(search, dimension, leaves):
    points = (
        np.random.default_rng(dimension * leaves).normal(size=(64, dimension)) ** 3
    )  # dense in the middle
    chosen = jm.KDTree(leaves, search, separation=0.0)(points)
    assert chosen.tolist() == reference(points, leaves, LOCAL[search](dimension))


def test_the_papers_source_numbers():
    """One leaf gives an airfoil its 4 sources; a far field split in two has 6: the boxes share none of their corners' nodes."""
    mesh = jm_cases.naca0015(points=3000)
    assert len(jm.KDTree(1)(mesh.points[mesh.patch("airfoil")])) == 4
    assert len(jm.KDTree(2)(mesh.points[mesh.patch("farfield")])) == 6


@pytest.mark.parametrize(
    "reduction",
    [
        *(jm.KDTree(7), jm.KDTree(5, jm.GaussPoints(), extremes=True), jm.AllPoints()),
        *(jm.FarthestPoints(40), jm.FarthestPoints(40, extremes=True), jm.Greedy(30), jm.Graded()),
    ],
)
@pytest.mark.parametrize("dimension", [2, 3])
def test_order_does_not_matter_and_nothing_is_named_twice(reduction, dimension):
    grid = lattice(*[np.linspace(0, 1, 9)] * dimension)  # ties everywhere
    for points in (body(dimension).points, grid):
        order = np.random.default_rng(0).permutation(len(points))
        first, again, shuffled = reduction(points), reduction(points), reduction(points[order])
        assert (first == again).all()
        assert (np.diff(first) > 0).all()
        assert set(map(tuple, points[first])) == set(map(tuple, points[order][shuffled]))


@pytest.mark.parametrize("size", [2.0**-30, 2.0**30])
def test_the_unit_of_length_does_not_matter(size):
    points = body(3).points
    for reduction in (jm.KDTree(16), jm.KDTree(16, extremes=True), jm.FarthestPoints(30)):
        assert (reduction(size * points) == reduction(points)).all()


def test_boxes_are_split_until_small_enough():
    """The limits on the leaves: every box obeys them, and holds its own points alone."""
    points = np.random.default_rng(1).normal(size=(500, 2)) ** 3

    def members(tree):
        boxes = tree.boxes(points)
        inside = [((points >= low) & (points <= high)).all(axis=1) for low, high in boxes]
        assert np.sum(inside) == len(points)
        return boxes, np.sum(inside, axis=1)

    _, counts = members(jm.KDTree(points_per_leaf=20))
    assert counts.min() >= 10
    assert counts.max() <= 20
    boxes, counts = members(jm.KDTree(largest_box=2.0))
    assert np.ptp(boxes, axis=1).max() <= 2.0
    assert counts.max() > 20
    boxes, counts = members(jm.KDTree(64, smallest_box=0.5))
    assert len(boxes) <= 64
    assert (
        np.ptp(boxes, axis=1).max(axis=1)[counts > 20] <= 0.5
    ).all()  # only these are left whole
    assert len(members(jm.KDTree(13))[0]) == 13
    assert len(jm.KDTree(1000).boxes(points)) == 500  # one point each, then it ends


def test_limits_on_leaves_at_equality():
    """A box as long as `smallest_box` is whole; one as long as `largest_box`, or as full as `points_per_leaf`, is not split."""
    points = np.stack([np.linspace(0, 1, 8), np.zeros(8)], axis=1)
    for name, whole, split in (
        ("smallest_box", 1.0, 0.999),
        ("largest_box", 1.0, 0.999),
        ("points_per_leaf", 8, 4),
    ):
        least = {"leaves": 2} if name == "smallest_box" else {}
        assert [
            len(jm.KDTree(**{name: limit}, **least).boxes(points)) for limit in (whole, split)
        ] == [1, 2], name


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("size", [1.0, 1e-6, 1e8])
def test_points_coincide_within_a_few_units_in_the_last_place(dtype, size):
    """Half of 8 units of the largest coordinate is round-off, twice 8 units are not: with `AllPoints` and without separation."""
    unit = np.finfo(dtype).eps
    for units, distinct in [(4, 3), (16, 4)]:
        points = (size * np.array([[1, 0], [1 - units * unit, 0], [0, 1], [0, 0]])).astype(dtype)
        assert roundoff(points) == pytest.approx(8 * unit * size, rel=1e-6)
        if dtype is np.float64:
            assert len(jm.AllPoints()(points)) == distinct
            assert len(jm.KDTree(8, separation=0.0)(points)) == distinct


@pytest.mark.parametrize("make", [jm.KDTree, jm.FarthestPoints, jm.Greedy])
def test_separation(make):
    """Sources keep their distance; where farthest points stop, no other point is farther from them."""
    points = np.concatenate(
        [np.random.default_rng(2).normal(size=(200, 2)), [[0.0, 0.0], [1e-9, 0.0]]]
    )
    wide, least = make(64, separation=0.05)(points), 0.05 * np.linalg.norm(np.ptp(points, axis=0))
    assert pdist(points[wide]).min() > least
    assert 10 < len(wide) < len(make(64, separation=0.0)(points))
    if make is jm.FarthestPoints:
        assert cdist(points, points[make(200, separation=0.05)(points)]).min(axis=1).max() <= least


def test_extremes():
    """The nodes at which the wall touches its bounding box: a blunt trailing edge has two, and both are sources."""
    x = (1 - np.cos(np.linspace(0, np.pi, 60))) / 2
    half = 0.06 * np.sqrt(x) * (1 - x) + 0.004 * x
    points = np.concatenate([np.stack([x, half], axis=1), np.stack([x, -half], axis=1)])
    chosen = set(jm.KDTree(1, jm.Centre(), extremes=True)(points).tolist())
    assert {59, 119} <= chosen  # trailing edge, upper and lower
    assert chosen & {0, 60}  # nose
    assert {int(half.argmax()), 60 + int(half.argmax())} <= chosen
    assert not {59, 119} <= set(jm.KDTree(1, jm.Centre())(points).tolist())


def test_all_points_takes_one_of_coincident_ones():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 0.0], [1.0, 1.0], [1.0, 0.0]])
    assert jm.AllPoints()(points).tolist() == [0, 1, 3]


@pytest.mark.parametrize("count", [0, 1, 2])
def test_hardly_any_points(count):
    points = np.arange(2.0 * count).reshape(count, 2)
    more = jm.FarthestPoints(4, extremes=True), jm.Greedy(4), jm.Graded()
    for reduction in (jm.KDTree(4), jm.KDTree(4, extremes=count > 0), jm.AllPoints(), *more):
        assert reduction(points).tolist() == list(range(count))


test_options_that_make_no_sense = refusals(
    (jm.KDTree, "needs `leaves`"),
    (lambda: jm.KDTree(1, smallest_box=2.0, largest_box=1.0), "smallest_box <= largest_box"),
)


def test_tree_with_about_so_many_sources():
    mesh = jm_cases.naca0015(points=3000)
    points = mesh.points[mesh.patch("airfoil")]
    for count in (6, 20, 45):
        leaves = jm.KDTree.with_sources(count, points).leaves
        missed = {
            k: abs(len(jm.KDTree(k, extremes=True)(points)) - count) for k in range(1, count + 1)
        }
        assert missed[leaves] <= min(missed.values()) + 1
    least = len(jm.KDTree(1, extremes=True)(points))
    assert len(jm.KDTree.with_sources(least, points)(points)) == least
    with pytest.raises(ValueError, match="`count` must be 3 or more in 2-D, not 2"):
        jm.KDTree.with_sources(2, points)


@pytest.mark.parametrize("shift", [(1e4, 0), (-1e4, 3e3), (1e6, 0)])
@pytest.mark.parametrize(
    "reduction",
    [
        jm.KDTree(16, extremes=True, crowded=32),
        jm.KDTree(64),
        jm.FarthestPoints(50),
        jm.Graded(0.25),
        jm.Graded(0.01),
        Filled(),
    ],
    ids=repr,
)
def test_far_from_the_origin_a_symmetric_section_has_the_same_sources(reduction, shift):
    """There the last digits of its coordinates are coarse, and decide no tie."""
    upper = naca(0.0, 0.4, 0.12, 75, last=0.1036)[:75]
    points = np.concatenate([upper, upper[1:-1] * [1, -1]])
    others = np.array([[0.5, -3.0], [0.5, 3.0], [-4.0, 0.5], [-4.0, -0.5]])
    sources = reduction.beside(points, others)
    for seed in range(3):
        up = np.random.default_rng(seed).random(points.shape) < 0.5
        moved = np.nextafter(points + shift, np.where(up, np.inf, -np.inf))
        np.testing.assert_array_equal(reduction.beside(moved, others + shift), sources)
