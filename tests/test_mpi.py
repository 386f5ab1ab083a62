"""Pieces of a mesh in the processes of an MPI run."""

import pytest
from runs import mpi_run


@pytest.mark.nightly
def test_two_processes_move_one_mesh():
    told = mpi_run(2, "mpi_pieces")
    for line in (
        "0 process 1: `u` has shape",
        "1 `u` has shape",
        "0 2 moving nodes are displaced differently",
        "1 2 moving nodes are displaced differently",
        "0 process 1: `prepare` takes a mesh or points",
        "0 process 1: `symmetry` holds",
        "0 `comm` must be a communicator",
        "0 process 1: `tangent` has shape",
        "0 process 1: `half` must be",
        "0 process 1: `cotangent` must be",
        "0 process 1: `mesh` must be",
    ):
        assert line in told
