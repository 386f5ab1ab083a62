"""Sums of functions on NVIDIA's GPUs, as one kernel that writes only the sums to memory.

XLA writes blocks of function values to memory, or reaches a tenth of the card's speed. Pallas, a
part of JAX, keeps the sums in registers. Neither contracts a product and a sum into one
instruction; `contracted` does, which halves the time.
"""

import contextlib
import contextvars
import math
import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.extend import core
from jaxtyping import Array, Float

BLOCK, WARPS = 512, 2
"""Points of a program of the kernel, and its groups of 32 threads: eight points a thread."""

FEW = 2**19
"""Points below which sources are divided too: blocks of points alone do not fill a card."""

FEW_BLOCK, FEW_WARPS = 64, 1
"""`BLOCK` and `WARPS` for fewer points."""

PROGRAMS, LEAST_SHARE = 2**17, 256
"""Number of programs that keep a card busy to the end, and least number of sources of a program."""

TOGETHER = 4
"""Sources in one round of the kernel's loop."""

LEAST_CAPABILITY = 8
"""Major compute capability below which Triton, by which Pallas compiles, has no kernels."""

ELEMENTWISE = {
    *(
        "abs",
        "add",
        "cos",
        "div",
        "exp",
        "exp2",
        "integer_pow",
        "log",
        "log1p",
        "logistic",
        "max",
        "min",
        "mul",
        "neg",
        "pow",
    ),
    *("rsqrt", "sign", "sin", "sqrt", "square", "sub", "tanh"),
    *("and", "eq", "ge", "gt", "le", "lt", "ne", "not", "or", "select_n"),
    *("bitcast_convert_type", "broadcast_in_dim", "convert_element_type", "shift_left", "shift_right_logical"),
}
"""Operations of a kernel, by names of JAX, which may change: other functions run as loops."""

CALLS = {"jit": "jaxpr", "pjit": "jaxpr", "custom_jvp_call": "call_jaxpr", "closed_call": "call_jaxpr"}
"""Operations that hold a jaxpr, and the name of the parameter. These names may change too."""

_is_in_kernel = contextvars.ContextVar("_is_in_kernel", default=False)


def is_in_kernel() -> bool:
    """Checks whether JAX traces a kernel's body, where the GPU's instructions may be used."""
    return _is_in_kernel.get()


@contextlib.contextmanager
def _in_kernel() -> Iterator[None]:
    token = _is_in_kernel.set(True)
    try:
        yield
    finally:
        _is_in_kernel.reset(token)


def has_kernels() -> bool:
    """Checks whether JAX's default device is a GPU of NVIDIA for which Pallas compiles."""
    if jax.default_backend() != "gpu":
        return False
    major = re.match(r"(\d+)\.\d+$", str(getattr(jax.devices()[0], "compute_capability", "")))  # of AMD: gfx90a
    return major is not None and int(major[1]) >= LEAST_CAPABILITY


def is_elementwise(phi: Callable, dtype: Any) -> bool:
    """Checks whether a function of one array uses only operations that a kernel may use."""
    try:
        with _in_kernel():
            closed = jax.make_jaxpr(phi)(jax.ShapeDtypeStruct((BLOCK,), dtype))
    except (ImportError, AttributeError):  # Pallas is experimental, and may rename its instructions
        return False
    return not any(jnp.ndim(const) for const in closed.consts) and _allowed(closed.jaxpr)


def _allowed(jaxpr: Any) -> bool:
    def is_allowed(equation: Any) -> bool:
        name = equation.primitive.name
        inner = equation.params.get(CALLS.get(name, ""))
        return name in (*ELEMENTWISE, _INLINE) if inner is None else _allowed(inner.jaxpr)

    return all(map(is_allowed, jaxpr.eqns))


