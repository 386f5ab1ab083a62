"""Compiled code that the command line keeps: where, how much, and when not."""

import gc
import os
import subprocess
import sys

import numpy as np
import pytest

import jaxmorph as jm
from jaxmorph._kernels.compile import compiled, quickly_compiled
from jaxmorph.cli import main

CODE = """
import jax
from jaxmorph.cli import _compiled
_compiled.keep_compiled()
values = jax.config.values
print(values["jax_compilation_cache_dir"], values["jax_compilation_cache_max_size"])
jax.numpy.negative(jax.numpy.ones(3)).block_until_ready()
"""


def kept(tmp_path, **variables):
    """What a process says of its cache, and the files in the user's cache folder afterwards."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("JAX")}
    environment |= {"XDG_CACHE_HOME": str(tmp_path)} | variables
    command = [sys.executable, "-c", CODE]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return done.stdout.split(), [file.name for file in tmp_path.rglob("*-cache")]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="other systems have another cache folder")
def test_it_is_in_the_users_cache_folder_with_a_limit_and_a_lock(tmp_path):
    (folder, limit), files = kept(tmp_path)
    assert folder.startswith(str(tmp_path / "jaxmorph" / "compiled"))
    assert int(limit) == 256 * 2**20
    assert files
    assert list(tmp_path.rglob(".lockfile"))


@pytest.mark.slow
@pytest.mark.parametrize("variables", [{"JAXMORPH_CACHE": "off"}, {"JAX_COMPILATION_CACHE_DIR": "elsewhere"}])
def test_it_can_be_turned_off_or_elsewhere(tmp_path, variables):
    if "JAX_COMPILATION_CACHE_DIR" in variables:
        variables = {"JAX_COMPILATION_CACHE_DIR": str(tmp_path / "elsewhere")}
    folder, limit = kept(tmp_path, **variables)[0]
    assert folder == variables.get("JAX_COMPILATION_CACHE_DIR", "None")
    assert int(limit) == -1
    assert not (tmp_path / "jaxmorph").exists()


@pytest.mark.slow
def test_a_folder_that_cannot_be_made_is_no_error(tmp_path):
    (tmp_path / "file").write_text("")
    (folder, _), _ = kept(tmp_path, XDG_CACHE_HOME=str(tmp_path / "file"))
    assert folder == "None"


def test_the_garbage_collector_is_that_of_the_caller(tmp_path):
    before = gc.isenabled(), gc.get_freeze_count()
    assert main(["info", str(tmp_path / "none.su2")]) == 2
    assert (gc.isenabled(), gc.get_freeze_count()) == before


def test_code_that_is_compiled_quickly_computes_the_same():
    x = np.linspace(0.1, 1, 300).reshape(100, 3)
    squares = compiled(lambda x: jm.ThinPlateSpline()(x**2))
    for is_quick in (True, False):
        with quickly_compiled(is_quick):
            np.testing.assert_allclose(squares(x), x**2 * np.log(x), rtol=1e-14)
