"""`jaxmorph sensitivity`: dJ/d(points) to dJ/d(moving nodes) or dJ/d(variables of a job)."""

from typing import Any

import jax
import numpy as np

import jaxmorph as jm
from jaxmorph import io, shapes

from ._job import job_of
from ._method import described, patches_of
from ._motion import Motion, motion
from ._output import LISTED, Output, coordinates, count, steepest, title
from ._requests import SensitivityRequest


def sensitivity(request: SensitivityRequest, out: Output) -> int:
    job = job_of(request)
    with out.progress(f"reading {title(request.file)}"):
        mesh = io.read(request.file)
    patches, n = patches_of(job or request, mesh), len(mesh.points)
    moving, wall = patches.nodes, np.asarray(mesh.points, float)[patches.nodes]
    moves = None if job is None else motion(job, mesh, moving)
    with out.progress(f"reading {request.sensitivity.name}"):
        given = io.read_sensitivity(request.sensitivity, mesh, moving=moving)
    if len(given) < n:  # of the moving nodes: the volume is not needed
        if moves is None:
            raise ValueError(
                f"{request.sensitivity}: {len(given)} of {n} nodes, the moving ones: it is dJ/d(moving nodes) already. "
                "--job FILE takes it on to design variables."
            )
        out.say(f"{title(request.file)}: {count(len(given), 'moving node')}, sensitivities of the surface")
        _write_variables(request, moves, shapes.project(moves.shape, wall, moves.parameters, given), out)
    else:
        with out.progress("preparing"):
            _, plan = next(patches.chunks())
        name, _ = described((job or request).method, plan)
        out.say(f"{title(request.file)}: {n} points, {count(len(moving), 'moving node')}")
        out.say(f"method   {name}", points=n, method=name)
        if job is None or moves is None:
            _write_nodes(request, plan, given, out)
        else:
            with out.progress(f"pulling back through {count(job.step_count, 'step')}"):
                plans = plan if job.step_count == 1 else jm.march(plan, moves.path(wall, job.step_count))[0]
                gradient = shapes.pullback(moves.shape, plans, moves.parameters, given)
            _write_variables(request, moves, gradient, out)
    out.wrote(request.output)
    return 0


def _write_nodes(request: SensitivityRequest, plan: jm.Plan, given: np.ndarray, out: Output) -> None:
    moving, wall = np.asarray(plan.moving), np.asarray(plan.moving_points)
    with out.progress("pulling back"):
        slope = np.asarray(jm.pullback(plan, np.zeros(wall.shape), given), float)
    size = np.linalg.norm(slope, axis=1)
    worst = int(size.argmax())
    place = coordinates(wall[worst])
    out.say(f"largest  {size[worst]:.5g}, at node {moving[worst]} near {place}", largest=float(size[worst]))
    out.say(f"sum      {', '.join(f'{x:.5g}' for x in slope.sum(axis=0))}", sum=slope.sum(axis=0).tolist())
    with out.progress(f"writing {request.output.name}"):
        io.write_sensitivity(request.output, moving, slope)


def _write_variables(request: SensitivityRequest, moves: Motion, gradient: Any, out: Output) -> None:
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
