"""A mesh on some points, judged as those judge it who solve on its format."""

import dataclasses
import functools
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

import jaxmorph as jm
from jaxmorph import Mesh, io
from jaxmorph._quality.face_quality import measured
from jaxmorph._quality.sides import Sides

ROWS = (
    *(("mean", "skewness"), ("max", "skewness")),
    *(("mean", "aspect_ratio"), ("max", "aspect_ratio")),
    *(("mean", "non_orthogonality"), ("max", "non_orthogonality")),
)
FACE_ROWS = tuple((kind, name if name == "non_orthogonality" else f"face_{name}") for kind, name in ROWS)
RATIOS, FACE_RATIOS = (("min", "volume_ratio"), ("min", "jacobian_ratio")), (("min", "volume_ratio"),)
_OF_CORNERS = ("skewness", "aspect_ratio", "jacobian_ratio")


@dataclasses.dataclass(frozen=True, eq=False)
class Judged:
    """A mesh on some points, after a motion with the undeformed mesh `before`. Cells have the numbers of the file.

    An OpenFOAM case, and any mesh with polyhedra or polygons, is judged by its faces, others by the corners of their cells.
    """

    mesh: Mesh
    points: Any
    before: "Judged | None" = None

    @functools.cached_property
    def report(self) -> jm.QualityReport:
        """The measures of the mesh's cells, pieces of polyhedra among them."""
        return jm.quality(self.mesh, None if self.before is None else self.points)

    @functools.cached_property
    def faces(self) -> jm.FaceQuality:
        """The measures of checkMesh."""
        return measured(self.mesh, self.sides, self.points)

    @functools.cached_property
    def sides(self) -> Sides:
        """The mesh's faces, which a motion leaves as they are."""
        return Sides.listed(self.mesh) if self.before is None else self.before.sides

    @functools.cached_property
    def by_faces(self) -> bool:
        return self.mesh.polyhedra is not None or getattr(self.mesh.source, "format", "") == "OpenFOAM"

    @property
    def rule(self) -> str:
        """By what cells are inverted."""
        return "volumes and face pyramids" if self.by_faces else "corner Jacobians"

    @functools.cached_property
    def counted(self) -> np.ndarray:
        """Ids of the cells that count: those of the highest dimension."""
        return np.flatnonzero(self.faces.counted if self.by_faces else self.report.counted)

    @functools.cached_property
    def inverted(self) -> Bool[np.ndarray, " k"]:
        """Cells that are inverted.

        By faces, wherever the mesh came from. By corners, cells that the motion inverts, and those that were inverted
        before it and still are. A corner without a sign before has none to lose.
        """
        if self.by_faces:
            return self.faces.is_inverted
        if not self._old.any():
            return self._lost
        return self._lost | (self._old & ~self._repaired)

    @property
    def spoilt(self) -> np.ndarray:
        """Ids of the cells that the motion has inverted; all that are, without a motion."""
        lost = self._lost if not self.by_faces else self.inverted
        if self.by_faces and self.before is not None:
            lost = lost & ~self.before.inverted
        return self.counted[lost[self.counted]]

    @functools.cached_property
    def _lost(self) -> Bool[np.ndarray, " k"]:
        return np.asarray(self.report.is_inverted) & ~self._repaired

    @property
    def _old(self) -> Bool[np.ndarray, " k"]:
        """Cells that were inverted before the motion, by corners."""
        return np.zeros(len(self.report.is_inverted), dtype=bool) if self.before is None else self.before.inverted

    @functools.cached_property
    def _repaired(self) -> Bool[np.ndarray, " k"]:
        """Cells that were inverted before the motion and are not on their own now: they lost a sign that was wrong."""
        if not self._old.any():
            return self._old
        return self._old & ~np.asarray(jm.quality(self.mesh.moved(self.points)).is_inverted)

    @property
    def measures(self) -> tuple[tuple[str, str], ...]:
        return FACE_ROWS if self.by_faces else ROWS

    @property
    def ratios(self) -> tuple[tuple[str, str], ...]:
        return FACE_RATIOS if self.by_faces else RATIOS

    @property
    def volume(self) -> Float[np.ndarray, " k"]:
        return self.faces.volume if self.by_faces else np.asarray(self.report.volume)

    @property
    def volume_ratio(self) -> Float[np.ndarray, " k"]:
        if not self.by_faces:
            return np.asarray(self.report.volume_ratio)
        old = self.volume if self.before is None else self.before.volume
        return np.where(old == 0, 1.0, self.volume / np.where(old == 0, 1.0, old))

    @property
    def pyramid(self) -> Float[np.ndarray, " k"]:
        return self.faces.pyramid

    @property
    def face_skewness(self) -> Float[np.ndarray, " k"]:
        return self.faces.skewness

    @property
    def face_aspect_ratio(self) -> Float[np.ndarray, " k"]:
        return self.faces.aspect_ratio

    @property
    def non_orthogonality(self) -> Float[np.ndarray, " k"]:
        """checkMesh's, exact also where faces are warped."""
        return self.faces.non_orthogonality

    def values(self, measure: str) -> np.ndarray:
        """Lists a measure's values, one for each cell that counts.

        It raises `ValueError` for a measure of corners where cells are polyhedra.
        """
        if measure not in _OF_CORNERS:
            return np.asarray(getattr(self, measure))[self.counted]
        if self.mesh.polyhedra is not None:
            kind = "polyhedra" if np.shape(self.points)[1] == 3 else "polygons"
            raise ValueError(
                f"{len(self.mesh.polyhedra.cut)} of {len(self.counted)} cells are {kind}, of which {measure.replace('_', ' ')} "
                "is not defined. --max-face-skewness, --max-face-aspect-ratio and --max-non-orthogonality measure them whole."
            )
        of_mesh = np.asarray(getattr(self.report, measure))
        in_file = np.empty_like(of_mesh)
        in_file[self.mesh.cell_ids] = of_mesh
        return in_file[self.counted]

    def number(self, kind: str, name: str) -> float:
        """Computes the least, the largest or the mean value of a measure; the mean is weighted by volume.

        The mean of non-orthogonality is that of faces, as checkMesh has it, where faces judge.
        """
        if not self.by_faces:
            return float(getattr(self.report, kind)(name))
        if (kind, name) == ("mean", "non_orthogonality"):
            return self.faces.mean_non_orthogonality
        values, weight = self.values(name), np.abs(self.volume[self.counted])
        if kind == "mean":
            return float(np.average(values, weights=weight)) if weight.sum() > 0 else float("nan")
        return float(values.min() if kind == "min" else values.max())

    def worst(self, kind: str, name: str) -> int:
        """Finds the cell with the least or the largest value of a measure; NaN is worse than any."""
        if not self.by_faces:
            return int(self.report.worst(1, by=name)[0])
        values = self.values(name) * (1.0 if kind == "max" else -1.0)
        return int(self.counted[np.where(np.isnan(values), np.inf, values).argmax()])

    def worst_spoilt(self) -> int:
        """Finds the worst of the cells that the motion has inverted: by the face seen from behind, or by skewness."""
        if not self.by_faces:
            return int(self.report.worst(1)[0])
        pyramid = self.pyramid[self.spoilt]
        return int(self.spoilt[np.where(np.isnan(pyramid), -np.inf, pyramid).argmin()])

    def write(self, path: Path) -> None:
        """Writes the mesh on these points, with the quality of its cells where the format holds arrays."""
        moved = self.mesh.moved(self.points)
        if io.check_output(path, self.mesh):
            io.write_moved(path, self.mesh, moved, self.report)
        else:
            io.write(path, moved)

    def centroid(self, cell: int) -> np.ndarray:
        return np.asarray(self.faces.centroid if self.by_faces else self.report.centroid)[cell]
