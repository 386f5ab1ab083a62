"""OpenMDAO components: design variables to surface displacements, and these to volume points."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

import jaxmorph as jm
from jaxmorph import shapes
from jaxmorph._host.package.arguments import shown

from ._traced import Deformed, MovedMesh, TracedComponent


class MeshDeformation(MovedMesh):
    """Wraps `jaxmorph.deform` as an explicit component, whose derivatives are products.

    The input `displacements` (m, d) is zero at first; its row i moves node `plan.moving[i]`. The
    output `points` (n, d) are all nodes in the mesh's own order. In reverse mode it takes
    sensitivities of all points to sensitivities of the moving nodes, as `jaxmorph.pullback` does.
    OpenMDAO works in float64, so make the plan with JAX's x64 mode on.

    **Arguments:** (options)

    - `plan`: what `jaxmorph.prepare` returned.
    - `mesh`: the mesh that the plan is of, whose cells are judged. Default None: no cells are seen,
      which is warned of.
    - `raise_if_inverted`: whether inverted cells raise `openmdao.api.AnalysisError`, by which
      optimisers shorten a step. Cells are judged relative to `mesh`: cells that were inverted from
      the start do not count. Default True.
    - `flat`: True flattens both variables to (m d,) and (n d,), as the solvers of MPhys have them.
      Default False.
    - `units`: of both variables, such as "m". Default None: none.

        problem = om.Problem()
        problem.model.add_subsystem("mesh", MeshDeformation(plan=plan, mesh=mesh), promotes=["*"])
        problem.setup()
        problem.set_val("displacements", u)
        problem.run_model()
        points = problem.get_val("points")
    """

    def initialize(self) -> None:
        super().initialize()
        self.options.declare("flat", types=bool, default=False, desc="variables of one dimension")
        self.options.declare("units", types=str, default=None, allow_none=True, desc="of displacements and points")

    def setup(self) -> None:
        super().setup()
        plan, flat, units = self.options["plan"], self.options["flat"], self.options["units"]
        rest: Any = np.zeros((plan.n_moving, plan.points.shape[1]))
        points: Any = np.asarray(plan.points, dtype=float)
        self.add_input("displacements", val=rest.ravel() if flat else rest, units=units)
        self.add_output("points", val=points.ravel() if flat else points, units=units)

    def traced(self) -> Deformed:
        """Returns `deform` of the plan."""
        return Deformed(self.options["plan"], "displacements")


class ShapeDisplacement(TracedComponent):
    """Computes displacements or positions of a plan's moving nodes, from a shape's parameters.

    Each array of the parameters is an input by its name of `jaxmorph.shapes.names`, with colons for
    dots: `twist`, `wing:box`. Parameters that are one array alone are called `parameters`. Inputs
    begin with neutral parameters. The output `displacements` (m, d) is what `MeshDeformation`
    takes.

        model.add_subsystem("shape", ShapeDisplacement(plan=plan, shape=wing), promotes=["*"])
        model.add_subsystem("mesh", MeshDeformation(plan=plan, mesh=mesh), promotes=["*"])

    **Arguments:** (options)

    - `shape`: a shape of `jaxmorph.shapes`, or a function of positions and parameters.
    - `plan`: what `jaxmorph.prepare` returned.
    - `parameters`: values at the start; only a plain function needs them. Default None:
      `shape.neutral()`.
    - `positions`: True makes the output `positions` (m, d) of the moving nodes instead. Default
      False.
    - `flat`, `units`: of the output, as `MeshDeformation` has them.
    """

    def initialize(self) -> None:
        self.options.declare("shape", types=object, recordable=False, desc="positions and parameters to positions")
        self.options.declare("plan", types=jm.Plan, recordable=False, desc="what jaxmorph.prepare returned")
        self.options.declare("parameters", default=None, recordable=False, desc="parameters at the start")
        self.options.declare("positions", types=bool, default=False, desc="positions instead of displacements")
        self.options.declare("flat", types=bool, default=False, desc="an output of one dimension")
        self.options.declare("units", types=str, default=None, allow_none=True, desc="of the output")

    def setup(self) -> None:
        function, flat, units = self.traced(), self.options["flat"], self.options["units"]
        parameters = add_parameters(self, function.parameters)
        out: Any = np.asarray(function(parameters), float)
        name = "positions" if self.options["positions"] else "displacements"
        self.add_output(name, val=out.ravel() if flat else out, units=units)

    def traced(self) -> "_Displaced":
        """Returns the shape at the plan's moving nodes."""
        shape, start = self.options["shape"], first_parameters(self.options["shape"], self.options["parameters"])
        return _Displaced(shape, self.options["plan"], start, self.options["positions"])


def first_parameters(shape: Any, parameters: PyTree) -> PyTree:
    """Returns the given parameters, or neutral ones for None.

    **Raises:** `ValueError` for what is no function, for a plain function and None, and for what
    the shape does not take.
    """
    if isinstance(shape, type) or not callable(shape):
        raise ValueError(f"`shape` must be a shape or a function of positions and parameters, not {shown(shape)}.")
    if parameters is None and not hasattr(shape, "neutral"):
        raise ValueError("`parameters` is missing: a plain function does not tell its own. Or take `shapes.Function`.")
    shapes.names(parameters)  # refuses leaves that are no numbers
    return shape.neutral() if parameters is None else parameters  # pyright: ignore[reportFunctionMemberAccess]


def add_parameters(component: Any, parameters: PyTree, **options: Any) -> dict[str, Float[np.ndarray, "..."]]:
    """Adds an input for each array of parameters; returns the arrays by input name."""
    arrays = {name: np.asarray(leaf, float) for name, leaf in _inputs(parameters)}
    for name, values in arrays.items():
        component.add_input(name, val=values, **options)
    return arrays


def from_inputs(parameters: PyTree, values: dict[str, Any]) -> PyTree:
    """Collects parameters from inputs: arrays by name to the structure of `parameters`."""
    leaves = [jnp.reshape(values[name], np.shape(leaf)) for name, leaf in _inputs(parameters)]
    return jax.tree.unflatten(jax.tree.structure(parameters), leaves)


def _inputs(parameters: PyTree) -> list[tuple[str, Any]]:
    paths = jax.tree_util.tree_flatten_with_path(parameters)[0]
    return [(jax.tree_util.keystr(path, simple=True, separator=":") or "parameters", leaf) for path, leaf in paths]


class _Displaced(eqx.Module):
    shape: Any
    plan: jm.Plan
    parameters: PyTree
    positions: bool

    def __call__(self, values: dict[str, Any]) -> Float[Array, "m d"]:
        u = shapes.displacement(self.shape, self.plan, from_inputs(self.parameters, values))
        return self.plan.moving_points + u if self.positions else u
