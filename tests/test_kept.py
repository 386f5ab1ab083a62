"""Programs that a command keeps: found again by what they depend on, never where that may have changed."""

import os
import pathlib
import subprocess
import sys
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array

import jaxmorph as jm
from jaxmorph import cases, io
from jaxmorph._kernels import kept

pytest.importorskip("filelock")

LISTENER = """
import sys, jax, jaxmorph
from jax._src import monitoring
traced = []
def heard(event, seconds, **facts):
    if event.endswith("jaxpr_trace_duration"):
        traced.append(str(facts.get("fun_name")))
monitoring.register_event_duration_secs_listener(heard)
"""
COMMAND = """
from jaxmorph.cli import main
status = main()
print("traced", *sorted(traced))
sys.exit(status)
"""
SCRIPT = """
from jaxmorph import cases
jax.config.update("jax_enable_x64", True)
plan = jaxmorph.prepare(cases.sharp_o_grid(around=24, layers=8), "airfoil", "farfield")
moved = [jaxmorph.deform(plan, x * jax.numpy.ones((len(plan.moving), 2))) for x in (0.01, 0.02)]
found = jax.device_get((jax.tree.leaves(plan.surface.factors), moved))
print(jax.tree.map(lambda leaf: leaf.tobytes().hex(), found))
print("traced", *sorted(traced))
"""


class Pair(eqx.Module):
    """Arrays and what is none."""

    rows: Array
    name: str
    count: int


class Settings:
    """JAX's settings, some of them other ones."""

    def __init__(self, **changed):
        self.values, self.changed = jax.config.values | changed, changed
        self.update, self.config = jax.config.update, jax.config

    def __getattr__(self, name):
        return self.changed[name] if name in self.changed else getattr(self.config, name)


def halves(pair: Pair, factor):
    return Pair(pair.rows * factor, f"{pair.name} times", pair.count), pair.rows


def packaged(function):
    """The function as one of the package."""
    function.__module__ = "jaxmorph.tests"
    return function


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder of programs for this process, in which `Pair` is the package's."""
    anew(monkeypatch)
    monkeypatch.setattr(kept, "_folder", None)
    monkeypatch.setattr(kept, "KNOWN", (*kept.KNOWN, __name__))
    kept.keep(str(tmp_path), 2**20)
    return tmp_path


def result(function, *arguments) -> Any:
    found = kept.kept(function, *jax.tree.flatten((arguments, {})), (False, True), dict)
    return None if found is None else found()


def files(folder: pathlib.Path) -> list[pathlib.Path]:
    return sorted(folder.glob("jaxmorph-*-cache"))


def anew(monkeypatch):
    """As a new process finds the folder."""
    monkeypatch.setattr(kept, "_programs", {})
    monkeypatch.setattr(kept, "_names", {})


def never(*_):
    raise AssertionError("compiled again")


def test_a_program_is_found_again_with_its_results(folder, monkeypatch):
    x = jnp.arange(6.0).reshape(3, 2)
    first = result(halves, Pair(x, "x", 3), 0.1)
    assert len(files(folder)) == 1
    anew(monkeypatch)
    monkeypatch.setattr(kept, "_made", never)
    for given in (x, x + 1):
        (pair, same) = result(halves, Pair(given, "x", 3), 0.1)
        np.testing.assert_array_equal(pair.rows, given * 0.1)
        assert (pair.name, pair.count) == ("x times", 3)
        assert same is given
    np.testing.assert_array_equal(first[0].rows, x * 0.1)


@pytest.mark.parametrize(
    "arguments",
    [
        (Pair(jnp.ones((4, 2)), "x", 3), 0.1),
        (Pair(jnp.ones((3, 2), np.float32), "x", 3), 0.1),
        (Pair(jnp.ones((3, 2)), "y", 3), 0.1),
        (Pair(jnp.ones((3, 2)), "x", 3), 0.2),
        (Pair(jnp.ones((3, 2)), "x", 3), jnp.asarray(0.1)),
    ],
)
def test_another_shape_type_or_static_argument_is_another_program(folder, arguments):
    result(halves, Pair(jnp.ones((3, 2)), "x", 3), 0.1)
    pair, _ = result(halves, *arguments)
    assert len(files(folder)) == 2
    np.testing.assert_array_equal(pair.rows, arguments[0].rows * arguments[1])
    assert pair.name == f"{arguments[0].name} times"


def test_calls_of_one_form_are_named_once(folder, monkeypatch):
    """To name a program takes longer than a small call; what is static may be equal and yet differ."""
    for factor in (0.0, -0.0):
        result(halves, Pair(jnp.ones((3, 2)), "x", 3), factor)
    monkeypatch.setattr(kept, "_key", never)
    for factor in (0.0, -0.0):
        pair, _ = result(halves, Pair(2 * jnp.ones((3, 2)), "x", 3), factor)
        assert np.array_equal(np.signbit(pair.rows), np.signbit(np.full((3, 2), factor)))
    with jax.default_matmul_precision("float32"), pytest.raises(AssertionError, match="compiled again"):
        result(halves, Pair(jnp.ones((3, 2)), "x", 3), 0.0)


