"""Design variables: shapes in a chain, their names, and derivatives of a volume by them, in Python and from the command line."""

import csv
import json
import pathlib

import jax
import meshes
import numpy as np
import pytest
from meshes import write_ring
from oracles import jacobian
from runs import over, refusals, refused

import jaxmorph as jm
from jaxmorph import io, shapes
from jaxmorph.cli import main


def turned(about):
    return shapes.Function(lambda x, angle: shapes.rotate(x, angle, about), 0.0)


def chain():
    box = shapes.FreeForm([-2, -2], 4 * np.eye(2), (2, 3))
    flap = shapes.OnRows(shapes.Chain({"angle": turned([1.0, 0.0])}), np.arange(4, 9))
    return shapes.Chain({"turn": turned([0.5, 0.0]), "box": box, "flap": flap})


def parameters(rng):
    return {"turn": 0.3, "box": 0.1 * rng.normal(size=(2, 3, 2)), "flap": {"angle": -0.2}}


@pytest.fixture(scope="module")
def ring(tmp_path_factory):
    return write_ring(tmp_path_factory.mktemp("ring") / "ring.su2")


@pytest.mark.nightly
def test_a_chain_is_its_shapes_nested(ring):
    x, given, shape = ring.points[:24], parameters(np.random.default_rng(0)), chain()
    box = shape.shapes[1](shapes.rotate(x, 0.3, [0.5, 0.0]), given["box"])
    expected = np.array(box)
    expected[4:9] = shapes.rotate(box[4:9], -0.2, [1.0, 0.0])
    np.testing.assert_array_equal(shape(x, given), expected)
    np.testing.assert_array_equal(shape(x, shape.neutral()), x)
    np.testing.assert_array_equal(shape(x, {"turn": 0.3}), shapes.rotate(x, 0.3, [0.5, 0.0]))
    path = shapes.path(shape, x, given, 3)
    third = jax.tree.map(lambda leaf: leaf / 3, given)
    np.testing.assert_allclose(path[0], shape(x, third) - x, atol=1e-15)
    np.testing.assert_allclose(path[2], expected - x, atol=1e-15)


def test_names_find_the_numbers_they_name():
    given = parameters(np.random.default_rng(1))
    names = shapes.names(given)
    assert names[0] == "box[0,0,0]"
    assert names[-2:] == ["flap.angle", "turn"]
    flat = jax.flatten_util.ravel_pytree(given)[0]
    for k in (0, 7, 12, 13):
        changed = jax.flatten_util.ravel_pytree(shapes.varied(given, {names[k]: 9.0}))[0]
        np.testing.assert_array_equal(changed, flat.at[k].set(9.0))
    whole = shapes.varied(given, {"box": range(12), "angle": 5})
    np.testing.assert_array_equal(whole["box"], np.arange(12.0).reshape(2, 3, 2))
    assert (whole["flap"]["angle"], whole["turn"]) == (5, 0.3)
    assert shapes.names(np.zeros(2)) == ["parameters[0]", "parameters[1]"]
    assert shapes.names({}) == []


@over("steps", slow=[1], nightly=[2])
def test_pullback_is_the_derivative_by_every_parameter(ring, steps):
    plan = jm.prepare(ring.points, np.arange(24), np.arange(192, 216), method=jm.RBF.classic())
    rng, shape = np.random.default_rng(2), chain()
    given, weights = parameters(rng), rng.normal(size=ring.points.shape)
    flat, unravel = jax.flatten_util.ravel_pytree(given)
    path = lambda p: shapes.path(shape, ring.points[:24], unravel(p), steps)  # noqa: E731
    plans = jm.march(plan, path(flat))[0]
    slope = shapes.pullback(shape, plan if steps == 1 else plans, given, weights)

    def value(p):
        return np.vdot(weights, jm.march(plan, path(flat.at[np.array([0, 12, 13])].set(p)))[1])

    slopes = jax.flatten_util.ravel_pytree(slope)[0]
    np.testing.assert_allclose(
        slopes[np.array([0, 12, 13])], jacobian(value, flat[np.array([0, 12, 13])], 1e-3), rtol=1e-7
    )


SQUARE = {"low": [0, 0], "high": [1, 1], "points": [3, 3], "moved": [{"at": [0, 1], "by": [1, 0]}]}


