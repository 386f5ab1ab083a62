"""A plan on other base coordinates."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, PyTree, Real

from .._boundary.periodic import Pairing
from .._boundary.symmetry import tolerance
from .._boundary.tracks import Track
from .._host.package.arguments import checked
from .._host.package.errors import MeshError, place_of, worst_first
from .._host.package.rounding import extent_of, spacing
from .._host.rows import join_ids
from .._host.tolerances import DEVIATION, MISMATCH
from .._kernels.compile import Constant, compiled
from .._kernels.values import is_readable
from .._methods.blocks import place_points, with_tables_of, without_tables
from .devices import over_points, pad_rows
from .judge import deviations
from .plan import Own, Plan, VolumePart

CARRIED = Constant(True)


@compiled
def refitted(
    plan: Plan, points: Any, surface: Own | None = None, how: Constant | None = None
) -> Plan:
    """Computes a plan anew on other points. `CARRIED` are those after one of its own steps: the
    solve and layers over walls are made anew, and every point keeps its place in the graph. A piece
    then needs the whole moved surface.
    """
    carried = how is not None
    method = plan.method
    old = plan.surface
    whole = base_points(plan, points)
    own = whole[old.nodes] if surface is None else surface
    rows = old.images.points(own)
    guide = old.guide
    if guide is not None:
        guide = dataclasses.replace(guide, plan=refitted(guide.plan, own, None, how))
    ids = old.ids
    before = old.factors
    factors = method.carry(ids, before, rows, whole) if carried else method.fit(ids, rows, whole)

    def place(shared: PyTree, volume: VolumePart) -> PyTree:
        factors, rows, first = shared
        before = volume.placed if carried else None
        placed = place_points(method, volume.seen(first), volume.ids, factors, rows, before)
        return placed if volume.placed is None else with_tables_of(volume.placed, placed)

    volume = dataclasses.replace(plan.volume, points=pad_rows(whole, plan.layout))
    volume = dataclasses.replace(
        volume, placed=over_points(plan.layout, place, (factors, rows, own[0]), volume)
    )
    surface_part = dataclasses.replace(old, points=rows, factors=factors, guide=guide)
    return dataclasses.replace(plan, surface=surface_part, volume=volume, carried=carried)


def base_points(plan: Plan, points: Any) -> Float[Array, "n d"]:
    points = jnp.asarray(points, plan.volume.points.dtype)
    if points.shape != plan.points.shape:
        raise ValueError(
            f"`points` has shape {points.shape}; this plan was made for {plan.points.shape}."
        )
    return points


ANEW = "Call `prepare` with the new mesh and its boundaries."
WORDS = {
    "off_plane": "nodes have left their symmetry plane",
    "off_surface": "nodes of sliding patches have left their surface",
    "mismatch": "periodic pairs do not match after their transform",
}


@checked
def refit(plan: Plan, points: Real[ArrayLike, "n d"] | Sequence[Any]) -> Plan:
    """Computes a plan anew on other base coordinates `points` (n, d): ids stay, floats are
    computed.

    Traced. It is meant for another mesh of one family. For the steps of one motion call `march`:
    after a large motion, points have left their simplices and extrapolate. The patches' own faces,
    and translations of periodic pairs, are taken from the new points. Symmetry planes, surfaces
    given to `jm.Slide`, and rotations stay; known points that do not lie on them are refused.

    **Raises:** `ValueError` for another shape of `points`, and for a plan of a piece: prepare the
    new surface, and attach the piece to it. Also where nodes leave a symmetry plane or a given
    surface, and where periodic pairs match no more. Also where nodes have come within the radius of
    `CompactRBF` or `LocalCorrection`, so that the ids serve no more; in traced code the result is
    then NaN.
    """
    if plan.is_piece:
        raise ValueError(
            "this plan is of a piece: call prepare_surface with the new surface, and attach the "
            "new points to it."
        )
    points = base_points(plan, points)
    surface = plan.surface
    if surface.guide is not None:
        plan = with_boundary(
            plan, *_boundary_at(surface.tracks, surface.pairings, points[surface.nodes])
        )
    if (surface.guide is not None or len(plan.images.normals)) and is_readable((points, plan)):
        _check_boundary(plan, np.asarray(points))
    refit = refitted(plan, points)
    if is_readable((points, plan)):
        _check_places(refit, np.asarray(points))
    return refit


def with_boundary(plan: Plan, tracks: tuple[Track, ...], pairings: tuple[Pairing, ...]) -> Plan:
    guide = plan.surface.guide
    if guide is None:
        return plan
    parts = lambda guide: (guide.tracks, guide.pairings, guide.plan.surface.images)  # noqa: E731
    return eqx.tree_at(
        lambda plan: parts(plan.surface.guide),
        plan,
        (tracks, pairings, guide.plan.images.at(pairings)),
    )


@compiled
def _boundary_at(
    tracks: tuple[Track, ...], pairings: tuple[Pairing, ...], points: Own
) -> tuple[tuple[Track, ...], tuple[Pairing, ...]]:
    return tuple(track.at(points) for track in tracks), tuple(
        pairing.at(points) for pairing in pairings
    )


def _check_boundary(plan: Plan, points: np.ndarray) -> None:
    """Refuses points that leave a plan's planes and walls, and pairs that differ."""
    surface = np.asarray(plan.surface.nodes)
    tracks = plan.surface.tracks
    sliding = surface[join_ids(np.asarray(track.rows) for track in tracks)]
    for name, nodes, distance in deviations(plan, points):
        if name == "mismatch":
            gaps = np.minimum(spacing(points[nodes].astype(float)), extent_of(points))
            allowed = np.maximum(MISMATCH * gaps, 2 * tolerance(points))
        else:
            extent = np.ptp(points[nodes if name == "off_plane" else sliding], axis=0).max(
                initial=0.0
            )
            allowed = np.full(len(nodes), max(DEVIATION * extent, tolerance(points)))
        wrong = worst_first(distance, allowed)
        if wrong.size:
            raise MeshError(
                f"{len(wrong)} of {len(nodes)} {WORDS[name]} at the new base points, the worst is "
                f"node {{node}} at "
                f"({place_of(points[nodes[wrong[0]]])}), {distance.max():.3g} away (allowed "
                f"{allowed[wrong[0]]:.3g}). {ANEW}",
                nodes[wrong],
            )


