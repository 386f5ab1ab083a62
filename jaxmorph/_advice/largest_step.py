"""The largest step of a surface in a direction before a cell breaks a bound.

It is exact, for the mesh moves linearly.
"""

import dataclasses
import itertools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from .._host.cells.topology import DIMENSION
from .._host.package.arguments import between, checked, finite_array
from .._kernels.module import Module
from .._mesh.mesh import Mesh
from .._methods.base import AbstractMethod
from .._plan.deform import deform
from .._plan.plan import Plan
from .._quality import measures
from .._quality.proof import bernstein
from .._quality.proof.form import form_of, nodes_of
from .._quality.proof.proof import proof
from .._quality.proof.search import DEPTH, ROOM
from .._quality.quality import places, signs_of, standards_of
from .._quality.vector import corners


@dataclasses.dataclass(frozen=True)
class LargestStep:
    """Result of `largest_step`.

    - `step`: factor of the direction, at most `max_step`.
    - `cell`: the cell that reaches the bound there, in the order of `quality`; -1 where none does.
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
    are found. A line search shortens its step by it before the flow is solved. With `proven` the
    Bernstein coefficients of det J take the corners' place, as in `proof`: whole cells keep the
    bound, at each instant up to the step. `proof` then finds that the points at its end are valid.
    Corners of cells that are folded on the undeformed mesh end no step.

    **Arguments:**

    - `plan`: a plan that is linear in `u` (`plan.is_linear`).
    - `u`: displacement (m, d) to start from.
    - `direction`: (m, d) change of `u` by a step of 1.
    - `mesh`: whose `points` are the plan's.
    - `min_jacobian_ratio`: bound on `QualityReport.jacobian_ratio`; 0 is where cells invert.
    - `max_step`: above 0; no step beyond it is looked at.
    - `proven`: judge whole cells too, default False. Their bound is relative to the least det J
      that is proven of the undeformed cell.

    **Returns:** a `LargestStep`; its step is 0 where `u` breaks the bound already.

    **Raises:** `ValueError` for wrong shapes, for a bound outside of 0 to 1, and where `max_step`
    is not above 0. Also for a plan that is not linear: its nodes leave the straight lines on which
    roots are sought. With `proven`, also for a mesh with undeformed cells that are not proven
    valid.
    """
    if not plan.is_linear:
        raise ValueError(
            f"this plan is not linear in `u`: {_nonlinear(plan)}. Its nodes leave straight lines, so a cell may invert before the "
            "step that straight lines give. jm.fewest_steps(plan, mesh, motion) finds how much of a motion keeps a bound. "
            "jm.ValidSteps judges each step of a line search where it ends."
        )
    between("min_jacobian_ratio", min_jacobian_ratio, 0, 1, "[)")
    between("max_step", max_step, 0)
    shape = plan.n_moving, plan.points.shape[1]
    u, direction = finite_array("u", u, shape), finite_array("direction", direction, shape)

    def at(step: float) -> np.ndarray:
        return np.asarray(places(mesh, deform(plan, jnp.asarray(u) + step * jnp.asarray(direction))))

    start, end = at(0.0), at(max_step)
    bounds = Bounds(mesh, plan.points.dtype, min_jacobian_ratio, proven)
    share, cell = bounds.share(start, end)
    step, less = share * max_step, float(np.finfo(plan.points.dtype).eps)
    # the points at the step have a round-off of their own
    while step > 0 and (broken := bounds.broken(at(step))) >= 0:
        step, cell, less = step * max(1 - less, 0.0), broken, 4 * less
    return LargestStep(step, cell)


def _nonlinear(plan: Plan) -> str:
    method = plan.method
    if method.linear:
        return "nodes slide along curved walls"
    while parts := [part for part in vars(method).values() if isinstance(part, AbstractMethod) and not part.linear]:
        method = parts[0]
    return f"{type(method).__name__} is not"


