"""Laws on generated point sets: each holds, or a `ValueError` says what to change; never another exception, never NaN.

JAXMORPH_FUZZ sets how many, a hundredth of it for each law and method; JAXMORPH_FUZZ_SEED another series of them.
"""

import dataclasses
import itertools
import os
import warnings

import hypothesis
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.spatial
from hypothesis import strategies
from meshes import lattice

import jaxmorph as jm

COUNT, SEED = (
    int(os.environ.get("JAXMORPH_FUZZ", "200")) // 100,
    int(os.environ.get("JAXMORPH_FUZZ_SEED", "0")),
)
SIZES = (1, 2, 3, 4, 6, 17, 60)
"""Numbers of points: few, since each compiles anew."""

pytestmark = pytest.mark.nightly


@dataclasses.dataclass(frozen=True)
class Cloud:
    """Points, the ids of those that move and of those that stay, their displacements, and how large the set is."""

    points: np.ndarray
    moving: np.ndarray
    fixed: np.ndarray
    u: np.ndarray
    size: float

    @property
    def round_off(self) -> float:
        """What rounding makes of coordinates: a length."""
        return 1e-16 * max(
            np.abs(self.points).max(), np.abs(self.points[self.moving] + self.u).max()
        )


SHAPES = {
    "scattered": lambda x: x,
    "flat": lambda x: x * (np.arange(x.shape[1]) > 0),
    "collinear": lambda x: x[:, :1] * np.arange(1.0, x.shape[1] + 1),
    "cospherical": lambda x: x / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-3),
    "lattice": lambda x: np.round(2 * x) / 2,
    "duplicate": lambda x: np.concatenate([x[: (len(x) + 1) // 2]] * 2)[: len(x)],
    "almost duplicate": lambda x: np.concatenate(
        [x[: (len(x) + 1) // 2], x[: len(x) // 2] * (1 + 1e-15)]
    ),
    "stretched": lambda x: x * 1e-7 ** np.arange(x.shape[1]),
    "one place": lambda x: 0 * x,
}


@strategies.composite
def clouds(draw, sizes=SIZES):
    n, d = draw(strategies.sampled_from(sizes)), draw(strategies.sampled_from((2, 3)))
    rng = np.random.default_rng(draw(strategies.integers(0, 2**16)))
    scale = draw(strategies.sampled_from((1.0, 1e-12, 1e-3, 1e6, 1e12)))
    offset = draw(strategies.sampled_from((0.0, 1.0, 1e4)))
    shape = SHAPES[draw(strategies.sampled_from(sorted(SHAPES)))]
    points = scale * (shape(rng.uniform(-1, 1, (n, d))) + offset)
    order = rng.permutation(n)
    count = {"one": 1, "half": (n + 1) // 2, "all": n}[
        draw(strategies.sampled_from(("one", "half", "all")))
    ]
    rest = {"none": 0, "some": (n - count) // 2, "all": n - count}[
        draw(strategies.sampled_from(("none", "some", "all")))
    ]
    u = scale * draw(strategies.sampled_from((1e-3, 0.1, 10.0))) * rng.normal(size=(count, d))
    return Cloud(points, order[:count], order[count : count + rest], u, scale)


METHODS = {
    "default": lambda size: None,
    "published": lambda size: jm.SurfaceReconstruction.published(),
    "delaunay": lambda size: jm.DelaunayGraph(),
    "full": lambda size: jm.RBF.classic(jm.ThinPlateSpline()),
    "near-wall": lambda size: jm.NearWall(),
    "multiscale": lambda size: jm.Multiscale(),
    "inverse-distance": lambda size: jm.InverseDistance(),
    "compact": lambda size: jm.CompactRBF(2 * size),
    "reduced": lambda size: jm.RBF(reduction=jm.KDTree(2), fixed_reduction=jm.KDTree(2)),
}
INEXACT = ("full", "reduced")
"""Methods that miss the wall by what their sources leave, or by the rounding of their solve."""


def told(error: ValueError) -> None:
    """Checks that an error is a sentence for people."""
    assert len(str(error)) > 30, repr(error)
    assert type(error).__module__.startswith(("builtins", "jaxmorph")), repr(error)


def answered(verb):
    """The answer of a call, or None where a sentence says what to change."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of what rounding costs
            return verb()
    except ValueError as error:
        return told(error)


def check_laws(cloud: Cloud, name: str) -> bool:
    """Checks that the laws hold; False where `prepare` refused the points."""
    plan = answered(
        lambda: jm.prepare(
            cloud.points, cloud.moving, cloud.fixed, method=METHODS[name](cloud.size)
        )
    )
    if plan is None:
        return False
    moved, still = (np.asarray(jm.deform(plan, u)) for u in (cloud.u, 0 * cloud.u))
    assert np.isfinite(moved).all()
    np.testing.assert_array_equal(still, cloud.points)
    if name not in INEXACT:
        np.testing.assert_array_equal(moved[cloud.moving], cloud.points[cloud.moving] + cloud.u)
        np.testing.assert_array_equal(moved[cloud.fixed], cloud.points[cloud.fixed])
    if not plan.is_linear:
        return True
    pushed, largest = moved - cloud.points, np.abs(cloud.u).max()
    reach = max(np.abs(pushed).max(), largest)  # a solve may overshoot
    twice = np.asarray(jm.deform(plan, 2 * cloud.u)) - cloud.points
    np.testing.assert_allclose(twice, 2 * pushed, rtol=0, atol=1e-12 * reach + 20 * cloud.round_off)
    w = np.random.default_rng(0).normal(size=moved.shape)
    pulled = np.asarray(jm.pullback(plan, cloud.u, w))
    assert np.isfinite(pulled).all()
    rounded = cloud.round_off * np.abs(w).sum() + 1e-9 * (
        np.abs(w).sum() * reach + np.vdot(np.abs(pulled), np.abs(cloud.u))
    )
    assert abs(np.vdot(pushed, w) - np.vdot(cloud.u, pulled)) <= 20 * rounded
    return True


def examples(count):
    return hypothesis.settings(
        max_examples=max(count, 2),
        derandomize=SEED == 0,
        deadline=None,
        database=None,
        suppress_health_check=list(hypothesis.HealthCheck),
    )


def seeded(law):
    """Makes another series repeatable."""
    return hypothesis.seed(SEED)(law) if SEED else law


@pytest.mark.parametrize("name", METHODS)
def test_maps_of_any_points(name):
    held = []

    @seeded
    @examples(COUNT)
    @hypothesis.given(clouds())
    def law(cloud):
        held.append(check_laws(cloud, name))

    law()
    assert any(held) or COUNT < 20, "all points were refused: no law was tried"


@seeded
@examples(COUNT)
@hypothesis.given(clouds(), strategies.sampled_from(("default", "delaunay", "near-wall", "full")))
def test_a_boundary_that_moves_as_one_takes_the_rest_along(cloud, name):
    """By less than the boundary's size, or the rounding of coordinates, allows."""

    def moved() -> np.ndarray:
        plan = jm.prepare(cloud.points, cloud.moving, method=METHODS[name](cloud.size))
        return np.asarray(jm.deform(plan, np.broadcast_to(cloud.u[:1], cloud.u.shape)))

    found, atol = answered(moved), 1e-9 * np.abs(cloud.u[0]).max() + 20 * cloud.round_off
    if found is not None:
        np.testing.assert_allclose(found, cloud.points + cloud.u[:1], rtol=0, atol=atol)


@seeded
@examples(2)
@hypothesis.given(clouds(sizes=(10_000,)), strategies.sampled_from(("default", "inverse-distance")))
def test_many_points(cloud, name):
    check_laws(cloud, name)


@seeded
@examples(COUNT)
@hypothesis.given(clouds(), strategies.integers(0, 2**16))
def test_boxes_around_any_points(cloud, seed):
    """A lattice that does not move leaves every point where it is; one that moves as one takes all in it along."""
    counts = np.random.default_rng(seed).integers(2, 5, cloud.points.shape[1])
    box = answered(lambda: jm.shapes.FreeForm.around(cloud.points, counts.tolist()))
    if box is not None:
        shift = jnp.broadcast_to(jnp.asarray(cloud.u[0]), box.neutral().shape)
        np.testing.assert_array_equal(box(cloud.points, box.neutral()), cloud.points)
        np.testing.assert_allclose(
            box(cloud.points, shift), cloud.points + cloud.u[:1], rtol=0, atol=20 * cloud.round_off
        )


def swapped(cells):
    """The same simplices, numbered the other way round."""
    return np.concatenate([cells[:, 1::-1], cells[:, 2:]], axis=1)


@seeded
@examples(COUNT)
@hypothesis.given(clouds(sizes=(3, 4, 6)), strategies.booleans())
def test_cells_of_any_points(cloud, flipped):
    """Measures are never NaN; a mesh that has not moved has no inverted cell; the ratios of its own are one."""
    n, d = cloud.points.shape
    corners = np.arange(d + 1)[None] if n > d else None
    if corners is None:
        return
    mesh = jm.Mesh(
        cloud.points, {"triangle" if d == 2 else "tetra": swapped(corners) if flipped else corners}
    )
    for report in (jm.quality(mesh), jm.quality(mesh, cloud.points)):
        assert int(report.inverted) == 0
        for name in (
            "skewness",
            "aspect_ratio",
            "non_orthogonality",
            "volume",
            "jacobian",
            "volume_ratio",
            "jacobian_ratio",
        ):
            assert not np.isnan(getattr(report, name)).any(), name
    np.testing.assert_array_equal(report.volume_ratio, 1)
    np.testing.assert_array_equal(report.jacobian_ratio, 1)


GRIDS = ((2, 2), (3, 3), (5, 4), (12, 7), (2, 2, 2), (3, 3, 2), (4, 4, 4), (7, 5, 6))
GRIDS += ((55, 55), (14, 14, 14)) if COUNT >= 100 else ()
"""Numbers of nodes along the axes of a grid; the largest take long to compile, by hand only."""


@strategies.composite
def grids(draw):
    """A grid cut into triangles or tetrahedra, whole sides of which move or stay: graded, shaken, flat, folded."""
    counts, rng = (
        draw(strategies.sampled_from(GRIDS)),
        np.random.default_rng(draw(strategies.integers(0, 2**16))),
    )
    d, ids = len(counts), np.arange(np.prod(counts)).reshape(counts)
    x = lattice(*(np.linspace(0, 1, count) for count in counts))
    shapes = SHAPES | {
        "graded": lambda x: x**8,
        "shaken": lambda x: x + rng.uniform(-1, 1, x.shape) / max(counts),
        "folded": lambda x: np.where(np.arange(d) > 0, x, np.abs(x[:, :1] - 0.4)),
        "layers of no height": lambda x: np.where(np.arange(d) > 0, x, np.round(2 * x[:, :1]) / 2),
    }
    points = shapes[draw(strategies.sampled_from(sorted(shapes)))](x) + draw(
        strategies.sampled_from((0.0, 1e4))
    )
    scale = draw(strategies.sampled_from((1.0, 1e-9, 1e6)))
    corners = lattice(*(np.arange(count - 1) for count in counts))
    paths = np.array(
        [
            [np.isin(range(d), order[:k]) for k in range(d + 1)]
            for order in itertools.permutations(range(d))
        ]
    )
    cells = ids[tuple(np.moveaxis(corners[:, None, None] + paths, -1, 0))].reshape(-1, d + 1)
    turned = np.linalg.det(x[cells[:, 1:]] - x[cells[:, :1]]) < 0
    cells[turned] = swapped(cells[turned])
    side, end = ids[:, 0].ravel(), ids[:, -1].ravel()
    rim = np.flatnonzero(((x == 0) | (x == 1)).any(axis=1))
    moving = {"node": ids.ravel()[:1], "side": side, "rim": rim, "all": ids.ravel()}
    moving = moving[draw(strategies.sampled_from(("side", "rim", "side", "node", "all")))]
    fixed = {"none": rim[:0], "end": end, "rim": rim}[
        draw(strategies.sampled_from(("end", "rim", "end", "none")))
    ]
    u = scale * draw(strategies.sampled_from((1e-3, 0.1, 10.0))) * rng.normal(size=(len(moving), d))
    u = u[:1] + 0 * u if draw(strategies.booleans()) else u
    cells = swapped(cells) if draw(strategies.booleans()) else cells
    cloud = Cloud(scale * points, moving, np.setdiff1d(fixed, moving), u, scale)
    return cloud, jm.Mesh(cloud.points, {"triangle" if d == 2 else "tetra": cells})


@strategies.composite
def tangles(draw):
    """Points, and cells that triangulate others: many are flat, inverted or cross; all may be numbered the other way round."""
    cloud = draw(clouds(sizes=(6, 17)))
    d = cloud.points.shape[1]
    unit = np.random.default_rng(draw(strategies.integers(0, 2**16))).normal(
        size=cloud.points.shape
    )
    cells = scipy.spatial.Delaunay(unit).simplices.astype(np.int64)
    turned = swapped(cells) if draw(strategies.booleans()) else cells
    return cloud, jm.Mesh(cloud.points, {"triangle" if d == 2 else "tetra": turned})


MESHES = grids() | tangles()


def check_mesh_laws(cloud: Cloud, mesh: jm.Mesh) -> bool:
    """Checks that every verb answers in finite numbers and keeps what is given; False where `prepare` or `improve` refused."""
    plan = answered(lambda: jm.prepare(mesh, cloud.moving, cloud.fixed))
    if plan is not None:
        moved = np.asarray(jm.deform(plan, cloud.u))
        assert np.isfinite(moved).all()
        np.testing.assert_array_equal(moved[cloud.moving], cloud.points[cloud.moving] + cloud.u)
        assert not np.isnan(jm.quality(mesh, moved).skewness).any()
        answered(lambda: str(jm.inspect(plan, cloud.u, mesh=mesh)))
    found = answered(
        lambda: jm.improve(jm.Boundary(mesh, (), fixed=cloud.moving), cloud.points, max_steps=3)
    )
    if found is not None:
        assert np.isfinite(found.points).all()
        np.testing.assert_array_equal(
            np.asarray(found.points)[cloud.moving], cloud.points[cloud.moving]
        )
        assert int(found.before) == 0
    return plan is not None and found is not None


def test_meshes_of_any_cells():
    held = []

    @seeded
    @examples(COUNT // 4)
    @hypothesis.given(MESHES)
    def law(case):
        held.append(check_mesh_laws(*case))

    law()
    print(f"{sum(held)} of {len(held)} meshes were taken")
    assert any(held) or COUNT < 20, "all meshes were refused: no law was tried"


@seeded
@examples(COUNT // 20)
@hypothesis.given(MESHES)
def test_advice_on_any_cells(case):
    """What `compare` and `fewest_steps` give is finite and keeps the wall, or a sentence says what to change."""
    cloud, mesh = case
    rivals = {"graph": jm.DelaunayGraph(), "inverse distances": jm.InverseDistance()}
    found = answered(
        lambda: jm.compare(jm.Boundary(mesh, cloud.moving, cloud.fixed), cloud.u[None], rivals)
    )
    if found is not None:
        moved = np.asarray(jm.deform(found.plans[0], cloud.u))
        assert np.isfinite(moved).all()
        np.testing.assert_array_equal(moved[cloud.moving], cloud.points[cloud.moving] + cloud.u)
    plan = answered(lambda: jm.prepare(mesh, cloud.moving, cloud.fixed))
    if plan is not None:
        steps = answered(
            lambda: jm.fewest_steps(plan, mesh, lambda share: share * cloud.u, max_steps=2)
        )
        assert steps is None or np.isfinite(steps.points).all()
