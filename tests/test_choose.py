"""Sources and radius chosen for a family of motions: the table says what is true, and the choice is the cheapest good one."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.interpolate
import scipy.spatial
from meshes import blocks, lattice

import jaxmorph as jm
from jaxmorph import cases
from jaxmorph._advice.choice import best
from jaxmorph._advice.methods import METHODS
from jaxmorph._advice.rivals import MOST_POINTS, Extent


@pytest.fixture(scope="module")
def problem():
    mesh = cases.naca0015(points=1200)
    base = mesh.points[mesh.patch("airfoil")]
    wave = [0.04 * np.sin(k * np.pi * base[:, :1]) * [0, 1] for k in (1, 2)]
    return mesh, mesh.patch("airfoil"), mesh.patch("farfield"), np.stack(wave)


@pytest.fixture(scope="module")
def choice(problem):
    return jm.choose(*problem, leaves=(2, 16), methods={})


@pytest.mark.nightly
def test_the_errors_are_those_of_scipys_interpolation(problem, choice):
    """Thin plate spline with a linear polynomial from the same sources, evaluated by SciPy."""
    mesh, moving, fixed, motions = problem
    row = choice.table[2]
    assert (row["leaves"], row["radius"]) == (16, None)
    surface = mesh.points[np.concatenate([moving, fixed])]
    values = np.zeros((len(surface), 4))
    values[: len(moving)] = np.moveaxis(motions, 0, 1).reshape(len(moving), -1)
    values /= np.abs(values).max()
    chosen = jm.prepare(mesh.points, moving, fixed, method=jm.RBF(reduction=jm.KDTree(16, extremes=True))).surface.ids
    interpolant = scipy.interpolate.RBFInterpolator(
        surface[chosen], values[chosen], kernel="thin_plate_spline", degree=1
    )
    missed = np.sqrt(np.mean((values - interpolant(surface)) ** 2))
    assert len(chosen) == row["sources"]
    np.testing.assert_allclose(row["error"], missed, rtol=1e-6)


@pytest.mark.slow
def test_the_radius_is_no_worse_than_others_that_one_might_guess(problem, choice):
    mesh, moving, fixed, motions = problem
    row = choice.table[3]
    surface = mesh.points[np.concatenate([moving, fixed])]
    ids = jm.prepare(mesh.points, moving, fixed, method=jm.RBF(reduction=jm.KDTree(16, extremes=True))).surface.ids
    values = np.zeros((len(surface), 4))
    values[: len(moving)] = np.moveaxis(motions, 0, 1).reshape(len(moving), -1)
    values /= np.abs(values).max()

    def error(radius):
        r = np.linalg.norm(surface[:, None] - surface[None, ids], axis=2) / radius
        rows = np.hstack([np.maximum(1 - r, 0) ** 4 * (4 * r + 1), np.ones((len(r), 1)), surface])
        matrix = np.zeros((len(ids) + 3,) * 2)
        matrix[: len(ids)] = rows[ids]
        matrix[len(ids) :, : len(ids)] = rows[ids][:, len(ids) :].T
        weights = np.linalg.solve(matrix, np.vstack([values[ids], np.zeros((3, 4))]))
        return np.sqrt(np.mean((values - rows @ weights) ** 2))

    np.testing.assert_allclose(error(row["radius"]), row["error"], rtol=1e-3)
    assert row["error"] <= 1.05 * min(error(radius) for radius in (0.25, 0.5, 1.0, 2.0, 5.0))


@pytest.mark.slow
def test_the_choice_moves_the_mesh_as_the_table_says(problem, choice):
    mesh, _, _, motions = problem
    row = choice.table[choice.chosen]
    reports = [jm.quality(mesh, jm.deform(choice.plan, jnp.asarray(u))) for u in motions]
    assert sum(int(report.inverted) for report in reports) == row["inverted"] == 0
    np.testing.assert_allclose(min(float(report.min_jacobian_ratio) for report in reports), row["jacobian"])
    text = str(choice).splitlines()
    assert len(text) == 1 + len(choice.table) == 7
    assert text[1 + choice.chosen].startswith("*")
    alike = [other for other in choice.table if other["fit"] == row["fit"]]
    cheaper = [other for other in alike if other["sources"] < row["sources"]]
    best = max(other["jacobian"] for other in alike)
    missing = [not other["fit"] and other["error"] > 0.01 for other in cheaper]
    worse = [other["inverted"] or other["jacobian"] < 0.98 * best for other in cheaper]
    assert all(a or b for a, b in zip(missing, worse, strict=True))


@pytest.mark.nightly
def test_a_change_of_shape_asks_for_the_fit_and_a_turn_does_not(problem, choice):
    """Camber turns the wall along the chord; a body that turns as a whole needs no fit to keep its grid lines."""
    mesh, moving, fixed, _ = problem
    row = choice.table[choice.chosen]
    assert row["fit"]
    assert row["angle"] < min(other["angle"] for other in choice.table if not other["fit"])
    points = mesh.points[moving]
    translation = jm.choose(mesh, moving, fixed, np.full((1, *points.shape), 0.1), leaves=(2,), methods={})
    assert not translation.table[translation.chosen]["fit"]


@pytest.mark.nightly
def test_a_symmetry_plane_counts_the_image_too():
    """Half a ring: the errors are those of SciPy's interpolation on the whole one, whose motion is known."""
    radius, angle = lattice(np.geomspace(1, 6, 8), np.pi * np.arange(17) / 16).T
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    points[np.abs(points) < 1e-12] = 0
    ids = np.arange(len(points)).reshape(8, 17)
    quads = blocks(ids)
    plane = jm.Plane((0, 1), (0, 0))

    def motion(x):
        return 0.2 * np.stack([x[:, 0] ** 2, x[:, 1] * x[:, 0]], axis=1)

    choice = jm.choose(
        jm.Mesh(points, {"quad": quads}),
        ids[0],
        ids[-1],
        motion(points[ids[0]])[None],
        symmetry=plane,
        leaves=(2,),
        methods={},
    )
    row = choice.table[0]
    reduced = jm.RBF(reduction=jm.KDTree(2, extremes=True))
    plan = jm.prepare(points, ids[0], ids[-1], method=reduced, symmetry=plane)
    whole, sources = np.asarray(plan.surface.points), np.asarray(plan.surface.ids)
    assert len(whole) == 64
    assert row["sources"] == len(sources) < 64
    values = np.where(np.linalg.norm(whole, axis=1)[:, None] < 2, motion(whole), 0)
    values /= np.abs(values).max()
    interpolant = scipy.interpolate.RBFInterpolator(
        whole[sources], values[sources], kernel="thin_plate_spline", degree=1
    )
    missed = np.sqrt(np.mean((values - interpolant(whole)) ** 2))
    assert missed > 1e-4
    np.testing.assert_allclose(row["error"], missed, rtol=1e-6)
    assert choice.plan.images is not None


