"""Whether a mesh is good: counts, worst cells and limits, of one mesh or the parts of one."""

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from .._host.package.arguments import checked, real_array, shown, whole
from .._mesh.mesh import Mesh, PointsLike
from .judged import RATIOS, Judged, RowsOfReport
from .limits import Gate, Limits, Number, label
from .report import QualityReport


@dataclasses.dataclass(frozen=True)
class Verdict:
    """Whether a mesh is good, from `judge`; `str` of it is a table.

    - `ok`: the motion inverts no cell, and no limit is exceeded. A mesh by itself has no inverted
      cell, and none without volume.
    - `cells`, `inverted`, `degenerate`: numbers of cells; `rule`: by what a cell is inverted.
    - `spoilt`: number of cells that the motion has inverted, or that are bad in a mesh by itself;
      `worst`: the worst, its cell and place.
    - `note`: a sentence on cells that were inverted before the motion, or "".
    - `bad` (k,): ids of the cells that are inverted or beyond a limit; none for joined parts.
    - `rows`: means and extremes by kind and measure, such as `("max", "skewness")`.
    - `gates`: each limit, with the number of cells `beyond` it.
    - `before`: the verdict on the undeformed mesh; None of a mesh by itself.
    - `parts`: the number of parts, 0 for a whole mesh. `between`: the number of faces between
      parts, which are not judged.
    - `corners`: the `QualityReport`; None after pickling, of parts, and of joined parts.
    """

    cells: int
    inverted: int
    degenerate: int
    rule: str
    spoilt: int
    worst: Number | None
    rows: RowsOfReport
    gates: tuple[Gate, ...]
    before: "Verdict | None" = None
    parts: int = 0
    between: int = 0
    bad: Int[np.ndarray, " k"] | None = dataclasses.field(default=None, compare=False, repr=False)
    judged: Judged | None = dataclasses.field(default=None, compare=False, repr=False)

    def __getstate__(self) -> dict[str, Any]:
        return vars(self.of_part())

    def of_part(self) -> "Verdict":
        """Drops the arrays of all cells, which are too large to keep for each part of a mesh."""
        return dataclasses.replace(self, before=self.before and self.before.of_part(), judged=None)

    @property
    def ok(self) -> bool:
        return not self.spoilt and not any(gate.beyond for gate in self.gates)

    @property
    def corners(self) -> QualityReport | None:
        return self.judged and self.judged.corners

    @property
    def note(self) -> str:
        old = self.before
        if old is None or not old.inverted or old.worst is None:
            return ""
        cells, were, them = (
            ("cell", "was", "it") if old.inverted == 1 else ("cells", "were", "them")
        )
        return (
            f"{old.inverted} {cells} of {old.cells} {were} folded before the motion, the worst is "
            f"{old.worst.full_name} near {old.worst.place}: the motion is not blamed for {them}. "
            "jm.improve may unfold what is folded."
        )

    @classmethod
    def together(cls, parts: "Sequence[Verdict]") -> "Verdict":
        """Joins the verdicts on the parts of a mesh. Raises `ValueError` for anything else."""
        if not isinstance(parts, Sequence) or set(map(type, parts)) != {cls}:
            raise ValueError(
                f"`parts` must be verdicts on the parts of a mesh, not {shown(parts)}."
            )
        of = {name: [getattr(part, name) for part in parts] for name in cls.__dataclass_fields__}
        spoilt, before = (list(filter(None, of[name])) for name in ("worst", "before"))
        return cls(
            cells=sum(of["cells"]),
            inverted=sum(of["inverted"]),
            degenerate=sum(of["degenerate"]),
            rule=parts[0].rule,
            spoilt=sum(of["spoilt"]),
            worst=Number.together(spoilt) if spoilt else None,
            rows={
                row: Number.together([rows[row] for rows in of["rows"]]) for row in parts[0].rows
            },
            gates=tuple(itertools.starmap(Gate.together, zip(*of["gates"], strict=True))),
            before=cls.together(before) if before else None,
            parts=len(parts),
            between=sum(of["between"]) // 2,
        )

    @checked
    def faults(
        self, name_of: Callable[[Gate], str] = lambda gate: f"{gate.name} {gate.limit:g}"
    ) -> list[str]:
        """Lists a sentence for the cells that the motion has inverted, and one for each limit."""
        sentences = []
        if self.worst is not None:
            are = "is" if self.spoilt == 1 else "are"
            s = "s" * (self.cells != 1)
            how = "inverted" if self.before or not self.degenerate else "inverted or without volume"
            where = f"the worst is {self.worst.full_name} near {self.worst.place}"
            sentences.append(
                f"{self.spoilt} of {self.cells} cell{s} {are} {how}, {where}, by {self.rule}."
            )
        for gate in self.gates:
            if gate.beyond:
                are = "cell is" if gate.beyond == 1 else "cells are"
                old = (
                    f" ({gate.before.beyond} before the motion)"
                    if gate.before and gate.before.beyond
                    else ""
                )
                where = f"the worst is {gate.worst[0].full_name}"
                sentences.append(
                    f"{gate.beyond} of {self.cells} {are} beyond {name_of(gate)}{old}, {where}."
                )
        return sentences

    @checked
    def table(self, more: Sequence[str] = ()) -> str:
        """Formats the measures, before and after a motion, with the worst cells, 80 columns wide,
        then the rows of `more` and the limits.
        """
        parts = f" in {self.parts} parts" if self.parts else ""
        note = f", {self.degenerate} degenerate from the start" if self.degenerate else ""
        lines = [
            f"quality of {self.cells} cells{parts}, inverted by {self.rule}{note}",
            *self._measures(),
        ]
        if self.parts:
            lines.append(
                f"{self.between} faces between parts are not judged: their skewness and "
                "non-orthogonality."
            )
        tables = ["\n".join([*lines, *more])]
        if self.gates:
            now = "now" if self.before is None else "after"
            rows, worst = zip(*(gate.lines(self.cells) for gate in self.gates), strict=True)
            head = f"{'gate':<23}{'limit':>12}{'before':>12}{now:>12}   cells beyond"
            tables.append("\n".join([head, *rows, *itertools.chain(*worst)]))
        return "\n\n".join(tables)

    def _measures(self) -> list[str]:
        """A row for each measure: without ratios, or after a motion without volume."""
        columns = (
            f"{'':>12}   worst cell"
            if self.before is None
            else f"{'before':>12}{'after':>12}   worst cell after"
        )
        lines = [f"{'':<23}{columns}"]
        for row, number in self.rows.items():
            if (row in RATIOS) if self.before is None else row[1] == "volume":
                continue
            start = "" if self.before is None else _column(self.before.rows[row].value)
            start = f"{'-':>12}" if row in RATIOS else start
            where = "" if row[0] == "mean" else f"   {number.name} near {number.place}"
            lines.append(f"{row[0] + ' ' + label(row[1]):<23}{start}{_column(number.value)}{where}")
        start = "" if self.before is None else f"{self.before.inverted:>12}"
        return [*lines, f"{'inverted cells':<23}{start}{self.inverted:>12}"]

    def __str__(self) -> str:
        said = filter(None, [self.note, *self.faults()])
        return "\n\n".join(filter(None, [self.table(), "\n".join(said)]))

    @property
    def facts(self) -> dict[str, Any]:
        """The numbers by name, for output as JSON."""
        facts: dict[str, Any] = {
            "cells": self.cells,
            "inverted": self.inverted,
            "inverted_by": self.rule,
        }
        facts |= {f"{kind}_{name}": number.value for (kind, name), number in self.rows.items()}
        return facts | {
            f"worst_{name}": number.facts
            for (kind, name), number in self.rows.items()
            if kind != "mean"
        }

    @property
    def gate_facts(self) -> list[dict[str, Any]]:
        """Each limit with its numbers, for output as JSON."""
        return [gate.facts for gate in self.gates]


