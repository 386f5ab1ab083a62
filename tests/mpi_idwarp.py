"""Processes that move a grid by IDWarp's calls, and keep what they find by places in the mesh; `test_idwarp.py` runs them."""

import pathlib
import sys

import idwarp_meshes as meshes
import numpy as np
from mpi4py import MPI

from jaxmorph.integrations.idwarp import USMesh

folder, comm = pathlib.Path(sys.argv[1]), MPI.COMM_WORLD


def summed(points, values):
    """Values by place, in the order of the places; those of all processes and of copies at one place add up."""
    points, values = (np.concatenate(comm.allgather(each.reshape(-1, 3))) for each in (points, values))
    _, at = np.unique(points, axis=0, return_inverse=True)
    total = np.zeros((at.max() + 1, 3))
    np.add.at(total, at.ravel(), values)
    return total


def by_place(points, values):
    """Values by place, which are alike in all processes and copies."""
    total, count = summed(points, values), summed(points, np.ones_like(values))
    return total / count


for kind, name in (("structured", "grid.cgns"), ("openfoam", "case")):
    planes = [[[0, 0, 0], [1, 0, 0]], [[0, 0, 0], [0, 1, 0]]]
    options = {"gridFile": str(folder / name), "specifiedSurfaces": ["floor"], "symmetryPlanes": planes}
    mesh = USMesh(options=options, comm=comm)
    start = mesh.getCommonGrid()
    count = len(start)
    first = sum(comm.allgather(count)[: comm.rank])
    # a solver that has the nodes of the other process, in the opposite order
    everything = sum(comm.allgather(count))
    share = np.array_split(np.arange(everything // 3), comm.size)[-1 - comm.rank][::-1]
    indices = (3 * share[:, None] + np.arange(3)).ravel()
    mesh.setExternalMeshIndices(indices)
    whole = np.concatenate(comm.allgather(start))
    assert np.array_equal(mesh.getSolverGrid(), whole[indices])

    surface = mesh.getSurfaceCoordinates()
    mesh.setSurfaceCoordinates(meshes.bump(surface))
    mesh.warpMesh()
    moved = mesh.getCommonGrid()
    found = {"grid": by_place(start, moved), "solver": by_place(whole[indices], mesh.getSolverGrid())}
    # a derivative by place, which copies share: what each node has adds up to it
    seed = np.cos(7 * start) / summed(start, np.ones(count))[np.unique(
        np.concatenate(comm.allgather(start.reshape(-1, 3))), axis=0, return_inverse=True)[1].ravel()[first // 3 :][: count // 3]].ravel()  # fmt: skip
    mesh.warpDeriv(seed, solverVec=False)
    found["dXs"] = summed(surface, mesh.getdXs())
    tangent = np.sin(5 * surface)
    change = mesh.warpDerivFwd(tangent, solverVec=False)
    found["change"] = by_place(start, change)
    left = comm.allreduce(float(np.vdot(seed, change)))
    right = comm.allreduce(float(np.vdot(tangent, mesh.getdXs())))
    assert abs(left - right) < 1e-12 * np.linalg.norm(found["change"]) * np.linalg.norm(seed), (left, right)
    mesh.warpDeriv(np.cos(7 * mesh.getSolverGrid()))
    solvers = mesh.warpDerivFwd(tangent)
    left = comm.allreduce(float(np.vdot(np.cos(7 * mesh.getSolverGrid()), solvers)))
    right = comm.allreduce(float(np.vdot(tangent, mesh.getdXs())))
    assert abs(left - right) < 1e-11 * comm.allreduce(float(np.linalg.norm(solvers))), (left, right)
    assert mesh.verifyWarpDeriv(dofEnd=2) < 1e-6
    if comm.rank == 0:
        np.savez(folder / f"{kind}-{comm.size}.npz", **found)
    if kind == "openfoam" and comm.size > 1:
        mesh.writeGrid(str(folder / "moved"))
