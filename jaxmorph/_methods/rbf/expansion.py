"""The expansion of a field in radial functions and a polynomial (eqs. 1, 3 and 4)."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.lax.linalg import triangular_solve
from jaxtyping import Array, Float, Int

from ..._host.package.errors import place_of, warn
from ..._host.package.rounding import Tree
from ..._host.surface.neighbours import nearly_coincident
from ..._kernels.compile import compiled
from ..._kernels.module import Module
from ..base import AbstractField, Flag, Point, Scalar, matmul
from ..blocks import map_rows
from . import system
from .basis import AbstractBasis, Columns, Sources, Weights
from .iterations import Cardinals, iterated, precondition


class RBFFactors(eqx.Module):
    """Sources in coordinates of order one, and the factored system (eq. 3) of t = s + p equations.
    `order` are the rows as pivoted. With `cardinals`, the factored system is that of the first
    sources.
    """

    sources: Sources
    centre: Point
    scale: Scalar
    lu: Float[Array, "t t"]
    order: Int[Array, " t"]
    cardinals: Cardinals | None = None

    @property
    def places(self) -> Float[np.ndarray, "s d"]:
        """The sources' own coordinates, on the host."""
        sources, scale, centre = map(np.asarray, (self.sources, self.scale, self.centre))
        return sources / scale + centre[None]

    def solve(self, values: Columns) -> Float[Array, "t k"]:
        """Solves for values at the sources, or at the first of them; other rows are zero."""
        right = jnp.pad(values, ((0, len(self.lu) - len(values)), (0, 0)))
        half = triangular_solve(
            self.lu, right[self.order], left_side=True, lower=True, unit_diagonal=True
        )
        return triangular_solve(self.lu, half, left_side=True, lower=False)


class RBFField(AbstractField):
    basis: AbstractBasis
    degree: int | None = eqx.field(static=True)
    sources: Sources
    centre: Point
    scale: Scalar
    beta: Weights
    alpha: Float[Array, "k p"]

    def __call__(self, x, ids):
        return self.evaluate(x[None], ids)[0]

    @property
    def varying(self):
        return self.beta, self.alpha

    @property
    def block_size(self) -> int | None:
        return (
            None
            if system.is_fused(self._phi, self.sources.dtype)
            else system.block_size(len(self.sources))
        )

    @property
    def _phi(self) -> system.Radial:
        return system.Radial(self.basis, self.scale)

    def evaluate(self, points, ids):
        if self.block_size is None:
            x = (points - self.centre[None]) * self.scale
            terms = system.polynomial(x, self.degree)[:, :, None] * self.alpha.T[None]
            return system.fused(self._phi, self.sources, self.beta.T, x) + terms.sum(axis=1)
        x = system.in_rows(points - self.centre[None], self.scale)
        terms = system.polynomial(x.T, self.degree).T
        tail = sum(
            (self.alpha[:, k, None] * term[None] for k, term in enumerate(terms)),
            start=jnp.zeros_like(x),
        )
        return (system.kernel_sum(self._phi, self.sources, self.beta, x) + tail).T


class Expansion(Module):
    """Basis, degree and ridge. Sources and points have coordinates in units of 1 / `scale`."""

    basis: AbstractBasis
    degree: int | None = eqx.field(static=True)
    ridge: float = eqx.field(static=True)

    @property
    def sign(self) -> int:
        """The side of the definite part: phi is negative definite where its order is one."""
        return -1 if self.basis.min_degree == 0 else 1

    @property
    def at_sources(self) -> float:
        """The ridge, with its sign: the addition to phi at each source."""
        return self.sign * self.ridge

    def kernel(self, r2, scale):
        kernel = system.Radial(self.basis, scale)(r2)
        return (
            kernel + self.at_sources * jnp.eye(len(kernel), dtype=kernel.dtype)
            if self.ridge
            else kernel
        )

    def factored(self, sources, scale):
        tail = system.polynomial(sources, self.degree)
        # One reduction, not a sum of d terms: XLA's CPU backend (jaxlib 0.10.2) merges d terms
        # wrongly with the transposition that LAPACK asks for, and the jitted gradient with respect
        # to one coordinate of the sources is wrong or NaN.
        distances = jnp.sum((sources[:, None] - sources[None]) ** 2, axis=-1)
        kernel = self.kernel(distances, scale)
        corner = jnp.zeros((tail.shape[1],) * 2, kernel.dtype)
        matrix = jnp.block([[kernel, tail], [tail.T, corner]])  # eq. (3)
        lu, _, order = jax.lax.linalg.lu(matrix)
        return lu, order

    def rows(self, sources, scale, points: Float[Array, "k d"]) -> Float[Array, "k t"]:
        kernel = system.Radial(self.basis, scale)(system.squared_distances(points, sources))
        return jnp.concatenate([kernel, system.polynomial(points, self.degree)], axis=1)

    def field(self, factors: RBFFactors, values: Columns, dtype) -> RBFField:
        """Makes the field with given values at the sources, in a given precision. Traced."""
        solved = (
            factors.solve(values) if factors.cardinals is None else self._iterated(factors, values)
        )
        weights = solved.astype(dtype)
        beta = weights.T[:, : len(factors.sources)]
        alpha = weights.T[:, len(factors.sources) :]
        sources, centre, scale = (
            leaf.astype(dtype) for leaf in (factors.sources, factors.centre, factors.scale)
        )
        return RBFField(self.basis, self.degree, sources, centre, scale, beta, alpha)

    def _iterated(self, factors: RBFFactors, values: Columns) -> Float[Array, "t k"]:
        count = len(factors.sources)
        tail = system.polynomial(factors.sources, self.degree)
        right = jnp.pad(values, ((0, tail.shape[1]), (0, 0)))

        def product(x):
            beta = x[:count]
            alpha = x[count:]
            return jnp.concatenate(
                [self._times_kernel(factors, beta) + matmul(tail, alpha), matmul(tail.T, beta)]
            )

        constant, fixed = jax.lax.stop_gradient((self, factors))

        def solve(_, right):
            rows = fixed.cardinals
            assert rows is not None
            return iterated(
                lambda beta: jax.lax.platform_dependent(
                    fixed, beta, cpu=constant._of_pairs, default=constant._times_kernel
                ),
                lambda rest: precondition(
                    rows, lambda first: fixed.solve(first)[: len(first)], rest
                ),
                system.polynomial(fixed.sources, self.degree),
                rows.tolerance,
                right,
            )

        return jax.lax.custom_linear_solve(product, right, solve, symmetric=True)

    def _times_kernel(self, factors: RBFFactors, beta: Columns) -> Columns:
        sources = factors.sources
        phi = system.Radial(self.basis, factors.scale)

        def of_block(points):
            return system.kernel_sum(
                phi, sources, beta.T, system.in_rows(points, jnp.ones((), points.dtype))
            ).T

        if system.is_fused(phi, sources.dtype):
            return self._with_ridge(system.fused(phi, sources, beta, sources), beta)
        return self._with_ridge(
            map_rows(jax.checkpoint(of_block), sources, system.block_size(len(sources))), beta
        )

    def _of_pairs(self, factors: RBFFactors, beta: Columns) -> Columns:
        """Multiplies by the kernel's matrix, on a CPU by half of its entries."""
        product = system.symmetric_kernel_sum(
            system.Radial(self.basis, factors.scale), factors.sources, beta.T
        ).T
        return self._with_ridge(product, beta)

    def _with_ridge(self, product, beta):
        return product + self.at_sources * beta if self.ridge else product


