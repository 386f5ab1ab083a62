"""JAX's cache of compiled code in a command: where, how large, for whom, and when not."""

import os
import subprocess
import sys

import numpy as np
import pytest

import jaxmorph as jm
from jaxmorph._kernels.compile import compiled, quickly_compiled

CODE = """
import jax
from jaxmorph.cli import _entry
_entry.begin_jax()
values = jax.config.values
print(values["jax_compilation_cache_dir"], values["jax_compilation_cache_max_size"])
jax.numpy.negative(jax.numpy.ones(3)).block_until_ready()
"""


def cached(tmp_path, code=CODE, **variables):
    """What a process says of its cache, and the files in the user's cache folder afterwards."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("JAX")}
    environment |= {"XDG_CACHE_HOME": str(tmp_path)} | variables
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return done.stdout.split(), [file.name for file in tmp_path.rglob("*-cache")]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="other systems have another cache folder")
def test_it_is_in_the_users_cache_folder_with_a_limit_and_a_lock(tmp_path):
    (folder, limit), files = cached(tmp_path)
    assert folder.startswith(str(tmp_path / "jaxmorph" / "compiled"))
    assert int(limit) == 256 * 2**20
    assert files
    assert list(tmp_path.rglob(".lockfile"))


@pytest.mark.slow
def test_jax_can_turn_it_off_or_put_it_elsewhere(tmp_path):
    assert not cached(tmp_path, JAX_ENABLE_COMPILATION_CACHE="false")[1]
    (folder, limit), _ = cached(tmp_path, JAX_COMPILATION_CACHE_DIR=str(tmp_path / "elsewhere"))
    assert (folder, limit) == (str(tmp_path / "elsewhere"), "-1")


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="other systems have another cache folder")
@pytest.mark.parametrize("mode", [0o777, 0o770])
def test_no_code_comes_from_a_folder_that_others_may_write(tmp_path, mode):
    (folder, _), _ = cached(tmp_path)
    assert os.stat(folder).st_mode & 0o777 == 0o700
    os.chmod(folder, mode)
    assert cached(tmp_path)[0][0] == "None"


@pytest.mark.slow
def test_a_folder_that_cannot_be_made_is_no_error(tmp_path):
    (tmp_path / "file").write_text("")
    (folder, _), _ = cached(tmp_path, XDG_CACHE_HOME=str(tmp_path / "file"))
    assert folder == "None"


def test_code_that_is_compiled_quickly_computes_the_same():
    x = np.linspace(0.1, 1, 300).reshape(100, 3)
    squares = compiled(lambda x: jm.ThinPlateSpline()(x**2))
    for is_quick in (True, False):
        with quickly_compiled(is_quick):
            np.testing.assert_allclose(squares(x), x**2 * np.log(x), rtol=1e-14)


HEALED = """
import warnings
from jaxmorph.cli import _entry
warnings.simplefilter("always")
warnings.showwarning = lambda message, *_: _entry.is_healed(message) or print(message)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="other systems have another cache folder")
@pytest.mark.parametrize("damage", ["cut", "changed", "without a time"])
def test_a_damaged_entry_is_replaced(tmp_path, damage):
    """Nothing is said of it, and a new entry is in its place."""
    said, _ = cached(tmp_path, HEALED + CODE)
    entries = {file: file.read_bytes() for file in tmp_path.rglob("*-cache")}
    for file, content in entries.items():
        if damage == "without a time":
            file.with_name(file.name.replace("-cache", "-atime")).unlink()
        else:
            file.write_bytes(content[:20] if damage == "cut" else b"damaged" + content[7:])
    assert cached(tmp_path, HEALED + CODE)[0] == said
    healed = {file: file.read_bytes() for file in tmp_path.rglob("*-cache")}
    assert healed.keys() == entries.keys()
    assert all(len(content) > 20 and content[:7] != b"damaged" for content in healed.values())
