"""Compilation of what users call: with vectors as wide as the processor has them, where nothing stands in the way."""

import functools
from collections.abc import Callable
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer  # pyright: ignore[reportAttributeAccessIssue]

WIDE = {"xla_cpu_prefer_vector_width": 512}
"""XLA by itself holds back to 256 bits, and a kernel sum then takes up to half as long again. No effect where there are fewer."""

Function = TypeVar("Function", bound=Callable)


def compiled(function: Function) -> Function:
    """`equinox.filter_jit(function)`, with `WIDE` vectors where it is called directly, with arrays on a CPU.

    Within another transformation it is an ordinary jitted function: JAX takes options for the outermost one only.
    """
    plain = eqx.filter_jit(function)
    wide = eqx.filter_jit(function, compiler_options=WIDE)  # pyright: ignore[reportCallIssue] -- passed on to `jax.jit`

    @functools.wraps(function)
    def call(*arguments, **keywords):
        return (wide if _direct((arguments, keywords)) else plain)(*arguments, **keywords)

    return call  # pyright: ignore[reportReturnType]


def _direct(arguments) -> bool:
    arrays = [leaf for leaf in jax.tree.leaves(arguments) if isinstance(leaf, jax.Array)]
    if any(isinstance(array, Tracer) for array in arrays):
        return False
    on_cpu = all(device.platform == "cpu" for array in arrays for device in array.sharding.device_set)
    return on_cpu and not isinstance(jnp.zeros(()), Tracer)  # a tracer is made even of a constant under `jit`
