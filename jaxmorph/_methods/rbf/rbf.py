"""Radial basis function interpolation from a reduced set of sources (sections 2.1 and 2.2 of the paper, eqs. 1 to 4).

The classic method on all nodes of the surface is that of de Boer, van der Schoot and Bijl (Computers and Structures 85, 2007).
Rendall and Allen (Journal of Computational Physics 228, 2009) reduced its sources.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
import scipy.spatial
from jax.lax.linalg import triangular_solve
from jaxtyping import Array, Bool, Float, Int

from ..._host.linear.ordering import far_to_near
from ..._host.package.arguments import between, checked, shown
from ..._host.package.errors import place_of, warn
from ..._host.package.rounding import roundoff
from ..._host.sources.graded import Graded
from ..._host.sources.reduction import AbstractReduction, AllPoints, KDTree, drop_close
from ..._host.surface.neighbours import nearly_coincident
from ..._kernels.compile import compiled
from ..._kernels.values import largest
from ..base import AbstractField, AbstractMethod, Surface, check_kind
from ..blocks import map_rows
from .basis import AbstractBasis, ThinPlateSpline
from .fused import Radial, fused, is_fused
from .solvers import (
    LIMIT,
    PROMISING,
    ROUNDINGS,
    TRIAL,
    Cardinals,
    ConjugateGradients,
    Direct,
    Iterative,
    OrderedIds,
    local_weights,
    precondition,
)
from .system import block_size, in_rows, kernel_sum, polynomial, squared_distances, symmetric_kernel_sum

MANY = 8192
"""Sources beyond which the system is solved by iterations."""

SUSPICIOUS = 0.1
"""Rounding of the residual after a few steps, over what makes a field NaN, from which on `prepare` takes all steps."""

USELESS, NOTICEABLE, NOTICEABLE_SINGLE = 1e-2, 1e-6, 1e-3
"""Changes of displacements by rounding, relative to them, that are an error, and that are warned of (solved in float32)."""


NEAR = 1e-3
"""Distance of two sources, relative to those around them, below which a difference of their displacements is told."""


class RBF(AbstractMethod):
    """Interpolates by radial basis functions: c(x) = p(x) + sum_j beta_j phi(|x - x_j|), eq. (1).

    A source x_j is a node of the surface that carries a function: a control point, or centre, of the field. Moving and fixed
    nodes are reduced to sources apart. With `AllPoints()` for both reductions it is the classic method, exact on the surface.
    With fewer sources the surface follows approximately, and fixed nodes that are no sources move too;
    `SurfaceReconstruction` adds what is missing.

    **Arguments:**

    - `basis`: the function phi. Default `ThinPlateSpline()`, which has no parameter.
    - `reduction`, `fixed_reduction`: choose the sources among the moving and among the fixed nodes. Defaults `KDTree(64)` and
      `Graded()`. More sources follow the surface closer, and cost more.
    - `degree`: degree of the polynomial p: None (no polynomial), 0, or 1, which reproduces rigid and affine motions. Default 1.
    - `ridge`: added to the matrix at each source, in units of phi at the sources' extent (of phi itself for a basis with a
      radius). The field then smooths noise and misses the sources. Default 0.
    - `solver`: `Direct()` factors the dense system once per plan, `Iterative()` solves for each displacement without the
      matrix. Default None: `Iterative()` for more than 8,192 sources.

    **Raises:** `ValueError` for another degree or a negative ridge. `prepare` raises it where the sources cannot determine
    the polynomial (all in one plane). It also does so if rounding changes displacements by more than 1 %, because the radius
    is wide or sources nearly coincide. It warns from 1e-6 on (1e-3 without x64).

    The system (eq. 3) is solved in float64 if JAX's x64 mode is on. The effect of rounding on the dense solve is measured.
    A smooth motion is interpolated, and so is what the result misses at the sources. The largest value of this second field,
    at the sources and between them, is the error. A condition number would not do, and scaling the mesh changes it. Its
    reciprocal is 1e-15 for a sound Wendland C2 function of the size of an airfoil's mesh (error 3e-7), and also for a useless
    Gaussian (error 0.1).
    """

    basis: AbstractBasis = eqx.field(default_factory=ThinPlateSpline)
    reduction: AbstractReduction = eqx.field(static=True, default=KDTree(64))
    fixed_reduction: AbstractReduction = eqx.field(static=True, default=Graded())
    degree: int | None = eqx.field(static=True, default=1)
    ridge: float = eqx.field(static=True, default=0.0)
    solver: Direct | Iterative | None = None

    def __check_init__(self):
        if not (self.solver is None or isinstance(self.solver, Direct | Iterative)):
            raise ValueError(f"`solver` must be jm.Direct() or jm.Iterative(), not {shown(self.solver)}.")
        check_kind(self.basis, AbstractBasis, "basis", "jm.ThinPlateSpline()")
        check_kind(self.reduction, AbstractReduction, "reduction", "jm.KDTree(64)")
        check_kind(self.fixed_reduction, AbstractReduction, "fixed_reduction", "jm.KDTree(16)")
        if not (self.degree is None or (type(self.degree) is int and self.degree in (0, 1))):
            raise ValueError(f"`degree` of the polynomial is None, 0 or 1, not {self.degree!r}.")
        between("ridge", self.ridge, 0, ends="[)")
        if self._below_min_degree:
            warn(
                f"{type(self.basis).__name__} without a polynomial of degree {self.basis.min_degree} may give a singular system.",
            )

    @classmethod
    @checked
    def classic(cls, basis: AbstractBasis | None = None, *, degree: int | None = 1) -> "RBF":
        """Returns the classic method: every surface node is a source, so the surface is exact (de Boer et al. 2007).

        It takes one dense solve of as many unknowns as there are surface nodes.

        **Arguments:**

        - `basis`: the function phi. Default `ThinPlateSpline()`.
        - `degree`: degree of the polynomial: None, 0 or 1. Default 1.

        **Returns:** an `RBF`.
        """
        return cls(ThinPlateSpline() if basis is None else basis, AllPoints(), AllPoints(), degree)

    @property
    def _below_min_degree(self) -> bool:
        order = {None: -1, 0: 0, 1: 1}
        return order[self.degree] < order[self.basis.min_degree]

    @property
    def exact(self) -> bool:
        every = isinstance(self.reduction, AllPoints) and isinstance(self.fixed_reduction, AllPoints)
        return every and not self.ridge

    def connect(self, surface: Surface, points):
        sources = self.chosen(surface)
        solver = self.iterative(len(sources))
        if solver is None:
            return sources, None
        first = solver.dense_count(len(sources))
        order, earlier = far_to_near(surface.points[sources].astype(float), first, solver.neighbours)
        return OrderedIds(jnp.asarray(sources[order]), jnp.asarray(earlier)), None

    def chosen(self, surface: Surface) -> np.ndarray:
        """Chooses the surface's rows that are sources, on the host. Raises `ValueError` if they do not determine the polynomial."""
        sources = surface.reduced(self.reduction, self.fixed_reduction)
        sources = drop_close(surface.points, sources, roundoff(surface.points))
        self._check_spread(surface.points[sources])
        return sources.astype(np.int32)

    def iterative(self, count: int) -> Iterative | None:
        """Returns the iterative solver for a number of sources, or None where the system is factored."""
        if self.solver is None:
            return Iterative() if count > MANY else None
        return self.solver if isinstance(self.solver, Iterative) else None

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
        return self.sources(ids)

    def sources(self, ids):
        return np.asarray(_rows(ids))

    def fit(self, ids: Int[Array, " s"] | OrderedIds, surface, points):
        points = surface[_rows(ids)].astype(jnp.promote_types(surface.dtype, jnp.result_type(float)))
        centre = points.mean(axis=0)
        extent = jnp.abs(points - centre[None]).max()
        if self.ridge:  # its effect depends on the scale, which must then not depend on the axes
            extent = jnp.sqrt(largest(jnp.sum((points - centre[None]) ** 2, axis=1)))
        scale = 1 / jnp.where(extent > 0, extent, 1)
        if self._below_min_degree:
            scale = jnp.ones_like(scale)
        elif not self.ridge:
            centre, scale = jax.lax.stop_gradient((centre, scale))
        sources = (points - centre[None]) * scale
        if not isinstance(ids, OrderedIds):
            return RBFFactors(sources, centre, scale, *self._factored(sources, scale))
        method, places, stretch = jax.lax.stop_gradient((self, sources, scale))  # any preconditioner gives one solution
        first = len(sources) - len(ids.earlier)
        weights = local_weights(lambda r2: method._matrix(r2, stretch), places, ids.earlier, self.degree, self._sign)
        tolerance = (method.iterative(len(sources)) or Iterative()).tolerance.astype(weights.dtype)
        floor = ROUNDINGS * float(jnp.finfo(weights.dtype).eps)
        rows = Cardinals(ids.earlier, weights, jnp.maximum(tolerance, floor))
        return RBFFactors(sources, centre, scale, *method._factored(places[:first], stretch), rows)

    def _factored(self, sources, scale):
        """Factors the dense system of some sources; returns the factors, and the rows in the order of the pivots."""
        tail = polynomial(sources, self.degree)
        # One reduction, not a sum of d terms: XLA's CPU backend (jaxlib 0.10.2) merges those wrongly with the transposition
        # that LAPACK asks for, and the jitted gradient with respect to one coordinate of the sources is wrong or NaN.
        distances = jnp.sum((sources[:, None] - sources[None]) ** 2, axis=-1)
        kernel = self._matrix(distances, scale)
        corner = jnp.zeros((tail.shape[1],) * 2, kernel.dtype)
        matrix = jnp.block([[kernel, tail], [tail.T, corner]])  # eq. (3)
        lu, _, order = jax.lax.linalg.lu(matrix)
        return lu, order

    @property
    def _sign(self) -> int:
        """Returns the side of the definite part: phi is negative definite where its order is one."""
        return -1 if self.basis.min_degree == 0 else 1

    @property
    def _at_sources(self) -> float:
        """Returns what the ridge adds to phi at each source."""
        return self._sign * self.ridge

    def _matrix(self, r2, scale):
        """Computes the kernel's square matrix, ridge included."""
        kernel = self._phi(r2, scale)
        return kernel + self._at_sources * jnp.eye(len(kernel), dtype=kernel.dtype) if self.ridge else kernel

    def _phi(self, r2, scale):
        return Radial(self.basis, scale)(r2)

    def check(self, ids, factors: "RBFFactors", u):
        dtype = factors.lu.dtype
        sources, scale, centre = map(np.asarray, (factors.sources, factors.scale, factors.centre))
        warn_of_close(sources / scale + centre, np.inf, type(self).__name__)
        values = np.asarray(u, dtype)[self.sources(ids)]
        if factors.cardinals is not None:
            return _check_convergence(self, factors, factors.cardinals, values)
        error = _rounding(self, factors, values) / np.abs(u).max()
        noticeable = NOTICEABLE if jnp.finfo(dtype).bits == 64 else NOTICEABLE_SINGLE
        if error <= noticeable:
            return
        useless = not error <= USELESS  # NaN too
        how = f"ill-conditioned: rounding changes the displacements by {error:.1g} of their size"
        message = _unusable(self, factors, how if np.isfinite(error) else "singular")
        if useless:
            raise ValueError(message)
        warn(message)

    def field(self, ids, factors: "RBFFactors", surface, u):
        return self.through(factors, u[_rows(ids)].astype(factors.lu.dtype), u.dtype)

    def through(self, factors: "RBFFactors", values: Float[Array, "s k"], dtype) -> "RBFField":
        """Makes the field with given values at the sources, in a given precision. Traced."""
        terms = polynomial(factors.sources[:1], self.degree).shape[1]
        rhs = jnp.concatenate([values, jnp.zeros((terms, values.shape[1]), values.dtype)])
        if factors.cardinals is None:
            weights = factors.solve(rhs).astype(dtype)
        else:
            weights = self._iterated(factors, factors.cardinals, rhs).astype(dtype)
        beta, alpha = weights.T[:, : len(factors.sources)], weights.T[:, len(factors.sources) :]
        sources, centre, scale = (leaf.astype(dtype) for leaf in (factors.sources, factors.centre, factors.scale))
        return RBFField(self, sources, centre, scale, beta, alpha)

    def _iterated(self, factors: "RBFFactors", cardinals: Cardinals, rhs: Float[Array, "t k"]) -> Float[Array, "t k"]:
        """Solves the system without its matrix. Its derivatives are products and solves of the same kind."""
        count, tail = len(factors.sources), polynomial(factors.sources, self.degree)

        def product(x):
            beta, alpha = x[:count], x[count:]
            top = self._times_kernel(factors, beta) + jnp.matmul(tail, alpha, precision="highest")
            return jnp.concatenate([top, jnp.matmul(tail.T, beta, precision="highest")])

        method, kept, rows = jax.lax.stop_gradient((self, factors, cardinals))
        iterations = method._iterations(kept, rows)
        return jax.lax.custom_linear_solve(product, rhs, lambda _, rhs: iterations.solve(rhs), symmetric=True)

    def _iterations(self, factors: "RBFFactors", cardinals: Cardinals) -> ConjugateGradients:
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

    def _times_kernel(self, factors: "RBFFactors", beta: Float[Array, "s k"]) -> Float[Array, "s k"]:
        """Multiplies by the matrix of functions at the sources, block by block. To be differentiated."""
        sources, phi = factors.sources, Radial(self.basis, factors.scale)

        def of_block(points):
            return kernel_sum(phi, sources, beta.T, in_rows(points, jnp.ones((), points.dtype))).T

        if is_fused(phi, sources.dtype):
            product = fused(phi, sources, beta, sources)
        else:
            product = map_rows(jax.checkpoint(of_block), sources, block_size(len(sources)))
        return product + self._at_sources * beta if self.ridge else product

    def _times_kernel_quickly(self, factors: "RBFFactors", beta: Float[Array, "s k"]) -> Float[Array, "s k"]:
        """Computes what `_times_kernel` does in half the time on a CPU: each function of two sources once."""

        def block_by_block(factors, beta):
            return self._times_kernel(factors, beta)

        def of_pairs(factors, beta):
            product = symmetric_kernel_sum(lambda r2: self._phi(r2, factors.scale), factors.sources, beta.T).T
            return product + self._at_sources * beta if self.ridge else product

        return jax.lax.platform_dependent(factors, beta, cpu=of_pairs, default=block_by_block)

    def rows(self, factors: "RBFFactors", points: Float[Array, "k d"]) -> Float[Array, "k t"]:
        """Computes rows at any points: times the weights of functions and polynomial they give the field. Traced."""
        scaled = (points - factors.centre[None]) * factors.scale
        kernel = self._phi(squared_distances(scaled, factors.sources), factors.scale)
        return jnp.concatenate([kernel, polynomial(scaled, self.degree)], axis=1)


