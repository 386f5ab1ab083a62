"""The layout of points over devices."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Int, PyTree

from .._host.package.arguments import shown

AXIS = "points"


@dataclasses.dataclass(frozen=True)
class Layout:
    """The shares of `count` points on the devices of `mesh`: equal, the last share padded."""

    mesh: Mesh
    count: int

    @staticmethod
    def over(devices: Sequence[Any], count: int) -> "Layout":
        if len(devices) == 0:
            raise ValueError("`devices` is empty: pass jax.devices(), or some of them.")
        for device in devices:
            if not isinstance(device, jax.Device):
                raise ValueError(
                    f"`devices` holds {shown(device)}, which is no device of JAX: pass "
                    "jax.devices()."
                )
            if list(devices).count(device) > 1:
                raise ValueError(
                    f"`devices` has {device} more than once, among {len(devices)}: pass each "
                    "device once."
                )
        return Layout(Mesh(np.array(devices), (AXIS,)), count)

    def placed(self, tree: PyTree, *axes: str) -> PyTree:
        sharding = NamedSharding(self.mesh, PartitionSpec(*axes))
        return jax.tree.map(lambda leaf: jax.device_put(np.asarray(leaf), sharding), tree)


def pad_rows(leaf: Array, layout: Layout | None) -> Array:
    """Repeats the last row of a leaf until all devices have an equal number of rows."""
    padding = 0 if layout is None else -layout.count % layout.mesh.size
    return (
        jnp.concatenate([leaf, jnp.broadcast_to(leaf[-1:], (padding, *leaf.shape[1:]))])
        if padding
        else leaf
    )


def rows_from(start: Int[Array, ""], ids: Int[Array, " k"], count: int) -> Int[Array, " k"]:
    """Finds `ids` among the `count` rows from `start` on; absent ones get a row from `count` on."""
    here = ids - start
    return jnp.where((here >= 0) & (here < count), here, count + jnp.arange(len(ids)))


def over_points(
    layout: Layout | None,
    function: Callable[[PyTree, PyTree], PyTree],
    shared: PyTree,
    rows: PyTree,
) -> PyTree:
    """Evaluates `function(shared, rows)`; leaves of `rows` and the result have one row a point.

    Every device works on its own rows. JAX's tracking of what varies (`check_vma`) is off. So one
    all-reduce at the end sums the gradient of `shared`, not one in every round of an inner loop.
    """
    if layout is None:
        return function(shared, rows)
    arrays, static = eqx.partition(shared, eqx.is_array)

    def local(arrays, rows):
        return function(eqx.combine(arrays, static), rows)

    specs = (PartitionSpec(), PartitionSpec(AXIS))
    mapped = jax.shard_map(
        local, mesh=layout.mesh, in_specs=specs, out_specs=PartitionSpec(AXIS), check_vma=False
    )
    return mapped(arrays, rows)
