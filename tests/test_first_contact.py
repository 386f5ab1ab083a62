"""What a process costs before its first result: at most twice the goals of `benchmarks`."""

import os
import pathlib
import subprocess
import sys

import pytest
from runs import runs

ROOT = pathlib.Path(__file__).parents[1]
CONTACTS = ["su2 def", "paper's airfoil", "USMesh", "onto", "judge"]


@pytest.mark.skipif(sys.platform != "linux", reason="one core, and the time of a child")
@pytest.mark.parametrize("contact", runs(slow=["info", "deform"], nightly=CONTACTS))
def test_the_first_contact_takes_twice_its_goal_at_most(contact):
    """CPU seconds on one core, imports and compilation included, and again."""
    if contact == "USMesh":
        pytest.importorskip("mpi4py")
    unset = ("JAX_COMPILATION_CACHE_DIR", "XLA_FLAGS")
    environment = {name: value for name, value in os.environ.items() if name not in unset}
    environment |= {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, "benchmarks/first_contact.py", "--check", "--only", contact]
    done = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
