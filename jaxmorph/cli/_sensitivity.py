"""`jaxmorph sensitivity`: dJ/d(points of the volume) to dJ/d(moving nodes), for adjoint solvers elsewhere."""

import numpy as np

import jaxmorph as jm
from jaxmorph import io

from ._method import named_method, patches_of
from ._output import Output
from ._requests import Sensitivity
from ._tables import count


def sensitivity(request: Sensitivity, out: Output) -> int:
    """Reads, pulls back, writes. Returns the exit status."""
    io.check_sensitivity_output(request.output)
    if request.output.resolve() == request.sensitivity.resolve():
        raise ValueError(f"{request.output}: the sensitivities are read from this file; write to another one.")
    with out.progress(f"reading {request.file.name}"):
        mesh = io.read(request.file)
    patches = patches_of(request.surface, mesh, request.file)
    with out.progress(f"reading {request.sensitivity.name}"):
        given = io.read_sensitivity(request.sensitivity, mesh)
    moving = patches.nodes
    with out.progress("preparing"):
        choice = named_method(request.method, np.asarray(mesh.points)[moving])
        plan = patches.plan(patches.chunks(choice))
    with out.progress("pulling back"):
        slope = np.asarray(jm.pullback(plan, np.zeros((len(moving), given.shape[1])), given), float)
    out.say(f"{request.file.name}: {len(mesh.points)} points, {count(len(moving), 'moving node')}")
    out.say(f"method   {choice.name}", points=len(mesh.points), method=choice.name)
    size = np.linalg.norm(slope, axis=1)
    worst = int(size.argmax())
    place = ", ".join(f"{x:.3g}" for x in np.asarray(mesh.points)[moving[worst]])
    out.say(f"largest  {size[worst]:.5g}, at node {moving[worst]} near ({place})", largest=float(size[worst]))
    out.say(f"sum      {', '.join(f'{x:.5g}' for x in slope.sum(axis=0))}", sum=slope.sum(axis=0).tolist())
    with out.progress(f"writing {request.output.name}"):
        io.write_sensitivity(request.output, moving, slope)
    out.say(f"wrote {request.output} ({out.seconds:.1f} s)", output=str(request.output))
    return 0