def _rounding(rbf: RBF, factors: "RBFFactors", values: np.ndarray) -> float:
    """Measures, on the host, how much rounding changes the interpolation of `values` (s, d), at and between the sources.

    It takes one step of iterative refinement: the field of what the first field misses at the sources. Infinite without a solution.
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
            result[start : start + block] = np.asarray(_system_rows(rbf, sources, scale, part)) @ weights
        return result

    with np.errstate(all="ignore"):
        first = weights(values)
        missed = values - field(first, sources)
        if rbf.ridge:
            missed = missed - rbf._at_sources * first[:count]
        between = [(sources + np.roll(sources, shift, axis=0)) / 2 for shift in (1, 1 + count // 2)]
        moved = field(weights(missed), np.concatenate([sources, *between]))
        return float(np.abs(np.concatenate([missed, moved])).max())


@compiled
def _system_rows(rbf: RBF, sources, scale, points):
    """Computes rows of the system (eq. 3) at any points, all in scaled coordinates."""
    kernel = rbf._phi(squared_distances(points, sources), scale)
    return jnp.concatenate([kernel, polynomial(points, rbf.degree)], axis=1)


def _check_convergence(rbf: RBF, factors: "RBFFactors", cardinals: Cardinals, values: np.ndarray) -> None:
    """Raises `ValueError` if some steps do not promise that conjugate gradients converge."""
    left, count, rounding = map(float, _left_after_trial(rbf, factors, cardinals, jnp.asarray(values)))
    steps = count * np.log(float(cardinals.tolerance)) / np.log(max(left, 1e-300)) if left < 1 else np.inf
    how = "too ill-conditioned for Iterative()"
    if not steps <= LIMIT:
        raise ValueError(_unusable(rbf, factors, f"{how}: an error of {left:.1g} is left after {count:.0f} steps"))
    # in single precision rounding sets a floor that a few steps do not show
    single = cardinals.weights.dtype != np.float64
    if (single or not rounding <= SUSPICIOUS) and not _is_solved(rbf, factors, jnp.asarray(values)):
        why = " in single precision" if single else ": rounding keeps the field from its sources"
        raise ValueError(_unusable(rbf, factors, how + why))


@compiled
def _left_after_trial(
    rbf: RBF, factors: "RBFFactors", cardinals: Cardinals, values: Float[Array, "s k"]
) -> tuple[Float[Array, ""], Int[Array, ""], Float[Array, ""]]:
    """Takes some steps of conjugate gradients, and counts them.

    Returns also which share of the error they leave, in the norm of the basis. The third number is what rounding has made of
    the residual, over what makes a field NaN.
    """
    iterations = rbf._iterations(factors, cardinals)
    trial = dataclasses.replace(iterations, tolerance=jnp.asarray(PROMISING, values.dtype))
    size, start = jnp.abs(values).max(), iterations.without_polynomial(values)
    now = trial.improve(start, size, TRIAL)
    left = jnp.sqrt(jnp.abs(now.left / jnp.where(now.energy == 0, 1, now.energy)).max())
    is_polynomial = jnp.abs(now.residual).max() <= cardinals.tolerance * size
    rounding = iterations.rounding(now, start) / (iterations.allowed * jnp.where(size == 0, 1, size))
    return jnp.where(is_polynomial, 0, left), now.count, rounding


@compiled
def _is_solved(rbf: RBF, factors: "RBFFactors", values: Float[Array, "s k"]) -> Bool[Array, ""]:
    return jnp.isfinite(rbf.through(factors, values, values.dtype).beta).all()


def _unusable(rbf: RBF, factors: "RBFFactors", how: str) -> str:
    """Describes what is wrong with a system, where, and what of the method to change."""
    sources = np.asarray(factors.sources / factors.scale + factors.centre[None])
    *hints, last = _hints(rbf, factors.cardinals is not None, single=sources.dtype != np.float64)
    return (
        f"the interpolation matrix of {len(sources)} sources is {how}{_nearest_two(sources)}. "
        f"Try {', '.join(hints)}, or {last}."
    )


def _hints(rbf: RBF, iterates: bool, single: bool) -> list[str]:
    """Lists what to change where a method's system is unusable: only what this method has."""
    lengths = [field.name for field in dataclasses.fields(rbf.basis) if "radius" in field.name]
    hints = [*(f"a smaller `{name}` of the basis" for name in lengths), "a `ridge` of RBF such as 1e-6"]
    if all(hasattr(reduction, "separation") for reduction in (rbf.reduction, rbf.fixed_reduction)):
        hints += ["fewer sources", "a larger `separation` in both reductions"]
    else:
        hints += ["fewer sources by a `reduction` and a `fixed_reduction` such as jm.KDTree(64)"]
    if rbf.basis.min_degree != 1 or rbf._below_min_degree:
        hints += ["another `degree` of the polynomial"]
    if iterates and not single:
        hints += ["a larger `tolerance` of Iterative"]
    return [*hints, "x64 mode of JAX"] if single else hints


