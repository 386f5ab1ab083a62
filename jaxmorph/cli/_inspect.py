"""`jaxmorph quality`, `jaxmorph info` and `jaxmorph demo`."""

import textwrap

import numpy as np

from jaxmorph import Mesh, _demo, io

from ._judged import Judged
from ._output import Output, title
from ._requests import Demo, Info, Quality
from ._summary import Summary, count
from ._tables import faults, gate_facts, gate_table, table


def quality(request: Quality, out: Output) -> int:
    """Prints the quality of a mesh, or of two with the same cells. Returns the exit status."""
    limits = request.gates.limits
    with out.progress("reading"):
        mesh = io.read(request.file)
        moved = None if request.moved is None else io.read(request.moved)
    if moved is None and "min_jacobian_ratio" in limits:
        raise ValueError("--min-jacobian-ratio compares two meshes: give FILE2.")
    with out.progress("judging the cells"):
        judged = Judged(mesh, mesh.points)
        before, after = None, Summary.from_judged(judged, limits)
        if moved is not None:
            _check_same(request, mesh, moved)
            judged = Judged(mesh, moved.points, judged)
            before, after = after, Summary.from_judged(judged, limits)
        proof = judged.proof if request.proof else None
    tables = [table(before, after), gate_table(before, after), "" if proof is None else str(proof)]
    out.say("\n\n".join(filter(None, tables)), gates=gate_facts(before, after))
    if before is not None:
        out.say(before=before.facts)
    out.say(after=after.facts)
    bad = faults(before, after)
    if proof is not None:
        out.say(proof={name: getattr(proof, name) for name in ("valid", "invalid", "unknown", "min_margin", "depth")})
        if proof.invalid:
            verb = "folds" if proof.invalid == 1 else "fold"
            bad.append(f"{proof.invalid} of {count(proof.count, 'cell')} {verb} inside.")
    for sentence in bad:
        out.complain(sentence)
    return 1 if bad else 0


def info(request: Info, out: Output) -> int:
    """Prints what a mesh file holds. Returns the exit status."""
    with out.progress("reading"):
        mesh = io.read(request.file)
    points = np.asarray(mesh.points)
    n, d = points.shape
    cells = mesh.cell_counts
    out.say(f"{title(request.file)}: {d}-D, {n} points", dimension=d, points=n)
    out.say("cells    " + ", ".join(f"{number} {kind}" for kind, number in cells.items()), cells=cells)
    low, high = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    for name, least, most in zip("xyz", low, high, strict=False):
        out.say(f"{name:<9}{least:.6g} to {most:.6g}")
    patches = {name: len(nodes) for name, nodes in mesh.patches.items()}
    kinds = dict(mesh.kinds)
    out.say("patches" if patches else "patches  none", low=low, high=high, patches=patches, kinds=kinds)
    width = max(map(len, patches), default=0)
    for name, number in patches.items():
        out.say(f"  {name:<{width}}  {number:>9} nodes  {kinds.get(name, '')}".rstrip())
    if mesh.groups:
        out.say("groups", groups={name: list(names) for name, names in mesh.groups.items()})
    for name, names in mesh.groups.items():
        text = f"  {name}: {', '.join(names)}"
        out.say(textwrap.fill(text, 80, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False))
    boxes = io.boxes(mesh)
    degrees = {box.name: [count - 1 for count in box.shape.counts] for box in boxes}
    if boxes:
        out.say("boxes", boxes=degrees)
    for box in boxes:
        nodes = sum(len(ids) for ids, _ in box.surface.values())
        out.say(f"  {box.name}  degrees {' x '.join(map(str, degrees[box.name]))}, {nodes:>9} nodes")
    return 0


def demo(request: Demo, out: Output) -> int:
    """Shows a case of the paper. Returns the exit status."""
    return _demo.run(request.case, request.output)


def _ids(mesh: Mesh) -> dict[str, np.ndarray]:
    """Collects the ids that say which cells a mesh has; where the pieces of polyhedra are cut depends on the points."""
    if mesh.polyhedra is None:
        return {kind: np.asarray(corners) for kind, corners in mesh.cells.items()}
    faces = mesh.polyhedra.faces
    return {"labels": faces.labels, "starts": faces.starts, "owner": faces.owner, "neighbour": faces.neighbour}


def _check_same(request: Quality, mesh: Mesh, moved: Mesh) -> None:
    a, b = tuple(mesh.points.shape), tuple(moved.points.shape)
    if a != b:
        raise ValueError(f"{request.moved} has points of shape {b}, {request.file} of {a}: not the same mesh.")
    ours, theirs = _ids(mesh), _ids(moved)
    if ours.keys() != theirs.keys() or not all(np.array_equal(ids, theirs[name]) for name, ids in ours.items()):
        raise ValueError(f"{request.moved} has other cells than {request.file}: not the same mesh, moved.")
