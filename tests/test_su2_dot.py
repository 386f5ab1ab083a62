"""`jaxmorph su2 dot` on the files that SU2's adjoint solvers leave: names, formats, the angle of attack."""

import json

import numpy as np
import pytest
from runs import printed

from jaxmorph import cases, io, shapes
from jaxmorph.integrations import su2

CONFIG = """MATH_PROBLEM= {problem}
OBJECTIVE_FUNCTION= {objective}
MESH_FILENAME= airfoil.su2
DV_KIND= HICKS_HENNE, ANGLE_OF_ATTACK
DV_PARAM= (1, 0.4); (1.0)
DV_VALUE= 0.01, 0.0
DV_MARKER= ( airfoil )
SOLUTION_ADJ_FILENAME= solution_adj.dat
"""
NAMES = ["x", "y", "Adjoint_Density", "Sensitivity_x", "Sensitivity_y", "Surface_Sensitivity"]
ANGLE = -0.0625


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    file = tmp_path_factory.mktemp("dot") / "airfoil.su2"
    io.write(file, cases.naca0015(points=300))
    return io.read(file)


@pytest.fixture
def folder(mesh, tmp_path):
    io.write(tmp_path / "airfoil.su2", mesh)
    return tmp_path


def opened(folder, problem="DISCRETE_ADJOINT", objective="DRAG"):
    (folder / "case.cfg").write_text(CONFIG.format(problem=problem, objective=objective))
    with pytest.warns(UserWarning, match="ANGLE_OF_ATTACK"):
        return su2.read_config(folder / "case.cfg")


def table(mesh, seed=0):
    """Numbers of each node in the columns `NAMES`, and the sensitivities among them."""
    values = np.random.default_rng(seed).normal(size=(len(mesh.points), len(NAMES)))
    values[:, :2] = mesh.points
    return values, values[:, 3:5]


def write_binary(path, values, order="<", names=NAMES, tail=True):
    """SU2's binary restart: five numbers, names of 33 bytes, rows, and nine numbers of the run behind them."""
    head = np.array([535532, len(names), len(values), 0, 0], f"{order}i4").tobytes()
    head += b"".join(name.encode().ljust(33, b"\0") for name in names)
    facts = np.array([0.0, 1.25, 0, 0, ANGLE, 0, 0, 0], f"{order}f8").tobytes()
    end = np.array([250], f"{order}i4").tobytes() + facts if tail else b""
    path.write_bytes(head + values.astype(f"{order}f8").tobytes() + end)


