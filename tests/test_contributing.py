"""The recipes of CONTRIBUTING.md, typed into a copy of the package: each gives what its reader asked for."""

import os
import pathlib
import re
import shutil
import subprocess
import sys
import textwrap

import pytest
from documents import ROOT

RECIPES = {
    "A basis": """
        points = np.random.default_rng(0).uniform(-1, 1, (60, 2))
        plan = jm.prepare(points, range(20), range(20, 30), method=jm.RBF(jm.WendlandD5(2.0)))
        jm.export(plan, "basis.plan")
        square = jax.vmap(jax.grad(jm.WendlandD5(2.0)))(jnp.array([0.0, 1.0, 5.0]))
        np.testing.assert_allclose(square, [-15 / 4, -15 / 4 * 0.5**4, 0], rtol=1e-12)
        from jaxmorph._methods.tape import FUNCTIONS
        if shutil.which("cc"):
            code = '#define JMPLAN_IMPLEMENTATION\\n#include "jmplan.h"\\n'
            call = "void phi(int kind, double *r2, double *out) { jm_phi(kind, r2, out); }"
            pathlib.Path("phi.c").write_text(code + call)
            words = ["cc", "-fPIC", "-shared", f"-I{native.folder}", "phi.c", "-o", "phi.so", "-lm"]
            subprocess.run(words, check=True)
            r2 = np.linspace(0, 1.2, 64)
            found = np.zeros(64)
            pointers = [ctypes.c_void_p(array.ctypes.data) for array in (r2, found)]
            ctypes.CDLL("./phi.so").phi(FUNCTIONS.index(jm.WendlandD5), *pointers)
            np.testing.assert_allclose(found, jm.WendlandD5(1.0)(jnp.asarray(r2)), atol=1e-14)
    """,
    "A reduction": """
        points = np.random.default_rng(0).uniform(size=(30, 2))
        rows = jm.Every(10)(points)
        np.testing.assert_array_equal(np.sort(points[:, 0])[::10], np.sort(points[rows, 0]))
        with refuses("`step`"):
            jm.Every(0)
    """,
    "A method": """
        mesh = cases.naca0015(points=300)
        u = np.tile([0.1, 0.2], (len(mesh.patch("airfoil")), 1))
        plan = jm.prepare(mesh, "airfoil", "farfield", method=jm.METHODS["nearest"].make(1.0))
        np.testing.assert_allclose(jm.deform(plan, u)[plan.moving] - mesh.points[plan.moving], u)
        io.write("airfoil.su2", mesh)
        move = ["--moving", "airfoil", "--fixed", "farfield", "--translate", "0.001", "0"]
        said = told("deform", "airfoil.su2", "new.su2", *move, "--method", "nearest")
        assert "the closest node of the wall" in said
    """,
    "A design variable": """
        x = np.array([[0.5, 0.1], [0.0, 0.0], [2.0, 1.0]])
        np.testing.assert_array_equal(shapes.Sag()(x, shapes.Sag().neutral()), x)
        np.testing.assert_allclose(shapes.Sag()(x, 0.2), x - [[0, 0.2], [0, 0], [0, 0]], atol=1e-15)
        slope = jax.grad(lambda depth: shapes.Sag()(x, depth).sum())(0.2)
        np.testing.assert_allclose(slope, -1, atol=1e-15)
        mesh = cases.naca0015(points=300)
        io.write("wing.su2", mesh)
        move = ["--moving", "airfoil", "--fixed", "farfield", "--sag", "0.01"]
        told("deform", "wing.su2", "sagged.su2", *move, "--save-job", "job.toml")
        assert "sag = 0.01" in pathlib.Path("job.toml").read_text()
        wall = mesh.patch("airfoil")
        np.testing.assert_allclose(
            io.read("sagged.su2").points[wall], shapes.Sag()(mesh.points[wall], 0.01), atol=1e-15
        )
    """,
    "A measure or limit": """
        mesh = jm.Mesh([[0.0, 0.0], [3.0, 0.0], [3.0, 1.0], [0.0, 1.0]], {"quad": [[0, 1, 2, 3]]})
        np.testing.assert_allclose(jm.quality(mesh).edge_ratio, [3])
        assert jm.judge(mesh, limits=jm.Limits(max_edge_ratio=4)).ok
        assert not jm.judge(mesh, limits=jm.Limits(max_edge_ratio=2)).ok
        io.write("quad.su2", jm.Mesh(mesh.points, mesh.cells, {"all": np.arange(4)}))
        assert "max edge ratio" in told("quality", "quad.su2", "--max-edge-ratio", "4")
        assert "1 of 1" in told("quality", "quad.su2", "--max-edge-ratio", "2", status=1)
    """,
    "A flag of the command line": """
        io.write("some.su2", cases.naca0015(points=300))
        assert len(told("info", "some.su2", "--brief").splitlines()) == 2
        assert len(told("info", "some.su2").splitlines()) > 2
    """,
    "A picture": """
        mesh = cases.naca0015(points=300)
        axes = plot.walls(mesh, "airfoil")
        (line,) = axes.lines
        np.testing.assert_array_equal(line.get_xydata(), mesh.points[mesh.patch("airfoil")])
    """,
    "A format": """
        triangles = jm.Mesh([[0.0, 0.0], [1.0, 0.0], [0.1, 1 / 3]], {"triangle": [[0, 1, 2]]})
        io.write("one.tri", triangles)
        again = io.read("one.tri")
        np.testing.assert_array_equal(again.points, triangles.points)
        np.testing.assert_array_equal(again.cells["triangle"], [[0, 1, 2]])
        io.write("two.tri", again)
        assert pathlib.Path("two.tri").read_bytes() == pathlib.Path("one.tri").read_bytes()
        io.write("three.tri", again.moved(2 * again.points))
        np.testing.assert_array_equal(io.read("three.tri").points, 2 * triangles.points)
        with refuses("triangles alone"):
            io.write("wrong.tri", jm.Mesh(np.eye(4)[:, :2], {"quad": [[0, 1, 2, 3]]}))
    """,
}
"""What the reader of a recipe has in the end, by its title."""

