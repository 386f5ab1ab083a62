"""An OpenMDAO component that moves a mesh: displacements of its surface in, points of its volume out."""

try:
    import openmdao.api as om
except ImportError as error:
    raise ImportError("this component needs openmdao: pip install 'jaxmorph[openmdao]'") from error

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

import jaxmorph as jm


class MeshDeformation(om.ExplicitComponent):
    """Wraps `jaxmorph.deform` as an explicit component, whose derivatives are products without a matrix.

    The input `displacements` (m, d) is zero at first; its row i moves node `plan.moving[i]`. The output `points` (n, d) are all
    nodes in the mesh's own order. In reverse mode it takes sensitivities of all points to those of the moving ones, which is
    `jaxmorph.pullback`. OpenMDAO works in float64, so make the plan with JAX's x64 mode on.

    **Arguments:** (options)

    - `plan`: what `jaxmorph.prepare` returned.
    - `flat`: True flattens both variables to (m d,) and (n d,), as the solvers of MPhys have them. Default False.
    - `units`: those of both variables, such as "m". Default None: none.

        problem = om.Problem()
        problem.model.add_subsystem("mesh", MeshDeformation(plan=plan), promotes=["*"])
        problem.setup()
        problem.set_val("displacements", u)
        problem.run_model()
        points = problem.get_val("points")
    """

    def initialize(self) -> None:
        self.options.declare("plan", types=jm.Plan, recordable=False, desc="what jaxmorph.prepare returned")
        self.options.declare("flat", types=bool, default=False, desc="variables of one dimension")
        self.options.declare("units", types=str, default=None, allow_none=True, desc="of displacements and points")

    def setup(self) -> None:
        plan, flat, units = self.options["plan"], self.options["flat"], self.options["units"]
        self._shape = plan.n_moving, plan.points.shape[1]
        rest: Any = np.zeros(self._shape)
        points: Any = np.asarray(plan.points, dtype=float)
        self.add_input("displacements", val=rest.ravel() if flat else rest, units=units)
        self.add_output("points", val=points.ravel() if flat else points, units=units)

    def compute(self, inputs, outputs, discrete_inputs=None, discrete_outputs=None) -> None:
        points = jm.deform(self.options["plan"], self._rows(inputs["displacements"]))
        outputs["points"] = np.asarray(points).reshape(outputs["points"].shape)

    def compute_jacvec_product(
        self, inputs, d_inputs, d_outputs, mode, discrete_inputs=None, discrete_outputs=None
    ) -> None:
        if "displacements" not in d_inputs or "points" not in d_outputs:
            return
        plan, u = self.options["plan"], self._rows(inputs["displacements"])
        du, dpoints = d_inputs["displacements"], d_outputs["points"]
        if mode == "fwd":
            dpoints += np.asarray(_product(plan, u, self._rows(du))).reshape(dpoints.shape)
        else:
            du += np.asarray(jm.pullback(plan, u, dpoints.reshape(plan.points.shape))).reshape(du.shape)

    def _rows(self, displacements: np.ndarray) -> Float[np.ndarray, "m d"]:
        return np.asarray(displacements).reshape(self._shape)


@eqx.filter_jit
def _product(plan: jm.Plan, u: Float[ArrayLike, "m d"], du: Float[ArrayLike, "m d"]) -> Float[Array, "n d"]:
    """Computes the derivative of `deform` along `du`."""
    u, du = (jnp.asarray(values, plan.points.dtype) for values in (u, du))
    return jax.jvp(lambda u: jm.deform(plan, u), (u,), (du,))[1]
