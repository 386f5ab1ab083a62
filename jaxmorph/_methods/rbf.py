"""Radial basis function interpolation from a reduced set of sources (sections 2.1 and 2.2 of the paper, eqs. 1 to 4)."""

import warnings

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._basis import AbstractBasis, ThinPlateSpline
from .._host.reduction import AbstractReduction, AllPoints, KDTree, drop_close, roundoff
from .._product import few_rows_times
from .base import BLOCK, AbstractField, AbstractMethod, Surface

KERNEL_BLOCK = 2**17
"""Elements of the kernel that a block of points makes: 1 MiB in float64, which stays in a core's own cache."""


class RBF(AbstractMethod):
    """c(x) = p(x) + sum_j beta_j phi(|x - x_j|), with sources x_j among the surface's nodes (eq. 1).

    Moving and fixed nodes are reduced apart. `degree` is that of the polynomial p: None (no polynomial), 0, or 1, which
    reproduces rigid and affine motions. With `AllPoints()` for both reductions it is the classic method, exact on the
    surface; with fewer sources the surface follows approximately, and `SurfaceReconstruction` adds what is missing.

    The dense system (eq. 3) is factored once per plan, in float64 where JAX's x64 mode is on. `prepare` raises
    `ValueError` where the sources cannot determine the polynomial (all in one plane) or the system is singular.
    """

    basis: AbstractBasis = eqx.field(default_factory=ThinPlateSpline)
    reduction: AbstractReduction = eqx.field(static=True, default=KDTree(64))
    fixed_reduction: AbstractReduction = eqx.field(static=True, default=KDTree(16))
    degree: int | None = eqx.field(static=True, default=1)

    def __check_init__(self):
        if self.degree not in (None, 0, 1):
            raise ValueError(f"`degree` of the polynomial is None, 0 or 1, not {self.degree!r}.")
        if self._below_min_degree:
            warnings.warn(
                f"{type(self.basis).__name__} without a polynomial of degree {self.basis.min_degree} may give a singular system.",
                stacklevel=3,
            )

    @property
    def _below_min_degree(self) -> bool:
        order = {None: -1, 0: 0, 1: 1}
        return order[self.degree] < order[self.basis.min_degree]

    @property
    def exact(self) -> bool:
        return isinstance(self.reduction, AllPoints) and isinstance(self.fixed_reduction, AllPoints)

    def connect(self, surface: Surface, points):
        sources = surface.reduced(self.reduction, self.fixed_reduction)
        sources = drop_close(surface.points, sources, roundoff(surface.points))
        self._check_spread(surface.points[sources])
        return sources.astype(np.int32), None

    def _check_spread(self, sources: np.ndarray) -> None:
        if len(sources) == 0:
            raise ValueError("there are no sources: `moving` is empty.")
        if self.degree != 1:
            return
        dimension = sources.shape[1]
        spread = (
            np.linalg.svd(sources - sources.mean(axis=0), compute_uv=False) if len(sources) > dimension else np.zeros(1)
        )
        if len(sources) <= dimension or spread[-1] <= 1e-10 * spread[0]:
            raise ValueError(
                f"the {len(sources)} sources do not span {dimension} dimensions, so a linear polynomial is not determined. "
                "Add fixed nodes (far field), more leaves, or use RBF(degree=0) with a basis that allows it."
            )

    def matched(self, ids):
        return ids

    def fit(self, ids: Int[Array, " s"], surface):
        points = surface[ids].astype(jnp.promote_types(surface.dtype, jnp.result_type(float)))
        centre = points.mean(axis=0)
        scale = 1 / jnp.abs(points - centre).max()
        centre, scale = (
            jax.lax.stop_gradient((centre, scale)) if not self._below_min_degree else (centre, jnp.ones_like(scale))
        )
        sources = (points - centre) * scale
        tail = polynomial(sources, self.degree)
        # One reduction, not a sum of d terms: XLA's CPU backend (jaxlib 0.10.2) merges those wrongly with the transposition
        # that LAPACK asks for, and the jitted gradient with respect to one coordinate of the sources is wrong or NaN.
        distances = jnp.sum((sources[:, None] - sources[None]) ** 2, axis=-1)
        kernel = self._phi(distances, scale)
        corner = jnp.zeros((tail.shape[1],) * 2, kernel.dtype)
        matrix = jnp.block([[kernel, tail], [tail.T, corner]])  # eq. (3)
        lu, pivots = jax.scipy.linalg.lu_factor(matrix)
        return RBFFactors(sources, centre, scale, lu, pivots)

    def _phi(self, r2, scale):
        return self.basis(r2 if self.basis.scale_free else r2 / scale**2)

    def check(self, factors: "RBFFactors") -> None:
        lu = np.asarray(factors.lu)
        diagonal = np.abs(np.diagonal(lu))
        eps = np.finfo(lu.dtype).eps
        if not np.isfinite(lu).all() or diagonal.min() <= eps**2 * diagonal.max():
            raise ValueError(
                f"the interpolation matrix of {len(factors.sources)} sources is singular. Use a larger `separation` in the "
                "reduction, a smaller radius of the basis, or the polynomial that the basis needs."
            )

    def field(self, ids, factors: "RBFFactors", surface, u):
        values = u[ids].astype(factors.lu.dtype)
        terms = factors.lu.shape[0] - len(factors.sources)
        rhs = jnp.concatenate([values, jnp.zeros((terms, u.shape[1]), values.dtype)])
        weights = jax.scipy.linalg.lu_solve((factors.lu, factors.pivots), rhs).astype(u.dtype)
        beta, alpha = weights.T[:, : len(factors.sources)], weights.T[:, len(factors.sources) :]
        sources, centre, scale = (leaf.astype(u.dtype) for leaf in (factors.sources, factors.centre, factors.scale))
        return RBFField(self, sources, centre, scale, beta, alpha)