@checked
def judge(
    mesh: Mesh,
    points: PointsLike | None = None,
    limits: Limits | None = None,
    *,
    before: Verdict | None = None,
    steps: Sequence[Float[np.ndarray, "n d"]] = (),
    is_straight: bool = True,
    part: int | None = None,
) -> Verdict:
    """Judges a mesh by itself, or after a motion, by the rule of the solvers that read its format.

    OpenFOAM's cases and meshes with polyhedra or polygons are judged by volumes and face pyramids,
    as checkMesh does. Others are judged by the Jacobians at the corners of their cells, relative to
    the undeformed mesh. A motion is not blamed for cells that were inverted before.

    **Arguments:**

    - `mesh`: the undeformed mesh.
    - `points`: points (n, d) after a motion, in the unit of the mesh. Default: the mesh by itself.
    - `limits`: further conditions. Default: none.
    - `before`: the verdict on the undeformed mesh under the same limits, for several motions of one
      mesh. Default: made.
    - `steps`: points after each step of the motion but the last, for `Limits.proven`.
    - `is_straight`: nodes move along straight lines from step to step. Default True. Else the ends
      of steps alone are proven.
    - `part`: number of the part of a mesh that `mesh` is, for `Verdict.together`.

    **Raises:** `ValueError` for points of another shape, and a limit on a measure that the cells
    lack.
    """
    limits = Limits() if limits is None else limits
    if part is not None:
        whole("part", part, 0)
    steps = tuple(real_array("steps", step, tuple(mesh.points.shape)) for step in steps)
    if points is None:
        return _verdict(Judged(mesh, mesh.points, part=part), limits, None)
    points = real_array("points", points, tuple(mesh.points.shape))
    before = judge(mesh, None, limits, part=part) if before is None else before
    judged = Judged(
        mesh, points, before.judged or Judged(mesh, mesh.points), steps, is_straight, part
    )
    verdict = _verdict(judged, limits, before)
    return verdict if part is None else verdict.of_part()


def _verdict(judged: Judged, limits: Limits, before: Verdict | None) -> Verdict:
    spoilt = judged.spoilt
    worst = None
    old = {} if before is None else {gate.name: gate for gate in before.gates}
    gates = [judged.gate(name, limit, old.get(name)) for name, limit in limits.by_name.items()]
    if len(spoilt):
        values = getattr(judged.report, "pyramid" if judged.by_faces else "jacobian_ratio")
        worst = judged.number("min", values[spoilt[0]], spoilt[0])
    return Verdict(
        cells=len(judged.counted),
        inverted=int(judged.inverted[judged.counted].sum()),
        degenerate=int(judged.report.degenerate),
        rule=judged.report.rule,
        spoilt=len(spoilt),
        worst=worst,
        rows=judged.rows,
        gates=tuple(gate for gate, _ in gates),
        before=before,
        parts=int(judged.part is not None),
        between=0 if judged.mesh.between is None else len(judged.mesh.between),
        bad=np.unique(np.concatenate([spoilt, *(beyond for _, beyond in gates)])),
        judged=judged,
    )


def _column(value: float) -> str:
    return f"{value + 0.0:>12.5g}"  # -0 is 0
