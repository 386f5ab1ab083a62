"""Newton's method for a mesh's distortion: optimistix's line search, positive Hessians of cells."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Float

from .._host.linear.hessians import Pattern, solve, solve_exactly
from .._kernels.callback import host_call
from .motion import Distortion

NEAR = 1.0
"""Largest derivative (order one) at which the whole Hessian is taken: quadratic convergence."""


def _on_host(solver: Callable, pattern: Pattern, blocks, shift, right: Float[Array, "n d"]) -> Float[Array, "n d"]:
    """Calls a solver of `hessians` on the host, with a Hessian and a right side."""
    structure = jax.ShapeDtypeStruct(right.shape, right.dtype)
    return host_call(solver, structure, *pattern, blocks, shift, right)


class _Inverse(lx.AbstractLinearOperator):
    """The inverse of a Hessian, applied on the host."""

    pattern: Pattern
    blocks: Float[Array, "d d pairs"]
    shift: Float[Array, " n"]
    structure: Any = eqx.field(static=True)

    def mv(self, vector):
        return _on_host(solve, self.pattern, self.blocks, self.shift, vector)

    def as_matrix(self):
        return jax.vmap(self.mv)(jnp.eye(self.in_size()).reshape(-1, *self.structure.shape)).reshape(self.in_size(), -1)

    def transpose(self):
        return self

    def in_structure(self):
        return self.structure

    def out_structure(self):
        return self.structure


class HessianSolver(lx.AbstractLinearSolver):
    """A solver with the energy's Hessian at a minimum, on the host: implicit differentiation.

    Its operator is the derivative of the energy's gradient, as optimistix builds it.
    """

    distortion: Distortion
    base: Float[Array, "n d"]
    pattern: Pattern

    def init(self, operator, options):
        if not isinstance(operator, lx.JacobianLinearOperator):
            raise ValueError(
                f"the Hessian of an energy is a `JacobianLinearOperator`, not a {type(operator).__name__}."
            )
        return self.distortion.blocks(jax.lax.stop_gradient(operator.x), self.base, -jnp.inf)

    def compute(self, state, vector, options):
        solution = _on_host(solve_exactly, self.pattern, state, self.distortion.shift(), vector)
        return solution, lx.RESULTS.successful, {}

    def transpose(self, state, options):
        return state, options

    def conj(self, state, options):
        return state, options

    def assume_full_rank(self):
        return True


@lx.is_symmetric.register(_Inverse)
def _(operator):
    return True


class ProjectedNewton(optx.AbstractQuasiNewton):
    """Newton's method; far from a minimum without negative curvature, so that steps descend.

    Teran et al., Robust quasistatic finite elements and flesh simulation, SCA 2005.
    """

    rtol: Any
    atol: Any
    norm: Callable
    distortion: Distortion
    base: Float[Array, "n d"]
    pattern: Pattern
    verbose: Callable
    use_inverse: bool = True
    descent: optx.AbstractDescent = optx.NewtonDescent()
    search: optx.AbstractSearch = optx.BacktrackingArmijo(slope=1e-4)

    def init_hessian(self, y, f, grad):
        pairs = len(self.pattern.block)
        return self._information(f, grad, jnp.zeros((y.shape[1], y.shape[1], pairs), y.dtype)), None

    def update_hessian(self, y, y_eval, f_info, f_eval_info, hessian_update_state):
        near = jnp.max(jnp.abs(f_eval_info.grad)) < NEAR
        blocks = self.distortion.blocks(y_eval, self.base, jnp.where(near, -jnp.inf, 0))
        return self._information(f_eval_info.f, f_eval_info.grad, blocks), None

    def _information(self, f, grad, blocks):
        inverse = _Inverse(self.pattern, blocks, self.distortion.shift(), jax.ShapeDtypeStruct(grad.shape, grad.dtype))
        return optx.FunctionInfo.EvalGradHessianInv(f, grad, inverse)
