"""`inspect(plan, u, mesh=mesh)` finds walls that run into another boundary or into themselves: closed forms."""

import itertools
from typing import Any

import foam
import numpy as np
import pytest
from meshes import blocks, lattice, turn
from runs import over, runs

import jaxmorph as jm
from jaxmorph import cases, io
from jaxmorph._advice.crossings import Crossings, crossings, simplices, wall_crossings
from jaxmorph._host.surface.gaps import crossing_faces, overlapping_boxes
from jaxmorph.cli import main

METHOD = jm.DelaunayGraph()


def grid(shape, holes):
    """Unit cells from the origin, without those in `holes` {name: (low, high)}, whose nodes are patches; `outer` is the rest."""
    d = len(shape)
    number = np.arange(np.prod(np.array(shape) + 1)).reshape(np.array(shape) + 1)
    cells = blocks(number).reshape(*shape, -1)
    points = lattice(*[np.arange(k + 1.0) for k in shape])
    keep, patches = np.ones(shape, bool), {}
    for name, (first, last) in holes.items():
        keep[tuple(slice(a, b) for a, b in zip(first, last, strict=True))] = False
        inside = ((points >= first) & (points <= last)).all(axis=1)
        patches[name] = inside & ((points == first) | (points == last)).any(axis=1)
    outer = (points == 0).any(axis=1) | (points == shape).any(axis=1)
    cells = cells[keep]
    used = np.unique(cells)
    patches = {
        name: np.searchsorted(used, np.flatnonzero(here))
        for name, here in {**patches, "outer": outer}.items()
    }
    kind = "quad" if d == 2 else "hexahedron"
    return jm.Mesh(points[used], {kind: np.searchsorted(used, cells)}, patches)


def found(mesh: jm.Mesh, moving: str, u: Any) -> Crossings:
    """Moves the patch `moving` by `u`, a vector or a function of its points; all others rest."""
    nodes = mesh.patch(moving)
    rest = np.setdiff1d(mesh.patch(*mesh.patches), nodes)
    base = np.asarray(mesh.points)[nodes]
    vectors = np.asarray(u(base)) if callable(u) else np.tile(u, (len(nodes), 1))
    all_vectors = np.concatenate([vectors, np.zeros((len(rest), base.shape[1]))])
    nodes = np.concatenate([nodes, rest])
    report = crossings(simplices(mesh, nodes), mesh, nodes, all_vectors)
    assert report is not None
    return report


@pytest.fixture(scope="module")
def squares():
    return grid((9, 8), {"left": ((2, 3), (4, 5)), "right": ((5, 3), (7, 5))})


@pytest.mark.parametrize("up", [0.0, 0.3, 1.0])
@pytest.mark.parametrize(
    ("way", "overlap"), [(0.9, False), (0.999, False), (1.1, True), (1.5, True), (2.5, True)]
)
def test_two_squares_cross_once_they_overlap(squares, way, up, overlap):
    report = found(squares, "left", (way, up))
    assert bool(report) == overlap
    for pair in report.patches:
        assert set(pair) == {"left", "right"}
    for (x, y), (first, second) in zip(report.places, report.nodes, strict=True):
        assert 5 <= x <= 4 + way + 1e-12
        assert 3 - 1e-12 <= y <= 5 + up
        assert first in squares.patch("left", "right")
        assert second in squares.patch("left", "right")


def test_the_number_of_crossings_of_two_squares_is_two(squares):
    """The outlines of two squares, one moved up by less than a side, cross in two points. `inspect` says so."""
    plan = jm.prepare(squares, "left", ("right", "outer"), method=METHOD)
    u = np.tile([1.4, 0.7], (plan.n_moving, 1))
    inspection = jm.inspect(plan, u, mesh=squares)
    assert inspection.crossings is not None
    places = inspection.crossings.places[np.argsort(inspection.crossings.places[:, 1])]
    np.testing.assert_allclose(places, [[5, 3.7], [5.4, 5]])
    assert "2 pairs of boundary faces cross" in str(inspection)
    assert "'left' and 'right'" in inspection.warnings[-1]
    assert jm.inspect(plan, u).crossings is None
    assert str(jm.inspect(plan, 0.1 * u, mesh=squares)) == "nothing to warn of."
    with pytest.raises(ValueError, match="this plan was made for"):
        jm.inspect(plan, u, mesh=cases.naca0015(points=600))


