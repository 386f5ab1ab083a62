"""SU2's config files: what each kind of design variable moves, by SU2's own formulas, and both commands."""

import itertools
import json
import math
import re
import warnings

import jax
import numpy as np
import pytest
import scipy.interpolate
from meshes import bricks
from runs import printed

import jaxmorph as jm
from jaxmorph import cases, io, shapes
from jaxmorph.cli import main
from jaxmorph.integrations import su2

CORNERS = [[-0.1, -0.2], [1.1, -0.25], [1.2, 0.25], [-0.15, 0.2]]
FFD = "FFD_DEFINITION= (MAIN, {}, 0,0,0, 0,0,0, 0,0,0, 0,0,0)\nFFD_DEGREE= (3,{},0)\n"
TABLE = FFD.format(", ".join(f"{x}, {y}, 0.0" for x, y in CORNERS), 1)
SOLID = np.array([[-0.1, -0.1, -0.2], [1.2, -0.1, -0.2], [1.1, 0.6, -0.2], [-0.1, 0.6, -0.2],
                  [-0.1, -0.1, 0.3], [1.2, -0.1, 0.3], [1.1, 0.6, 0.4], [-0.1, 0.6, 0.3]])  # fmt: skip
WHOLE = SOLID * [1, 2, 1]
"""A box that holds the whole of the floor; that of `SOLID` ends within it."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("su2")
    io.write(folder / "airfoil.su2", cases.naca0015(points=800))
    brick = bricks(4)
    x = np.asarray(brick.points)
    top = np.flatnonzero(x[:, 2] == 1)
    sides = np.setdiff1d(np.flatnonzero((x[:, :2] % 1 == 0).any(axis=1) & (x[:, 2] > 0)), [])
    io.write(
        folder / "brick.su2", jm.Mesh(x, brick.cells, {**brick.patches, "top": top, "sides": sides})
    )
    names = {"floor": (2, 0), "lid": (2, 1), "wall": (0, 0), "side": (1, 0)}
    sides = {name: np.flatnonzero(x[:, axis] == place) for name, (axis, place) in names.items()}
    io.write(folder / "room.su2", jm.Mesh(x, brick.cells, sides))
    inner = [
        corner for corner in brick.cells["hexahedron"][21] if x[corner, 1] == 0.5
    ]  # a marker within the mesh
    text = (folder / "room.su2").read_text().replace("NMARK= 4", "NMARK= 5")
    (folder / "room.su2").write_text(
        text + f"MARKER_TAG= cut\nMARKER_ELEMS= 1\n9 {' '.join(map(str, inner))}\n"
    )
    return folder


def config(folder, kind, param, value, more="", mesh="airfoil", marker="airfoil"):
    """Reads a config file of these design variables."""
    text = f"MESH_FILENAME= {mesh}.su2\nDV_KIND= {kind}\nDV_PARAM= {param}\nDV_VALUE= {value}\nDV_MARKER= ( {marker} )\n{more}"
    (folder / "case.cfg").write_text(text)
    return su2.read_config(folder / "case.cfg")


def moved(case):
    """Returns the wall before and after."""
    x = np.asarray(case.mesh.points)[case.mesh.patch(*case.moving)]
    return x, np.asarray(case.shape(x, case.parameters))


def turned(points, a, b, degrees):
    """SU2's rotation about the line from a to b: the general matrix, by cosine and sine."""
    axis = (b - a) / np.linalg.norm(b - a)
    cosine, sine = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    matrix = cosine * np.eye(3) + sine * cross + (1 - cosine) * np.outer(axis, axis)
    return (points - a) @ matrix.T + a


def test_rigid_kinds_add_what_each_does_to_the_wall_as_it_was(folder):
    param = "(0.1, 0.2, 0.3); (0.25, 0.1, 0, 0.5, 0.3, 1); (1.0)"
    case = config(
        folder, "TRANSLATION, ROTATION, SCALE", param, "0.5, 12, 1.1", mesh="brick", marker="floor"
    )
    x, after = moved(case)
    spin = turned(x, np.array([0.25, 0.1, 0]), np.array([0.5, 0.3, 1]), 12) - x
    np.testing.assert_allclose(
        after, x + 0.5 * np.array([0.1, 0.2, 0.3]) + spin + 0.1 * x, atol=1e-14
    )
    np.testing.assert_array_equal(case.shape(x, case.shape.neutral()), x)
    assert (case.fixed, case.steps) == (("top", "sides"), 1)
    flat = config(folder, "ROTATION", "(0.25, 0.1, 0, 0.25, 0.1, 1)", "12")
    x, after = moved(flat)
    solid = np.column_stack([x, np.zeros(len(x))])
    spun = turned(solid, np.array([0.25, 0.1, 0]), np.array([0.25, 0.1, 1]), 12)
    np.testing.assert_allclose(after, spun[:, :2], atol=1e-14)


