"""Traced functions as OpenMDAO components, whose derivatives are products without a matrix."""

try:
    import openmdao.api as om
except ImportError as error:
    raise ImportError("this component needs openmdao: pip install 'jaxmorph[openmdao]'") from error

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

import jaxmorph as jm
from jaxmorph._host.cells.topology import solid
from jaxmorph._host.package.errors import warn

Values = dict[str, Any]
Traced = Callable[[Values], Any]
"""A pytree that computes one array from arrays by name."""


class TracedComponent(om.ExplicitComponent):
    """Computes one output of inputs by a traced function; forward and reverse products are JAX's.

    A subclass adds inputs and one output in `setup`, and returns the function from `traced`.
    """

    def traced(self) -> Traced:
        """Returns the function: a pytree, so that it is compiled once."""
        raise NotImplementedError

    def compute(self, inputs, outputs, discrete_inputs=None, discrete_outputs=None) -> None:
        (name,) = outputs.keys()
        value = _value(self.traced(), _arrays(inputs))
        outputs[name] = np.asarray(value).reshape(outputs[name].shape)
        self.judge(value)

    def judge(self, value: Array) -> None:
        """Raises `openmdao.api.AnalysisError` for a value no solver should get; none by default."""

    def compute_jacvec_product(
        self, inputs, d_inputs, d_outputs, mode, discrete_inputs=None, discrete_outputs=None
    ) -> None:
        if not list(d_inputs.keys()) or not list(d_outputs.keys()):
            return
        (name,), values = d_outputs.keys(), _arrays(inputs)
        if mode == "fwd":
            tangents = {key: np.zeros_like(value) for key, value in values.items()} | _arrays(d_inputs)
            d_outputs[name] += np.asarray(_forward(self.traced(), values, tangents)).reshape(d_outputs[name].shape)
        else:
            slopes = _reverse(self.traced(), values, np.array(d_outputs[name]))
            for key in d_inputs:
                d_inputs[key] += np.asarray(slopes[key]).reshape(d_inputs[key].shape)


class Deformed(eqx.Module):
    """Computes `deform` of a plan.

    The input `name` has displacements of its moving nodes, or their positions.
    """

    plan: jm.Plan
    name: str = eqx.field(static=True)
    is_position: bool = eqx.field(static=True, default=False)

    def __call__(self, values: Values) -> Array:
        u = jnp.reshape(values[self.name], self.plan.moving_points.shape)
        return jm.deform(self.plan, u - self.plan.moving_points if self.is_position else u)


class MovedMesh(TracedComponent):
    """Moves a mesh by the option `plan`; judges its cells where the option `mesh` has them."""

    def initialize(self) -> None:
        self.options.declare("plan", types=jm.Plan, recordable=False, desc="what jaxmorph.prepare returned")
        self.options.declare(
            "mesh", types=jm.Mesh, default=None, allow_none=True, recordable=False, desc="whose cells are judged"
        )
        self.options.declare("raise_if_inverted", types=bool, default=True, desc="AnalysisError on inverted cells")

    def setup(self) -> None:
        plan, mesh = self.options["plan"], self.options["mesh"]
        self._is_inverted = None
        if not self.options["raise_if_inverted"]:
            return
        if mesh is None:
            warn(
                "inverted cells are not seen: pass the mesh, mesh=mesh, so that they raise AnalysisError, or "
                "raise_if_inverted=False."
            )
            return
        if tuple(mesh.points.shape) != tuple(plan.points.shape):
            raise ValueError(
                f"`mesh` has points {tuple(mesh.points.shape)}, the plan {tuple(plan.points.shape)}: pass the mesh that it is of."
            )
        judged = jm.Mesh(mesh.points, solid(mesh.cells, mesh.points.shape[1]))
        self._is_inverted = jax.jit(lambda points: jm.inverted(judged, points).any())

    def judge(self, value: Array) -> None:
        """Raises `AnalysisError` where cells have inverted, or points are not finite."""
        points = jnp.reshape(value, self.options["plan"].points.shape)
        if self._is_inverted is None or not self._is_inverted(points):
            return
        try:
            jm.quality(self.options["mesh"], points).raise_if_inverted()
        except ValueError as error:
            raise om.AnalysisError(f"{self.pathname}: {error}") from None


def _arrays(vector: Any) -> Values:
    return {name: np.array(values) for name, values in vector.items()}


@eqx.filter_jit
def _value(function: Traced, values: Values) -> Array:
    return function(values)


@eqx.filter_jit
def _forward(function: Traced, values: Values, tangents: Values) -> Array:
    return jax.jvp(function, (values,), (tangents,))[1]


@eqx.filter_jit
def _reverse(function: Traced, values: Values, cotangent: ArrayLike) -> Values:
    out, transpose = jax.vjp(function, values)
    return transpose(jnp.reshape(cotangent, out.shape).astype(out.dtype))[0]
