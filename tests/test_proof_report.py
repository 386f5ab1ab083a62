"""The report of a proof: motions, margins, steps, what is told and refused."""

import re

import equinox as eqx
import foam
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from meshes import bricks, drum, grid, mixed, ring, shaken, square, turn, unit_box, wedges
from oracles import cells_near_the_limit, jacobians_inside, samples_inside
from runs import over, refusals

import jaxmorph as jm
from jaxmorph import cases, io
from jaxmorph._host.cells import lagrange
from jaxmorph._host.cells.lagrange import lagrange_types
from jaxmorph.cli import main


@pytest.mark.parametrize(
    "make", [square, ring, mixed, wedges, bricks, unit_box, drum, lambda: cases.naca4("2412")]
)
def test_valid_meshes_are_proven(make):
    mesh = make()
    report = jm.proof(mesh)
    assert report.unknown <= 1e-3 * report.count
    assert report.invalid == 0
    assert report.min_margin > 0
    report.raise_if_unproven()


@pytest.mark.parametrize("degrees", [60, 120, 170, 179])
@pytest.mark.parametrize("make", [square, bricks])
def test_a_turn_along_straight_lines_has_a_closed_form(make, degrees):
    """det J of (1 - t) + t R is 1 - 2 t (1 - t) (1 - cos), least in the middle of the motion."""
    mesh = make()
    points = np.asarray(mesh.points) @ turn(np.deg2rad(degrees), mesh.points.shape[1]).T
    least = (1 + np.cos(np.deg2rad(degrees))) / 2
    report = jm.proof(mesh, points, base=mesh.points)
    assert report.valid == report.count
    assert (report.margin <= least + 1e-9).all()
    close = jm.proof(mesh, points, base=mesh.points, depth=6)
    np.testing.assert_array_equal(close.is_valid, True)
    if degrees > 90:  # the sign was open, so cells were cut
        np.testing.assert_allclose(report.time, 0.5)
        np.testing.assert_allclose(report.upper / report.size, least, atol=1e-9)


def test_a_motion_folds_cells_that_are_sound_where_it_begins_and_ends():
    mesh = square()
    ends = np.asarray(mesh.points) * np.array([-2.0, -0.5])  # det J is (1 - 3 t) (1 - 1.5 t)
    assert jm.proof(mesh, ends).valid == jm.proof(mesh).valid == 9
    report = jm.proof(mesh, ends, base=mesh.points)
    assert report.invalid == 9
    t = report.time
    np.testing.assert_allclose(report.upper / report.size, (1 - 3 * t) * (1 - 1.5 * t), atol=1e-9)
    assert ((t > 1 / 3) & (t < 2 / 3)).all()
    assert report.from_start == 0
    with pytest.raises(
        ValueError, match=r"9 of 9 cells fold inside, 0 are not proven, first cell \d \(quad\) near"
    ):
        report.raise_if_unproven()
    assert "least det J during the motion over" in str(report)


def test_a_motion_from_a_folded_mesh_is_told():
    mesh = bricks(2)
    folded = shaken(mesh, 0.4)
    report = jm.proof(mesh, mesh.points, base=folded)
    assert report.from_start == jm.proof(mesh, folded).invalid > 0
    assert f"{report.from_start} of them are invalid from the start" in str(report)
    with pytest.raises(ValueError, match=r"cells fold inside, \d+ from the start"):
        report.raise_if_unproven()


