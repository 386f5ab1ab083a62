"""Sums of functions on NVIDIA's GPUs, as one kernel that writes only the sums to memory.

XLA writes blocks of function values to memory, or reaches a tenth of the card's speed. Pallas, a
part of JAX, keeps the sums in registers.
"""

import math
import re
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .compile import as_for_cpu

BLOCK, WARPS = (
    512,
    2,
)  # points of a program of the kernel, and its groups of 32 threads: eight points a thread
FEW = 2**19  # points below which sources are divided too: blocks of points alone do not fill a card
FEW_BLOCK = 64
FEW_WARPS = 1  # `BLOCK` and `WARPS` for fewer points

PROGRAMS, LEAST_SHARE = (
    2**17,
    256,
)  # programs that keep a card busy to the end, least sources of a program
# major compute capability below which Triton, by which Pallas compiles, has no kernels
LEAST_CAPABILITY = 8

ELEMENTWISE = {
    *("abs", "add", "cos", "div", "exp", "exp2", "integer_pow", "log", "log1p", "logistic"),
    *("max", "min", "mul", "neg", "pow"),
    *("rsqrt", "sign", "sin", "sqrt", "square", "sub", "tanh"),
    *("and", "eq", "ge", "gt", "le", "lt", "ne", "not", "or", "select_n"),
    *(
        "bitcast_convert_type",
        "broadcast_in_dim",
        "convert_element_type",
        "shift_left",
        "shift_right_logical",
    ),
}
"""Operations of a kernel, by names of JAX, which may change: other functions run as loops."""


def has_kernels() -> bool:
    if jax.default_backend() != "gpu":
        return False
    major = re.match(
        r"(\d+)\.\d+$", str(getattr(jax.devices()[0], "compute_capability", ""))
    )  # of AMD: gfx90a
    return major is not None and int(major[1]) >= LEAST_CAPABILITY


CALLS = {
    "jit": "jaxpr",
    "pjit": "jaxpr",
    "custom_jvp_call": "call_jaxpr",
    "closed_call": "call_jaxpr",
}
"""Operations that hold a jaxpr, and its parameter, by names of JAX, which may change."""


def is_elementwise(phi: Callable, dtype: Any) -> bool:
    with as_for_cpu():
        closed = jax.make_jaxpr(phi)(jax.ShapeDtypeStruct((BLOCK,), dtype))
    return not any(jnp.ndim(const) for const in closed.consts) and _allowed(closed.jaxpr)


def _allowed(jaxpr: Any) -> bool:
    calls = [(each.primitive.name, each.params) for each in jaxpr.eqns]
    return all(
        _allowed(held[CALLS[name]].jaxpr) if name in CALLS else name in ELEMENTWISE
        for name, held in calls
    )


def fused_sum(
    phi: Callable,
    weights: Float[Array, "s k"],
    sources: Float[Array, "s d"],
    points: Float[Array, "c d"],
    constants: Sequence[Float[Array, ""]] = (),
) -> Float[Array, "c k"]:
    """Returns `phi(squared distances of points and sources, *constants) @ weights`, for CUDA. A
    program of the kernel has a block of points, and, if there are few points, a part of the
    sources. All blocks have one size: the last block overlaps the block before it. A thread keeps
    the sums of its points in registers, and the loop runs over the sources.
    """
    from jax.experimental import pallas as pl
    from jax.experimental.pallas import triton

    (count, rows), (n, dimension) = weights.shape, points.shape
    block, warps, blocks, share = _layout(n, count)
    parts = -(-count // share)
    packed = jnp.asarray([*constants, 0.0], points.dtype)  # Pallas takes no empty array

    def kernel(weights_ref, sources_ref, points_ref, constants_ref, sums_ref):
        here = pl.ds(jnp.minimum(pl.program_id(0) * block, n - block), block)
        x = [points_ref[here, axis] for axis in range(dimension)]
        numbers = [constants_ref[i] for i in range(len(constants))]

        def add(j, sums):
            value = phi(
                sum((x[axis] - sources_ref[j, axis]) ** 2 for axis in range(dimension)), *numbers
            )
            return tuple(total + weights_ref[j, row] * value for row, total in enumerate(sums))

        first = pl.program_id(1) * share
        last = count if parts == 1 else jnp.minimum(first + share, count)
        with as_for_cpu():
            sums = jax.lax.fori_loop(first, last, add, (jnp.zeros(block, points.dtype),) * rows)
        for row, total in enumerate(sums):
            sums_ref[pl.program_id(1), here, row] = total

    sums = pl.pallas_call(
        kernel,
        out_shape=jax.ShapeDtypeStruct((parts, n, rows), points.dtype),
        grid=(blocks, parts),
        compiler_params=triton.CompilerParams(num_warps=warps),
    )(weights, sources, points, packed)
    return sums[0] if parts == 1 else sums.sum(axis=0)


def _layout(n: int, count: int) -> tuple[int, int, int, int]:
    """For `n` points and `count` sources: block, warps, count of blocks, sources of a part."""
    block, warps = (
        (BLOCK, WARPS) if n >= FEW else (min(FEW_BLOCK, 1 << int(math.log2(n))), FEW_WARPS)
    )
    blocks = -(-n // block)
    return (
        block,
        warps,
        blocks,
        count if n >= FEW else max(LEAST_SHARE, -(-count * blocks // PROGRAMS)),
    )