test_bad_input_is_refused = refusals(
    (
        lambda x: chain()(x, {"twist": 1}),
        "no shape is called twist; this chain has turn, box, flap",
    ),
    (lambda x: shapes.Chain({}), "needs one shape"),
    (lambda x: shapes.OnRows(turned([0, 0]), [0, 24])(x, 0.1), "up to 24; `x` has 24"),
    (lambda x: shapes.OnRows(turned([0, 0]), [1, 1]), "different row numbers"),
    (lambda x: shapes.path(lambda x, p: x + p, x, 0.1, 2), "a plain function has no neutral"),
    (
        lambda x: shapes.varied({"a": np.zeros(2), "b": {"c": 1.0}}, {"d": 1}),
        "variable d; there are: a, b.c",
    ),
    (
        lambda x: shapes.varied({"p": {"a": 1.0}, "q": {"a": 1.0}}, {"a": 1}),
        "2 .* are called a; .* p.a, q.a",
    ),
    (
        lambda x: shapes.varied({"a": np.zeros(2)}, {"a": 1}),
        r"a takes 2 finite numbers, found \[1.0\]",
    ),
    (lambda x: shapes.varied({"a": 0.0}, {"a": np.nan}), "a takes one finite number, found"),
    (
        lambda x: shapes.varied({"a": {"b": np.zeros((4, 3))}}, {"b[9,9]": 1}),
        r"b\[9,9\]: a.b has shape \(4, 3\)",
    ),
    (
        lambda x: shapes.varied({"wing": {"twist": 1.0}}, {"twits": 1}),
        r"twits \(did you mean 'twist'\?\)",
    ),
    (lambda x: io.read_box(SQUARE | {"moved": [], "degree": 9}, 2), "degrees"),
    (
        lambda x: io.read_box(SQUARE | {"continuity": 0}, 2),
        r"control point \[0, 1\] is held by continuity = 0",
    ),
    of=lambda: (meshes.ring().points[:24],),
)