def su2_loop(x, up, kind, numbers, value):
    """Displacements across x as SU2's loops over the nodes of the wall have them; `up` are ordinates of normals."""
    moves = np.zeros_like(x)
    for row, (t, y) in enumerate(x):
        if kind == "SURFACE_BUMP":
            start, end, place = numbers
            size, ahead = end - start, t - start
            power = math.log10(0.5) / math.log10((place - start) / size)
            if 0 < ahead < size:
                moves[row, 1] = value * math.sin(math.pi * (ahead / size) ** power) ** 3
        elif kind == "CST":
            side, k, n = int(numbers[0]), numbers[1] - 1, numbers[2] - 1
            t = max(0.0, t)
            share = (
                math.factorial(n)
                / (math.factorial(k) * math.factorial(n - k))
                * t**k
                * (1 - t) ** (n - k)
            )
            if up[row] > 0 if side else up[row] < 0:
                moves[row, 1] = value * math.sqrt(t) * (1 - t) * share
        elif kind == "HICKS_HENNE":
            side, place = numbers
            t = max(0.0, t)
            bump = (
                math.sin(math.pi * t ** (math.log10(0.5) / math.log10(place))) ** 3
                if t > 1e-15
                else 0.0
            )
            moves[row, 1] = value * bump * ((up[row] > 0) if side else -1 * (up[row] < 0))
        elif kind == "NACA_4DIGITS":  # those of 2412
            mean = (
                0.02 / 0.16 * (0.8 * t - t**2) if t < 0.4 else 0.02 / 0.36 * (0.2 + 0.8 * t - t**2)
            )
            half = 0.6 * (
                0.2969 * max(t, 0) ** 0.5
                - 0.126 * t
                - 0.3516 * t**2
                + 0.2843 * t**3
                - 0.1036 * t**4
            )
            moves[row, 1] = (
                mean + half - y if up[row] > 0 else mean - half - y if up[row] < 0 else 0
            )
        elif kind == "PARABOLIC":
            centre, thick = numbers[0], numbers[1] / 100
            arc = thick * (t * t - t) / (2.0 * (centre * centre - centre))
            moves[row, 1] = arc - y if up[row] > 0 else -arc - y if up[row] < 0 else 0
    return moves


@pytest.mark.parametrize(
    "listed",
    [
        [
            ("HICKS_HENNE", (1, 0.3), 0.01),
            ("HICKS_HENNE", (0, 0.6), 0.02),
            ("HICKS_HENNE", (1, 0.3), 0.005),
        ],
        [
            ("SURFACE_BUMP", (0.2, 0.7, 0.4), 0.02),
            ("CST", (0, 5, 7), 0.03),
            ("CST", (1, 2, 6), 0.05),
        ],
        [("PARABOLIC", (0.5, 12), 1.0)],
        [("NACA_4DIGITS", (2, 4, 12), 1.0)],
    ],
)
def test_kinds_that_look_at_x(folder, listed):
    param = "; ".join(str(numbers) for _, numbers, _ in listed)
    kinds, values = (
        ", ".join(kind for kind, *_ in listed),
        ", ".join(str(value) for *_, value in listed),
    )
    case = config(folder, kinds, param, values)
    (x, after), up = moved(case), shapes.wall_normals(case.mesh, "airfoil")[:, 1]
    np.testing.assert_allclose(
        after, x + sum(su2_loop(x, up, *each) for each in listed), atol=1e-15
    )
    assert np.abs(after - x).max() > 0.005
    assert case.names == tuple(f"{kind}[{k}]" for k, (kind, *_) in enumerate(listed))
    slope = shapes.project(case.shape, x, case.parameters, np.ones_like(x))
    if case.constants:
        assert case.constants == [f"{kinds}[0]"]
        return
    expected = [su2_loop(x, up, kind, numbers, 1.0).sum() for kind, numbers, _ in listed]
    np.testing.assert_allclose(slope, expected, rtol=1e-12)


def test_bumps_of_the_camber_line(folder):
    """Both sides move across the chord, which is turned here; behind 0.99 nothing moves."""
    mesh, angle, shift = io.read(folder / "airfoil.su2"), np.deg2rad(8), np.array([0.3, -0.2])
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])  # nose up
    io.write(folder / "pitched.su2", mesh.moved(np.asarray(mesh.points) @ turn.T + shift))
    case = config(
        folder,
        "HICKS_HENNE_CAMBER, HICKS_HENNE_CAMBER",
        "(0.3); (0.8)",
        "0.02, 0.01",
        mesh="pitched",
    )
    x, after = moved(case)
    tail = x[np.argmax(x[:, 0])]
    nose = x[np.argmax(np.linalg.norm(x - tail, axis=1))]
    along = (tail - nose) / np.linalg.norm(tail - nose)
    np.testing.assert_allclose(along, turn[:, 0], atol=0.02)
    up = np.zeros(len(x))
    for row, t in enumerate(np.maximum((x - nose) @ along, 0)):
        for place, value in ((0.3, 0.02), (0.8, 0.01)):
            bump = (
                math.sin(math.pi * t ** (math.log10(0.5) / math.log10(place))) ** 3
                if t > 1e-15
                else 0.0
            )
            up[row] += value * bump * (t <= 0.99)
    np.testing.assert_allclose(after - x, up[:, None] * np.array([-along[1], along[0]]), atol=1e-14)
    assert up.max() > 0.019


def test_whole_meshes_move(folder):
    mesh = io.read(folder / "airfoil.su2")
    for kind, param, value, expected in (
        ("SCALE_GRID", "(1.0)", 0.001, lambda p: 0.001 * p),
        ("TRANSLATE_GRID", "(3, 4, 0)", 0.5, lambda p: p + np.array([0.3, 0.4])),
        ("ROTATE_GRID", "(0.25, 0.1, 0, 0.25, 0.1, 1)", 30, lambda p: (
            turned(np.column_stack([p, np.zeros(len(p))]), np.array([0.25, 0.1, 0]), np.array([0.25, 0.1, 1]), 30)[:, :2])),
    ):  # fmt: skip
        case = config(folder, kind, param, value, more="MARKER_SYM= farfield\n", marker="")
        assert (set(case.moving), case.fixed, case.symmetry) == (set(mesh.patches), (), ())
        plan = jm.prepare(
            case.mesh, case.moving, case.fixed, symmetry=case.symmetry, method=jm.RBF.classic()
        )
        points = jm.deform(plan, shapes.displacement(case.shape, plan, case.parameters))
        np.testing.assert_allclose(points, expected(np.asarray(mesh.points)), atol=1e-9)