class Bounds:
    """Bounds of the Jacobians at a mesh's corners, and with `proven` of det J of whole cells.

    An instance is equal only to itself, so that compiled programs may hold it.
    """

    def __init__(self, mesh: Mesh, dtype: Any, min_jacobian_ratio: float, proven: bool = False):
        self.mesh, self.of_cells = mesh, min_jacobian_ratio * least_undeformed(mesh) if proven else None
        self.min_jacobian_ratio = min_jacobian_ratio
        standards, self.signs = jax.tree.map(np.asarray, (standards_of(mesh, dtype), signs_of(mesh)))
        self.parts = []
        for (kind, ids), standard in zip(mesh.cells.items(), standards, strict=True):
            ids = np.asarray(ids)
            rows = slice(len(_corner_jacobians(kind, np.asarray(mesh.points), ids[:1])))
            judged = (standard.is_judged & ~standard.is_folded)[rows]
            self.parts.append((kind, ids, standard.sign, judged, standard.jacobian))

    def share(self, start: Float[np.ndarray, "n d"], end: Float[np.ndarray, "n d"]) -> tuple[float, int]:
        """Finds the share of the way, at most 1, that keeps all bounds, and the cell that ends it.

        The cell is -1 where none does.
        """
        share, cell = self._of_corners(start, end)
        if self.of_cells is None:
            return share, cell
        # Never beyond what the corners allow, so that round-off is that of the step itself.
        begin, way = np.asarray(start, float), np.asarray(end, float) - np.asarray(start, float)
        part, ends_it = proven_share(self.mesh, self.signs, (begin, begin + share * way), self.of_cells)
        return (share * part, ends_it) if part < 1 else (share, cell)

    def broken(self, points: Float[np.ndarray, "n d"]) -> int:
        """Finds a cell that is not proven to keep its bound; -1 if all are, or corners count."""
        if self.of_cells is None:
            return -1
        x = np.asarray(points, float)
        return proven_share(self.mesh, self.signs, (x, x), self.of_cells)[1]

    def _of_corners(self, start: np.ndarray, end: np.ndarray) -> tuple[float, int]:
        best, worst, offset = 1.0, -1, 0
        for kind, ids, sign, judged, scale in self.parts:
            values = _polynomials(kind, start, end, ids) * sign
            values[0] -= self.min_jacobian_ratio * scale
            rows, columns = np.nonzero(judged)
            roots = first_roots(values[:, rows, columns])
            if len(roots) and roots.min() < best:
                best, worst = float(roots.min()), offset + int(columns[roots.argmin()])
            offset += len(ids)
        return best, worst

    def hold(self, points: Float[Array, "n d"]) -> Bool[Array, ""]:
        """Checks whether every corner is above its bound; traced."""
        return jnp.all(self.ratios(points) > self.min_jacobian_ratio)

    def ratios(self, points: Float[Array, "n d"]) -> Float[Array, " s"]:
        """Computes the Jacobian ratio at each corner; infinite where there is no bound. Traced."""
        ratios = []
        for kind, ids, sign, judged, scale in self.parts:
            jacobians = sign[None] * _corner_jacobians(kind, points, ids)
            ratios.append(jnp.where(judged, jacobians / np.where(judged, scale, 1), jnp.inf).ravel())
        return jnp.concatenate(ratios)

    @property
    def cells(self) -> Int[np.ndarray, " s"]:
        """The cell of each ratio, -1 at corners without a bound."""
        cells, first = [], 0
        for _, ids, _, judged, _ in self.parts:
            cells.append(np.where(judged, first + np.arange(len(ids)), -1).ravel())
            first += len(ids)
        return np.concatenate(cells)


class DesignedMesh(Module):
    """A mesh that design variables move, with bounds on its corners.

    `displacement` takes the variables, and returns `u` (m, d). Raises `ValueError` for a bound
    outside of 0 to 1, and for a mesh that is not the plan's.
    """

    plan: Plan
    displacement: Callable[[Any], Float[Array, "m d"]]
    bounds: Bounds = eqx.field(static=True)

    def __init__(self, plan: Plan, mesh: Mesh, displacement: Callable, min_jacobian_ratio: float, proven: bool = False):
        between("min_jacobian_ratio", min_jacobian_ratio, 0, 1, "[)")
        places(mesh, plan.points)
        self.plan, self.displacement = plan, displacement
        self.bounds = Bounds(mesh, plan.points.dtype, min_jacobian_ratio, proven)

    def points(self, design: Any) -> Float[Array, "n d"]:
        """Moves the mesh; traced."""
        return deform(self.plan, self.displacement(design))

    def ratios(self, design: Any) -> Float[Array, " s"]:
        """Computes the Jacobian ratio at each corner, as `Bounds` does; traced."""
        return self.bounds.ratios(self.points(design))


