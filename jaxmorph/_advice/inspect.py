"""Checks of a surface displacement before the mesh is moved."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.spatial
from jaxtyping import ArrayLike, Real

from .._host.errors import MeshError
from .._plan.plan import Plan
from .overshoot import overshoot


@dataclasses.dataclass(frozen=True)
class Inspection:
    """Holds the findings of `inspect`, lengths in the mesh's units.

    - `offset`: the largest displacement that the correction has to carry (eq. 5; 0 for a method without one).
    - `offset_node`: the node with that offset.
    - `offset_ratio`: the largest ratio of a node's offset to the distance of its nearest mesh node.
    - `contradictions`: pairs (k, 2) of neighbouring surface nodes that are torn apart, the worst first.
    - `near`: where the worst pair lies (d,). `warnings` says so in words.
    - `overshoot`: the largest motion of a node off the surface over the largest one of the surface.
    - `overshoot_behind`: the same behind a thin body's part that rests while its other side moves (below an airfoil
      with a bump on its upper side).
    """

    offset: float
    offset_node: int
    offset_ratio: float
    contradictions: np.ndarray
    near: np.ndarray
    overshoot: float
    overshoot_behind: float

    @property
    def warnings(self) -> tuple[str, ...]:
        """One sentence for each thing that no method moves well."""
        if not len(self.contradictions):
            return ()
        first, second = self.contradictions[0]
        place = ", ".join(f"{x:.4g}" for x in self.near)
        return (
            f"{len(self.contradictions)} pairs of neighbouring surface nodes are torn apart by more than their distance, the worst "
            f"nodes {first} and {second} near ({place}). If a boundary slides along the moving one, make it a symmetry plane.",
        )

    def renumbered(self, ids: np.ndarray) -> "Inspection":
        """Returns the same inspection for a larger mesh, in which node k is node `ids[k]`."""
        ids = np.asarray(ids)
        node, pairs = int(ids[self.offset_node]), ids[self.contradictions]
        return dataclasses.replace(self, offset_node=node, contradictions=pairs)


def inspect(plan: Plan, u: Real[ArrayLike, "m d"] | Sequence[Any]) -> Inspection:
    """Checks a surface displacement on the host, and the motion that the mesh would make.

    Neighbouring surface nodes are contradictory where one moves, the other is fixed and the displacement is larger than
    their distance: a wall slides along a boundary that is held. They are also where both move and their distance more
    than doubles. No method moves such a mesh well.

    **Arguments:**

    - `plan`: what `prepare` returned.
    - `u`: displacements (m, d) of the moving nodes, in the mesh's unit.

    **Returns:** an `Inspection`.

    **Raises:** `ValueError` when the shape of `u` is not (m, d), or a component is not finite.
    """
    offset = np.linalg.norm(np.asarray(plan.offset(u)), axis=1)
    points, nodes = np.asarray(plan.points), np.concatenate([plan.moving, plan.fixed])
    vectors = np.zeros((len(nodes), points.shape[1]), points.dtype)
    vectors[: plan.n_moving] = u
    finite = np.isfinite(vectors).all(axis=1)
    if not finite.all():
        row = int(np.argmin(finite))
        raise MeshError(
            f"{(~finite).sum()} of {plan.n_moving} displacements are not finite, first that of node {{node}} (row {row}).",
            nodes[~finite],
        )
    size = np.asarray(scipy.spatial.KDTree(points).query(points[nodes], k=2)[0])[:, 1]
    worst = int(offset.argmax())
    pairs = _torn(points[nodes], vectors, plan.n_moving)
    torn = nodes[pairs].reshape(-1, 2)
    near = points[torn[0, 0]] if len(torn) else np.full(points.shape[1], np.nan)
    ratio = float((offset / np.where(size > 0, size, np.inf)).max())
    return Inspection(
        float(offset[worst]), int(nodes[worst]), ratio, torn, near, *overshoot(plan, np.asarray(u, dtype=float))
    )


def _torn(points: np.ndarray, vectors: np.ndarray, moves: int) -> np.ndarray:
    """Finds pairs of neighbouring rows whose displacements contradict each other, the worst first."""
    count = min(2 * points.shape[1], len(points) - 1)
    distance, nearest = map(np.asarray, scipy.spatial.KDTree(points).query(points, k=count + 1))
    first, second = np.repeat(np.arange(len(points)), count), nearest[:, 1:].ravel()
    distance = distance[:, 1:].ravel()
    apart = np.linalg.norm((vectors[first] - vectors[second]), axis=1)
    after = np.linalg.norm((points + vectors)[first] - (points + vectors)[second], axis=1)
    mixed = (first < moves) != (second < moves)
    # nodes that nearly coincide are one place by accident: the two sides of a wake, of an interface, of a sharp edge
    scale = 1e-9 * np.ptp(points, axis=0).max()
    excess = np.where(mixed, apart / (distance + scale), (after - distance) / (distance + scale))
    torn = np.flatnonzero((excess > 1) & (distance > scale) & (first < second))
    return np.stack([first, second], axis=1)[torn[np.argsort(-excess[torn], kind="stable")]]
