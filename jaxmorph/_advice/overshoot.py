"""Overshoot: the motion of nodes off the surface, relative to that of the surface."""

import numpy as np
from jaxtyping import Float

from .._host.package.rounding import Tree
from .._plan.deform import deform
from .._plan.plan import Plan

RESTS = 1e-3
"""Share of the largest displacement below which a part of the surface rests."""


def overshoot(
    plan: Plan, u: Float[np.ndarray, "m d"], moved: Float[np.ndarray, "n d"] | None = None
) -> tuple[float, float]:
    """Compares the largest motion off the surface with that of the surface.

    The second number is for nodes behind a part that rests.

    A node lies behind a part that rests if three conditions hold. The nearest node of the moving
    surface rests. The part that moves lies on the other side of this node, as the upper side of an
    airfoil does for nodes below it. And the node is no farther away than the surface is long.

    `moved` is what `deform` returns, where it is known.
    """
    points, moving = np.asarray(plan.points), np.asarray(plan.moving)
    size = np.linalg.norm(u, axis=1)
    is_inner = np.ones(len(points), dtype=bool)
    is_inner[moving] = is_inner[np.asarray(plan.fixed)] = False
    inner = np.flatnonzero(is_inner)
    if not size.max() or not inner.size:
        return 0.0, 0.0
    moved = np.asarray(deform(plan, u)) if moved is None else moved
    share = np.linalg.norm((moved - points)[inner], axis=1) / size.max()
    largest, base, active = float(share.max()), points[moving], np.flatnonzero(size > size.max() / 2)
    extent = np.ptp(base, axis=0).max()
    is_near = ((points[inner] > base.min(axis=0) - extent) & (points[inner] < base.max(axis=0) + extent)).all(axis=1)
    inner, share = inner[is_near & (share > RESTS)], share[is_near & (share > RESTS)]
    if not inner.size:
        return largest, 0.0
    nearest = np.asarray(Tree(base).query(points[inner])[1])
    towards = base[active[np.asarray(Tree(base[active]).query(base)[1])]] - base
    away = points[inner] - base[nearest]
    towards = towards[nearest]
    product, lengths = np.sum(away * towards, axis=1), (np.linalg.norm(away, axis=1), np.linalg.norm(towards, axis=1))
    is_opposite = product < -lengths[0] * lengths[1] / 2
    behind = (size[nearest] <= RESTS * size.max()) & is_opposite & (lengths[0] < extent)
    return largest, float(share[behind].max(initial=0.0))
