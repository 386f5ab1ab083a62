"""`jaxmorph su2 def`, `su2 dot`: SU2_DEF and SU2_DOT, from SU2's own config file; `su2 shims`."""

import shlex
from collections.abc import Iterator

import jax
import numpy as np

import jaxmorph as jm
from jaxmorph import io, shapes
from jaxmorph.extend import quickly_compiled, wall_crossings
from jaxmorph.integrations import su2

from ._deform import SMALL_WORK
from ._early import check_apart
from ._method import Patches, describe_method
from ._output import Output, plural, steepest, title
from ._requests import SU2
from ._way import (
    Way,
    check_picture,
    draw,
    faults,
    finish,
    say_verdict,
    warn_of_size,
)


def run_su2(request: SU2, out: Output) -> int:
    if request.action == "shims":
        return _make_shims(request, out)
    if request.action == "def":
        options = su2.read_options(request.file)
        io.check_output(request.output or options.output, options.mesh_file)
    with out.progress(f"reading {title(request.file)}"):
        config = su2.read_config(request.file, definition=request.definition, zone=request.zone)
    mesh = config.mesh
    factors = np.asarray(config.shape.scales)
    n, d = mesh.points.shape
    out.say(f"{mesh.source.path.name}: {n} points in {d}-D", points=n)
    out.say(
        f"values   {'; '.join(_list_values(config, factors)) or 'none: nothing is deformed'}",
        variables=dict(zip(config.names, config.parameters.tolist(), strict=True)),
        factors=dict(zip(config.names, factors.tolist(), strict=True)),
    )
    nodes = plural(len(mesh.patch(*config.moving)), "node")
    out.say(f"moving   {', '.join(config.moving)}: {nodes}", moving=list(config.moving))
    with quickly_compiled(n * config.steps <= SMALL_WORK):
        return (
            _move_by_config(request, config, out)
            if request.action == "def"
            else _write_derivatives(request, config, out)
        )


def _make_shims(request: SU2, out: Output) -> int:
    links = su2.write_shims(request.file)
    out.say(f"{request.file}: SU2_DEF, SU2_DOT and SU2_DOT_AD by jaxmorph", links=list(links))
    others = ", ".join(links) or "none was found, for neither SU2_RUN nor the path has SU2_CFD"
    out.say(f"links    {others}")
    out.say(f"\nexport SU2_RUN={shlex.quote(str(request.file.absolute()))}")
    return 0


def _list_values(config: su2.Config, factors: np.ndarray) -> Iterator[str]:
    kinds = np.array([name.partition("[")[0] for name in config.names])
    relaxed = config.options.relaxation
    for kind in dict.fromkeys(kinds.tolist()):
        own = factors[kinds == kind]
        text = _format_numbers(config.parameters[kinds == kind])
        of = "" if (own == relaxed).all() else f"{_format_numbers(own)}, of DEFINITION_DV and "
        yield f"{len(own)} {kind}: {text}" + (
            f", times {of}OPT_RELAX_FACTOR= {relaxed:g}" if (own != 1).any() else ""
        )


def _format_numbers(numbers: np.ndarray) -> str:
    if len(numbers) > 4:
        return f"{numbers.min():g} to {numbers.max():g}"
    return ", ".join(f"{number:g}" for number in numbers)


def _prepare_config(request: SU2, config: su2.Config, out: Output) -> jm.Plan:
    patches = Patches(config.mesh, request.method, config.moving, config.fixed, config.symmetry)
    with out.progress("preparing"):
        return next(patches.chunks())[1]


