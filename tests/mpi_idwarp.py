"""Processes that move a grid by IDWarp's calls, and keep what they find by places in the mesh; `test_idwarp.py` runs them."""

import pathlib
import sys

import idwarp_meshes as meshes
import numpy as np
from mpi4py import MPI

from jaxmorph.integrations.idwarp import MultiUSMesh, USMesh

folder, comm = pathlib.Path(sys.argv[1]), MPI.COMM_WORLD


def places(points):
    """The number of each point's place (k,) among the places of all processes, and how many places there are."""
    points = points.reshape(-1, 3)
    counts = comm.allgather(len(points))
    at = np.unique(np.concatenate(comm.allgather(points)), axis=0, return_inverse=True)[1].ravel()
    return at[sum(counts[: comm.rank]) :][: len(points)], at.max() + 1


def summed(points, values):
    """Sums (p, 3) of values by place: those of all processes, and of copies at one place, add up."""
    at, count = places(points)
    total = np.zeros((count, 3))
    np.add.at(total, at, values.reshape(-1, 3))
    return np.sum(comm.allgather(total), axis=0)


def by_place(points, values):
    """Means by place: of values that are alike in all processes and copies."""
    return summed(points, values) / summed(points, np.ones_like(values))


PLANES = {"symmetryPlanes": [[[0, 0, 0], [1, 0, 0]], [[0, 0, 0], [0, 1, 0]]]}
QUICK = {"useRotations": False} | PLANES
GRIDS = {
    "structured": ("grid.cgns", {"specifiedSurfaces": ["floor"]} | PLANES),
    "unstructured": ("mesh.cgns", {"specifiedSurfaces": ["floor"]} | QUICK),
    "plot3d": ("grid.xyz", {"specifiedSurfaces": ["kmin"]} | QUICK),
    "openfoam": ("case", {}),  # the types of its patches say the rest, in each part too
}

for kind, (name, options) in GRIDS.items():
    options = {"gridFile": str(folder / name)} | options
    mesh = USMesh(options=options, comm=comm)
    start = mesh.getCommonGrid()
    count = len(start)
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
    found = {
        "grid": by_place(start, moved),
        "solver": by_place(whole[indices], mesh.getSolverGrid()),
    }
    # a derivative by place: what its copies have adds up to it
    seed = np.cos(7 * start) / summed(start, np.ones(count))[places(start)[0]].ravel()
    mesh.warpDeriv(seed, solverVec=False)
    found["dXs"] = summed(surface, mesh.getdXs())
    tangent = np.sin(5 * surface)
    change = mesh.warpDerivFwd(tangent, solverVec=False)
    found["change"] = by_place(start, change)
    left = comm.allreduce(float(np.vdot(seed, change)))
    right = comm.allreduce(float(np.vdot(tangent, mesh.getdXs())))
    assert abs(left - right) < 1e-12 * np.linalg.norm(found["change"]) * np.linalg.norm(seed), (
        left,
        right,
    )
    mesh.warpDeriv(np.cos(7 * mesh.getSolverGrid()))
    solvers = mesh.warpDerivFwd(tangent)
    left = comm.allreduce(float(np.vdot(np.cos(7 * mesh.getSolverGrid()), solvers)))
    right = comm.allreduce(float(np.vdot(tangent, mesh.getdXs())))
    assert abs(left - right) < 1e-11 * comm.allreduce(float(np.linalg.norm(solvers))), (left, right)
    assert mesh.verifyWarpDeriv(dofStart=20, dofEnd=22) < 1e-6
    if comm.rank == 0:
        np.savez(folder / f"{kind}-{comm.size}.npz", **found)
    if kind == "openfoam" and comm.size > 1:
        mesh.writeGrid(str(folder / "moved"))

# grids that overlap: each process has the nodes of the other, and faces of its half of the zones
nodes = np.concatenate(
    [
        part.reshape(-1, 3, order="F") + meshes.OVERSET[zone]
        for zone, part in meshes.overset_blocks().items()
    ]
)
grid = MultiUSMesh(
    str(folder / "overset.cgns"), {key: {"useRotations": False} for key in ("wing", "tip")}, comm
)
share = np.array_split(np.arange(len(nodes)), comm.size)[-1 - comm.rank][::-1]
grid.setExternalMeshIndices((3 * share[:, None] + np.arange(3)).ravel())
points, zones = meshes.overset_floors()
own = np.array_split(np.arange(len(zones)), comm.size)[comm.rank]
corners = (4 * own[:, None] + np.arange(4)).ravel()
grid.setSurfaceDefinition(
    points[corners], np.arange(len(corners)), np.full(len(own), 4), zones[own]
)
grid.setSurfaceCoordinates(meshes.bump(points[corners]))
grid.warpMesh()
moved, change = np.zeros_like(nodes), np.zeros_like(nodes)
back = np.zeros_like(points)
back[corners] = grid.warpDeriv(np.cos(7 * nodes[share]).ravel())
moved[share] = grid.getSolverGrid().reshape(-1, 3)
change[share] = grid.warpDerivFwd(np.sin(5 * points[corners])).reshape(-1, 3)
found = {
    name: np.sum(comm.allgather(each), axis=0)
    for name, each in (("grid", moved), ("change", change))
}
found["dXs"] = summed(points[corners], back[corners])
if comm.rank == 0:
    np.savez(folder / f"overset-{comm.size}.npz", **found)
