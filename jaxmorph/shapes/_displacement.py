"""From a shape to what `deform` takes."""

from collections.abc import Callable
from typing import Any

from jaxtyping import Array, Float, PyTree

from ._shape import AbstractLinearShape


def displacement(shape: Callable[[Any, Any], Any], plan: Any, parameters: PyTree) -> Float[Array, "m d"]:
    """Computes the displacement of a plan's moving nodes by a shape: the `u` of `deform(plan, u)`.

    **Arguments:**

    - `shape`: a function of positions and parameters that returns positions, or a shape of `jaxmorph.shapes`.
    - `plan`: from `prepare`.
    - `parameters`: what the shape takes; traced, for derivatives.

    **Returns:** displacement (m, d); row i is that of node `plan.moving[i]`.

    **Raises:** `ValueError` where the shape returns another number of positions.
    """
    x = plan.points[plan.moving]
    if isinstance(shape, AbstractLinearShape):
        return shape.at(x)(parameters)
    moved = shape(x, parameters)
    if moved.shape != x.shape:
        raise ValueError(f"the shape turns positions {x.shape} into {moved.shape}; it must keep their shape.")
    return moved - x
