"""What type checkers tell users, and what completion offers them."""

import importlib
import pathlib
import shutil
import subprocess
import sys

import pytest

import jaxmorph as jm

ROOMS = ("", ".io", ".shapes", ".plot", ".cases", ".extend", ".integrations.su2")


@pytest.mark.parametrize("room", ROOMS)
def test_completion_offers_public_names_alone(room):
    if room == ".plot":
        pytest.importorskip("matplotlib")
    module = importlib.import_module(f"jaxmorph{room}")
    offered = dir(module)
    assert len(offered) > 3
    assert not [name for name in offered if name.startswith("_") and name != "__version__"]
    assert all(hasattr(module, name) for name in offered)
    # editors read the file: what it imports for itself has an underscore
    extra = {name for name in vars(module) if not name.startswith("_")} - {*offered}
    assert extra <= {"attached", "listing", "jaxtyping", "kinds", "cgns", "openfoam"}
    assert room == ".extend" or not extra & {"attached", "listing"}


RIGHT = """\
import numpy as np
import jaxmorph as jm
from jaxmorph import io

mesh = io.read("a.su2")
plan = jm.prepare(mesh, "airfoil", ["farfield"])
jm.prepare(np.asarray(mesh.points), plan.moving, [1, 2])
jm.prepare(mesh.points, mesh.patch("airfoil"), np.arange(3))
points = jm.deform(plan, np.zeros((plan.n_moving, 2)))
io.write("b.su2", mesh.moved(points))
"""
WRONG = (
    "plan.movingg",
    "mesh.pointss",
    "jm.prepare(mesh, 3.5)",
    "jm.prepare(mesh, 'a', fixd='b')",
    "jm.deformm",
    "io.reed('a')",
    "jm.quality(mesh).skewnes",
    "jm.shapes.rotatee",
    "jm.shapes.attached",
    "io.attached",
)


@pytest.mark.slow
def test_a_type_checker_finds_what_is_mistyped(tmp_path):
    beside = pathlib.Path(sys.executable).with_name("pyright")
    pyright = str(beside) if beside.exists() else shutil.which("pyright")
    if pyright is None:
        pytest.skip("pyright is not installed")
    file = tmp_path / "user.py"
    file.write_text(RIGHT + "\n".join(WRONG) + "\n")
    words = [pyright, "--pythonpath", sys.executable, str(file)]
    said = subprocess.run(
        words,
        capture_output=True,
        text=True,
        cwd=pathlib.Path(jm.__file__).parents[1],
        check=False,
    ).stdout
    if "error" not in said and "0 errors" not in said:
        pytest.skip(f"pyright does not run: {said[:100]}")
    lines = {
        int(line.split(":")[1])
        for line in said.splitlines()
        if "user.py:" in line and "error" in line
    }
    first = RIGHT.count("\n") + 1
    assert lines == {*range(first, first + len(WRONG))}, said
