"""Tables of transposes of a plan's sparse operators, made when a derivative first needs them."""

from typing import Any

import equinox as eqx
import jax

from .._kernels.values import is_known, is_readable
from .._methods.blocks import is_rows, with_tables, without_tables


def with_transposes(plan: Any, parts: int = 1) -> Any:
    """Adds the tables, for so many shares of points, to a plan of known arrays, and to its guide.

    They are made once for a plan.

    A plan that is traced, or laid over devices, stays as it is: its transpose scatters, or has
    tables.
    """
    volume, guide = getattr(plan, "volume", None), getattr(getattr(plan, "surface", None), "guide", None)
    if volume is None or plan.layout is not None or not is_readable(plan) or (parts == 1 and not _lacks_tables(plan)):
        return plan
    placed = volume.placed if parts == 1 else without_tables(volume.placed)
    placed = with_tables(placed, len(plan.surface.points), parts)
    plan = eqx.tree_at(
        lambda plan: plan.volume.placed, plan, placed, is_leaf=lambda leaf: leaf is None or is_rows(leaf)
    )
    if guide is not None:
        plan = eqx.tree_at(lambda plan: plan.surface.guide.plan, plan, with_transposes(guide.plan))
    return plan


def transposable(plan: Any, *arguments: Any) -> Any:
    """Adds the tables where another argument is traced: it may be differentiated."""
    return plan if is_known(arguments) else with_transposes(plan)


def _lacks_tables(plan: Any) -> bool:
    rows = filter(is_rows, jax.tree.leaves(plan, is_leaf=is_rows))
    return any(operator.table is None for operator in rows)
