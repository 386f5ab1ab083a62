"""Stages of `improve`, each a minimum by Newton's method: first a barrier, then a bound."""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Float, Int

from .._host.linear.hessians import Pattern, solve, solve_exactly
from .._kernels.callback import host_call
from .._kernels.compile import compiled
from .._quality.distortion import Bounds
from .motion import Distortion, Nodal, Ways

# least cosine between a wall's normals at a node's start and end; below it, no minimum
QUARTER = 0.05

SHARPEST = 1e-3
GENTLER = 0.3
STAGES = 5
"""Softness of the barrier in the last stage, its largest factor per stage, and most stages."""

ROOM_LEFT = 0.95
RUNG = 1.02
RUNGS = 40
"""Worst sample over its bound where a stage begins, ratio of two rungs, and most stages."""

# least tolerance between two stages of stiffening: a looser one would end them too early
CLOSE = 0.03


class Search(NamedTuple):
    blocks: Pattern
    tolerance: Float[Array, ""]
    max_steps: int

    def enough(self, last: bool) -> Float[Array, "2"]:
        loose = jnp.maximum(self.tolerance, 0.3)
        return jnp.stack([1e-3 * self.tolerance, self.tolerance] if last else [loose, loose])


class Minimum(NamedTuple):
    distortion: Distortion
    y: Nodal
    steps: Int[Array, ""] | int


def minimise_softly(distortion: Distortion, base: Nodal, search: Search) -> Minimum:
    """Finds the minimum in stages, in which the barrier at det T = 0 sharpens."""
    softness = jnp.asarray(1 / GENTLER)
    held = jax.lax.stop_gradient(base)
    distortion = eqx.tree_at(lambda it: it.ways, distortion, _ways_at(distortion.ways, held))
    y = jnp.zeros_like(base)
    count = 0
    stage = distortion
    for stage_number in range(1, STAGES + 1):
        last = stage_number == STAGES
        before = softness
        least = SHARPEST if last else -2 * _least_determinant(distortion, y, held)
        softness = jnp.maximum(jnp.minimum(least, GENTLER * softness), SHARPEST)
        stage = eqx.tree_at(lambda it: it.softness, distortion, softness.astype(base.dtype))
        end = (last | (softness < before), search.enough(last))
        y, steps = _minimise(stage, jax.lax.stop_gradient(y), base if last else held, search, end)
        count += steps
    return Minimum(stage, y, count)


def minimise_stiffly(plain: Minimum, base: Nodal, search: Search) -> Minimum:
    """Finds the minimum within the closest feasible bounds on distortion and size. Bounds stand on
    rungs. Between jumps they do not depend on the points, so the derivative of the last minimum is
    the derivative of the whole search.
    """
    y, held = map(jax.lax.stop_gradient, (plain.y, base))
    distortion, y, steps = _climb_rungs(plain.distortion, y, held, search)
    y, last = _minimise(
        distortion, y, base, search, (True, jnp.minimum(search.enough(last=True), CLOSE / 10))
    )
    return Minimum(distortion, y, plain.steps + steps + last)


@compiled
def _climb_rungs(distortion: Distortion, y, base, search: Search):
    """Moves the bounds rung by rung until the worst samples leave no room for the next. Returns the
    rungs where the smallest determinant is largest, and the steps of all rungs.
    """
    distortion = distortion.movable()
    enough = jnp.stack([jnp.maximum(search.tolerance, CLOSE)] * 2)

    def rungs(y):
        closest = jnp.stack(
            [1 / jnp.maximum(distortion.worst(y, base), 1e-6), distortion.least(y, base)]
        )
        highest = jnp.log(ROOM_LEFT * jnp.maximum(closest, 0)) / jnp.log(
            RUNG
        )  # -inf where a cell is inverted: no bound
        return jnp.floor(highest).astype(base.dtype)

    def stiff(rungs):
        return dataclasses.replace(distortion, bounds=Bounds(*RUNG**rungs))

    def goes_on(state):
        y, now, *_, stage = state
        return jnp.any(rungs(y) > now) & (stage < RUNGS)

    def climb(state):
        y, now, best, count, stage = state
        now = jnp.maximum(now, rungs(y))
        y, steps = _minimise(stiff(now), y, base, search, (True, enough))
        here = y, now, distortion.least(y, base)
        best = jax.tree.map(lambda new, old: jnp.where(here[2] > best[2], new, old), here, best)
        return y, now, best, count + steps, stage + 1

    none = jnp.full(2, -jnp.inf, base.dtype)
    start = y, none, (y, none, distortion.least(y, base)), jnp.asarray(0), jnp.asarray(0)
    _, _, (y, now, _), count, _ = jax.lax.while_loop(goes_on, climb, start)
    return stiff(now), y, count


