"""What a verdict is made of: a mesh on some points, and its measures by corners or by faces."""

import dataclasses
import functools
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from .._mesh.mesh import Mesh
from .face_quality import FaceQuality, Sides, measured
from .limits import WORST, Gate, Number
from .proof import proof
from .quality import quality
from .report import QualityReport, Report

BY_FACES = {"face_skewness": "skewness", "face_aspect_ratio": "aspect_ratio"}
"""Measures of faces, by their names in limits and tables. The plain names are those of corners."""

RATIOS = (("min", "volume_ratio"), ("min", "jacobian_ratio"))
MEASURES_TOLD = tuple(
    (kind, name)
    for name in ("skewness", "aspect_ratio", "non_orthogonality")
    for kind in ("mean", "max")
)

RowsOfReport = dict[tuple[str, str], Number]


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
        # checkMesh's, exact also where faces are warped
        if key in BY_FACES or key == "non_orthogonality":
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
        for kind, name in (*MEASURES_TOLD, ("min", "volume"), *last):
            if (kind, name) in RATIOS:
                rows[kind, name] = self.number(kind, *self._least(name))
                continue
            value = float(getattr(report, kind)(name))
            key = (kind, keys.get(name, name))
            if kind != "mean":
                rows[key] = self.number(kind, value, report.worst(1, by=name)[0])
            elif self.part is None or name != "non_orthogonality":
                # checkMesh's mean is over faces, which parts share
                rows[key] = Number(kind, value, part=self.part, weight=weight)
        return rows
