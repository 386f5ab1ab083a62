"""Calls of NumPy and SciPy from traced code, which never wait for XLA."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import ShapedArray  # pyright: ignore[reportAttributeAccessIssue]
from jax.extend.core import Primitive
from jax.interpreters import batching, mlir
from jaxtyping import Array

# `jax.pure_callback` makes arrays of JAX of its arguments. XLA copies those above 100 KiB on a pool of a thread for each core, that
# also waits for programs: on one core the copy waits for the program that waits for it. This primitive hands on what XLA gives,
# complete NumPy arrays. So does `jax.experimental.buffer_callback`, but not on a GPU, and on each of several devices anew.
# `jax.interpreters.mlir` is public, but may change between versions of JAX.


def host_call(function: Callable[..., Any], result: jax.ShapeDtypeStruct, *arguments: Any) -> Array:
    """Calls a function of NumPy arrays on the host, for an array of the shape and dtype of `result`. Traced.

    The function is pure and calls nothing of JAX, which may wait. Under `vmap` it takes one element after another. It has no
    derivative: an implicit one, such as that of `jax.lax.custom_linear_solve`, is the caller's.
    """
    return _call_p.bind(*arguments, function=function, shape=result.shape, dtype=np.dtype(result.dtype), batch=())


def _called(*arguments: Any, function: Callable, shape: tuple, dtype: np.dtype, batch: tuple) -> np.ndarray:
    """Calls the function for each element of a batch, whose axes come first: in an argument without them their sizes are 1."""
    results = np.empty((*batch, *shape), dtype)
    arrays = [np.asarray(argument) for argument in arguments]
    for place in np.ndindex(*batch):
        rows = [tuple(i if size > 1 else 0 for i, size in zip(place, array.shape, strict=False)) for array in arrays]
        results[place] = function(*(array[row] for array, row in zip(arrays, rows, strict=True)))
    return results


_call_p = Primitive("jaxmorph_host_call")
_call_p.def_impl(lambda *arguments, **params: jnp.asarray(_called(*arguments, **params)))


@_call_p.def_abstract_eval
def _(*arguments, function, shape, dtype, batch):
    return ShapedArray((*batch, *shape), dtype)


def _lowered(context: Any, *operands: Any, **params: Any) -> Sequence[Any]:
    outputs, _, _ = mlir.emit_python_callback(
        context,
        lambda *arrays: (_called(*arrays, **params),),
        None,
        operands,
        context.avals_in,
        context.avals_out,
        has_side_effect=False,
        sharding=_sharding(context),
    )
    return outputs


def _sharding(context: Any) -> Any:
    """Lays out a call in a program for several devices as JAX does its own callbacks: one device makes it."""
    layout = context.module_context.axis_context
    if isinstance(layout, mlir.ShardingContext) and layout.num_devices == 1:
        return None
    try:  # a private name, for such programs alone
        from jax._src.callback import _callback_op_sharding
    except ImportError:  # XLA then lays it out itself: each device makes the call
        return None
    return _callback_op_sharding(layout, None, context.avals_out)


def _batched(arguments: Any, axes: Any, *, batch: tuple, **params: Any) -> tuple[Array, int]:
    size = next(each.shape[axis] for each, axis in zip(arguments, axes, strict=True) if axis is not None)
    rows = [
        jnp.expand_dims(each, 0) if axis is None else jnp.moveaxis(each, axis, 0)
        for each, axis in zip(arguments, axes, strict=True)
    ]
    return _call_p.bind(*rows, batch=(size, *batch), **params), 0


mlir.register_lowering(_call_p, _lowered)
batching.primitive_batchers[_call_p] = _batched
