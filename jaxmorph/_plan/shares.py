"""The transpose of `deform` by shares of the points, computed by all cores in turn."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Literal
from jaxtyping import Array, Float, PyTree

from .._kernels.compile import Constant, compiled
from .devices import rows_from
from .plan import Plan, Shared, VolumePart, extended, move, shared_by
from .slabs import on_all_cores, share_of
from .transposes import with_transposes


def pulled_back(plan: Plan, u: Any, cotangent: Float[Array, "n d"], number: int) -> Float[Array, "m d"]:
    """Pulls sensitivities back to the moving nodes, by `number` shares of the points."""
    plan = with_transposes(plan, number)
    shared, varying = _shared_by(plan, u, "traced")
    volume, constant = plan.volume, Constant((varying, number))
    places = [np.asarray(k, np.int32) for k in range(number)]
    parts = on_all_cores(lambda k: _share(shared, volume, cotangent, k, constant), places)
    return _put_together(plan, u, varying, parts)


def _shared(plan: Plan, u: Any) -> Shared:
    return shared_by(plan, extended(plan, u))


@compiled
def _shared_by(plan: Plan, u: Any, _: str) -> tuple[Shared, str]:
    """Computes what all points share, and which of its leaves depend on `u`: 1 or 0 for each.

    The string makes both static.
    """
    return _shared(plan, u), _varying(plan, u)


def _varying(plan: Plan, u: Any) -> str:
    # A leaf depends on u if an operation between the two does, of all that JAX traces. Sources and
    # scales of a field do not: derivatives in them cost more than all else, and nobody asks for
    # them.
    traced = jax.make_jaxpr(lambda u: jax.tree.leaves(_shared(plan, u)))(jnp.asarray(u, plan.points.dtype)).jaxpr
    varies = set(traced.invars)
    for step in traced.eqns:
        if any(not isinstance(value, Literal) and value in varies for value in step.invars):
            varies.update(step.outvars)
    return "".join(str(int(not isinstance(value, Literal) and value in varies)) for value in traced.outvars)


def _leaves(shared: Shared, varying: str) -> list[Array]:
    return [leaf for leaf, varies in zip(jax.tree.leaves(shared), varying, strict=True) if varies == "1"]


@compiled
def _share(shared: Shared, volume: VolumePart, cotangent: Array, k: Any, constant: Constant) -> list[Array]:
    """Pulls the cotangents of one share of the points back to what varies of what they share."""
    varying, number = constant.value
    count, size = len(cotangent), -(-len(cotangent) // number)
    start = jnp.minimum(k * size, count - size)  # the last share overlaps the one before it
    rows, at = share_of(volume, k, start, size, number), rows_from(start, shared.nodes, size)
    is_counted = start + jnp.arange(size) >= k * size
    cotangent = jnp.where(is_counted[:, None], jax.lax.dynamic_slice_in_dim(cotangent, start, size), 0)
    leaves, structure = jax.tree.flatten(shared)

    def moved(values: list[Array]) -> Float[Array, "s d"]:
        replaced, others = iter(values), zip(leaves, varying, strict=True)
        everything = [next(replaced) if varies == "1" else leaf for leaf, varies in others]
        return move(jax.tree.unflatten(structure, everything), rows, at)

    return jax.vjp(moved, _leaves(shared, varying))[1](cotangent)[0]


@compiled
def _put_together(plan: Plan, u: Any, varying: str, parts: PyTree) -> Float[Array, "m d"]:
    """Sums the shares, always in one order, and pulls the sum back to `u`."""
    total = functools.reduce(lambda first, other: jax.tree.map(jnp.add, first, other), parts)
    u = jnp.asarray(u, plan.points.dtype)
    return jax.vjp(lambda u: _leaves(_shared(plan, u), varying), u)[1](total)[0]