def test_walls_stay_in_symmetry_planes(folder):
    """A node of a marker in MARKER_SYM keeps its height above that plane, and so do those of a marker that is in both lists."""
    more = "MARKER_SYM= ( wall, side )\nMARKER_INTERNAL= ( cut )\n"
    case = config(folder, "TRANSLATION", "(1, 2, 3)", "0.01", more, "room", "floor, wall")
    x, after = moved(case)
    expected = np.array([0.01, 0.02, 0.03]) * np.column_stack(
        [x[:, 0] > 0, x[:, 1] > 0, np.ones(len(x))]
    )
    np.testing.assert_allclose(after - x, expected, atol=1e-16)
    assert (case.moving, case.symmetry, case.fixed) == (("floor", "wall"), ("side",), ("lid",))


def box_of_su2(case, listed, length=1.0, fixed=((), (), ())):
    """Moves control points as SU2 does, in its loops over boxes that are always 3-D; returns them before and after."""
    flat = len(CORNERS[0]) == case.mesh.points.shape[1]
    (box,) = case.boxes
    counts = (*box.shape.counts, 2) if flat else box.shape.counts
    corners = [(*c, z) for z in (-0.5, 0.5) for c in CORNERS] if flat else box.shape.given_corners
    start = np.zeros((*counts, 3))
    for place in np.ndindex(counts):
        u, v, w = (k / (n - 1) for k, n in zip(place, counts, strict=True))
        around = [(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v]
        shares = [a * b for b in (1 - w, w) for a in around]
        start[place] = sum(
            share * np.array(corner) for share, corner in zip(shares, corners, strict=True)
        )
    control, d = start.copy(), 2 if flat else 3

    def stays(*index):
        return any(k in planes for k, planes in zip(index, fixed, strict=False))

    for kind, numbers, values in listed:
        value, ends = (
            values[0],
            np.split(np.array(numbers[-6:], float), 2) if len(numbers) > 5 else None,
        )
        if kind.startswith("FFD_CONTROL_POINT"):
            way = np.zeros(3)
            way[:d] = np.array(numbers[d:]) * value if len(values) == 1 else values
            index = [*numbers[:d], *([-1] if flat else [])]
            every = [a for a in range(d) if index[a] == -1]
            for place in np.ndindex(counts) if not stays(*index) else ():
                named = all(i in (-1, k) for i, k in zip(index, place, strict=True))
                held = not flat and len(every) == 1 and place[every[0]] in fixed[every[0]]
                control[place] += way if named and not held else 0
        elif kind.startswith(("FFD_CAMBER", "FFD_THICKNESS")):
            for side in (0, 1) if flat or not (stays(*numbers, 0) or stays(*numbers, 1)) else ():
                control[(*numbers, side)][..., d - 1] += (
                    -value if "THICK" in kind and side == 0 else value
                )
        elif kind == "FFD_GULL":
            control[:, numbers[0], :, 2] += 0 if stays(-1, numbers[0]) else value
        elif kind == "FFD_NACELLE":
            i, j, k, *way = numbers
            for theta in dict.fromkeys([j, counts[1] - 1 - j]):
                if stays(i, theta, k):
                    break
                control[slice(None) if i == -1 else i, theta, k] += value * np.array(
                    [way[0], 0, way[1]]
                )
        elif kind in ("FFD_CONTROL_SURFACE", "FFD_ROTATION"):
            part, sign = (control[:-2, 2:-2], -1) if "SURFACE" in kind else (control, 1)
            part[...] = turned(part, *ends, sign * value)
        elif kind == "FFD_TWIST":
            j, (a, b) = numbers[0], ends
            share = (control[0, j, 0, 1] - a[1]) / (b[1] - a[1])
            about = a + share * (b - a)
            spun = turned(
                control[:, j],
                about,
                about + np.array([0, 1, 0]),
                np.rad2deg(math.atan(value / length)),
            )
            for i, k in itertools.product(range(counts[0]), range(counts[2])):
                if 0 <= share <= 1 and not stays(i, j, k):
                    control[i, j, k] = spun[i, k]
    return start, control


def evaluated(control, t):
    """Places at coordinates t of a box with these control points: Bernstein polynomials."""
    out = np.zeros((len(t), 3))
    for place in np.ndindex(control.shape[:3]):
        weight = np.ones(len(t))
        for a, (k, n) in enumerate(zip(place, control.shape[:3], strict=True)):
            weight *= math.comb(n - 1, k) * t[:, a] ** k * (1 - t[:, a]) ** (n - 1 - k)
        out += weight[:, None] * control[place]
    return out


def check_box(case, listed, **options):
    (x, after), (box,) = moved(case), case.boxes
    start, control = box_of_su2(case, listed, **options)
    marker = case.moving[0]
    nodes, places = box.surface[marker]
    t = np.column_stack([places, np.full((len(nodes), 3 - places.shape[1]), 0.5)])
    d = x.shape[1]
    np.testing.assert_allclose(evaluated(start, t)[:, :d], case.mesh.points[nodes], atol=1e-13)
    expected = x.copy()
    expected[np.searchsorted(case.mesh.patch(marker), nodes)] = evaluated(control, t)[:, :d]
    np.testing.assert_allclose(after, expected, atol=1e-13)
    assert np.abs(after - x).max() > 1e-3
    (written,) = case.moved_boxes
    np.testing.assert_allclose(
        written.control, control[..., :3] if d == 3 else control[:, :, 0, :2], atol=1e-13
    )


def test_boxes_in_2d(folder):
    listed = [
        ("FFD_CONTROL_POINT_2D", [1, 1, 0.5, 2.0], [0.01]),
        ("FFD_CONTROL_POINT_2D", [2, -1, 0, 0], [0.01, 0.02]),
        ("FFD_CONTROL_POINT_2D", [-1, 0, 0, 1], [-0.01]),
        ("FFD_CAMBER_2D", [1], [0.03]),
        ("FFD_THICKNESS_2D", [2], [0.02]),
        ("FFD_ROTATION", [0.25, 0, 0, 0.25, 0, 1], [4]),
    ]
    case = config(folder, *words_of(listed, "MAIN"), TABLE)
    assert len(case.boxes[0].surface["airfoil"][0]) == len(case.mesh.patch("airfoil"))
    check_box(case, listed)


def words_of(listed, box="BOX"):
    """Kinds, parameters and values as a config file has them."""
    kinds = ", ".join(kind for kind, _, _ in listed)
    param = "; ".join(f"({box}, {', '.join(map(str, numbers))})" for _, numbers, _ in listed)
    return kinds, param, ", ".join(str(value) for _, _, values in listed for value in values)


def solid(corners, *, degrees="(3, 2, 1)", more=""):
    return f"FFD_DEFINITION= (BOX, {', '.join(map(str, corners.ravel()))})\nFFD_DEGREE= {degrees}\n{more}"


LISTED = [
    ("FFD_CONTROL_POINT", [1, 1, 1, 0.5, 2.0, 1.0], [0.01]),
    ("FFD_CONTROL_POINT", [2, -1, 0, 0, 0, 0], [0.01, 0.02, 0.03]),
    ("FFD_CONTROL_POINT", [-1, 0, -1, 0, 1, 0], [-0.01]),
    ("FFD_CAMBER", [1, 0], [0.03]),
    ("FFD_THICKNESS", [2, 1], [0.02]),
    ("FFD_TWIST", [1, 0.3, -1, 0, 0.4, 2, 0.1], [0.2]),
    ("FFD_ROTATION", [0.25, 0, 0, 0.25, 1, 0.5], [4]),
]


@pytest.mark.nightly
def test_wings_gulls_and_nacelles(folder):
    listed = [
        ("FFD_GULL", [2], [0.05]),
        ("FFD_NACELLE", [1, 1, 0, 1.0, 0.5], [0.02]),
        ("FFD_NACELLE", [-1, 0, 1, 0.5, 1.0], [0.01]),
        ("FFD_CONTROL_SURFACE", [0.25, 0, 0, 0.25, 1, 0.5], [4]),
    ]
    more = solid(WHOLE, degrees="(3, 5, 1)")
    case = config(folder, *words_of(listed), more, mesh="brick", marker="floor")
    check_box(case, listed)


@pytest.mark.nightly
def test_a_box_of_splines_gives_the_wall_at_rest(folder):
    """Coordinates in the box are those at which the lattice at rest gives the wall: else SU2 would move it by nothing."""
    more = solid(
        WHOLE,
        degrees="(5, 4, 2)",
        more="FFD_BLENDING= BSPLINE_UNIFORM\nFFD_BSPLINE_ORDER= 4, 3, 2\n",
    )
    case = config(folder, "FFD_CAMBER", "(BOX, 1, 1)", "0.1", more, mesh="brick", marker="floor")
    (box,) = case.boxes
    nodes, places = box.surface["floor"]
    knots = [
        np.clip(np.arange(-p, n + 1) / (n - p), 0, 1)
        for n, p in zip((6, 5, 3), (3, 2, 1), strict=True)
    ]
    weights = [
        np.nan_to_num(scipy.interpolate.BSpline(each, np.eye(n), p)(places[:, axis]))
        for axis, (each, n, p) in enumerate(zip(knots, (6, 5, 3), (3, 2, 1), strict=True))
    ]
    at_rest = np.einsum("ma,mb,mc,abcd->md", *weights, box.control)
    np.testing.assert_allclose(at_rest, np.asarray(case.mesh.points)[nodes], atol=1e-14)
    (after,) = case.moved_boxes
    x, wall = moved(case)
    expected = np.einsum("ma,mb,mc,abcd->md", *weights, after.control - box.control)
    np.testing.assert_allclose(wall - x, expected, atol=1e-14)
    assert np.abs(wall - x).max() > 0.01


@pytest.mark.nightly
@pytest.mark.parametrize("continuity", ["NO_DERIVATIVE", "2ND_DERIVATIVE", "USER_INPUT", None])
def test_boxes_in_3d(folder, continuity):
    """A box that ends within the wall holds the planes of control points behind that face; one around it holds none."""
    more = f"FFD_CONTINUITY= {continuity}\nFFD_FIX_I= (0, 9)\nFFD_FIX_J= (2)\nFFD_FIX_K= (9)\nREF_LENGTH= 2.0\n"
    fixed = {
        "NO_DERIVATIVE": ((), (2,), ()),
        "2ND_DERIVATIVE": ((), (2, 1, 0), ()),
        "USER_INPUT": ((0,), (2,), ()),
    }
    text = solid(SOLID if continuity else WHOLE, more=more if continuity else "REF_LENGTH= 2.0\n")
    case = config(folder, *words_of(LISTED), text, mesh="brick", marker="floor")
    check_box(case, LISTED, length=2.0, fixed=fixed.get(continuity, ((), (), ())))


@pytest.mark.parametrize("option", ["DV_FILENAME", "MOTION_FILENAME"])
def test_positions_from_a_file(folder, option):
    mesh = io.read(folder / "airfoil.su2")
    nodes, rng = mesh.patch("airfoil"), np.random.default_rng(0)
    target = np.asarray(mesh.points)[nodes] + 0.01 * rng.normal(size=(len(nodes), 2))
    rows = [
        f"{node}\t{x!r}\t{y!r}"
        for node, (x, y) in zip(nodes.tolist(), target.tolist(), strict=True)
    ]
    (folder / "wall.dat").write_text("\n".join(rows[::-1]) + "\n")
    case = config(
        folder, "SURFACE_FILE", "( 1.0 )", "1.0", f"{option}= wall.dat\nDEFORM_NONLINEAR_ITER= 3\n"
    )
    x, after = moved(case)
    np.testing.assert_allclose(after, target, atol=1e-16)
    np.testing.assert_allclose(case.path[1], (target - x) * 2 / 3, atol=1e-16)


def test_a_motion_that_inverts_cells_names_the_option_for_more_steps(folder, tmp_path, capsys):
    """What is said works: a turn by 160 degrees, in 4 steps."""
    more = f"MESH_OUT_FILENAME= {tmp_path}/out.su2\n"
    config(folder, "ROTATION", "(0.5, 0, 0, 0.5, 0, 1)", "160", more)
    command = ["su2", "def", str(folder / "case.cfg"), "--method", "rbf"]
    assert main(command) == 1
    (said,) = re.findall("such as (DEFORM_NONLINEAR_ITER= 4)", capsys.readouterr().err)
    assert not (tmp_path / "out.su2").exists()
    config(folder, "ROTATION", "(0.5, 0, 0, 0.5, 0, 1)", "160", f"{more}{said}\n")
    assert main(command) == 0
    assert "DEFORM_NONLINEAR_ITER" not in capsys.readouterr().err
    with pytest.raises(
        FileNotFoundError, match=r"case\.cfg: MESH_FILENAME= there is no file .*none"
    ):
        config(folder, "ROTATION", "(0, 0, 0, 0, 0, 1)", "1", mesh="none")


def test_how_options_are_written(folder):
    text = """% made by hand, DV_KIND= NONSENSE
MESH_FILENAME=airfoil.su2   % the mesh
MESH_OUT_FILENAME = moved
MATH_PROBLEM= DIRECT
DV_KIND= HICKS_HENNE, \\
         HICKS_HENNE
DV_PARAM= ( 1, 0.3 ); \\ % upper
  ( 0, 0.6 )
DV_VALUE= 0.01, 0.02
DV_MARKER= ( airfoil )
OPT_RELAX_FACTOR= 2.0
DEFINITION_DV= ( 30, 0.5 | airfoil | 1, 0.3 ); ( HICKS_HENNE, 1.0 | airfoil | 0, 0.6 ); ( 1, 1.0 | airfoil | 0, 1, 0 )
"""
    (folder / "written.cfg").write_text(text)
    case = su2.read_config(folder / "written.cfg")
    assert case.output == folder / "moved.su2"
    assert case.parameters.tolist() == [0.01, 0.02]
    x, after = moved(case)
    _, plain = moved(config(folder, "HICKS_HENNE, HICKS_HENNE", "(1, 0.3); (0, 0.6)", "0.02, 0.04"))
    np.testing.assert_allclose(after, plain, atol=1e-16)
    defined = su2.read_config(folder / "written.cfg", definition=True)
    assert defined.names == ("HICKS_HENNE[0]", "HICKS_HENNE[1]", "TRANSLATION[2]")
    assert not defined.parameters.any()
    up = np.array([0, 0.2])
    np.testing.assert_allclose(defined.shape(x, [0.02, 0.02, 0.1]), plain + up, atol=1e-15)


def test_names_are_in_any_case_and_the_result_is_su2s(folder):
    io.write(folder / "airfoil.vtu", io.read(folder / "airfoil.su2"))
    lines = "mesh_filename= airfoil.vtu\nMesh_Out_Filename= moved\ndv_kind= scale\nDV_MARKER= airfoil\nDV_VALUE= 1.1\n"
    (folder / "case.cfg").write_text(lines)
    case = su2.read_config(folder / "case.cfg")
    assert (case.output, case.parameters.tolist()) == (folder / "moved.su2", [1.1])


DEFINITION = f"FFD_DEFINITION= (MAIN, 0,-1,0, 1,-1,0, 1,1,0, 0,1,0, {', '.join('0' * 12)})\n"


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"kind": "HICKS_HENN"}, "HICKS_HENN is not taken .did you mean HICKS_HENNE"),
        ({"kind": "AIRFOIL"}, "AIRFOIL is not taken; .*TRANSLATION"),
        ({"kind": "SURFACE_BUMP", "param": "(0.2, 0.4, 0.5)"}, "it must lie between"),
        ({"kind": "CST", "param": "(1, 4, 3)"}, "CST has the function 4 of 3"),
        ({"kind": "HICKS_HENNE_CAMBER", "param": "(1)"}, "a bump has its top at 1"),
        (
            {"kind": "HICKS_HENNE_CAMBER, SCALE", "param": "(0.5); (1)", "value": "1, 1"},
            "SU2 moves by one sort",
        ),
        (
            {"kind": "SCALE_GRID, SCALE", "param": "(1); (1)", "value": "1, 1"},
            "SCALE_GRID is taken alone",
        ),
        ({"kind": "TRANSLATE_GRID", "param": "(0, 0, 1)"}, "vector without length"),
        ({"kind": "FFD_TWIST_2D"}, "FFD_TWIST_2D is not taken"),
        ({"param": "(1)"}, "HICKS_HENNE has 2 parameters, found 1"),
        ({"param": "(1, 0.3); (0, 0.2)"}, "2 groups of parameters for 1 of DV_KIND"),
        ({"param": "(1, wide)"}, "DV_PARAM= a number expected, found 'wide'"),
        ({"param": "(4, 0.3)"}, "HICKS_HENNE has the side 4"),
        ({"value": "0.1, 0.2"}, "DV_VALUE= 1 values expected, one for each number, found 2"),
        ({"value": "0.1, nan"}, "a number expected"),
        ({"marker": "wing"}, "DV_MARKER= names no marker .*it has airfoil, farfield"),
        ({"marker": ""}, "DV_MARKER= names no marker"),
        ({"more": "DV_VALUE= 1\n"}, "DV_VALUE= comes a second time"),
        ({"more": "DEFORM_NONLINEAR_ITER= 0\n"}, "1 or more"),
        (
            {"more": "DEFORM_NONLINEAR_ITER= 2.5\n"},
            "a whole number, 1 or more, expected, found 2.5",
        ),
        (
            {"kind": "FFD_SETTING", "more": DEFINITION + "FFD_DEGREE= (3.5, 1, 0)\n"},
            "FFD_DEGREE= a whole number",
        ),
        (
            {"kind": "FFD_SETTING", "more": DEFINITION + "FFD_DEGREE= (3)\n"},
            "FFD_DEGREE= 2 degrees .* found 4",
        ),
        (
            {"kind": "FFD_SETTING", "more": DEFINITION + "FFD_DEGREE= (99999, 9999, 0)\n"},
            "at most 1000000 control",
        ),
        ({"more": "nonsense\n"}, "line 6: an option NAME= value expected"),
        (
            {"kind": "NACA_4DIGITS, TRANSLATION", "param": "(2,4,12); (1,0,0)", "value": "1, 1"},
            "taken alone",
        ),
        ({"kind": "ROTATION", "param": "(0,0,0,1,0,1)"}, "both ends have the same x and y"),
        (
            {"kind": "FFD_CAMBER_2D", "param": "(MAIN, 1)"},
            "no box MAIN in the mesh file; it has none",
        ),
        (
            {"kind": "FFD_CAMBER_2D", "param": "(TAIL, 1)", "more": TABLE},
            "no box TAIL.*it has MAIN",
        ),
        (
            {"kind": "FFD_CAMBER_2D", "param": "(MAIN, 7)", "more": TABLE},
            "i = 7; box MAIN has control points 0 to 3",
        ),
        (
            {"kind": "FFD_CAMBER", "param": "(MAIN, 1, 0)", "more": TABLE},
            "FFD_CAMBER in a mesh in 2-D",
        ),
        (
            {"kind": "FFD_CAMBER_2D", "param": "(MAIN, 1)", "more": TABLE + "FFD_CONTINUITY= C1\n"},
            "C1 is not taken",
        ),
        (
            {
                "kind": "FFD_CAMBER_2D",
                "param": "(MAIN, 1)",
                "more": TABLE + "FFD_COORD_SYSTEM= POLAR\n",
            },
            "POLAR is not taken; CARTESIAN is",
        ),
        (
            {"kind": "FFD_CAMBER_2D, SCALE", "param": "(MAIN, 1); (1)", "value": "1, 1"},
            "SU2 moves by one",
        ),
    ],
)
def test_what_is_not_taken_is_told_by_its_name(folder, change, says):
    given = {"kind": "HICKS_HENNE", "param": "(1, 0.3)", "value": "0.01"} | change
    with pytest.raises(ValueError, match=rf"case\.cfg.*{says}|{says}"):
        config(folder, **given)


