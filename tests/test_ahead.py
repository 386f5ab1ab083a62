"""A command's mesh is read in a child of its process, beside imports, and is what the process itself would read."""

import os
import subprocess
import sys

import pytest
from formats import ENDINGS, written
from meshes import bricks

import jaxmorph as jm
from jaxmorph import io

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="a process begins no other one elsewhere")

READ = """
import sys
from jaxmorph.io import _ahead
paths = sys.argv[1:]
for path in paths:
    _ahead.begin(path)
assert not {"numpy", "jax"} & set(sys.modules)
import pathlib
from jaxmorph.io._reading import file_mesh
alone = [file_mesh(pathlib.Path(path)) for path in paths]
assert "jax" not in sys.modules
import numpy as np
from jaxmorph import Mesh, io
for path, other in zip(paths, alone, strict=True):
    sent = _ahead.taken(path)
    for mine, its in ((other.cells, sent.cells), (other.patches, sent.patches)):
        assert list(mine) == list(its)
        for name in mine:
            np.testing.assert_array_equal(mine[name], its[name])
    np.testing.assert_array_equal(other.points, sent.points)
    files = []
    for name, mesh in (("mine", Mesh(*other)), ("its", Mesh(*sent))):
        out = pathlib.Path(path).with_name(name + pathlib.Path(path).suffix)
        io.write(out, mesh.moved(np.asarray(mesh.points) + 0.125))
        file = out / "constant/polyMesh/points" if out.is_dir() else out
        files.append(file.read_bytes().replace(name.encode(), b""))
    assert files[0] == files[1] and _ahead.taken(path) is None, path
"""


def run(*words, cores="2", closed=()):
    environment = os.environ | {"JAXMORPH_CPUS": cores}
    closing = " ".join(f"{number}{'<' if number == 0 else '>'}&-" for number in closed)
    command = ["sh", "-c", f'exec "$@" {closing}', "sh", sys.executable, *words]
    return subprocess.run(command, capture_output=True, text=True, env=environment, check=False, timeout=120)


def test_each_format_arrives_whole(tmp_path):
    """Without JAX in the child, and with all that writing needs."""
    done = run("-c", READ, *(str(written(tmp_path, ending)) for ending in ENDINGS))
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("fault", ["cut", "folded", "missing", "none"])
def test_faults_and_warnings_are_those_of_one_process(tmp_path, fault):
    path = tmp_path / "in.msh"
    mesh = jm.elevate(bricks(2), 2)
    if fault == "folded":
        corners = mesh.cells["hexahedron27"].copy()
        corners[0, 20] = corners[0, 21]
        mesh = jm.Mesh(mesh.points, {"hexahedron27": corners})
    if fault != "missing":
        io.write(path, mesh)
    if fault == "cut":
        path.write_bytes(path.read_bytes()[:-500])
    alone, beside = (run("-m", "jaxmorph", "quality", str(path), cores=cores) for cores in "12")
    assert (beside.returncode, beside.stdout, beside.stderr) == (alone.returncode, alone.stdout, alone.stderr)
    assert alone.returncode == {"none": 0, "folded": 1}.get(fault, 2)
    assert ("name a node twice" in alone.stderr) == (fault == "folded")


@pytest.mark.parametrize("closed", [(0,), (1,), (2,), (0, 2), (0, 1, 2)])
def test_a_service_may_have_closed_streams(tmp_path, closed):
    """The pipe to the child then has their numbers."""
    io.write(tmp_path / "in.su2", bricks(2))
    whole = run("-m", "jaxmorph", "quality", str(tmp_path / "in.su2"))
    done = run("-m", "jaxmorph", "quality", str(tmp_path / "in.su2"), closed=closed)
    assert (done.returncode, done.stdout, done.stderr) == (0, "" if 1 in closed else whole.stdout, "")


def test_nobody_waits_for_a_process_that_has_ended(tmp_path):
    """A child sends its mesh to nobody where its parent has ended, and ends too."""
    code = f"""
import os
from jaxmorph.io import _ahead
_ahead.begin({str(tmp_path / "in.su2")!r})
((child, pipe),) = _ahead._begun.values()
pipe.close()
print(os.waitpid(child, 0)[1])
"""
    io.write(tmp_path / "in.su2", bricks(24))  # more than a pipe holds
    assert run("-c", code).stdout == "0\n"
