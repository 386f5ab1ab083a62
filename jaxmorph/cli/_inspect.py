"""`jaxmorph quality`, `jaxmorph info`, `jaxmorph convert` and `jaxmorph demo`."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

import jaxmorph as jm
from jaxmorph import Mesh, io

from ._output import Output, plural, some, title, wrap
from ._requests import Convert, Demo, Info, Quality
from ._way import check_picture, draw, faults
from ._zones import load_mesh


def run_quality(request: Quality, out: Output) -> int:
    with out.progress("reading"):
        mesh = load_mesh(request.file, request.zone, request.tags)
        points = None if request.moved is None else _same_mesh(request, mesh, request.moved).points
    check_picture(request.picture)
    with out.progress("judging the cells"):
        verdict = jm.judge(mesh, points, request.gates.limits, is_straight=False)
        proof = jm.proof(mesh, points) if request.proof else None
    bad = faults(verdict)
    tables = [verdict.table(), *filter(None, [verdict.note])]
    out.say(gates=verdict.gate_facts, after=verdict.facts)
    if verdict.before is not None:
        out.say(before=verdict.before.facts)
    if proof is not None:
        tables.append(str(proof))
        out.say(
            proof={
                name: getattr(proof, name)
                for name in ("valid", "invalid", "unknown", "min_margin", "depth")
            }
        )
        if proof.invalid:
            verb = "folds" if proof.invalid == 1 else "fold"
            bad.append(f"{proof.invalid} of {plural(proof.count, 'cell')} {verb} inside.")
    out.say("\n\n".join(tables))
    draw(request.picture, mesh, out, points, verdict=verdict)
    for sentence in bad:
        out.complain(sentence)
    return 1 if bad else 0


def _same_mesh(request: Quality, mesh: Mesh, file: Path) -> Mesh:
    moved = load_mesh(file, request.zone, request.tags)
    ours = _find_cell_ids(mesh)
    theirs = _find_cell_ids(moved)
    if ours.keys() != theirs.keys() or not all(
        np.array_equal(ids, theirs[name]) for name, ids in ours.items()
    ):
        raise ValueError(f"{file} has other cells than {request.file}: two different meshes.")
    return moved


def _find_cell_ids(mesh: Mesh) -> Mapping[str, Any]:
    """Collects the ids that define the cells, with faces of polyhedra: cuts depend on points."""
    return mesh.cells if mesh.polyhedra is None else vars(mesh.polyhedra.faces)


def run_info(request: Info, out: Output) -> int:
    with out.progress("reading"):
        is_su2 = request.file.suffix.lower() == ".su2"
        meshes = list(
            io.read_zones(request.file) if is_su2 else [load_mesh(request.file, tags=request.tags)]
        )
    if len(meshes) > 1 and request.picture is not None:
        raise ValueError(
            f"--picture is of one zone, {request.file} has {len(meshes)}: quality --zone 1 "
            "--picture ..."
        )
    check_picture(request.picture)
    zones: list[dict[str, Any]] = []
    for number, mesh in enumerate(meshes, start=1):
        with out.progress("counting"):
            facts = _list_facts(mesh)
        name = title(request.file) + (f" zone {number}" if len(meshes) > 1 else "")
        out.say("\n".join(_describe_mesh(name, mesh, facts)))
        zones.append({key: value for key, value in facts.items() if value or key in ALWAYS})
    out.say(None, **(zones[0] if len(zones) == 1 else {"zones": zones}))
    draw(request.picture, meshes[0], out)
    return 0


def run_convert(request: Convert, out: Output) -> int:
    io.check_output(request.output, request.file)
    with out.progress("reading"):
        mesh = load_mesh(request.file, tags=request.tags)
    with out.progress("comparing the formats"):
        lost = list(io.losses(request.output, mesh))
    for sentence in lost:
        out.warn(sentence)
    old = ", in place of an older file" if request.output.is_file() else ""
    with out.progress("writing"):
        io.write(request.output, mesh)
    out.say(f"wrote {request.output}: {mesh}{old}", output=str(request.output), lost=lost)
    return 0


ALWAYS = ("dimension", "points", "cells", "low", "high", "patches", "kinds")
"""Facts that are printed even when they are empty."""


def _list_facts(mesh: Mesh) -> dict[str, Any]:
    points = np.asarray(mesh.points)
    faces = [] if mesh.polyhedra is None else [mesh.polyhedra.faces.labels]
    corners = map(np.ravel, (*mesh.cells.values(), *faces))
    return {
        "dimension": points.shape[1],
        "points": len(points),
        "cells": mesh.cell_counts,
        "low": points.min(axis=0).tolist(),
        "high": points.max(axis=0).tolist(),
        "patches": {patch: len(nodes) for patch, nodes in mesh.patches.items()},
        "kinds": dict(mesh.kinds),
        "of_no_cell": np.setdiff1d(np.arange(len(points)), np.concatenate([[], *corners])).tolist(),
        "groups": {group: list(names) for group, names in mesh.groups.items()},
        "periodic": [pair.patches for pair in io.periodic(mesh)],
        "boxes": {box.name: [number - 1 for number in box.shape.counts] for box in io.boxes(mesh)},
        "notes": list(getattr(mesh.source, "notes", ())),
    }


def _describe_mesh(name: str, mesh: Mesh, facts: dict[str, Any]) -> Iterator[str]:
    yield f"{name}: {facts['dimension']}-D, {facts['points']} points"
    yield "cells    " + ", ".join(f"{number} {kind}" for kind, number in facts["cells"].items())
    for axis, least, most in zip("xyz", facts["low"], facts["high"], strict=False):
        yield f"{axis:<9}{least:.6g} to {most:.6g}"
    loose = facts["of_no_cell"]
    if loose:
        yield f"no cell  {plural(len(loose), 'node')}, at rest: {some(loose)}"
    yield "patches" if facts["patches"] else "patches  none"
    width = max(map(len, facts["patches"]), default=0)
    for patch, number in facts["patches"].items():
        yield f"  {patch:<{width}}  {number:>9} nodes  {facts['kinds'].get(patch, '')}".rstrip()
    yield from _format_list(
        "groups", [f"{group}: {', '.join(names)}" for group, names in facts["groups"].items()]
    )
    yield from _format_list(
        "periodic", [f"--periodic {' '.join(pair)}" for pair in facts["periodic"]]
    )
    yield from _format_list("boxes", list(map(_line_of_box, io.boxes(mesh))))
    yield from _format_list("notes", facts["notes"])


def _format_list(what: str, lines: list[str]) -> list[str]:
    return [what, *(wrap(f"  {line}", 4) for line in lines)] if lines else []


def _line_of_box(box: io.Box) -> str:
    degrees = " x ".join(str(number - 1) for number in box.shape.counts)
    return (
        f"{box.name}  degrees {degrees}, {sum(len(ids) for ids, _ in box.surface.values()):>9} "
        "nodes"
    )


def run_demo(request: Demo, out: Output) -> int:
    from jaxmorph import _demo  # with matplotlib

    return _demo.run_paper_case(request.output)
