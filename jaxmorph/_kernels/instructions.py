"""Instructions of NVIDIA's GPUs that neither XLA nor Pallas makes, for the body of a kernel.

A product and an addition become one instruction (`contracted`): that halves the time of a sum.
"""

import contextlib
import contextvars
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.extend import core
from jaxtyping import Array, Float

from .compile import holding

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


CALLS = {"jit": "jaxpr", "pjit": "jaxpr", "custom_jvp_call": "call_jaxpr", "closed_call": "call_jaxpr"}
"""Operations that hold a jaxpr, and the name of the parameter, by names of JAX, which may change.

A function that calls another by a name that is not here runs as loops.
"""


def contracted(function: Callable, *arguments: Any) -> Any:
    """Evaluates an elementwise function of arrays, with products fused into additions."""
    closed, shape = jax.make_jaxpr(function, return_shape=True)(*arguments)
    results = _evaluate(closed.jaxpr, closed.consts, jax.tree.leaves(arguments))
    return jax.tree.unflatten(jax.tree.structure(shape), results)


def _evaluate(jaxpr: core.Jaxpr, constants: Sequence[Any], arguments: Sequence[Any]) -> list[Any]:
    # If one addition alone uses a product, the factors wait in `products` until the addition, which
    # becomes one `fma`. Another operation that reads a waiting product multiplies it first.
    values = dict(zip((*jaxpr.constvars, *jaxpr.invars), (*constants, *arguments), strict=True))
    products: dict[Any, tuple] = {}
    waiting = _only_added(jaxpr)

    def read(atom):
        if isinstance(atom, core.Literal):
            return jnp.asarray(atom.val, atom.aval.dtype)  # pyright: ignore[reportAttributeAccessIssue]
        if atom in products:
            values[atom] = jnp.multiply(*products.pop(atom))
        return values[atom]

    for equation in jaxpr.eqns:
        name, atoms = equation.primitive.name, equation.invars
        out = equation.outvars[0]
        if out in waiting:
            factors = atoms if name == "mul" else atoms * 2
            products[out] = tuple(map(read, factors))
        elif name in ("add", "sub") and (late := [atom for atom in atoms if _is_in(atom, products)]):
            a, b = products.pop(late[-1])
            is_first = late[-1] is atoms[0]
            c = read(atoms[1] if is_first else atoms[0])
            negated = None if name == "add" else 3 if is_first else 1
            values[out] = fma(*jnp.broadcast_arrays(a, b, c), negated=negated)
        elif name in CALLS:
            inner = equation.params[CALLS[name]]
            results = _evaluate(inner.jaxpr, inner.consts, list(map(read, atoms)))
            values.update(zip(equation.outvars, results, strict=True))
        else:
            results = equation.primitive.bind(*map(read, atoms), **equation.params)
            results = results if equation.primitive.multiple_results else [results]
            values.update(zip(equation.outvars, results, strict=True))
    return [read(atom) for atom in jaxpr.outvars]


def _is_in(atom: Any, values: dict) -> bool:
    return not isinstance(atom, core.Literal) and atom in values


def _only_added(jaxpr: Any) -> set[Any]:
    """Finds the products of floats that only one addition or subtraction uses."""
    uses: dict[Any, list[str]] = {}
    for equation in jaxpr.eqns:
        for atom in equation.invars:
            if not isinstance(atom, core.Literal):
                uses.setdefault(atom, []).append(equation.primitive.name)
    for atom in jaxpr.outvars:
        if not isinstance(atom, core.Literal):
            uses.setdefault(atom, []).append("")

    def is_product(equation: Any) -> bool:
        name, params = equation.primitive.name, equation.params
        is_square = name == "square" or (name == "integer_pow" and params["y"] == 2)
        return (name == "mul" or is_square) and jnp.issubdtype(equation.outvars[0].aval.dtype, jnp.floating)

    products = [equation.outvars[0] for equation in jaxpr.eqns if is_product(equation)]
    return {product for product in products if uses.get(product) in (["add"], ["sub"])}
