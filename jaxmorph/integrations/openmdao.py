"""OpenMDAO components: design variables to surface displacements, and these to volume points."""

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
from jaxtyping import Array, ArrayLike, Float, PyTree
from numpy import ndarray

import jaxmorph as jm
from jaxmorph import shapes
from jaxmorph.extend import solid, warn

ValuesByName = dict[str, Any]
PointsOrArray = Float[Array, "n d"]
Traced = Callable[[ValuesByName], Any]
"""A pytree that computes one array from arrays by name."""

COMPONENT_OPTIONS: dict[str, dict[str, Any]] = {
    "plan": {"types": jm.Plan, "recordable": False, "desc": "what jaxmorph.prepare returned"},
    "mesh": {
        "types": jm.Mesh,
        "default": None,
        "allow_none": True,
        "recordable": False,
        "desc": "whose cells are judged",
    },
    "raise_if_inverted": {
        "types": bool,
        "default": True,
        "desc": "AnalysisError on inverted cells",
    },
    "flat": {"types": bool, "default": False, "desc": "variables of one dimension"},
    "units": {
        "types": str,
        "default": None,
        "allow_none": True,
        "desc": "of both variables, or the output",
    },
    "shape": {
        "types": object,
        "recordable": False,
        "desc": "positions and parameters to positions",
    },
    "parameters": {"default": None, "recordable": False, "desc": "parameters at the start"},
    "positions": {"types": bool, "default": False, "desc": "positions instead of displacements"},
}


class TracedComponent(om.ExplicitComponent):
    """Computes one output of inputs by a traced function; forward and reverse products are JAX's.

    A subclass names its options, adds inputs and one output in `setup`, and returns the function
    from `traced`: a pytree, so that it is compiled once.
    """

    option_names: tuple[str, ...] = ()

    def initialize(self) -> None:
        for name in self.option_names:
            self.options.declare(name, **COMPONENT_OPTIONS[name])

    def traced(self) -> Traced:
        raise NotImplementedError

    def add(self, name: str, value: Any, added: Callable[..., Any]) -> None:
        value = np.asarray(value, float)
        added(
            name, val=value.ravel() if self.options["flat"] else value, units=self.options["units"]
        )

    def compute(self, inputs, outputs, discrete_inputs=None, discrete_outputs=None) -> None:
        (name,) = outputs.keys()
        value = _value(self.traced(), _as_arrays(inputs))
        outputs[name] = np.asarray(value).reshape(outputs[name].shape)
        self.judge(value)

    def judge(self, value: Array) -> None:
        """Raises `openmdao.api.AnalysisError` for a value no solver should get; none by default."""

    def compute_jacvec_product(
        self, inputs, d_inputs, d_outputs, mode, discrete_inputs=None, discrete_outputs=None
    ) -> None:
        if not list(d_inputs.keys()) or not list(d_outputs.keys()):
            return
        (name,) = d_outputs.keys()
        values = _as_arrays(inputs)
        if mode == "fwd":
            zeros = {key: np.zeros_like(value) for key, value in values.items()}
            change = _forward(self.traced(), values, zeros | _as_arrays(d_inputs))
            d_outputs[name] += np.asarray(change).reshape(d_outputs[name].shape)
        else:
            slopes = _reverse(self.traced(), values, np.array(d_outputs[name]))
            for key in d_inputs:
                d_inputs[key] += np.asarray(slopes[key]).reshape(d_inputs[key].shape)


class MovedMesh(TracedComponent):
    """Moves a mesh by the option `plan`; judges its cells where the option `mesh` has them."""

    option_names = ("plan", "mesh", "raise_if_inverted")

    def setup(self) -> None:
        mesh = self.options["mesh"]
        self._is_inverted = None
        if not self.options["raise_if_inverted"]:
            return
        if mesh is None:
            warn(
                "inverted cells are not seen: pass the mesh, mesh=mesh, so that they raise "
                "AnalysisError, or "
                "raise_if_inverted=False."
            )
            return
        judged = jm.Mesh(mesh.points, solid(mesh.cells, mesh.points.shape[1]))
        old = jm.quality(judged).is_inverted
        self._is_inverted = jax.jit(lambda points: (jm.inverted(judged, points) & ~old).any())

    def judge(self, value: Array) -> None:
        """Raises `AnalysisError` where cells have inverted, or points are not finite."""
        points = jnp.reshape(value, self.options["plan"].points.shape)
        if self._is_inverted is None or not self._is_inverted(points):
            return
        try:
            jm.quality(self.options["mesh"], points).raise_if_inverted()
        except ValueError as error:
            raise om.AnalysisError(f"{self.pathname}: {error}") from None


