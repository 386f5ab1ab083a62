"""Whether a mesh is good: counts, worst cells and limits, of one mesh or the parts of one."""

import dataclasses
import functools
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from .._host.package.arguments import between, check_fields, checked, real_array, shown, whole
from .._mesh.mesh import Mesh, PointsLike
from .face_quality import FaceQuality, Sides, measured
from .proof import proof
from .quality import quality
from .report import QualityReport, Report

WORST = 5

BY_FACES = {"face_skewness": "skewness", "face_aspect_ratio": "aspect_ratio"}
"""Measures of faces, by their names in limits and tables. The plain names are those of corners."""

LABELS = {"non_orthogonality": "non-orthogonality", "pyramid": "face pyramid"}
PROVEN = "min_proven_margin"  # the limit that `Limits.proven` sets, to 0

RATIOS = (("min", "volume_ratio"), ("min", "jacobian_ratio"))
ROWS = tuple(
    (kind, name)
    for name in ("skewness", "aspect_ratio", "non_orthogonality")
    for kind in ("mean", "max")
)


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


@dataclasses.dataclass(frozen=True, eq=False)
class Judged:
    """A mesh on some points, judged relative to the mesh `before` a motion, through `steps`."""

    mesh: Mesh
    points: Any
    before: "Judged | None" = None
    steps: tuple[Float[np.ndarray, "n d"], ...] = ()
    is_straight: bool = True
    part: int | None = None

    @functools.cached_property
    def corners(self) -> QualityReport:
        return quality(self.mesh, None if self.before is None else self.points)

    @functools.cached_property
    def faces(self) -> FaceQuality:
        return measured(self.mesh, self.sides, self.points)

    @functools.cached_property
    def sides(self) -> Sides:
        return Sides.listed(self.mesh) if self.before is None else self.before.sides

    @functools.cached_property
    def by_faces(self) -> bool:
        return (
            self.mesh.polyhedra is not None or getattr(self.mesh.source, "format", "") == "OpenFOAM"
        )

    @property
    def report(self) -> Report:
        return self.faces if self.by_faces else self.corners

    @functools.cached_property
    def counted(self) -> np.ndarray:
        return np.flatnonzero(self.report.counted)

    @functools.cached_property
    def inverted(self) -> Bool[np.ndarray, " k"]:
        return np.asarray(self.faces.is_inverted if self.by_faces else self.corners.is_folded)

    @property
    def _old(self) -> Bool[np.ndarray, " k"]:
        if self.before is None:
            return np.zeros(len(self.report.counted), dtype=bool)
        return self.before.inverted

    @property
    def spoilt(self) -> np.ndarray:
        """Ids of the cells for which the motion, or a mesh by itself, is blamed, worst first."""
        mask = self.inverted & ~self._old if self.by_faces else np.asarray(self.corners.is_spoilt)
        worst = self.report.worst(self.report.count) if mask.any() else np.zeros(0, dtype=int)
        return worst[mask[worst]]

    @property
    def ratio(self) -> float:
        """The smallest corner Jacobian over its initial value, of polyhedra the smallest volume, of
        cells that were sound.
        """
        if self.mesh.polyhedra is None:
            return float(self.values("jacobian_ratio").min())
        return self._least("volume_ratio")[0]

    def _least(self, name: str) -> tuple[float, int]:
        values = np.where(self._old, np.inf, getattr(self.report, name))[self.counted]
        return float(values.min()), int(self.counted[values.argmin()])

    def values(self, key: str) -> np.ndarray:
        """A measure of the counted cells. Raises `ValueError` for corners of polyhedra."""
        if (
            key in BY_FACES or key == "non_orthogonality"
        ):  # checkMesh's, exact also where faces are warped
            return getattr(self.faces, BY_FACES.get(key, key))[self.counted]
        if self.mesh.polyhedra is not None:
            kind = "polyhedra" if np.shape(self.points)[1] == 3 else "polygons"
            raise ValueError(
                f"{len(self.mesh.polyhedra.cut)} of {len(self.counted)} cells are {kind}, of "
                f"which {key.replace('_', ' ')} "
                "is not defined. Limits on face skewness, face aspect ratio and "
                "non-orthogonality measure them whole."
            )
        of_mesh = (
            self._proven_margin()
            if key == "proven_margin"
            else np.asarray(getattr(self.corners, key))
        )
        in_file = np.empty_like(of_mesh)
        in_file[self.mesh.cell_ids] = of_mesh
        if key == "jacobian_ratio":  # cells that were inverted before have none to keep
            in_file = np.where(self._old, np.inf, in_file)
        return in_file[self.counted]

    def _proven_margin(self) -> np.ndarray:
        """The least margins over the motion, below 0 if not proven; off lines, at ends of steps."""
        starts = (self.mesh.points, *self.steps)
        ends = (*self.steps, self.points)
        bases = starts if self.is_straight and self.before is not None else [None] * len(starts)
        proofs = [proof(self.mesh, end, base=base) for base, end in zip(bases, ends, strict=True)]
        below = -np.finfo(float).tiny
        return np.min(
            [
                np.where(step.is_valid, step.margin, np.minimum(step.margin, below))
                for step in proofs
            ],
            axis=0,
        )

    def number(self, kind: str, value: Any, cell: Any) -> "Number":
        return Number(
            kind,
            float(value),
            int(cell),
            tuple(np.asarray(self.report.centroid)[cell].tolist()),
            self.part,
        )

    def gate(self, name: str, limit: float, before: "Gate | None") -> "tuple[Gate, np.ndarray]":
        """Compares all cells with a limit; also lists those beyond it."""
        kind = name[:3]
        values = self.values(name[4:]).astype(float)
        sign = 1 if kind == "max" else -1
        badness = np.where(np.isnan(values), np.inf, sign * values)
        rows = np.flatnonzero(badness > sign * limit)
        order = rows[np.argsort(-badness[rows], kind="stable")][:WORST]
        worst = tuple(self.number(kind, values[row], self.counted[row]) for row in order)
        extreme = self.number(kind, sign * (sign * values).max(), self.counted[badness.argmax()])
        return Gate(name, limit, extreme, len(rows), worst, before), self.counted[rows]

    @property
    def rows(self) -> "RowsOfReport":
        report = self.report
        rows = {}
        keys = {}
        last = RATIOS
        if self.by_faces:
            keys = {measure: key for key, measure in BY_FACES.items()}
            last = (("min", "pyramid"), RATIOS[0])
        weight = float(np.abs(np.asarray(report.volume)[self.counted]).sum())
        for kind, name in (*ROWS, ("min", "volume"), *last):
            if (kind, name) in RATIOS:
                rows[kind, name] = self.number(kind, *self._least(name))
                continue
            value = float(getattr(report, kind)(name))
            key = (kind, keys.get(name, name))
            if kind != "mean":
                rows[key] = self.number(kind, value, report.worst(1, by=name)[0])
            elif (
                self.part is None or name != "non_orthogonality"
            ):  # checkMesh's mean is over faces, which parts share
                rows[key] = Number(kind, value, part=self.part, weight=weight)
        return rows


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


