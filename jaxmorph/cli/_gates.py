"""Quality gates: limits that a mesh must keep, and which cells are beyond them."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ._flags import GATES, PRESETS
from ._judged import Judged
from ._tables import place

WORST = 5
"""Cells named for each gate that fails."""


@dataclasses.dataclass(frozen=True)
class Gate:
    """A limit, from above or from below."""

    flag: str
    limit: float

    @property
    def measure(self) -> str:
        return self.flag[4:]

    @property
    def label(self) -> str:
        return f"{self.flag[:3]} {self.measure.replace('_', ' ').replace('non orth', 'non-orth')}"

    def extreme(self, judged: Judged) -> float:
        values = judged.values(self.measure)
        return float(values.max() if self.flag.startswith("max") else values.min())

    def beyond(self, judged: Judged) -> np.ndarray:
        """Lists the ids of cells beyond the limit, the worst first; NaN is beyond every limit."""
        sign = 1.0 if self.flag.startswith("max") else -1.0
        badness = sign * judged.values(self.measure).astype(float)
        badness = np.where(np.isnan(badness), np.inf, badness)
        rows = np.flatnonzero(badness > sign * self.limit)
        return judged.counted[rows[np.argsort(-badness[rows], kind="stable")]]


def gates(given: Mapping[str, float | None], preset: str | None) -> tuple[Gate, ...]:
    """Makes the gates of a preset and of single flags, which win. Raises `ValueError` for limits that are no numbers."""
    limits = dict(PRESETS.get(preset or "", {})) | {flag: limit for flag, limit in given.items() if limit is not None}
    wrong = [flag for flag, limit in limits.items() if np.isnan(limit)]
    if wrong:
        raise ValueError(f"--{wrong[0].replace('_', '-')} needs a number, found nan.")
    return tuple(Gate(flag, limits[flag]) for flag in GATES if flag in limits)


def table(chosen: Sequence[Gate], before: Judged | None, after: Judged) -> str:
    """Formats a row for each gate, then the worst cells of gates that fail; nothing without gates."""
    if not chosen:
        return ""
    lines = [f"{'gate':<23}{'limit':>12}{'before':>12}{'after' if before else 'now':>12}   cells beyond"]
    worst = []
    for gate in chosen:
        start, bad = _start(gate, before), gate.beyond(after)
        old = "-" if start is None else f"{start:.5g}"
        share = f"{len(bad)} of {len(after.counted)}" if len(bad) else "0"
        lines.append(f"{gate.label:<23}{gate.limit:>12.5g}{old:>12}{gate.extreme(after):>12.5g}   {share}")
        if len(bad):
            worst.append(f"worst cells by {gate.label}")
            worst += [_cell(gate, after, int(cell)) for cell in bad[:WORST]]
    return "\n".join(lines + worst)


def _start(gate: Gate, before: Judged | None) -> float | None:
    """Returns the extreme before the motion. The ratio of Jacobians has none: it is relative to that mesh."""
    return None if before is None or gate.measure == "jacobian_ratio" else gate.extreme(before)


def _cell(gate: Gate, judged: Judged, cell: int) -> str:
    row = int(np.searchsorted(judged.counted, cell))
    return f"  {cell:<22}{judged.values(gate.measure)[row]:>12.5g}   near {place(judged, cell)}"


def failures(chosen: Sequence[Gate], before: Judged | None, after: Judged) -> list[str]:
    """Writes one sentence for each gate that fails, with the number of cells that failed it before the motion."""
    sentences = []
    for gate in chosen:
        bad = gate.beyond(after)
        if len(bad):
            are = "cell is" if len(bad) == 1 else "cells are"
            limit = f"--{gate.flag.replace('_', '-')} {gate.limit:g}"
            old = "" if before is None else _before(gate, before)
            sentences.append(
                f"{len(bad)} of {len(after.counted)} {are} beyond {limit}{old}, the worst is cell {bad[0]}."
            )
    return sentences


def _before(gate: Gate, before: Judged) -> str:
    count = len(gate.beyond(before))
    return f" ({count} before the motion)" if count else ""


def hopeless(chosen: Sequence[Gate], before: Judged) -> bool:
    """Tells whether the undeformed mesh was beyond a limit, which no way of moving it can cure."""
    return any(len(gate.beyond(before)) for gate in chosen)


def facts(chosen: Sequence[Gate], before: Judged | None, after: Judged) -> list[dict[str, Any]]:
    """Lists each gate with its numbers, for output as JSON."""
    rows = []
    for gate in chosen:
        bad = gate.beyond(after)
        cells = [{"cell": int(cell), "near": after.centroid(int(cell)).tolist()} for cell in bad[:WORST]]
        rows.append(
            {
                "gate": gate.flag,
                "limit": gate.limit,
                "before": _start(gate, before),
                "after": gate.extreme(after),
                "beyond": len(bad),
                "worst": cells,
            }
        )
    return rows
