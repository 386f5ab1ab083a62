"""`jaxmorph modes`, `sensitivity` and `export`: what one plan of a mesh is for."""

import dataclasses
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.flatten_util
import numpy as np
from jaxtyping import Float

import jaxmorph as jm
from jaxmorph import io, shapes

from ._early import check_apart
from ._job import job_of
from ._method import Patches, PlanRequest, describe_method, patches_of
from ._motion import Motion, motion
from ._output import LISTED, Output, format_place, plural, steepest, title
from ._requests import ExportRequest, ModesRequest, SensitivityRequest
from ._way import Points, Way, faults, instants, to_double
from ._zones import load_mesh

BATCH = 8
"""Motions computed together."""


def _open_mesh(request: PlanRequest, out: Output) -> jm.Mesh:
    with out.progress(f"reading {title(request.file)}"):
        return load_mesh(request.file, getattr(request, "zone", None), request.tags)


def _look_up_patches(request: PlanRequest, out: Output) -> Patches:
    mesh = _open_mesh(request, out)
    with out.progress("finding the patches"):
        return patches_of(request, mesh)


def _prepare_plan(request: PlanRequest, patches: Patches, out: Output, what: str = "") -> jm.Plan:
    with out.progress("preparing"):
        _, plan = next(patches.chunks())
    name, sources = describe_method(request.method, plan)
    n = len(patches.mesh.points)
    out.say(
        f"{title(request.file)}: {n} points, {what or plural(plan.n_moving, 'moving node')}",
        points=n,
    )
    out.say(f"method   {name}", method=name, sources=sources)
    return plan


class Case(NamedTuple):
    number: int
    mode: int
    amplitude: float
    output: Path
    time: float


def run_modes(request: ModesRequest, out: Output) -> int:
    cases = _cases(request)
    io.check_output(cases[0].output, request.file)
    patches = _look_up_patches(request, out)
    limits = request.gates.limits
    mesh = patches.mesh
    _check_cases(request, cases, mesh)
    with out.progress("reading the modes"):
        u = np.stack(
            [io.read_displacement(m, mesh, patches.nodes, is_position=False) for m in request.mode]
        )
    what = f"{plural(len(u), 'mode')} at {plural(len(request.amplitude), 'amplitude')}"
    plan = _prepare_plan(request, patches, out, what)
    if request.gates.proven:
        out.say(
            f"proven   cells that fold nowhere inside, {instants(plan.is_linear, 1)}",
            on_the_way=plan.is_linear,
        )
    with out.progress("judging the cells"):
        before = jm.judge(mesh, None, limits)
    ratio = list(before.rows)[-1][1][0].upper()  # of volumes, or of Jacobians
    columns = f"{'skewness':>12}{f'min {ratio}/{ratio}0':>12}{'inverted':>10}"
    out.say(f"\n{'':>6}{'amplitude':>12}{columns}  mode")
    good = []
    bad = 0
    replaced = 0
    with out.progress("moving") as stage:
        for case, points in _move_cases(mesh, plan, u, cases):
            way = Way(case.output, mesh, (points,), plan.is_linear)
            verdict = way.judge(limits, before)
            bad += not verdict.ok
            _say_case(case, request.mode[case.mode], verdict, out)
            if verdict.ok or request.allow_inverted:
                replaced += case.output.is_file()
                way.write(verdict)
                good.append(case)
            stage.done(case.number / len(cases))
    _end(request, good, len(cases), replaced, out)
    return int(bad > 0)


def _check_cases(request: ModesRequest, cases: list[Case], mesh: jm.Mesh) -> None:
    outputs = [("OUT", case.output) for case in cases]
    for _, output in outputs:
        io.check_output(output, mesh)
    inputs = [("IN", request.file), *(("--mode", file) for file in request.mode)]
    check_apart(inputs, [("OUT", request.output), *outputs])


def _end(request: ModesRequest, good: list[Case], total: int, replaced: int, out: Output) -> None:
    out.say("")
    if good:
        files = good[0].output if len(good) == 1 else f"{good[0].output} to {good[-1].output.name}"
        old = f", in place of {plural(replaced, 'older file')}" if replaced else ""
        out.say(f"wrote {files} ({out.seconds:.1f} s){old}", replaced=replaced)
    if request.output.suffix == ".pvd" and good:
        was_there = request.output.is_file()
        io.write_pvd(request.output, [case.output for case in good], [case.time for case in good])
        out.wrote(request.output, was_there)
    if len(good) < total:
        missing = f"{total - len(good)} of {plural(total, 'case')}"
        out.complain(f"{missing} not written; --allow-inverted writes them anyway.")


