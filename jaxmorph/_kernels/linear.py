"""JAX operations with hand-written transposes: linear ones, and the product of a few rows."""

import functools
import operator
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Float

# `jax.custom_vjp` allows no forward derivatives, and `jax.custom_jvp` no hand-written transpose. A
# primitive has both, to any order, and batching. `jax.extend.core` and `jax.interpreters` are
# public, but change between versions of JAX.


def _changed(compute: Callable, primals: Sequence[Any], tangents: Sequence[Any]) -> Any:
    """The derivative of `compute` by all arguments that vary, but the first."""
    moving = [i for i, tangent in enumerate(tangents) if i and not isinstance(tangent, ad.Zero)]

    def of_moving(*values):
        return compute(
            *(dict(enumerate(primals)) | dict(zip(moving, values, strict=True))).values()
        )

    return jax.jvp(of_moving, [primals[i] for i in moving], [tangents[i] for i in moving])[1]


def _program(primitive: Primitive, compute: Callable) -> Callable:
    program = eqx.filter_jit(primitive.bind)  # platforms have lowerings of the primitive

    def evaluated(*arguments, **options):
        # Without `jit`, the program would call itself.
        return (compute if jax.config.values["jax_disable_jit"] else program)(*arguments, **options)

    return evaluated


def linear_primitive(name: str, compute: Callable, rows: Callable, turned: Callable) -> Primitive:
    """Makes a primitive of `compute(values, *others, **options)`, linear in `values` (b, c). Its
    transpose is the primitive with other arguments, `turned(*others, **options)`. Derivatives by
    `others` are those of `compute`. Under `vmap` of `values` alone the primitive gets more columns;
    if `others` vary, `compute` is mapped. Options are static keywords. The result has
    `rows(*others, **options)` rows. A lowering for one platform may be added.
    """
    primitive = Primitive(name)

    def jvp(primals, tangents, **options):
        changes = []
        if not isinstance(tangents[0], ad.Zero):
            changes.append(primitive.bind(tangents[0], *primals[1:], **options))
        if any(not isinstance(tangent, ad.Zero) for tangent in tangents[1:]):
            changes.append(_changed(functools.partial(compute, **options), primals, tangents))
        return primitive.bind(*primals, **options), sum(changes[1:], start=changes[0])

    def transposed(cotangent, values, *others, **options):
        nothing = [None] * len(others)
        if isinstance(cotangent, ad.Zero):
            return [ad.Zero(values.aval), *nothing]
        others, options = turned(*others, **options)
        return [primitive.bind(cotangent, *others, **options), *nothing]

    def batched(arguments, axes, **options):
        values, *others = arguments
        if any(axis is not None for axis in axes[1:]):
            return jax.vmap(functools.partial(compute, **options), tuple(axes))(*arguments), 0
        values = jnp.moveaxis(values, axes[0], 1)
        result = primitive.bind(values.reshape(len(values), -1), *others, **options)
        return result.reshape(len(result), *values.shape[1:]), 1

    def abstract(values, *others, **options):
        # JAX may keep account of arrays that vary between devices.
        varies = (
            {"vma": values.vma.union(*(other.vma for other in others))}
            if hasattr(values, "vma")
            else {}
        )
        return values.update(
            shape=(rows(*others, **options), values.shape[1]), weak_type=False, **varies
        )

    primitive.def_impl(_program(primitive, compute))
    primitive.def_abstract_eval(abstract)
    ad.primitive_jvps[primitive] = jvp
    ad.primitive_transposes[primitive] = transposed
    batching.primitive_batchers[primitive] = batched
    mlir.register_lowering(primitive, mlir.lower_fun(compute, multiple_results=False))
    return primitive


MOST_ROWS = 4  # most rows that one loop sums on a GPU; a displacement has two or three

# The transpose of a sum over a kernel's block contracts a few rows of a cotangent with the block's
# long axis. On a CPU it takes a quarter of the time as one matrix-vector product a row; for many
# rows, as under `vmap`, one product of matrices is faster.


def few_rows_times(rows: Float[Array, "k s"], block: Float[Array, "s c"]) -> Float[Array, "k c"]:
    """`rows @ block`, both of one dtype, with all derivatives and transformations."""
    return _product.bind(rows.T, block, axis=0).T


def few_rows_times_transposed(
    rows: Float[Array, "k c"], block: Float[Array, "s c"]
) -> Float[Array, "k s"]:
    """`rows @ block.T` as `few_rows_times`, without a transposed copy of the block."""
    return _product.bind(rows.T, block, axis=1).T


def _contract(rows, block, axis):
    dimensions = (((rows.ndim - 1,), (axis,)), ((), ()))
    return jax.lax.dot_general(
        rows, block, dimensions, precision="highest"
    )  # a GPU would round float32 to ten bits


def _few_rows(columns, block, *, axis):
    if axis == 0 or columns.shape[1] > MOST_ROWS:
        return _contract(columns.T, block, axis).T
    return jnp.stack([_contract(row, block, axis) for row in columns.T], axis=1)


def few_rows_in_one_loop(
    columns: Float[Array, "s k"], block: Float[Array, "..."], axis: int
) -> Float[Array, "c k"]:
    """The product as one reduction of all rows, for GPUs: the block is never in memory."""
    if columns.shape[1] > MOST_ROWS:
        return _contract(columns.T, block, axis).T
    terms = tuple(block * (row[:, None] if axis == 0 else row[None]) for row in columns.T)
    zeros = (jnp.zeros((), block.dtype),) * len(terms)
    return jnp.stack(
        jax.lax.reduce(terms, zeros, lambda *pair: tuple(map(operator.add, *pair)), (axis,)), axis=1
    )


_product = linear_primitive(
    "few_rows_times",
    _few_rows,
    rows=lambda block, axis: block.shape[1 - axis],
    turned=lambda block, axis: ((block,), {"axis": 1 - axis}),  # XLA would compute block.T anew
)
for _platform in ("cuda", "rocm"):
    mlir.register_lowering(
        _product, mlir.lower_fun(few_rows_in_one_loop, multiple_results=False), platform=_platform
    )