def test_a_wall_that_leaves_the_mesh(squares):
    report = found(squares, "left", (-2.25, 0.25))
    assert set(report.patches) <= {("left", "outer"), ("outer", "left")}
    assert len(report) == 2
    assert set(report.places[:, 0]) == {0}


def test_a_flap_that_goes_through_another_wall():
    """A thin flap turns about its left end; its right end reaches the wall above at the angle asin(1 / 4)."""
    mesh = grid((8, 8), {"flap": ((2, 2), (6, 3)), "wall": ((4, 4), (7, 5))})

    def turned(degrees):
        def u(base):
            return np.asarray(jm.shapes.rotate(base, np.deg2rad(degrees), [2.0, 3.0])) - base

        return u

    reached = np.rad2deg(np.arcsin(1 / 4))
    for degrees, crosses in ((0.98 * reached, False), (1.05 * reached, True), (2 * reached, True)):
        report = found(mesh, "flap", turned(degrees))
        assert bool(report) == crosses
    assert np.allclose(report.places[report.places[:, 1] < 4.999, 1].min(), 4)


def plate(longest):
    """A thin plate that is bent to the curve (t^2 - 1, t (t^2 - 1)), which crosses itself in the origin for t = -1 and 1."""
    mesh = grid((40, 12), {"plate": ((10, 5), (30, 6))})

    def u(base):
        t, height = (base[:, 0] - 20) / 10 * longest, base[:, 1] - 5.5
        slope = np.stack([2 * t, 3 * t**2 - 1], axis=1)
        normal = (
            np.stack([-slope[:, 1], slope[:, 0]], axis=1) / np.linalg.norm(slope, axis=1)[:, None]
        )
        curve = np.stack([t**2 - 1, t**3 - t], axis=1)
        return [20, 6] + 3 * (curve + 0.1 * height[:, None] * normal) - base

    return mesh, u


def test_a_plate_folded_through_itself():
    mesh, u = plate(1.5)
    report = found(mesh, "plate", u)
    assert set(report.patches) == {("plate", "plate")}
    np.testing.assert_allclose(report.places, np.tile([20, 6], (4, 1)), atol=0.3)
    assert "'plate' and itself" in str(report)
    mesh, u = plate(0.9)
    assert not found(mesh, "plate", u)


@pytest.fixture(scope="module")
def ball():
    """A sphere of radius 2 around (4, 4, 4) in a cube, whose floor is at z = 0."""
    mesh = grid((8, 8, 8), {"ball": ((2, 2, 2), (6, 6, 6))})
    points, nodes = np.array(mesh.points), mesh.patch("ball")
    arms = points[nodes] - 4
    points[nodes] = 4 + 2 * arms / np.linalg.norm(arms, axis=1)[:, None]
    outer = mesh.patch("outer")
    floor = outer[points[outer, 2] == 0]
    return jm.Mesh(
        points, mesh.cells, {"ball": nodes, "floor": floor, "sides": np.setdiff1d(outer, floor)}
    )


@pytest.mark.parametrize(
    ("way", "crosses"), [(1.9, False), (1.99, False), (2.2, True), (3.5, True)]
)
def test_a_sphere_moved_into_a_plane(ball, way, crosses):
    report = found(ball, "ball", (0.13, 0.21, -way))
    assert bool(report) == crosses
    assert {frozenset(pair) for pair in report.patches} == (
        {frozenset({"ball", "floor"})} if crosses else set()
    )
    centre = np.array([4.13, 4.21])
    assert np.allclose(report.places[:, 2], 0, atol=1e-9)
    radius = np.sqrt(4 - (4 - way) ** 2 if crosses else 0)
    assert (np.linalg.norm(report.places[:, :2] - centre, axis=1) <= radius).all()


@over(
    "make",
    [
        lambda: cases.naca4("0012", points=600, sharp=True),
        lambda: cases.naca0015(points=600),
        cases.bricks,
    ],
)
def test_a_mesh_that_turns_as_a_whole_crosses_nothing(make):
    """Wake cuts and sharp edges have coincident nodes."""
    mesh = make()
    nodes = np.unique(np.concatenate(list(mesh.patches.values())))
    base = np.asarray(mesh.points)[nodes]
    report = crossings(
        simplices(mesh, nodes), mesh, nodes, base @ turn(0.7, base.shape[1]).T + 1 / 3 - base
    )
    assert report is not None
    assert not len(report)
    assert str(report) == ""


