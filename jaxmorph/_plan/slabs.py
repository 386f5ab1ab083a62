"""A direct call on a CPU in slabs of points, one for each core, that run beside each other.

XLA splits the loop over a program's blocks among threads operation by operation, and they wait for each other at each. Programs
of one slab each have nothing to wait for: JAX runs programs that it has begun on threads of its own.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._host.package.cores import cores
from .._kernels.compile import compiled, is_direct

LEAST = 2**15
"""Points of a slab below which a program of its own costs more than it gains."""

STEP = 1536
"""Slabs begin at multiples of this, as blocks of points do: results in a block depend on its size, by a last bit."""


def slabs(count: int, *arguments: Any) -> list[tuple[np.ndarray, int]]:
    """Divides points into slabs: the first row of each, and how many rows; none where calls are traced or points few.

    All have one size, and so one program; some overlap. Results do not depend on the number of slabs, one included.
    """
    if count < 2 * LEAST or not is_direct(arguments):
        return []
    # Every slab ends with the points that are left over when all are divided into steps, as the last slab has to. What a slab
    # overlaps its successor by is cut off.
    rest, number = count % STEP, min(cores(), count // LEAST)
    stride = -(-(count - rest) // (number * STEP)) * STEP
    size = stride + rest
    return [(np.asarray(start, np.int32), size) for start in [*range(0, count - size, stride), count - size]]


def joined(parts: tuple[Float[Array, "s d"], ...], count: int) -> Float[Array, "n d"]:
    """Joins the results of slabs of `count` points."""
    return parts[0] if len(parts) == 1 else _joined(parts, count)


@compiled
def _joined(parts: tuple[Float[Array, "s d"], ...], count: int) -> Float[Array, "n d"]:
    *others, last = parts
    stride, before = len(last) - count % STEP, count - len(last)
    return jnp.concatenate([*(part[: min(stride, before - k * stride)] for k, part in enumerate(others)), last])