def _polynomials(kind: str, start: np.ndarray, end: np.ndarray, ids: np.ndarray) -> np.ndarray:
    """Finds the coefficients (4, s, k) of corner Jacobians over t from 0 to 1.

    The lowest coefficient comes first. They follow from four values.
    """
    places = np.arange(4) / 3
    samples = [_corner_jacobians(kind, start + t * (end - start), ids) for t in places]
    inverse = np.linalg.inv(np.vander(places, increasing=True))
    return np.tensordot(inverse, np.stack(samples).astype(float), axes=1)


def _corner_jacobians(kind: str, points: Any, ids: Any) -> Any:
    """Computes the Jacobians (s, k) at corners of cells of one type, by NumPy or JAX."""
    relative, _ = measures.relative_corners(corners(points, ids))
    return measures.jacobians(kind, relative)[0]


def least_undeformed(mesh: Mesh) -> Float[np.ndarray, " k"]:
    """Finds the least det J that is proven of each undeformed cell.

    **Raises:** `ValueError` for cells that are not proven valid.
    """
    undeformed = proof(mesh, mesh.points)
    if undeformed.valid < undeformed.count:
        first = undeformed.worst(1)[0]
        raise ValueError(
            f"{undeformed.count - undeformed.valid} of {undeformed.count} cells of the undeformed mesh are not proven valid, first "
            f"cell {first}: no step can be. jm.proof(mesh) lists them; proven=False looks at corners alone."
        )
    return undeformed.lower


def proven_share(
    mesh: Mesh, signs: dict[str, np.ndarray], ends: tuple[np.ndarray, np.ndarray], bounds: Float[np.ndarray, " k"]
) -> tuple[float, int]:
    """Finds the share of the straight way on which all cells keep their bound, at most 1.

    Also finds the cell that ends it, or -1. `ends` are the points (n, d) at both, `signs` those of
    `signs_of`. At each instant the least coefficient is a lower bound
    on det J, so the step ends where the first coefficient falls below. Only cells that would end it
    are cut.
    """
    search, offset = _Search(), 0
    for kind, ids in mesh.cells.items():
        if DIMENSION[kind] == mesh.points.shape[1]:
            bound = bounds[offset : offset + len(ids)]
            search.through(_Cells(kind, np.asarray(ids).T, signs[kind], ends, bound), offset)
        offset += len(ids)
    return search.step, search.cell


@dataclasses.dataclass(frozen=True, eq=False)
class _Cells:
    """Cells of one type, ids (nodes, k), with sign and bound (k,) of each between two `ends`."""

    kind: str
    ids: np.ndarray
    sign: np.ndarray
    ends: tuple[np.ndarray, np.ndarray]
    bound: np.ndarray

    @property
    def space(self) -> bernstein.Space:
        return form_of(self.kind).space

    def excess(self, cells: Int[np.ndarray, " c"]) -> Float[np.ndarray, "t n c"]:
        """Computes Bernstein coefficients, in time by space, of det J less the bound."""
        form, ids = form_of(self.kind, True), self.ids[:, cells]
        x = [np.concatenate(parts) for parts in zip(*(nodes_of(end, ids) for end in self.ends), strict=True)]
        columns = form.columns(x)
        values = self.sign[cells] * form.determinant(columns) - form.round_off(x, columns) - self.bound[cells]
        return values.reshape(-1, bernstein.count(self.space), len(cells))