def _rows(ids: Any) -> Any:
    """Returns the surface's rows that are sources."""
    return ids.sources if isinstance(ids, OrderedIds) else ids


def _nearest_two(sources: np.ndarray) -> str:
    if len(sources) < 2:
        return ""
    distance, nearest = map(np.asarray, scipy.spatial.KDTree(sources).query(sources, k=2))
    first = distance[:, 1].argmin()
    pair = " and ".join(str(tuple(float(f"{x:.6g}") for x in sources[i])) for i in (first, nearest[first, 1]))
    return f"; the nearest two sources, {pair}, are {distance[first, 1]:.3g} apart"


class RBFFactors(eqx.Module):
    """Sources in coordinates of order one, and the factored system (eq. 3) of t = s + p equations.

    `order` are the rows as the pivots have them. With `cardinals`, the factored system is that of the first sources alone.
    """

    sources: Float[Array, "s d"]
    centre: Float[Array, " d"]
    scale: Float[Array, ""]
    lu: Float[Array, "t t"]
    order: Int[Array, " t"]
    cardinals: Cardinals | None = None

    def solve(self, values: Float[Array, "t k"]) -> Float[Array, "t k"]:
        """Solves the factored system."""
        half = triangular_solve(self.lu, values[self.order], left_side=True, lower=True, unit_diagonal=True)
        return triangular_solve(self.lu, half, left_side=True, lower=False)


