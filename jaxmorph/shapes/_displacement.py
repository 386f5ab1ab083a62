"""From a shape to the input of `deform`, and from sensitivities to the shape's parameters."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from .._host.package.arguments import checked, whole
from .._kernels.values import as_jax, on_host
from .._plan.deform import pullback as to_nodes
from .._plan.plan import Plan
from .._plan.steps import replay
from ._arguments import Numbers, check_parameters, positions
from ._shape import AbstractLinearShape

AnyShape = Callable[[Any, Any], Any]


@checked
def displacement(shape: AnyShape, plan: Plan, parameters: PyTree) -> Float[Array, "m d"]:
    """Computes the displacement of a plan's moving nodes by a shape: the `u` of `deform(plan, u)`.

    **Arguments:**

    - `shape`: a function of positions and parameters that returns positions, or a shape of
      `jaxmorph.shapes`.
    - `plan`: from `prepare`.
    - `parameters`: what the shape takes; traced, for derivatives.

    **Returns:** displacement (m, d); row i is that of node `plan.moving[i]`.

    **Raises:** `ValueError` where the shape returns another number of positions.
    """
    return moves(shape, plan.moving_points, parameters)


@checked
def path(shape: AnyShape, x: Numbers, parameters: PyTree, steps: int) -> Float[Array, "k m d"]:
    """Computes total displacements after equal steps of the parameters: the path of `march`.

    A rotation in steps is a path of rotated positions. Traced in positions and parameters.

    **Arguments:**

    - `shape`: a shape with `neutral()`, the parameters where the path begins.
    - `x`: positions (m, d).
    - `parameters`: the parameters at the end.
    - `steps`: 1 or more.

    **Returns:** displacements (k, m, d).

    **Raises:** `ValueError` for no steps, for a plain function in several steps, and as
    `displacement` does.
    """
    x = positions(x)
    whole("steps", steps)
    check_parameters(parameters)
    if steps == 1:
        moved = moves(shape, x, parameters)
        return as_jax(np.asarray(moved)[None]) if on_host(moved) else moved[None]
    start = neutral(shape)
    if jax.tree.structure(start) != jax.tree.structure(parameters):
        raise ValueError(f"parameters for several steps must all be given: {jax.tree.structure(start)}.")
    sizes = [[np.shape(leaf) for leaf in jax.tree.leaves(tree)] for tree in (parameters, start)]
    if sizes[0] != sizes[1]:
        raise ValueError(f"`parameters` have shapes {sizes[0]}; this shape takes {sizes[1]}.")
    shares = [(j + 1) / steps for j in range(steps)]
    at = [jax.tree.map(lambda a, b, share=share: a + share * (b - a), start, parameters) for share in shares]
    return jnp.stack([moves(shape, x, values) for values in at])


@checked
def pullback(shape: AnyShape, plan: Plan | Sequence[Plan], parameters: PyTree, cotangent: Numbers) -> PyTree:
    """Takes dJ/d(points) of all nodes to dJ/d(parameters) of the shape that moved the mesh.

    **Arguments:**

    - `shape`: a shape, or a function of positions and parameters.
    - `plan`: from `prepare`; or the plans that `march` returned for `path(shape, x, parameters,
      len(plans))`.
    - `parameters`: the parameters that moved the mesh.
    - `cotangent`: dJ/d(points) (n, d) at the moved mesh.

    **Returns:** dJ/d(parameters), of the structure of `parameters`.

    **Raises:** `ValueError` for another number of nodes, and as `path` does.
    """
    check_parameters(parameters)
    plans = (plan,) if isinstance(plan, Plan) else tuple(plan)
    if not plans or np.shape(cotangent) != plans[0].points.shape:
        expected = plans[0].points.shape if plans else "plans of a march"
        raise ValueError(f"`cotangent` has shape {np.shape(cotangent)}; expected {expected}.")
    x, dtype = plans[0].points[plans[0].moving], plans[0].points.dtype
    parameters = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), parameters)
    total, transpose = jax.vjp(lambda parameters: path(shape, x, parameters, len(plans)), parameters)
    cotangent = jnp.asarray(cotangent, dtype)
    if len(plans) == 1:
        return transpose(to_nodes(plans[0], total[0], cotangent)[None])[0]
    return transpose(jax.vjp(lambda total: replay(plans, total), total)[1](cotangent)[0])[0]


@checked
def project(shape: AnyShape, x: Numbers, parameters: PyTree, gradient: Numbers) -> PyTree:
    """Takes dJ/d(positions) of a wall to dJ/d(parameters) of its shape, without a mesh.

    It is for sensitivities that are the wall's own, as `jm.pullback` or a solver's surface file
    gives them.

    **Arguments:**

    - `shape`: a shape, or a function of positions and parameters.
    - `x`: undeformed positions (m, d) of the wall.
    - `parameters`: the parameters that moved the wall.
    - `gradient`: dJ/d(positions) (m, d) of the moved wall.

    **Returns:** dJ/d(parameters), of the structure of `parameters`.

    **Raises:** `ValueError` for another number of rows, and as `displacement` does.
    """
    x = positions(x)
    check_parameters(parameters)
    if np.shape(gradient) != x.shape:
        raise ValueError(f"`gradient` has shape {np.shape(gradient)}; the wall has positions {x.shape}.")
    parameters = jax.tree.map(lambda leaf: jnp.asarray(leaf, x.dtype), parameters)
    return jax.vjp(lambda parameters: moves(shape, x, parameters), parameters)[1](jnp.asarray(gradient, x.dtype))[0]


def neutral(shape: AnyShape) -> PyTree:
    """Returns the parameters of a shape that move nothing.

    **Raises:** `ValueError` for a plain function.
    """
    if not hasattr(shape, "neutral"):
        raise ValueError("a plain function has no neutral parameters: take `shapes.Function(function, rest)`.")
    return shape.neutral()  # pyright: ignore[reportFunctionMemberAccess]


def moves(shape: AnyShape, x: Float[Array, "m d"], parameters: PyTree) -> Float[Array, "m d"]:
    """Computes the displacement of positions.

    **Raises:** `ValueError` where the shape returns another number of positions.
    """
    check_parameters(parameters)
    if isinstance(shape, AbstractLinearShape) and parameters is None:
        raise ValueError("`parameters` is None; `shape.neutral()` gives parameters that move nothing.")
    if isinstance(shape, AbstractLinearShape):
        return shape.at(x)(parameters)
    moved = shape(x, parameters)
    if moved.shape != x.shape:
        raise ValueError(f"the shape turns positions {x.shape} into {moved.shape}; it must keep their shape.")
    return moved - x
