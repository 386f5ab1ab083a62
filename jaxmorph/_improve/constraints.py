"""The problem of `improve`: nodes that are held, nodes that are led, and the cells' energy."""

import dataclasses
from collections.abc import Iterable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._boundary.boundary import Boundary
from .._boundary.periodic import Pairing
from .._boundary.tracks import Track, check_repeated, smoothed, tracks_of
from .._boundary.walls import Flat
from .._host.cells.pieces import boundary_faces
from .._host.cells.topology import solid
from .._host.linear.hessians import Pattern, pattern
from .._kernels.compile import compiled
from .._kernels.values import as_jax
from .._mesh.mesh import Mesh
from .._quality.distortion import node_scales, signs_of_pieces, targets
from .motion import Distortion, Ways


@dataclasses.dataclass(frozen=True)
class Constraints:
    held: np.ndarray
    tracks: tuple[Track, ...]
    pairings: tuple[Pairing, ...]


def constraints_of(boundary: Boundary, mesh: Mesh) -> Constraints:
    points, data = boundary.points, np.concatenate([boundary.moving, boundary.fixed])
    sliding = _rows(boundary.tracks)
    on_plane = [np.flatnonzero(plane.holds(points)) for plane in boundary.planes]
    pairs = zip(boundary.planes, on_plane, strict=True)
    walls = [(Flat(plane.normal, plane.origin), np.setdiff1d(nodes, sliding)) for plane, nodes in pairs]
    tracks, corners = tracks_of(walls, (), points)
    tracks, held = (*boundary.tracks, *tracks), np.append(data, corners)
    edges = _rows(track for track in tracks if len(track.walls) > 1)
    ways = [track.rows for track in tracks if len(track.walls) == 1]
    ways += [np.append(side, pair.alone) for pair in boundary.pairings for side in (pair.first, pair.second)]
    ways = [np.concatenate([way, held, edges]) for way in (*ways, *on_plane, boundary.free)]
    return Constraints(np.append(_boundary(mesh, ways), held), tuple(map(smoothed, tracks)), boundary.pairings)


def _rows(tracks: Iterable[Track]) -> np.ndarray:
    return np.concatenate([np.zeros(0, dtype=int), *(track.rows for track in tracks)])


def prepared(
    mesh: Mesh, dtype, constraints: Constraints, ideal: bool, size_weight: float
) -> tuple[Distortion, Pattern]:
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
    """The node with which every node moves. Clears `free` for nodes whose partners are held."""
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
    """Nodes of patches and outer faces, except where one lies wholly in one of the `ways`."""
    sides = [np.asarray(nodes)[None] for nodes in mesh.patches.values()]
    sides += boundary_faces(solid(mesh.cells, mesh.points.shape[1]), len(mesh.points)).values()
    for nodes in ways:
        is_led = np.isin(np.arange(len(mesh.points)), nodes)
        sides = [ids[~is_led[ids].all(axis=1)] for ids in sides]
    return np.unique(np.concatenate([np.zeros(0, int), *map(np.ravel, sides)])).astype(int)
