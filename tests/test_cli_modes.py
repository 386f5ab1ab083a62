"""`jaxmorph modes` and `jaxmorph sensitivity`."""

import json
import re

import numpy as np
import pytest
import pyvista
from meshes import write_ring
from runs import refused, runs

from jaxmorph import io
from jaxmorph.cli import main

SURFACE = ["--moving", "wall", "--fixed", "far"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The ring, and two modes of its wall: a bump, and one at random."""
    folder = tmp_path_factory.mktemp("modes")
    mesh = write_ring(folder / "ring.su2")
    wall = mesh.points[:24]
    shapes = np.stack([wall * (wall[:, :1] > 0), np.random.default_rng(0).normal(size=(24, 2))])
    rows = "".join(
        f"{k} {x!r} {y!r}\n" for k, (x, y) in reversed(list(enumerate(shapes[0].tolist())))
    )
    (folder / "bump.csv").write_text(rows)
    np.savez(folder / "random.npz", displacement=shapes[1])
    np.save(folder / "shapes.npy", shapes)
    return folder


def modes(out: str, *flags: str) -> int:
    return main(["modes", "ring.su2", out, *SURFACE, "--mode", *flags])


@pytest.mark.slow
def test_each_file_is_what_deform_writes(here, capsys):
    amplitudes = ["-0.05", "0.02", "0", "0.03", "-0.01"]
    assert modes("sweep.su2", "bump.csv", "random.npz", "--amplitude", *amplitudes) == 0
    said = capsys.readouterr()
    assert (said.err, "wrote sweep_0001.su2 to sweep_0010.su2" in said.out) == ("", True)
    assert max(map(len, said.out.split("\n"))) <= 80
    shapes, points = np.load("shapes.npy"), io.read("ring.su2").points
    for k in range(10):
        amplitude = float(amplitudes[k % 5])
        moved = io.read(f"sweep_{k + 1:04d}.su2").points
        np.testing.assert_allclose(moved[:24], points[:24] + amplitude * shapes[k // 5], atol=1e-15)
    for k, file in ((1, "bump.csv"), (9, "random.npz")):
        motion = ["--mode", file, amplitudes[k % 5 - 1]]
        assert main(["deform", "ring.su2", "one.su2", *SURFACE, *motion]) == 0
        np.testing.assert_allclose(
            io.read(f"sweep_{k:04d}.su2").points, io.read("one.su2").points, rtol=0, atol=1e-13
        )


@pytest.mark.nightly
def test_a_series_opens_in_paraview_at_its_amplitudes(here):
    assert modes("series.pvd", "bump.csv", "--amplitude", "-0.1", "0", "0.2") == 0
    reader = pyvista.PVDReader("series.pvd")
    assert reader.time_values == [-0.1, 0.0, 0.2]
    shape, points = np.load("shapes.npy")[0], io.read("ring.su2").points
    for value in reader.time_values:
        reader.set_active_time_value(value)
        mesh = reader.read()[0]
        np.testing.assert_allclose(mesh.points[:24, :2], points[:24] + value * shape, atol=1e-14)
        assert {"displacement", "patch:wall"} <= set(mesh.point_data)
        assert "skewness" in mesh.cell_data


@pytest.mark.slow
def test_bad_cases_are_left_out_and_told(here, capsys):
    flags = ("bump.csv", "--amplitude", "0", "9", "0.1", "--method", "graph")
    assert modes("bad.pvd", *flags, "--json") == 1
    said = capsys.readouterr()
    found = json.loads(said.out)
    assert [bool(case["problems"]) for case in found["cases"]] == [False, True, False]
    assert [case["inverted"] > 0 for case in found["cases"]] == [False, True, False]
    assert re.search(r"case 2: \d+ of 192 cells are inverted", said.err)
    assert "1 of 3 cases not written" in said.err
    assert sorted(path.name for path in here.glob("bad*")) == [
        "bad.pvd",
        "bad_0001.vtu",
        "bad_0003.vtu",
    ]
    assert pyvista.PVDReader("bad.pvd").time_values == [1.0, 3.0]  # the amplitudes do not go up
    capsys.readouterr()
    assert modes("bad.pvd", *flags, "--allow-inverted") == 1
    said = capsys.readouterr().out
    assert "wrote bad_0001.vtu to bad_0003.vtu" in said
    assert "in place of 2 older files\n" in said
    assert "in place of an older file" in said
    assert (here / "bad_0002.vtu").exists()


@pytest.mark.parametrize(
    ("form", "ending"), runs([("su2", "csv")], nightly=[("table", "npz"), ("npz", "csv")])
)
def test_sensitivity_is_the_slope_of_what_deform_does(here, form, ending):
    """J = sum of g . x over all points, whose gradient is g, against differences of J by two runs of deform."""
    points = np.asarray(io.read("ring.su2").points)
    g = np.random.default_rng(1).normal(size=points.shape)
    order = np.random.default_rng(2).permutation(len(points)).tolist()
    if form == "su2":
        lines = ['"PointID","x","y","Adjoint Pressure","Sensitivity_x","Sensitivity_y"']
        lines += [f"{k}, 0.5, 0.25, 7, {float(g[k, 0])!r}, {float(g[k, 1])!r}" for k in order]
        (here / "volume.csv").write_text("\n".join(lines))
    elif form == "table":
        (here / "volume.csv").write_text(
            "".join(f"{k} {float(g[k, 0])!r} {float(g[k, 1])!r}\n" for k in order)
        )
    else:
        np.savez("volume.npz", ids=order, sensitivity=g[order])
    file = "volume.npz" if form == "npz" else "volume.csv"
    assert main(["sensitivity", "ring.su2", file, f"wall.{ending}", *SURFACE]) == 0
    if ending == "csv":
        table = np.loadtxt("wall.csv", delimiter=",", skiprows=1)
        ids, slope = table[:, 0], table[:, 1:]
        assert (here / "wall.csv").read_text().startswith("id,dJ_dx,dJ_dy\n")
    else:
        arrays = np.load("wall.npz")
        ids, slope = arrays["ids"], arrays["sensitivity"]
    np.testing.assert_array_equal(ids, np.arange(24))
    shape = np.load("shapes.npy")[1]
    assert modes("slope.su2", "random.npz", "--amplitude", "-0.01", "0.01") == 0
    low, high = (np.vdot(g, io.read(f"slope_{k:04d}.su2").points) for k in (1, 2))
    np.testing.assert_allclose(np.vdot(slope, shape), (high - low) / 0.02, rtol=1e-9)


BAD = {
    "half.csv": ("0 1 2\n1 1 2\n", r"half.csv: 22 of the 24 nodes are missing \(first 2\)"),
    "foreign.csv": (
        "216 1 2\n",
        r"foreign.csv: 1 of its 1 node ids are not of the mesh, 0 to 215 \(first 216\)",
    ),
    "a.csv": (
        "PointID,x,Sensitivity_x,Sensitivity_y\n0,1,2,3\n1,2,3\n",
        "line 3: 4 numbers, as in the header, expected",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_sensitivities_that_do_not_fit(here, capsys, name):
    text, message = BAD[name]
    (here / name).write_text(text)
    refused(capsys, ["sensitivity", "ring.su2", name, "never.csv", *SURFACE], message)
    assert not (here / "never.csv").exists()


def test_outputs_that_cannot_be(here, capsys):
    (here / "zero.csv").write_text("".join(f"{k} 0 0\n" for k in range(216)))
    for out, message in (("zero.csv", "is the file of SENS"), ("no/x.csv", "no folder no")):
        refused(capsys, ["sensitivity", "ring.su2", "zero.csv", out, *SURFACE], message)
    shape = (here / "bump.csv").read_bytes()
    (here / "y_0001.su2").write_bytes(shape)
    words = ["modes", "ring.su2", "y.su2", *SURFACE, "--mode", "y_0001.su2"]
    refused(capsys, words, "OUT y_0001.su2 is the file of --mode")
    motion = [*SURFACE, "--mode", "bump.csv", "0.01", "--save-job", "job.toml"]
    assert main(["deform", "ring.su2", "moved.su2", *motion]) == 0
    words = ["sensitivity", "--job", "job.toml", "zero.csv", "bump.csv"]
    refused(capsys, words, "OUT bump.csv is the file of --mode")
    assert (here / "bump.csv").read_bytes() == (here / "y_0001.su2").read_bytes() == shape
