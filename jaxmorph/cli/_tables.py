"""Summaries as text, 80 columns wide, and gates as JSON."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ._judged import RATIOS
from ._parser import flag_of
from ._parts import PROVEN
from ._summary import Summary, count, label

LISTED = 20
"""Design variables on the terminal, at most."""


def steepest(slopes: np.ndarray) -> np.ndarray:
    """Sorts design variables by their derivative, the largest first, at most `LISTED`."""
    return np.argsort(-np.abs(slopes), kind="stable")[:LISTED]


def table(before: Summary | None, after: Summary, more: Sequence[str] = ()) -> str:
    """Formats the numbers of a mesh, or before and after a motion, with the worst cells."""
    parts = f" in {after.parts} parts" if after.parts else ""
    note = f", {after.degenerate} degenerate from the start" if after.degenerate else ""
    lines = [f"quality of {after.cells} cells{parts}, inverted by {after.rule}{note}"]
    if before is None:
        lines.append(f"{'':<23}{'':>12}   worst cell")
    else:
        lines.append(f"{'':<23}{'before':>12}{'after':>12}   worst cell after")
    for (kind, name), number in after.rows.items():
        is_ratio = (kind, name) in RATIOS
        if is_ratio if before is None else name == "volume":
            continue
        cells = "" if before is None else f"{'-':>12}" if is_ratio else _cell(before.rows[kind, name].value)
        where = "" if kind == "mean" else f"   {number.name.removeprefix('cell ')} near {number.place}"
        lines.append(f"{kind + ' ' + label(name):<23}{cells}{_cell(number.value)}{where}")
    if before is not None:
        lines.append(f"{'inverted cells':<23}{before.inverted:>12}{after.inverted:>12}")
    if after.parts:
        lines.append(f"{after.between} faces between parts are not judged: their skewness and non-orthogonality.")
    return "\n".join([*lines, *more])


def gate_table(before: Summary | None, after: Summary) -> str:
    """Formats a row for each gate, then the worst cells of gates that fail."""
    if not after.gates:
        return ""
    lines = [f"{'gate':<23}{'limit':>12}{'before':>12}{'after' if before else 'now':>12}   cells beyond"]
    worst = []
    for old, gate in zip(_old(before, after), after.gates, strict=True):
        start = "-" if old is None else f"{old:.5g}"
        share = f"{gate.beyond} of {after.cells}" if gate.beyond else "0"
        lines.append(f"{gate.label:<23}{gate.limit:>12.5g}{start:>12}{gate.extreme.value:>12.5g}   {share}")
        if gate.beyond:
            worst.append(f"worst cells by {gate.label}")
            worst += [f"  {c.name.removeprefix('cell '):<22}{c.value:>12.5g}   near {c.place}" for c in gate.worst]
    return "\n".join(lines + worst)


def gate_facts(before: Summary | None, after: Summary) -> list[dict[str, Any]]:
    """Lists each gate with its numbers, for output as JSON."""
    return [
        {
            "gate": gate.flag,
            "limit": gate.limit,
            "before": old,
            "after": gate.extreme.value,
            "beyond": gate.beyond,
            "worst": [cell.facts for cell in gate.worst],
        }
        for old, gate in zip(_old(before, after), after.gates, strict=True)
    ]


def _old(before: Summary | None, after: Summary) -> list[float | None]:
    """Lists the extremes before the motion.

    The ratio of Jacobians has none: it is relative to the mesh before.
    """
    if before is None:
        return [None] * len(after.gates)
    return [None if gate.flag == "min_jacobian_ratio" else gate.extreme.value for gate in before.gates]


def faults(before: Summary | None, after: Summary) -> list[str]:
    """Writes a sentence for the cells that the motion has inverted, and for each failed gate."""
    sentences = []
    if after.worst is not None:
        are = "is" if after.spoilt == 1 else "are"
        where = f"the worst is {after.worst.name} near {after.worst.place}"
        sentences.append(f"{after.spoilt} of {count(after.cells, 'cell')} {are} inverted, {where}, by {after.rule}.")
    for k, gate in enumerate(after.gates):
        if gate.beyond:
            are = "cell is" if gate.beyond == 1 else "cells are"
            limit = "--proven" if gate.flag == PROVEN else f"{flag_of(gate.flag)} {gate.limit:g}"
            start = 0 if before is None else before.gates[k].beyond
            old = f" ({start} before the motion)" if start else ""
            sentences.append(
                f"{gate.beyond} of {after.cells} {are} beyond {limit}{old}, the worst is {gate.worst[0].name}."
            )
    return sentences


def _cell(value: float) -> str:
    return f"{value + 0.0:>12.5g}"  # -0 is 0
