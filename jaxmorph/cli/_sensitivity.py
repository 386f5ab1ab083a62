"""`jaxmorph sensitivity`: dJ/d(points) to dJ/d(moving nodes) or dJ/d(variables of a job)."""

from typing import Any

import jax
import numpy as np

import jaxmorph as jm
from jaxmorph import io, shapes

from ._job import job_of
from ._method import patches_of
from ._motion import Motion, motion
from ._output import LISTED, Output, coordinates, count, steepest, title
from ._requests import Sensitivity


def sensitivity(request: Sensitivity, out: Output) -> int:
    """Reads, pulls back, writes. Returns the exit status."""
    job = job_of(request)
    with out.progress(f"reading {title(request.file)}"):
        mesh = io.read(request.file)
    patches = patches_of(job or request, mesh)
    moving = patches.nodes
    moves = None if job is None else motion(job, mesh, moving)
    with out.progress(f"reading {request.sensitivity.name}"):
        sensitivity = io.read_sensitivity(request.sensitivity, mesh, moving=moving)
    if len(sensitivity) < len(mesh.points):
        return _of_surface(request, np.asarray(mesh.points, float), moving, moves, sensitivity, out)
    with out.progress("preparing"):
        choice = patches.method((job or request).method)
        _, plan = next(patches.chunks(choice.method))
    out.say(f"{title(request.file)}: {len(mesh.points)} points, {count(len(moving), 'moving node')}")
    out.say(f"method   {choice.name}", points=len(mesh.points), method=choice.name)
    if job is None or moves is None:
        _to_nodes(request, plan, sensitivity, out)
    else:
        _to_variables(request, plan, moves, job.steps, sensitivity, out)
    out.say(f"wrote {request.output} ({out.seconds:.1f} s)", output=str(request.output))
    return 0


def _to_nodes(request: Sensitivity, plan: jm.Plan, sensitivity: np.ndarray, out: Output) -> None:
    moving, points = np.asarray(plan.moving), np.asarray(plan.points)
    with out.progress("pulling back"):
        slope = np.asarray(jm.pullback(plan, np.zeros((len(moving), sensitivity.shape[1])), sensitivity), float)
    size = np.linalg.norm(slope, axis=1)
    worst = int(size.argmax())
    place = coordinates(points[moving[worst]])
    out.say(f"largest  {size[worst]:.5g}, at node {moving[worst]} near {place}", largest=float(size[worst]))
    out.say(f"sum      {', '.join(f'{x:.5g}' for x in slope.sum(axis=0))}", sum=slope.sum(axis=0).tolist())
    with out.progress(f"writing {request.output.name}"):
        io.write_sensitivity(request.output, moving, slope)


def _of_surface(
    request: Sensitivity,
    points: np.ndarray,
    moving: np.ndarray,
    moves: Motion | None,
    sensitivity: np.ndarray,
    out: Output,
) -> int:
    """Takes sensitivities of the moving nodes to design variables, without the volume."""
    if moves is None:
        raise ValueError(
            f"{request.sensitivity}: {len(sensitivity)} of {len(points)} nodes, the moving ones: it is dJ/d(moving nodes) already. "
            "--job FILE takes it on to design variables."
        )
    out.say(f"{title(request.file)}: {count(len(sensitivity), 'moving node')}, sensitivities of the surface")
    _write(request, moves, shapes.project(moves.shape, points[moving], moves.parameters, sensitivity), out)
    out.say(f"wrote {request.output} ({out.seconds:.1f} s)", output=str(request.output))
    return 0


def _to_variables(
    request: Sensitivity, plan: jm.Plan, moves: Motion, steps: int, sensitivity: np.ndarray, out: Output
) -> None:
    with out.progress(f"pulling back through {count(steps, 'step')}"):
        wall = np.asarray(plan.moving_points, float)
        plans = plan if steps == 1 else jm.march(plan, moves.path(wall, steps))[0]
        gradient = shapes.pullback(moves.shape, plans, moves.parameters, sensitivity)
    _write(request, moves, gradient, out)


def _write(request: Sensitivity, moves: Motion, gradient: Any, out: Output) -> None:
    names = shapes.names(moves.parameters)
    values, slopes = (
        np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(tree)]) for tree in (moves.parameters, gradient)
    )
    out.say(f"\n{'dJ/d(variable)':>16}{'variable':>16}")
    for k in steepest(slopes):
        out.say(f"{slopes[k]:>16.6g}{values[k]:>16.6g}  {names[k]}")
    out.say(f"{'... ' if len(names) > LISTED else ''}{count(len(names), 'design variable')} in {request.output.name}\n")
    out.say(variables=dict(zip(names, slopes.tolist(), strict=True)))
    with out.progress(f"writing {request.output.name}"):
        io.write_gradient(request.output, moves.parameters, gradient)