def test_what_crossed_before_is_no_news(squares):
    points = np.array(squares.points)
    left = squares.patch("left")
    points[left] += [1.4, 0.7]
    tangled = squares.moved(points)
    assert not found(tangled, "left", (0.01, 0.01))
    assert len(found(squares, "left", (1.4, 0.7))) == 2


def test_a_part_names_nodes_of_the_whole(squares):
    nodes, plan = next(
        jm.prepare_in_chunks(
            jm.Boundary(squares, "left", ("right", "outer")), size=40, method=METHOD
        )
    )
    whole = found(squares, "left", (1.4, 0.7))
    part = jm.inspect(plan, np.tile([1.4, 0.7], (plan.n_moving, 1)), mesh=squares, nodes=nodes)
    assert part.crossings is not None
    np.testing.assert_array_equal(
        np.sort(part.crossings.nodes, axis=None), np.sort(whole.nodes, axis=None)
    )


@pytest.mark.slow
def test_a_wall_stays_in_its_symmetry_plane():
    """A bump of the floor that is to go down along a plane of symmetry does not cross it; its neighbour is crossed."""
    mesh = grid((8, 8), {"left": ((2, 0), (4, 3)), "right": ((5, 0), (7, 3))})
    points = np.asarray(mesh.points)
    rest = np.flatnonzero((points[:, 0] == 0) | (points[:, 0] == 8) | (points[:, 1] == 8))
    nodes = {name: mesh.patch(name)[points[mesh.patch(name), 1] > 0] for name in ("left", "right")}
    foot = {name: mesh.patch(name)[points[mesh.patch(name), 1] == 0][[0, -1]] for name in nodes}
    moving, fixed = (np.concatenate([nodes[name], foot[name]]) for name in nodes)
    plane = jm.Plane(normal=(0, 1), origin=(0, 0))
    plan = jm.prepare(mesh, moving, np.union1d(fixed, rest), symmetry=plane, method=jm.RBF())
    for way, count in ((0.5, 0), (1.5, 1)):
        report = jm.inspect(plan, np.tile([way, 0.25], (len(moving), 1)), mesh=mesh).crossings
        assert report is not None
        assert len(report) == count


@pytest.mark.nightly
def test_the_command_line_warns(squares, tmp_path, capsys):
    io.write(tmp_path / "a.su2", squares)
    names = ["--moving", "left", "--fixed", "right", "outer", "--translate", "1.4", "0.7"]
    assert main(["deform", str(tmp_path / "a.su2"), str(tmp_path / "b.su2"), *names]) == 1
    assert "2 pairs of boundary faces cross" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("d", [2, 3])
def test_overlapping_boxes_are_those_of_all_pairs(d):
    """Sizes differ by four orders, as those of a wall and a far field do."""
    random = np.random.default_rng(d)
    sizes = 10 ** random.uniform(-4, 0, (300, 1, 1))
    corners = random.uniform(size=(300, 1, d)) + sizes * random.normal(size=(300, d, d))
    moves = random.uniform(size=300) < 0.3
    low, high = corners.min(axis=1), corners.max(axis=1)
    overlap = ((low[:, None] <= high[None]) & (low[None] <= high[:, None])).all(axis=2) & (
        moves[:, None] | moves
    )
    expected = {tuple(pair) for pair in np.argwhere(np.triu(overlap, 1))}
    listed = [tuple(sorted(pair)) for pair in overlapping_boxes(corners, moves)]
    assert len(listed) == len(set(listed))
    assert set(listed) == expected


