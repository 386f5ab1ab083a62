"""The largest, exact step of a surface in a direction before a cell breaks a bound."""

import dataclasses
import itertools
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int
from numpy.polynomial.polynomial import polyval

from .._host.cells.topology import DIMENSION
from .._host.package.arguments import between, checked, finite_array
from .._kernels.module import Module
from .._mesh.mesh import Mesh
from .._methods.base import AbstractMethod
from .._plan.deform import deform
from .._plan.plan import Plan
from .._quality import bernstein, measures
from .._quality.bounds import DEPTH, blocks
from .._quality.jacobian_form import form_of, nodes_of
from .._quality.proof import proof
from .._quality.quality import places, signs_of, standards_of
from .._quality.vector import corner_points

Points = Float[np.ndarray, "n d"]


@dataclasses.dataclass(frozen=True)
class LargestStep:
    """Result of `largest_step`: `step`, the factor of the direction, at most `max_step`, and
    `cell`, which reaches the bound there, in the order of `quality`; -1 where none does.
    """

    step: float
    cell: int


@checked
def largest_step(
    plan: Plan,
    u: Float[ArrayLike, "m d"],
    direction: Float[ArrayLike, "m d"],
    mesh: Mesh,
    *,
    min_jacobian_ratio: float = 0.0,
    max_step: float = 1.0,
    proven: bool = False,
) -> LargestStep:
    """Finds the largest step along a direction that keeps every Jacobian ratio above a bound.

    Corner Jacobians are polynomials in the step, of degree 2 in 2-D and 3 in 3-D, whose first roots
    are found. With `proven` the Bernstein coefficients of det J take the corners' place, as in
    `proof`: whole cells keep the bound, at each instant up to the step. Corners of cells that are
    inverted on the undeformed mesh end no step.

    **Arguments:**

    - `plan`: a plan that is linear in `u` (`plan.is_linear`).
    - `u`: displacement (m, d) to start from.
    - `direction`: (m, d) change of `u` by a step of 1.
    - `mesh`: whose `points` are the plan's.
    - `min_jacobian_ratio`: bound on `QualityReport.jacobian_ratio`; 0 is where cells invert.
    - `max_step`: the largest step to try, above 0.
    - `proven`: judge whole cells too, default False. Their bound is relative to the least det J
      that is proven of the undeformed cell.

    **Returns:** a `LargestStep`; its step is 0 where `u` breaks the bound already. **Raises:**
    `ValueError` for wrong shapes, a bound outside of 0 to 1, a `max_step` that is not above 0, and
    a plan that is not linear. With `proven`, also for undeformed cells that are not proven valid.
    """
    _check_linear(plan)
    between("min_jacobian_ratio", min_jacobian_ratio, 0, 1, "[)")
    between("max_step", max_step, 0)
    shape = plan.n_moving, plan.points.shape[1]
    u = finite_array("u", u, shape)
    direction = finite_array("direction", direction, shape)

    def at(step: float) -> np.ndarray:
        moved = deform(plan, jnp.asarray(u) + step * jnp.asarray(direction))
        return np.asarray(places(mesh, moved))

    start = at(0.0)
    bounds = CornerBounds(mesh, plan.points.dtype, min_jacobian_ratio, proven)
    found = bounds.largest_share(start, at(max_step))
    found = LargestStep(found.step * max_step, found.cell)
    return _proven_back(bounds, at, found, plan.points.dtype) if proven else found


def _proven_back(
    bounds: "CornerBounds", at: Callable[[float], np.ndarray], found: LargestStep, dtype: Any
) -> LargestStep:
    """Goes back from a step until its points, which have a round-off of their own, are proven."""
    step = found.step
    cell = found.cell
    less = float(np.finfo(dtype).eps)
    while step > 0 and (broken := bounds.proven_share(at(step), at(step)).cell) >= 0:
        step = step * max(1 - less, 0.0)
        cell = broken
        less = 4 * less
    return LargestStep(step, cell)


