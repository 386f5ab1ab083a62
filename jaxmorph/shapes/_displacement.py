"""What is done with a shape: the input of `deform`, sensitivities, fits, names of parameters."""

import difflib
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int, PyTree

import jaxmorph as jm
from jaxmorph import Plan
from jaxmorph.extend import Either, Module, as_jax, by_place, checked, is_known, namespace, whole

from ._arguments import (
    Column,
    Numbers,
    Positions,
    Scalar,
    check_known,
    check_parameters,
    positions,
)
from ._shape import AbstractLinearShape

AnyShape = Callable[[Any, Any], Any]


@checked
def displacement(shape: AnyShape, plan: Plan, parameters: PyTree) -> Positions:
    """Computes the displacement of a plan's moving nodes by a shape: the `u` of `deform(plan, u)`.

    **Arguments:**

    - `shape`: a shape, or a function of positions and parameters that returns positions.
    - `plan`: from `prepare`.
    - `parameters`: what the shape takes; traced, for derivatives.

    **Returns:** displacement (m, d); row i is that of node `plan.moving[i]`. **Raises:**
    `ValueError` where the shape returns another number of positions.
    """
    return moves(shape, plan.moving_points, parameters)


@checked
def path(shape: AnyShape, x: Numbers, parameters: PyTree, steps: int) -> Float[Array, "k m d"]:
    """Computes total displacements after equal steps of the parameters: the path of `march`.

    The parameters go from `shape.neutral()` to `parameters`, so a rotation stays a rotation in each
    step. Traced in the positions `x` (m, d) and the parameters.

    **Raises:** `ValueError` for a plain function in several steps, and as `displacement` does.
    """
    x = positions(x)
    whole("steps", steps)
    if steps == 1:
        return as_jax(_stacked(moves(shape, x, parameters)))
    start = neutral(shape)
    given, needed = (jax.tree.map(np.shape, tree) for tree in (parameters, start))
    if given != needed:
        raise ValueError(f"`parameters` have shapes {given}; this shape takes {needed}.")

    def at(share: float) -> Positions:
        values = jax.tree.map(lambda a, b: a + share * (b - a), start, parameters)
        return moves(shape, x, values)

    return as_jax(_stacked(*(at((k + 1) / steps) for k in range(steps))))


@checked
def pullback(
    shape: AnyShape, plan: Plan | Sequence[Plan], parameters: PyTree, cotangent: Numbers
) -> PyTree:
    """Takes dJ/d(points) of all nodes to dJ/d(parameters) of the shape that moved the mesh.

    **Arguments:**

    - `shape`, `parameters`: as `displacement` takes them.
    - `plan`: from `prepare`, or the plans of `march` along `path(shape, x, parameters,
      len(plans))`.
    - `cotangent`: dJ/d(points) (n, d) at the moved mesh.

    **Raises:** `ValueError` for another number of nodes, and as `path` does.
    """
    plans = (plan,) if isinstance(plan, Plan) else tuple(plan)
    if not plans or np.shape(cotangent) != plans[0].points.shape:
        expected = plans[0].points.shape if plans else "plans of a march"
        raise ValueError(f"`cotangent` has shape {np.shape(cotangent)}; expected {expected}.")
    x = plans[0].points[plans[0].moving]
    total, transpose = jax.vjp(
        lambda values: path(shape, x, values, len(plans)), _as_floats(parameters, x)
    )
    cotangent = jnp.asarray(cotangent, x.dtype)
    if len(plans) == 1:
        return transpose(jm.pullback(plans[0], total[0], cotangent)[None])[0]
    return transpose(jax.vjp(lambda total: jm.replay(plans, total), total)[1](cotangent)[0])[0]


