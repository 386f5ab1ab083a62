"""Sources on one boundary whose spacing follows the distance of the other boundary."""

import dataclasses

import numpy as np

from ..package.arguments import between, whole
from ..package.rounding import nearest_of, spacing
from ..package.trees import Tree
from .farthest import farthest
from .reduction import AbstractSeparated, chosen_in_order

SHARE = {2: 0.25, 3: 0.5}
"""Default `share` by dimension: a distant circle gets 16 sources, a sphere about 30."""


@dataclasses.dataclass(frozen=True)
class Graded(AbstractSeparated):
    """Chooses points so that sources are dense where the other boundary is near.

    The distance of every point from a source is at most `share` of its distance from the other
    boundary. It is made for the fixed boundary. Where the moving boundary is near, the field must
    vanish within the gap, and few sources would leave it wavy. A far field needs a few dozen
    sources at most, however fine its mesh.

    The distance is measured to the nearest source of the other boundary. It is at least the
    distance of that source from its own nearest source: where boundaries touch, the spacing changes
    gradually. Without another boundary it is the diagonal of all points.

    A fixed wall whose distance is larger than its length, a body for example, may come near later.
    It gets its sources as if there were no other boundary, at most 512 on all such walls. Walls are
    found by the faces of the mesh.

    **Arguments:**

    - `share`: relative, above 0; 0.25 in 2-D and 0.5 in 3-D by default.
    - `most`: most sources; the most needed sources come first; 512 by default.
    - `separation`: least distance between sources, relative to the diagonal of all points, from 0
      to 1; 1e-3 by default.

    **Raises:** `ValueError` for values that are not in these ranges.
    """

    share: float | None = None
    _: dataclasses.KW_ONLY
    most: int = 512
    separation: float = 1e-3

    most_on_far_walls = 512

    def __post_init__(self):
        if self.share is not None:
            between("share", self.share, 0)
        whole("most", self.most)
        between("separation", self.separation, 0, 1, "[)")

    def _chosen(self, points: np.ndarray, order: np.ndarray) -> np.ndarray:
        return self._near(points, points[:0])

    def beside(self, points: np.ndarray, others: np.ndarray) -> np.ndarray:
        return chosen_in_order(points, lambda points, order: self._near(points, others))

    def _near(self, points: np.ndarray, others: np.ndarray) -> np.ndarray:
        share = SHARE[points.shape[1]] if self.share is None else self.share
        return farthest(points, self.most, self.closest(points), reach=share * _room(points, others))


def _room(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Measures distances (n,) from the nearest of the `others`, at least their spacing there."""
    if len(others) == 0:
        return np.full(len(points), float(np.linalg.norm(np.ptp(points, axis=0))) or 1.0)
    distance = np.asarray(Tree(others).query(points)[0])
    if len(others) == 1:
        return np.maximum(distance, 1e-12 * distance.max())
    return np.maximum(distance, nearest_of(points, others, spacing(others)))