def _check_linear(plan: Plan) -> None:
    if not plan.is_linear:
        raise ValueError(
            f"this plan is not linear in `u`: {_nonlinear(plan)}. Its nodes leave straight lines, "
            "so a cell may invert before the step that straight lines give. "
            "jm.fewest_steps(plan, mesh, motion) finds how much of a motion keeps a bound. "
            "jm.ValidSteps judges each step of a line search where it ends."
        )


def _nonlinear(plan: Plan) -> str:
    method = plan.method
    if method.linear:
        return "nodes slide along curved walls"
    while parts := [
        part
        for part in vars(method).values()
        if isinstance(part, AbstractMethod) and not part.linear
    ]:
        method = parts[0]
    return f"{type(method).__name__} is not"


@dataclasses.dataclass(frozen=True, eq=False)
class _Corners:
    """Cells of one type, from the number `first` on, with their signs (k,), and the mask of judged
    corners (s, k). `scale` (k,) are the smallest corner Jacobians of the undeformed cells.
    """

    kind: str
    ids: Int[np.ndarray, "k c"]
    first: int
    sign: np.ndarray
    judged: Bool[np.ndarray, "s k"]
    scale: Float[np.ndarray, " k"]

    def jacobians(self, points: Any) -> Any:
        relative = measures.relative_corners(corner_points(points, self.ids))[0]
        return self.sign[None] * measures.jacobians(self.kind, relative)[0]

    def polynomials(self, start: np.ndarray, end: np.ndarray) -> Float[np.ndarray, "4 s k"]:
        """Coefficients of Jacobians over t from 0 to 1, the lowest first."""
        times = np.arange(4) / 3
        samples = np.stack([self.jacobians(start + t * (end - start)) for t in times]).astype(float)
        powers = np.vander(times, increasing=True)
        return np.linalg.solve(powers, samples.reshape(4, -1)).reshape(samples.shape)


class CornerBounds:
    """Bounds at corners, with `proven` of whole cells; hashed by identity for compilation."""

    def __init__(self, mesh: Mesh, dtype: Any, min_jacobian_ratio: float, proven: bool = False):
        self.mesh = mesh
        self.min_jacobian_ratio = min_jacobian_ratio
        self.of_cells = min_jacobian_ratio * least_undeformed(mesh) if proven else None
        standards, signs = jax.tree.map(np.asarray, (standards_of(mesh, dtype), signs_of(mesh)))
        self.signs = signs
        self.parts = []
        for kind, ids in jax.tree.map(np.asarray, mesh.cells).items():
            standard = standards[kind]
            first = sum(len(part.ids) for part in self.parts)
            every = _Corners(kind, ids, first, standard.sign, standard.is_judged, standard.jacobian)
            # not the least one of a curved cell
            judged = (standard.is_judged & ~standard.was_inverted)[
                : len(every.jacobians(np.asarray(mesh.points)))
            ]
            self.parts.append(dataclasses.replace(every, judged=judged))

    def largest_share(self, start: Points, end: Points) -> LargestStep:
        """Finds the share of the way, at most 1, that keeps all bounds, and the cell there."""
        best = LargestStep(1.0, -1)
        for part in self.parts:
            values = part.polynomials(start, end)
            values[0] -= self.min_jacobian_ratio * part.scale
            rows, columns = np.nonzero(part.judged)
            best = _sooner(best, first_roots(values[:, rows, columns]), part.first + columns)
        if self.of_cells is None:
            return best
        # Never beyond what the corners allow, so that round-off is that of the step itself.
        proven = self.proven_share(start, start + best.step * (np.asarray(end, float) - start))
        return LargestStep(best.step * proven.step, proven.cell) if proven.step < 1 else best

    def proven_share(self, start: Points, end: Points) -> LargestStep:
        """Finds the share of the straight way on which whole cells keep their bound, at most 1. At
        each instant the least coefficient is a lower bound on det J, so the step ends where the
        first coefficient falls below. Only cells that would end it are cut.
        """
        assert self.of_cells is not None
        best = LargestStep(1.0, -1)
        ends = (np.asarray(start, float), np.asarray(end, float))
        for part in self.parts:
            if DIMENSION[part.kind] != self.mesh.points.shape[1]:
                continue
            form = form_of(part.kind, True)
            space = form_of(part.kind).space
            for rows in blocks(np.arange(len(part.ids)), 4 * bernstein.count_coefficients(space)):
                x = nodes_of(part.ids[rows].T, *ends)
                cell = part.first + rows
                columns = form.columns(x)
                excess = self.signs[part.kind][rows] * form.determinant(columns) - form.round_off(
                    x, columns
                )
                excess = (excess - self.of_cells[cell]).reshape(
                    -1, bernstein.count_coefficients(space), len(rows)
                )
                best = _search(space, excess, cell, best)
        return best

    def hold(self, points: Float[Array, "n d"]) -> Bool[Array, ""]:
        return jnp.all(self.ratios(points) > self.min_jacobian_ratio)

    def ratios(self, points: Float[Array, "n d"]) -> Float[Array, " s"]:
        """The Jacobian ratio at each corner; infinite where there is no bound. Traced."""
        ratios = [
            jnp.where(
                part.judged, part.jacobians(points) / np.where(part.judged, part.scale, 1), jnp.inf
            ).ravel()
            for part in self.parts
        ]
        return jnp.concatenate(ratios)

    @property
    def cells(self) -> Int[np.ndarray, " s"]:
        """The cell of each ratio, -1 at corners without a bound."""
        cells = [
            np.where(part.judged, part.first + np.arange(len(part.ids)), -1).ravel()
            for part in self.parts
        ]
        return np.concatenate(cells)