class _Search:
    """Holds the largest step so far, which some cell's bound or coefficient ends, and that cell."""

    def __init__(self) -> None:
        self.step, self.cell = 1.0, -1

    def through(self, cells: _Cells, offset: int) -> None:
        """Looks at all cells, then into cells that may end the step before any corner does."""
        size = max(1, ROOM // (4 * bernstein.count(cells.space)))
        blocks = np.split(np.arange(cells.ids.shape[1]), range(size, cells.ids.shape[1], size))
        for block in blocks:
            self._look(cells.space, cells.excess(block), block + offset, 0)

    def _look(self, space: bernstein.Space, excess: np.ndarray, cell: np.ndarray, level: int) -> None:
        """Takes values at corners, which are certain, and cuts the parts that may end the step."""
        corners = bernstein.corners(space)
        self._take(_first(excess[:, corners]), cell)
        least = _first(excess)
        if level == DEPTH:
            self._take(least, cell)
            return
        rows, size = np.flatnonzero(least < self.step), max(1, ROOM // (32 * excess.shape[1]))
        for start in range(0, len(rows), size):
            some = rows[start : start + size]
            t, n, _ = excess.shape
            parts = bernstein.halved(space, np.moveaxis(excess[:, :, some], 0, 1).reshape(n, -1))
            parts = np.moveaxis(parts.reshape(n, -1, t, len(some)), 2, 0).reshape(t, n, -1)
            self._look(space, parts, np.tile(cell[some], parts.shape[2] // len(some)), level + 1)

    def _take(self, steps: Float[np.ndarray, " p"], cell: Int[np.ndarray, " p"]) -> None:
        if len(steps) and steps.min() < self.step:
            self.step, self.cell = float(steps.min()), int(cell[steps.argmin()])


def _first(excess: Float[np.ndarray, "t n p"]) -> Float[np.ndarray, " p"]:
    """Finds when each part's first coefficient falls below 0; infinity if none does in 0 to 1."""
    steps = np.full(excess.shape[1:], np.inf)
    falls = excess.min(axis=0) < 0
    steps[falls] = first_roots(_powers(excess[:, falls]))
    return steps.min(axis=0)


def _powers(values: Float[np.ndarray, "t k"]) -> Float[np.ndarray, "4 k"]:
    """Turns Bernstein coefficients of degree 2 or 3 into coefficients of powers, lowest first."""
    if len(values) == 3:
        a, b, c = values
        return np.stack([a, 2 * (b - a), a - 2 * b + c, np.zeros_like(a)])
    a, b, c, d = values
    return np.stack([a, 3 * (b - a), 3 * (a - 2 * b + c), d - 3 * c + 3 * b - a])


def first_roots(coefficients: Float[np.ndarray, "4 k"]) -> Float[np.ndarray, " k"]:
    """Finds where cubics (lowest coefficient first) first fall below 0 in 0 to 1; else infinity."""
    roots = np.full(coefficients.shape[1], np.inf)
    roots[coefficients[0] < 0] = 0
    c0, c1, c2, c3 = coefficients
    with np.errstate(divide="ignore", invalid="ignore"):
        # places of the extremes, by the form of the quadratic's roots that does not cancel
        half = c2 + np.copysign(np.sqrt(np.maximum(c2**2 - 3 * c1 * c3, 0)), c2)
        extremes = np.stack([-half / (3 * c3), -c1 / half])
    extremes = np.where((extremes > 0) & (extremes < 1), extremes, 1)
    stops = np.concatenate([np.zeros((1, len(c0))), np.sort(extremes, axis=0), np.ones((1, len(c0)))])
    for before, after in itertools.pairwise(stops):
        falls = np.isinf(roots) & (_value(coefficients, after) < 0)
        if falls.any():
            roots[falls] = _bisect(coefficients[:, falls], before[falls], after[falls])
    return roots


def _value(coefficients: np.ndarray, t: np.ndarray) -> np.ndarray:
    c0, c1, c2, c3 = coefficients
    return c0 + t * (c1 + t * (c2 + t * c3))


def _bisect(coefficients: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    for _ in range(60):
        middle = 0.5 * (low + high)
        is_below = _value(coefficients, middle) < 0
        low, high = np.where(is_below, low, middle), np.where(is_below, middle, high)
    return low
