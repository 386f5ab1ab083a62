"""Measures of cells without kinks, for objectives and constraints that are differentiated."""

import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float, Real

from .._host.package.arguments import between, checked
from .._kernels.compile import compiled
from .._kernels.module import Module
from .._kernels.values import is_known
from .._mesh.mesh import Mesh, PointsLike
from .._methods.base import number
from . import measures
from .quality import Standard, link, non_orthogonality, places, standards_of
from .vector import ValuesByType, Vector, by_type, dot, join_values

SmoothOfCells = Float[Array, " k"]


class SmoothQuality(Module):
    """Smooth measures of k cells: arrays (k,), as in `QualityReport`; angles in degrees."""

    skewness: SmoothOfCells
    aspect_ratio: SmoothOfCells
    non_orthogonality: SmoothOfCells
    jacobian_ratio: SmoothOfCells


@checked
def smooth_quality(
    mesh: Mesh, points: PointsLike | None = None, *, sharpness: float = 50.0, softness: float = 1e-6
) -> SmoothQuality:
    """Measures cells as `quality` does, with smooth twins of the measures that have kinks.

    `volume`, `volume_ratio` and `distortion` have none. Where `quality` takes the largest (or
    smallest) of m terms of a cell, a soft maximum (or minimum) takes its place. Its derivative is
    spread over the terms near the largest. The values approach those of `quality` as `sharpness`
    grows:

    - `skewness` is less by log(m) / `sharpness` at most, m up to 36; a quad has m = 2.
    - `aspect_ratio` is less by a factor of m^(2 / `sharpness`) at most, m up to 12. It is finite on
      flat cells, 2 / `softness`, and where triangles, quads and tetrahedra are inverted. There it
      is larger the further they are, so that its derivative turns them round.
    - `non_orthogonality` is less by 90 (1 + log m) / `sharpness` degrees at most; smooth at 0
      degrees too.
    - `jacobian_ratio` is more by log(m) / `sharpness` at most.

    Traced in `points`: `jit`, `grad` and `vmap` work, with finite derivatives on inverted cells.

    **Arguments:**

    - `mesh`: the mesh with its cells; `mesh.points` is undeformed.
    - `points`: where the nodes are now (n, d), in the unit of `mesh.points`, the default.
    - `sharpness`: positive, without unit, default 50. A larger value is closer to `quality`, a
      smaller one smoother.
    - `softness`: positive, without unit, default 1e-6, far below the inverse of the aspect ratios
      that matter.

    **Raises:** `ValueError` for a mesh without cells, another shape of `points`, and a `sharpness`
    or `softness` that is not positive.
    """
    current = places(mesh, points)
    for name, value in (("sharpness", sharpness), ("softness", softness)):
        if is_known(value):
            between(name, value, 0)
    with jax.ensure_compile_time_eval():
        links = link(mesh)
        standards = standards_of(mesh, current.dtype, links)
    options = jnp.asarray(sharpness, current.dtype), jnp.asarray(softness, current.dtype)
    return _measure_softly(mesh.cells, links.neighbour, current, standards, options)


@compiled
def _measure_softly(
    cells: ValuesByType, behind, points, standards: dict[str, Standard], options
) -> SmoothQuality:
    shapes = functools.partial(_measure_shapes, options)
    skewness, aspect, jacobian = join_values(jnp, by_type(shapes, points, cells, standards))
    signs = {kind: standard.sign for kind, standard in standards.items()}
    largest_angle = functools.partial(_largest_angle, sharpness=options[0])
    angles = non_orthogonality(points, cells, signs, behind, largest_angle)
    return SmoothQuality(
        skewness=skewness, aspect_ratio=aspect, non_orthogonality=angles, jacobian_ratio=jacobian
    )


