"""Reports on cells: what `quality` and `face_quality` report alike, and the report of `quality`."""

from collections.abc import Callable
from typing import Any, ClassVar, Protocol, runtime_checkable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._host.cells.topology import DIMENSION
from .._host.package.arguments import checked, whole
from .._kernels.module import Module
from .._kernels.values import Either, array, is_known, largest, on_host, smallest

MEASURES = (
    *("skewness", "aspect_ratio", "non_orthogonality", "volume"),
    *("jacobian", "volume_ratio", "jacobian_ratio"),
)
SMALL_IS_BAD = ("volume", "jacobian", "volume_ratio", "jacobian_ratio", "pyramid")
"""Measures whose smallest value is the worst; of others the largest one is."""


@runtime_checkable
class Report(Protocol):
    """Judges cells by measures: `QualityReport` by the cells' corners, `FaceQuality` by faces.

    - `rule`: by what a cell is inverted.
    - `is_inverted`, `counted`: masks (k,) of inverted cells, and of cells that count; `count` is
      the number of these.
    - `volume`, `centroid`: how large the cells are (k,), and where (k, d).
    - `min`, `mean`, `max`: a measure over the cells that count, by its name; the mean is weighted
      by volume.
    - `worst`: ids of the worst cells by a measure; without one, inverted cells come first.
    """

    rule: ClassVar[str]

    @property
    def is_inverted(self) -> Any: ...
    @property
    def volume(self) -> Any: ...
    @property
    def centroid(self) -> Any: ...
    @property
    def counted(self) -> Bool[np.ndarray, " k"]: ...
    @property
    def count(self) -> int: ...
    def min(self, name: str) -> Any: ...
    def mean(self, name: str) -> Any: ...
    def max(self, name: str) -> Any: ...
    def worst(self, k: int = 5, *, by: str | None = None) -> np.ndarray: ...


def ranked(values: Any, by: str, counted: np.ndarray, k: int, first: np.ndarray | None = None) -> np.ndarray:
    """Lists the `k` worst counting cells by a measure, worst first; NaN is worst.

    Cells marked by `first` come before all others.
    """
    badness = np.asarray(values, dtype=float) * (-1.0 if by in SMALL_IS_BAD else 1.0)
    badness = np.where(np.isnan(badness), np.inf, badness)
    ids = np.flatnonzero(counted)
    early = np.zeros(len(ids), dtype=bool) if first is None else np.asarray(first)[ids]
    if 0 < k < len(ids):  # only cells that may be among the first k are sorted
        least = np.partition(badness[ids], len(ids) - k)[len(ids) - k]
        near = early | (badness[ids] >= least)
        ids, early = ids[near], early[near]
    return ids[np.lexsort((-badness[ids], ~early))][:k]


def table_of(report: Report, heading: str, names: tuple[str, ...]) -> str:
    """Writes a table of measures: least, mean and largest value, the worst cell and its place."""
    lines = [heading, f"{'':<17}{'min':>10}{'mean':>10}{'max':>10}  {'worst':<8}near"]
    for name in names:
        cell = report.worst(1, by=name)[0]
        numbers = "".join(f"{float(value(name)):>10.3g}" for value in (report.min, report.mean, report.max))
        lines.append(f"{name:<17}{numbers}  {cell:<8}{place_of(report, cell)}")
    return "\n".join(lines)


def check_inverted(report: Report) -> None:
    """Raises `ValueError` where cells are inverted: how many, and where the first one is."""
    bad = np.flatnonzero(np.asarray(report.is_inverted) & report.counted)
    if len(bad):
        are = "cell is" if len(bad) == 1 else "cells are"
        raise ValueError(
            f"{len(bad)} of {report.count} {are} inverted, first cell {bad[0]} near {place_of(report, bad[0])}. "
            "jm.inspect(plan, u, mesh=mesh) looks for what helps."
        )


def place_of(report: Report, cell: int | np.integer) -> str:
    """Writes where a cell is; a coordinate that is small beside the largest one is 0."""
    centroid = np.asarray(report.centroid[cell], dtype=float)
    place = np.where(np.abs(centroid) < 1e-4 * np.abs(centroid).max(), 0.0, centroid)
    return "(" + ", ".join(f"{x:.3g}" for x in place.tolist()) + ")"


