"""Compilation of public functions: quick, with the processor's widest vectors, or none."""

import contextlib
import contextvars
import functools
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .values import is_known, on_host

XLA_OPTIONS = {
    # XLA's default is 256 bits: a kernel sum takes up to 50 % longer. No effect on smaller
    # processors.
    "xla_cpu_prefer_vector_width": 512,
    # The newer emitters compile up to twice as long; programs here run as fast with the older ones.
    "xla_cpu_use_fusion_emitters": False,
}

UNTUNED = {
    "xla_backend_optimization_level": 0,
    "xla_cpu_parallel_codegen_split_count": 1,  # each part has a price of its own
}  # a third of the compile time, for few runs on little data

_is_quick = contextvars.ContextVar("_is_quick", default=False)
_is_for_cpu = contextvars.ContextVar("_is_for_cpu", default=False)

Function = TypeVar("Function", bound=Callable)
T = TypeVar("T")


class Constant(eqx.Module):
    """A static value. With arrays alone as leaves a call is asynchronous; `filter_jit` waits."""

    value: Any = eqx.field(static=True)


def compiled(function: Function) -> Function:
    """Compiles a function as `equinox.filter_jit` does, for direct calls on a CPU with
    `XLA_OPTIONS`. Within another transformation it is an ordinary jitted function: JAX takes
    options only for the outermost program. Lists and tuples of numbers become arrays, not static
    arguments.
    """
    plain = eqx.filter_jit(function)

    @functools.cache
    def direct(
        only_arrays: bool, is_quick: bool, for_cpu: bool
    ) -> Callable:  # tracing depends on `for_cpu`
        # `jax.jit` is quicker to call, `filter_jit` knows static arguments
        compile: Any = jax.jit if only_arrays else eqx.filter_jit
        options = XLA_OPTIONS | (UNTUNED if is_quick else {})
        return compile(function, compiler_options=_known_of(tuple(options.items())))

    @functools.wraps(function)
    def call(*arguments, **keywords):
        arguments = tuple(map(_numbers_as_array, arguments))
        keywords = {name: _numbers_as_array(value) for name, value in keywords.items()}
        if _is_for_cpu.get():
            return function(*arguments, **keywords)  # traced into the program of a direct call
        if not is_direct(arguments, keywords):
            return plain(*arguments, **keywords)
        leaves = jax.tree.leaves((arguments, keywords))
        only_arrays = all(isinstance(leaf, jax.Array | np.ndarray) for leaf in leaves)
        for_cpu = any(isinstance(leaf, jax.Array) for leaf in leaves)
        with holding(_is_for_cpu, for_cpu):
            return direct(only_arrays, _is_quick.get(), for_cpu)(*arguments, **keywords)

    return call  # pyright: ignore[reportReturnType]


def by_place(function: Function) -> Function:
    """Makes a function that runs by NumPy where its arrays are in the host's memory, else compiled:
    a compilation would take longer than NumPy. Whole numbers among its arguments are static.
    """
    program = compiled(function)

    def call(*arguments: Any) -> Any:
        if not on_host(arguments):
            return program(*_converted(jnp.asarray, arguments))
        with np.errstate(all="ignore"), jax.ensure_compile_time_eval():  # cells may have no size
            return function(*_converted(np.asarray, arguments))

    return call  # pyright: ignore[reportReturnType]


def _converted(convert: Callable, arguments: Any) -> Any:
    return jax.tree.map(lambda leaf: leaf if isinstance(leaf, int) else convert(leaf), arguments)


def is_for_cpu() -> bool:
    """Checks whether JAX traces a direct call with CPU arrays: the program runs nowhere else."""
    return _is_for_cpu.get()


def as_for_cpu() -> contextlib.AbstractContextManager[None]:
    """Makes JAX trace as for a CPU alone: the body of a kernel cannot choose by platform."""
    return holding(_is_for_cpu, True)


def is_direct(*trees: Any) -> bool:
    """Checks whether arrays are known and on a CPU, untraced: a call with them runs at once."""
    if _is_for_cpu.get() or not is_known(trees):
        return False
    leaves = jax.tree.leaves(trees)
    devices = next(
        (leaf.sharding.device_set for leaf in leaves if isinstance(leaf, jax.Array)), set()
    )
    on_cpu = all(device.platform == "cpu" for device in devices)
    # a tracer is made even of a constant under `jit`
    return on_cpu and is_known(jax.device_put(np.zeros(())))


def quickly_compiled(is_quick: bool = True) -> contextlib.AbstractContextManager[None]:
    """Returns a context in which calls compile in a third of the time, without optimisation: for
    small meshes that are moved a few times.
    """
    return holding(_is_quick, is_quick or _is_quick.get())


def float64_mode(is_on: bool = True) -> contextlib.AbstractContextManager[Any]:
    """Returns a context in which JAX computes in float64, or does not, whatever its mode is."""
    if hasattr(jax, "enable_x64"):
        return jax.enable_x64(is_on)
    from jax.experimental import enable_x64  # pyright: ignore[reportAttributeAccessIssue]  of older versions

    return enable_x64(is_on)


@functools.cache
def _known_of(options: tuple[tuple[str, Any], ...]) -> dict[str, Any]:
    """Leaves out options that XLA does not know: it refuses a program for them."""
    try:
        jax.jit(jnp.negative, compiler_options=dict(options))(np.zeros(1))
    except Exception:
        known = (_known_of((option,)) for option in options if len(options) > 1)
        return {name: value for each in known for name, value in each.items()}
    return dict(options)


def _numbers_as_array(argument: Any) -> Any:
    leaves = jax.tree.leaves(argument) if isinstance(argument, tuple) else ()
    is_numbers = len(leaves) > 0 and all(isinstance(leaf, int | float) for leaf in leaves)
    return jnp.asarray(argument) if isinstance(argument, list) or is_numbers else argument


@contextlib.contextmanager
def holding(variable: contextvars.ContextVar[T], value: T) -> Iterator[None]:
    token = variable.set(value)
    try:
        yield
    finally:
        variable.reset(token)
