"""MPhys builders: a shape as geometry, and a volume mesh that follows its wall."""

try:
    from mphys.core import Builder, MPhysVariables  # pyright: ignore[reportMissingImports]
except ImportError as error:
    raise ImportError("these builders need mphys: pip install 'jaxmorph[mphys]'") from error

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import openmdao.api as om
from jaxtyping import Array, Float, PyTree

import jaxmorph as jm

from .openmdao import (
    MovedMesh,
    Traced,
    TracedComponent,
    ValuesByName,
    add_parameters,
    first_parameters,
    from_inputs,
)

SURFACE = MPhysVariables.Aerodynamics.Surface


class ShapeBuilder(Builder):
    """Builds MPhys's geometry of a shape: wall coordinates in, moved ones out, by design variables.

    `get_mesh_coordinate_subsystem` is the component. It takes the coordinates
    `x_aero0_geometry_input` (3 m,) of any solver to `x_aero0_geometry_output`. One builder serves
    solvers with different walls.

    **Arguments:**

    - `shape`: a shape of `jaxmorph.shapes` in 3-D, or a function of positions and parameters.
    - `parameters`: as `ShapeDisplacement` takes them and names their inputs.
    """

    def __init__(self, shape: Any, parameters: PyTree = None):
        super().__init__()
        self.shape = shape
        self.parameters = first_parameters(shape, parameters)

    def get_mesh_coordinate_subsystem(self, scenario_name=None) -> "Geometry":  # pyright: ignore[reportIncompatibleMethodOverride]  MPhys states no result
        return Geometry(shape=self.shape, parameters=self.parameters)


class VolumeBuilder(Builder):
    """Builds a mesh that follows its wall, in place of an aerodynamic solver or in one's builder.

    The mesh subsystem has the wall's coordinates `x_aero0_mesh` (3 m,), in the order of
    `plan.moving`. The coupling subsystem takes `x_aero` (3 m,) to the coordinates `aero_vol_coords`
    (3 n,) of all nodes.

    **Arguments:**

    - `plan`: what `jaxmorph.prepare` returned for a mesh in 3-D.
    - `mesh`, `raise_if_inverted`: as `MeshDeformation` has them: inverted cells raise
      `openmdao.api.AnalysisError`.

    **Raises:** `ValueError` for a mesh in 2-D, and by `initialize` on more than one process.
    """

    def __init__(
        self, plan: jm.Plan, mesh: jm.Mesh | None = None, *, raise_if_inverted: bool = True
    ):
        super().__init__()
        self.plan = plan
        self.judged = {"mesh": mesh, "raise_if_inverted": raise_if_inverted}
        Volume(plan=plan, **self.judged)  # OpenMDAO refuses values of other types
        if plan.points.shape[1] != 3:
            raise ValueError(
                f"this mesh is in {plan.points.shape[1]}-D; MPhys's coordinates are in 3-D."
            )

    def initialize(self, comm) -> None:
        if comm.size > 1:
            raise ValueError(f"a plan is whole on one process; there are {comm.size}.")

    def get_mesh_coordinate_subsystem(self, scenario_name=None) -> om.IndepVarComp:  # pyright: ignore[reportIncompatibleMethodOverride]  MPhys states no result
        wall: Any = np.asarray(self.plan.moving_points, float).ravel()
        component = om.IndepVarComp()
        component.add_output(
            SURFACE.Mesh.COORDINATES, wall, distributed=True, units="m", tags=["mphys_coordinates"]
        )
        return component

    def get_coupling_group_subsystem(self, scenario_name=None) -> "Volume":  # pyright: ignore[reportIncompatibleMethodOverride]  MPhys states no result
        return Volume(plan=self.plan, **self.judged)

    def get_number_of_nodes(self) -> int:
        return self.plan.n_moving

    def get_ndof(self) -> int:
        return 3


class Geometry(TracedComponent):
    """Moves a wall's coordinates (3 m,) by a shape; `ShapeBuilder` makes it."""

    option_names = ("shape", "parameters")

    def setup(self) -> None:
        tags = ["mphys_coordinates"]
        name = SURFACE.Geometry.COORDINATES_INPUT
        self.add_input(name, shape_by_conn=True, distributed=True, units="m", tags=tags)
        add_parameters(self, self.options["parameters"], tags=["mphys_input"])
        self.add_output(
            SURFACE.Geometry.COORDINATES_OUTPUT,
            copy_shape=name,
            distributed=True,
            units="m",
            tags=tags,
        )

    def traced(self) -> Traced:
        return eqx.Partial(_move_wall, self.options["shape"], self.options["parameters"])


class Volume(MovedMesh):
    """Moves a volume's coordinates (3 n,) with its wall's (3 m,); `VolumeBuilder` makes it."""

    def setup(self) -> None:
        super().setup()
        points: Any = np.asarray(self.options["plan"].points, float)
        wall: Any = np.asarray(self.options["plan"].moving_points, float)
        tags = ["mphys_coupling"]
        self.add_input(
            SURFACE.COORDINATES,
            wall.ravel(),
            distributed=True,
            units="m",
            tags=["mphys_coordinates"],
        )
        self.add_output("aero_vol_coords", points.ravel(), distributed=True, units="m", tags=tags)

    def traced(self) -> Traced:
        return eqx.Partial(_deform_volume, self.options["plan"])


def _move_wall(shape: Any, parameters: PyTree, values: ValuesByName) -> Float[Array, " k"]:
    x = jnp.reshape(values[SURFACE.Geometry.COORDINATES_INPUT], (-1, 3))
    return shape(x, from_inputs(parameters, values)).ravel()


def _deform_volume(plan: jm.Plan, values: ValuesByName) -> Float[Array, "n 3"]:
    return jm.deform(plan, jnp.reshape(values[SURFACE.COORDINATES], (-1, 3)) - plan.moving_points)
