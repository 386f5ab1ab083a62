"""A mesh on some points, judged by the rule of the solvers that read its format."""

import dataclasses
import functools
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from .._mesh.mesh import Mesh
from .face_quality import FaceQuality, measured
from .proof.proof import Proof, proof
from .quality import quality
from .report import QualityReport, Report
from .sides import Sides

BY_FACES = {"face_skewness": "skewness", "face_aspect_ratio": "aspect_ratio"}
"""Measures of faces, by their names in limits and tables. The plain names are those of corners."""


@dataclasses.dataclass(frozen=True, eq=False)
class Judged:
    """A mesh on some points, judged relative to the mesh `before` a motion.

    An OpenFOAM case, and any mesh with polyhedra or polygons, is judged by its faces, others by the
    corners of their cells. Cells have the numbers of the file. The motion led through the points
    `steps`, along straight lines where `is_straight`.
    """

    mesh: Mesh
    points: Any
    before: "Judged | None" = None
    steps: tuple[Float[np.ndarray, "n d"], ...] = ()
    is_straight: bool = True

    @functools.cached_property
    def corners(self) -> QualityReport:
        return quality(self.mesh, None if self.before is None else self.points)

    @functools.cached_property
    def faces(self) -> FaceQuality:
        return measured(self.mesh, self.sides, self.points, None if self.before is None else self.before.faces)

    @functools.cached_property
    def sides(self) -> Sides:
        return Sides.listed(self.mesh) if self.before is None else self.before.sides

    @functools.cached_property
    def by_faces(self) -> bool:
        return self.mesh.polyhedra is not None or getattr(self.mesh.source, "format", "") == "OpenFOAM"

    @property
    def report(self) -> Report:
        return self.faces if self.by_faces else self.corners

    def key(self, name: str) -> str:
        return next((key for key, measure in BY_FACES.items() if self.by_faces and measure == name), name)

    @functools.cached_property
    def counted(self) -> np.ndarray:
        """Ids of the cells that count: those of the highest dimension."""
        return np.flatnonzero(self.report.counted)

    @functools.cached_property
    def inverted(self) -> Bool[np.ndarray, " k"]:
        """Mask of inverted cells.

        By faces the mesh before does not matter. By corners they are cells that the motion inverts,
        and cells that were inverted before and still are. A corner without a sign before cannot
        lose it.
        """
        return self.faces.is_inverted if self.by_faces else self._lost | (self._old & ~self._repaired)

    @property
    def spoilt(self) -> np.ndarray:
        """Ids of the cells that the motion has inverted, the worst first."""
        lost = self.inverted & ~self._old if self.by_faces else self._lost
        worst = self.report.worst(len(self.counted)) if lost.any() else np.zeros(0, dtype=int)
        return worst[lost[worst]]

    @functools.cached_property
    def _lost(self) -> Bool[np.ndarray, " k"]:
        return np.asarray(self.corners.is_inverted) & ~self._old

    @property
    def _old(self) -> Bool[np.ndarray, " k"]:
        return np.zeros(len(self.report.is_inverted), dtype=bool) if self.before is None else self.before.inverted

    @functools.cached_property
    def _repaired(self) -> Bool[np.ndarray, " k"]:
        """Cells that were inverted before the motion and are not inverted by themselves now."""
        if not self._old.any():
            return self._old
        return self._old & ~np.asarray(quality(self.mesh.moved(self.points)).is_inverted)

    def values(self, key: str) -> np.ndarray:
        """Lists a limited measure of the cells that count, in the order of `counted`.

        Raises `ValueError` for a measure of corners where cells are polyhedra.
        """
        if key in BY_FACES or key == "non_orthogonality":  # checkMesh's, exact also where faces are warped
            return getattr(self.faces, BY_FACES.get(key, key))[self.counted]
        if self.mesh.polyhedra is not None:
            kind = "polyhedra" if np.shape(self.points)[1] == 3 else "polygons"
            raise ValueError(
                f"{len(self.mesh.polyhedra.cut)} of {len(self.counted)} cells are {kind}, of which {key.replace('_', ' ')} "
                "is not defined. Limits on face skewness, face aspect ratio and non-orthogonality measure them whole."
            )
        of_mesh = self._proven_margin if key == "proven_margin" else np.asarray(getattr(self.corners, key))
        in_file = np.empty_like(of_mesh)
        in_file[self.mesh.cell_ids] = of_mesh
        return in_file[self.counted]

    @property
    def _proven_margin(self) -> np.ndarray:
        """The least margins of all cells during the motion, below 0 where a cell is not proven."""
        below = -np.finfo(float).tiny
        margins = [np.where(each.is_valid, each.margin, np.minimum(each.margin, below)) for each in self.proofs]
        return np.min(margins, axis=0)

    @functools.cached_property
    def proofs(self) -> tuple[Proof, ...]:
        """Proves each step at all of its instants; where it ends if nodes leave straight lines."""
        if self.before is None:
            return (proof(self.mesh),)
        starts, ends = (self.mesh.points, *self.steps), (*self.steps, self.points)
        bases = starts if self.is_straight else [None] * len(starts)
        return tuple(proof(self.mesh, end, base=base) for base, end in zip(bases, ends, strict=True))
