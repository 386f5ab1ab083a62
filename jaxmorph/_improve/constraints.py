"""The problem of `improve`: nodes that are held, nodes that are led, and the cells' energy."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._boundary.conditions import Conditions
from .._boundary.tracks import Track, check_repeated, smoothed, tracks_of
from .._boundary.walls import Flat
from .._host.cells.topology import solid
from .._host.linear.hessians import Pattern, pattern
from .._host.rows import join_ids, mark
from .._kernels.compile import compiled
from .._kernels.values import as_jax
from .._mesh.mesh import Mesh
from .._quality.distortion import node_scales, signs_of_pieces, target_cells
from .motion import Distortion, Ways


def problem_of(
    boundary: Conditions, mesh: Mesh, dtype, ideal: bool, size_weight: float
) -> tuple[Distortion, Pattern]:
    n, d = mesh.points.shape
    pairings = boundary.pairings
    held, tracks = _split_held(boundary, mesh)
    cells = {kind: np.asarray(ids) for kind, ids in solid(mesh.linear.cells, d).items()}
    free = mark(n, *cells.values()) & ~mark(n, held)
    check_repeated(tracks, held, pairings, np.asarray(mesh.points), free)
    leads = np.arange(n)  # the node with which every node moves; none moves with one that is held
    for pairing in pairings:
        leads[pairing.second] = leads[pairing.first]
        free[pairing.alone] = False
    free[np.isin(leads, np.unique(leads[~free]))] = False
    distortion = _distortion_of(
        {kind: jnp.asarray(ids) for kind, ids in cells.items()},
        jnp.asarray(mesh.points, dtype),
        signs_of_pieces(mesh),
        jnp.asarray(free),
        Ways(*as_jax((tracks, pairings, leads != np.arange(n), np.zeros((n, d, d))))),
        ideal,
        size_weight,
    )
    groups = [*(leads[ids] for ids in cells.values()), np.arange(n)[:, None]]
    return jax.lax.stop_gradient(distortion), pattern(groups, n, d)


def _split_held(boundary: Conditions, mesh: Mesh) -> tuple[np.ndarray, tuple[Track, ...]]:
    """Nodes that do not move, and tracks of those that slide."""
    points = boundary.points
    held = [boundary.moving, boundary.fixed]
    sliding = mark(len(points), *(track.rows for track in boundary.tracks))
    on_plane = boundary.on.T
    pairs = zip(boundary.planes, on_plane, strict=True)
    walls = [
        (Flat(plane.normal, plane.origin), np.flatnonzero(is_on & ~sliding))
        for plane, is_on in pairs
    ]
    tracks, corners = tracks_of(walls, (), boundary.on[:, :0], points)
    tracks = *boundary.tracks, *tracks
    edges = [track.rows for track in tracks if len(track.walls) > 1]
    ways = [track.rows for track in tracks]
    ways += [
        np.append(side, pair.alone)
        for pair in boundary.pairings
        for side in (pair.first, pair.second)
    ]
    ways = [*ways, *map(np.flatnonzero, on_plane), boundary.free]
    sides = _held_sides(mesh, [mark(len(points), nodes, *held, corners, *edges) for nodes in ways])
    return np.concatenate([sides, *held, corners]).astype(int), tuple(map(smoothed, tracks))


def _held_sides(mesh: Mesh, ways: Sequence[Bool[np.ndarray, " n"]]) -> np.ndarray:
    """Nodes of patches and outer faces, except where one lies wholly in one of the `ways`."""
    sides = [np.asarray(nodes)[None] for nodes in mesh.patches.values()]
    sides += [ids for ids, _ in mesh.linear.topology.sides.values()]
    for is_led in ways:
        sides = [ids[~is_led[ids].all(axis=1)] for ids in sides]
    return join_ids(sides)


@compiled
def _distortion_of(
    cells: dict[str, Array],
    reference: Float[Array, "n d"],
    signs,
    free: Bool[Array, " n"],
    ways,
    ideal,
    size,
):
    goals = target_cells(cells, reference, signs, ideal)
    scale = node_scales(cells, goals, len(reference))
    return Distortion(
        cells=cells,
        targets=goals,
        scale=scale,
        free=free,
        softness=jnp.ones((), reference.dtype),
        ways=ways,
        size=float(size),
    )
