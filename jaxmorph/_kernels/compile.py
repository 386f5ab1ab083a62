"""Compilation of what users call: quick, and with vectors as wide as the processor has them."""

import contextlib
import contextvars
import functools
from collections.abc import Callable, Iterator
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

UNTUNED = {"xla_backend_optimization_level": 0}
"""A third of the time to compile, for programs that run a few times on little."""

_is_quick = contextvars.ContextVar("_is_quick", default=False)
_is_for_cpu = contextvars.ContextVar("_is_for_cpu", default=False)

Function = TypeVar("Function", bound=Callable)


def compiled(function: Function) -> Function:
    """Compiles a function as `equinox.filter_jit` does, with `OPTIONS` for direct calls on a CPU.

    Within another transformation it is an ordinary jitted function: JAX takes options for the outermost one only. Lists
    and tuples of numbers become arrays. As they are, each number would be a static argument, and others compile anew.
    """
    plain = eqx.filter_jit(function)

    @functools.cache
    def direct(only_arrays: bool, is_quick: bool, for_cpu: bool) -> Callable:  # `for_cpu`: what is traced differs
        compile: Any = (
            jax.jit if only_arrays else eqx.filter_jit
        )  # the first is quicker to call; the second knows static arguments
        return compile(function, compiler_options=_known_options(is_quick))

    @functools.wraps(function)
    def call(*arguments, **keywords):
        arguments = tuple(_array(each) for each in arguments)
        keywords = {name: _array(each) for name, each in keywords.items()}
        leaves = jax.tree.leaves((arguments, keywords))
        arrays = [leaf for leaf in leaves if isinstance(leaf, jax.Array | np.ndarray)]
        if _is_for_cpu.get():
            return function(*arguments, **keywords)  # traced into the program of a direct call
        if not _is_direct(arrays):
            return plain(*arguments, **keywords)
        for_cpu = any(isinstance(leaf, jax.Array) for leaf in arrays)
        token = _is_for_cpu.set(for_cpu)
        try:
            return direct(len(arrays) == len(leaves), _is_quick.get(), for_cpu)(*arguments, **keywords)
        finally:
            _is_for_cpu.reset(token)

    return call  # pyright: ignore[reportReturnType]


def is_for_cpu() -> bool:
    """Checks whether JAX traces a direct call with arrays on a CPU, which never runs elsewhere."""
    return _is_for_cpu.get()


def is_direct(*trees: Any) -> bool:
    """Checks whether arrays are known and on a CPU, and nothing is traced: what is called with them runs at once."""
    leaves = jax.tree.leaves(trees)
    return not _is_for_cpu.get() and _is_direct([leaf for leaf in leaves if isinstance(leaf, jax.Array | np.ndarray)])


@contextlib.contextmanager
def quickly_compiled(is_quick: bool = True) -> Iterator[None]:
    """Compiles what is called within without optimisation, and runs that code, which is slower: for one run on a small mesh.

    Where `is_quick` is False, it changes nothing.
    """
    token = _is_quick.set(is_quick or _is_quick.get())
    try:
        yield
    finally:
        _is_quick.reset(token)


@functools.cache
def _known_options(is_quick: bool) -> dict[str, Any]:
    """Selects the options that this version of XLA knows: it refuses a program for one that it does not."""

    def is_known(options: dict[str, Any]) -> bool:
        try:
            jax.jit(jnp.negative, compiler_options=options)(np.zeros(1))
        except Exception:
            return False
        return True

    options = OPTIONS | UNTUNED if is_quick else OPTIONS
    return options if is_known(options) else {name: value for name, value in options.items() if is_known({name: value})}


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
