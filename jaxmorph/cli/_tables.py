"""Quality as text, 80 columns wide."""

from typing import Any

import numpy as np

from jaxmorph import QualityReport

ROWS = (
    *(("mean", "skewness"), ("max", "skewness")),
    *(("mean", "aspect_ratio"), ("max", "aspect_ratio")),
    *(("mean", "non_orthogonality"), ("max", "non_orthogonality")),
)
RATIOS = (("min", "volume_ratio"), ("min", "jacobian_ratio"))
LABELS = {"non_orthogonality": "non-orthogonality"}


def alone(report: QualityReport) -> str:
    """Formats a table for one mesh, with the worst cell of each row."""
    lines = [_heading(report), f"{'':<24}{'':>12}   worst cell"]
    lines += [_row(report, kind, name, _number(report, kind, name)) for kind, name in (*ROWS, ("min", "volume"))]
    return "\n".join(lines)


def compared(before: QualityReport, after: QualityReport) -> str:
    """Formats a table for a mesh before and after its motion, with the worst cells of the moved mesh."""
    lines = [_heading(after), f"{'':<24}{'before':>12}{'after':>12}   worst cell after"]
    for kind, name in ROWS:
        lines.append(_row(after, kind, name, _number(before, kind, name) + _number(after, kind, name)))
    for kind, name in RATIOS:
        lines.append(_row(after, kind, name, f"{'-':>12}" + _number(after, kind, name)))
    lines.append(f"{'inverted cells':<24}{int(before.inverted):>12}{int(after.inverted):>12}")
    return "\n".join(lines)


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
    return "(" + ", ".join(f"{x:.3g}" for x in np.asarray(report.centroid[cell]).tolist()) + ")"


def count(number: int, what: str) -> str:
    """Writes a number with its noun: `1 step`, `2 steps`."""
    return f"{number} {what}" + ("" if number == 1 else "s")


def _heading(report: QualityReport) -> str:
    degenerate = int(report.degenerate)
    note = f", {degenerate} degenerate from the start" if degenerate else ""
    return f"quality of {report.count} cells{note}"


def _number(report: QualityReport, kind: str, name: str) -> str:
    return f"{float(getattr(report, kind)(name)):>12.5g}"


def _row(report: QualityReport, kind: str, name: str, numbers: str) -> str:
    label = f"{kind} {LABELS.get(name, name.replace('_', ' '))}"
    if kind == "mean":
        return f"{label:<24}{numbers}"
    cell = int(report.worst(1, by=name)[0])
    return f"{label:<24}{numbers}   {cell} near {place(report, cell)}"


def numbers(report: QualityReport) -> dict[str, Any]:
    """Lists the tables' numbers by name, for output as JSON."""
    facts: dict[str, Any] = {"cells": report.count, "inverted": int(report.inverted)}
    for kind, name in (*ROWS, *RATIOS, ("min", "volume")):
        facts[f"{kind}_{name}"] = float(getattr(report, kind)(name))
    for name in ("skewness", "aspect_ratio", "non_orthogonality", "jacobian_ratio"):
        cell = int(report.worst(1, by=name)[0])
        facts[f"worst_{name}"] = {"cell": cell, "near": np.asarray(report.centroid[cell]).tolist()}
    return facts
