"""The product that ends a kernel sum: a few rows of weights times a large block of the kernel.

The transpose contracts a few rows of a cotangent with the block's long axis. On a CPU it takes a
quarter of the time as one matrix-vector product a row. With the rows of many displacements
(`vmap`), one product of matrices is faster. Only a primitive can distinguish the two cases and stay
bilinear.
"""

import functools

import jax
import jax.numpy as jnp
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Float

MOST_ROWS = 4
"""Most rows that one loop sums on a GPU; a displacement has two or three."""


def few_rows_times(rows: Float[Array, "k s"], block: Float[Array, "s c"]) -> Float[Array, "k c"]:
    """Computes `rows @ block`, both of one dtype, with all derivatives and transformations."""
    return _product.bind(rows, block, axis=0)


def few_rows_times_transposed(rows: Float[Array, "k c"], block: Float[Array, "s c"]) -> Float[Array, "k s"]:
    """Computes `rows @ block.T` as `few_rows_times`, without a transposed copy of the block."""
    return _product.bind(rows, block, axis=1)


def _contract(rows, block, axis):
    """Sums the product over the last axis of `rows` and over `axis` of the matrix `block`."""
    dimensions = (((rows.ndim - 1,), (axis,)), ((), ()))
    return jax.lax.dot_general(rows, block, dimensions, precision="highest")  # a GPU would round float32 to ten bits


def _few_rows(rows, block, *, axis):
    if axis == 0:
        return _contract(rows, block, axis)
    return jnp.stack([_contract(row, block, axis) for row in rows])


def few_rows_in_one_loop(rows: Float[Array, "k s"], block: Float[Array, "..."], axis: int) -> Float[Array, "k c"]:
    """Computes the product of `_few_rows` as one reduction of all rows, for GPUs.

    XLA computes an element of the block where it is summed, once for all rows. A library's product
    of matrices would need the block in memory.
    """
    if len(rows) > MOST_ROWS:
        return _contract(rows, block, axis)
    terms = tuple(block * (row[:, None] if axis == 0 else row[None]) for row in rows)
    zeros = (jnp.zeros((), block.dtype),) * len(terms)

    def add(a, b):
        return tuple(x + y for x, y in zip(a, b, strict=True))

    return jnp.stack(jax.lax.reduce(terms, zeros, add, (axis,)))


def _abstract(rows, block, *, axis):
    varies = {"vma": rows.vma | block.vma} if hasattr(rows, "vma") else {}
    return rows.update(shape=(rows.shape[0], block.shape[1 - axis]), **varies)


def _batched(arguments, axes, *, axis):
    rows, block = arguments
    if axes[1] is None:
        return _contract(jnp.moveaxis(rows, axes[0], 0), block, axis), 0
    return jax.vmap(functools.partial(_few_rows, axis=axis), axes)(rows, block), 0


def _transposed_in_rows(cotangent, rows, block, *, axis):
    return _product.bind(cotangent, block, axis=1 - axis)  # XLA would compute block.T anew


def _transposed_in_block(cotangent, rows, block, *, axis):
    left, right = (rows, cotangent) if axis == 0 else (cotangent, rows)
    return jnp.matmul(left.T, right, precision="highest")


_product = Primitive("few_rows_times")
_product.def_impl(jax.jit(_few_rows, static_argnames="axis"))
_product.def_abstract_eval(_abstract)
ad.defbilinear(_product, _transposed_in_rows, _transposed_in_block)
batching.primitive_batchers[_product] = _batched
mlir.register_lowering(_product, mlir.lower_fun(_few_rows, multiple_results=False))
for _platform in ("cuda", "rocm"):
    mlir.register_lowering(_product, mlir.lower_fun(few_rows_in_one_loop, multiple_results=False), platform=_platform)