class QualityReport(Module):
    """Reports each cell's quality: arrays of one entry a cell, type after type, as `mesh.cells`.

    The cells are k in number. Lengths have the unit of the points, volumes its square or cube.

    - `volume`: signed volume (trilinear cells), in 2-D the signed area, also as `area`. For a
      surface in 3-D the area, without sign. Positive for cells numbered as VTK numbers them.
    - `skewness`: 0 ideal, 1 degenerate. Quad and hexahedron: Verdict's `skew`, the largest |cos| of
      the angle between principal axes. Triangle, tetrahedron, pyramid, wedge: Verdict's
      `equiangle_skew`.
    - `aspect_ratio`: 1 ideal, inf for a flat cell. Triangle, quad, tetrahedron: Verdict's
      `aspect_ratio`; hexahedron its `max_edge_ratio`; pyramid and wedge longest over shortest edge.
    - `jacobian`: the smallest Jacobian at the corners (and at the centre of a hexahedron),
      Verdict's `jacobian`. Of a curved cell it is the smallest found anywhere. Its sign is turned
      for cells that are left-handed on the undeformed mesh: negative where a cell is not convex.
      For a simplex twice its area or six times its volume; at a pyramid the four corners of the
      base.
    - `non_orthogonality`: OpenFOAM's, in degrees: the angle between a face's area vector and the
      line between the centres of its two cells. A cell has the largest angle of its inner faces, 0
      without neighbours.
    - `volume_ratio`: volume over undeformed volume, for a simplex det F of its deformation. 1 where
      that was zero.
    - `jacobian_ratio`: smallest corner Jacobian over its initial value, at the corners that had the
      sign of their cell on the undeformed mesh and were not flat there. 1 where none had.
    - `is_inverted`: either ratio is not positive; NaN coordinates count as inverted. Without
      `points`, see `quality`.
    - `is_degenerate`: no corner's Jacobian had a sign beyond round-off on the undeformed mesh: the
      cell is not judged. In float32 the round-off of the coordinates hides the sign of the thinnest
      cells at a wall.
    - `centroid`: mean of the corners (k, d): where the cell is.
    - `was_inverted`: the cell's volume had the wrong sign on the undeformed mesh already; False
      without `points`.

    Counts, means and extremes (`inverted`, `mean_skewness`, `max_skewness`, ...) are traced numbers
    over the cells of the highest dimension alone; boundary elements have entries but do not count.
    Means are weighted by area or volume, sum(skewness * area) / area. `str(report)`, `worst` and
    `raise_if_inverted` speak on the host.
    """

    rule: ClassVar[str] = "corner Jacobians"

    volume: Float[Array, " k"]
    skewness: Float[Array, " k"]
    aspect_ratio: Float[Array, " k"]
    jacobian: Float[Array, " k"]
    non_orthogonality: Float[Array, " k"]
    volume_ratio: Float[Array, " k"]
    jacobian_ratio: Float[Array, " k"]
    is_inverted: Bool[Array, " k"]
    is_degenerate: Bool[Array, " k"]
    centroid: Float[Array, "k d"]
    types: tuple[tuple[str, int], ...] = eqx.field(static=True)
    relative: bool = eqx.field(static=True, default=True)
    was_inverted: Bool[Array, " k"] | None = None

    @property
    def area(self) -> Float[Array, "*batch k"]:
        """Area of each cell: `volume`, by the name that it has in 2-D."""
        return self.volume

    @property
    def inverted(self) -> Int[Array, "..."]:
        """Number of inverted cells."""
        return self._over_cells(lambda xp, flags: xp.sum(flags, axis=-1), self.is_inverted)

    @property
    def from_start(self) -> Int[Array, "..."]:
        """Number of inverted cells that were folded on the undeformed mesh already."""
        was = jnp.zeros_like(self.is_inverted) if self.was_inverted is None else self.was_inverted
        return self._over_cells(lambda xp, flags, was: xp.sum(flags & was, axis=-1), self.is_inverted, was)

    @property
    def degenerate(self) -> Int[Array, "..."]:
        """Number of cells that had no sign from the start and are not judged."""
        return self._over_cells(lambda xp, flags: xp.sum(flags, axis=-1), self.is_degenerate)

    @checked
    def mean(self, name: str, *, weighted: bool = True) -> Float[Array, "..."]:
        """Averages the measure `name` over cells, weighted by size unless `weighted` is False."""
        if weighted:
            return self._over_cells(_weighted_mean, self._measure(name), self.volume)
        return self._over_cells(lambda xp, values: xp.mean(values, axis=-1), self._measure(name))

    @checked
    def max(self, name: str) -> Float[Array, "..."]:
        """Returns the largest value of the measure called `name`."""
        return self._over_cells(lambda xp, values: largest(values, axis=-1), self._measure(name))

    @checked
    def min(self, name: str) -> Float[Array, "..."]:
        """Returns the smallest value of the measure called `name`."""
        return self._over_cells(lambda xp, values: smallest(values, axis=-1), self._measure(name))

    @property
    def mean_skewness(self) -> Float[Array, "..."]:
        return self.mean("skewness")

    @property
    def max_skewness(self) -> Float[Array, "..."]:
        return self.max("skewness")

    @property
    def mean_aspect_ratio(self) -> Float[Array, "..."]:
        return self.mean("aspect_ratio")

    @property
    def max_aspect_ratio(self) -> Float[Array, "..."]:
        return self.max("aspect_ratio")

    @property
    def mean_non_orthogonality(self) -> Float[Array, "..."]:
        return self.mean("non_orthogonality")

    @property
    def max_non_orthogonality(self) -> Float[Array, "..."]:
        return self.max("non_orthogonality")

    @property
    def min_volume(self) -> Float[Array, "..."]:
        return self.min("volume")

    @property
    def min_jacobian(self) -> Float[Array, "..."]:
        return self.min("jacobian")

    @property
    def min_volume_ratio(self) -> Float[Array, "..."]:
        return self.min("volume_ratio")

    @property
    def min_jacobian_ratio(self) -> Float[Array, "..."]:
        return self.min("jacobian_ratio")

    @checked
    def worst(self, k: int = 5, *, by: str | None = None) -> np.ndarray:
        """Lists ids of the worst cells on the host, worst first, at `report.centroid[ids]`.

        **Arguments:**

        - `k`: how many cells, default 5.
        - `by`: the measure to rank by. By default inverted cells come first, then the most skewed
          ones.

        **Raises:** `ValueError` for a measure that is not known.
        """
        whole("k", k, 0)
        values = self._measure("skewness" if by is None else by)
        return ranked(values, by or "skewness", self.counted, k, None if by else np.asarray(self.is_inverted))

    def raise_if_inverted(self) -> None:
        """Raises `ValueError` on the host for inverted cells: how many, and where the first is.

        It does not work inside `jit`: there `report.inverted` is a value like any other.
        """
        check_inverted(self)

    def __str__(self) -> str:
        if not is_known(self.volume) or self.volume.ndim > 1:
            return repr(self)
        counted = ", ".join(f"{count} {kind}" for kind, count in self._top())
        old = f" ({int(self.from_start)} of them from the start)" if int(self.from_start) else ""
        heading = f"{counted}: {int(self.inverted)} inverted{old}, {int(self.degenerate)} degenerate from the start"
        return table_of(self, heading, MEASURES if self.relative else MEASURES[:-2])

    def _measure(self, name: str) -> Float[Array, "*batch k"]:
        if name not in MEASURES:
            raise ValueError(f"no measure is called {name!r}; there are {', '.join(MEASURES)}.")
        return getattr(self, name)

    def _top(self) -> list[tuple[str, int]]:
        highest = max(DIMENSION[kind] for kind, count in self.types if count)
        return [(kind, count) for kind, count in self.types if DIMENSION[kind] == highest]

    @property
    def counted(self) -> Bool[np.ndarray, " k"]:
        """Marks cells that count, on the host: highest dimension, no boundary elements."""
        top = {kind for kind, _ in self._top()}
        return np.concatenate([np.full(count, kind in top) for kind, count in self.types])

    @property
    def count(self) -> int:
        """Number of cells that count."""
        return sum(count for _, count in self._top())

    def _over_cells(self, reduce: Callable, *values: Either) -> Array:
        """Reduces values over counting cells, the last axis; readable ones by NumPy, uncompiled."""
        mask = self.counted
        known = on_host(values)
        values = tuple(np.asarray(row) for row in values) if known else values
        counted = values if mask.all() else [row[..., np.flatnonzero(mask)] for row in values]
        return array(reduce(np if known else jnp, *counted))


def _weighted_mean(xp: Any, values: Either, volume: Either) -> Either | np.generic:
    """Averages by volume; infinite values give infinity, but for cells without volume."""
    weight, infinite = xp.abs(volume), xp.isinf(values)
    total = xp.sum(weight, axis=-1)
    # a product with an infinite value, or with one that does not count, would have a derivative by
    # the volume
    mean = xp.sum(xp.where(infinite | (weight == 0), 0, values) * weight, axis=-1) / xp.where(total == 0, 1, total)
    return xp.where(xp.any(infinite & (weight > 0), axis=-1), xp.inf, mean)
