"""`jaxmorph sensitivity`: dJ/d(points of the volume) to dJ/d(moving nodes) or to a job's design variables."""

from typing import Any

import jax
import numpy as np

import jaxmorph as jm
from jaxmorph import io, shapes

from ._method import named_method, patches_of
from ._motion import Motion, motion
from ._output import Output, title
from ._requests import Sensitivity
from ._tables import count

LISTED = 20
"""Design variables on the terminal, at most."""


def sensitivity(request: Sensitivity, out: Output) -> int:
    """Reads, pulls back, writes. Returns the exit status."""
    (io.check_sensitivity_output if request.job is None else io.check_gradient_output)(request.output)
    if request.output.resolve() == request.sensitivity.resolve():
        raise ValueError(f"{request.output}: the sensitivities are read from this file; write to another one.")
    with out.progress(f"reading {title(request.file)}"):
        mesh = io.read(request.file)
    patches, job = patches_of(request.surface, mesh, request.file), request.job
    moving = patches.nodes
    moves = None if job is None else motion(job.groups, mesh, moving, job.changes)
    with out.progress(f"reading {request.sensitivity.name}"):
        given = io.read_sensitivity(request.sensitivity, mesh, moving=moving)
    if len(given) < len(mesh.points):
        return _of_surface(request, mesh, moves, given, out)
    with out.progress("preparing"):
        choice = named_method(request.method, np.asarray(mesh.points)[moving])
        plan = patches.plan(patches.chunks(choice))
    out.say(f"{title(request.file)}: {len(mesh.points)} points, {count(len(moving), 'moving node')}")
    out.say(f"method   {choice.name}", points=len(mesh.points), method=choice.name)
    if job is None or moves is None:
        _to_nodes(request, plan, given, out)
    else:
        _to_variables(request, plan, moves, job.steps, given, out)
    out.say(f"wrote {request.output} ({out.seconds:.1f} s)", output=str(request.output))
    return 0


def _to_nodes(request: Sensitivity, plan: jm.Plan, given: np.ndarray, out: Output) -> None:
    moving, points = np.asarray(plan.moving), np.asarray(plan.points)
    with out.progress("pulling back"):
        slope = np.asarray(jm.pullback(plan, np.zeros((len(moving), given.shape[1])), given), float)
    size = np.linalg.norm(slope, axis=1)
    worst = int(size.argmax())
    place = ", ".join(f"{x:.3g}" for x in points[moving[worst]])
    out.say(f"largest  {size[worst]:.5g}, at node {moving[worst]} near ({place})", largest=float(size[worst]))
    out.say(f"sum      {', '.join(f'{x:.5g}' for x in slope.sum(axis=0))}", sum=slope.sum(axis=0).tolist())
    with out.progress(f"writing {request.output.name}"):
        io.write_sensitivity(request.output, moving, slope)


def _of_surface(request: Sensitivity, mesh: jm.Mesh, moves: Motion | None, given: np.ndarray, out: Output) -> int:
    """Takes sensitivities of the moving nodes alone to design variables: the volume has no part in it."""
    if moves is None:
        raise ValueError(
            f"{request.sensitivity}: {len(given)} of {len(mesh.points)} nodes, the moving ones: it is dJ/d(moving nodes) already. "
            "--job FILE takes it on to design variables."
        )
    out.say(f"{title(request.file)}: {count(len(given), 'moving node')}, sensitivities of the surface")
    wall = np.asarray(mesh.points, float)[mesh.patch(*request.surface.moving)]
    _write(request, moves, shapes.project(moves.shape, wall, moves.parameters, given), out)
    out.say(f"wrote {request.output} ({out.seconds:.1f} s)", output=str(request.output))
    return 0


def _to_variables(
    request: Sensitivity, plan: jm.Plan, moves: Motion, steps: int, given: np.ndarray, out: Output
) -> None:
    with out.progress(f"pulling back through {count(steps, 'step')}"):
        wall = np.asarray(plan.moving_points, float)
        plans = plan if steps == 1 else jm.march(plan, moves.path(wall, steps))[0]
        gradient = shapes.pullback(moves.shape, plans, moves.parameters, given)
    _write(request, moves, gradient, out)


def _write(request: Sensitivity, moves: Motion, gradient: Any, out: Output) -> None:
    names = shapes.names(moves.parameters)
    values, slopes = (
        np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(tree)]) for tree in (moves.parameters, gradient)
    )
    out.say(f"\n{'dJ/d(variable)':>16}{'variable':>16}")
    for k in np.argsort(-np.abs(slopes), kind="stable")[:LISTED]:
        out.say(f"{slopes[k]:>16.6g}{values[k]:>16.6g}  {names[k]}")
    out.say(f"{'... ' if len(names) > LISTED else ''}{count(len(names), 'design variable')} in {request.output.name}\n")
    out.say(variables=dict(zip(names, slopes.tolist(), strict=True)))
    with out.progress(f"writing {request.output.name}"):
        io.write_gradient(request.output, moves.parameters, gradient)
