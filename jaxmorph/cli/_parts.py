"""Quality of a mesh that is judged part by part: what each part says, and the table of all."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from . import _gates
from ._judged import Judged
from ._tables import LABELS, count, place

ROWS = (
    *(("mean", "face_skewness"), ("max", "face_skewness")),
    *(("mean", "face_aspect_ratio"), ("max", "face_aspect_ratio")),
    *(("max", "non_orthogonality"), ("min", "pyramid"), ("min", "volume_ratio")),
)


@dataclasses.dataclass(frozen=True)
class Worst:
    """A measure's extreme value in a part, before and after, and the cell that has it after; NaN is worse than any."""

    before: float
    after: float
    part: int
    cell: int
    place: str

    def badness(self, kind: str) -> float:
        return np.inf if np.isnan(self.after) else self.after if kind == "max" else -self.after


@dataclasses.dataclass(frozen=True)
class Beyond:
    """A gate's extreme values in a part, and how many cells are beyond its limit, before and after."""

    worst: Worst
    before: int
    after: int


@dataclasses.dataclass(frozen=True)
class Verdict:
    """Judges one part before and after its motion, in numbers that add up.

    - `cells`, `faces_between`: cells, and faces that it shares with other parts.
    - `inverted`: inverted cells before and after; `spoilt`: those that the motion has inverted; `cell` is the worst of these.
    - `means`: sums of a measure times the volume, before and after, by name; `volume`: the sums of the volumes.
    - `rows`: kinds and names of the measures; `rule`: by what cells are inverted.
    - `worst`: extremes by kind and name.
    - `gates`: what is beyond each gate.
    """

    part: int
    cells: int
    faces_between: int
    inverted: tuple[int, int]
    spoilt: int
    cell: Worst | None
    volume: tuple[float, float]
    rows: tuple[tuple[str, str], ...]
    rule: str
    means: Mapping[str, tuple[float, float]]
    worst: Mapping[tuple[str, str], Worst]
    gates: tuple[Beyond, ...]


def verdict(part: int, before: Judged, after: Judged, gates: Sequence[_gates.Gate]) -> Verdict:
    """Judges one part. Raises `ValueError` for a gate on a measure that its cells do not have."""
    both = before, after
    sizes = [np.abs(each.volume[each.counted]) for each in both]
    means, worst = {}, {}
    rows = ROWS if before.by_faces else (*before.measures, *before.ratios)
    for kind, name in rows:
        if kind == "mean":
            sums = [float(each.values(name) @ size) for each, size in zip(both, sizes, strict=True)]
            means[name] = sums[0], sums[1]
        else:
            worst[kind, name] = _worst(part, kind, name, before, after)
    cell = None
    if len(after.spoilt):
        number = after.worst_spoilt()
        heights = [each.pyramid if after.by_faces else each.report.jacobian_ratio for each in both]
        old, new = (float(each[number]) for each in heights)
        cell = Worst(old, new, part, number, place(after, number))
    beyond = [
        (_worst(part, gate.flag[:3], gate.measure, *both), *(len(gate.beyond(each)) for each in both)) for gate in gates
    ]
    inverted = [int(each.inverted[each.counted].sum()) for each in both]
    return Verdict(
        part,
        len(after.counted),
        0 if after.mesh.between is None else len(after.mesh.between),
        (inverted[0], inverted[1]),
        len(after.spoilt),
        cell,
        (float(sizes[0].sum()), float(sizes[1].sum())),
        rows,
        after.rule,
        means,
        worst,
        tuple(Beyond(*each) for each in beyond),
    )


def _worst(part: int, kind: str, name: str, before: Judged, after: Judged) -> Worst:
    cell = after.worst(kind, name)
    return Worst(before.number(kind, name), after.number(kind, name), part, cell, place(after, cell))


