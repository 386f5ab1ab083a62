"""The report of `face_quality`."""

import dataclasses
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float

from .._host.package.arguments import checked, whole
from .report import check_inverted, ranked, table_of

MEASURES = ("skewness", "aspect_ratio", "non_orthogonality", "volume", "pyramid", "volume_ratio")


@dataclasses.dataclass(frozen=True, eq=False)
class FaceQuality:
    """Measures (k,) of each cell by its faces; faces are edges in 2-D.

    The cells are the file's cells, polyhedra and polygons whole, in the file's order: see
    `Mesh.cell_ids`.

    - `volume`: the sum of the pyramids between the faces and a point inside; in 2-D the area.
    - `pyramid`: the smallest pyramid between a face and the cell's centre, over the mean of them. 1
      for a regular cell, negative where a face is seen from behind. In 2-D a triangle.
    - `is_inverted`: the volume or a pyramid is negative beyond round-off, as checkMesh tests cells
      of finite volumes. NaN counts. Cells that the mesh numbers the other way round are turned
      first, as `quality(mesh)` does; not in a part of a mesh.
    - `skewness`: the distance by which the line between the centres of two cells misses the centre
      of their face, over the face's reach in that direction. It has no upper bound. The reach is at
      least 0.2 of the line's length; at the boundary 0.4 of the distance from the cell's centre to
      the plane of the face. Faces to other parts (`Mesh.between`) do not count.
    - `aspect_ratio`: the faces' areas are summed as seen along each axis; the largest sum over the
      smallest. In 3-D it is at least a sixth of the sums' total over the volume to the power of
      2/3. It depends on how a cell lies in the axes.
    - `non_orthogonality`: in degrees, the largest over the inner faces.
    - `centroid`: the centre of mass (k, d).
    - `counted`: False for boundary elements. They have 0, and aspect ratio, pyramid and volume
      ratio 1.
    - `volume_ratio`: volume over undeformed volume; 1 where that was zero.

    `mean_non_orthogonality` is checkMesh's average, one number: the angle whose cosine is the mean
    of the inner faces' cosines. `min`, `mean`, `max` of a measure, `worst` and `raise_if_inverted`
    are as in `QualityReport`, over the cells that count. Other means are weighted by volume.
    `str(measured)` is a table.
    """

    rule: ClassVar[str] = "volumes and face pyramids"

    volume: Float[np.ndarray, " k"]
    pyramid: Float[np.ndarray, " k"]
    is_inverted: Bool[np.ndarray, " k"]
    skewness: Float[np.ndarray, " k"]
    aspect_ratio: Float[np.ndarray, " k"]
    non_orthogonality: Float[np.ndarray, " k"]
    centroid: Float[np.ndarray, "k d"]
    counted: Bool[np.ndarray, " k"]
    mean_non_orthogonality: float
    volume_ratio: Float[np.ndarray, " k"]

    @property
    def count(self) -> int:
        """Number of cells that count."""
        return int(np.count_nonzero(self.counted))

    @property
    def inverted(self) -> int:
        """Number of inverted cells."""
        return int(self.is_inverted[self.counted].sum())

    def min(self, name: str) -> float:
        """Returns the smallest value of the measure called `name`."""
        return float(self._measure(name)[self.counted].min())

    def max(self, name: str) -> float:
        """Returns the largest value of the measure called `name`."""
        return float(self._measure(name)[self.counted].max())

    def mean(self, name: str) -> float:
        """Averages a measure by area or volume; non-orthogonality as checkMesh does."""
        if name == "non_orthogonality":
            return self.mean_non_orthogonality
        values, weight = self._measure(name)[self.counted], np.abs(self.volume[self.counted])
        return float(np.average(values, weights=weight)) if weight.sum() > 0 else float("nan")

    @checked
    def worst(self, k: int = 5, *, by: str | None = None) -> np.ndarray:
        """Lists the ids of the worst cells, the worst first; `centroid[ids]` is where they are.

        **Arguments:**

        - `k`: how many cells, default 5.
        - `by`: the measure to rank by. By default inverted cells come first, then cells of the
          smallest pyramid.

        **Raises:** `ValueError` for a measure that is not known.
        """
        whole("k", k, 0)
        name = "pyramid" if by is None else by
        return ranked(self._measure(name), name, self.counted, k, self.is_inverted if by is None else None)

    def raise_if_inverted(self) -> None:
        """Raises `ValueError` where cells are inverted, with their number and the first place."""
        check_inverted(self)

    def _measure(self, name: str) -> np.ndarray:
        if name not in MEASURES:
            raise ValueError(f"no measure is called {name!r}; there are {', '.join(MEASURES)}.")
        return getattr(self, name)

    def __repr__(self) -> str:
        return f"FaceQuality({self.count} cells)"

    def __str__(self) -> str:
        return table_of(self, f"{self.count} cells: {self.inverted} inverted", MEASURES[:-1])