JOB = """\
file = "ring.su2"
fixed = ["far"]
method = "graph"
steps = 2
set = { "wall2.rotate" = 8 }

[[moving]]
patches = ["wall"]
name = "form"
mode = [["shift.csv", 0.5]]
box = { low = [-2, -2], high = [2, 2], points = [2, 3], moved = [{ at = [1, 2], by = [0.1, 0] }] }
scale = 1.1

[[moving]]
patches = ["wall"]
rotate = 3

[[moving]]
patches = ["wall"]
rotate = -5
translate = [0.1, 0]
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    mesh = write_ring(tmp_path / "ring.su2")
    (tmp_path / "shift.csv").write_text(
        "".join(f"{k},0.125,{-0.25 + 0.01 * k}\n" for k in range(24))
    )
    (tmp_path / "job.toml").write_text(JOB)
    weights = np.random.default_rng(3).normal(size=mesh.points.shape)
    np.savez("volume.npz", sensitivity=weights)
    return weights


def objective(weights, *changes):
    assert (
        main(
            [
                "deform",
                "ring.su2",
                "out.su2",
                "--job",
                "job.toml",
                *(("--set", *changes) if changes else ()),
            ]
        )
        == 0
    )
    return np.vdot(weights, io.read("out.su2").points)


@pytest.mark.nightly
def test_sensitivities_of_a_job_are_the_slopes_of_what_deform_does(here, capsys):
    """Against differences of runs of `deform --set`: the file, its JSON and the terminal say the same."""
    assert main(["sensitivity", "--job", "job.toml", "volume.npz", "dJ.csv"]) == 0
    said = capsys.readouterr().out
    with open("dJ.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    values, slopes = (
        {row["variable"]: float(row[key]) for row in rows} for key in ("value", "dJ_dvalue")
    )
    assert len(rows) == 18
    assert (values["wall2.rotate"], values["form.box[1,2,0]"]) == (8, 0.1)
    for name in ("form.mode[0]", "form.box[1,1,1]", "form.scale", "wall2.rotate"):
        change = 1e-3 * (1 if name.endswith("rotate") else 0.1)
        high, low = (
            objective(here, f"{name}={values[name] + sign * change!r}") for sign in (1, -1)
        )
        np.testing.assert_allclose(slopes[name], (high - low) / (2 * change), rtol=2e-6)
        assert f"  {name}\n" in said
    capsys.readouterr()
    assert (
        main(
            [
                "sensitivity",
                "--job",
                "job.toml",
                "volume.npz",
                "dJ.json",
                "--set",
                "scale=1.2",
                "--json",
            ]
        )
        == 0
    )
    found = json.loads(capsys.readouterr().out)["variables"]
    table = json.loads(pathlib.Path("dJ.json").read_text())
    assert table["form.scale"]["value"] == 1.2
    assert {name: entry["dJ_dvalue"] for name, entry in table.items()} == found
    assert found["wall2.rotate"] != slopes["wall2.rotate"]


@pytest.mark.slow
def test_set_is_saved(here):
    flags = [
        "--job",
        "job.toml",
        "--set",
        "translate=0,0.2",
        "box[1,2,0]=0.3",
        "--save-job",
        "saved.toml",
    ]
    assert main(["deform", "ring.su2", "one.su2", *flags]) == 0
    assert main(["deform", "ring.su2", "two.su2", "--job", "saved.toml"]) == 0
    np.testing.assert_array_equal(io.read("one.su2").points, io.read("two.su2").points)


DEFORM = "deform ring.su2 never.su2 --job job.toml"
SENSITIVITY = "sensitivity --job job.toml volume.npz"
SET = 'set = { "wall2.rotate" = 8 }'


@pytest.mark.parametrize(
    ("words", "set_to", "message"),
    [
        (
            f"{DEFORM} --set twist=2",
            SET,
            r"--set: there is no design variable twist; there are: form.box, ",
        ),
        (
            f"{DEFORM} --set rotate=2",
            SET,
            "2 design variables are called rotate; take one of: wall.rotate, wall2",
        ),
        (f"{DEFORM} --set box=2", SET, r"box takes 12 finite numbers, found \[2.0\]"),
        (f"{DEFORM} --set twist", SET, "'twist' is not NAME=NUMBER"),
        (f"{SENSITIVITY} never.csv --moving wall", SET, "--job names patches and method"),
        (f"{SENSITIVITY} x.npz", SET, r"x.npz: the name should end in .csv or .json"),
        ("sensitivity ring.su2 volume.npz x.csv --set a=1", SET, "--set without --job"),
        (DEFORM, "set = 3", "job.toml: set is a table of names and numbers, found 3"),
        (DEFORM, "set = { a = 'x' }", "job.toml: argument --set: 'a=x' is not NAME"),
    ],
)
def test_design_variables_that_make_no_sense(here, capsys, words, set_to, message):
    pathlib.Path("job.toml").write_text(JOB.replace(SET, set_to))
    refused(capsys, words.split(), message)


@pytest.mark.nightly
def test_a_surface_sensitivity_goes_on_to_a_job_without_the_volume(ring, tmp_path, capsys):
    """A factor, and a box that leans, from the wall's own sensitivities."""
    write_ring(tmp_path / "ring.su2")
    box = "{corners = [[-2, -2], [2, -2.5], [2.5, 2], [-2, 2]], points = [2, 2], moved = [{at = [1, 1], by = [0.1, 0]}]}"
    (tmp_path / "job.toml").write_text(
        'file = "ring.su2"\noutput = "out.su2"\nfixed = ["far"]\nmethod = "rbf"\n[[moving]]\npatches = ["wall"]\n'
        f"box = {box}\nscale = [1.1, 0.9]\n"
    )
    assert main(["deform", "--job", str(tmp_path / "job.toml")]) == 0
    x = np.asarray(ring.points)[:24]
    leaning = shapes.Hexahedron([[-2, -2], [2, -2.5], [2.5, 2], [-2, 2]], (2, 2))
    corner = np.zeros((2, 2, 2))
    corner[1, 1, 0] = 1.0

    def wall(by, factors):
        return shapes.scale(leaning(x, by * corner), factors, np.zeros(2))

    given = 0.1, np.array([1.1, 0.9])
    np.testing.assert_allclose(io.read(tmp_path / "out.su2").points[:24], wall(*given), atol=1e-14)
    sens = np.random.default_rng(0).normal(size=(24, 2))
    io.write_sensitivity(tmp_path / "wall.csv", np.arange(24), sens)
    words = [
        "sensitivity",
        "--job",
        str(tmp_path / "job.toml"),
        str(tmp_path / "wall.csv"),
        str(tmp_path / "d.json"),
    ]
    assert main(words) == 0
    table = json.loads((tmp_path / "d.json").read_text())
    for name, k, place in (("box[1,1,0]", 0, 0), ("scale[1]", 1, 1)):
        slopes = jacobian(
            lambda own, k=k: np.vdot(sens, wall(*given[:k], own, *given[k + 1 :])), given[k], 1e-3
        )
        found = next(row["dJ_dvalue"] for key, row in table.items() if key.endswith(name))
        np.testing.assert_allclose(found, slopes.ravel()[place], rtol=1e-6)
    io.write_sensitivity(tmp_path / "part.csv", np.arange(20), sens[:20])
    assert main([*words[:3], str(tmp_path / "part.csv"), words[4]]) == 2
    assert "4 of the 24 nodes are missing (first 20)" in capsys.readouterr().err
