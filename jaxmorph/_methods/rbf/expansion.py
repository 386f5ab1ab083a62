"""The expansion of a field in radial functions and a polynomial (eqs. 1, 3 and 4)."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax.linalg import triangular_solve
from jaxtyping import Array, Float, Int

from ..._kernels.module import Module
from ..base import AbstractField
from ..blocks import map_rows
from .basis import AbstractBasis
from .iterations import Cardinals, ConjugateGradients, precondition
from .system import (
    Radial,
    block_size,
    fused,
    in_rows,
    is_fused,
    kernel_sum,
    polynomial,
    squared_distances,
    symmetric_kernel_sum,
)


class RBFFactors(eqx.Module):
    """Sources in coordinates of order one, and the factored system (eq. 3) of t = s + p equations.

    `order` are the rows as the pivots have them. With `cardinals`, the factored system is that of
    the first sources alone.
    """

    sources: Float[Array, "s d"]
    centre: Float[Array, " d"]
    scale: Float[Array, ""]
    lu: Float[Array, "t t"]
    order: Int[Array, " t"]
    cardinals: Cardinals | None = None

    def solve(self, values: Float[Array, "t k"]) -> Float[Array, "t k"]:
        half = triangular_solve(self.lu, values[self.order], left_side=True, lower=True, unit_diagonal=True)
        return triangular_solve(self.lu, half, left_side=True, lower=False)


class RBFField(AbstractField):
    """Evaluates eq. (4) at one point."""

    basis: AbstractBasis
    degree: int | None = eqx.field(static=True)
    sources: Float[Array, "s d"]
    centre: Float[Array, " d"]
    scale: Float[Array, ""]
    beta: Float[Array, "k s"]
    alpha: Float[Array, "k p"]

    def __call__(self, x, ids):
        x = (x - self.centre) * self.scale
        phi = self._phi(squared_distances(self.sources, x[None])[:, 0])
        terms = polynomial(x[None], self.degree)[0]
        return jnp.matmul(self.beta, phi, precision="highest") + jnp.matmul(self.alpha, terms, precision="highest")

    @property
    def block_size(self) -> int | None:
        return None if is_fused(self._phi, self.sources.dtype) else block_size(len(self.sources))

    @property
    def _phi(self) -> Radial:
        return Radial(self.basis, self.scale)

    def evaluate(self, points, ids):
        if self.block_size is None:
            x = (points - self.centre[None]) * self.scale
            terms = polynomial(x, self.degree)[:, :, None] * self.alpha.T[None]
            return fused(self._phi, self.sources, self.beta.T, x) + terms.sum(axis=1)
        x = in_rows(points - self.centre[None], self.scale)
        terms = polynomial(x.T, self.degree).T
        tail = sum((self.alpha[:, k, None] * term[None] for k, term in enumerate(terms)), start=jnp.zeros_like(x))
        return (kernel_sum(self._phi, self.sources, self.beta, x) + tail).T


class Expansion(Module):
    """Radial functions and a polynomial without coefficients: basis, degree and ridge.

    Sources and points are in scaled coordinates; `scale` is the factor that scaled them.
    """

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
        kernel = Radial(self.basis, scale)(r2)
        return kernel + self.at_sources * jnp.eye(len(kernel), dtype=kernel.dtype) if self.ridge else kernel

    def factored(self, sources, scale):
        """Factors the dense system of some sources.

        It returns the factors, and the rows in the order of the pivots.
        """
        tail = polynomial(sources, self.degree)
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
        kernel = Radial(self.basis, scale)(squared_distances(points, sources))
        return jnp.concatenate([kernel, polynomial(points, self.degree)], axis=1)

    def field(self, factors: RBFFactors, values: Float[Array, "s k"], dtype) -> RBFField:
        """Makes the field with given values at the sources, in a given precision. Traced."""
        terms = polynomial(factors.sources[:1], self.degree).shape[1]
        right = jnp.concatenate([values, jnp.zeros((terms, values.shape[1]), values.dtype)])
        solve = factors.solve if factors.cardinals is None else lambda right: self._iterated(factors, right)
        weights = solve(right).astype(dtype)
        beta, alpha = weights.T[:, : len(factors.sources)], weights.T[:, len(factors.sources) :]
        sources, centre, scale = (leaf.astype(dtype) for leaf in (factors.sources, factors.centre, factors.scale))
        return RBFField(self.basis, self.degree, sources, centre, scale, beta, alpha)

    def _iterated(self, factors: RBFFactors, right: Float[Array, "t k"]) -> Float[Array, "t k"]:
        count, tail = len(factors.sources), polynomial(factors.sources, self.degree)

        def product(x):
            beta, alpha = x[:count], x[count:]
            top = self._times_kernel(factors, beta) + jnp.matmul(tail, alpha, precision="highest")
            return jnp.concatenate([top, jnp.matmul(tail.T, beta, precision="highest")])

        constant, constant_factors = jax.lax.stop_gradient((self, factors))
        iterations = constant.iterations(constant_factors)
        return jax.lax.custom_linear_solve(product, right, lambda _, right: iterations.solve(right), symmetric=True)

    def iterations(self, factors: RBFFactors) -> ConjugateGradients:
        cardinals = factors.cardinals
        assert cardinals is not None
        first = len(factors.sources) - len(cardinals.earlier)

        def inverse_of_first(values):
            padded = jnp.pad(values, ((0, len(factors.lu) - first), (0, 0)))
            return factors.solve(padded)[:first]

        return ConjugateGradients(
            lambda beta: self._times_kernel_quickly(factors, beta),
            lambda residual: precondition(cardinals, inverse_of_first, residual),
            polynomial(factors.sources, self.degree),
            cardinals.tolerance,
        )

    def _times_kernel(self, factors: RBFFactors, beta: Float[Array, "s k"]) -> Float[Array, "s k"]:
        """Multiplies by the kernel's matrix, block by block. To be differentiated."""
        sources, phi = factors.sources, Radial(self.basis, factors.scale)

        def of_block(points):
            return kernel_sum(phi, sources, beta.T, in_rows(points, jnp.ones((), points.dtype))).T

        if is_fused(phi, sources.dtype):
            product = fused(phi, sources, beta, sources)
        else:
            product = map_rows(jax.checkpoint(of_block), sources, block_size(len(sources)))
        return product + self.at_sources * beta if self.ridge else product

    def _times_kernel_quickly(self, factors: RBFFactors, beta: Float[Array, "s k"]) -> Float[Array, "s k"]:
        """Multiplies by the kernel's matrix in half the time on a CPU.

        It evaluates each function of two sources once.
        """

        def of_pairs(factors, beta):
            phi = Radial(self.basis, factors.scale)
            product = symmetric_kernel_sum(phi, factors.sources, beta.T).T
            return product + self.at_sources * beta if self.ridge else product

        return jax.lax.platform_dependent(factors, beta, cpu=of_pairs, default=self._times_kernel)