def fused_sum(
    phi: Callable,
    weights: Float[Array, "s k"],
    sources: Float[Array, "s d"],
    points: Float[Array, "c d"],
    constants: Sequence[Float[Array, ""]] = (),
) -> Float[Array, "c k"]:
    """Computes `phi(squared distances of points and sources, *constants) @ weights`, for CUDA."""
    # A program of the kernel has a block of points, and, if there are few points, a part of the
    # sources. All blocks have one size: the last block overlaps the block before it. A thread keeps
    # the sums of its points in registers, and the loop runs over the sources.
    from jax.experimental import pallas as pl
    from jax.experimental.pallas import triton

    (count, rows), (n, dimension) = weights.shape, points.shape
    block, warps, blocks, share = _layout(n, count)
    parts = -(-count // share)
    packed = jnp.stack([jnp.asarray(number, points.dtype) for number in constants] or [jnp.zeros((), points.dtype)])

    def kernel(weights_ref, sources_ref, points_ref, constants_ref, sums_ref):
        here = pl.ds(jnp.minimum(pl.program_id(0) * block, n - block), block)
        x = [points_ref[here, axis] for axis in range(dimension)]
        numbers = [constants_ref[i] for i in range(len(constants))]

        def term(sums, x, y, weights):
            r2 = sum((a - b) ** 2 for a, b in zip(x, y, strict=True))
            value = phi(r2, *numbers)
            return [total + weight * value for total, weight in zip(sums, weights, strict=True)]

        def add(j, sums):
            y = [sources_ref[j, axis] for axis in range(dimension)]
            return tuple(contracted(term, sums, x, y, [weights_ref[j, row] for row in range(rows)]))

        first = pl.program_id(1) * share
        last = count if parts == 1 else jnp.minimum(first + share, count)
        with _in_kernel():
            sums = _looped(add, first, last, (jnp.zeros(block, points.dtype),) * rows)
        for row, total in enumerate(sums):
            sums_ref[pl.program_id(1), here, row] = total

    sums = pl.pallas_call(
        kernel,
        out_shape=jax.ShapeDtypeStruct((parts, n, rows), points.dtype),
        grid=(blocks, parts),
        compiler_params=triton.CompilerParams(num_warps=warps),
    )(weights, sources, points, packed)
    return sums[0] if parts == 1 else sums.sum(axis=0)


def _layout(n: int, count: int) -> tuple[int, int, int, int]:
    """Lays out `n` points and `count` sources: block, warps, count of blocks, sources of a part."""
    block, warps = (BLOCK, WARPS) if n >= FEW else (min(FEW_BLOCK, 1 << int(math.log2(n))), FEW_WARPS)
    blocks = -(-n // block)
    return block, warps, blocks, count if n >= FEW else max(LEAST_SHARE, -(-count * blocks // PROGRAMS))


def _looped(add: Callable, first: Any, last: Any, sums: tuple) -> tuple:
    """Adds the sources from `first` to `last`, `TOGETHER` in a round, then the rest one by one."""
    whole = (last - first) // TOGETHER

    def add_together(i, sums):
        for k in range(TOGETHER):
            sums = add(first + i * TOGETHER + k, sums)
        return sums

    sums = jax.lax.fori_loop(0, whole, add_together, sums)
    return jax.lax.fori_loop(first + whole * TOGETHER, last, add, sums)


def contracted(function: Callable, *arguments: Any) -> Any:
    """Evaluates an elementwise function of arrays, with products fused into additions."""
    closed, shape = jax.make_jaxpr(function, return_shape=True)(*arguments)
    results = _evaluate(closed.jaxpr, closed.consts, jax.tree.leaves(arguments))
    return jax.tree.unflatten(jax.tree.structure(shape), results)


def _evaluate(jaxpr: core.Jaxpr, constants: Sequence[Any], arguments: Sequence[Any]) -> list[Any]:
    """Runs a jaxpr equation by equation, with its products and sums fused."""
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


_KINDS = {"float64": ("f64", "d"), "float32": ("f32", "f")}
_INLINE = "elementwise_inline_asm_p"
"""The name of Pallas's instructions, which may change: logarithms then run as loops."""


def _inline(code: str, constraints: str, *arrays: Array) -> Array:
    from jax.experimental.pallas import triton

    result = jax.ShapeDtypeStruct(arrays[0].shape, arrays[0].dtype)
    return triton.elementwise_inline_asm(
        code, args=arrays, constraints=constraints, pack=1, result_shape_dtypes=[result]
    )[0]
