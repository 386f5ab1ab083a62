"""A guard for optimisers: the smallest Jacobian ratio as a smooth constraint."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxmorph import DesignedMesh, Mesh, Plan
from jaxmorph.extend import Module, between, checked, finite_array, whole

from ._arguments import Numbers


@dataclasses.dataclass(frozen=True)
class QualityRows:
    """The smallest Jacobian ratios at corners of a moved mesh, with their derivatives.

    - `values` (k,): the ratios less the bound, ascending; below 0 the bound is broken.
    - `matrix` (k, p): derivatives by the design variables. A step `s` gives `values + matrix @ s`.
    - `cells` (k,): the cells, in the order of `quality`.
    """

    values: Float[np.ndarray, " k"]
    matrix: Float[np.ndarray, "k p"]
    cells: Int[np.ndarray, " k"]


class LastDesign:
    """Mutable, so that a guard compares it by identity."""

    value: Float[np.ndarray, " p"] | None = None


class MeshGuard(Module):
    """A constraint that keeps the mesh valid: a soft smallest Jacobian ratio less a bound.

    The soft ratio is -log(sum(exp(-sharpness ratio))) / sharpness over all corners of cells, and
    centres of hexahedra. It lies below the smallest ratio, by log(count) / sharpness at most: a
    design with a constraint of 0 or more is feasible. It is twice differentiable, along any motion.

        guard = shapes.MeshGuard(plan, mesh, lambda p: shapes.displacement(bumps, plan, p))
        options = {"jac": True, "method": "SLSQP", "constraints": guard.constraint()}
        scipy.optimize.minimize(guard.guarded(drag), start, **options)

    **Arguments:**

    - `plan`: from `prepare`.
    - `mesh`: whose `points` are the plan's, with cells.
    - `displacement`: takes the design variables (p,) and returns `u` (m, d); traced.
    - `min_jacobian_ratio`: bound on `QualityReport.jacobian_ratio`, from 0 to 1. Default 0.1; cells
      invert at 0.
    - `sharpness`: positive, default 100. A larger value is closer to the smallest ratio, and bends
      more.

    **Raises:** `ValueError` for numbers out of their range, and for a mesh that is not the plan's.
    """

    mesh: DesignedMesh
    bound: float = eqx.field(static=True)
    sharpness: float = eqx.field(static=True)
    last: LastDesign = eqx.field(static=True)

    @checked
    def __init__(
        self,
        plan: Plan,
        mesh: Mesh,
        displacement: Callable[[Any], Any],
        *,
        min_jacobian_ratio: float = 0.1,
        sharpness: float = 100.0,
    ):
        between("sharpness", sharpness, 0)
        self.mesh = DesignedMesh(plan, mesh, displacement, min_jacobian_ratio)
        self.bound, self.sharpness = float(min_jacobian_ratio), float(sharpness)
        self.last = LastDesign()

    def __call__(self, design: Any) -> Float[Array, ""]:
        ratios = self.mesh.ratios(design)
        return -jax.scipy.special.logsumexp(-self.sharpness * ratios) / self.sharpness - self.bound

    @checked
    def value(self, design: Numbers) -> float:
        """Computes the constraint at design variables (p,), for NumPy."""
        return float(eqx.filter_jit(self)(_flat(design)))

    @checked
    def smallest(self, design: Numbers) -> float:
        """Computes the smallest ratio itself, which has kinks, at design variables (p,)."""
        return float(eqx.filter_jit(self.mesh.ratios)(_flat(design)).min())

    @checked
    def gradient(self, design: Numbers) -> Float[np.ndarray, " p"]:
        """Computes the derivative by each design variable (p,), for NumPy."""
        return np.asarray(eqx.filter_jit(eqx.filter_grad(self))(_flat(design)), float)

    @checked
    def quality_rows(self, design: Numbers, count: int) -> QualityRows:
        """Finds the `count` smallest ratios at design variables (p,), and their derivatives: rows
        of a linear program whose step keeps all corners above the bound.

        **Raises:** `ValueError` for more rows than the cells have Jacobians.
        """
        values, chosen, matrix = eqx.filter_jit(self._rows)(_flat(design), self._checked_count(count))
        cells = self.mesh.cells[np.asarray(chosen)]
        return QualityRows(np.asarray(values, float), np.asarray(matrix, float), cells)

    def _checked_count(self, count: int) -> int:
        if whole("count", count) > (total := (self.mesh.cells >= 0).sum()):
            raise ValueError(f"`count` is {count}; the cells have {total} Jacobians.")
        return count

    def _rows(
        self, design: Float[Array, " p"], count: int
    ) -> tuple[Float[Array, " k"], Int[Array, " k"], Float[Array, "k p"]]:
        ratios = self.mesh.ratios(design)
        chosen = jax.lax.top_k(-ratios, count)[1]
        slopes = jax.jacfwd if len(design) <= count else jax.jacrev
        matrix = slopes(lambda design: self.mesh.ratios(design)[chosen])(design)
        return ratios[chosen] - self.bound, chosen, matrix

    def constraint(self, count: int | None = None) -> dict[str, Any]:
        """Makes the constraint of `scipy.optimize.minimize` with its derivative: on the soft
        smallest ratio, or on the ratios of the `count` smallest corners.
        """
        if count is None:
            return {"type": "ineq", "fun": self.value, "jac": self.gradient}
        count = self._checked_count(count)
        rows = functools.lru_cache(1)(lambda design: self.quality_rows(np.frombuffer(design), count))
        at = lambda design: rows(np.asarray(design, float).tobytes())  # noqa: E731
        return {"type": "ineq", "fun": lambda design: at(design).values, "jac": lambda design: at(design).matrix}

    def guarded(self, objective: Callable[[Any], Any]) -> Callable[[Any], Any]:
        """Makes an objective that is infinite, without a flow, for an infeasible design: line
        searches step back. The objective takes design variables (p,), and returns its value and
        derivative (p,).
        """

        def guard(design: Any) -> tuple[float, Any]:
            if self.smallest(design) < self.bound:
                return np.inf, np.zeros(np.shape(design))
            self.last.value = np.array(design, float)
            return objective(design)

        return guard

    @checked
    def callback(self, function: Callable[[Any], Any]) -> Callable[..., Any]:
        """Makes the `callback` of `scipy.optimize.minimize`, for a history of feasible designs.

        It calls the function with the last design (p,) that `guarded` let through. SLSQP gives the
        first trial of each line search, which may invert cells.
        """
        return lambda *_: None if self.last.value is None else function(self.last.value)


def _flat(design: Any) -> Float[Array, " p"]:
    return jnp.asarray(finite_array("design", design, (None,)), float)
