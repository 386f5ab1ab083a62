"""Sources by the power function: the largest interpolation error at a point (De Marchi 2005)."""

import dataclasses

import numpy as np

from ..package.arguments import between, check_fields, whole
from ..package.rounding import SAME, first_largest
from .reduction import AbstractSeparated

NOISE = 1e-13
"""Round-off of the power function, whose largest value is 1."""


@dataclasses.dataclass(frozen=True)
class PGreedy(AbstractSeparated):
    """Chooses points one by one, each where the power function of the chosen points is largest.

    The method is that of De Marchi, Schaback and Wendland (Advances in Computational Mathematics
    23, 2005). It depends on places alone, not on a motion. The basis is Wendland's C2 with a radius
    as large as the extent of the points. The factors grow by one column a point (Newton's basis).

    **Arguments:**

    - `count`: number of points; fewer if `separation` leaves no more.
    - `separation`: the least distance between two sources, as a share of the diagonal of all
      points, from 0 to 1. Default 1e-3.

    **Raises:** `ValueError` for a count below 1, and a separation that is not from 0 to 1.
    """

    count: int
    _: dataclasses.KW_ONLY
    separation: float = 1e-3

    def __post_init__(self):
        whole("count", self.count)
        check_fields(self)
        between("separation", self.separation, 0, 1, "[)")

    def _chosen(self, points: np.ndarray, order: np.ndarray) -> np.ndarray:
        radius = float(np.linalg.norm(np.ptp(points, axis=0))) or 1.0
        count, closest = min(self.count, len(points)), self.closest(points)
        basis, power, chosen = np.zeros((count, len(points))), np.ones(len(points)), []
        node = first_largest(((points - points.mean(axis=0)) ** 2).sum(axis=1))
        while len(chosen) < count and power[node] > 1e-14:
            k = len(chosen)
            distance = np.sqrt(((points - points[node]) ** 2).sum(axis=1))
            xi = np.minimum(distance / radius, 1)
            column = (1 - xi) ** 4 * (4 * xi + 1) - basis[:k, node] @ basis[:k]
            basis[k] = column / np.sqrt(power[node])
            power = np.where(distance <= closest * (1 + SAME), 0, np.maximum(power - basis[k] ** 2, 0))
            chosen.append(node)
            node = first_largest(power, SAME * power.max() + NOISE)
        return np.array(chosen)
