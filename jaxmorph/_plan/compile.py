"""Compilation of what users call: with vectors as wide as the processor has them, where nothing stands in the way."""

import functools
from collections.abc import Callable
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._kernels.values import is_known

WIDE = {"xla_cpu_prefer_vector_width": 512}
"""XLA by itself holds back to 256 bits, and a kernel sum then takes up to half as long again. No effect where there are fewer."""

Function = TypeVar("Function", bound=Callable)


def compiled(function: Function) -> Function:
    """Compiles a function as `equinox.filter_jit` does, with `WIDE` vectors for direct calls with arrays on a CPU.

    Within another transformation it is an ordinary jitted function: JAX takes options for the outermost one only. Lists become
    arrays: as they are, each of their numbers would be a static argument, and other numbers another compilation.
    """
    plain, wide = eqx.filter_jit(function), jax.jit(function, compiler_options=WIDE)

    @functools.wraps(function)
    def call(*arguments, **keywords):
        arguments = tuple(jnp.asarray(each) if isinstance(each, list) else each for each in arguments)
        keywords = {name: jnp.asarray(each) if isinstance(each, list) else each for name, each in keywords.items()}
        return (wide if _direct(jax.tree.leaves((arguments, keywords))) else plain)(*arguments, **keywords)

    return call  # pyright: ignore[reportReturnType]


def _direct(leaves: list) -> bool:
    if not all(isinstance(leaf, jax.Array | np.ndarray) for leaf in leaves) or not is_known(leaves):
        return False
    devices = next((leaf.sharding.device_set for leaf in leaves if isinstance(leaf, jax.Array)), set())
    on_cpu = all(device.platform == "cpu" for device in devices)
    return on_cpu and is_known(jnp.zeros(()))  # a tracer is made even of a constant under `jit`