def _measure_shapes(options, kind: str, x: Vector, standard: Standard) -> tuple[Array, ...]:
    sharpness, softness = options
    relative, size = measures.relative_corners(x)
    shape = measures.scaled(relative, size)
    largest = functools.partial(soft_maximum, sharpness=sharpness, axis=0)
    skewness = measures.skewness(kind, shape, largest)
    ratios = standard.sign[None] * measures.jacobians(kind, relative)[0] / standard.jacobian[None]
    least = -_soft_maximum_where(-ratios, standard.is_judged[: len(ratios)], sharpness)
    ratio = jnp.where(standard.is_degenerate, 1, least)
    linear, shape = measures.linear_cells_at_nodes(kind, shape)
    sign = jnp.tile(standard.sign, shape[0].shape[1] // len(size))
    aspect = jnp.log(_soft_aspect_ratio(linear, shape, sign, sharpness, softness))
    return skewness, jnp.exp(largest(aspect.reshape(-1, len(size)))), ratio


def _soft_aspect_ratio(kind: str, x: Vector, sign: Array, sharpness, softness) -> SmoothOfCells:
    if kind == "line":
        return jnp.ones_like(x[0][0])
    edges, under = measures.aspect_terms(kind, x)
    logarithms = jnp.log(dot(edges, edges) + 1e-30) / 2
    longest = soft_maximum(logarithms, sharpness, axis=0)
    if under is None:
        inverse = jnp.exp(-soft_maximum(-logarithms, sharpness, axis=0) - longest)
    else:
        size, sides = under
        none = sides <= 0
        inverse = jnp.where(none, 0, sign * size / jnp.where(none, 1, jnp.exp(longest) * sides))
    return 1 / positive_part(inverse, softness)


def _largest_angle(
    degrees: Float[Array, "f k"], is_inner: Bool[Array, "f k"], sharpness
) -> SmoothOfCells:
    unit = 90 / sharpness
    return _soft_maximum_where(jnp.sqrt(degrees**2 + unit**2) - unit, is_inner, 1 / unit)


def _soft_maximum_where(
    values: Float[Array, "m k"], counts: Bool[Array, "m k"], sharpness
) -> SmoothOfCells:
    number = jnp.sum(counts, axis=0)
    weights = jnp.where((number > 0)[None], counts, True).astype(values.dtype)
    largest = jax.scipy.special.logsumexp(sharpness * values, b=weights, axis=0)
    return jnp.where(number > 0, (largest - jnp.log(jnp.maximum(number, 1))) / sharpness, 0)


@checked
def soft_maximum(
    values: Real[ArrayLike, "..."] | Sequence[Any], sharpness: Any = 50.0, axis: int | None = None
) -> Float[Array, "..."]:
    """Computes a smooth stand-in for the largest value.

    It is log(mean(exp(sharpness values))) / sharpness, below the largest value by log(count) /
    sharpness at most, and equal to values that are all equal. Its derivative is spread over the
    values near the largest.

    **Arguments:**

    - `values`: an array.
    - `sharpness`: positive, in the inverse unit of `values`, default 50. A larger value comes
      closer to the maximum.
    - `axis`: the axis along which to take it. Default: all values.

    **Raises:** `ValueError` for a sharpness that is not positive and finite, and an axis that is
    not there.
    """
    values = jnp.asarray(values)
    sharpness = number("sharpness", 0)(sharpness)
    if axis is not None and not -values.ndim <= axis < values.ndim:
        raise ValueError(
            f"`axis` is {axis}; `values` have {values.ndim} axes, 0 to {values.ndim - 1}."
        )
    count = values.size if axis is None else values.shape[axis]
    largest = jax.scipy.special.logsumexp(sharpness * values, axis=axis)
    return (largest - jnp.log(jnp.asarray(count, values.dtype))) / sharpness


def positive_part(x: Float[Array, "..."], softness: Any) -> Float[Array, "..."]:
    """(x + sqrt(x^2 + softness^2)) / 2, positive and increasing everywhere: the regularised
    determinant of Garanzha et al., Foldover-free maps in 50 lines of code, ACM Trans. Graph. 40,
    2021.
    """
    root = jnp.sqrt(x**2 + softness**2)
    return jnp.where(x >= 0, (x + root) / 2, softness**2 / (2 * (root + jnp.abs(x))))