RowsOfReport = dict[tuple[str, str], Number]


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
            worst=_number_of_parts(spoilt) if spoilt else None,
            rows={
                row: _number_of_parts([rows[row] for rows in of["rows"]]) for row in parts[0].rows
            },
            gates=tuple(map(_gate_of_parts, zip(*of["gates"], strict=True))),
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
        if self.before is not None:
            lines.append(f"{'inverted cells':<23}{self.before.inverted:>12}{self.inverted:>12}")
        return lines

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

    ```python
    verdict = jm.judge(mesh, jm.deform(plan, u), jm.Limits(max_skewness=0.9, proven=True))
    print(verdict)
    assert verdict.ok
    ```

    **Arguments:**

    - `mesh`: the undeformed mesh.
    - `points`: points (n, d) after a motion, in the unit of the mesh. Default: the mesh by itself.
    - `limits`: further conditions. Default: none.
    - `before`: the verdict on the undeformed mesh under the same limits, for several motions of one
      mesh. Default: made.
    - `steps`: points after each step of the motion but the last, for `Limits.proven`.
    - `is_straight`: nodes move along straight lines from step to step, as with a plan that
      `is_linear`. Default True. Else the ends of steps alone are proven.
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


def _gate_of_parts(gates: Sequence[Gate]) -> Gate:
    cells = sorted((cell for gate in gates for cell in gate.worst), key=lambda cell: -cell.badness)
    before = [gate.before for gate in gates if gate.before]
    return dataclasses.replace(
        gates[0],
        extreme=_number_of_parts([gate.extreme for gate in gates]),
        beyond=sum(gate.beyond for gate in gates),
        worst=tuple(cells[:WORST]),
        before=_gate_of_parts(before) if before else None,
    )


def _number_of_parts(numbers: Sequence[Number]) -> Number:
    if numbers[0].kind != "mean":
        return max(numbers, key=lambda number: number.badness)
    weight = sum(number.weight for number in numbers)
    total = sum(number.value * number.weight for number in numbers)
    return Number("mean", total / weight if weight else float("nan"), weight=weight)


def label(name: str) -> str:
    return LABELS.get(name, name.replace("_", " "))


def _column(value: float) -> str:
    return f"{value + 0.0:>12.5g}"  # -0 is 0
