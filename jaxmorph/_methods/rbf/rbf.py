"""Interpolation by radial basis functions from reduced sources (eqs. 1 to 4 of the paper)."""

import dataclasses
import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from ..._host.package.arguments import between, shown, whole
from ..._host.package.errors import warn
from ..._host.package.rounding import roundoff
from ..._host.sources.farthest import Graded, far_to_near
from ..._host.sources.reduction import AbstractReduction, AllPoints, KDTree, drop_close
from ..._kernels.module import Module
from ..._kernels.values import as_jax, largest
from ..base import AbstractMethod, Control, Scalar, check_kind, number, or_one
from ..surface import Surface
from .basis import AbstractBasis, ThinPlateSpline
from .expansion import (
    Expansion,
    RBFFactors,
    is_solved,
    is_sound,
    nearest_two,
    rounding,
    warn_of_close,
)
from .iterations import ROUNDINGS, Cardinals, OrderedIds, local_weights

MANY = 8192  # sources beyond which the system is solved by iterations
DENSE, SHARE = (
    (1000, 6000),
    6,
)  # least and most sources solved densely by default; between, one of every `SHARE`


class Direct(Module):
    """Factors the dense system once per plan: 8 s^2 bytes for s sources (0.5 GB for 8,000), and a
    time with s^3. Each displacement then costs little.
    """


