"""Compilation of what users call: quick, and with vectors as wide as the processor has them."""

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .values import is_known

OPTIONS = {
    # XLA by itself holds back to 256 bits, and a kernel sum then takes up to half as long again. No effect where there are fewer.
    "xla_cpu_prefer_vector_width": 512,
    # the newer emitters take up to twice as long to compile; the programs here run as fast with the older ones
    "xla_cpu_use_fusion_emitters": False,
}

Function = TypeVar("Function", bound=Callable)


def compiled(function: Function) -> Function:
    """Compiles a function as `equinox.filter_jit` does, with `OPTIONS` for direct calls on a CPU.

    Within another transformation it is an ordinary jitted function: JAX takes options for the outermost one only. Lists
    and tuples of numbers become arrays. As they are, each number would be a static argument, and others compile anew.
    """
    plain = eqx.filter_jit(function)

    @functools.cache
    def direct(only_arrays: bool) -> Callable:
        compile: Any = (
            jax.jit if only_arrays else eqx.filter_jit
        )  # the first is quicker to call; the second knows static arguments
        return compile(function, compiler_options=_known_options())

    @functools.wraps(function)
    def call(*arguments, **keywords):
        arguments = tuple(_array(each) for each in arguments)
        keywords = {name: _array(each) for name, each in keywords.items()}
        leaves = jax.tree.leaves((arguments, keywords))
        arrays = [leaf for leaf in leaves if isinstance(leaf, jax.Array | np.ndarray)]
        chosen = direct(len(arrays) == len(leaves)) if _is_direct(arrays) else plain
        return chosen(*arguments, **keywords)

    return call  # pyright: ignore[reportReturnType]


@functools.cache
def _known_options() -> dict[str, Any]:
    """Selects the options that this version of XLA knows: it refuses a program for one that it does not."""

    def is_known(options: dict[str, Any]) -> bool:
        try:
            jax.jit(jnp.negative, compiler_options=options)(np.zeros(1))
        except Exception:
            return False
        return True

    return OPTIONS if is_known(OPTIONS) else {name: value for name, value in OPTIONS.items() if is_known({name: value})}


def _array(argument: Any) -> Any:
    leaves = jax.tree.leaves(argument) if isinstance(argument, tuple) else ()
    is_numbers = len(leaves) > 0 and all(isinstance(leaf, int | float) for leaf in leaves)
    return jnp.asarray(argument) if isinstance(argument, list) or is_numbers else argument


def _is_direct(arrays: list) -> bool:
    if not is_known(arrays):
        return False
    devices = next((leaf.sharding.device_set for leaf in arrays if isinstance(leaf, jax.Array)), set())
    on_cpu = all(device.platform == "cpu" for device in devices)
    return on_cpu and is_known(jnp.zeros(()))  # a tracer is made even of a constant under `jit`
