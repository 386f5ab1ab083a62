"""Summaries of judged meshes: numbers that add up over the parts of a mesh."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ._judged import Judged

WORST = 5
"""Cells named for each gate that fails."""

LABELS = {"non_orthogonality": "non-orthogonality", "pyramid": "face pyramid"}


@dataclasses.dataclass(frozen=True)
class Number:
    """A number of a mesh or a part: an extreme with its cell, or a mean with its weight.

    The extreme is at `cell`, whose middle is `near`.

    `part` is the part of the mesh, None for the whole. `kind` is `mean`, `max` or `min`.
    """

    kind: str
    value: float
    cell: int = -1
    near: tuple[float, ...] = ()
    part: int | None = None
    weight: float | None = None

    @property
    def badness(self) -> float:
        """Ranks the value, the larger the worse; infinite for NaN."""
        return np.inf if np.isnan(self.value) else self.value if self.kind == "max" else -self.value

    @property
    def place(self) -> str:
        return coordinates(self.near)

    @property
    def name(self) -> str:
        """The cell, by its part where the mesh has several."""
        return f"cell {self.cell}" if self.part is None else f"processor{self.part} cell {self.cell}"

    @property
    def facts(self) -> dict[str, Any]:
        part = {} if self.part is None else {"processor": self.part}
        return part | {"cell": self.cell, "near": list(self.near)}


@dataclasses.dataclass(frozen=True)
class Gate:
    """A limit by the name of its flag, the extreme, and the cells beyond the limit."""

    flag: str
    limit: float
    extreme: Number
    beyond: int
    worst: tuple[Number, ...]

    @property
    def label(self) -> str:
        return f"{self.flag[:3]} {label(self.flag[4:])}"

    @classmethod
    def from_judged(cls, judged: Judged, flag: str, limit: float, part: int | None) -> "Gate":
        kind = flag[:3]
        values = judged.values(flag[4:]).astype(float)
        badness = np.where(np.isnan(values), np.inf, values if kind == "max" else -values)
        rows = np.flatnonzero(badness > (limit if kind == "max" else -limit))
        order = rows[np.argsort(-badness[rows], kind="stable")][:WORST]
        worst = tuple(_number(judged, kind, float(values[row]), judged.counted[row], part) for row in order)
        extreme = values.max() if kind == "max" else values.min()
        row = int(badness.argmax())
        return cls(flag, limit, _number(judged, kind, float(extreme), judged.counted[row], part), len(rows), worst)


@dataclasses.dataclass(frozen=True)
class Summary:
    """Sums up one judged mesh, or all its parts.

    - `cells`, `inverted`, `degenerate`: numbers of cells; `rule`: by what a cell is inverted.
    - `spoilt`: how many cells the motion has inverted; `worst` is the worst of them.
    - `rows`: numbers by kind and measure, in the order of tables.
    - `gates`: what is beyond each limit.
    - `parts`: the number of parts, 0 for a whole mesh. `between`: the number of faces between
      parts.
    """

    cells: int
    inverted: int
    degenerate: int
    rule: str
    spoilt: int
    worst: Number | None
    rows: Mapping[tuple[str, str], Number]
    gates: tuple[Gate, ...]
    parts: int = 0
    between: int = 0

    @classmethod
    def from_judged(cls, judged: Judged, limits: Mapping[str, float], part: int | None = None) -> "Summary":
        """Sums up a mesh, or part number `part`."""
        gates = tuple(Gate.from_judged(judged, flag, limit, part) for flag, limit in limits.items())
        spoilt = judged.spoilt
        number = "pyramid" if judged.by_faces else "jacobian_ratio"
        worst = None
        if len(spoilt):
            value = float(getattr(judged.report, number)[spoilt[0]])
            worst = _number(judged, "min", value, spoilt[0], part)
        between = judged.mesh.between
        return cls(
            len(judged.counted),
            int(judged.inverted[judged.counted].sum()),
            0 if judged.by_faces else int(judged.corners.degenerate),
            judged.report.rule,
            len(spoilt),
            worst,
            dict(_rows(judged, part)),
            gates,
            0 if part is None else 1,
            0 if between is None else len(between),
        )

    @classmethod
    def together(cls, parts: "Sequence[Summary]") -> "Summary":
        """Adds up the summaries of parts."""
        spoilt = [part.worst for part in parts if part.worst is not None]
        gates = [
            Gate(
                gate.flag,
                gate.limit,
                _worst([part.gates[k].extreme for part in parts]),
                sum(part.gates[k].beyond for part in parts),
                tuple(sorted((cell for part in parts for cell in part.gates[k].worst), key=_badness)[-WORST:][::-1]),
            )
            for k, gate in enumerate(parts[0].gates)
        ]
        return cls(
            sum(part.cells for part in parts),
            sum(part.inverted for part in parts),
            sum(part.degenerate for part in parts),
            parts[0].rule,
            sum(part.spoilt for part in parts),
            _worst(spoilt) if spoilt else None,
            {row: _merged([part.rows[row] for part in parts]) for row in parts[0].rows},
            tuple(gates),
            len(parts),
            sum(part.between for part in parts) // 2,
        )

    @property
    def facts(self) -> dict[str, Any]:
        """Lists the numbers by name, for output as JSON."""
        facts: dict[str, Any] = {"cells": self.cells, "inverted": self.inverted, "inverted_by": self.rule}
        facts |= {f"{kind}_{name}": number.value for (kind, name), number in self.rows.items()}
        for (kind, name), number in self.rows.items():
            if kind != "mean":
                facts[f"worst_{name}"] = number.facts
        return facts


def _rows(judged: Judged, part: int | None) -> list[tuple[tuple[str, str], Number]]:
    report, rows = judged.report, []
    for kind, name in judged.rows:
        value, key = float(getattr(report, kind)(name)), (kind, judged.key(name))
        if kind != "mean":
            rows.append((key, _number(judged, kind, value, report.worst(1, by=name)[0], part)))
        elif part is None or name != "non_orthogonality":  # checkMesh's mean is over faces, which parts share
            weight = float(np.abs(np.asarray(report.volume)[judged.counted]).sum())
            rows.append((key, Number(kind, value, part=part, weight=weight)))
    return rows


def _number(judged: Judged, kind: str, value: float, cell: Any, part: int | None) -> Number:
    return Number(kind, value, int(cell), tuple(np.asarray(judged.report.centroid)[cell].tolist()), part)


def _merged(numbers: Sequence[Number]) -> Number:
    """Takes the worst of all parts, or the mean by their volumes."""
    if numbers[0].kind != "mean":
        return _worst(numbers)
    weight = sum(number.weight or 0.0 for number in numbers)
    total = sum(number.value * (number.weight or 0.0) for number in numbers)
    return Number("mean", total / weight if weight else float("nan"), weight=weight)


def _worst(numbers: Sequence[Number]) -> Number:
    return max(numbers, key=_badness)


def _badness(number: Number) -> float:
    return number.badness


def label(name: str) -> str:
    """Writes a measure's name."""
    return LABELS.get(name, name.replace("_", " "))


def count(number: int, what: str) -> str:
    """Writes a number with its noun: `1 step`, `2 steps`."""
    return f"{number} {what}" + ("" if number == 1 else "s")


def coordinates(x: Any) -> str:
    """Writes a place."""
    return "(" + ", ".join(f"{number:.3g}" for number in np.asarray(x).tolist()) + ")"
