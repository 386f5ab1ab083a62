"""The code in README.md and CONTRIBUTING.md runs as it stands there."""

import ast
import re

import jax
import numpy as np
import pytest
from documents import ROOT, blocks

import jaxmorph as jm
from jaxmorph import io


@pytest.mark.slow
@pytest.mark.parametrize(
    "code", [code for code in blocks("CONTRIBUTING.md") if "\nmethod = " in code]
)
def test_extensions_move_a_mesh(code):
    names = {"__name__": "contributed"}
    exec(code, names)
    rng = np.random.default_rng(0)

    def circle(radius, n):
        return radius * np.stack(
            [np.cos(t := np.linspace(0, 2 * np.pi, n, False)), np.sin(t)], axis=1
        )

    points = np.concatenate(
        [circle(1, 30), circle(5, 20), circle(1, 200) * rng.uniform(1.5, 4, (200, 1))]
    )
    plan = jm.prepare(points, np.arange(30), np.arange(30, 50), method=names["method"])
    u = 0.1 * rng.normal(size=(30, 2))
    moved = jm.deform(plan, u)
    np.testing.assert_allclose(moved[:30], points[:30] + u, atol=1e-14)
    np.testing.assert_array_equal(moved[30:50], points[30:50])
    cotangent, tangent = rng.normal(size=points.shape), rng.normal(size=u.shape)
    forward = jax.jvp(lambda u: jm.deform(plan, u), (u,), (tangent,))[1]
    np.testing.assert_allclose(
        np.vdot(forward, cotangent), np.vdot(tangent, jm.pullback(plan, u, cotangent)), rtol=1e-9
    )


@pytest.mark.slow
def test_readme_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names = {"__name__": "readme"}
    for code in blocks("README.md"):
        exec(code, names)
    before, after = names["mesh"], io.read(tmp_path / "larger.su2")
    wall = before.patch("airfoil")
    np.testing.assert_allclose(after.points[wall], 1.1 * before.points[wall], atol=1e-15)
    np.testing.assert_array_equal(names["dJ_dwall"].shape, (len(wall), 2))
    assert float(capsys.readouterr().out) != 0


def test_the_first_screen_of_readme():
    """Short, in Python four statements, and with the two commands that set everything up by themselves."""
    text = (ROOT / "README.md").read_text()
    assert len(text.splitlines()) < 120
    moves = blocks("README.md")[0].split("\n\n")[-1]
    assert len(ast.parse(moves).body) == 4
    assert len(re.findall("^python3 -m venv .venv && ", text, flags=re.MULTILINE)) == 2
