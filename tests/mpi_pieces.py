"""Two processes that have half of a mesh each; `test_mpi.py` runs them."""

import sys

import jax
import numpy as np
from meshes import lattice
from mpi4py import MPI

import jaxmorph as jm
from jaxmorph import cases
from jaxmorph.integrations import mpi

jax.config.update("jax_enable_x64", True)
comm = MPI.COMM_WORLD

mesh = cases.naca0015(points=300)  # the whole is here only to judge by
points, wall, far = np.asarray(mesh.points), mesh.patch("airfoil"), mesh.patch("farfield")
kind, cells = next((kind, ids) for kind, ids in mesh.cells.items() if kind != "line")
cells = np.asarray(cells)
own = cells[(points[cells].mean(axis=1)[:, 1] > 0.01) == (comm.rank == 0)]
nodes, inverse = np.unique(own, return_inverse=True)
piece_cells = {kind: inverse.reshape(own.shape).astype(np.int32)}
moving, fixed = np.flatnonzero(np.isin(nodes, wall)), np.flatnonzero(np.isin(nodes, far))

piece = mpi.prepare(comm, points[nodes], nodes, moving, fixed)


def motion(x):
    return np.stack([0.02 * np.cos(5 * x[:, 1]), 0.05 * x[:, 0] * (1 - x[:, 0])], axis=1)


plan = jm.prepare(points, wall, far)
u_all, u = motion(points[wall]), motion(points[nodes[moving]])
moved, whole = piece.deform(u), np.asarray(jm.deform(plan, u_all))
assert np.abs(moved - whole[nodes]).max() < 3e-12

# a gradient of a sum over all nodes: shared ones count once
weight = np.random.default_rng(3).normal(size=points.shape)
gradient = piece.pullback(u, weight[nodes])
expected = np.asarray(jm.pullback(plan, u_all, weight))
# forward products, and pieces of a half that one process prepared
half = comm.bcast(jm.prepare_surface(jm.Boundary(points, wall, far)) if comm.rank == 0 else None)
attached = mpi.attach(comm, half, points[nodes], nodes)
assert np.array_equal(attached.moving, moving)
tangent = np.cos(3 * points[wall])
change = np.asarray(jm.velocity(plan, u_all, tangent))[nodes]
for each in (piece, attached):
    assert (
        np.abs(each.pushforward(u, tangent[np.searchsorted(wall, nodes[moving])]) - change).max()
        < 3e-12
    )
assert np.abs(attached.deform(u) - moved).max() < 3e-12

row = {node: k for k, node in enumerate(wall)}
expected = expected[[row[node] for node in nodes[moving]]]
assert np.abs(gradient - expected).max() < 2e-9 * np.abs(expected).max()
assert comm.allreduce(int(piece.is_owner.sum())) == len(points)
shared = comm.allreduce(len(nodes)) - len(points)
assert shared > 5

places = comm.allgather({int(node): tuple(place) for node, place in zip(nodes, moved, strict=True)})
both = places[0].keys() & places[1].keys()
assert len(both) == shared
assert all(places[0][node] == places[1][node] for node in both)  # bit for bit

part = jm.Mesh(points[nodes], piece_cells)
limits = jm.Limits(max_skewness=0.2)
verdict, expected = (
    piece.judge(part, moved, limits),
    jm.judge(jm.Mesh(points, {kind: cells}), whole, limits),
)
assert (verdict.cells, verdict.inverted, verdict.parts) == (len(cells), expected.inverted, 2)
for row in (("max", "skewness"), ("mean", "skewness"), ("min", "jacobian_ratio")):
    assert abs(verdict.rows[row].value - expected.rows[row].value) < 1e-9
assert verdict.gates[0].beyond == expected.gates[0].beyond > 0


