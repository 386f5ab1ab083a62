"""Sources on one boundary as close to each other as the other boundary is near."""

import dataclasses

import numpy as np

from ..package.arguments import between, whole
from ..package.cores import Tree
from ..package.rounding import nearest_of
from .farthest import farthest
from .reduction import AbstractReduction, check_separation, chosen_in_order, least_distance

SHARE = {2: 0.25, 3: 0.5}
"""A circle far away gets 16 sources, a sphere about 30."""


@dataclasses.dataclass(frozen=True)
class Graded(AbstractReduction):
    """Chooses points so that none is farther from a source than `share` times its distance from the other boundary.

    It is made for the fixed boundary. Where the moving one is near, the field must vanish within the gap, and few sources
    leave it wavy there. A far field needs a few dozen sources at most, however fine its mesh.

    The distance is measured to the other boundary's nearest source. It is no less than the distance from that source to its
    own nearest one: where boundaries touch, the spacing changes gradually from one to the other. Without another boundary it
    is the diagonal of all points.

    A fixed wall that is farther away than it is long, a body for example, may be near later. It gets the sources that it would have
    without another boundary; 512 at most on all such walls. The faces of the mesh tell what a wall is.

    **Arguments:**

    - `share`: relative, above 0; 0.25 in 2-D and 0.5 in 3-D by default.
    - `most`: sources at most, the most needed ones first; 512 by default.
    - `separation`: least distance between sources, relative to the diagonal of all points, from 0 to 1; 1e-3 by default.

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
        check_separation(self.separation)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        return self.beside(points, np.zeros((0, np.shape(points)[1])))

    def beside(self, points: np.ndarray, others: np.ndarray) -> np.ndarray:
        def chosen(points, order):
            share = SHARE[points.shape[1]] if self.share is None else self.share
            return farthest(points, self.most, self.closest(points), reach=share * _room(points, others))

        return chosen_in_order(points, chosen)

    def closest(self, points: np.ndarray) -> float:
        return least_distance(points, self.separation)


def _room(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Measures each point's distance from the nearest of the `others`.

    The distance is at least that nearest point's own distance from its nearest neighbour.
    """
    if len(others) == 0:
        return np.full(len(points), float(np.linalg.norm(np.ptp(points, axis=0))) or 1.0)
    tree = Tree(others)
    distance = np.asarray(tree.query(points)[0])
    if len(others) == 1:
        return np.maximum(distance, 1e-12 * distance.max())
    spacing = np.asarray(tree.query(others, k=2)[0])[:, 1]
    return np.maximum(distance, nearest_of(points, others, spacing))