@checked
def project(shape: AnyShape, x: Numbers, parameters: PyTree, gradient: Numbers) -> PyTree:
    """Takes dJ/d(positions) of a wall to dJ/d(parameters) of its shape, without a mesh.

    `jm.pullback` or a solver's surface file gives such sensitivities.

    **Arguments:**

    - `shape`, `parameters`: as `displacement` takes them.
    - `x`: undeformed positions (m, d) of the wall.
    - `gradient`: dJ/d(positions) (m, d) of the moved wall.

    **Raises:** `ValueError` for another number of rows, and as `displacement` does.
    """
    x = positions(x)
    if np.shape(gradient) != x.shape:
        raise ValueError(
            f"`gradient` has shape {np.shape(gradient)}; the wall has positions {x.shape}."
        )
    transpose = jax.vjp(lambda values: moves(shape, x, values), _as_floats(parameters, x))[1]
    return transpose(jnp.asarray(gradient, x.dtype))[0]


def _as_floats(parameters: PyTree, x: Positions) -> PyTree:
    check_parameters(parameters)
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, x.dtype), parameters)


def neutral(shape: AnyShape) -> PyTree:
    if not hasattr(shape, "neutral"):
        raise ValueError(
            "a plain function has no neutral parameters: take `shapes.Function(function, rest)`."
        )
    return shape.neutral()  # pyright: ignore[reportFunctionMemberAccess]


def moves(shape: AnyShape, x: Positions, parameters: PyTree) -> Positions:
    check_parameters(parameters)
    if isinstance(shape, AbstractLinearShape):
        if parameters is None:
            raise ValueError(
                "`parameters` is None; `shape.neutral()` gives parameters that move nothing."
            )
        return shape.at(x)(parameters)
    moved = shape(x, parameters)
    if moved.shape != x.shape:
        raise ValueError(
            f"the shape turns positions {x.shape} into {moved.shape}; it must keep their shape."
        )
    return as_jax(_difference(moved, x))


@by_place
def _difference(a: Float[Either, "m d"], b: Float[Either, "m d"]) -> Float[Either, "m d"]:
    return a - b


@by_place
def _stacked(*rows: Float[Either, "m d"]) -> Float[Either, "k m d"]:
    return namespace(rows[0]).stack(rows)


def names(parameters: PyTree) -> list[str]:
    """Names each number of a shape's parameters, in the order of `jax.flatten_util.ravel_pytree`.

    Keys are joined by dots, places in an array follow in brackets: `wing.twist`, `wing.box[2,1,0]`.
    """
    check_parameters(parameters)
    return [
        name for stem, leaf in _leaves(parameters) for name in _number_names(stem, np.shape(leaf))
    ]


@checked
def varied(parameters: PyTree, changes: Mapping[str, Any]) -> PyTree:
    """Sets some of a shape's parameters by name, on the host.

    `changes` has values by the names that `names` gives, or of whole arrays (`wing.box`); an
    unambiguous end of a name is enough (`twist`).

    **Returns:** parameters in their structure, as NumPy's floats. **Raises:** `ValueError` for
    unknown or ambiguous names, counts that differ, and values that are not finite.
    """
    check_parameters(parameters)
    stems = [stem for stem, _ in _leaves(parameters)]
    values = [np.array(leaf, float) for leaf in jax.tree.leaves(parameters)]
    for name, change in changes.items():
        stem, bracket, indices = name.partition("[")
        array = _stem_of(stem, stems)
        value = values[stems.index(array)]
        flat = value.reshape(-1)
        if bracket:
            listed = _number_names(array, value.shape)
            if f"{array}[{indices}" not in listed:
                raise ValueError(
                    f"there is no design variable {name}: {array} has shape {value.shape}."
                )
            first = listed.index(f"{array}[{indices}")
            flat = flat[first : first + 1]
        numbers = np.asarray(change, float).ravel()
        if numbers.size != flat.size or not np.isfinite(numbers).all():
            count = "one finite number" if flat.size == 1 else f"{flat.size} finite numbers"
            raise ValueError(f"{name} takes {count}, found {numbers.tolist()}.")
        flat[:] = numbers
    return jax.tree.unflatten(jax.tree.structure(parameters), values)