ROW = {"inverted": 0, "jacobian": 0.8, "angle": 5.0, "fit": False, "error": None, "refused": None}


@pytest.mark.parametrize(
    ("changes", "chosen"),
    [
        (({}, {}), 0),
        (({"inverted": 1, "jacobian": 1.0, "angle": 0.0}, {}), 1),
        (({"jacobian": 0.79}, {"jacobian": 1.0}), 1),
        (({"jacobian": 0.81}, {"jacobian": 1.0}), 0),
        (({"angle": 6.1}, {}), 1),
        (({"angle": 5.9}, {}), 0),
        (({"angle": 6.1}, {"jacobian": 0.6}), 0),
        (({"error": 0.02}, {"jacobian": 1.0, "angle": 5.5}), 1),
        (({"error": 0.02, "fit": True}, {"jacobian": 0.9}), 0),
        (({"error": 0.02}, {"error": 0.03}), 0),
        (({"error": 0.02}, {"inverted": 1}), 0),
        (({"angle": np.nan, "jacobian": 0.7}, {"angle": np.nan, "jacobian": 0.9}), 1),
        (({"jacobian": -1.1}, {"jacobian": -1.0}), 0),
        (({"jacobian": np.nan, "angle": np.nan}, {"jacobian": -1.0}), 1),
        (({"refused": "too large", "inverted": np.nan}, {"inverted": 9}), 1),
    ],
)
def test_the_rule(changes, chosen):
    """Fewest inverted cells, 80 % of the best Jacobian ratio, and of these the first within a degree of the best angle."""
    assert best([ROW | change for change in changes], tolerance=0.01) == chosen