class DesignedMesh(Module):
    """A mesh that design variables move, with a bound on the Jacobian ratios at its corners.

    `ValidSteps` and `shapes.MeshGuard` take it; a constraint of your own can, too. Its functions
    are traced.

        design = jm.DesignedMesh(plan, mesh, lambda variables: operator(variables))
        smallest = design.ratios(variables).min()

    **Arguments:**

    - `plan`: from `prepare`.
    - `mesh`: whose `points` are the plan's.
    - `displacement`: takes the design variables and returns `u` (m, d).
    - `min_jacobian_ratio`: bound on `QualityReport.jacobian_ratio`. Default 0, where cells invert.
    - `proven`: whether whole cells have a bound too, as in `largest_step`. Default False.

    **Raises:** `ValueError` for a bound outside of 0 to 1, and for a mesh that is not the plan's.
    With `proven`, also for undeformed cells that are not proven valid.
    """

    plan: Plan
    displacement: Callable[[Any], Float[Array, "m d"]]
    bounds: CornerBounds = eqx.field(static=True)

    @checked
    def __init__(
        self,
        plan: Plan,
        mesh: Mesh,
        displacement: Callable[[Any], Any],
        *,
        min_jacobian_ratio: float = 0.0,
        proven: bool = False,
    ):
        between("min_jacobian_ratio", min_jacobian_ratio, 0, 1, "[)")
        places(mesh, plan.points)
        self.plan = plan
        self.displacement = displacement
        self.bounds = CornerBounds(mesh, plan.points.dtype, min_jacobian_ratio, proven)

    @property
    def bound(self) -> float:
        return self.bounds.min_jacobian_ratio

    def points(self, design: Any) -> Float[Array, "n d"]:
        """Moves the mesh by design variables."""
        return deform(self.plan, self.displacement(design))

    def ratios(self, design: Any) -> Float[Array, " s"]:
        """Computes the Jacobian ratio at each corner; infinity at corners without a bound."""
        return self.bounds.ratios(self.points(design))

    @property
    def cells(self) -> Int[np.ndarray, " s"]:
        """The cell of each ratio, in the order of `quality`; -1 at corners without a bound."""
        return self.bounds.cells


