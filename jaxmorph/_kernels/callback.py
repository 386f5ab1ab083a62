"""Calls of NumPy and SciPy from traced code that never wait for XLA."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import ShapedArray  # pyright: ignore[reportAttributeAccessIssue]
from jax.extend.core import Primitive
from jax.interpreters import batching, mlir
from jaxtyping import Array

# `jax.pure_callback` makes JAX arrays of its arguments, which XLA copies on a thread pool that also
# waits for programs: on one core, a deadlock. This primitive passes on NumPy arrays.
# `jax.experimental.buffer_callback` does so too, but not on a GPU, and once a device.


def host_call(function: Callable[..., Any], result: jax.ShapeDtypeStruct, *arguments: Any) -> Array:
    """Calls a pure function of NumPy arrays on the host, for an array shaped as `result`. Traced.
    It must not call JAX. Under `vmap` it is called for each element. It has no derivative:
    `jax.lax.custom_linear_solve`, for example, gives it one.
    """
    return _call_p.bind(
        *arguments, function=function, shape=result.shape, dtype=np.dtype(result.dtype), batch=()
    )


def _call_each(
    *arguments: Any, function: Callable, shape: tuple, dtype: np.dtype, batch: tuple
) -> np.ndarray:
    """Calls the function for a batch, whose axes come first, of size 1 where nothing varies."""
    results = np.empty((*batch, *shape), dtype)
    arrays = [np.asarray(argument) for argument in arguments]
    arrays = [np.broadcast_to(array, (*batch, *array.shape[len(batch) :])) for array in arrays]
    for place in np.ndindex(*batch):
        results[place] = function(*(array[place] for array in arrays))
    return results


_call_p = Primitive("jaxmorph_host_call")
_call_p.def_impl(lambda *arguments, **params: jax.device_put(_call_each(*arguments, **params)))


@_call_p.def_abstract_eval
def _result_of(*arguments, function, shape, dtype, batch):
    return ShapedArray((*batch, *shape), dtype)


def _lowered(context: Any, *operands: Any, **params: Any) -> Sequence[Any]:
    def call(*arrays):
        return (_call_each(*arrays, **params),)

    avals = context.avals_in, context.avals_out
    outputs, _, _ = mlir.emit_python_callback(
        context, call, None, operands, *avals, has_side_effect=False, sharding=_sharding(context)
    )
    return outputs


def _sharding(context: Any) -> Any:
    layout = context.module_context.axis_context
    if isinstance(layout, mlir.ShardingContext) and layout.num_devices == 1:
        return None
    try:  # a private name of JAX, only for programs on several devices
        from jax._src.callback import _callback_op_sharding
    except ImportError:  # XLA then decides: all devices make the call
        return None
    return _callback_op_sharding(layout, None, context.avals_out)


def _batched(arguments: Any, axes: Any, *, batch: tuple, **params: Any) -> tuple[Array, int]:
    pairs = list(zip(arguments, axes, strict=True))
    size = next(array.shape[axis] for array, axis in pairs if axis is not None)
    rows = [
        jnp.expand_dims(array, 0) if axis is None else jnp.moveaxis(array, axis, 0)
        for array, axis in pairs
    ]
    return _call_p.bind(*rows, batch=(size, *batch), **params), 0


mlir.register_lowering(_call_p, _lowered)
batching.primitive_batchers[_call_p] = _batched
