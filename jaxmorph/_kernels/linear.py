"""JAX operations linear in their first argument; their transposes are such operations too."""

import functools
import inspect
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

# `jax.custom_vjp` allows no forward derivatives, and `jax.custom_jvp` no hand-written transpose. A
# primitive has both, to any order, and batching. `jax.extend.core` and `jax.interpreters` are
# public, but change between versions of JAX.


def _changed(compute: Callable, primals: Sequence[Any], tangents: Sequence[Any]) -> Any:
    """Computes the derivative of `compute` by all arguments that vary, but the first."""
    moving = [i for i, tangent in enumerate(tangents) if i and not isinstance(tangent, ad.Zero)]

    def of_moving(*values):
        arguments = dict(enumerate(primals)) | dict(zip(moving, values, strict=True))
        return compute(*arguments.values())

    return jax.jvp(of_moving, [primals[i] for i in moving], [tangents[i] for i in moving])[1]


def _program(primitive: Primitive, compute: Callable) -> Callable:
    """Makes the function that a direct call runs: the compiled primitive."""
    parameters = inspect.signature(compute).parameters.values()
    static = tuple(option.name for option in parameters if option.kind is option.KEYWORD_ONLY)
    program = jax.jit(primitive.bind, static_argnames=static)  # platforms have lowerings of the primitive

    def evaluated(*arguments, **options):
        # Without `jit`, the program would call itself.
        return (compute if jax.config.values["jax_disable_jit"] else program)(*arguments, **options)

    return evaluated


def linear_primitive(name: str, compute: Callable, rows: Callable, turned: Callable) -> Primitive:
    """Makes a primitive of `compute(values, *others, **options)`, linear in `values` (b, c).

    Its transpose is the primitive with other arguments. Derivatives by `others` are the derivatives
    of `compute`. Under `vmap` of `values` alone the primitive gets more columns; if `others` vary,
    `compute` is mapped.

    **Arguments:**

    - `name`: the name in a jaxpr.
    - `compute`: traced; its options are keywords without defaults, and are static.
    - `rows`: counts the rows of the result, `rows(*others, **options)`.
    - `turned`: returns `others` and `options` of the transpose, `turned(*others, **options)`.

    **Returns:** the primitive, to which a lowering for one platform may be added.
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
        varies = {"vma": values.vma.union(*(other.vma for other in others))} if hasattr(values, "vma") else {}
        return values.update(shape=(rows(*others, **options), values.shape[1]), weak_type=False, **varies)

    primitive.def_impl(_program(primitive, compute))
    primitive.def_abstract_eval(abstract)
    ad.primitive_jvps[primitive] = jvp
    ad.primitive_transposes[primitive] = transposed
    batching.primitive_batchers[primitive] = batched
    mlir.register_lowering(primitive, mlir.lower_fun(compute, multiple_results=False))
    return primitive