def _move_by_config(request: SU2, config: su2.Config, out: Output) -> int:
    mesh = config.mesh
    output = request.output or config.output
    bad = []
    io.check_output(output, mesh)
    check_picture(request.picture)
    moved = mesh
    verdict = None
    if config.names:
        plan = _prepare_config(request, config, out)
        name, _ = describe_method(request.method, plan)
        out.say(f"method   {name}, {plural(config.steps, 'step')}", method=name, steps=config.steps)
        out.say(f"fixed    {', '.join(config.fixed) or 'no patch'}", fixed=list(config.fixed))
        if config.symmetry:
            out.say(f"symmetry {', '.join(config.symmetry)}", symmetry=list(config.symmetry))
        _say_size(config, out)
        with out.progress(f"deforming in {plural(config.steps, 'step')}"):
            moved = mesh.moved(
                np.asarray(jm.march(plan, config.path.astype(plan.points.dtype))[1], float)
            )
        with out.progress("inspecting the motion"):
            crossed = wall_crossings(plan, mesh, config.path, np.asarray(moved.points))
            if said := str(crossed):
                out.warn(said)
        with out.progress("judging the cells"):
            verdict = Way(output, mesh, (np.asarray(moved.points),)).judge()
        say_verdict(verdict, out)
        bad = faults(verdict)
        if verdict.spoilt and config.steps == 1:
            bad[0] += " More steps may invert none, such as DEFORM_NONLINEAR_ITER= 4."
    draw(
        request.picture, mesh, out, moved.points, moving=mesh.patch(*config.moving), verdict=verdict
    )
    if config.boxes:
        with out.progress("moving the boxes"):
            moved = io.with_boxes(moved, config.moved_boxes)
        out.say(
            f"boxes    {', '.join(box.name for box in config.boxes)}",
            boxes=[box.name for box in config.boxes],
        )
    return finish(bad, request.allow_inverted, output, lambda: io.write(output, moved), out)


def _say_size(config: su2.Config, out: Output) -> None:
    text = f"largest  {config.largest:.6g}, {config.share:.3g} times the length of what moves"
    out.say(text, largest=config.largest, share=config.share)
    warn_of_size(config.share, out)


def _write_derivatives(request: SU2, config: su2.Config, out: Output) -> int:
    fault = next(iter(config.constants), "" if config.names else "no design variable")
    if fault:
        raise ValueError(
            f"{request.file}: {fault} has no derivative: the wall does not depend on DV_VALUE."
        )
    own = config.options.beside(config.options.text("GRAD_OBJFUNC_FILENAME", "of_grad.dat"))
    output = request.output or own
    with out.progress("reading the sensitivities"):
        sensitivities = su2.read_sensitivity(config, request.sensitivity)
    files = {
        "CONFIG": request.file,
        "MESH_FILENAME": config.mesh.source.path,
        "--sensitivity": sensitivities.path,
    }
    check_apart(list(files.items()), [("OUT", output)])
    gradient = _compute_derivatives(request, config, sensitivities, out)
    angle = sensitivities.by_angle
    if config.angles:
        gradient[config.angles] = angle or 0
        what = (
            "is not told by this file, 0 here" if angle is None else f"from the file: {angle:.6g}"
        )
        out.say(f"angle    dJ/d(angle of attack) {what}", angle=angle)
    out.say(f"\n{'dJ/d(value)':>16}")
    for k in steepest(gradient):
        out.say(f"{gradient[k]:>16.6g}  {config.names[k]}")
    out.say("", gradient=dict(zip(config.names, gradient.tolist(), strict=True)))
    was_there = output.is_file()
    su2.write_gradient(
        output,
        gradient,
        config.options.text("OBJECTIVE_FUNCTION", "DRAG").split(",")[0].strip("() "),
    )
    out.wrote(output, was_there)
    return 0


def _compute_derivatives(
    request: SU2, config: su2.Config, sensitivities: su2.Sensitivity, out: Output
) -> np.ndarray:
    mesh = config.mesh
    path = sensitivities.path
    by_nodes = sensitivities.by_nodes
    kind = "surface"
    wall = np.asarray(mesh.points, float)[mesh.patch(*config.moving)]
    if len(by_nodes) == len(mesh.points):
        kind = "volume"
        plan = _prepare_config(request, config, out)
        with out.progress("pulling back"):
            by_nodes = np.asarray(jm.pullback(plan, np.zeros(wall.shape), by_nodes))
    out.say(f"reading  {path.name}: dJ/d(nodes) of the {kind}", sensitivity=str(path), kind=kind)
    project = jax.jit(
        lambda by_wall: shapes.project(config.shape, wall, config.shape.neutral(), by_wall)
    )
    with out.progress("pulling back"):
        return np.array(project(by_nodes), float)
