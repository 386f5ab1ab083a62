"""Which run holds which cases of a law, tables of what is refused, and runs of several processes."""

import os
import pathlib
import re
import subprocess
import sys

import pytest

from jaxmorph.cli import main

TESTS = pathlib.Path(__file__).resolve().parent


def mpi_run(count: int, module: str, *words: str) -> str:
    """Runs a module in several processes, and returns what they print; skips without mpi4py and its mpiexec."""
    pytest.importorskip("mpi4py")
    command = pathlib.Path(sys.executable).with_name("mpiexec")
    if not command.exists():
        pytest.skip(
            "no mpiexec beside this python: another one may belong to another MPI than mpi4py"
        )
    run = [str(command), "-n", str(count), sys.executable, "-m", module, *words]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(TESTS.parent), str(TESTS)])}
    # with the library of another MPI each process takes itself for the only one, and has all pieces
    libraries = command.resolve().parents[1] / "lib"
    if any(libraries.glob("libmpi.*")):
        environment["MPI4PY_LIBMPI"] = str(libraries)
    done = subprocess.run(
        run, capture_output=True, text=True, env=environment, timeout=900, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def runs(fast=(), slow=(), nightly=()) -> list:
    """Lists cases for `parametrize`, marked by the run that holds them. A case of several arguments is a tuple."""
    marked = [*((case, ()) for case in fast), *((case, pytest.mark.slow) for case in slow)]
    marked += [(case, pytest.mark.nightly) for case in nightly]
    return [
        pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=marks)
        for case, marks in marked
    ]


def printed(capsys, words: list[str]) -> str:
    """What a command prints that ends well."""
    assert main(words) == 0
    return capsys.readouterr().out


def refused(capsys, words: list[str], message: str) -> None:
    """Runs a command that cannot be done: it ends with 2, and prints one line of error alone."""
    capsys.readouterr()
    try:
        status = main(words)
    except SystemExit as end:
        status = end.code
    said = capsys.readouterr()
    assert (status, said.out, said.err.count("\n")) == (2, "", 1)
    assert re.search(message, said.err), said.err


def all_refused(*cases) -> None:
    """Calls each of these, which ends with a ValueError of these words."""
    for call, message in cases:
        with pytest.raises(ValueError, match=message):
            call()


def over(names: str, *cases, ids=None, **more):
    """Parametrises a test over the cases of `runs`; several names of arguments are parted by spaces."""
    return pytest.mark.parametrize(
        names.split() if " " in names else names, runs(*cases, **more), ids=ids
    )


def refusals(*cases, of=tuple):
    """Makes a test of calls, each refused in two sentences at most, in words that match; `of` makes their arguments."""

    @pytest.mark.parametrize(("call", "words"), cases)
    def refuses(call, words):
        with pytest.raises(ValueError, match=words) as caught:
            call(*of())
        assert len(re.split(r"(?<=[a-z)])\. ", str(caught.value))) <= 2

    return refuses
