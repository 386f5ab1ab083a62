"""Quality as text, 80 columns wide."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxmorph import Inspection, WallQuality

from ._judged import Judged

LABELS = {"non_orthogonality": "non-orthogonality", "pyramid": "face pyramid"}


def alone(judged: Judged) -> str:
    """Formats a table for one mesh, with the worst cell of each row."""
    lines = [_heading(judged), f"{'':<23}{'':>12}   worst cell"]
    more = [("min", "volume"), *_pyramid(judged)]
    lines += [_row(judged, kind, name, _number(judged, kind, name)) for kind, name in (*judged.measures, *more)]
    return "\n".join(lines)


def compared(before: Judged, after: Judged, more: Sequence[str] = ()) -> str:
    """Formats a table for a mesh before and after its motion, with the worst cells of the moved mesh, and more rows below."""
    lines = [_heading(after), f"{'':<23}{'before':>12}{'after':>12}   worst cell after"]
    for kind, name in (*after.measures, *_pyramid(after)):
        lines.append(_row(after, kind, name, _number(before, kind, name) + _number(after, kind, name)))
    for kind, name in after.ratios:
        lines.append(_row(after, kind, name, f"{'-':>12}" + _number(after, kind, name)))
    lines.append(f"{'inverted cells':<23}{_inverted(before):>12}{_inverted(after):>12}")
    return "\n".join([*lines, *more])


def _pyramid(judged: Judged) -> list[tuple[str, str]]:
    return [("min", "pyramid")] if judged.by_faces else []


def _inverted(judged: Judged) -> int:
    return int(judged.inverted[judged.counted].sum())


@dataclasses.dataclass(frozen=True)
class WallNumber:
    """Holds one number of the first grid line at the moving wall: `before` and `after`, and the node of an extreme."""

    name: str
    label: str
    before: float
    after: float
    node: int | None


def wall_numbers(wall: WallQuality | None) -> list[WallNumber]:
    """Collects the numbers of the first grid line: none where the wall has none."""
    if wall is None:
        return []
    # as mean_angle, max_angle and min_height, by NumPy: nothing is compiled for a table
    angle, height, nodes = np.asarray(wall.angle), np.asarray(wall.height), np.asarray(wall.nodes)
    most, least = int(angle.argmax()), int(height.argmin())
    return [
        WallNumber("mean_wall_angle", "mean wall angle", 0.0, float(angle.mean()), None),
        WallNumber("max_wall_angle", "max wall angle", 0.0, float(angle[most]), int(nodes[most])),
        WallNumber("min_first_cell_height", "min first-cell height", 1.0, float(height[least]), int(nodes[least])),
    ]


def wall_rows(wall: Sequence[WallNumber], inspection: Inspection, points: Float[np.ndarray, "n d"]) -> list[str]:
    """Formats numbers of the first grid line, and the overshoot, as rows of `compared`; `points` are the moved ones."""
    rows = []
    for each in wall:
        where = "" if each.node is None else f"   node {each.node} near {_coordinates(points[each.node])}"
        rows.append(f"{each.label:<23}{each.before:>12g}{each.after:>12.5g}{where}")
    for label, value in (("overshoot", inspection.overshoot), ("overshoot behind", inspection.overshoot_behind)):
        rows.append(f"{label:<23}{'-':>12}{value:>12.5g}")
    return rows


def inverted_cells(judged: Judged) -> str:
    """Writes how many cells the motion has inverted, which is the worst and where, and by what; nothing if it is none."""
    bad = len(judged.spoilt)
    if not bad:
        return ""
    are = "is" if bad == 1 else "are"
    worst = judged.worst_spoilt()
    where = f"the worst is cell {worst} near {place(judged, worst)}"
    return f"{bad} of {count(len(judged.counted), 'cell')} {are} inverted, {where}, by {judged.rule}."


def place(judged: Judged, cell: int) -> str:
    """Formats a cell's centroid."""
    return _coordinates(judged.centroid(cell))


def count(number: int, what: str) -> str:
    """Writes a number with its noun: `1 step`, `2 steps`."""
    return f"{number} {what}" + ("" if number == 1 else "s")


def _coordinates(x: Any) -> str:
    return "(" + ", ".join(f"{each:.3g}" for each in np.asarray(x).tolist()) + ")"


def _heading(judged: Judged) -> str:
    degenerate = 0 if judged.by_faces else int(judged.report.degenerate)
    note = f", {degenerate} degenerate from the start" if degenerate else ""
    return f"quality of {len(judged.counted)} cells, inverted by {judged.rule}{note}"


def _number(judged: Judged, kind: str, name: str) -> str:
    return f"{judged.number(kind, name) + 0.0:>12.5g}"  # -0 is 0


def _row(judged: Judged, kind: str, name: str, numbers: str) -> str:
    label = f"{kind} {LABELS.get(name, name.replace('_', ' '))}"
    if kind == "mean":
        return f"{label:<23}{numbers}"
    cell = judged.worst(kind, name)
    return f"{label:<23}{numbers}   {cell} near {place(judged, cell)}"


def numbers(judged: Judged) -> dict[str, Any]:
    """Lists the tables' numbers by name, for output as JSON."""
    facts: dict[str, Any] = {"cells": len(judged.counted), "inverted": _inverted(judged), "inverted_by": judged.rule}
    rows = (*judged.measures, *judged.ratios, ("min", "volume"), *_pyramid(judged))
    facts |= {f"{kind}_{name}": judged.number(kind, name) for kind, name in rows}
    for kind, name in rows:
        if kind != "mean" and "volume" not in name:
            cell = judged.worst(kind, name)
            facts[f"worst_{name}"] = {"cell": cell, "near": judged.centroid(cell).tolist()}
    return facts
