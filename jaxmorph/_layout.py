"""How the rows of a volume lie over devices."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, PyTree

AXIS = "points"


@dataclasses.dataclass(frozen=True)
class Layout:
    """`count` points laid over the devices of `mesh` in equal shares, the last one padded."""

    mesh: Mesh
    count: int

    @staticmethod
    def over(devices: Sequence[Any], count: int) -> "Layout":
        if len(devices) == 0:
            raise ValueError("`devices` is empty: pass jax.devices(), or some of them.")
        return Layout(Mesh(np.array(devices), (AXIS,)), count)

    @property
    def padding(self) -> int:
        return -self.count % self.mesh.size

    def replicated(self, tree: PyTree) -> PyTree:
        return self._placed(tree, PartitionSpec())

    def divided(self, tree: PyTree) -> PyTree:
        return self._placed(tree, PartitionSpec(AXIS))

    def _placed(self, tree, spec):
        sharding = NamedSharding(self.mesh, spec)
        return jax.tree.map(lambda leaf: jax.device_put(np.asarray(leaf), sharding), tree)


def pad_rows(leaf: Array, layout: Layout) -> Array:
    """A leaf with its last row repeated until the devices share its rows evenly."""
    if not layout.padding:
        return leaf
    return jnp.concatenate([leaf, jnp.broadcast_to(leaf[-1:], (layout.padding, *leaf.shape[1:]))])


def over_points(
    layout: Layout | None, function: Callable[[PyTree, PyTree], PyTree], shared: PyTree, rows: PyTree
) -> PyTree:
    """`function(shared, rows)`, where each leaf of `rows` and of the result has one row a point.

    Over devices each works on its own rows. What they share is marked as varying before any loop, so that the sum of its
    gradient over devices is one all-reduce after the loop instead of one in each round.
    """
    if layout is None:
        return function(shared, rows)
    arrays, static = eqx.partition(shared, eqx.is_array)

    def local(arrays, rows):
        arrays = jax.tree.map(lambda leaf: jax.lax.pcast(leaf, AXIS, to="varying"), arrays)
        return function(eqx.combine(arrays, static), rows)

    specs = (PartitionSpec(), PartitionSpec(AXIS))
    return jax.shard_map(local, mesh=layout.mesh, in_specs=specs, out_specs=PartitionSpec(AXIS))(arrays, rows)