HALF_BOX = f"0, -1, 0, 1, -1, 0, 1, 1, 0, 0, 1, 0, {', '.join('0' * 12)}"
TUTORIALS = {
    "RAE2822": ("HICKS_HENNE", "( 1, 0.5 )", "0.01", "OPT_RELAX_FACTOR= 1E2\nOPT_LINE_SEARCH_BOUND= 1E6\n",
                ["the wall moves by 0.99.* times its own length: OPT_RELAX_FACTOR= 100 multiplies"]),
    "NACA0012": ("HICKS_HENNE", "( 1, 0.5 )", "1.0", "DEFORM_LINEAR_SOLVER_ITER= 500\nDEFORM_STIFFNESS_TYPE= INVERSE_VOLUME\n",
                 ["not honoured .*: DEFORM_STIFFNESS_TYPE= INVERSE_VOLUME", "0.99.* times its own length: check DV_VALUE"]),
    "unsteady": ("FFD_CONTROL_POINT_2D", "( MAIN, 0.0, 0.0, 1.0, 0.0)", "0.01",
                 TABLE + "MARKER_INTERNAL= ( FWH1 )\nDEFORM_STIFFNESS_TYPE= WALL_DISTANCE\nOPT_RELAX_FACTOR= 1\n",
                 ["MARKER_INTERNAL= the mesh has no marker FWH1"]),
    "wedge": ("FFD_CONTROL_POINT_2D", "(MAIN, 3,0, 0,1.0,0,0 )", "0.5", TABLE + "FFD_CONTINUITY= 2ND_DERIVATIVE\n",
              ["DV_PARAM= FFD_CONTROL_POINT_2D has 5 parameters, left out: 0 0"]),
    "heat": ("FFD_SETTING", "(( UPPER, 14, 1, 0.0, 1.0 ), ( LOWER, 14, 1, 0.0, 1.0 ))", "0",
             f"FFD_DEFINITION= (UPPER, {HALF_BOX}); \\\n (LOWER, {HALF_BOX}, 0.0)\nFFD_DEGREE= ( 14, 1, 0); ( 14, 1, 0)\n",
             ["FFD_DEFINITION= box LOWER has 24 parameters, left out: 0.0"]),
    "RBF": ("HICKS_HENNE", "( 1, 0.5 )", "0.1", "DEFORM_KIND= RBF\nRBF_DATA_REDUCTION= YES\nRBF_GREEDY_TOLERANCE= 1E-3\n",
            ["not honoured .*: DEFORM_KIND= RBF"]),
    "bend": ("TRANSLATION", "(0, 1, 0)", "0.1", "MARKER_SYM= ( symmetry )\nDEFORM_COEFF = 1.0e6\nDEFORM_LIMIT = 1E6\n",
             ["MARKER_SYM= the mesh has no marker symmetry"]),
    "checks": ("HICKS_HENNE", "(1, 0.3)", "0.01", "FFD_INTPREV= YES\nCONVEXITY_CHECK= TRUE\nHOLD_GRID_FIXED= NO\n",
               ["not honoured .*: FFD_INTPREV= YES, CONVEXITY_CHECK= TRUE"]),
    "periodic": ("TRANSLATION", "(0, 1, 0)", "0.1", "MARKER_PERIODIC= ( low, high, 0,0,0, 0,0,0, 0,1,0, in, out, 0,0,0, 0,0,0, 2,0,0 )\n",
                 ["not honoured .*: MARKER_PERIODIC=", "moves periodic patches alike by --periodic low high in out"]),
    "held": ("FFD_CONTROL_POINT_2D", "(MAIN, 2, 1, 0, 1)", "0.1", f"FFD_DEFINITION= (MAIN, {HALF_BOX})\nFFD_DEGREE= (2, 1, 0)\n",
             [r"1 of 1 design variables move nothing, FFD_CONTINUITY= 2ND_DERIVATIVE holds .*: MAIN \(2, 1\)"]),
    "defaults": ("TRANSLATION", "(1, 0, 0)", "2.0", "DEFORM_POISSONS_RATIO= 0.30\nDEFORM_KIND= elastic\nMESH_FORMAT= SU2\n", []),
}  # fmt: skip


