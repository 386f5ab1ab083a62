"""Parameters that reproduce a given surface."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int, PyTree

from jaxmorph.extend import Module, checked, is_known, whole

from ._arguments import Numbers, check_finite, positions
from ._curves import CST
from ._displacement import neutral
from ._section import Chord, upper_side
from ._shape import AbstractLinearShape, Part, Together


class Fit(Module):
    """Result of `fit`.

    - `parameters`: as the shape takes them.
    - `residual`: (m,) distance of each position from its target.
    - `rank`: of the derivative by the parameters. Below `count` some have no effect, and are as
      small as possible.
    - `count`: numbers in the parameters.
    """

    parameters: PyTree
    residual: Float[Array, " m"]
    rank: Int[Array, ""]
    count: int = eqx.field(static=True)

    def raise_if_singular(self) -> None:
        """Raises `ValueError` where parameters, or combinations of them, have no effect."""
        if idle := self.count - int(self.rank):
            raise ValueError(
                f"the fit is singular: {idle} of {self.count} parameters have no effect of their own on these {len(self.residual)} "
                f"points. Try fewer parameters, or more points."
            )

    @property
    def max_residual(self) -> Float[Array, ""]:
        return self.residual.max()


@checked
def fit(
    shape: Callable, points: Numbers, targets: Numbers, start: PyTree | None = None, *, max_steps: int = 100
) -> Fit:
    """Finds the parameters with which a shape moves points closest to targets (least squares).

    A linear shape takes one solve, by singular values, any other Levenberg and Marquardt's method.

    **Arguments:**

    - `shape`: a shape, or a function of positions and parameters.
    - `points`, `targets`: (m, d) before and after, row by row.
    - `start`: parameters to begin with; `shape.neutral()` by default.
    - `max_steps`: of the iteration.

    **Raises:** `ValueError` for different shapes, a function without `start`, and parameters of
    which none moves a point.
    """
    whole("max_steps", max_steps)
    points, targets = positions(points, "points"), positions(targets, "targets")
    check_finite(points=points, targets=targets)
    if points.shape != targets.shape:
        raise ValueError(f"`points` has shape {points.shape}, `targets` {targets.shape}; they belong row to row.")
    start = neutral(shape) if start is None else start
    flat, unravel = ravel_pytree(jax.tree.map(lambda leaf: jnp.asarray(leaf, points.dtype), start))

    def miss(flat, _=None):
        return (shape(points, unravel(flat)) - targets).ravel()

    is_linear = isinstance(shape, AbstractLinearShape)
    if not is_linear:
        import optimistix  # not before it is needed: it takes a quarter of a second

        solver = optimistix.LevenbergMarquardt(rtol=1e-12, atol=1e-14)
        flat = optimistix.least_squares(miss, solver, flat, max_steps=max_steps, throw=False).value
    jacobian = jax.jacfwd(miss)(flat)
    change, _, rank, _ = jnp.linalg.lstsq(jacobian, -miss(flat))
    if is_known(jacobian) and not jnp.any(jacobian):
        raise ValueError(
            f"none of {len(flat)} parameters moves one of the {len(points)} points: are they outside the box?"
        )
    flat = flat + change if is_linear else flat
    return Fit(unravel(flat), jnp.linalg.norm(miss(flat).reshape(points.shape), axis=1), rank, len(flat))


@checked
def fit_cst(
    points: Numbers,
    order: int,
    exponents: tuple[float, float] = (0.5, 1.0),
    *,
    chord: Chord | None = None,
    wall: Any = None,
) -> tuple[Together, Fit]:
    """Fits class and shape functions to the upper and the lower side of an airfoil, from its chord.

    **Arguments:**

    - `points`: (m, 2) nodes of the airfoil, in any order.
    - `order`, `exponents`: of `CST`.
    - `chord`: `Chord.along` by default. A nose between two nodes shows in the residual there.
    - `wall`: as `upper_side` takes it; it names all points.

    **Returns:** the shape and the `Fit`, whose parameters (upper, lower) describe this airfoil.
    Changes to them move it: `shape(points, (d_upper, d_lower))`.

    **Raises:** `ValueError` for fewer nodes than unknowns, and an airfoil without two sides.
    """
    whole("order", order)
    points = positions(points, "points")
    chord = Chord.along(points) if chord is None else chord
    cst, upper = CST(order, exponents, chord=chord), upper_side(points, chord, wall=wall)
    if wall is not None and len(wall) != len(points):
        raise ValueError(f"`wall` names {len(wall)} of {len(points)} points; all of them belong to the airfoil.")
    if min(upper.sum(), (~upper).sum()) < order + 2:
        raise ValueError(
            f"{upper.sum()} nodes above and {(~upper).sum()} below do not determine {order + 2} numbers a side."
        )
    shape = Together(*(Part(cst, side) for side in (upper, ~upper)))
    _, height = chord.coordinates(points)
    return shape, fit(shape, points - height[:, None] * chord.up.astype(points.dtype)[None, :], points)