class Iterative(Module):
    """Solves by conjugate gradients without the matrix.

    For s sources the memory grows with s, the time with s^2. A displacement or a gradient takes 10
    to 20 products with the kernel. The preconditioner is a sparse factor of the inverse (Faul,
    Goodsell and Powell, IMA Journal of Numerical Analysis 25, 2005). Sources are ordered from far
    apart to close (Schaefer, Katzfuss and Owhadi, SIAM Journal on Scientific Computing 43, 2021). A
    source carries the function that is 1 at its place and 0 at the nearest sources before it. The
    first sources are solved densely. The system is symmetric, so its solve serves derivatives too.
    `prepare` finds sources and neighbours, and `refit` does not change them. Where no solve
    converges, `prepare` raises. A field is NaN if it misses its sources by a thousand tolerances,
    or by a thousandth of the displacement where that is less.

    **Arguments:**

    - `tolerance`: the distance by which the field misses its sources when a solve ends, relative to
      the largest displacement. Default 1e-10; 1.2e-5 at least in single precision.
    - `neighbours`: sources in each function's small system. More of them take fewer products, and
      more time and memory to prepare. Default 100.
    - `dense`: the number of first sources that are solved densely. Default None: a sixth of all
      sources, but 1,000 at least and 6,000 at most.

    **Raises:** `ValueError` for a tolerance that is not between 0 and 1, and for fewer than 8
    neighbours or dense sources.
    """

    tolerance: Scalar = eqx.field(converter=number("tolerance", 0, 1), default=1e-10)
    neighbours: int = eqx.field(static=True, default=100)
    dense: int | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        whole("neighbours", self.neighbours, 8)
        if self.dense is not None:
            whole("dense", self.dense, 8)

    def dense_count(self, count: int) -> int:
        fewest, most = DENSE
        return min(
            count, min(max(fewest, count // SHARE), most) if self.dense is None else self.dense
        )


class RBF(AbstractMethod):
    """Interpolates by radial basis functions: c(x) = p(x) + sum_j beta_j phi(|x - x_j|), eq. (1).

    A source x_j is a node of the surface that carries a function: a control point, or centre, of
    the field. Moving and fixed nodes are reduced to sources separately. With `AllPoints()` for both
    it is the classic method, exact on the surface (de Boer, van der Schoot and Bijl, Computers and
    Structures 85, 2007). With fewer sources (Rendall and Allen, Journal of Computational Physics
    228, 2009) the surface follows approximately, and fixed nodes that are no sources move too;
    `SurfaceReconstruction` adds the rest.

    **Arguments:**

    - `basis`: the function phi. Default `ThinPlateSpline()`.
    - `reduction`, `fixed_reduction`: choose the sources among the moving and among the fixed nodes.
      Defaults `KDTree(64)` and `Graded()`. More sources follow the surface more closely, and cost
      more.
    - `degree`: degree of the polynomial p: None (no polynomial), 0, or 1, which reproduces rigid
      and affine motions. Default 1.
    - `ridge`: added to the matrix at each source, in units of phi at the sources' extent (of phi
      itself for a basis with a radius). The field then smooths noise and misses the sources.
      Default 0.
    - `solver`: `Direct()` factors the dense system once per plan, `Iterative()` solves for each
      displacement without the matrix. Default None: `Iterative()` for more than 8,192 sources.

    **Raises:** `ValueError` for another degree or a negative ridge. `prepare` raises it where the
    sources cannot determine the polynomial (all in one plane), and where rounding changes
    displacements by more than 1 %: the radius is wide or sources nearly coincide. It warns from
    1e-6 on (1e-3 without x64).

    The system (eq. 3) is solved in float64 if JAX's x64 mode is on. The effect of rounding is the
    largest value, at the sources and between them, of the field that interpolates what the first
    solve of a smooth motion misses.
    """

    basis: AbstractBasis = eqx.field(default_factory=ThinPlateSpline)
    reduction: AbstractReduction = eqx.field(static=True, default=KDTree(64))
    fixed_reduction: AbstractReduction = eqx.field(static=True, default=Graded())
    degree: int | None = eqx.field(static=True, default=1)
    ridge: float = eqx.field(static=True, default=0.0)
    solver: Direct | Iterative | None = None

    def __check_init__(self):
        if not isinstance(self.solver, Direct | Iterative | None):
            raise ValueError(
                f"`solver` must be jm.Direct() or jm.Iterative(), not {shown(self.solver)}."
            )
        check_kind(self.basis, AbstractBasis, "basis", "jm.ThinPlateSpline()")
        check_kind(self.reduction, AbstractReduction, "reduction", "jm.KDTree(64)")
        check_kind(self.fixed_reduction, AbstractReduction, "fixed_reduction", "jm.KDTree(16)")
        if self.degree is not None and (type(self.degree) is not int or self.degree not in (0, 1)):
            raise ValueError(f"`degree` of the polynomial is None, 0 or 1, not {self.degree!r}.")
        between("ridge", self.ridge, 0, ends="[)")
        if self._below_min_degree:
            needed = f"a polynomial of degree {self.basis.min_degree}"
            warn(f"{type(self.basis).__name__} without {needed} may give a singular system.")

    @classmethod
    def classic(cls, basis: AbstractBasis | None = None, *, degree: int | None = 1) -> "RBF":
        """Returns the classic method: every surface node is a source (de Boer et al. 2007).

        The surface is exact, by one dense solve of as many unknowns as it has nodes. `basis` is by
        default `ThinPlateSpline()`; `degree`, of the polynomial, is None, 0 or 1, by default 1.
        """
        return cls(ThinPlateSpline() if basis is None else basis, AllPoints(), AllPoints(), degree)

    @property
    def _below_min_degree(self) -> bool:
        lowest = self.basis.min_degree
        return lowest is not None and (self.degree is None or self.degree < lowest)

    @property
    def exact(self) -> bool:
        every = isinstance(self.reduction, AllPoints) and isinstance(
            self.fixed_reduction, AllPoints
        )
        return every and not self.ridge

    def connect(self, surface: Surface, points):
        sources = self.chosen(surface)
        solver = self.iterative(len(sources))
        if solver is None:
            return sources, None
        first = solver.dense_count(len(sources))
        order, earlier = far_to_near(
            surface.points[sources].astype(float), first, solver.neighbours
        )
        return OrderedIds(jnp.asarray(sources[order]), jnp.asarray(earlier)), None

    def chosen(self, surface: Surface) -> np.ndarray:
        sources = surface.reduced(self.reduction, self.fixed_reduction)
        sources = drop_close(surface.points, sources, roundoff(surface.points))
        if len(sources) == 0:
            raise ValueError("there are no sources: `moving` is empty.")
        places = surface.points[sources]
        dimension = surface.points.shape[1]
        spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
        if self.degree == 1 and (len(sources) <= dimension or spread[-1] <= 1e-10 * spread[0]):
            is_flat = dimension == 3 and not np.ptp(surface.points, axis=0).all()
            plane = " A mesh in a plane is given as (n, 2)." if is_flat else ""
            raise ValueError(
                f"the {len(sources)} sources do not span {dimension} dimensions, so a linear "
                f"polynomial is not determined.{plane} "
                "Add fixed nodes (far field), more leaves, or use RBF(degree=0) with a basis "
                "that allows it."
            )
        return sources.astype(np.int32)

    def iterative(self, count: int) -> Iterative | None:
        if self.solver is None:
            return Iterative() if count > MANY else None
        return self.solver if isinstance(self.solver, Iterative) else None

    def control(self, ids):
        sources = np.asarray(_source_rows(ids))
        return Control(sources, sources)

    def fit(self, ids: Int[Array, " s"] | OrderedIds, surface, points):
        points = surface[_source_rows(ids)].astype(
            jnp.promote_types(surface.dtype, jnp.result_type(float))
        )
        centre = points.mean(axis=0)
        extent = jnp.abs(points - centre[None]).max()
        if self.ridge:  # its effect depends on the scale, which must then not depend on the axes
            extent = jnp.sqrt(largest(jnp.sum((points - centre[None]) ** 2, axis=1)))
        scale = 1 / or_one(extent)
        if self._below_min_degree:
            scale = jnp.ones_like(scale)
        elif not self.ridge:
            centre, scale = jax.lax.stop_gradient((centre, scale))
        sources = (points - centre[None]) * scale
        expansion = self.expansion
        if not isinstance(ids, OrderedIds):
            return RBFFactors(sources, centre, scale, *expansion.factored(sources, scale))
        # any preconditioner gives one solution, so it has no derivative
        constant, places, stretch = jax.lax.stop_gradient((expansion, sources, scale))
        first = len(sources) - len(ids.earlier)
        weights = local_weights(
            lambda r2: constant.kernel(r2, stretch), places, ids.earlier, self.degree, constant.sign
        )
        solver = self.iterative(len(sources)) or Iterative()
        tolerance = jax.lax.stop_gradient(solver.tolerance).astype(weights.dtype)
        floor = ROUNDINGS * float(jnp.finfo(weights.dtype).eps)
        rows = Cardinals(ids.earlier, weights, jnp.maximum(tolerance, floor))
        return RBFFactors(sources, centre, scale, *constant.factored(places[:first], stretch), rows)

    @property
    def expansion(self) -> Expansion:
        return Expansion(self.basis, self.degree, self.ridge)

    def check(self, ids, factors: RBFFactors, u):
        values = np.asarray(u, factors.lu.dtype)[self.control(ids).sources]
        unusable = functools.partial(self._unusable, factors)
        if factors.cardinals is not None:
            if not is_solved(self.expansion, factors, as_jax(values)):
                raise ValueError(unusable("too ill-conditioned for Iterative()"))
            return
        error = float(rounding(self.expansion, factors, as_jax(values))) / float(np.abs(u).max())
        if is_sound(error, factors.lu.dtype, unusable, "singular") and not self.ridge:
            nodes = factors.places
            body = nodes[values.any(axis=1)]
            extent = float(np.linalg.norm(np.ptp(body, axis=0))) if len(body) else 0.0
            warn_of_close(nodes, extent, type(self).__name__)

    def field(self, ids, factors: RBFFactors, surface, u):
        return self.expansion.field(factors, u[_source_rows(ids)].astype(factors.lu.dtype), u.dtype)

    def _unusable(self, factors: RBFFactors, fault: str) -> str:
        sources = factors.places
        *hints, last = self._hints(
            factors.cardinals is not None, single=sources.dtype != np.float64
        )
        return (
            f"the interpolation matrix of {len(sources)} sources is {fault}{nearest_two(sources)}. "
            f"Try {', '.join(hints)}, or {last}."
        )

    def _hints(self, iterates: bool, single: bool) -> list[str]:
        lengths = [field.name for field in dataclasses.fields(self.basis) if "radius" in field.name]
        separates = all(
            hasattr(reduction, "separation") for reduction in (self.reduction, self.fixed_reduction)
        )
        hints = {
            "a `ridge` of RBF such as 1e-6": True,
            "fewer sources": separates,
            "a larger `separation` in both reductions": separates,
            "fewer sources by a `reduction` and a `fixed_reduction` such as jm.KDTree(64)": (
                not separates
            ),
            "another `degree` of the polynomial": self.basis.min_degree != 1
            or self._below_min_degree,
            "a larger `tolerance` of Iterative": iterates and not single,
            "x64 mode of JAX": single,
        }
        return [
            *(f"a smaller `{name}` of the basis" for name in lengths),
            *(hint for hint in hints if hints[hint]),
        ]


def _source_rows(ids: Any) -> Any:
    return ids.sources if isinstance(ids, OrderedIds) else ids