def test_random_triangles_cross_where_the_equations_say():
    """Two triangles meet if a side of one passes through the other: solved for each pair by LAPACK."""
    random = np.random.default_rng(0)
    points = random.uniform(size=(120, 3))
    apart = points + 1000 * (np.arange(120) // 3)[:, None]
    faces = np.arange(120).reshape(-1, 3)
    pairs, places = crossing_faces(apart, points, faces, np.arange(120))
    expected = set()
    for i in range(40):
        for j in range(40):
            for start, end in ((0, 1), (1, 2), (2, 0)):
                p, q, (a, b, c) = points[faces[i, start]], points[faces[i, end]], points[faces[j]]
                t, u, v = (
                    np.linalg.solve(np.stack([p - q, b - a, c - a], axis=1), p - a)
                    if i != j
                    else (2, 0, 0)
                )
                if 0 <= t <= 1 and min(u, v) >= 0 and u + v <= 1:
                    expected.add((min(i, j), max(i, j)))
    assert {tuple(sorted(pair)) for pair in pairs} == expected
    assert np.isfinite(places).all()
    assert len(expected) > 20


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_faces_that_touch_meet_at_every_size(size):
    """A corner that comes to lie in another face, within round-off, meets it; a millionth of the size above it does not."""
    random = np.random.default_rng(1)
    for d in (2, 3):
        faces, place = np.arange(2 * d).reshape(2, d), np.arange(2 * d)
        for _ in range(20):
            face, weights = random.normal(size=(d, d)), random.dirichlet(np.ones(d))
            foot = weights @ face
            normal = np.linalg.svd(face[1:] - face[0])[2][-1]
            away = [
                foot + height * normal + across
                for height, across in zip((1, 1.5), 0.2 * np.eye(d), strict=False)
            ]
            other = np.array([foot, *away[: d - 1]])
            before = size * np.concatenate([face, other + 3 * normal])
            for gap, meets in ((0.0, True), (1e-6, False)):
                after = size * np.concatenate([face, other + gap * normal])
                pairs, places = crossing_faces(before, after, faces, place)
                assert len(pairs) == meets
                np.testing.assert_allclose(
                    places, np.tile(size * foot, (meets, 1)), rtol=0, atol=1e-7 * size
                )


def test_faces_of_which_no_node_moves_or_that_are_no_whole_ones_cross_nothing(squares):
    for nodes, way in ((squares.patch("left", "right"), 0.0), (squares.patch("left")[::2], 9.0)):
        report = crossings(simplices(squares, nodes), squares, nodes, np.full((len(nodes), 2), way))
        assert report is not None
        assert not len(report)


def annulus():
    """A ring round a square hole; a second hole beside it."""
    holes = {"left": ((6, 8), (9, 11)), "right": ((12, 8), (14, 11))}
    return grid((20, 20), holes)


def duct(free=True):
    mesh = grid((20, 6), {})
    points = np.asarray(mesh.points)
    sides = {
        "lower": points[:, 1] == 0,
        "upper": points[:, 1] == 6,
        "inlet": points[:, 0] == 0,
        "outlet": points[:, 0] == 20,
    }
    return jm.Mesh(points, mesh.cells, {name: np.flatnonzero(on) for name, on in sides.items()})


def cube():
    """A cube in a cube."""
    return grid((7, 7, 7), {"ball": ((3, 3, 3), (4, 4, 4))})


def by(*way):
    return lambda x: np.tile(np.array(way, float), (len(x), 1))


def about(degrees, centre):
    return lambda x: np.asarray(jm.shapes.rotate(x, np.deg2rad(degrees), np.array(centre))) - x


TWO = (annulus, "left", ("right", "outer"), {})
DUCT = (duct, "lower", "upper", {"free": ("inlet", "outlet")})
HALF = (duct, "lower", (), {"symmetry": ("upper",), "free": ("inlet", "outlet")})
CUBE = (cube, "ball", "outer", {})
MOTIONS = {
    "over a wall": (TWO, by(7.5, 0.25), ("left", "right"), False),
    "onto a wall": (TWO, by(4.5, 0.25), ("left", "right"), False),
    "over a wall, turned": (TWO, about(170, (11.0, 9.5)), ("left", "right"), False),
    "out of the domain": (TWO, by(-12.5, 0.25), ("left", "outer"), True),
    "partly out of the domain": (TWO, by(-7.5, 0.25), ("left", "outer"), True),
    "inside out": (TWO, lambda x: (x - [7.5, 9.5]) * [-2.0, 0.0], ("left", "left"), False),
    "a duct turned over": (DUCT, by(0.0, 7.5), ("lower", "upper"), True),
    "through a duct": (
        DUCT,
        lambda x: np.c_[0 * x[:, 0], 9 * (x[:, 0] / 20) ** 2],
        ("lower", "upper"),
        True,
    ),
    "through a symmetry plane": (HALF, by(0.0, 7.5), ("lower", "upper"), True),
    "a cube out of its box": (CUBE, by(5.3, 0.1, 0.2), ("ball", "outer"), True),
    "a cube half out of its box": (CUBE, by(3.4, 0.1, 0.2), ("ball", "outer"), True),
    "a cube turned out of its box": (
        CUBE,
        lambda x: np.c_[about(180, (8.0, 3.5))(x[:, :2]), 0 * x[:, 0]],
        ("ball", "outer"),
        True,
    ),
}
LEGAL = {
    "at rest": (TWO, by(0, 0)),
    "near a wall": (TWO, by(2.9, 0.25)),
    "round a wall": (TWO, by(0.0, 5.0)),
    "turned by 60 degrees": (TWO, about(60, (7.5, 9.5))),
    "turned by 170 degrees": (TWO, about(170, (7.5, 9.5))),
    "turned by 180 degrees": (TWO, about(180, (7.5, 9.5))),
    "smaller": (TWO, lambda x: 0.9 * ([7.5, 9.5] - x)),
    "larger": (TWO, lambda x: 0.4 * (x - [7.5, 9.5])),
    "a narrow duct": (DUCT, by(3.0, 5.5)),
    "a wavy duct": (DUCT, lambda x: np.c_[0 * x[:, 0], np.sin(x[:, 0])]),
    "towards a symmetry plane": (HALF, by(0.0, 5.5)),
    "a cube in its box": (CUBE, by(2.8, 0.1, -2.2)),
    "a cube turned": (
        CUBE,
        lambda x: np.c_[about(60, (3.5, 3.5))(x[:, :2]), 0 * x[:, 0]],
    ),
}


def verdict_of(case, motion):
    """What `wall_crossings` says where inner and free nodes move as inverse distances send them."""
    make, moving, fixed, more = case
    mesh = make()
    plan = jm.prepare(mesh, moving, fixed, method=jm.InverseDistance(rotations=False), **more)
    u = motion(np.asarray(plan.moving_points))
    moved = np.asarray(jm.deform(plan, u))
    return mesh, plan, u, wall_crossings(plan, mesh, u[None], moved)


@pytest.mark.parametrize("name", MOTIONS)
def test_motions_that_no_mesh_can_follow_are_named(name):
    """By both patches, the place, and how far: over the way from rest to the end."""
    case, motion, patches, leaves = MOTIONS[name]
    mesh, _, _, found = verdict_of(case, motion)
    assert found
    assert set(patches) in [set(pair) for pair in found.patches]
    for word in (repr(patches[0]), "first near", "% of the motion", "beyond"):
        assert word in str(found)
    points = np.asarray(mesh.points)
    slack = 1e-6 if not leaves else np.inf
    assert (found.places >= points.min(axis=0) - slack).all()
    assert 0 < found.share < 1
    assert found.beyond > 0
    assert leaves == found.leaves or found.crosses


@pytest.mark.parametrize("name", LEGAL)
def test_motions_that_a_mesh_can_follow_are_not_named(name):
    assert not verdict_of(*LEGAL[name])[3]


def test_a_path_counts_and_not_its_end_alone():
    """A body that turns once, and one that goes through a wall and comes back, end where they began."""
    mesh, plan, _, _ = verdict_of(TWO, by(0, 0))
    x = np.asarray(plan.moving_points)
    turns = np.stack([about(degrees, (7.5, 9.5))(x) for degrees in (120, 240, 360)])
    back = np.stack([by(7.5, 0.25)(x), by(0, 0)(x)])
    assert not wall_crossings(plan, mesh, turns)
    assert wall_crossings(plan, mesh, back)


@pytest.mark.parametrize("name", MOTIONS)
def test_no_cures_are_tried_for_them(name, monkeypatch):
    """Neither by `inspect` nor are they listed, but for walls that could slide along what they are torn from."""
    case, motion, patches, _ = MOTIONS[name]
    _, moving, fixed, more = case
    mesh, plan, u, _ = verdict_of(case, motion)
    monkeypatch.setattr("jaxmorph._advice.inspect.advice_on_folds", lambda *_: 1 / 0)
    found = jm.inspect(plan, u, mesh=mesh)
    assert found.is_hopeless
    assert "one step folds" not in " ".join(found.advice)
    assert repr(patches[0]) in " ".join(found.warnings)
    listed = jm.cures(jm.Boundary(mesh, moving, fixed, **more), u)
    assert [cure for cure in listed if not cure.sliding] == []


def commands(folder, case, motion):
    """Command lines that move a mesh by a table of new positions, and one by SU2's config file."""
    make, moving, fixed, more = case
    mesh = make()
    io.write(folder / "in.su2", mesh)
    nodes = mesh.patch(moving)
    wall = np.asarray(mesh.points)[nodes]
    rows = np.column_stack([nodes, wall + motion(wall)])
    np.savetxt(folder / "wall.csv", rows, "%.17g", ",")
    np.savetxt(folder / "wall.dat", rows, "%.17g")
    words = ["deform", str(folder / "in.su2"), str(folder / "out.su2"), "--moving", moving]
    words += ["--displacement", str(folder / "wall.csv")]
    for flag, names in (
        ("--fixed", fixed),
        *((f"--{name}", names) for name, names in more.items()),
    ):
        words += [flag, *([names] if isinstance(names, str) else names)] if names else []
    lines = {
        "MESH_FILENAME": "in.su2",
        "DV_KIND": "SURFACE_FILE",
        "DV_PARAM": "( 1.0 )",
        "DV_VALUE": "1.0",
        "DV_FILENAME": "wall.dat",
        "DV_MARKER": f"( {moving} )",
        "MARKER_SYM": f"( {', '.join(more.get('symmetry', ['NONE']))} )",
    }
    (folder / "in.cfg").write_text("".join(f"{key}= {text}\n" for key, text in lines.items()))
    return {"deform": words, "su2 def": ["su2", "def", str(folder / "in.cfg")]}


@pytest.mark.parametrize(
    ("command", "name"),
    runs(
        [("deform", "inside out")],
        slow=[("su2 def", "through a symmetry plane")],
        nightly=sorted(
            {*itertools.product(("deform", "su2 def"), MOTIONS)}
            - {("deform", "inside out"), ("su2 def", "through a symmetry plane")}
        ),
    ),
)
def test_commands_name_them_without_dry_runs(command, name, tmp_path, capsys, monkeypatch):
    case, motion, patches, _ = MOTIONS[name]
    monkeypatch.setattr("jaxmorph.cli._deform._works", lambda *_: 1 / 0)
    status = main(commands(tmp_path, case, motion)[command])
    said = " ".join(capsys.readouterr().err.split())
    assert status == 1 or "turned" in name
    names = patches if command == "deform" else patches[1:]  # fixed ends may cross before walls
    for word in (*map(repr, names), "first near", "move the wall less"):
        assert word in said


@over("name", slow=["a cube out of its box"], nightly=["a cube half out of its box"])
def test_a_decomposed_case_names_them(name, tmp_path, capsys):
    (make, moving, fixed, _), motion, patches, _ = MOTIONS[name]
    mesh = make()
    points = np.asarray(mesh.points)
    cells = foam.hexahedra(mesh.cells["hexahedron"])
    inside = np.isin(np.arange(len(points)), mesh.patch(moving))
    sides = [("ball", "wall", lambda nodes: inside[nodes].all()), ("outer", "wall", lambda _: True)]
    foam.write_case(tmp_path / "case", points, cells, sides)
    halves = (points[mesh.cells["hexahedron"]].mean(axis=1)[:, 0] > 3.5).astype(int).tolist()
    foam.write_parts(tmp_path / "case", points, cells, sides, halves)
    way = map(str, motion(points[:1])[0])
    words = ["deform", str(tmp_path / "case"), str(tmp_path / "new"), "--moving", moving]
    words += ["--fixed", fixed, "--decomposed", "--translate", *way]
    assert main(words) == 1
    said = " ".join(capsys.readouterr().err.split())
    for word in (*map(repr, patches), "first near", "move the wall less"):
        assert word in said


@pytest.mark.slow
def test_faces_that_all_come_near_each_other_are_told_and_not_compared(monkeypatch):
    """Work is bounded: of a bound of no pairs a motion that crosses a wall is not known."""
    monkeypatch.setattr("jaxmorph._host.surface.gaps.PAIRS_OF_FACE", 0)
    monkeypatch.setattr("jaxmorph._host.surface.gaps.PAIRS_ALWAYS", 0)
    mesh, plan, u, found = verdict_of(TWO, by(7.5, 0.25))
    assert not found
    assert not found.is_known
    assert "walls may cross on their way" in " ".join(jm.inspect(plan, u, mesh=mesh).warnings)
