"""Instructions of NVIDIA's GPUs that neither XLA nor Pallas makes, for the body of a kernel."""

import contextlib
import contextvars

import jax
from jaxtyping import Array, Float

from .contexts import holding

_KINDS = {"float64": ("f64", "d"), "float32": ("f32", "f")}
INLINE = "elementwise_inline_asm_p"
"""The name of Pallas's instructions, which may change: logarithms then run as loops."""

_is_in_kernel = contextvars.ContextVar("_is_in_kernel", default=False)


def is_in_kernel() -> bool:
    """Checks whether JAX traces a kernel's body, where the GPU's instructions may be used."""
    return _is_in_kernel.get()


def in_kernel() -> contextlib.AbstractContextManager[None]:
    """Marks what JAX traces as a kernel's body."""
    return holding(_is_in_kernel, True)


def fma(
    a: Float[Array, "*b"], b: Float[Array, "*b"], c: Float[Array, "*b"], negated: int | None = None
) -> Float[Array, "*b"]:
    """Computes a b + c with one rounding, in a kernel; argument `negated`, from 1, changes sign."""
    kind, letter = _KINDS[a.dtype.name]
    names = ["minus" if i == negated else f"${i}" for i in range(4)]
    code = f"fma.rn.{kind} {', '.join(names)};"
    if negated:
        code = f"{{ .reg .{kind} minus; neg.{kind} minus, ${negated}; {code} }}"
    return _inline(code, f"={letter},{letter},{letter},{letter}", a, b, c)


def rough_reciprocal(x: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """Computes 1/x of float64 numbers with a relative error of 2^-20, within a kernel."""
    return _inline("rcp.approx.ftz.f64 $0, $1;", "=d,d", x)


def _inline(code: str, constraints: str, *arrays: Array) -> Array:
    from jax.experimental.pallas import triton

    result = jax.ShapeDtypeStruct(arrays[0].shape, arrays[0].dtype)
    return triton.elementwise_inline_asm(
        code, args=arrays, constraints=constraints, pack=1, result_shape_dtypes=[result]
    )[0]