def _silent(**report: Any) -> None: ...


@compiled
def _minimise(distortion: Distortion, y, base, search: Search, end: Any):
    wanted, (relative, absolute) = end
    blocks, _, max_steps = search
    solver = ProjectedNewton(
        rtol=relative,
        atol=absolute,
        norm=optx.rms_norm,
        distortion=distortion,
        base=jax.lax.stop_gradient(base),
        pattern=blocks,
        verbose=_silent,
    )
    adjoint = optx.ImplicitAdjoint(HessianSolver(distortion, solver.base, blocks))
    tags = frozenset({lx.positive_semidefinite_tag})

    def minimum(y):
        run = optx.minimise(
            distortion,
            solver,
            y,
            base,
            max_steps=max_steps,
            adjoint=adjoint,
            throw=False,
            tags=tags,
        )
        return run.value, run.stats["num_steps"]

    return jax.lax.cond(wanted, minimum, lambda y: (y, jnp.asarray(0)), y)


_ways_at = compiled(Ways.at)
_least_determinant = compiled(Distortion.least)


@compiled
def judge_minimum(plain: Distortion, minimum: Minimum, base: Nodal):
    distortion, y, _ = minimum
    values = plain(y, base), plain(jnp.zeros_like(y), base)
    slope = jax.grad(distortion)(y, base)
    points = distortion.points(y, base)
    ways = distortion.ways
    if not ways.is_linear:
        # A quarter of a turn from its start, a node's slope vanishes, at a minimum or not.
        # The cosine is that of the normals on one wall, that of the tangents between two walls.
        common = jnp.sum(ways.off * ways.at(points).off, axis=(1, 2))
        along = 1 + common - jnp.trace(ways.off, axis1=1, axis2=2)
        least = jnp.min(along, where=distortion.free, initial=1.0)
        slope = jnp.where(least > QUARTER**2, slope, jnp.inf)
    return values, slope, points, plain.lost(points)


# largest derivative (order one) at which the whole Hessian is taken: quadratic convergence
NEAR_MINIMUM = 1.0


def _solve_on_host(solver: Callable, pattern: Pattern, blocks, shift, right: Nodal) -> Nodal:
    structure = jax.ShapeDtypeStruct(right.shape, right.dtype)
    return host_call(solver, structure, *pattern, blocks, shift, right)


class HessianSolver(lx.AbstractLinearSolver):
    """A solver with the energy's Hessian at a minimum, on the host: implicit differentiation. Its
    operator is the derivative of the energy's gradient, as optimistix builds it.
    """

    distortion: Distortion
    base: Nodal
    pattern: Pattern

    def init(self, operator: Any, options):
        return self.distortion.blocks(jax.lax.stop_gradient(operator.x), self.base, -jnp.inf)

    def compute(self, state, vector, options):
        solution = _solve_on_host(
            solve_exactly, self.pattern, state, self.distortion.shift(), vector
        )
        return solution, lx.RESULTS.successful, {}

    def transpose(self, state, options):
        return state, options

    def conj(self, state, options):
        return state, options

    def assume_full_rank(self):
        return True


class ProjectedNewton(optx.AbstractQuasiNewton):
    """Newton's method; far from a minimum without negative curvature, so that steps descend (Teran
    et al., Robust quasistatic finite elements and flesh simulation, SCA 2005).
    """

    rtol: Any
    atol: Any
    norm: Callable
    distortion: Distortion
    base: Nodal
    pattern: Pattern
    verbose: Callable
    use_inverse: bool = True
    descent: optx.AbstractDescent = optx.NewtonDescent()
    search: optx.AbstractSearch = optx.BacktrackingArmijo(slope=1e-4)

    def init_hessian(self, y, f, grad):
        pairs = len(self.pattern.block)
        return self._information(f, grad, jnp.zeros((y.shape[1], y.shape[1], pairs), y.dtype)), None

    def update_hessian(self, y, y_eval, f_info, f_eval_info, hessian_update_state):
        near = jnp.max(jnp.abs(f_eval_info.grad)) < NEAR_MINIMUM
        blocks = self.distortion.blocks(y_eval, self.base, jnp.where(near, -jnp.inf, 0))
        return self._information(f_eval_info.f, f_eval_info.grad, blocks), None

    def _information(self, f, grad, blocks):
        inverse = eqx.Partial(_solve_on_host, solve, self.pattern, blocks, self.distortion.shift())
        structure = jax.ShapeDtypeStruct(grad.shape, grad.dtype)
        # not converted: a closure converted anew would be another type, and so another state
        operator = lx.FunctionLinearOperator(
            inverse, structure, lx.symmetric_tag, closure_convert=False
        )
        return optx.FunctionInfo.EvalGradHessianInv(f, grad, operator)