def test_changed_files_of_the_package_are_another_program(folder, monkeypatch):
    x = Pair(jnp.ones((3, 2)), "x", 3)
    result(halves, x, 0.1)
    anew(monkeypatch)
    monkeypatch.setattr(kept, "_world", lambda: b"another version")
    result(halves, x, 0.1)
    assert len(files(folder)) == 2


def test_another_kind_of_processor_has_programs_of_its_own(monkeypatch):
    """Nodes of a cluster may share a folder: code for wide vectors ends a process on an older node."""
    own = kept._world.__wrapped__()
    monkeypatch.setattr(kept.platform, "machine", lambda: "another")
    assert kept._world.__wrapped__() != own


def test_prepare_keeps_programs_in_jaxs_folder_if_there_is_one(folder, monkeypatch):
    x = Pair(jnp.ones((3, 2)), "x", 3)
    monkeypatch.setattr(kept, "_folder", None)
    monkeypatch.delenv(kept.SWITCH, raising=False)
    monkeypatch.setattr(kept.jax, "config", Settings(jax_compilation_cache_dir=str(folder)))
    assert result(halves, x, 0.1) is None
    with kept.kept_in_jaxs_folder():
        assert result(halves, x, 0.1) is not None
        with jax.default_matmul_precision("float32"):
            assert result(halves, x, 0.1) is not None
        assert len(files(folder)) == 2
        monkeypatch.setenv(kept.SWITCH, "off")
        assert result(halves, x, 0.1) is None


def test_functions_and_classes_of_the_user_are_not_kept(folder, monkeypatch):
    x, local = jnp.ones(3), packaged(lambda x: x + 1)
    assert result(local, x) is None
    monkeypatch.setattr(kept, "KNOWN", kept.KNOWN[:-1])
    assert result(halves, x, 0.1) is None
    assert result(jm.soft_maximum, (x, Pair(x, "x", 3))) is None
    assert not files(folder)


def test_a_program_that_calls_python_is_not_kept(folder):
    @packaged
    def asks(x):
        return jax.pure_callback(np.sin, jax.ShapeDtypeStruct(x.shape, x.dtype), x)

    asks.__qualname__ = "asks"
    np.testing.assert_array_equal(result(asks, jnp.arange(3.0)), np.sin(np.arange(3.0)))
    assert not files(folder)


def test_a_damaged_file_is_no_fault(folder, monkeypatch):
    x = Pair(jnp.ones((3, 2)), "x", 3)
    result(halves, x, 0.1)
    file = files(folder)[0]
    whole = file.read_bytes()
    flipped = [bytes([*whole[:at], whole[at] ^ 64, *whole[at + 1 :]]) for at in range(7, len(whole), len(whole) // 12)]
    for content in (b"", b"no program", whole[:1000], *flipped):
        file.write_bytes(content)
        anew(monkeypatch)
        np.testing.assert_array_equal(result(halves, x, 0.1)[0].rows, np.full((3, 2), 0.1))


def heard(folder, code, *words, **variables) -> list[str]:
    """What a process of its own says, and the names of the functions that it traces."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("JAX")}
    environment |= {"PYTHONPATH": str(pathlib.Path(jm.__file__).parents[1])} | variables
    command = [sys.executable, "-c", LISTENER + code, *words]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=True)
    return done.stdout.split("traced")


@pytest.mark.nightly
def test_a_command_traces_nothing_again_and_writes_the_same_file(tmp_path):
    mesh = cases.sharp_o_grid(around=24, layers=8)
    io.write(tmp_path / "mesh.su2", mesh)
    words = ["deform", "mesh.su2", "OUT", "--moving", "airfoil", "--fixed", "farfield", "--rotate", "5"]

    def run(name, **variables):
        command = (COMMAND, *(name if word == "OUT" else word for word in words))
        traced = heard(tmp_path, *command, XDG_CACHE_HOME=str(tmp_path / "cache"), **variables)[-1]
        return (tmp_path / name).read_bytes(), traced.split()

    plain, traced = run("plain.su2", JAXMORPH_CACHE="off")
    assert any("refitted" in name for name in traced)
    first, _ = run("first.su2")
    again, traced = run("again.su2")
    assert first == again == plain
    assert not any("refitted" in name or "_deform" in name or "_offset" in name for name in traced)


@pytest.mark.slow
def test_a_script_prepares_again_without_tracing(tmp_path):
    (factors, first), (same, again) = (
        heard(tmp_path, SCRIPT, JAX_COMPILATION_CACHE_DIR=str(tmp_path / "cache")) for _ in range(2)
    )
    assert same == factors
    for name in ("refitted", "_deform"):
        assert name in first
        assert name not in again
