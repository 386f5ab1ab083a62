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

IN_CALLBACK = """
import sys, warnings, jax, numpy as np, jaxmorph as jm
from jaxmorph import shapes
from meshes import ball, grid
warnings.simplefilter("ignore")
jax.config.update("jax_enable_x64", True)
x = np.linspace(0, .5, 61)
mesh = grid(x, np.array([0, .02, .05, 2.]), patches={"floor": lambda ids: ids[:, 0], "lid": lambda ids: ids[:, -1]})
floor, lid = mesh.patch("floor"), mesh.patch("lid")
points = np.asarray(mesh.points)
boundary = jm.Boundary(mesh, "floor", "lid", free=range(len(points)))
u = 1e-3 * np.sin(9 * points[floor])
plan = jm.prepare(boundary)
moved = np.asarray(jm.deform(plan, u))
places, faces = ball(12)
places = places - places.min(axis=0)
sphere = jm.Facets(places, faces)
wall = np.concatenate([points[floor], points[lid]])

CALLS = {
    "prepare": lambda: jm.prepare(boundary).sources,
    "published": lambda: jm.prepare(boundary, method=jm.SurfaceReconstruction.published(8, 4)).sources,
    "multiscale": lambda: jm.prepare(boundary, method=jm.Multiscale()).points,
    "of points": lambda: jm.prepare(points, floor, lid, symmetry=jm.Plane((1, 0), (0, 0))).sources,
    "halves": lambda: jm.prepare_surface(boundary).attach(points, np.arange(len(points))).points,
    "chunks": lambda: np.concatenate([nodes for nodes, _ in jm.prepare_in_chunks(boundary, size=50)]),
    "march": lambda: jm.march(plan, u[None], rebuild=True)[1],
    "kd tree": lambda: jm.KDTree(8, extremes=True)(wall),
    "with sources": lambda: jm.KDTree.with_sources(12, wall)(wall),
    "farthest": lambda: jm.FarthestPoints(12)(wall),
    "graded": lambda: jm.Graded(.2).beside(points[floor], points[lid]),
    "greedy": lambda: jm.Greedy(12)(wall),
    "all": lambda: jm.AllPoints()(wall),
    "closest": lambda: sphere.closest(np.abs(places[::-1])),
    "onto": lambda: shapes.onto(sphere, jm.Facets(1.1 * places, faces)),
    "sides": lambda: shapes.upper_side(jm.cases.naca0015(points=600), "airfoil"),
    "inspect": lambda: jm.inspect(plan, u).offset,
    "judge": lambda: jm.judge(mesh, moved).ok,
}

def law(name):
    def host(seed):
        return np.resize(np.asarray(CALLS[name](), float), 8)
    out = jax.ShapeDtypeStruct((8,), float)
    inside = jax.jit(lambda seed: jax.pure_callback(host, out, seed))(np.zeros(3))
    np.testing.assert_allclose(inside, host(0), rtol=1e-9, atol=1e-12, err_msg=name)

for name in sys.argv[1:] or CALLS:
    print(name, flush=True)
    law(name)
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


@pytest.mark.nightly
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


@pytest.mark.slow
def test_host_code_works_in_a_callback(tmp_path):
    """Coordinates at 0, where XLA's callbacks flush small numbers, and a tree would never end."""
    tests = pathlib.Path(__file__).parent
    path = os.pathsep.join([str(tests.parent), str(tests)])
    done = run(tmp_path, sys.executable, "-c", IN_CALLBACK, PYTHONPATH=path)
    assert (done.returncode, done.stderr) == (0, ""), done.stdout
