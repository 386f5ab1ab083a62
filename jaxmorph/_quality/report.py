"""Reports on cells: the base class, and the report of `quality`."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._host.cells.topology import DIMENSION
from .._host.package.arguments import whole
from .._kernels.module import Module
from .._kernels.values import Either, array, is_known, largest, on_host, smallest

CellValues = Float[Array, " k"]
CellMarks = Bool[Array, " k"]

MEASURES = (
    "skewness",
    "aspect_ratio",
    "non_orthogonality",
    "volume",
    "jacobian",
    "volume_ratio",
    "jacobian_ratio",
)
SMALL_IS_BAD = (
    "volume",
    "jacobian",
    "volume_ratio",
    "jacobian_ratio",
    "pyramid",
    "margin",
    "lower",
    "upper",
    "_least",
)
"""Measures whose smallest value is the worst; of others the largest one is."""


class Report:
    """The base of `QualityReport`, `FaceQuality` and `Proof`: cells, judged by measures.

    A subclass has the masks `is_inverted` and `counted` (k,), of cells that count, `volume` (k,),
    `centroid` (k, d) and the arrays (k,) that `measures` names. A cell is inverted by the `rule`;
    `worst` ranks by the measure `rank`, after `_levels`.
    """

    rule: str
    measures: tuple[str, ...]
    rank: str
    degenerate: Any = 0
    is_inverted: Any
    volume: Any
    centroid: Any
    counted: Any

    @property
    def count(self) -> int:
        """Number of cells that count."""
        return int(np.count_nonzero(self.counted))

    @property
    def is_spoilt(self) -> Any:
        """Mask of the cells that are blamed on a motion; of a mesh by itself, on the mesh."""
        return self.is_inverted

    @property
    def inverted(self) -> Any:
        """Number of inverted cells."""
        return self._over_cells(_add_flags, self.is_inverted)

    def min(self, name: str) -> Any:
        """Returns the smallest value of the measure called `name`."""
        return self._over_cells(lambda xp, values: smallest(values, axis=-1), self._measure(name))

    def max(self, name: str) -> Any:
        """Returns the largest value of the measure called `name`."""
        return self._over_cells(lambda xp, values: largest(values, axis=-1), self._measure(name))

    def mean(self, name: str, *, weighted: bool = True) -> Any:
        """Averages the measure `name` over cells, weighted by size unless `weighted` is False."""
        if weighted:
            return self._over_cells(_weighted_mean, self._measure(name), self.volume)
        return self._over_cells(lambda xp, values: xp.mean(values, axis=-1), self._measure(name))

    def worst(self, k: int = 5, *, by: str | None = None) -> np.ndarray:
        """Lists ids of the `k` worst cells on the host, the worst first.

        They are ranked by the measure `by`. By default inverted cells come first. Cells alike are
        then ranked by skewness, faces' smallest pyramid, or the margin of a `Proof`.

        **Raises:** `ValueError` for an unknown measure, and a `k` that is negative or no whole
        number.
        """
        whole("k", k, 0)
        ids = np.flatnonzero(self.counted)
        has_levels = by is None
        name = self.rank if by is None else by
        values = np.asarray(
            getattr(self, name) if has_levels else self._measure(name), dtype=float
        )[ids]
        badness = np.where(np.isnan(values), np.inf, -values if name in SMALL_IS_BAD else values)
        levels = self._levels[ids].astype(int) if has_levels else np.zeros(len(ids), dtype=int)
        if 0 < k < len(ids):  # only cells that may be among the first k are sorted
            near = (levels < levels.max()) | (
                badness >= np.partition(badness, len(ids) - k)[len(ids) - k]
            )
            ids = ids[near]
            badness = badness[near]
            levels = levels[near]
        return ids[np.lexsort((-badness, levels))][:k]

    @property
    def _levels(self) -> np.ndarray:
        """Ranks of cells (k,) that come before all measures, the worst 0."""
        return ~np.asarray(self.is_inverted)

    def raise_if_inverted(self) -> None:
        """Raises `ValueError` on the host for cells of `is_spoilt`: how many, where the first is.
        Inside `jit` it does not work: there the mask is a value like any other.
        """
        bad = np.flatnonzero(np.asarray(self.is_spoilt) & self.counted)
        if len(bad):
            are = "cell is" if len(bad) == 1 else "cells are"
            raise ValueError(
                f"{len(bad)} of {self.count} {are} inverted, first cell {bad[0]} near "
                f"{place_of_cell(self, bad[0])}. "
                "jm.inspect(plan, u, mesh=mesh) looks for what helps."
            )

    def _measure(self, name: str) -> Any:
        if name not in self.measures:
            raise ValueError(
                f"no measure is called {name!r}; there are {', '.join(self.measures)}."
            )
        return getattr(self, name)

    def _over_cells(self, reduce: Callable, *values: Any) -> Any:
        return reduce(np, *(row[self.counted] for row in values)).item()

    def _table(self, heading: str, names: tuple[str, ...]) -> str:
        lines = [heading, f"{'':<17}{'min':>10}{'mean':>10}{'max':>10}  {'worst':<8}near"]
        for name in names:
            cell = self.worst(1, by=name)[0]
            numbers = "".join(
                f"{float(value(name)):>10.3g}" for value in (self.min, self.mean, self.max)
            )
            lines.append(f"{name:<17}{numbers}  {cell:<8}{place_of_cell(self, cell)}")
        return "\n".join(lines)


def place_of_cell(report: Report, cell: int | np.integer) -> str:
    """Writes where a cell is; a coordinate that is small beside the largest one is 0."""
    centroid = np.asarray(report.centroid[cell], dtype=float)
    place = np.where(np.abs(centroid) < 1e-4 * np.abs(centroid).max(), 0.0, centroid)
    return "(" + ", ".join(f"{x:.3g}" for x in place.tolist()) + ")"


def _reduce_by(reduction: str, name: str) -> Any:
    return property(lambda report: getattr(report, reduction)(name))


class QualityReport(Report, Module):
    """Reports each cell's quality: arrays (k,), one type of cells after another, as `mesh.cells`.

    Lengths have the unit of the points, volumes its square or cube.

    - `volume`: signed volume (trilinear cells), in 2-D the signed area, also as `area`. For a
      surface in 3-D the area, without sign. Positive for cells numbered as VTK numbers them.
    - `skewness`: 0 ideal, 1 degenerate. Quad and hexahedron: Verdict's `skew`, the largest |cos| of
      the angle between principal axes. Others: Verdict's `equiangle_skew`.
    - `aspect_ratio`: 1 ideal, inf for a flat cell. Triangle, quad, tetrahedron: Verdict's
      `aspect_ratio`; hexahedron its `max_edge_ratio`; pyramid and wedge longest over shortest edge.
    - `jacobian`: the smallest Jacobian at the corners (and at the centre of a hexahedron),
      Verdict's `jacobian`; of a curved cell the smallest found anywhere. Negative where a cell is
      not convex: its sign is turned for cells that are left-handed on the undeformed mesh. For a
      simplex twice its area or six times its volume; at a pyramid the four corners of the base.
    - `non_orthogonality`: OpenFOAM's, in degrees: the largest angle at an inner face between its
      area vector and the line between the centres of its two cells; 0 without neighbours.
    - `volume_ratio`: volume over undeformed volume, for a simplex det F of its deformation. 1 where
      that was zero.
    - `jacobian_ratio`: smallest corner Jacobian over its initial value, at the corners that had the
      sign of their cell on the undeformed mesh and were not flat there. 1 where none had.
    - `is_inverted`: either ratio is not positive; NaN coordinates count as inverted. Without
      `points`, see `quality`.
    - `is_degenerate`: no corner's Jacobian had a sign beyond round-off on the undeformed mesh, so
      the cell is not judged. In float32 these may be the thinnest cells at a wall.
    - `centroid`: mean of the corners (k, d): where the cell is.
    - `was_inverted`: the undeformed mesh by itself has the cell inverted; False without `points`.
    - `is_folded`: inverted; of a cell that `was_inverted`, until it is sound by itself.
    - `is_spoilt`: inverted, and not before the motion. Without `points` inverted, or flat: no
      corner's Jacobian is beyond round-off.
    - `degenerate`, `from_start`: numbers of such cells, and of inverted cells that were so before.

    Counts, means and extremes (`inverted`, `mean_skewness`, `max_skewness`, ...) are traced numbers
    over the cells of the highest dimension alone; boundary elements do not count. Means are
    weighted by area or volume. `str(report)`, `worst` and `raise_if_inverted` speak on the host.
    """

    rule = "corner Jacobians"
    measures = MEASURES
    rank = "skewness"

    volume: CellValues
    skewness: CellValues
    aspect_ratio: CellValues
    jacobian: CellValues
    non_orthogonality: CellValues
    volume_ratio: CellValues
    jacobian_ratio: CellValues
    is_inverted: CellMarks
    is_degenerate: CellMarks
    centroid: Float[Array, "k d"]
    was_inverted: CellMarks
    is_folded: CellMarks
    types: tuple[tuple[str, int], ...] = eqx.field(static=True)
    relative: bool = eqx.field(static=True, default=True)

    @property
    def area(self) -> Float[Array, "..."]:
        return self.volume

    @property
    def degenerate(self) -> Array:
        return self._over_cells(_add_flags, self.is_degenerate)

    @property
    def is_spoilt(self) -> CellMarks:
        marks = self.is_inverted, self.was_inverted, self.is_degenerate
        now, before, flat = map(np.asarray, marks) if on_host(marks) else marks
        return array(now & ~before if self.relative else now | flat)

    @property
    def from_start(self) -> Int[Array, "..."]:
        both = lambda xp, now, before: _add_flags(xp, now & before)  # noqa: E731
        return self._over_cells(both, self.is_inverted, self.was_inverted)

    mean_skewness = _reduce_by("mean", "skewness")
    max_skewness = _reduce_by("max", "skewness")
    mean_aspect_ratio = _reduce_by("mean", "aspect_ratio")
    max_aspect_ratio = _reduce_by("max", "aspect_ratio")
    mean_non_orthogonality = _reduce_by("mean", "non_orthogonality")
    max_non_orthogonality = _reduce_by("max", "non_orthogonality")
    min_volume = _reduce_by("min", "volume")
    min_jacobian = _reduce_by("min", "jacobian")
    min_volume_ratio = _reduce_by("min", "volume_ratio")
    min_jacobian_ratio = _reduce_by("min", "jacobian_ratio")

    def __str__(self) -> str:
        if not is_known(self.volume) or self.volume.ndim > 1:
            return repr(self)
        counted = ", ".join(f"{count} {kind}" for kind, count in self._top())
        old = f" ({int(self.from_start)} of them from the start)" if int(self.from_start) else ""
        heading = (
            f"{counted}: {int(self.inverted)} inverted{old}, {int(self.degenerate)} degenerate "
            "from the start"
        )
        return self._table(heading, MEASURES if self.relative else MEASURES[:-2])

    def _top(self) -> list[tuple[str, int]]:
        highest = max(DIMENSION[kind] for kind, count in self.types if count)
        return [(kind, count) for kind, count in self.types if DIMENSION[kind] == highest]

    @property
    def counted(self) -> Bool[np.ndarray, " k"]:
        """Marks cells that count, on the host: highest dimension, no boundary elements."""
        top = {kind for kind, _ in self._top()}
        return np.concatenate([np.full(count, kind in top) for kind, count in self.types])

    def _over_cells(self, reduce: Callable, *values: Either) -> Array:
        """Reduces values over counting cells, the last axis; readable ones by NumPy, uncompiled."""
        mask = self.counted
        known = on_host(values)
        values = tuple(np.asarray(row) for row in values) if known else values
        counted = values if mask.all() else [row[..., np.flatnonzero(mask)] for row in values]
        return array(reduce(np if known else jnp, *counted))


def _add_flags(xp: Any, flags: Either) -> Any:
    return xp.sum(flags, axis=-1)


def _weighted_mean(xp: Any, values: Either, volume: Either) -> Either | np.generic:
    """Averages by volume; infinite values give infinity, but for cells without volume."""
    weight = xp.abs(volume)
    infinite = xp.isinf(values)
    total = xp.sum(weight, axis=-1)
    # else a product with a value that does not count would have a derivative by the volume
    mean = xp.sum(xp.where(infinite | (weight == 0), 0, values) * weight, axis=-1) / xp.where(
        total == 0, 1, total
    )
    return xp.where(xp.any(infinite & (weight > 0), axis=-1), xp.inf, mean)
