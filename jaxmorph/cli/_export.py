"""`jaxmorph export`: plans for running solvers. It is alone as each command with a plan is."""

import jaxmorph as jm
from jaxmorph import io

from ._method import described, mesh_of, patches_of
from ._output import Output, count, title
from ._requests import ExportRequest


def export(request: ExportRequest, out: Output) -> int:
    with out.progress(f"reading {title(request.file)}"):
        mesh = mesh_of(request.file, request.zone)
    patches = patches_of(request, mesh)
    with out.progress("preparing"):
        plan = jm.prepare(patches.boundary, method=patches.method)
    with out.progress("writing the plan"):
        if request.output is None:
            files = io.export_case(request.file, mesh, plan)
        else:
            jm.export(plan, request.output)
            files = [request.output]
    name, sources = described(request.method, plan)
    out.say(f"{title(request.file)}: {len(mesh.points)} points, {count(plan.n_moving, 'moving node')}")
    out.say(f"method   {name}", points=len(mesh.points), moving=plan.n_moving, method=name, sources=sources)
    for file in files:
        out.wrote(file)
    return 0