@pytest.mark.parametrize("case", TUTORIALS)
def test_what_su2_would_do_otherwise_is_told_and_its_tutorials_run(folder, case):
    *given, says = TUTORIALS[case]
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        read = config(folder, *given)
    assert len(told) == len(says)
    assert bool(read.names) == (given[0] != "FFD_SETTING")
    if not read.names:
        assert [box.name for box in read.boxes] == ["UPPER", "LOWER"]
        np.testing.assert_array_equal(read.boxes[1].control[-1, -1], [1, 1])
    for each, warning in zip(says, told, strict=True):
        assert re.search(each, str(warning.message))
        assert warning.filename == __file__


@pytest.mark.filterwarnings("default")
def test_the_command_says_what_multiplies_the_values(folder, tmp_path, capsys):
    """The motion that is printed is the value times SU2's factor; `dot` prints both, too."""
    more = f"OPT_RELAX_FACTOR= 100\nMESH_OUT_FILENAME= {tmp_path}/out.su2\n"
    with pytest.warns(UserWarning, match="OPT_RELAX_FACTOR"):
        config(folder, "HICKS_HENNE", "(1, 0.5)", "0.01", more)
    main(["su2", "def", str(folder / "case.cfg"), "--method", "graph"])
    out, err = capsys.readouterr()
    assert "values   1 HICKS_HENNE: 0.01, times OPT_RELAX_FACTOR= 100\n" in out
    assert re.search(r"largest  0.98\d+, 0.99 times the length of what moves", out)
    assert "OPT_RELAX_FACTOR= 100 multiplies DV_VALUE" in err
    main(["su2", "dot", str(folder / "case.cfg")])
    assert "0.01, times OPT_RELAX_FACTOR= 100" in capsys.readouterr().out