def write_text(path, values, facts=True):
    header = ", ".join(f'"{name}"' for name in ["PointID", *NAMES])
    rows = [", ".join([str(k), *map(repr, row)]) for k, row in enumerate(values.tolist())]
    tail = ["EXT_ITER= 250", "AOA= 1.25", f"SENS_AOA= {ANGLE:.16e}"] if facts else []
    path.write_text("\n".join([header, *rows, *tail]) + "\n")


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("quote", ["", '"'])
def test_a_binary_restart_is_read(mesh, tmp_path, order, quote):
    values, expected = table(mesh)
    write_binary(
        tmp_path / "adjoint.dat", values, order, [f"{quote}{name}{quote}" for name in NAMES]
    )
    np.testing.assert_array_equal(io.read_sensitivity(tmp_path / "adjoint.dat", mesh), expected)
    content = (tmp_path / "adjoint.dat").read_bytes()
    (tmp_path / "adjoint.dat").write_bytes(content[: len(content) // 2])
    with pytest.raises(ValueError, match=r"adjoint.dat: a binary restart of .* bytes or more"):
        io.read_sensitivity(tmp_path / "adjoint.dat", mesh)
    write_binary(tmp_path / "flow.dat", values[:, :3], order, ["x", "y", "Density"])
    with pytest.raises(
        ValueError, match="without the columns sensitivity_x, sensitivity_y; it has x, y, density"
    ):
        io.read_sensitivity(tmp_path / "flow.dat", mesh)
    write_binary(tmp_path / "short.dat", values[1:], order)
    with pytest.raises(ValueError, match=r"short.dat: 1 of .* nodes are missing"):
        io.read_sensitivity(tmp_path / "short.dat", mesh)


@pytest.mark.filterwarnings("default:ANGLE_OF_ATTACK")
@pytest.mark.parametrize("form", ["binary", "binary without facts", "text", "text and meta"])
def test_the_angle_of_attack_has_the_derivative_that_the_file_tells(mesh, folder, form, capsys):
    values, expected = table(mesh)
    file = folder / "solution_adj.dat"
    if form.startswith("binary"):
        write_binary(file, values, tail=form == "binary")
    else:
        write_text(file, values, facts=form == "text")
    if form == "text and meta":
        file.with_suffix(".meta").write_text(f"ITER= 3\nSENS_AOA={ANGLE}\n")
    case = opened(folder)
    given = su2.read_sensitivity(case)
    np.testing.assert_array_equal(given.by_nodes, expected)
    assert given.by_angle == (None if form == "binary without facts" else ANGLE)
    assert (given.path, case.angles) == (file, [1])
    if form != "binary":
        return
    facts = json.loads(
        printed(capsys, ["su2", "dot", str(folder / "case.cfg"), "--method", "rbf", "--json"])
    )
    assert (facts["angle"], facts["kind"]) == (given.by_angle, "volume")
    first, bump, angle = (folder / "of_grad.dat").read_text().splitlines()
    assert (first, float(angle)) == ("DRAG gradient ", given.by_angle or 0)
    assert float(bump) != 0


@pytest.mark.parametrize(
    ("objective", "there", "taken"),
    [
        (
            "DRAG",
            ["solution_adj_cd.dat", "solution_adj_cl.dat", "solution_adj.dat"],
            "solution_adj_cd.dat",
        ),
        ("LIFT", ["solution_adj_cd.dat", "solution_adj_cl.csv"], "solution_adj_cl.csv"),
        (
            "( DRAG, LIFT )",
            ["solution_adj_cd.dat", "solution_adj_combo.dat"],
            "solution_adj_combo.dat",
        ),
        ("SURFACE_TOTAL_PRESSURE", ["solution_adj_pt.dat"], "solution_adj_pt.dat"),
        ("DRAG", ["volume_sens.csv", "solution_adj_cl.dat"], "volume_sens.csv"),
        ("DRAG", ["solution_adj_cl.dat"], None),
        ("SURFACE_MACH", ["solution_adj_pt.dat", "solution_adj_cl.dat"], None),
    ],
)
def test_files_are_called_by_the_objective(mesh, folder, objective, there, taken):
    for file in there:
        write_text(folder / file, table(mesh)[0])
    case = opened(folder, objective=objective)
    if taken:
        assert su2.read_sensitivity(case).path == folder / taken
        return
    with pytest.raises(
        ValueError, match=r"no file of sensitivities is there \(SOLUTION_ADJ_FILENAME= solution_adj"
    ):
        su2.read_sensitivity(case)


def test_the_continuous_adjoint_is_a_derivative_along_the_normals(mesh, folder):
    """SU2_DOT's loop: minus the normal of a node, which points into the flow, times the column `Surface_Sensitivity`."""
    case = opened(folder, problem="CONTINUOUS_ADJOINT")
    with pytest.raises(ValueError, match="SURFACE_ADJ_FILENAME= surface_adjoint"):
        su2.read_sensitivity(case)
    loop = shapes.wall_loop(mesh, "airfoil")
    x, rng = np.asarray(mesh.points), np.random.default_rng(1)
    slopes = dict(zip(loop.tolist(), rng.normal(size=len(loop)).tolist(), strict=True))
    rows = [f"{node}, 0.0, 0.0, {slope!r}" for node, slope in slopes.items()]
    head = '"PointID", "x", "y", "Surface_Sensitivity"\n'
    (folder / "surface_adjoint.csv").write_text(head + "\n".join(rows) + "\n")
    given = su2.read_sensitivity(case)
    ahead = np.roll(x[loop], -1, axis=0)
    sign = np.sign(
        np.sum(x[loop, 0] * ahead[:, 1] - x[loop, 1] * ahead[:, 0])
    )  # 1 where the wall turns to the left
    for row, node in zip(given.by_nodes, mesh.patch("airfoil").tolist(), strict=True):
        k = loop.tolist().index(node)
        along = x[loop[(k + 1) % len(loop)]] - x[loop[k - 1]]
        normal = sign * np.array([along[1], -along[0]]) / np.linalg.norm(along)
        np.testing.assert_allclose(row, -slopes[node] * normal, atol=1e-12)
    (folder / "surface_adjoint.csv").write_text(head + "\n".join(rows[1:]) + "\n")
    with pytest.raises(
        ValueError, match=f"1 of {len(loop)} nodes of DV_MARKER are missing, first {loop[0]}"
    ):
        su2.read_sensitivity(case)
