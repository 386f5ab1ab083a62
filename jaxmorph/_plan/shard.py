"""Lays the points of a plan over devices."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax

from .._host.package.arguments import checked
from .._methods.blocks import with_tables, without_tables
from .devices import AXIS, Layout, pad_rows
from .plan import Plan


@checked
def shard(plan: Plan, devices: Sequence[Any]) -> Plan:
    """Lays the points of a plan over devices. `deform` and all other calls stay as they were.

    Every device holds the whole surface and an equal share of the points; the last share is padded.
    A gradient with respect to `u` costs one all-reduce. The devices may belong to several processes
    (`jax.distributed`). Every process then calls `shard` with an equal plan.

    **Raises:** `ValueError` without devices, for a plan that is laid over devices already, and for
    a method that solves for all nodes at once.
    """
    if plan.layout is not None:
        raise ValueError("this plan is laid over devices already: shard the plan that `prepare` returned.")
    if plan.method.needs_cells:
        raise ValueError(
            f"{type(plan.method).__name__} solves for all nodes at once: its plan is not laid over devices."
        )
    layout = Layout.over(devices, len(plan.volume.points))
    volume = jax.tree.map(lambda leaf: pad_rows(leaf, layout), without_tables(plan.volume))
    placed = with_tables(volume.placed, len(plan.surface.points), layout.mesh.size)
    return dataclasses.replace(
        plan,
        method=layout.placed(plan.method),
        surface=layout.placed(plan.surface),
        volume=layout.placed(dataclasses.replace(volume, placed=placed), AXIS),
        layout=layout,
    )