TOOLS = """
import contextlib, ctypes, io as text, pathlib, shutil, subprocess, traceback
import jax, jax.numpy as jnp, matplotlib, numpy as np
jax.config.update("jax_enable_x64", True)
matplotlib.use("agg")
import jaxmorph as jm
from jaxmorph import cases, io, native, plot, shapes
from jaxmorph.cli import main


@contextlib.contextmanager
def refuses(words):
    try:
        yield
    except ValueError as error:
        assert words in str(error), error
    else:
        raise AssertionError(f"not refused: {words}")


def told(*words, status=0):
    with contextlib.redirect_stdout(text.StringIO()) as said:
        assert main([*words]) == status
    return said.getvalue()
"""


def recipes() -> dict[str, list[tuple[str, str]]]:
    """The language and text of each block of code, by the title of its recipe."""
    text = (ROOT / "CONTRIBUTING.md").read_text()
    parts = re.findall(r"^## (A [^\n]*)\n(.*?)(?=^## )", text, flags=re.DOTALL | re.MULTILINE)
    block = re.compile(r"^( *)```(python|diff)\n(.*?)^\1```$", re.DOTALL | re.MULTILINE)
    return {
        title: [(found[2], textwrap.dedent(found[3])) for found in block.finditer(part)]
        for title, part in parts
    }


def typed(text: str, lines: list[str]) -> str:
    """A text with the changed lines, whose unchanged and removed ones stand in it once."""
    old = "".join(line[1:] + "\n" for line in lines if line[:1] != "+")
    new = "".join(line[1:] + "\n" for line in lines if line[:1] != "-")
    assert text.count(old) == 1, old
    return text.replace(old, new)


def hunks(text: str, lines: list[str]) -> str:
    """Types the changes of a file one after the other: each ends where a `+` is not followed by one."""
    ends = [k for k in range(1, len(lines)) if lines[k - 1][:1] == "+" and lines[k][:1] != "+"]
    for first, last in zip([0, *ends], [*ends, len(lines)], strict=True):
        text = typed(text, lines[first:last])
    return text


def type_recipe(blocks: list[tuple[str, str]], root: pathlib.Path) -> None:
    above = ""
    for language, code in blocks:
        if language == "python":
            above = code
            if code.startswith("# jaxmorph/"):
                head, _, rest = code.partition("\n")
                (root / head[2:]).write_text(rest)
            continue
        for part in re.split(r"^--- ", code, flags=re.MULTILINE)[1:]:
            name, *lines = part.splitlines()
            if name == "above":
                target = root / lines[0].removeprefix("+++ ")
                target.write_text(hunks(above, lines[1:]))
            else:
                file = root / name
                file.write_text(typed(file.read_text(), lines))


@pytest.fixture(scope="module")
def said(tmp_path_factory):
    """What a copy of the package with all recipes in it says of each: nothing, if all is well."""
    root = tmp_path_factory.mktemp("typed")
    leave = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "jaxmorph", root / "jaxmorph", ignore=leave)
    for blocks in recipes().values():
        type_recipe(blocks, root)
    code = TOOLS
    for title, check in RECIPES.items():
        alone = [block for _, block in recipes()[title] if "\n\n\nclass" in block]
        check = (
            f"for block in {alone!r}:\n    exec(block, {{'__name__': 'own'}})\n"
            + textwrap.dedent(check)
        )
        code += f"\nprint('## {title}')\ntry:\n{textwrap.indent(check, '    ')}"
        code += "\nexcept Exception:\n    traceback.print_exc(file=__import__('sys').stdout)\n"
    (root / "checks.py").write_text(code)
    environment = os.environ | {"PYTHONPATH": str(root)}
    done = subprocess.run(
        [sys.executable, "checks.py"], cwd=root, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    parts = re.split(r"^## (.*)\n", done.stdout, flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def test_every_recipe_has_a_check():
    assert recipes().keys() == RECIPES.keys()


@pytest.mark.parametrize("title", RECIPES)
def test_a_recipe_works_as_typed(said, title):
    assert not said[title].strip(), said[title]