@dataclasses.dataclass(frozen=True)
class Verdicts:
    """All parts' verdicts, and the gates they were judged by."""

    parts: Sequence[Verdict]
    gates: Sequence[_gates.Gate]

    @property
    def cells(self) -> int:
        return sum(part.cells for part in self.parts)

    @property
    def faces_between(self) -> int:
        return sum(part.faces_between for part in self.parts) // 2

    def worst(self, kind: str, name: str) -> Worst:
        """Finds the worst of all parts, with the worst value before, which may be of another part."""
        return _of_all(kind, [part.worst[kind, name] for part in self.parts])

    def mean(self, name: str) -> tuple[float, float]:
        """Computes the mean before and after, weighted by volume."""
        sums, sizes = (
            np.sum(each, axis=0) for each in zip(*((p.means[name], p.volume) for p in self.parts), strict=True)
        )
        return float(sums[0] / sizes[0]), float(sums[1] / sizes[1])

    @property
    def faults(self) -> list[str]:
        """One sentence for the cells that the motion has inverted, and one for each gate that fails."""
        sentences, spoilt = [], sum(part.spoilt for part in self.parts)
        if spoilt:
            worst = min(
                (part.cell for part in self.parts if part.cell is not None), key=lambda cell: -cell.badness("min")
            )
            are = "is" if spoilt == 1 else "are"
            sentences.append(
                f"{spoilt} of {count(self.cells, 'cell')} {are} inverted, the worst is {self._where(worst)}, "
                f"by {self.parts[0].rule}."
            )
        for k, gate in enumerate(self.gates):
            beyond = [part.gates[k] for part in self.parts]
            before, after = (sum(getattr(each, when) for each in beyond) for when in ("before", "after"))
            if after:
                limit, old = (
                    f"--{gate.flag.replace('_', '-')} {gate.limit:g}",
                    f" ({before} before the motion)" if before else "",
                )
                worst = _of_all(gate.flag[:3], [each.worst for each in beyond])
                are = "cell is" if after == 1 else "cells are"
                sentences.append(
                    f"{after} of {self.cells} {are} beyond {limit}{old}, the worst is {self._where(worst)}."
                )
        return sentences

    @property
    def table(self) -> str:
        """Formats the quality before and after, with the worst cells after."""
        title = f"quality of {self.cells} cells in {len(self.parts)} parts, inverted by {self.parts[0].rule}"
        lines = [title, f"{'':<23}{'before':>12}{'after':>12}   worst cell after"]
        for kind, name in self.parts[0].rows:
            label = f"{kind} {LABELS.get(name, name.replace('_', ' '))}"
            if kind == "mean":
                before, after = self.mean(name)
                lines.append(f"{label:<23}{before:>12.5g}{after:>12.5g}")
            else:
                worst = self.worst(kind, name)
                old = "-" if name == "volume_ratio" else f"{worst.before + 0.0:.5g}"
                lines.append(f"{label:<23}{old:>12}{worst.after + 0.0:>12.5g}   {self._where(worst)}")
        lines.append(f"{'inverted cells':<23}{self._inverted(0):>12}{self._inverted(1):>12}")
        seen = "skewness and non-orthogonality" if self.parts[0].rows == ROWS else "non-orthogonality"
        lines.append(f"{self.faces_between} faces between parts are not judged: their {seen}.")
        return "\n".join(lines)

    @property
    def facts(self) -> dict[str, Any]:
        """Lists the numbers for output as JSON: `before`, `after`, and the gates."""
        sides: list[dict[str, Any]] = []
        rows = self.parts[0].rows
        for when in (0, 1):
            side: dict[str, Any] = {"cells": self.cells, "inverted": self._inverted(when)}
            side |= {f"mean_{name}": self.mean(name)[when] for kind, name in rows if kind == "mean"}
            for kind, name in rows:
                if kind != "mean":
                    worst = self.worst(kind, name)
                    side[f"{kind}_{name}"] = (worst.before, worst.after)[when]
                    if when:
                        side[f"worst_{name}"] = {"processor": worst.part, "cell": worst.cell}
            sides.append(side)
        gates = []
        for k, gate in enumerate(self.gates):
            beyond = [part.gates[k] for part in self.parts]
            worst = _of_all(gate.flag[:3], [each.worst for each in beyond])
            numbers = {"before": worst.before, "after": worst.after, "beyond": sum(each.after for each in beyond)}
            gates.append({"gate": gate.flag, "limit": gate.limit, **numbers})
        more = {"faces_between_parts": self.faces_between, "parts": len(self.parts)}
        return {"before": sides[0], "after": sides[1], "gates": gates, **more}

    def _where(self, worst: Worst) -> str:
        return f"processor{worst.part} cell {worst.cell} near {worst.place}"

    def _inverted(self, when: int) -> int:
        return sum(part.inverted[when] for part in self.parts)


def _of_all(kind: str, worst: Sequence[Worst]) -> Worst:
    before = np.array([each.before for each in worst])
    start = before.max() if kind == "max" else before.min()
    return dataclasses.replace(max(worst, key=lambda each: each.badness(kind)), before=float(start))
