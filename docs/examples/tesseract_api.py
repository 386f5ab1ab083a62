"""A Tesseract that moves a mesh: parameters of a shape in, points of the volume out, with exact derivatives.

    from tesseract_core import Tesseract

    with Tesseract.from_tesseract_api("docs/examples/tesseract_api.py") as mover:
        points = mover.apply({"angle": 0.1, "control": control})["points"]

Another mesh or shape: replace `MESH`, `PLAN` and `SHAPE`.
"""

from typing import Any

import equinox as eqx
import jax
import numpy as np
from pydantic import BaseModel
from tesseract_core.runtime import Array, Differentiable, Float64
from tesseract_core.runtime.jax_recipes import jax_abstract_eval, jax_apply, jax_jvp, jax_vjp

import jaxmorph as jm
from jaxmorph import cases, shapes

jax.config.update("jax_enable_x64", True)

MESH = cases.naca0015(points=400)
PLAN = jm.prepare(MESH, "airfoil", "farfield", method=jm.RBF.classic())
BOX = shapes.FreeForm.around(np.asarray(MESH.points)[MESH.patch("airfoil")], (5, 3))
PITCH = shapes.Function(lambda x, angle: shapes.rotate(x, angle, [0.25, 0.0]), 0.0)
SHAPE = shapes.Chain({"control": BOX, "angle": PITCH})


class InputSchema(BaseModel):
    """Design variables: displacements of the box's control points, then an angle in radians about the quarter chord."""

    angle: Differentiable[Float64]
    control: Differentiable[Array[(*BOX.counts, 2), Float64]]


class OutputSchema(BaseModel):
    """Points of all nodes of the mesh, in its own order."""

    points: Differentiable[Array[(len(MESH.points), 2), Float64]]


@eqx.filter_jit
def moved(inputs: dict) -> dict:
    """Moves the mesh."""
    return {"points": jm.deform(PLAN, shapes.displacement(SHAPE, PLAN, inputs))}


def apply(inputs: InputSchema) -> OutputSchema:
    """Moves the mesh."""
    return OutputSchema(**jax_apply(moved, inputs))


def jacobian_vector_product(
    inputs: InputSchema, jvp_inputs: set[str], jvp_outputs: set[str], tangent_vector: dict[str, Any]
):
    """Computes how the points move with the design variables."""
    return jax_jvp(moved, inputs, jvp_inputs, jvp_outputs, tangent_vector)


def vector_jacobian_product(
    inputs: InputSchema,
    vjp_inputs: set[str],
    vjp_outputs: set[str],
    cotangent_vector: dict[str, Any],
):
    """Takes dJ/d(points) to dJ/d(design variables)."""
    return jax_vjp(moved, inputs, vjp_inputs, vjp_outputs, cotangent_vector)


def abstract_eval(abstract_inputs):
    """Tells the shape of the output."""
    return jax_abstract_eval(moved, abstract_inputs)
