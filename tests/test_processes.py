"""Processes as people start them: from bytecode alone, under daemons, with closed streams."""

import compileall
import os
import pathlib
import shutil
import subprocess
import sys

import pytest
from meshes import write_ring

import jaxmorph as jm

ALONE = """
import sys, jaxmorph
from jaxmorph import cases, integrations, io, shapes
from jaxmorph.cli import main
assert jaxmorph.__file__.endswith(".pyc")
assert io.read and shapes.rotate and all(getattr(jaxmorph, name) for name in dir(jaxmorph) if name not in ("cli", "plot"))
sys.exit(main(["deform", "ring.su2", "out.su2", "--moving", "wall", "--fixed", "far", "--rotate", "5", "--method", "graph"]))
"""


def run(folder, *command, **variables):
    environment = os.environ | variables
    options = {"capture_output": True, "text": True, "timeout": 300}
    return subprocess.run(command, cwd=folder, env=environment, check=False, **options)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="a folder is linked")
def test_an_install_without_source_works(tmp_path):
    """Bytecode beside removed sources, as images are made small: all public names, and a command."""
    write_ring(tmp_path / "ring.su2")
    without = shutil.ignore_patterns("__pycache__")
    shutil.copytree(pathlib.Path(jm.__file__).parent, tmp_path / "jaxmorph", ignore=without)
    compileall.compile_dir(tmp_path / "jaxmorph", quiet=1, legacy=True)
    for source in (tmp_path / "jaxmorph").rglob("*.py"):
        source.unlink()
    done = run(tmp_path, sys.executable, "-c", ALONE, PYTHONPATH=str(tmp_path))
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "out.su2").exists()


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
def test_a_daemon_may_ignore_the_ends_of_processes(tmp_path):
    """Perl's and other daemons ignore SIGCHLD; what they start inherits it."""
    write_ring(tmp_path / "ring.su2")
    command = [sys.executable, "-m", "jaxmorph", "quality", "ring.su2"]
    done = run(tmp_path, "bash", "-c", "trap '' CHLD; \"$@\"", "bash", *command)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("sh") is None, reason="no shell")
@pytest.mark.parametrize("closed", [(0,), (1,), (2,), (0, 1, 2)])
def test_a_service_may_have_closed_streams(tmp_path, closed):
    write_ring(tmp_path / "ring.su2")
    command = [sys.executable, "-m", "jaxmorph", "quality", "ring.su2"]
    closing = " ".join(f"{number}{'<' if number == 0 else '>'}&-" for number in closed)
    whole, done = (
        run(tmp_path, "sh", "-c", f'exec "$@" {end}', "sh", *command) for end in ("", closing)
    )
    assert (done.returncode, done.stdout, done.stderr) == (
        0,
        "" if 1 in closed else whole.stdout,
        "",
    )
