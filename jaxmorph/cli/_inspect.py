"""`jaxmorph quality`, `jaxmorph info`, `jaxmorph convert` and `jaxmorph demo`."""

from collections.abc import Iterator
from typing import Any

import numpy as np

import jaxmorph as jm
from jaxmorph import Mesh, io

from ._method import mesh_of
from ._output import Output, count, some, title, wrapped
from ._requests import Convert, Demo, Info, Quality
from ._way import check_picture, draw, faults


def quality(request: Quality, out: Output) -> int:
    with out.progress("reading"):
        mesh = mesh_of(request.file, request.zone)
        moved = None if request.moved is None else mesh_of(request.moved, request.zone)
    check_picture(request.picture, mesh)
    with out.progress("judging the cells"):
        if moved is not None:
            _check_same(request, mesh, moved)
        points = None if moved is None else moved.points
        verdict = jm.judge(mesh, points, request.gates.limits, is_straight=False)
        proof = jm.proof(mesh, points) if request.proof else None
    tables = [verdict.table(), *([] if proof is None else [str(proof)])]
    out.say("\n\n".join(tables), gates=verdict.gate_facts, after=verdict.facts)
    if verdict.before is not None:
        out.say(before=verdict.before.facts)
    draw(request.picture, mesh, out, points, verdict=verdict)
    bad = faults(verdict) + ([] if proof is None else _proven(proof, out))
    for sentence in bad:
        out.complain(sentence)
    return 1 if bad else 0


def _proven(proof: jm.Proof, out: Output) -> list[str]:
    out.say(proof={name: getattr(proof, name) for name in ("valid", "invalid", "unknown", "min_margin", "depth")})
    verb = "folds" if proof.invalid == 1 else "fold"
    return [f"{proof.invalid} of {count(proof.count, 'cell')} {verb} inside."] if proof.invalid else []


def info(request: Info, out: Output) -> int:
    with out.progress("reading"):
        is_su2 = request.file.suffix.lower() == ".su2"
        meshes = list(io.read_zones(request.file) if is_su2 else [io.read(request.file)])
    if len(meshes) > 1 and request.picture is not None:
        raise ValueError(f"--picture is of one zone, {request.file} has {len(meshes)}: quality --zone 1 --picture ...")
    check_picture(request.picture, meshes[0])
    zones: list[dict[str, Any]] = []
    for number, mesh in enumerate(meshes, start=1):
        facts = _facts(mesh)
        name = title(request.file) + (f" zone {number}" if len(meshes) > 1 else "")
        out.say("\n".join(_lines(name, mesh, facts)))
        zones.append({key: value for key, value in facts.items() if value or key in ALWAYS})
    facts = zones[0] if len(zones) == 1 else {"zones": zones}
    out.say(None, **facts)
    draw(request.picture, meshes[0], out)
    return 0


def convert(request: Convert, out: Output) -> int:
    with out.progress("reading"):
        mesh = io.read(request.file)
    lost = list(io.losses(request.output, mesh))
    for sentence in lost:
        out.warn(sentence)
    with out.progress("writing"):
        io.write(request.output, mesh)
    out.say(f"wrote {request.output}: {mesh}", output=str(request.output), lost=lost)
    return 0


ALWAYS = ("dimension", "points", "cells", "low", "high", "patches", "kinds")
"""Facts that are printed even when they are empty."""


def _facts(mesh: Mesh) -> dict[str, Any]:
    points = np.asarray(mesh.points)
    low, high = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    return {
        "dimension": points.shape[1],
        "points": len(points),
        "cells": mesh.cell_counts,
        "low": low,
        "high": high,
        "patches": {patch: len(nodes) for patch, nodes in mesh.patches.items()},
        "kinds": dict(mesh.kinds),
        "of_no_cell": _of_no_cell(mesh).tolist(),
        "groups": {group: list(names) for group, names in mesh.groups.items()},
        "boxes": {box.name: [number - 1 for number in box.shape.counts] for box in io.boxes(mesh)},
        "notes": list(getattr(mesh.source, "notes", ())),
    }


def _of_no_cell(mesh: Mesh) -> np.ndarray:
    ids = [*mesh.cells.values(), *([] if mesh.polyhedra is None else [mesh.polyhedra.faces.labels])]
    return np.setdiff1d(np.arange(len(mesh.points)), np.concatenate([[], *map(np.ravel, ids)]))


def _lines(name: str, mesh: Mesh, facts: dict[str, Any]) -> Iterator[str]:
    yield f"{name}: {facts['dimension']}-D, {facts['points']} points"
    yield "cells    " + ", ".join(f"{number} {kind}" for kind, number in facts["cells"].items())
    for axis, least, most in zip("xyz", facts["low"], facts["high"], strict=False):
        yield f"{axis:<9}{least:.6g} to {most:.6g}"
    loose = facts["of_no_cell"]
    if loose:
        yield f"no cell  {count(len(loose), 'node')}, at rest: {some(loose)}"
    yield "patches" if facts["patches"] else "patches  none"
    width = max(map(len, facts["patches"]), default=0)
    for patch, number in facts["patches"].items():
        yield f"  {patch:<{width}}  {number:>9} nodes  {facts['kinds'].get(patch, '')}".rstrip()
    rest = {
        "groups": [f"  {group}: {', '.join(names)}" for group, names in facts["groups"].items()],
        "boxes": list(map(_line_of_box, io.boxes(mesh))),
        "notes": list(map("  {}".format, facts["notes"])),
    }
    for what, lines in rest.items():
        yield from (what, *(wrapped(line, 4) for line in lines)) if lines else ()


def _line_of_box(box: io.Box) -> str:
    degrees = " x ".join(str(number - 1) for number in box.shape.counts)
    return f"  {box.name}  degrees {degrees}, {sum(len(ids) for ids, _ in box.surface.values()):>9} nodes"


def demo(request: Demo, out: Output) -> int:
    from jaxmorph import _demo  # with matplotlib

    return _demo.run(request.output)


def _ids(mesh: Mesh) -> dict[str, np.ndarray]:
    """Collects the ids that define the cells, with faces of polyhedra: cuts depend on points."""
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