def _stem_of(name: str, stems: Sequence[str]) -> str:
    """The array of a name, or of the unambiguous end of one."""
    matches = [name] if name in stems else [stem for stem in stems if stem.endswith(f".{name}")]
    if len(matches) == 1:
        return matches[0]
    if matches:
        listed = ", ".join(matches)
        raise ValueError(
            f"{len(matches)} design variables are called {name}; take one of: {listed}."
        )
    ends = [stem.rpartition(".")[2] for stem in stems]
    near = difflib.get_close_matches(name, [*stems, *ends], n=1)
    hint = f" (did you mean {near[0]!r}?)" if near else ""
    listed = ", ".join(stems) or "none"
    raise ValueError(f"there is no design variable {name}{hint}; there are: {listed}.")


def _leaves(parameters: PyTree) -> Iterator[tuple[str, Any]]:
    for path, leaf in jax.tree_util.tree_flatten_with_path(parameters)[0]:
        yield jax.tree_util.keystr(path, simple=True, separator=".") or "parameters", leaf


def _number_names(stem: str, shape: tuple[int, ...]) -> list[str]:
    return [f"{stem}[{','.join(map(str, at))}]" for at in np.ndindex(shape)] if shape else [stem]


class Fit(Module):
    """Result of `fit`.

    - `parameters`: as the shape takes them.
    - `residual`: (m,) distance of each position from its target.
    - `rank`: of the derivative by the parameters. Below `count` some have no effect, and are as
      small as possible.
    - `count`: numbers in the parameters.
    """

    parameters: PyTree
    residual: Column
    rank: Int[Array, ""]
    count: int = eqx.field(static=True)

    def raise_if_singular(self) -> None:
        """Raises `ValueError` where parameters, or combinations of them, have no effect."""
        if idle := self.count - int(self.rank):
            raise ValueError(
                f"the fit is singular: {idle} of {self.count} parameters have no effect of their "
                f"own on these {len(self.residual)} points. Try fewer of them, or more points."
            )

    @property
    def max_residual(self) -> Scalar:
        return self.residual.max()


def _least_squares(miss: Callable, start: Array, max_steps: int) -> Array:
    import optimistix  # not before it is needed: it takes a quarter of a second

    solver = optimistix.LevenbergMarquardt(rtol=1e-12, atol=1e-14)
    return optimistix.least_squares(miss, solver, start, max_steps=max_steps, throw=False).value


@checked
def fit(
    shape: Callable,
    points: Numbers,
    targets: Numbers,
    start: PyTree | None = None,
    *,
    max_steps: int = 100,
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
    points = positions(points, "points")
    targets = positions(targets, "targets")
    check_known(points=points, targets=targets)
    if points.shape != targets.shape:
        raise ValueError(
            f"`points` has shape {points.shape}, `targets` {targets.shape}; they belong row to row."
        )
    start = neutral(shape) if start is None else start
    flat, unravel = ravel_pytree(jax.tree.map(lambda leaf: jnp.asarray(leaf, points.dtype), start))

    def miss(flat, _=None):
        return (shape(points, unravel(flat)) - targets).ravel()

    is_linear = isinstance(shape, AbstractLinearShape)
    if not is_linear:
        flat = _least_squares(miss, flat, max_steps)
    jacobian = jax.jacfwd(miss)(flat)
    change, _, rank, _ = jnp.linalg.lstsq(jacobian, -miss(flat))
    if is_known(jacobian) and not jnp.any(jacobian):
        raise ValueError(
            f"none of {len(flat)} parameters moves one of the {len(points)} points: are they "
            "outside the box?"
        )
    flat = flat + change if is_linear else flat
    return Fit(
        parameters=unravel(flat),
        residual=jnp.linalg.norm(miss(flat).reshape(points.shape), axis=1),
        rank=rank,
        count=len(flat),
    )