LENGTHS = Extent(np.array([[0.0, 0], [1, 0], [0.5, 0.2]]), np.array([[4.0, 0], [0, 4]]))


@pytest.mark.parametrize("entry", METHODS, ids=lambda entry: entry.name)
def test_the_list_says_of_a_method_what_the_method_says_of_itself(entry):
    method = entry.make(LENGTHS)
    assert isinstance(method, jm.AbstractMethod)
    assert entry.needs_cells == method.needs_cells
    if entry.sources == "some":
        coarse = method.coarse.rbf if isinstance(method.coarse, jm.FittedRBF) else method.coarse
        assert isinstance(coarse, jm.RBF)


def test_names_and_titles_of_methods_are_unique():
    assert (
        len({entry.name for entry in METHODS}) == len({entry.title or entry.name for entry in METHODS}) == len(METHODS)
    )


@pytest.mark.nightly
def test_camber_asks_for_the_cells_and_half_a_turn_for_a_rigid_blend(problem, monkeypatch):
    """Elastic and torsional cells turn with the wall; half a turn in one step is rigid, and only RigidBlend knows that."""
    mesh, moving, fixed, _ = problem
    base = mesh.points[moving]
    camber = 0.2 * (base[:, :1] - base[:, :1] ** 2) * [0, 1]
    turn = np.asarray(jm.shapes.rotate(base, np.deg2rad(-165.0), about=(0.25, 0.0))) - base
    first, second = (jm.choose(mesh, moving, fixed, u[None], leaves=(8,)) for u in (camber, turn))
    rows = {row["method"]: row for row in first.table}
    assert first.method.needs_cells
    within = min(row["angle"] for row in first.table) + 1
    assert first.table[first.chosen]["angle"] <= within < rows["fitted"]["angle"] < rows["thin plate"]["angle"]
    assert rows["elasticity"]["angle"] < rows["graph"]["angle"]
    assert all(row["seconds"] > 0 for row in first.table)
    chosen = second.table[second.chosen]
    assert (chosen["method"], chosen["inverted"]) == ("rigid", 0)
    assert all(row["inverted"] > 0 for row in second.table if row["method"] != "rigid")
    monkeypatch.setitem(MOST_POINTS, 2, 1000)
    skipped = jm.choose(mesh, moving, fixed, camber[None], leaves=(8,))
    assert "elasticity: skipped: 1279 points" in str(skipped)
    assert not skipped.method.needs_cells
    named = {"soft": jm.LinearElasticity(jm.ByDistance(1.0))}
    other = jm.choose(mesh, moving, fixed, camber[None], leaves=(8,), methods=named)
    assert [row["method"] for row in other.table[3:]] == ["soft"]


@pytest.mark.parametrize("motions", [np.zeros((1, 3, 2)), np.zeros((3, 2))])
def test_wrong_motions_are_named(problem, motions):
    with pytest.raises(ValueError, match="motions"):
        jm.choose(*problem[:3], motions)


@pytest.mark.nightly
def test_where_sources_determine_no_field_other_methods_are_left():
    """Two nodes span no plane, and the moving one alone has no extent to take a radius from."""
    points = np.random.default_rng(0).random((12, 2))
    mesh = jm.Mesh(points, {"triangle": scipy.spatial.Delaunay(points).simplices})
    motions = np.full((1, 1, 2), 1e-3)
    keywords = {"leaves": (2,), "methods": {"by distance": jm.InverseDistance()}}
    with pytest.warns(UserWarning, match="boundary faces"):
        found = jm.choose(mesh, [0], [1], motions, **keywords)
    assert isinstance(found.method, jm.InverseDistance)
    assert all("do not span 2 dimensions" in row["refused"] for row in found.table[:-1])
    with pytest.warns(UserWarning, match="boundary faces"):
        found = jm.choose(mesh, [0], [1, 2, 5, 7], motions, **keywords)
    assert all("convex hull" in row["refused"] for row in found.table[:-1])
    with pytest.warns(UserWarning, match="faces"), pytest.raises(ValueError, match="do not span 2 dimensions"):
        jm.choose(mesh, [0], [1], motions, leaves=(2,), methods={})