def least_undeformed(mesh: Mesh) -> Float[np.ndarray, " k"]:
    """The least proven det J of each undeformed cell; raises `ValueError` for invalid cells."""
    undeformed = proof(mesh, mesh.points)
    if undeformed.valid < undeformed.count:
        first = undeformed.worst(1)[0]
        raise ValueError(
            f"{undeformed.count - undeformed.valid} of {undeformed.count} cells of the undeformed "
            "mesh are not proven valid, first "
            f"cell {first}: no step can be. jm.proof(mesh) lists them; proven=False looks at "
            "corners alone."
        )
    return undeformed.lower


def _search(
    space: bernstein.Space,
    excess: Float[np.ndarray, "t n p"],
    cell: np.ndarray,
    best: LargestStep,
    level: int = 0,
) -> LargestStep:
    """Takes values at corners, which are certain, and cuts the parts that may end the step."""
    best = _sooner(best, _first(excess[:, bernstein.corners(space)]), cell)
    least = _first(excess)
    if level == DEPTH:
        return _sooner(best, least, cell)
    t, n, _ = excess.shape
    for some in blocks(np.flatnonzero(least < best.step), 32 * n):
        parts = bernstein.halved(space, np.moveaxis(excess[:, :, some], 0, 1).reshape(n, -1))
        parts = np.moveaxis(parts.reshape(n, -1, t, len(some)), 2, 0).reshape(t, n, -1)
        best = _search(
            space, parts, np.tile(cell[some], parts.shape[2] // len(some)), best, level + 1
        )
    return best


def _sooner(
    best: LargestStep, steps: Float[np.ndarray, " p"], cell: Int[np.ndarray, " p"]
) -> LargestStep:
    if len(steps) and steps.min() < best.step:
        return LargestStep(float(steps.min()), int(cell[steps.argmin()]))
    return best


def _first(excess: Float[np.ndarray, "t n p"]) -> Float[np.ndarray, " p"]:
    """When each part's first coefficient falls below 0; infinity if none does in 0 to 1."""
    steps = np.full(excess.shape[1:], np.inf)
    falls = excess.min(axis=0) < 0
    degree = len(excess) - 1
    # from Bernstein coefficients in time, of degree 2 or 3, to those of powers
    powers = np.zeros((4, falls.sum()))
    for k in range(degree + 1):
        powers[k] = math.comb(degree, k) * np.diff(excess[:, falls], k, axis=0)[0]
    steps[falls] = first_roots(powers)
    return steps.min(axis=0)


def first_roots(coefficients: Float[np.ndarray, "4 k"]) -> Float[np.ndarray, " k"]:
    """Where cubics (lowest coefficient first) first fall below 0 in 0 to 1; else infinity."""
    roots, (_, c1, c2, c3) = np.where(coefficients[0] < 0, 0, np.inf), coefficients
    with np.errstate(divide="ignore", invalid="ignore"):
        # places of the extremes, by the form of the quadratic's roots that does not cancel
        half = c2 + np.copysign(np.sqrt(np.maximum(c2**2 - 3 * c1 * c3, 0)), c2)
        extremes = np.stack([-half / (3 * c3), -c1 / half])
    extremes = np.sort(np.where((extremes > 0) & (extremes < 1), extremes, 1), axis=0)
    for low, high in itertools.pairwise([0 * c1, *extremes, 0 * c1 + 1]):
        falls = np.isinf(roots) & (polyval(high, coefficients, tensor=False) < 0)
        some = coefficients[:, falls]
        low = low[falls]
        high = high[falls]
        for _ in range(60 if falls.any() else 0):
            middle = 0.5 * (low + high)
            is_below = polyval(middle, some, tensor=False) < 0
            low = np.where(is_below, low, middle)
            high = np.where(is_below, middle, high)
        roots[falls] = low
    return roots
