"""A mesh on some points, judged by the rules of the solvers that read its format."""

import dataclasses
import functools
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

import jaxmorph as jm
from jaxmorph import Mesh, io
from jaxmorph._quality.face_quality import measured
from jaxmorph._quality.report import Report
from jaxmorph._quality.sides import Sides

from ._way import Way

ROWS = tuple((kind, name) for name in ("skewness", "aspect_ratio", "non_orthogonality") for kind in ("mean", "max"))
RATIOS = (("min", "volume_ratio"), ("min", "jacobian_ratio"))
BY_FACES = {"face_skewness": "skewness", "face_aspect_ratio": "aspect_ratio"}
"""Measures of faces by their names in tables and flags.

The plain names are for measures of corners.
"""


@dataclasses.dataclass(frozen=True, eq=False)
class Judged:
    """A mesh on some points, judged relative to the mesh `before` a motion.

    Cells have the numbers of the file.

    An OpenFOAM case, and any mesh with polyhedra or polygons, is judged by its faces, others by the
    corners of their cells. `way` is how the points came there; None where that is not known.
    """

    mesh: Mesh
    points: Any
    before: "Judged | None" = None
    way: Way | None = None

    @functools.cached_property
    def corners(self) -> jm.QualityReport:
        """The measures of the mesh's cells, pieces of polyhedra among them."""
        return jm.quality(self.mesh, None if self.before is None else self.points)

    @functools.cached_property
    def faces(self) -> jm.FaceQuality:
        """The measures of checkMesh."""
        return measured(self.mesh, self.sides, self.points, None if self.before is None else self.before.faces)

    @functools.cached_property
    def sides(self) -> Sides:
        """The mesh's faces, which a motion leaves as they are."""
        return Sides.listed(self.mesh) if self.before is None else self.before.sides

    @functools.cached_property
    def by_faces(self) -> bool:
        return self.mesh.polyhedra is not None or getattr(self.mesh.source, "format", "") == "OpenFOAM"

    @functools.cached_property
    def proof(self) -> jm.Proof:
        """The bounds on det J inside the cells."""
        return jm.proof(self.mesh, None if self.before is None else self.points)

    @property
    def report(self) -> Report:
        """The report that judges."""
        return self.faces if self.by_faces else self.corners

    @property
    def rows(self) -> tuple[tuple[str, str], ...]:
        """Rows of a table: how the cells are summed up, and the report's measure."""
        last = (("min", "pyramid"), RATIOS[0]) if self.by_faces else RATIOS
        return (*ROWS, ("min", "volume"), *last)

    def key(self, name: str) -> str:
        """Names a measure of the report as tables and flags do."""
        return next((key for key, measure in BY_FACES.items() if self.by_faces and measure == name), name)

    @functools.cached_property
    def counted(self) -> np.ndarray:
        """Ids of the cells that count: the cells of the highest dimension."""
        return np.flatnonzero(self.report.counted)

    @functools.cached_property
    def inverted(self) -> Bool[np.ndarray, " k"]:
        """Cells that are inverted.

        By faces the mesh before does not matter. By corners they are cells that the motion inverts,
        and cells that were inverted before and still are. A corner without a sign before cannot
        lose it.
        """
        if self.by_faces:
            return self.faces.is_inverted
        return self._lost | (self._old & ~self._repaired)

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
        """Cells that were inverted before the motion."""
        return np.zeros(len(self.report.is_inverted), dtype=bool) if self.before is None else self.before.inverted

    @functools.cached_property
    def _repaired(self) -> Bool[np.ndarray, " k"]:
        """Cells that were inverted before the motion and are not inverted by themselves now."""
        if not self._old.any():
            return self._old
        return self._old & ~np.asarray(jm.quality(self.mesh.moved(self.points)).is_inverted)

    def values(self, key: str) -> np.ndarray:
        """Lists the values of a gate's measure for the cells that count, in the order of `counted`.

        It raises `ValueError` for a measure of corners where cells are polyhedra.
        """
        if key in BY_FACES or key == "non_orthogonality":  # checkMesh's, exact also where faces are warped
            return getattr(self.faces, BY_FACES.get(key, key))[self.counted]
        if self.mesh.polyhedra is not None:
            kind = "polyhedra" if np.shape(self.points)[1] == 3 else "polygons"
            raise ValueError(
                f"{len(self.mesh.polyhedra.cut)} of {len(self.counted)} cells are {kind}, of which {key.replace('_', ' ')} "
                "is not defined. --max-face-skewness, --max-face-aspect-ratio and --max-non-orthogonality measure them whole."
            )
        of_mesh = self._proven_margin if key == "proven_margin" else np.asarray(getattr(self.corners, key))
        in_file = np.empty_like(of_mesh)
        in_file[self.mesh.cell_ids] = of_mesh
        return in_file[self.counted]

    @property
    def _proven_margin(self) -> np.ndarray:
        """The least margins of all cells on the way, below 0 where a cell is not proven."""
        proofs = [self.proof] if self.way is None else self.way.proofs(self.mesh)
        below = -np.finfo(float).tiny
        return np.min(
            [np.where(proof.is_valid, proof.margin, np.minimum(proof.margin, below)) for proof in proofs], axis=0
        )

    def write(self, path: Path) -> None:
        """Writes the mesh on its points, with the cells' quality where the format holds arrays."""
        moved = self.mesh.moved(self.points if self.way is None else self.way.moved)
        if io.check_output(path, self.mesh):
            io.write_moved(path, self.mesh, moved, self.corners)
        else:
            io.write(path, moved)
