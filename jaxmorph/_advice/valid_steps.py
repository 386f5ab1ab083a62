"""A line search for optimistix that never inverts a cell."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, PyTree, Scalar

from .._host.package.arguments import checked
from .._kernels.callback import host_call
from .._kernels.module import Module
from .largest_step import DesignedMesh

SHARE = 0.9  # of the way to the bound that is tried
SLOPE = 0.1  # part of the linear gain that Armijo's rule asks for
DECREASE = 0.5  # factor of a step that gains too little


class ValidSteps(Module, optx.AbstractSearch):
    """Searches along a line by backtracking; a step that would invert a cell is shortened.

    The way ends where `largest_step` finds it, and nine tenths of it are tried next. Other steps
    end by Armijo's rule. The search suits descents whose change is a multiple of the step, such as
    `optimistix.NewtonDescent` and `optimistix.SteepestDescent`.

        mesh = jm.DesignedMesh(plan, mesh, lambda design: operator(design))
        search = jm.ValidSteps(mesh)
        solver = equinox.tree_at(lambda solver: solver.search, optimistix.BFGS(1e-6, 1e-6), search)
        optimistix.minimise(search.guarded(drag), solver, start)

    **Arguments:**

    - `mesh`: a `DesignedMesh`, moved by the optimiser's variables. Where its motion, or its plan,
      is not linear, the way's end is that of the chord, and the step is cut again until it fits.
      If it is `proven`, whole cells are judged on the straight way to each step that is accepted;
      `holds` and `guarded` look at corners alone.
    """

    mesh: DesignedMesh

    @checked
    def __init__(self, mesh: DesignedMesh):
        self.mesh = mesh

    def holds(self, y: PyTree) -> Bool[Array, ""]:
        """Checks whether every corner of the mesh of these variables keeps its bound."""
        return self.mesh.bounds.hold(self.mesh.points(y))

    def guarded(self, objective: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
        """Makes an objective that is infinite, and runs no flow, where the mesh breaks a bound."""

        def guard(y: Any, args: Any) -> Any:
            shapes = jax.eval_shape(objective, y, args)

            def infinite():
                return jax.tree.map(lambda leaf: jnp.full(leaf.shape, jnp.inf, leaf.dtype), shapes)

            return jax.lax.cond(self.holds(y), lambda: objective(y, args), infinite)

        return guard

    def init(self, y: PyTree, f_info_struct: Any) -> Scalar:
        """Begins with a whole step."""
        return jnp.array(1.0)

    def step(
        self, first_step: Any, y: Any, y_eval: Any, f_info: Any, f_eval_info: Any, state: Any
    ) -> tuple[Any, Any, Any, Any]:
        """Accepts the variables that were tried, or gives a shorter step."""
        before = self.mesh.points(y)
        after = self.mesh.points(y_eval)
        bounds = self.mesh.bounds
        share = jax.ShapeDtypeStruct((), before.dtype)
        way = host_call(lambda *ends: bounds.largest_share(*ends).step, share, before, after)
        fits = (way >= 1) & bounds.hold(after)
        gain = f_info.compute_grad_dot(jax.tree.map(jnp.subtract, y_eval, y))
        falls = f_eval_info.as_min() - f_info.as_min() <= SLOPE * gain
        accept = first_step | (fits & falls & (gain <= 0))
        shorter = jnp.where(fits, DECREASE, jnp.minimum(SHARE * way, SHARE))
        step = jnp.where(accept, 1.0, shorter * state)
        blocked = ~accept & (way <= 0)
        result = optx.RESULTS.where(
            blocked, optx.RESULTS.nonlinear_divergence, optx.RESULTS.successful
        )
        return step, accept, result, step