def test_margins_do_not_depend_on_place_size_and_direction():
    mesh = bricks()
    points = shaken(mesh, 0.05)
    rotation = turn(0.7, 3)
    moved = lambda x: 1e-3 * np.asarray(x) @ rotation.T + np.array([5.0, -7.0, 3.0])  # noqa: E731
    one, other = jm.proof(mesh, points), jm.proof(mesh.moved(moved(mesh.points)), moved(points))
    np.testing.assert_allclose(one.margin, other.margin, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(
        moved(one.near)[one.is_invalid], other.near[one.is_invalid], atol=1e-8
    )


def test_a_collapsed_cell_is_flat_and_a_nan_is_invalid():
    """A hexahedron with one edge collapsed has det J = 0 there: neither proven nor folded."""
    mesh = bricks(1)
    points = np.array(mesh.points)
    cells = np.asarray(mesh.cells["hexahedron"])
    points[cells[0, 1]] = points[cells[0, 0]]
    report = jm.proof(mesh, points)
    assert (report.valid, report.invalid, report.unknown) == (0, 0, 1)
    assert report.is_flat.all()
    assert "no depth decides them" in str(report)
    points[0] = np.nan
    assert jm.proof(mesh, points).invalid == 1


def test_a_thin_tilted_layer_is_proven():
    """Cells of 1e-7 by 1, whose nodes are known to nine digits of the height."""
    mesh = bricks(3)
    tilt = np.array([[1, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]])
    points = np.asarray(mesh.points) * np.array([1.0, 1.0, 1e-7]) @ turn(0.5, 3).T @ tilt
    report = jm.proof(mesh.moved(points))
    assert report.valid == 27
    np.testing.assert_allclose(report.margin, 1, rtol=1e-5)


@over(
    "make options",
    [(mixed, {"base": True}), (mixed, {"sharpness": 40.0})],
    slow=[(lambda: bricks(1), {"depth": 1})],
    nightly=[(lambda: bricks(2), {}), (wedges, {"sharpness": 40.0})],
)
def test_the_margin_is_traced_and_has_derivatives(make, options):
    mesh = make()
    points, way = shaken(mesh, 0.03), np.random.default_rng(1).normal(size=mesh.points.shape)
    if options.get("base"):
        options = {"base": mesh.points}

    def least(x):
        return jm.proven_margin(mesh, x, **options).min()

    eager = jm.proven_margin(mesh, points, **options)
    traced = jax.jit(lambda x: jm.proven_margin(mesh, x, **options))(points)
    np.testing.assert_allclose(traced, eager, rtol=1e-12, atol=1e-12)
    slope = jax.jit(jax.grad(least))(points)
    difference = (least(points + 1e-6 * way) - least(points - 1e-6 * way)) / 2e-6
    assert float((slope * way).sum()) == pytest.approx(float(difference), rel=1e-6)
    if "depth" not in options:
        report = jm.proof(mesh, points, base=options.get("base"), depth=0)
        exact = report.margin
        if "sharpness" in options:
            assert (np.asarray(eager) <= exact + 1e-9).all()
            assert (np.asarray(eager) >= exact - np.log(27) / 40 - 1e-9).all()
        else:
            np.testing.assert_allclose(eager, exact, atol=1e-10)
    if make is mixed:
        both = jax.vmap(lambda x: jm.proven_margin(mesh, x, **options))(
            np.stack([points, mesh.points])
        )
        np.testing.assert_allclose(both[0], eager, rtol=1e-10, atol=1e-12)


def test_no_sample_of_a_proven_motion_folds():
    """Places in cells at instants, by the trilinear functions, against the bounds of the whole motion."""
    mesh = bricks()
    start, end = shaken(mesh, 0.05), shaken(mesh, 0.12, seed=1)
    report = jm.proof(mesh, end, base=start)
    cells, lattice = np.asarray(mesh.cells["hexahedron"]), lagrange_types()["hexahedron"].lattice
    ways = [((1 - t) * start + t * end)[cells] for t in np.linspace(0, 1, 7)]
    values = [
        jacobians_inside("hexahedron", 1, lattice, way, samples_inside("hexahedron", 7))
        for way in ways
    ]
    least = np.min(values, axis=(0, 2))
    assert (report.lower <= least + 1e-12).all()
    assert (least[report.is_valid] > 0).all()
    assert 0 < report.valid < report.count


@pytest.mark.slow
def test_a_line_search_accepts_proven_steps_alone():
    """A brick's corners may move on although it is folded between them: judged by corners alone the way ends later."""
    mesh = grid(*[[0.0, 1.0]] * 3)
    cells = cells_near_the_limit(lagrange_types()["hexahedron"], 400, seed=3)[
        :, [0, 4, 3, 7, 1, 5, 2, 6]
    ]
    hidden = (
        x for x in cells if jm.proof(mesh, x).invalid and not int(jm.quality(mesh, x).inverted)
    )
    direction = next(hidden) - mesh.points
    plan, folded = jm.prepare(mesh.points, np.arange(8), method=jm.InverseDistance()), []
    for proven in (False, True):
        search = jm.ValidSteps(jm.DesignedMesh(plan, mesh, lambda y: y * direction, proven=proven))
        solver = eqx.tree_at(lambda it: it.search, optx.GradientDescent(1.0, 1e-9, 1e-9), search)
        objective = search.guarded(lambda y, args: -y)
        end = optx.minimise(objective, solver, jnp.asarray(0.0), max_steps=12, throw=False).value
        assert float(end) > 0
        report = jm.proof(mesh, jm.deform(plan, end * direction), base=mesh.points)
        folded.append(report.count - report.valid)
    assert folded == [1, 0]


test_bad_input_is_refused = refusals(
    (lambda: jm.proof(square(), base=np.zeros((3, 2))), r"`base` has shape \(3, 2\)"),
    (
        lambda: jm.proof(jm.Mesh(np.zeros((3, 3)), {"triangle": [[0, 1, 2]]})),
        "no cells that fill 3-D space",
    ),
    (lambda: jm.proof(jm.Mesh(np.zeros((3, 3)))), "the mesh has no cells"),
    (
        lambda: jax.jit(lambda x: jm.proof(square(), x).lower)(square().points),
        "`proven_margin` is traced",
    ),
)


@pytest.mark.parametrize(
    "kind", ["triangle6", "quad16", "quad8", "tetra10", "wedge18", "pyramid14", "hexahedron27"]
)
def test_curved_cells_of_a_mesh_are_judged_whole(kind):
    """A node that is pulled through the cell folds it; nodes in place are proven, at the volume of the straight cell."""
    cell = lagrange_types()[kind]
    mesh = jm.Mesh(cell.reference, {kind: np.arange(len(cell.lattice))[None]})
    report = jm.proof(mesh)
    assert (report.valid, report.unknown) == (1, 0)
    np.testing.assert_allclose([report.min_margin, report.size[0]], 1, rtol=1e-9)
    points = np.array(cell.reference)
    points[cell.corners] += 3 * (points.mean(axis=0) - points[cell.corners])
    bent = jm.proof(mesh, points)
    assert bent.invalid == 1
    value = np.linalg.det(
        points.T @ lagrange.derivatives(kind, collapsed(cell.shape, bent.reference))[0]
    )
    assert bent.upper[0] == pytest.approx(value, abs=1e-6)
    assert value < 0
    near = lagrange.shape_values(kind, collapsed(cell.shape, bent.reference)) @ points
    np.testing.assert_allclose(bent.near, near, atol=1e-9)
    margin = jm.proof(mesh, points, depth=0).margin
    np.testing.assert_allclose(jm.proven_margin(mesh, points, depth=0), margin, rtol=1e-6)


def collapsed(shape: str, places: np.ndarray) -> np.ndarray:
    """Places of a pyramid as its shape functions take them."""
    return (
        np.column_stack([places[:, :2] / (1 - places[:, 2:]), places[:, 2]])
        if shape == "pyramid"
        else places
    )


def test_a_folded_piece_of_a_polyhedron_is_unknown(tmp_path):
    """A polyhedron that is not convex may have a folded piece and still be sound."""
    points, cells = foam.split()
    foam.write_case(tmp_path, points, cells, [("all", "wall", lambda face: True)])
    mesh = io.read(tmp_path)
    assert len(mesh.polyhedra.cut)
    report = jm.proof(mesh)
    assert report.valid == report.count
    moved = shaken(mesh, 0.4)
    report, is_piece = jm.proof(mesh, moved), np.isin(mesh.cell_ids, mesh.polyhedra.cut)
    is_folded = np.asarray(jm.quality(mesh, moved).is_inverted)
    assert (is_folded & is_piece).any()
    assert not report.is_invalid[is_piece].any()
    assert report.is_unknown[is_folded & is_piece].all()
    arrived = mesh.moved(moved)  # the same where the mesh arrives so
    for again in (jm.proof(arrived), jm.proof(arrived, moved)):
        np.testing.assert_array_equal(again.is_valid, report.is_valid)


def test_tables_fit_on_a_terminal():
    mesh = bricks()
    points = shaken(mesh, 0.2) - 0.5
    for report in (
        jm.proof(mesh, points),
        jm.proof(mesh, points, base=np.asarray(mesh.points) - 0.5),
    ):
        lines = str(report).split("\n")
        assert max(map(len, lines)) <= 80
        assert re.match(r"27 cells: \d+ proven valid, \d+ invalid, \d+ unknown", lines[0])
        first = report.worst(1)[0]
        assert lines[-5].startswith(f"{first} ")


def test_the_command_line_proves_and_gates(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    mesh = unit_box(3)
    inner = np.setdiff1d(np.arange(len(mesh.points)), mesh.patch(*mesh.patches))
    points = np.array(mesh.points)
    points[inner] += 0.2 * np.random.default_rng(0).normal(size=(len(inner), 3))
    io.write("box.su2", mesh)
    io.write("bad.su2", mesh.moved(points))
    report = jm.proof(mesh, points)
    assert report.invalid > 0
    assert main(["quality", "box.su2", "--proof", "--proven"]) == 0
    said = capsys.readouterr()
    assert "27 cells: 27 proven valid, 0 invalid, 0 unknown" in said.out
    assert max(map(len, said.out.split("\n"))) <= 80
    assert main(["quality", "box.su2", "bad.su2", "--proof", "--proven"]) == 1
    said = capsys.readouterr()
    assert f"{report.invalid} invalid" in said.out
    assert f"{report.invalid} of 27 cells fold inside." in said.err
    assert re.search(r"\d+ of 27 cells are beyond --proven, the worst is cell \d+\.", said.err)
    motion = [
        "--moving",
        "z0",
        "--fixed",
        "z1",
        "--free",
        "x0",
        "x1",
        "y0",
        "y1",
        "--proven",
        "--no-dry-run",
    ]
    assert main(["deform", "box.su2", "moved.su2", *motion, "--translate", "0", "0", "0.05"]) == 0
    assert "min proven margin" in capsys.readouterr().out
    assert main(["deform", "box.su2", "folded.su2", *motion, "--translate", "0", "0", "1.5"]) == 1
    assert "beyond --proven" in capsys.readouterr().err
    assert not (tmp_path / "folded.su2").exists()


HALF_TURN = [
    "--rotate",
    "180",
    "--axis",
    "0",
    "0",
    "1",
    "--about",
    "0.5",
    "0.5",
    "0.5",
    "--proven",
    "--no-dry-run",
]
"""det J of a straight half turn is (1 - 2 t)^2: zero in the middle, 1 at the end. In four steps it is (1 + cos 45) / 2 at least."""


@over(
    "flags valid when",
    slow=[([], 0, "at every instant of the motion.")],
    nightly=[
        (["--steps", "4"], 8, "at every instant of the motion, step by step in 4 steps."),
        (
            ["--method", "turning"],
            8,
            "where the motion ends, but not on the way, where nodes leave straight lines.",
        ),
    ],
)
def test_the_gate_proves_the_whole_motion(tmp_path, capsys, monkeypatch, flags, valid, when):
    monkeypatch.chdir(tmp_path)
    io.write("box.su2", unit_box(2))
    every = ["--moving", "x0", "x1", "y0", "y1", "z0", "z1"]
    assert main(["deform", "box.su2", "turned.su2", *every, *HALF_TURN, *flags]) == (valid == 0)
    said = capsys.readouterr()
    assert f"proven: {valid} of 8 cells fold nowhere inside, {when}" in re.sub(
        r"\s+", " ", said.out
    )
    assert re.search(r"inverted cells +0 +0", said.out)
    assert max(map(len, said.out.split("\n"))) <= 80
    if flags[:1] == ["--steps"]:  # the margin of the worst step, by its closed form
        margin = float(re.search(r"min proven margin +0 +1 +([0-9.]+)", said.out)[1])
        assert 0.8 < margin <= (1 + np.cos(np.pi / 4)) / 2
