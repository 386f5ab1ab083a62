"""Greedy reduction: sources where interpolation is worst, one by one (Rendall and Allen 2009)."""

import dataclasses

import numpy as np
from numpy import ndarray
from scipy.spatial.distance import cdist
from scipy.special import xlogy

from ..linear.products import row_lengths
from ..package.arguments import between, finite_array, whole
from ..package.rounding import extent_of, first_largest
from ..tolerances import SAME
from .farthest import farthest
from .reduction import AbstractSeparated


@dataclasses.dataclass(frozen=True, eq=False)
class Greedy(AbstractSeparated):
    """Chooses sources one after the other, always where a source is needed most.

    The next source is the point where a thin plate spline through the chosen sources misses the
    `motions` by most (Rendall and Allen, Journal of Computational Physics 228, 2009). Without
    motions it chooses as `FarthestPoints` does. It costs the host sources^3 operations.

    **Arguments:**

    - `sources`: number of points, at least 1.
    - `motions`: typical displacements (k, m, d) of the m points, such as modes. Default None.
    - `tolerance`: the largest miss, relative to the largest displacement, at which it ends early.
      Default 0, which is 1e-9.
    - `group`: number of sources in one round, relative to the chosen ones; with 0, one by one.
      Default 1/8.
    - `separation`: the least distance between two sources, relative to the diagonal of all points.
      Default 1e-3.

    **Raises:** `ValueError` for fewer than one source, and for another number of points than the
    motions have.
    """

    sources: int
    motions: ndarray | None = None
    _: dataclasses.KW_ONLY
    tolerance: float = 0.0
    group: float = 0.125
    separation: float = 1e-3

    def __post_init__(self):
        whole("sources", self.sources)
        if self.motions is not None:
            finite_array("motions", self.motions, (None, None, None))
        between("tolerance", self.tolerance, 0, ends="[)")
        between("group", self.group, 0, 1, "[]")
        between("separation", self.separation, 0, 1, "[)")

    def _chosen(self, points: ndarray, order: ndarray) -> ndarray:
        closest = self.closest(points)
        if self.motions is None:
            return farthest(points, self.sources, closest)
        motions = np.asarray(self.motions, dtype=float)
        if motions.shape[1:] != points.shape:
            raise ValueError(
                f"`motions` has shape {motions.shape}, but there are {len(points)} points in "
                f"{points.shape[1]} dimensions."
            )
        values = np.concatenate(list(motions[:, order]), axis=1)
        return _by_error(points, values, self.sources, closest, self.tolerance, self.group)


def _by_error(
    points: ndarray,
    values: ndarray,
    count: int,
    closest: float,
    tolerance: float,
    group: float,
) -> ndarray:
    """Picks points where interpolation of `values` (m, k d) misses most, a `group` in a round."""
    unit = (points - points.mean(axis=0)) / (extent_of(points) or 1.0)
    tail = np.concatenate([np.ones((len(unit), 1)), unit], axis=1)
    chosen = farthest(points, min(count, points.shape[1] + 1), closest)
    kernel = _kernel(unit, unit[chosen])
    distance = np.min([row_lengths(points - points[i]) for i in chosen], axis=0)
    closest = closest * (1 + SAME)
    slack = SAME * np.abs(values).max()
    least = max(tolerance * np.abs(values).max(), slack)
    while len(chosen) < count:
        missed = _measure_misses(kernel, tail, chosen, values)
        missed[distance <= closest] = 0
        if missed.max() <= least:
            break
        added = []
        for _ in range(min(1 + int(group * len(chosen)), count - len(chosen))):
            worst = first_largest(missed, slack)
            if missed[worst] <= least:
                break
            added.append(worst)
            away = row_lengths(points - points[worst])
            # without the part that this source will mend
            missed = missed * np.minimum(away / distance[worst], 1)
            distance = np.minimum(distance, away)
            missed[distance <= closest] = 0
        chosen = np.concatenate([chosen, added])
        kernel = np.concatenate([kernel, _kernel(unit, unit[added])], axis=1)
    return chosen


def _measure_misses(kernel: ndarray, tail: ndarray, chosen: ndarray, values: ndarray) -> ndarray:
    """The largest miss (m,), over all values, of the chosen points' spline (eq. 3)."""
    terms = tail.shape[1]
    matrix = np.block([[kernel[chosen], tail[chosen]], [tail[chosen].T, np.zeros((terms, terms))]])
    rhs = np.concatenate([values[chosen], np.zeros((terms, values.shape[1]))])
    # points in one plane leave the polynomial undetermined
    weights = np.linalg.lstsq(matrix, rhs)[0]
    return np.abs(values - np.concatenate([kernel, tail], axis=1) @ weights).max(axis=1)


def _kernel(points: ndarray, sources: ndarray) -> ndarray:
    squared = cdist(points, sources, "sqeuclidean")
    return 0.5 * xlogy(squared, squared)