class RBFFactors(eqx.Module):
    """Sources in coordinates of order one, and the factored system (eq. 3)."""

    sources: Float[Array, "s d"]
    centre: Float[Array, " d"]
    scale: Float[Array, ""]
    lu: Float[Array, "s+p s+p"]
    pivots: Int[Array, " s+p"]


class RBFField(AbstractField):
    """eq. (4) at one point."""

    rbf: RBF
    sources: Float[Array, "s d"]
    centre: Float[Array, " d"]
    scale: Float[Array, ""]
    beta: Float[Array, "d s"]
    alpha: Float[Array, "d p"]

    def __call__(self, x, ids):
        x = (x - self.centre) * self.scale
        phi = self.rbf._phi(_squared_distances(self.sources, x[None])[:, 0], self.scale)
        terms = polynomial(x[None], self.rbf.degree)[0]
        return jnp.matmul(self.beta, phi, precision="highest") + jnp.matmul(self.alpha, terms, precision="highest")

    @property
    def block(self) -> int:
        return min(BLOCK, max(64, KERNEL_BLOCK // len(self.sources) // 64 * 64))

    def evaluate(self, points, ids):
        """Distances and kernel in one loop along the points, then a product with the weights.

        The loop becomes vectors only where each coordinate lies in a row of its own. A product of matrices lays the points
        out so and is not merged into the loop, as a transposition would be.
        """
        stretch = self.scale * jnp.eye(points.shape[1], dtype=points.dtype)
        x = jnp.matmul(stretch, (points - self.centre).T, precision="highest")
        phi = self.rbf._phi(_squared_distances(self.sources, x.T), self.scale)
        terms = polynomial(x.T, self.rbf.degree).T
        tail = sum((self.alpha[:, k, None] * term for k, term in enumerate(terms)), start=jnp.zeros_like(x))
        return (few_rows_times(self.beta, phi) + tail).T


def polynomial(points: Float[Array, "k d"], degree: int | None) -> Float[Array, "k p"]:
    """The monomials of eq. (1) at each point: none, 1, or 1, x1, x2(, x3)."""
    one = jnp.ones((len(points), 1), points.dtype)
    return {None: one[:, :0], 0: one, 1: jnp.concatenate([one, points], axis=1)}[degree]


def _squared_distances(a: Float[Array, "k d"], b: Float[Array, "s d"]) -> Float[Array, "k s"]:
    """By direct differences: the expanded form loses the small distances that a boundary layer is made of."""
    return sum((a[:, None, k] - b[None, :, k]) ** 2 for k in range(a.shape[1]))  # pyright: ignore[reportReturnType]