# pieces with cells know the faces, so the mesh moves as it does whole: in a passage too, and where pieces have ghost cells
def moved_in_pieces(whole, patches, parts, u_of):
    """Moves a mesh whose piece in each process has the given cells; tells the largest distance from the mesh moved whole."""
    points = np.asarray(whole.points)
    kinds = {kind: np.asarray(ids) for kind, ids in whole.cells.items() if len(np.asarray(ids))}
    mine = {kind: ids[parts[kind][comm.rank]] for kind, ids in kinds.items()}
    here = np.unique(np.concatenate([ids.ravel() for ids in mine.values()]))
    part = jm.Mesh(points[here], {kind: np.searchsorted(here, ids) for kind, ids in mine.items()})
    lists = [np.flatnonzero(np.isin(here, ids)) for ids in patches]
    one = mpi.prepare(comm, part, here, *lists)
    plan = jm.prepare(whole, *patches)
    expected = np.asarray(jm.deform(plan, u_of(points[patches[0]])))
    return (
        np.abs(one.deform(u_of(points[here[lists[0]]])) - expected[here]).max()
        / np.ptp(points, axis=0).max()
    )


for whole, patches in (
    (jm.Mesh(points, {kind: cells}), (wall, far)),
    (cases.wing(points=300, stations=4), None),
):
    patches = patches or (
        whole.patch("wing"),
        np.setdiff1d(whole.patch("farfield"), whole.patch("wing")),
    )
    middles = {
        k: np.asarray(whole.points)[np.asarray(ids)].mean(axis=1) for k, ids in whole.cells.items()
    }
    for ghosts in (0.0, 0.1):  # cells of both pieces lie about the cut
        parts = {k: [x[:, 0] > 0.4 - ghosts, x[:, 0] <= 0.4 + ghosts] for k, x in middles.items()}
        error = moved_in_pieces(whole, patches, parts, lambda x: 0.05 * np.sin(3 * x[:, ::-1]))
        assert error < 1e-10, error

# between two parallel planes: all of their nodes count, whoever has them
grid = lattice(np.linspace(-2, 2, 13), np.linspace(0, 1, 7))
round_body = [0, 0.5] + 0.2 * np.stack([np.cos(np.arange(12)), np.sin(np.arange(12))], axis=1)
channel = np.concatenate([round_body, grid[np.linalg.norm(grid - [0, 0.5], axis=1) > 0.25]])
planes = [jm.Plane([0, 1], [0, 0]), jm.Plane([0, 1], [0, 1])]
ends = np.abs(channel[:, 0]) == 2
here = np.flatnonzero((channel[:, 0] <= 0) if comm.rank else (channel[:, 0] >= 0))
lists = np.flatnonzero(here < 12), np.flatnonzero(ends[here])
between = mpi.prepare(comm, channel[here], here, *lists, symmetry=planes)
whole_plan = jm.prepare(channel, np.arange(12), np.flatnonzero(ends), symmetry=planes)
lift = np.tile([0.02, 0.05], (12, 1))
expected = np.asarray(jm.deform(whole_plan, lift))[here]
assert np.abs(between.deform(lift[: len(lists[0])]) - expected).max() < 3e-12

# what one process refuses, all refuse; none waits
for wrong in (
    lambda: piece.deform(u[:-1] if comm.rank else u),
    lambda: piece.deform(u + comm.rank),
    lambda: mpi.prepare(comm, points[nodes], nodes, moving + 1000 * comm.rank, fixed),
    lambda: mpi.prepare(
        comm, points[nodes][: 0 if comm.rank else None], nodes[: 0 if comm.rank else None], [], []
    ),
    lambda: mpi.prepare(comm, points[nodes], nodes, np.isin(nodes, wall), fixed),
    lambda: mpi.prepare(comm, None if comm.rank else points[nodes], nodes, moving, fixed),
    lambda: mpi.prepare(
        comm, points[nodes], nodes, moving, fixed, symmetry="symmetry" if comm.rank else ()
    ),
    lambda: mpi.prepare(comm, part if comm.rank else points[nodes], nodes, moving, fixed),
    lambda: mpi.prepare("world", points[nodes], nodes, moving, fixed),
    lambda: piece.pullback(u, {} if comm.rank else weight[nodes]),
    lambda: piece.pushforward(u, u[:-1] if comm.rank else u),
    lambda: mpi.attach(comm, None if comm.rank else half, points[nodes], nodes),
    lambda: piece.judge(None if comm.rank else part, moved),
):
    try:
        wrong()
    except ValueError as error:
        message = str(error)
    else:
        sys.exit(f"process {comm.rank} saw no error")
    for rank, line in enumerate(comm.gather(message) or ()):
        print(rank, line)  # one process prints: lines of two would mix
