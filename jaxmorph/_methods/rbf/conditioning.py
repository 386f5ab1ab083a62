"""Conditioning of the interpolation system (eq. 3), measured by `prepare`."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Array, Bool, Float, Int

from ..._host.package.errors import place_of, warn
from ..._host.package.rounding import Tree
from ..._host.surface.neighbours import nearly_coincident
from ..._kernels.compile import compiled
from .expansion import Expansion, RBFFactors
from .iterations import LIMIT, PROMISING, TRIAL

SUSPICIOUS = 0.1
"""Rounding of the residual after a few steps, from which on `prepare` takes all steps.

It is relative to the rounding that makes a field NaN.
"""

USELESS, NOTICEABLE, NOTICEABLE_SINGLE = 3e-2, 1e-6, 1e-3
"""Relative changes of displacements by rounding: an error, a warning, one in float32."""

NEAR = 1e-3
"""Distance of two sources, relative to the distance of sources around, that is worth a warning."""


def is_noticeable(error: float, dtype) -> bool:
    """Checks whether a change of displacements by rounding is worth a warning. NaN is."""
    return not error <= (NOTICEABLE if jnp.finfo(dtype).bits == 64 else NOTICEABLE_SINGLE)


def rounding(expansion: Expansion, factors: RBFFactors, values: np.ndarray) -> float:
    """Measures how much rounding changes the interpolation of `values` (s, d). Host.

    The change is taken at the sources and between them.

    It takes one step of iterative refinement: the field of what the first field misses at the
    sources. It is infinite for a system without a solution.
    """
    lu, order, sources, scale = map(np.asarray, (factors.lu, factors.order, factors.sources, factors.scale))
    count, block = len(values), min(1024, len(values))
    if not np.diagonal(lu).all():
        return np.inf

    def weights(values):
        rhs = np.concatenate([values, np.zeros((len(lu) - count, values.shape[1]), lu.dtype)])
        half = scipy.linalg.solve_triangular(lu, rhs[order], lower=True, unit_diagonal=True, check_finite=False)
        return scipy.linalg.solve_triangular(lu, half, check_finite=False)

    def field(weights, points):
        result = np.empty((len(points), weights.shape[1]), lu.dtype)
        for start in np.minimum(np.arange(0, len(points), block), len(points) - block):
            part = points[start : start + block]
            result[start : start + block] = np.asarray(_system_rows(expansion, sources, scale, part)) @ weights
        return result

    with np.errstate(all="ignore"):
        first = weights(values)
        missed = values - field(first, sources)
        if expansion.ridge:
            missed = missed - expansion.at_sources * first[:count]
        between = [(sources + np.roll(sources, shift, axis=0)) / 2 for shift in (1, 1 + count // 2)]
        moved = field(weights(missed), np.concatenate([sources, *between]))
        return float(np.abs(np.concatenate([missed, moved])).max())


@compiled
def _system_rows(expansion: Expansion, sources, scale, points):
    return expansion.rows(sources, scale, points)


def fault_of_iterations(expansion: Expansion, factors: RBFFactors, values: np.ndarray) -> str:
    """Describes why conjugate gradients will not converge; empty if they promise to."""
    cardinals = factors.cardinals
    assert cardinals is not None
    left, count, rounding = map(float, _left_after_trial(expansion, factors, jnp.asarray(values)))
    steps = count * np.log(float(cardinals.tolerance)) / np.log(max(left, 1e-300)) if left < 1 else np.inf
    fault = "too ill-conditioned for Iterative()"
    if not steps <= LIMIT:
        return f"{fault}: an error of {left:.1g} is left after {count:.0f} steps"
    # in single precision rounding sets a floor that a few steps do not show
    single = cardinals.weights.dtype != np.float64
    if (single or not rounding <= SUSPICIOUS) and not _is_solved(expansion, factors, jnp.asarray(values)):
        return fault + (" in single precision" if single else ": rounding keeps the field from its sources")
    return ""


@compiled
def _left_after_trial(
    expansion: Expansion, factors: RBFFactors, values: Float[Array, "s k"]
) -> tuple[Float[Array, ""], Int[Array, ""], Float[Array, ""]]:
    """Takes some steps; returns the share of the error that is left, and their number.

    The error is measured in the norm of the basis. The third number is what rounding has made of
    the residual, over what makes a field NaN.
    """
    iterations = expansion.iterations(factors)
    trial = dataclasses.replace(iterations, tolerance=jnp.asarray(PROMISING, values.dtype))
    size, start = jnp.abs(values).max(), iterations.without_polynomial(values)
    now = trial.improve(start, size, TRIAL)
    left = jnp.sqrt(jnp.abs(now.left / jnp.where(now.energy == 0, 1, now.energy)).max())
    is_polynomial = jnp.abs(now.residual).max() <= iterations.tolerance * size
    rounding = iterations.rounding(now, start) / (iterations.allowed * jnp.where(size == 0, 1, size))
    return jnp.where(is_polynomial, 0, left), now.count, rounding


@compiled
def _is_solved(expansion: Expansion, factors: RBFFactors, values: Float[Array, "s k"]) -> Bool[Array, ""]:
    return jnp.isfinite(expansion.field(factors, values, values.dtype).beta).all()


def nearest_two(sources: np.ndarray) -> str:
    """Describes the two sources that are nearest to each other, as the end of a sentence."""
    if len(sources) < 2:
        return ""
    distance, nearest = map(np.asarray, Tree(sources).query(sources, k=2))
    first = distance[:, 1].argmin()
    pair = " and ".join(str(tuple(float(f"{x:.6g}") for x in sources[i])) for i in (first, nearest[first, 1]))
    return f"; the nearest two sources, {pair}, are {distance[first, 1]:.3g} apart"


def warn_of_close_sources(method: str, factors: RBFFactors, values: Float[np.ndarray, "s k"]) -> None:
    """Warns of sources that nearly coincide for the size of what moves."""
    places, scale, centre = map(np.asarray, (factors.sources, factors.scale, factors.centre))
    body = places[values.any(axis=1)]
    extent = float(np.linalg.norm(np.ptp(body, axis=0))) if len(body) else 0.0
    warn_of_close(places / scale + centre, extent / float(scale), method)


def warn_of_close(nodes: Float[np.ndarray, "s d"], radius: float, method: str) -> None:
    first, second = nearly_coincident(nodes, radius, NEAR)
    if len(first):
        distance = np.linalg.norm(nodes[first[0]] - nodes[second[0]])
        warn(
            f"{len(first)} surface nodes nearly coincide with others, the nearest two {distance:.3g} apart near "
            f"({place_of(nodes[first[0]])}). Where such nodes move differently, {method} moves nodes around them by "
            f"{1 / NEAR:.0f} times the difference, or more. Merge them, or check the motion by jm.inspect.",
        )
