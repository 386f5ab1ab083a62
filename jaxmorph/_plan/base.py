"""A plan's solve, computed anew on other base coordinates."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, PyTree, Real

from .._kernels.compile import compiled
from .._methods.base import carry as carry_factors
from .._methods.blocks import carry_points, place_points, with_tables_of
from .devices import over_points, pad_rows
from .plan import Plan, VolumePart


@compiled
def refitted(plan: Plan, points: Real[ArrayLike, "n d"] | Sequence[Any]) -> Plan:
    """Computes a plan anew on other base coordinates, with its own planes, walls and transforms."""
    return _fitted(plan, points)


@compiled
def carry(
    plan: Plan, points: Real[ArrayLike, "n d"] | Sequence[Any], surface: Float[Array, "o d"] | None = None
) -> Plan:
    """Moves a plan to the mesh of one of its own steps; a piece needs the whole moved surface.

    The solve is made anew, and every point keeps its place in the graph. A layer over a wall is
    laid anew.
    """
    return _fitted(plan, points, surface, carried=True)


def _fitted(plan: Plan, points: Any, surface: Float[Array, "o d"] | None = None, *, carried: bool = False) -> Plan:
    method, old, whole = plan.method, plan.surface, base_points(plan, points)
    own = whole[old.nodes] if surface is None else surface
    rows = old.images.points(own)
    guide = old.guide
    if guide is not None:
        guide = eqx.tree_at(lambda guide: guide.plan, guide, _fitted(guide.plan, own, carried=carried))
    ids, before = old.ids, old.factors
    factors = carry_factors(method, ids, before, rows, whole) if carried else method.fit(ids, rows, whole)

    def place(shared: PyTree, volume: VolumePart) -> PyTree:
        points = volume.seen(shared[1][0])
        if carried:
            return carry_points(method, (points, volume.ids, volume.placed), *shared)
        placed = place_points(method, points, volume.ids, *shared)
        return placed if volume.placed is None else with_tables_of(volume.placed, placed)

    at = whole if plan.layout is None else pad_rows(whole, plan.layout)
    volume = dataclasses.replace(plan.volume, points=at)
    volume = dataclasses.replace(volume, placed=over_points(plan.layout, place, (factors, rows), volume))
    surface_part = dataclasses.replace(old, points=rows, factors=factors, guide=guide)
    return dataclasses.replace(plan, surface=surface_part, volume=volume, carried=carried)


def base_points(plan: Plan, points: Any) -> Float[Array, "n d"]:
    """Returns base coordinates in a plan's precision. Raises `ValueError` for another shape."""
    points = jnp.asarray(points, plan.volume.points.dtype)
    if points.shape != plan.points.shape:
        raise ValueError(f"`points` has shape {points.shape}; this plan was made for {plan.points.shape}.")
    return points
