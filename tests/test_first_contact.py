"""What a process costs before its first result, by the goals of `benchmarks`, and where it goes."""

import json
import os
import pathlib
import subprocess
import sys

import numpy as np
import pytest
from runs import runs

import jaxmorph as jm
from jaxmorph import io

ROOT = pathlib.Path(__file__).parents[1]
CONTACTS = ["su2 def", "paper's airfoil", "USMesh", "onto", "judge"]
PATCHES = "--moving airfoil --fixed farfield"
COMMANDS = {
    "deform": f"deform foil.su2 out.su2 {PATCHES} --rotate 5",
    "onto": f"deform foil.su2 out.su2 {PATCHES} --onto scan.npz",
    "export": f"export foil.su2 out.plan {PATCHES}",
    "su2 def": "su2 def config.cfg",
}
CONFIG = """DV_KIND= HICKS_HENNE
DV_MARKER= ( airfoil )
DV_PARAM= ( 1, 0.5 )
DV_VALUE= 0.01
MESH_FILENAME= foil.su2
MESH_OUT_FILENAME= out.su2
"""


def run(folder, *words):
    unset = ("JAX_COMPILATION_CACHE_DIR", "XLA_FLAGS")
    environment = {name: value for name, value in os.environ.items() if name not in unset}
    environment |= {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, *words]
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.skipif(sys.platform != "linux", reason="one core, and the time of a child")
@pytest.mark.parametrize("contact", runs(slow=["info", "deform"], nightly=CONTACTS))
def test_the_first_contact_takes_twice_its_goal_at_most(contact):
    """CPU seconds on one core, imports and compilation included, and again."""
    if contact == "USMesh":
        pytest.importorskip("mpi4py")
    run(ROOT, "benchmarks/first_contact.py", "--check", "--only", contact)


@pytest.mark.parametrize("command", runs(slow=["onto"], nightly=["deform", "export", "su2 def"]))
def test_stages_are_named_that_take_the_time(tmp_path, command):
    other = jm.Facets.of(jm.cases.naca4("2412", points=3000), "airfoil")
    lines = np.asarray(other.faces)
    np.savez(tmp_path / "scan.npz", points=np.asarray(other.points), lines=lines)
    io.write(tmp_path / "foil.su2", jm.cases.naca4("0012", points=1500))
    (tmp_path / "config.cfg").write_text(CONFIG)
    found = json.loads(run(tmp_path, "-m", "jaxmorph", *COMMANDS[command].split(), "--json"))
    assert sum(found["stages"].values()) > 0.95 * found["seconds"]