def _cases(request: ModesRequest) -> list[Case]:
    """Names a numbered file beside OUT for each case. Amplitudes are times if they increase."""
    amplitudes = request.amplitude
    out = request.output
    go_up = len(request.mode) == 1 and all(a < b for a, b in itertools.pairwise(amplitudes))
    suffix = ".vtu" if out.suffix == ".pvd" else out.suffix
    pairs = itertools.product(range(len(request.mode)), amplitudes)
    return [
        Case(k, mode, a, out.with_name(f"{out.stem}_{k:04d}{suffix}"), a if go_up else float(k))
        for k, (mode, a) in enumerate(pairs, start=1)
    ]


def _move_cases(
    mesh: jm.Mesh, plan: jm.Plan, u: Float[np.ndarray, "k m d"], cases: list[Case]
) -> Iterator[tuple[Case, Points]]:
    """Yields the points of each case. `BATCH` cases together cost much less than single cases."""
    base = np.asarray(mesh.points)
    nodes = np.asarray(plan.moving)
    size = min(BATCH, len(cases))
    together = jax.vmap(lambda u: jm.deform(plan, u))
    moves = np.array([case.amplitude * u[case.mode] for case in cases])
    for first in range(0, len(cases), size):
        some = np.resize(
            moves[first : first + size], (size, *moves.shape[1:])
        )  # the last ones are repeated
        for case, points, move in zip(
            cases[first:], np.asarray(together(some)), some, strict=False
        ):
            yield case, to_double(base, points, nodes, move, plan.method.exact)


def _say_case(case: Case, file: Path, verdict: jm.Verdict, out: Output) -> None:
    rows = verdict.rows
    failed = faults(verdict)
    inverted = verdict.inverted
    skewness = next(
        number.value
        for (kind, name), number in rows.items()
        if kind == "max" and "skewness" in name
    )
    ratio = list(rows.values())[-1].value
    name = file.name if len(file.name) <= 26 else f"...{file.name[-23:]}"
    out.say(
        f"{case.number:>6}{case.amplitude:>12.5g}{skewness:>12.5g}{ratio:>12.5g}{inverted:>10}  "
        f"{name}"
    )
    facts = {
        "mode": str(file),
        "amplitude": case.amplitude,
        "output": str(case.output),
        "problems": failed,
    }
    out.facts.setdefault("cases", []).append(facts | verdict.facts)
    for sentence in failed:
        out.complain(f"case {case.number}: {sentence}")


def run_sensitivity(request: SensitivityRequest, out: Output) -> int:
    job = job_of(request)
    asked = job or request
    patches = _look_up_patches(asked, out)
    mesh = patches.mesh
    moving = patches.nodes
    wall = np.asarray(mesh.points, float)[moving]
    with out.progress("finding the motion"):
        moves = None if job is None else motion(job, mesh, moving)
    was_there = request.output.is_file()
    with out.progress(f"reading {request.sensitivity.name}"):
        given = io.read_sensitivity(request.sensitivity, mesh, moving=moving)
    if len(given) == len(mesh.points):
        plan = _prepare_plan(asked, patches, out)
        if job is None or moves is None:
            _write_nodes(request, plan, given, out)
        else:
            with out.progress(f"pulling back through {plural(job.step_count, 'step')}"):
                plans, _ = jm.march(plan, moves.path(wall, job.step_count))
                gradient = shapes.pullback(moves.shape, plans, moves.parameters, given)
            _write_variables(request, moves, gradient, out)
    elif moves is None:  # of the moving nodes: the volume is not needed
        raise ValueError(
            f"{request.sensitivity}: {len(given)} of {len(mesh.points)} nodes, the moving ones: "
            "it is dJ/d(moving nodes) "
            "already. --job FILE takes it on to design variables."
        )
    else:
        out.say(
            f"{title(request.file)}: {plural(len(given), 'moving node')}, sensitivities of the "
            "surface"
        )
        with out.progress("pulling back"):
            gradient = shapes.project(moves.shape, wall, moves.parameters, given)
        _write_variables(request, moves, gradient, out)
    out.wrote(request.output, was_there)
    return 0


