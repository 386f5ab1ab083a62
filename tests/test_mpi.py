"""Pieces of a mesh in the processes of an MPI run."""

import os
import pathlib
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[1]


@pytest.mark.nightly
def test_two_processes_move_one_mesh():
    pytest.importorskip("mpi4py")
    command = pathlib.Path(sys.executable).with_name("mpiexec")
    if not command.exists():
        pytest.skip("no mpiexec beside this python: another one may belong to another MPI than mpi4py")
    run = [str(command), "-n", "2", sys.executable, str(ROOT / "tests" / "mpi_pieces.py")]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(run, capture_output=True, text=True, env=environment, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    for line in (
        "0 process 1: `u` has shape",
        "1 `u` has shape",
        "0 2 moving nodes are displaced differently",
        "1 2 moving nodes are displaced differently",
        *(
            "0 process 1: `prepare` takes a mesh or points",
            "0 process 1: `symmetry` holds",
            "0 `comm` must be a communicator",
        ),
        *("0 process 1: `tangent` has shape", "0 process 1: `half` must be"),
        *("0 process 1: `cotangent` must be", "0 process 1: `report` must be"),
    ):
        assert line in done.stdout, done.stdout
