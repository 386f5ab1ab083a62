"""A plan on other base coordinates: what the old ones determined follows, and what was given is checked."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Real

from .._boundary.closest import Track
from .._boundary.periodic import MISMATCH, Pairing
from .._boundary.symmetry import tolerance
from .._host.package.arguments import checked
from .._host.package.cores import Tree
from .._host.package.errors import MeshError, place_of
from .._kernels.compile import compiled
from .._kernels.values import is_readable
from .._methods.blocks import without_tables
from .plan import Plan, base_points, refitted

DEVIATION = 1e-5
"""Distance from a plane or a wall, relative to the extent of its nodes, that a new base may have: small differences pass."""


@checked
def refit(plan: Plan, points: Real[ArrayLike, "n d"] | Sequence[Any]) -> Plan:
    """Computes a plan anew on other base coordinates: ids are kept, floats computed. Traced and differentiable.

    It is meant for another mesh of the same family. The steps of one motion are those of `march`: points that a large
    motion has carried out of their simplices extrapolate.

    Patches that slide on their own faces do so on those of the new points, and periodic pairs have their translation.
    Symmetry planes, surfaces that were given to `jm.Slide`, and rotations stay. Points that do not keep them are refused;
    those that are traced are not looked at.

    **Arguments:**

    - `plan`: the plan.
    - `points`: the new base coordinates (n, d), in the unit of the old ones.

    **Returns:** a `Plan`.

    **Raises:** `ValueError` when the shape of `points` differs from the plan's. Also where nodes leave a symmetry plane or a
    given surface, and where periodic pairs do not match any more: with the number, and the worst node. Also where the ids do not
    serve any more, because nodes have come within the radius of `CompactRBF` or `LocalCorrection`. In traced code the answer
    there is NaN. Also for a plan of a piece, which does not know where the surface went: prepare the new surface, and attach the
    piece to that.
    """
    if plan.is_piece:
        raise ValueError(
            "this plan is of a piece: call prepare_surface with the new surface, and attach the new points to it."
        )
    points = base_points(plan, points)
    guide = plan.surface.guide
    if guide is not None:
        plan = _with(plan, *_boundary_at(guide.tracks, guide.pairings, points[plan.surface.nodes]))
    if (guide is not None or plan.images is not None) and is_readable((points, plan)):
        _check_boundary(plan, np.asarray(points))
    refit = refitted(plan, points)
    if is_readable((points, plan)):
        _check_places(refit, np.asarray(points))
    return refit


def with_boundary_of(plan: Plan, other: Plan) -> Plan:
    """Returns a plan with the walls and transforms of another plan of its mesh and lists."""
    guide = other.surface.guide
    return plan if guide is None else _with(plan, guide.tracks, guide.pairings)


def _with(plan: Plan, tracks: tuple[Track, ...], pairings: tuple[Pairing, ...]) -> Plan:
    guide = plan.surface.guide
    if guide is None:
        return plan
    images = guide.plan.images
    guide = eqx.tree_at(lambda guide: (guide.tracks, guide.pairings), guide, (tracks, pairings))
    if images is not None:
        guide = eqx.tree_at(lambda guide: guide.plan.surface.images, guide, images.at(pairings))
    return eqx.tree_at(lambda plan: plan.surface.guide, plan, guide)


@compiled
def _boundary_at(
    tracks: tuple[Track, ...], pairings: tuple[Pairing, ...], points: Float[Array, "o d"]
) -> tuple[tuple[Track, ...], tuple[Pairing, ...]]:
    return tuple(each.at(points) for each in tracks), tuple(each.at(points) for each in pairings)


def _check_boundary(plan: Plan, points: np.ndarray) -> None:
    """Raises `ValueError` where points are not on the planes and walls of a plan, or do not match as its pairs."""
    if plan.images is not None:
        flags = np.asarray(plan.volume.on_plane)[: len(points)]
        for plane, is_on in zip(plan.images.planes, flags.T, strict=True):
            nodes = np.flatnonzero(is_on)
            size = np.ptp(points[nodes], axis=0).max(initial=0.0)
            allowed = max(DEVIATION * size, tolerance(points))
            what = f"nodes have left the symmetry plane with normal {plane.normal.tolist()}"
            _refuse(what, np.abs(plane.height(points[nodes])), allowed, nodes, points)
    guide = plan.surface.guide
    if guide is None:
        return
    nodes = np.asarray(plan.surface.nodes)
    here, exact = points[nodes], points[nodes].astype(float)
    for track in guide.tracks:
        rows = np.asarray(track.rows)
        size = np.ptp(np.concatenate([here[np.asarray(track.rows)] for track in guide.tracks]), axis=0).max()
        for wall in track.walls:
            off = np.asarray(wall.distance(jax.numpy.asarray(here[rows])))
            what = "nodes of sliding patches have left their surface"
            _refuse(what, off, max(DEVIATION * size, tolerance(points)), nodes[rows], points)
    for pairing in jax.tree.map(np.asarray, guide.pairings):
        second = exact[pairing.second]
        spacing = (
            np.asarray(Tree(second).query(second, k=2)[0])[:, 1] if len(second) > 1 else np.ptp(exact, axis=0).max()
        )
        allowed = np.maximum(MISMATCH * spacing, 2 * tolerance(points))
        what = "periodic pairs do not match after their transform"
        _refuse(what, pairing.misses(exact), allowed, nodes[pairing.first], points)


@compiled
def _have_no_place(plan: Plan) -> tuple[Bool[Array, " n"], Bool[Array, ""]]:
    """Marks points whose weights are not finite, and tells whether the solve is."""
    rows = [
        leaf.reshape(len(leaf), -1)
        for leaf in jax.tree.leaves(without_tables(plan.volume.placed))
        if eqx.is_inexact_array(leaf)
    ]
    finite = [jnp.isfinite(leaf).all() for leaf in jax.tree.leaves(plan.surface.factors) if eqx.is_inexact_array(leaf)]
    lost = [~jnp.isfinite(row).all(axis=1) for row in rows]
    return sum(lost, jnp.zeros(len(plan.volume.points), bool)), jnp.stack([jnp.array(True), *finite]).all()


def _check_places(plan: Plan, points: np.ndarray) -> None:
    """Raises `ValueError` where a plan's ids do not serve at its base points any more; where these are finite."""
    lost, is_solved = map(np.asarray, _have_no_place(plan))
    if (is_solved and not lost.any()) or not np.isfinite(points).all():
        return
    nodes = np.flatnonzero(lost[: len(points)])
    if not len(nodes):
        raise ValueError(
            "the plan's solve is not finite at the new base points: nodes of the surface have come nearer to each other than "
            "the plan searched for them, or coincide. Call `prepare` with the new mesh and its boundaries."
        )
    raise MeshError(
        f"{len(nodes)} of {len(points)} points have lost their place at the new base points, first node {{node}} at "
        f"({place_of(points[nodes[0]])}): nodes of the surface have come nearer to them than the plan searched, or a simplex "
        "of its graph has no volume. Call `prepare` with the new mesh and its boundaries.",
        nodes,
    )


def _refuse(what: str, off: np.ndarray, allowed: np.ndarray | float, nodes: np.ndarray, points: np.ndarray) -> None:
    wrong = np.flatnonzero(off > allowed)
    if wrong.size:
        wrong = wrong[np.argsort(-off[wrong], kind="stable")]
        worst_first, limit = nodes[wrong], np.broadcast_to(allowed, off.shape)[wrong[0]]
        place = place_of(points[worst_first[0]])
        raise MeshError(
            f"{len(wrong)} of {len(nodes)} {what} at the new base points, the worst is node {{node}} at ({place}), "
            f"{off.max():.3g} away (allowed {limit:.3g}). Call `prepare` with the new mesh and its boundaries.",
            worst_first,
        )
