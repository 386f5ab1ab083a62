"""Quality as text, 80 columns wide."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxmorph import Inspection, QualityReport, WallQuality

ROWS = (
    *(("mean", "skewness"), ("max", "skewness")),
    *(("mean", "aspect_ratio"), ("max", "aspect_ratio")),
    *(("mean", "non_orthogonality"), ("max", "non_orthogonality")),
)
RATIOS = (("min", "volume_ratio"), ("min", "jacobian_ratio"))
LABELS = {"non_orthogonality": "non-orthogonality"}


def alone(report: QualityReport) -> str:
    """Formats a table for one mesh, with the worst cell of each row."""
    lines = [_heading(report), f"{'':<23}{'':>12}   worst cell"]
    lines += [_row(report, kind, name, _number(report, kind, name)) for kind, name in (*ROWS, ("min", "volume"))]
    return "\n".join(lines)


def compared(before: QualityReport, after: QualityReport, more: Sequence[str] = ()) -> str:
    """Formats a table for a mesh before and after its motion, with the worst cells of the moved mesh, and more rows below."""
    lines = [_heading(after), f"{'':<23}{'before':>12}{'after':>12}   worst cell after"]
    for kind, name in ROWS:
        lines.append(_row(after, kind, name, _number(before, kind, name) + _number(after, kind, name)))
    for kind, name in RATIOS:
        lines.append(_row(after, kind, name, f"{'-':>12}" + _number(after, kind, name)))
    lines.append(f"{'inverted cells':<23}{int(before.inverted):>12}{int(after.inverted):>12}")
    return "\n".join([*lines, *more])


def wall_rows(wall: WallQuality | None, inspection: Inspection, points: Float[np.ndarray, "n d"]) -> list[str]:
    """Formats the first grid line at the moving wall and the overshoot as rows of `compared`; `points` are the moved ones."""
    rows = []
    if wall is not None:
        angle, height = np.asarray(wall.angle), np.asarray(wall.height)
        rows = [
            f"{'mean wall angle':<23}{0:>12}{angle.mean():>12.5g}",
            f"{'max wall angle':<23}{0:>12}{angle.max():>12.5g}   {_node(wall, int(angle.argmax()), points)}",
            f"{'min first-cell height':<23}{1:>12}{height.min():>12.5g}   {_node(wall, int(height.argmin()), points)}",
        ]
    for label, value in (("overshoot", inspection.overshoot), ("overshoot behind", inspection.overshoot_behind)):
        rows.append(f"{label:<23}{'-':>12}{value:>12.5g}")
    return rows


def wall_numbers(wall: WallQuality | None) -> tuple[dict[str, float], dict[str, float]]:
    """Collects the numbers of `wall_rows` for machines, before and after; none where the wall has no first grid line."""
    if wall is None:
        return {}, {}
    names = ("mean_wall_angle", "max_wall_angle", "min_first_cell_height")
    after = (float(wall.mean_angle), float(wall.max_angle), float(wall.min_height))
    return dict(zip(names, (0.0, 0.0, 1.0), strict=True)), dict(zip(names, after, strict=True))


def inverted_cells(report: QualityReport) -> str:
    """Writes how many cells are inverted, and which is the worst and where; nothing if none is."""
    bad = int(report.inverted)
    if not bad:
        return ""
    are = "cell is" if bad == 1 else "cells are"
    worst = int(report.worst(1)[0])
    return f"{bad} of {report.count} {are} inverted, the worst is cell {worst} near {place(report, worst)}."


def place(report: QualityReport, cell: int) -> str:
    """Formats a cell's centroid."""
    return _coordinates(report.centroid[cell])


def count(number: int, what: str) -> str:
    """Writes a number with its noun: `1 step`, `2 steps`."""
    return f"{number} {what}" + ("" if number == 1 else "s")


def _coordinates(x: Any) -> str:
    return "(" + ", ".join(f"{each:.3g}" for each in np.asarray(x).tolist()) + ")"


def _node(wall: WallQuality, row: int, points: Float[np.ndarray, "n d"]) -> str:
    node = int(wall.nodes[row])
    return f"node {node} near {_coordinates(points[node])}"


def _heading(report: QualityReport) -> str:
    degenerate = int(report.degenerate)
    note = f", {degenerate} degenerate from the start" if degenerate else ""
    return f"quality of {report.count} cells{note}"


def _number(report: QualityReport, kind: str, name: str) -> str:
    return f"{float(getattr(report, kind)(name)):>12.5g}"


def _row(report: QualityReport, kind: str, name: str, numbers: str) -> str:
    label = f"{kind} {LABELS.get(name, name.replace('_', ' '))}"
    if kind == "mean":
        return f"{label:<23}{numbers}"
    cell = int(report.worst(1, by=name)[0])
    return f"{label:<23}{numbers}   {cell} near {place(report, cell)}"


def numbers(report: QualityReport) -> dict[str, Any]:
    """Lists the tables' numbers by name, for output as JSON."""
    facts: dict[str, Any] = {"cells": report.count, "inverted": int(report.inverted)}
    for kind, name in (*ROWS, *RATIOS, ("min", "volume")):
        facts[f"{kind}_{name}"] = float(getattr(report, kind)(name))
    for name in ("skewness", "aspect_ratio", "non_orthogonality", "jacobian_ratio"):
        cell = int(report.worst(1, by=name)[0])
        facts[f"worst_{name}"] = {"cell": cell, "near": np.asarray(report.centroid[cell]).tolist()}
    return facts