class MeshDeformation(MovedMesh):
    """Wraps `jaxmorph.deform` as an explicit component, whose derivatives are products.

    The input `displacements` (m, d) is zero at first; its row i moves node `plan.moving[i]`. The
    output `points` (n, d) are all nodes in the mesh's own order. OpenMDAO works in float64, so make
    the plan with JAX's x64 mode on.

    **Arguments:** (options)

    - `plan`: what `jaxmorph.prepare` returned.
    - `mesh`: the plan's mesh, whose cells are judged. Default None: no cells are seen, with a
      warning.
    - `raise_if_inverted`: whether cells that invert raise `openmdao.api.AnalysisError`, by which
      optimisers shorten a step. Default True.
    - `flat`: True flattens both variables to (m d,) and (n d,). Default False.
    - `units`: of both variables, such as "m". Default None.

        problem = om.Problem()
        problem.model.add_subsystem("mesh", MeshDeformation(plan=plan, mesh=mesh), promotes=["*"])
        problem.setup()
        problem.set_val("displacements", u)
        problem.run_model()
        points = problem.get_val("points")
    """

    option_names = (*MovedMesh.option_names, "flat", "units")

    def setup(self) -> None:
        super().setup()
        plan = self.options["plan"]
        self.add("displacements", np.zeros(plan.moving_points.shape), self.add_input)
        self.add("points", plan.points, self.add_output)

    def traced(self) -> Traced:
        return eqx.Partial(_deform_by_name, self.options["plan"])


class ShapeDisplacement(TracedComponent):
    """Computes displacements or positions of a plan's moving nodes, from a shape's parameters.

    Each array of the parameters is an input by its name of `jaxmorph.shapes.names`, with colons for
    dots: `twist`, `wing:box`. A single array is called `parameters`. Inputs begin with neutral
    parameters. The output `displacements` (m, d) is what `MeshDeformation` takes.

        model.add_subsystem("shape", ShapeDisplacement(plan=plan, shape=wing), promotes=["*"])
        model.add_subsystem("mesh", MeshDeformation(plan=plan, mesh=mesh), promotes=["*"])

    **Arguments:** (options)

    - `shape`: a shape of `jaxmorph.shapes`, or a function of positions and parameters.
    - `plan`: what `jaxmorph.prepare` returned.
    - `parameters`: initial values; a plain function needs them. Default None: `shape.neutral()`.
    - `positions`: True makes the output `positions` (m, d) of the moving nodes instead. Default
      False.
    - `flat`, `units`: of the output, as `MeshDeformation` has them.
    """

    option_names = ("shape", "plan", "parameters", "positions", "flat", "units")

    def setup(self) -> None:
        parameters = first_parameters(self.options["shape"], self.options["parameters"])
        start = add_parameters(self, parameters)
        name = "positions" if self.options["positions"] else "displacements"
        self.add(name, self.traced()(start), self.add_output)

    def traced(self) -> Traced:
        shape, plan, given, positions = (
            self.options[name] for name in ("shape", "plan", "parameters", "positions")
        )
        return eqx.Partial(_wall, shape, plan, first_parameters(shape, given), positions)


def first_parameters(shape: Any, parameters: PyTree) -> PyTree:
    if isinstance(shape, type) or not callable(shape):
        raise ValueError(
            f"`shape` must be a shape or a function of positions and parameters, not {shape!r}."
        )
    if parameters is None and not hasattr(shape, "neutral"):
        raise ValueError(
            "`parameters` is missing: a plain function does not tell its own. Or take "
            "`shapes.Function`."
        )
    shapes.names(parameters)  # refuses leaves that are no numbers
    return shape.neutral() if parameters is None else parameters  # pyright: ignore[reportFunctionMemberAccess]


def add_parameters(
    component: Any, parameters: PyTree, **options: Any
) -> dict[str, Float[ndarray, "..."]]:
    leaves = jax.tree_util.tree_leaves_with_path(parameters)
    arrays = {_name_variable(path): np.asarray(leaf, float) for path, leaf in leaves}
    for name, values in arrays.items():
        component.add_input(name, val=values, **options)
    return arrays


def from_inputs(parameters: PyTree, values: ValuesByName) -> PyTree:
    read = lambda path, leaf: jnp.reshape(values[_name_variable(path)], np.shape(leaf))  # noqa: E731
    return jax.tree_util.tree_map_with_path(read, parameters)


def _name_variable(path: Any) -> str:
    return jax.tree_util.keystr(path, simple=True, separator=":") or "parameters"


def _deform_by_name(plan: jm.Plan, values: ValuesByName) -> PointsOrArray:
    return jm.deform(plan, jnp.reshape(values["displacements"], plan.moving_points.shape))


def _wall(
    shape: Any, plan: jm.Plan, parameters: PyTree, positions: bool, values: ValuesByName
) -> PointsOrArray:
    u = shapes.displacement(shape, plan, from_inputs(parameters, values))
    return plan.moving_points + u if positions else u


def _as_arrays(vector: Any) -> ValuesByName:
    return {name: np.array(values) for name, values in vector.items()}


@eqx.filter_jit
def _value(function: Traced, values: ValuesByName) -> Array:
    return function(values)


@eqx.filter_jit
def _forward(function: Traced, values: ValuesByName, tangents: ValuesByName) -> Array:
    return jax.jvp(function, (values,), (tangents,))[1]


@eqx.filter_jit
def _reverse(function: Traced, values: ValuesByName, cotangent: ArrayLike) -> ValuesByName:
    out, transpose = jax.vjp(function, values)
    return transpose(jnp.reshape(cotangent, out.shape).astype(out.dtype))[0]