@compiled
def _have_no_place(plan: Plan) -> tuple[Bool[Array, " n"], Bool[Array, ""]]:
    """Marks points whose weights are not finite; also checks whether the solve is finite."""
    placed, factors = (
        filter(eqx.is_inexact_array, jax.tree.leaves(tree))
        for tree in (without_tables(plan.volume.placed), plan.surface.factors)
    )
    lost = [~jnp.isfinite(leaf.reshape(len(leaf), -1)).all(axis=1) for leaf in placed]
    finite = [jnp.isfinite(leaf).all() for leaf in factors]
    return sum(lost, jnp.zeros(len(plan.volume.points), bool)), jnp.stack(
        [jnp.array(True), *finite]
    ).all()


def _check_places(plan: Plan, points: np.ndarray) -> None:
    """Refuses base points at which a plan's ids fail, if these are finite."""
    lost, is_solved = map(np.asarray, _have_no_place(plan))
    if (is_solved and not lost.any()) or not np.isfinite(points).all():
        return
    nodes = np.flatnonzero(lost[: len(points)])
    if not len(nodes):
        raise ValueError(
            "the plan's solve is not finite at the new base points: nodes of the surface "
            "coincide, or have come nearer to "
            f"each other than the plan searched. {ANEW}"
        )
    raise MeshError(
        f"{len(nodes)} of {len(points)} points have lost their place at the new base points, "
        f"first node {{node}} at "
        f"({place_of(points[nodes[0]])}): nodes of the surface have come nearer to them than the "
        "plan searched, or a simplex "
        f"of its graph has no volume. {ANEW}",
        nodes,
    )
