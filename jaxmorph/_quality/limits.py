"""Limits of quality, and the numbers that are compared with them, of a mesh or joined of parts."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from .._host.package.arguments import between, check_fields

WORST = 5  # cells that are told
LABELS = {"non_orthogonality": "non-orthogonality", "pyramid": "face pyramid"}
PROVEN = "min_proven_margin"  # the limit that `Limits.proven` sets, to 0


@dataclasses.dataclass(frozen=True)
class Limits:
    """Limits of quality for `judge`; None limits nothing.

    - `max_aspect_ratio`, `max_skewness`: of cells by their corners, as `QualityReport` has them.
    - `max_non_orthogonality`: in degrees, as `face_quality` measures it.
    - `max_face_skewness`, `max_face_aspect_ratio`: as OpenFOAM's checkMesh measures them.
    - `min_jacobian_ratio`: smallest corner Jacobian over its initial value.
    - `proven`: every cell is proven to fold nowhere inside, during the whole motion.

    **Raises:** `ValueError` for a limit that is no number.
    """

    max_aspect_ratio: float | None = None
    max_non_orthogonality: float | None = None
    max_skewness: float | None = None
    max_face_skewness: float | None = None
    max_face_aspect_ratio: float | None = None
    min_jacobian_ratio: float | None = None
    proven: bool = False

    def __post_init__(self):
        check_fields(self)
        for name, limit in self.by_name.items():
            between(name, limit, ends="[]")

    @classmethod
    def checkmesh(cls) -> "Limits":
        """Returns the limits of OpenFOAM's checkMesh."""
        return cls(max_face_aspect_ratio=1000.0, max_non_orthogonality=70.0, max_face_skewness=4.0)

    @property
    def by_name(self) -> dict[str, float]:
        """Limits that are set, by name; `proven` is `min_proven_margin`, 0."""
        limits = {
            name: limit
            for name, limit in vars(self).items()
            if limit is not None and name != "proven"
        }
        return limits | ({PROVEN: 0.0} if self.proven else {})


@dataclasses.dataclass(frozen=True)
class Number:
    """An extreme (`max`, `min`) at a cell, or a mean by weight; `part` is None for the whole."""

    kind: str
    value: float
    cell: int = -1
    near: tuple[float, ...] = ()
    part: int | None = None
    weight: float = 0.0

    @property
    def badness(self) -> float:
        """Ranks the value, the larger the worse; infinite for NaN."""
        return np.inf if np.isnan(self.value) else self.value if self.kind == "max" else -self.value

    @property
    def place(self) -> str:
        return "(" + ", ".join(f"{x:.3g}" for x in self.near) + ")"

    @property
    def name(self) -> str:
        return str(self.cell) if self.part is None else f"processor{self.part} cell {self.cell}"

    @property
    def full_name(self) -> str:
        return f"cell {self.cell}" if self.part is None else self.name

    @property
    def facts(self) -> dict[str, Any]:
        part = {} if self.part is None else {"processor": self.part}
        return part | {"cell": self.cell, "near": list(self.near)}

    @staticmethod
    def together(parts: "Sequence[Number]") -> "Number":
        """Finds the worst of the extremes of the parts of a mesh, or the mean of their means."""
        if parts[0].kind != "mean":
            return max(parts, key=lambda number: number.badness)
        weight = sum(number.weight for number in parts)
        total = sum(number.value * number.weight for number in parts)
        return Number("mean", total / weight if weight else float("nan"), weight=weight)


@dataclasses.dataclass(frozen=True)
class Gate:
    """A limit, its extreme, the number of cells `beyond` it, and the same `before` a motion."""

    name: str
    limit: float
    extreme: Number
    beyond: int
    worst: tuple[Number, ...]
    before: "Gate | None" = None

    @property
    def label(self) -> str:
        return f"{self.name[:3]} {label(self.name[4:])}"

    @property
    def start(self) -> float | None:
        return (
            self.before.extreme.value if self.before and self.name != "min_jacobian_ratio" else None
        )

    @property
    def facts(self) -> dict[str, Any]:
        values = {"before": self.start, "after": self.extreme.value, "beyond": self.beyond}
        return {
            "gate": self.name,
            "limit": self.limit,
            **values,
            "worst": [cell.facts for cell in self.worst],
        }

    def lines(self, cells: int) -> tuple[str, list[str]]:
        """The row of a table, and rows of the worst of so many cells."""
        start = "-" if self.start is None else f"{self.start:.5g}"
        share = f"{self.beyond} of {cells}" if self.beyond else "0"
        row = f"{self.label:<23}{self.limit:>12.5g}{start:>12}{self.extreme.value:>12.5g}   {share}"
        worst = [f"  {cell.name:<22}{cell.value:>12.5g}   near {cell.place}" for cell in self.worst]
        return row, worst and [f"worst cells by {self.label}", *worst]

    @staticmethod
    def together(*parts: "Gate") -> "Gate":
        """Joins one limit of all parts of a mesh."""
        cells = (cell for gate in parts for cell in gate.worst)
        before = [gate.before for gate in parts if gate.before]
        return dataclasses.replace(
            parts[0],
            extreme=Number.together([gate.extreme for gate in parts]),
            beyond=sum(gate.beyond for gate in parts),
            worst=tuple(sorted(cells, key=lambda cell: -cell.badness)[:WORST]),
            before=Gate.together(*before) if before else None,
        )


def label(name: str) -> str:
    return LABELS.get(name, name.replace("_", " "))