@pytest.mark.slow
def test_a_gradient_by_boxes_is_its_differences(folder):
    still = [(kind, numbers, [0] * len(values)) for kind, numbers, values in LISTED]
    case = config(folder, *words_of(still), solid(WHOLE), mesh="brick", marker="floor")
    x, rng = moved(case)[0], np.random.default_rng(0)
    weights = rng.normal(size=x.shape)
    gradient = np.asarray(shapes.project(case.shape, x, case.parameters, weights))
    place = jax.jit(lambda step: case.shape(x, step))
    steps = 1e-6 * np.eye(len(gradient))
    differences = [np.vdot(weights, place(step) - place(-step)) / 2e-6 for step in steps]
    np.testing.assert_allclose(gradient, differences, rtol=1e-6, atol=1e-9)


@pytest.mark.nightly
def test_both_commands_on_boxes_that_the_mesh_keeps(folder, tmp_path, capsys):
    """FFD_SETTING puts a box into the mesh, two deformations go on from each other, and dot is their derivative."""
    mesh = io.read(folder / "airfoil.su2")
    io.write(tmp_path / "airfoil.su2", mesh)
    base = "DV_MARKER= ( airfoil )\nMESH_FILENAME= {}\nMESH_OUT_FILENAME= {}\n"
    kinds = "DV_KIND= FFD_CONTROL_POINT_2D, FFD_CAMBER_2D\nDV_PARAM= (MAIN, 1, 1, 0, 1); (MAIN, 2)\nDV_VALUE= {}\n"
    setting = (
        base.format("airfoil.su2", "set.su2")
        + "DV_KIND= FFD_SETTING\nDV_PARAM= ( 1.0 )\nDV_VALUE= 0.0\n"
        + TABLE
    )
    (tmp_path / "a.cfg").write_text(setting)
    (tmp_path / "b.cfg").write_text(base.format("set.su2", "one.su2") + kinds.format("0.02, 0.01"))
    (tmp_path / "c.cfg").write_text(base.format("one.su2", "two.su2") + kinds.format("0.01, -0.02"))
    for name in "abc":
        assert main(["su2", "def", str(tmp_path / f"{name}.cfg"), "--method", "rbf"]) == 0
    start, end = io.read(tmp_path / "set.su2"), io.read(tmp_path / "two.su2")
    np.testing.assert_array_equal(start.points, mesh.points)
    (before,), (after,) = io.boxes(start), io.boxes(end)
    np.testing.assert_allclose(
        after.control - before.control, change(4, 2, 0.03, -0.01), atol=1e-15
    )
    nodes, places = before.surface["airfoil"]
    weights = before.shape.box.at(places)
    wall = np.asarray(mesh.points)[nodes] + np.asarray(weights(after.control - before.control))
    np.testing.assert_allclose(end.points[nodes], wall, atol=1e-14)
    far = mesh.patch("farfield")
    np.testing.assert_array_equal(end.points[far], mesh.points[far])
    capsys.readouterr()
    sens = np.random.default_rng(0).normal(size=(len(nodes), 2))
    rows = [
        f"{n}, 0, 0, {a!r}, {b!r}, 0"
        for n, (a, b) in zip(nodes.tolist(), sens.tolist(), strict=True)
    ]
    (tmp_path / "surface_sens.csv").write_text(
        '"PointID", "x", "y", "Sensitivity_x", "Sensitivity_y", "Surface_Sensitivity"\n'
        + "\n".join(rows)
        + "\n"
    )
    facts = json.loads(printed(capsys, ["su2", "dot", str(tmp_path / "c.cfg"), "--json"]))
    first, *lines = (tmp_path / "of_grad.dat").read_text().splitlines()
    assert (first.split(), facts["kind"]) == (["DRAG", "gradient"], "surface")
    expected = [np.vdot(sens, weights(change(4, 2, *way))) for way in np.eye(2)]
    np.testing.assert_allclose([float(line) for line in lines], expected, rtol=1e-12)
    np.testing.assert_allclose(list(facts["gradient"].values()), expected, rtol=1e-12)


