"""`jaxmorph deform --ranges`: an SU2 or CGNS file by ranges of nodes and of cells, which are never in memory together."""

import numpy as np

from jaxmorph import io
from jaxmorph._host.package.files import output_path

from ._decomposed import check_flags, complain, moved_points, prepared_half
from ._judged import Judged
from ._output import Output
from ._parts import Verdict, Verdicts, verdict
from ._requests import Deform


def deform_ranges(request: Deform, out: Output) -> int:
    """Reads, moves, judges and writes range after range; says each on the terminal. Returns the exit status."""
    if request.decomposed:
        raise ValueError("--ranges is not for --decomposed, whose parts are files of their own: leave one away.")
    if request.ranges is None or request.ranges < 1:
        raise ValueError(f"--ranges must be 1 or more, found {request.ranges}.")
    check_flags(request, "--ranges")
    target = output_path(request.output)
    with out.progress(f"reading {request.file.name}"):
        mesh = io.Ranges(request.file, request.ranges, target.resolve().parent)
    mesh.check_output(target)
    with out.progress("reading the surface"):
        surface = mesh.surface()
    half, path, dtype = prepared_half(request, surface, out, "--ranges")
    largest = min(request.ranges, len(mesh.before))
    with out.progress("moving the nodes") as stage:
        for k in range(len(mesh)):
            base, nodes = mesh.read(k), mesh.nodes(k)
            mesh.put(k, moved_points(half, path, dtype, largest, base, nodes, f"nodes {nodes[0]} to {nodes[-1]}"))
            stage.done((k + 1) / len(mesh))
    with out.progress("judging the cells"):
        judged = Verdicts(_verdicts(request, mesh), request.gates, "range ")
    out.say(f"\n{judged.table}\n", **judged.facts)
    complain(request, judged, out)
    if judged.faults and not request.allow_inverted:
        out.complain(f"{request.output} is not written; --allow-inverted writes it all the same.")
        return 1
    with out.progress(f"writing {request.output.name}"):
        mesh.write(target)
    out.say(f"wrote {request.output} ({out.seconds:.1f} s)", output=str(request.output))
    return 1 if judged.faults else 0


def _verdicts(request: Deform, mesh: io.Ranges) -> list[Verdict]:
    verdicts = []
    for k, (part, points) in enumerate(mesh.cells()):
        before = Judged(part, np.asarray(part.points))
        verdicts.append(verdict(k, before, Judged(part, points, before), request.gates))
    return verdicts
