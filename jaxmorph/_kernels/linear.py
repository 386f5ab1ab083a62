"""JAX operations with hand-written transposes: linear ones, and the product of a few rows."""

import dataclasses
import functools
import operator
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Float

# `jax.custom_vjp` allows no forward derivatives, and `jax.custom_jvp` no hand-written transpose. A
# primitive has both, to any order, and batching. `jax.extend.core` and `jax.interpreters` are
# public, but change between versions of JAX.


def linear_primitive(name: str, compute: Callable, rows: Callable, turned: Callable) -> Primitive:
    """Makes a primitive of `compute(values, *others, **options)`, linear in `values` (b, c). Its
    transpose is the primitive with other arguments, `turned(*others, **options)`. Derivatives by
    `others` are those of `compute`. Under `vmap` of `values` alone the primitive gets more columns;
    if `others` vary, `compute` is mapped. Options are static keywords. The result has
    `rows(*others, **options)` rows. A lowering for one platform may be added.
    """
    primitive = Primitive(name)
    rules = _Rules(primitive, compute, rows, turned)
    primitive.def_impl(rules.evaluate)
    primitive.def_abstract_eval(rules.shape)
    ad.primitive_jvps[primitive] = rules.push
    ad.primitive_transposes[primitive] = rules.transpose
    batching.primitive_batchers[primitive] = rules.batch
    mlir.register_lowering(primitive, mlir.lower_fun(compute, multiple_results=False))
    return primitive


@dataclasses.dataclass(eq=False)
class _Rules:
    """How JAX evaluates, differentiates and maps a primitive of `linear_primitive`."""

    primitive: Primitive
    compute: Callable
    rows: Callable
    turned: Callable

    @functools.cached_property
    def _program(self) -> Callable:
        return eqx.filter_jit(self.primitive.bind)  # platforms have lowerings of the primitive

    def evaluate(self, *arguments, **options):
        # Without `jit`, the program would call itself.
        without_jit = jax.config.values["jax_disable_jit"]
        return (self.compute if without_jit else self._program)(*arguments, **options)

    def shape(self, values, *others, **options):
        # JAX may keep account of arrays that vary between devices.
        varies = {}
        if hasattr(values, "vma"):
            varies["vma"] = values.vma.union(*(other.vma for other in others))
        shape = (self.rows(*others, **options), values.shape[1])
        return values.update(shape=shape, weak_type=False, **varies)

    def push(self, primals, tangents, **options):
        """The value, and the derivative by all arguments that vary."""
        varies = [not isinstance(tangent, ad.Zero) for tangent in tangents]
        changes = []
        if varies[0]:
            changes.append(self.primitive.bind(tangents[0], *primals[1:], **options))
        if any(varies[1:]):
            moving = [i for i, moves in enumerate(varies) if i and moves]

            def of_moving(*values):
                known = dict(enumerate(primals)) | dict(zip(moving, values, strict=True))
                return self.compute(*known.values(), **options)

            chosen = ([primals[i] for i in moving], [tangents[i] for i in moving])
            changes.append(jax.jvp(of_moving, *chosen)[1])
        return self.primitive.bind(*primals, **options), sum(changes[1:], start=changes[0])

    def transpose(self, cotangent, values, *others, **options):
        nothing = [None] * len(others)
        if isinstance(cotangent, ad.Zero):
            return [ad.Zero(values.aval), *nothing]
        others, options = self.turned(*others, **options)
        return [self.primitive.bind(cotangent, *others, **options), *nothing]

    def batch(self, arguments, axes, **options):
        values, *others = arguments
        if any(axis is not None for axis in axes[1:]):
            compute = functools.partial(self.compute, **options)
            return jax.vmap(compute, tuple(axes))(*arguments), 0
        values = jnp.moveaxis(values, axes[0], 1)
        result = self.primitive.bind(values.reshape(len(values), -1), *others, **options)
        return result.reshape(len(result), *values.shape[1:]), 1


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