def change(p, q, at, camber):
    """Displacements of a lattice p x q by a control point and a camber."""
    control = np.zeros((p, q, 2))
    control[1, 1, 1] += at
    control[2, :, 1] += camber
    return control


@pytest.mark.nightly
def test_dot_takes_the_volume_through_the_mesh(folder, tmp_path, capsys):
    mesh = io.read(folder / "airfoil.su2")
    io.write(tmp_path / "airfoil.su2", mesh)
    more = "OBJECTIVE_FUNCTION= LIFT\nGRAD_OBJFUNC_FILENAME= lift_grad.dat\nSOLUTION_ADJ_FILENAME= solution_adj.dat\n"
    case = config(tmp_path, "HICKS_HENNE, TRANSLATION", "(1, 0.4); (0.6, 0.8, 0)", "0.01, 0", more)
    weights = np.random.default_rng(0).normal(size=mesh.points.shape)
    np.savez(tmp_path / "sens.npz", sensitivity=weights)
    words = ["su2", "dot", str(tmp_path / "case.cfg"), "--method", "rbf"]
    (tmp_path / "solution_adj.dat").write_bytes((535532).to_bytes(4, "little") + bytes(16))
    assert main(words) == 2
    assert "a binary restart of 0 nodes" in capsys.readouterr().err
    assert main([*words, "--sensitivity", str(tmp_path / "sens.npz")]) == 0
    plan = jm.prepare(case.mesh, case.moving, case.fixed, method=jm.RBF.classic())
    wall = np.asarray(case.mesh.points)[plan.moving]
    values = [
        np.vdot(weights, jm.deform(plan, case.shape(wall, h * way) - wall))
        for way in np.eye(2) for h in (1e-5, -1e-5)
    ]  # fmt: skip
    first, *lines = (tmp_path / "lift_grad.dat").read_text().splitlines()
    assert first == "LIFT gradient "
    differences = [(values[0] - values[1]) / 2e-5, (values[2] - values[3]) / 2e-5]
    np.testing.assert_allclose([float(line) for line in lines], differences, rtol=1e-6)


@pytest.mark.slow
def test_def_does_not_write_a_broken_mesh(folder, tmp_path, capsys):
    io.write(tmp_path / "airfoil.su2", io.read(folder / "airfoil.su2"))
    config(tmp_path, "SCALE", "(1)", "-1", "MARKER_SYM= NONE\n")
    words = ["su2", "def", str(tmp_path / "case.cfg"), "--method", "rbf"]
    assert main(words) == 1
    assert "inverted" in capsys.readouterr().err
    assert not (tmp_path / "mesh_out.su2").exists()
