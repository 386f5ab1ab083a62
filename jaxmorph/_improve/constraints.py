"""The problem of `improve`: nodes that are held, nodes that are led, and the cells' energy."""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._boundary.arguments import walls_of
from .._boundary.pairing import Pairing
from .._boundary.smooth_faces import smoothed
from .._boundary.tracks import Track, check_repeated, tracks_of
from .._boundary.walls import Flat
from .._host.cells.pieces import boundary_faces
from .._host.cells.topology import solid
from .._host.linear.hessians import Pattern, pattern
from .._kernels.compile import compiled
from .._kernels.values import as_jax
from .._mesh.mesh import Mesh
from .._plan.plan import Plan
from .._plan.prepare import boundary_of
from .._quality.distortion import node_scales, signs_of_pieces, targets
from .motion import Distortion
from .ways import Ways


@dataclasses.dataclass(frozen=True)
class Constraints:
    """Nodes that are `held`, and `tracks` and `pairings` that lead other boundary nodes."""

    held: np.ndarray
    tracks: tuple[Track, ...]
    pairings: tuple[Pairing, ...]


def constraints_of_mesh(mesh: Mesh, fixed, symmetry, sliding, periodic) -> Constraints:
    """Finds a mesh's constraints; without `fixed`, boundary nodes that do not slide are held."""
    walls, pairings = walls_of(mesh, symmetry, sliding, periodic, () if fixed is None else fixed)
    tracks, edges = tracks_of(walls, (), np.asarray(mesh.points))
    ways = [nodes for _, nodes in walls]
    ways += [np.append(side, pairing.alone) for pairing in pairings for side in (pairing.first, pairing.second)]
    fixed_nodes = _boundary(mesh, ways) if fixed is None else np.asarray(fixed, dtype=int)
    return Constraints(np.append(fixed_nodes, edges), tuple(map(smoothed, tracks)), pairings)


def constraints_of_plan(plan: Plan, mesh: Mesh) -> Constraints:
    """Finds the constraints of a plan; boundary nodes that the plan leaves free are held."""
    boundary = boundary_of(plan)
    flat = [
        (Flat(plane.normal, plane.origin), np.flatnonzero(plane.holds(boundary.points))) for plane in boundary.planes
    ]
    sliding = np.concatenate([np.zeros(0, dtype=int), *(track.rows for track in boundary.tracks)])
    flat = [(wall, np.setdiff1d(nodes, sliding)) for wall, nodes in flat]
    tracks, edges = tracks_of(flat, (), boundary.points)
    data = np.concatenate([boundary.moving, boundary.fixed])
    partners = [pairing.nodes for pairing in boundary.pairings]
    led = np.concatenate([data, sliding, *partners, *(nodes for _, nodes in flat)])
    fixed_nodes = np.concatenate([_boundary(mesh, [led]), data, edges])
    return Constraints(fixed_nodes, tuple(map(smoothed, (*boundary.tracks, *tracks))), boundary.pairings)


def prepared(
    mesh: Mesh, dtype, constraints: Constraints, ideal: bool, size_weight: float
) -> tuple[Distortion, Pattern]:
    """Prepares the energy, and on the host the pattern of its Hessian."""
    n, d = mesh.points.shape
    cells = _cells(mesh)
    tracks, pairings = constraints.tracks, constraints.pairings
    free = np.zeros(n, dtype=bool)
    free[np.concatenate([ids.ravel() for ids in cells.values()])] = True
    free[constraints.held] = False
    check_repeated(tracks, constraints.held, pairings, np.asarray(mesh.points), free)
    leads, has_ways = _leads(pairings, free), bool(tracks or pairings)
    distortion = _energy(
        {kind: jnp.asarray(ids) for kind, ids in cells.items()},
        jnp.asarray(mesh.points, dtype),
        signs_of_pieces(mesh),
        jnp.asarray(free),
        Ways(*as_jax((tracks, pairings, leads != np.arange(n), np.zeros((n, d - 1, d))))) if has_ways else None,
        ideal,
        size_weight,
    )
    groups = [leads[ids] for ids in cells.values()] + [np.arange(n)[:, None]] * has_ways
    return jax.lax.stop_gradient(distortion), pattern(groups, n, d)


def _leads(pairings: Sequence[Pairing], free: Bool[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """Finds the node with which every node moves.

    Clears `free` for nodes whose partners are held.
    """
    leads = np.arange(len(free))
    for pairing in pairings:
        leads[pairing.second] = leads[pairing.first]
        free[pairing.alone] = False
    free[np.isin(leads, np.unique(leads[~free]))] = False
    return leads


@compiled
def _energy(cells: dict[str, Array], reference: Float[Array, "n d"], signs, free: Bool[Array, " n"], ways, ideal, size):
    goals = targets(cells, reference, signs, ideal)
    scale = node_scales(cells, goals, len(reference))
    return Distortion(cells, goals, scale, free, jnp.ones((), reference.dtype), ways, float(size))


def _cells(mesh: Mesh) -> dict[str, np.ndarray]:
    return {kind: np.asarray(ids) for kind, ids in solid(mesh.linear.cells, mesh.points.shape[1]).items()}


def _boundary(mesh: Mesh, ways: Sequence[np.ndarray]) -> np.ndarray:
    """Lists nodes of patches and outer faces, except where one lies wholly in one of the `ways`."""
    sides = [np.asarray(nodes)[None] for nodes in mesh.patches.values()]
    sides += boundary_faces(solid(mesh.cells, mesh.points.shape[1]), len(mesh.points)).values()
    for nodes in ways:
        is_led = np.isin(np.arange(len(mesh.points)), nodes)
        sides = [ids[~is_led[ids].all(axis=1)] for ids in sides]
    return np.unique(np.concatenate([np.zeros(0, int), *map(np.ravel, sides)])).astype(int)
