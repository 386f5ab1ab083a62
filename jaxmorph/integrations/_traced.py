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

Values = dict[str, Any]
Traced = Callable[[Values], Any]
"""A pytree that computes one array from arrays by name."""


class TracedComponent(om.ExplicitComponent):
    """Computes one output from its inputs by a traced function; forward and reverse products are JAX's.

    A subclass adds inputs and one output in `setup`, and returns the function from `traced`.
    """

    def traced(self) -> Traced:
        """Returns the function: a pytree, so that it is compiled once."""
        raise NotImplementedError

    def compute(self, inputs, outputs, discrete_inputs=None, discrete_outputs=None) -> None:
        (name,) = outputs.keys()
        outputs[name] = np.asarray(_value(self.traced(), _arrays(inputs))).reshape(outputs[name].shape)

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