# relative changes of displacements by rounding: an error, a warning, one in float32
USELESS = 3e-2
NOTICEABLE = 1e-6
NOTICEABLE_SINGLE = 1e-3
# distance of two sources, relative to the distance of sources around, that is worth a warning
NEAR = 1e-3


def is_sound(error: float, dtype, message: Callable[[str], str], otherwise: str) -> bool:
    """Raises or warns where rounding changes displacements by an `error` relative to their size:
    `message` of a fault, which is `otherwise` where the error is not finite.
    """
    if error <= (NOTICEABLE if jnp.finfo(dtype).bits == 64 else NOTICEABLE_SINGLE):
        return True
    fault = f"ill-conditioned: rounding changes the displacements by {error:.1g} of their size"
    text = message(fault if np.isfinite(error) else otherwise)
    if not error <= USELESS:  # NaN too
        raise ValueError(text)
    warn(text)
    return False


@compiled
def rounding(expansion: Expansion, factors: RBFFactors, values: Columns) -> Scalar:
    """Measures how much rounding changes the interpolation, at the sources and between them, by one
    step of iterative refinement: the field of what the first field misses at the sources. It is
    infinite for a system without a solution.
    """
    sources = factors.sources
    count = len(values)

    def field(weights, points):
        return map_rows(
            lambda part: matmul(expansion.rows(sources, factors.scale, part), weights), points, 1024
        )

    first = factors.solve(values)
    missed = values - field(first, sources) - expansion.at_sources * first[:count]
    between = [(sources + jnp.roll(sources, shift, axis=0)) / 2 for shift in (1, 1 + count // 2)]
    moved = field(factors.solve(missed), jnp.concatenate([sources, *between]))
    change = jnp.abs(jnp.concatenate([missed, moved])).max()
    return jnp.where(jnp.diagonal(factors.lu).all(), change, jnp.inf)


@compiled
def is_solved(expansion: Expansion, factors: RBFFactors, values: Columns) -> Flag:
    return jnp.isfinite(expansion.field(factors, values, values.dtype).beta).all()


def nearest_two(sources: np.ndarray) -> str:
    if len(sources) < 2:
        return ""
    distance, nearest = map(np.asarray, Tree(sources).query(sources, k=2))
    first = distance[:, 1].argmin()
    pair = " and ".join(
        str(tuple(float(f"{x:.6g}") for x in sources[i])) for i in (first, nearest[first, 1])
    )
    return f"; the nearest two sources, {pair}, are {distance[first, 1]:.3g} apart"


def warn_of_close(nodes: Float[np.ndarray, "s d"], radius: float, method: str) -> None:
    first, second = nearly_coincident(nodes, radius, NEAR)
    if len(first):
        distance = np.linalg.norm(nodes[first[0]] - nodes[second[0]])
        warn(
            f"{len(first)} surface nodes nearly coincide with others, the nearest two "
            f"{distance:.3g} apart near "
            f"({place_of(nodes[first[0]])}). Where such nodes move differently, {method} moves "
            "nodes around them by "
            f"{1 / NEAR:.0f} times the difference, or more. Merge them, or check the motion by "
            "jm.inspect."
        )
