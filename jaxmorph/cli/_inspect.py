"""`jaxmorph quality`, `jaxmorph info` and `jaxmorph demo`."""

import textwrap
from typing import Any

import numpy as np

import jaxmorph as jm
from jaxmorph import Mesh, _demo, io
from jaxmorph._boundary.boundary import of_no_cell

from ._method import mesh_of
from ._output import Output, count, title
from ._requests import Demo, Info, Quality
from ._way import faults


def quality(request: Quality, out: Output) -> int:
    """Prints the quality of a mesh, or before and after a motion. Returns the exit status."""
    with out.progress("reading"):
        mesh = mesh_of(request.file, request.zone)
        moved = None if request.moved is None else mesh_of(request.moved, request.zone)
    with out.progress("judging the cells"):
        if moved is not None:
            _check_same(request, mesh, moved)
        points = None if moved is None else moved.points
        verdict = jm.judge(mesh, points, request.gates.limits, is_straight=False)
        proof = jm.proof(mesh, points) if request.proof else None
    tables = [verdict.table(), "" if proof is None else str(proof)]
    out.say("\n\n".join(filter(None, tables)), gates=verdict.gate_facts)
    if verdict.before is not None:
        out.say(before=verdict.before.facts)
    out.say(after=verdict.facts)
    bad = faults(verdict)
    if proof is not None:
        out.say(proof={name: getattr(proof, name) for name in ("valid", "invalid", "unknown", "min_margin", "depth")})
        if proof.invalid:
            verb = "folds" if proof.invalid == 1 else "fold"
            bad.append(f"{proof.invalid} of {count(proof.count, 'cell')} {verb} inside.")
    for sentence in bad:
        out.complain(sentence)
    return 1 if bad else 0


def info(request: Info, out: Output) -> int:
    """Prints what a mesh file holds, zone by zone where it has several. Returns the exit status."""
    with out.progress("reading"):
        is_su2 = request.file.suffix.lower() == ".su2"
        meshes = io.read_zones(request.file) if is_su2 else (io.read(request.file),)
    name, zones = title(request.file), []
    for number, mesh in enumerate(meshes, start=1):
        lines, facts = _described(mesh, name if len(meshes) == 1 else f"{name} zone {number}")
        out.say("\n".join(lines), **(facts if len(meshes) == 1 else {}))
        zones.append(facts)
    if len(zones) > 1:
        out.say(zones=zones)
    return 0


def _described(mesh: Mesh, name: str) -> tuple[list[str], dict[str, Any]]:
    """Describes a mesh: the lines to print, and the facts by name."""
    points, cells = np.asarray(mesh.points), mesh.cell_counts
    n, d = points.shape
    low, high = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    patches, kinds = {patch: len(nodes) for patch, nodes in mesh.patches.items()}, dict(mesh.kinds)
    facts = {"dimension": d, "points": n, "cells": cells, "low": low, "high": high, "patches": patches, "kinds": kinds}
    lines = [
        f"{name}: {d}-D, {n} points",
        "cells    " + ", ".join(f"{number} {kind}" for kind, number in cells.items()),
    ]
    for axis, least, most in zip("xyz", low, high, strict=False):
        lines.append(f"{axis:<9}{least:.6g} to {most:.6g}")
    loose = of_no_cell(mesh)
    if len(loose):
        first = ", ".join(map(str, loose[:5].tolist())) + (", ..." if len(loose) > 5 else "")
        lines.append(f"no cell  {count(len(loose), 'node')}, at rest: {first}")
        facts["of_no_cell"] = loose.tolist()
    lines.append("patches" if patches else "patches  none")
    width = max(map(len, patches), default=0)
    for patch, number in patches.items():
        lines.append(f"  {patch:<{width}}  {number:>9} nodes  {kinds.get(patch, '')}".rstrip())
    if mesh.groups:
        facts["groups"] = {group: list(names) for group, names in mesh.groups.items()}
        lines.append("groups")
    for group, names in mesh.groups.items():
        text = f"  {group}: {', '.join(names)}"
        lines.append(textwrap.fill(text, 80, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False))
    boxes = io.boxes(mesh)
    degrees = {box.name: [count - 1 for count in box.shape.counts] for box in boxes}
    if boxes:
        facts["boxes"] = degrees
        lines.append("boxes")
    for box in boxes:
        nodes = sum(len(ids) for ids, _ in box.surface.values())
        lines.append(f"  {box.name}  degrees {' x '.join(map(str, degrees[box.name]))}, {nodes:>9} nodes")
    notes = getattr(mesh.source, "notes", ())
    if notes:
        facts["notes"] = list(notes)
        lines.append("notes")
    for note in notes:
        text = f"  {note}"
        lines.append(textwrap.fill(text, 80, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False))
    return lines, facts


def demo(request: Demo, out: Output) -> int:
    """Shows a case of the paper. Returns the exit status."""
    return _demo.run(request.case, request.output)


def _ids(mesh: Mesh) -> dict[str, np.ndarray]:
    """Collects the ids that define the cells of a mesh.

    Where polyhedra are cut depends on the points, so their faces count.
    """
    if mesh.polyhedra is None:
        return {kind: np.asarray(corners) for kind, corners in mesh.cells.items()}
    faces = mesh.polyhedra.faces
    return {"labels": faces.labels, "starts": faces.starts, "owner": faces.owner, "neighbour": faces.neighbour}


def _check_same(request: Quality, mesh: Mesh, moved: Mesh) -> None:
    a, b = tuple(mesh.points.shape), tuple(moved.points.shape)
    if a != b:
        raise ValueError(f"{request.moved} has points of shape {b}, {request.file} of {a}: two different meshes.")
    ours, theirs = _ids(mesh), _ids(moved)
    if ours.keys() != theirs.keys() or not all(np.array_equal(ids, theirs[name]) for name, ids in ours.items()):
        raise ValueError(f"{request.moved} has other cells than {request.file}: two different meshes.")
