"""The fewest steps in which a large motion leaves no cell inverted."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Real

from .._host.package.arguments import between, checked, finite_array, whole
from .._improve.improve import Improvement
from .._improve.improve import improve as improved
from .._mesh.mesh import Mesh
from .._plan.plan import Plan
from .._plan.steps import march
from .._quality.report import QualityReport
from .._quality.verdict import Verdict, judge
from .turn import Turn


@dataclasses.dataclass(frozen=True)
class Steps:
    """Result of `fewest_steps`.

    - `count`: how many steps.
    - `fraction`: the share of the motion that they reach; 1 is the whole motion.
    - `points`: the points (n, d) at the end, with the `verdict` on them, and `report` of their
      quality.
    - `plans`: one plan a step; `replay` repeats them along `path` (count, m, d), up to the
      improvement.
    - `improvement`: of the last step's mesh, or None where the steps alone are good.
    """

    count: int
    fraction: float
    points: Float[Array, "n d"]
    verdict: Verdict
    plans: tuple[Plan, ...]
    path: Float[Array, "k m d"]
    improvement: Improvement | None = None

    @property
    def report(self) -> QualityReport:
        assert self.verdict.corners is not None
        return self.verdict.corners

    @checked
    def path_to(self, u: Real[ArrayLike, "m d"]) -> Float[Array, "k m d"]:
        """Computes the path whose end is `u` (m, d): `path`, and what `u` adds, in equal parts.

        Traced and linear in `u`, so that `replay(steps.plans, steps.path_to(u))` has derivatives by
        `u`. The turn of `path` stays.
        """
        if np.shape(u) != self.path.shape[1:]:
            raise ValueError(
                f"`u` has shape {np.shape(u)}; the path ends at {self.path.shape[1:]}."
            )
        shares = jnp.arange(1, self.count + 1, dtype=self.path.dtype) / self.count
        return self.path + shares[:, None, None] * (jnp.asarray(u) - self.path[-1])[None]


@checked
def fewest_steps(
    plan: Plan,
    mesh: Mesh,
    motion: Callable[[float], Real[ArrayLike, "m d"]] | Real[ArrayLike, "m d"],
    *,
    min_jacobian_ratio: float = 0.05,
    max_steps: int = 16,
    improve: bool = False,
) -> Steps:
    """Marches a motion, on the host, in the fewest equal steps that leave no cell inverted.

    A number of steps is good when `judge` finds no cell that they spoil, and the smallest corner
    Jacobian stays above `min_jacobian_ratio` of its initial value. When even `max_steps` steps are
    not good, the result has the largest fraction of the motion that they reach, to 1/1000. With
    `improve`, `jm.improve` then mends the mesh at their end, and if that is not good either, the
    largest fraction is sought again, to 1/100: seconds a trial for 10,000 cells.

    **Arguments:**

    - `plan`: what `prepare` returned.
    - `mesh`: the mesh whose cells are judged.
    - `motion`: the displacement (m, d) of the moving nodes, on the way that turns as it
      does (`Turn`). Or a function: `motion(t)` for t from 0 to 1 is the total displacement.
    - `max_steps`: the most steps to try, default 16.

    **Raises:** `ValueError` when `max_steps` is less than 1, `min_jacobian_ratio` is not from 0 to
    1, or `plan` and `mesh` differ in their points. Also for a `motion(t)` that is not (m, d) or not
    finite.
    """
    whole("max_steps", max_steps)
    between("min_jacobian_ratio", min_jacobian_ratio, 0, 1, "[)")
    plan.check_mesh(mesh)
    expected = (plan.n_moving, plan.points.shape[1])
    if not callable(motion):
        motion = Turn.of(
            np.asarray(plan.moving_points), finite_array("motion", motion, expected)
        ).at

    trials = _Trials(plan, mesh, motion, judge(mesh), min_jacobian_ratio)
    for count in range(1, max_steps + 1):
        if trials.is_good(steps := trials.march(count)):
            return steps
    if improve and trials.is_good(steps := trials.march(max_steps, mend=True)):
        return steps
    best = trials.farthest(trials.march(max_steps, 0.0), 1e-3)
    return trials.farthest(best, 1e-2, mend=True) if improve else best


@dataclasses.dataclass(frozen=True, eq=False)
class _Trials:
    """Marches of a motion, by numbers of steps and fractions, with the verdict on each."""

    plan: Plan
    mesh: Mesh
    motion: Callable[[float], Any]
    before: Verdict
    min_jacobian_ratio: float

    def march(self, count: int, fraction: float = 1.0, mend: bool = False) -> Steps:
        expected = (self.plan.n_moving, self.plan.points.shape[1])
        parts = [
            finite_array("motion(t)", self.motion(fraction * (j + 1) / count), expected)
            for j in range(count)
        ]
        path = jnp.stack(list(map(jnp.asarray, parts)))
        improvement = None
        plans, points = march(self.plan, path)
        if mend:
            improvement = improved(self.plan.boundary.altered(mesh=self.mesh), points)
            points = improvement.points
        verdict = judge(self.mesh, points, before=self.before)
        return Steps(count, fraction, points, verdict, plans, path, improvement)

    def is_good(self, steps: Steps) -> bool:
        judged = steps.verdict.judged
        if steps.verdict.spoilt or judged is None:
            return False
        return judged.ratio > self.min_jacobian_ratio

    def farthest(self, best: Steps, width: float, mend: bool = False) -> Steps:
        """Bisects the fraction between that of `best` and the whole motion to a `width`."""
        low = best.fraction
        high = 1.0  # on the host: a motion may be NumPy's
        while high - low > width:
            steps = self.march(best.count, (low + high) / 2, mend)
            if self.is_good(steps):
                best = steps
                low = steps.fraction
            else:
                high = steps.fraction
        return best