def _write_nodes(
    request: SensitivityRequest, plan: jm.Plan, given: np.ndarray, out: Output
) -> None:
    moving = np.asarray(plan.moving)
    wall = np.asarray(plan.moving_points)
    with out.progress("pulling back"):
        slope = np.asarray(jm.pullback(plan, np.zeros(wall.shape), given), float)
    size = np.linalg.norm(slope, axis=1)
    worst = int(size.argmax())
    place = format_place(wall[worst])
    out.say(
        f"largest  {size[worst]:.5g}, at node {moving[worst]} near {place}",
        largest=float(size[worst]),
    )
    out.say(
        f"sum      {', '.join(f'{x:.5g}' for x in slope.sum(axis=0))}",
        sum=slope.sum(axis=0).tolist(),
    )
    with out.progress(f"writing {request.output.name}"):
        io.write_sensitivity(request.output, moving, slope)


def _write_variables(
    request: SensitivityRequest, moves: Motion, gradient: Any, out: Output
) -> None:
    names = shapes.names(moves.parameters)
    values, slopes = (
        np.asarray(jax.flatten_util.ravel_pytree(tree)[0]) for tree in (moves.parameters, gradient)
    )
    out.say(f"\n{'dJ/d(variable)':>16}{'variable':>16}")
    for k in steepest(slopes):
        out.say(f"{slopes[k]:>16.6g}{values[k]:>16.6g}  {names[k]}")
    out.say(
        f"{'... ' if len(names) > LISTED else ''}{plural(len(names), 'design variable')} in "
        f"{request.output.name}\n"
    )
    out.say(variables=dict(zip(names, slopes.tolist(), strict=True)))
    with out.progress(f"writing {request.output.name}"):
        io.write_gradient(request.output, moves.parameters, gradient)


def run_export(request: ExportRequest, out: Output) -> int:
    mesh = _open_mesh(request, out)
    request = _add_roles(request, mesh, out)
    patches = patches_of(request, mesh)
    plan = _prepare_plan(request, patches, out)
    older = _older_plans(request)
    with out.progress("writing the plan"):
        if request.output is None:
            files = io.export_case(request.file, patches.mesh, plan)
        else:
            jm.export(plan, request.output)
            files = [request.output]
    out.say(moving=plan.n_moving)
    for file in files:
        out.wrote(file, file in older)
    out.say(replaced=not older.isdisjoint(files))
    return 0


def _add_roles(request: ExportRequest, mesh: jm.Mesh, out: Output) -> ExportRequest:
    """Adds what `pointDisplacement` says of the patches of a case that no flag names."""
    flags = request.boundary
    roles = io.patch_roles(mesh) if request.output is None else {}
    known = mesh.patch_names(*request.moving, *itertools.chain(*vars(flags).values()))
    for name in known:
        roles.pop(name, None)
    if not roles:
        return request
    added = {role: [name for name in roles if roles[name] == role] for role in set(roles.values())}
    moving = (*request.moving, *added.get("moving", ()))
    said = "; ".join(f"{role} {' '.join(names)}" for role, names in sorted(added.items()))
    if not moving:
        raise ValueError(
            f"{request.file}: by its pointDisplacement no patch moves: {said}. Give the wall a "
            "type there that moves it, such as sixDoFRigidBodyDisplacement; or name it by --moving "
            "where something else moves it, such as preCICE or rigidBodyMotionSolver."
        )
    out.say(f"patches  {said}, by pointDisplacement", roles=roles)
    added.pop("moving", None)
    lists = {role: (*getattr(flags, role), *names) for role, names in added.items()}
    boundary = dataclasses.replace(flags, **lists)
    return dataclasses.replace(request, moving=moving, boundary=boundary)


def _older_plans(request: ExportRequest) -> set[Path]:
    """Finds the plan at OUT, or those of a case: in `constant`, also of a region and of parts."""
    if request.output is not None:
        return {request.output} if request.output.is_file() else set()
    place = request.file
    root = place.parent.parent if place.parent.name == "constant" else place
    places = ("constant", "constant/*", "processor*/constant", "processor*/constant/*")
    return {file for folder in places for file in root.glob(f"{folder}/jaxmorph.plan")}