class RBFField(AbstractField):
    """Evaluates eq. (4) at one point."""

    rbf: RBF
    sources: Float[Array, "s d"]
    centre: Float[Array, " d"]
    scale: Float[Array, ""]
    beta: Float[Array, "k s"]
    alpha: Float[Array, "k p"]

    def __call__(self, x, ids):
        x = (x - self.centre) * self.scale
        phi = self._phi(squared_distances(self.sources, x[None])[:, 0])
        terms = polynomial(x[None], self.rbf.degree)[0]
        return jnp.matmul(self.beta, phi, precision="highest") + jnp.matmul(self.alpha, terms, precision="highest")

    @property
    def block_size(self) -> int | None:
        return None if is_fused(self._phi, self.sources.dtype) else block_size(len(self.sources))

    @property
    def _phi(self) -> Radial:
        return Radial(self.rbf.basis, self.scale)

    def evaluate(self, points, ids):
        """Sums the functions, and adds the polynomial."""
        if self.block_size is None:
            x = (points - self.centre[None]) * self.scale
            terms = polynomial(x, self.rbf.degree)[:, :, None] * self.alpha.T[None]
            return fused(self._phi, self.sources, self.beta.T, x) + terms.sum(axis=1)
        x = in_rows(points - self.centre[None], self.scale)
        terms = polynomial(x.T, self.rbf.degree).T
        tail = sum((self.alpha[:, k, None] * term[None] for k, term in enumerate(terms)), start=jnp.zeros_like(x))
        return (kernel_sum(self._phi, self.sources, self.beta, x) + tail).T


def warn_of_close(nodes: Float[np.ndarray, "s d"], radius: float, method: str) -> None:
    """Warns of nodes that nearly coincide: an interpolation carries their difference over the distance to the next nodes."""
    first, second = nearly_coincident(nodes, radius, NEAR)
    if len(first):
        distance = np.linalg.norm(nodes[first[0]] - nodes[second[0]])
        warn(
            f"{len(first)} surface nodes nearly coincide with others, the nearest two {distance:.3g} apart near "
            f"({place_of(nodes[first[0]])}). Where such nodes move differently, {method} moves nodes around them by "
            f"{1 / NEAR:.0f} times the difference, or more. Merge them, or check the motion by jm.inspect.",
        )
