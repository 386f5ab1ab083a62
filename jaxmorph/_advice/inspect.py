"""Checks of a surface displacement before the mesh is moved."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import ArrayLike, Integer, Real

from .._host.package.arguments import checked, rows_of
from .._host.package.cores import Tree
from .._host.package.errors import MeshError
from .._host.surface.gaps import share_left
from .._host.surface.skin import edges
from .._host.surface.walls import walls
from .._mesh.mesh import Mesh
from .._methods.rbf.fitted import FittedRBF
from .._plan.judge import ended, ends
from .._plan.plan import Plan
from .collisions import Crossings, crossings_of, names_of, simplices
from .overshoot import overshoot
from .resolved import UNRESOLVED, leaves_enough, missed
from .torn import remedies, share_faces, torn_pairs

PUT_BACK = 0.01
"""Share of the largest motion by which planes, surfaces and pairs may change a moving node's."""

STEEP = 0.5
"""Slope of a displacement along the wall from which on a fitted field strains cells noticeably more."""


TOUCHING = 1e-9
"""Distance of a node from another wall, relative to the surface's extent, at which there is no gap."""

NARROW = 0.2
"""Share of a gap, left after a motion, below which one step folds cells in it."""


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
    - `slope`: how steeply the displacement changes along the wall, per length and without its affine part: that of the
      steepest edges but 2 %.
    - `is_fitted`: whether the coarse field is a `FittedRBF`, as in `prepare`'s default.
    - `crossings`: where moved walls cross another boundary or themselves; None where `inspect` was given no mesh.
    - `put_back`: moving nodes (k,) that do not go where `u` sends them, the worst first. Their plane, surface or pair
      changes the motion by more than a hundredth of the largest one.
    - `put_back_by`: the largest of these changes.
    - `ended`: sliding nodes (k,) that come to the end of their surface.
    - `ended_at`: where these are then (k, d).
    - `gap_left`: the share of its gap to another wall that is left to the node that loses most of it. It is 1 and more if no
      gap becomes smaller, as of walls that slide along each other; None without a mesh, and of one wall alone.
    - `gap_node`: that node.
    - `largest`: the largest displacement of a moving node.
    - `reach`: how far from the surface a field of compact support reaches, `CompactRBF`; infinity for other methods.
    - `torn`: the patches of the worst pair's two nodes, "" for none; empty without a mesh, and without such a pair.
    - `rests` (k,): whether one node of each pair is fixed while the other one moves.
    - `missed`: what an interpolation from the moving sources misses of the displacement in 3-D, relative to the largest one.
    - `leaves`: leaves of a `KDTree` whose sources miss less than a third of it; None where that is so already, or nowhere.
    - `touches` (k,): whether the boundaries of these two nodes have faces in common there. Without a mesh: `rests`.
    """

    offset: float
    offset_node: int
    offset_ratio: float
    contradictions: np.ndarray
    near: np.ndarray
    overshoot: float
    overshoot_behind: float
    slope: float
    is_fitted: bool
    crossings: Crossings | None = None
    put_back: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=int))
    put_back_by: float = 0.0
    ended: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=int))
    ended_at: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((0, 3)))
    gap_left: float | None = None
    gap_node: int | None = None
    largest: float = 0.0
    reach: float = math.inf
    torn: tuple[str, ...] = ()
    rests: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=bool))
    touches: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=bool))
    missed: float = 0.0
    leaves: int | None = None

    @property
    def warnings(self) -> tuple[str, ...]:
        """One sentence for each thing that no method moves well."""
        crossings = (str(self.crossings),) if self.crossings else ()
        return (*self._contradicting, *crossings, *self._kept, *filter(None, [ends(self.ended, self.ended_at)]))

    @property
    def _kept(self) -> tuple[str, ...]:
        if not len(self.put_back):
            return ()
        return (
            f"{len(self.put_back)} moving nodes do not go where `u` sends them, the worst is node {self.put_back[0]}, by "
            f"{self.put_back_by:.3g}: they stay on their plane or surface, and pairs take the mean. Give a motion that does.",
        )

    @property
    def _contradicting(self) -> tuple[str, ...]:
        if not len(self.contradictions):
            return ()
        first, second = self.contradictions[0]
        place = ", ".join(f"{x:.4g}" for x in self.near)
        both = " and ".join(repr(name) if name else "no patch" for name in self.torn)
        return (
            f"{len(self.contradictions)} pairs of neighbouring surface nodes are torn apart by more than their distance, the worst "
            f"nodes {first} and {second}{f' of {both}' if both else ''} near ({place}). {remedies(self.rests, self.touches)}",
        )

    @property
    def advice(self) -> tuple[str, ...]:
        """One sentence for another method, or for more steps, that may do better."""
        return (*self._narrow, *self._short, *self._unresolved, *self._steep)

    @property
    def _unresolved(self) -> tuple[str, ...]:
        if self.leaves is None:
            return ()
        return (
            f"the sources do not resolve the displacement: between them {100 * self.missed:.0f} % of it is missed. Take "
            f"SurfaceReconstruction(FittedRBF(RBF(reduction=KDTree({self.leaves}, extremes=True)))).",
        )

    @property
    def _short(self) -> tuple[str, ...]:
        if self.reach >= self.largest:
            return ()
        return (
            f"the field ends {self.reach:.2g} from the surface, which moves by {self.largest:.2g}: cells fold between. Take a "
            "radius of several times the motion, `jm.CompactRBF(radius)`, or a method without one.",
        )

    @property
    def _narrow(self) -> tuple[str, ...]:
        if self.gap_left is None or self.gap_left >= NARROW:
            return ()
        return (
            f"{100 * self.gap_left:.2g} % of the gap between node {self.gap_node} and another wall is left. Go there in several "
            "steps, each of which leaves half of it or more: `march(plan, path, rebuild=True)`.",
        )

    @property
    def _steep(self) -> tuple[str, ...]:
        if not self.is_fitted or self.slope <= STEEP:
            return ()
        return (
            f"the displacement changes by {self.slope:.2g} per length along the wall. The fitted field keeps grid lines close to "
            "their angle to the wall, and may cost a quarter of the smallest Jacobian ratio where that is above 0.5. "
            "SurfaceReconstruction(RBF(reduction=KDTree(64, extremes=True))) does without; `choose` tries both.",
        )

    def renumbered(self, ids: np.ndarray) -> "Inspection":
        """Renumbers the inspection for a larger mesh, in which node k is node `ids[k]`."""
        ids = np.asarray(ids)
        node, pairs = int(ids[self.offset_node]), ids[self.contradictions]
        renumbered = {"put_back": ids[self.put_back], "ended": ids[self.ended]}
        return dataclasses.replace(self, offset_node=node, contradictions=pairs, **renumbered)

    def with_faces(self, mesh: Mesh, nodes: np.ndarray, vectors: np.ndarray, moving: int) -> "Inspection":
        """Adds what needs faces to the inspection.

        The mesh's `nodes` (o,) move by `vectors` (o, d); the caller gave the first `moving` vectors.
        """
        cut, left, node, touches = simplices(mesh, nodes), None, None, self.touches
        crossed = None if cut is None else crossings_of(cut, mesh, nodes, vectors)
        if cut is not None and self.rests.any():
            rows = np.zeros(len(mesh.points), dtype=np.int64)
            rows[nodes] = np.arange(len(nodes))
            touches = self.rests & share_faces(rows[self.contradictions], cut[0], len(nodes))
        if cut is not None and len(cut[0]):
            before = np.asarray(mesh.points, dtype=float)[nodes]
            wall = walls(before, moving, {"simplex": cut[0]})
            share = share_left(before, before + vectors, wall, cut[0], TOUCHING * np.ptp(before, axis=0).max())
            if np.isfinite(share).any():
                left, node = float(share.min()), int(nodes[share.argmin()])
        torn = tuple(names_of(mesh, self.contradictions[0][:, None])) if len(self.contradictions) else ()
        return dataclasses.replace(self, crossings=crossed, gap_left=left, gap_node=node, torn=torn, touches=touches)

    def __str__(self) -> str:
        """Lists what no method moves well, then what another method may do better."""
        return "\n".join((*self.warnings, *self.advice)) or "nothing to warn of."


@checked
def inspect(
    plan: Plan,
    u: Real[ArrayLike, "m d"] | Sequence[Any],
    *,
    mesh: Mesh | None = None,
    nodes: Integer[ArrayLike, " n"] | None = None,
) -> Inspection:
    """Checks a surface displacement on the host, and the motion that the mesh would make.

    Neighbouring surface nodes are contradictory where one moves, the other is fixed and the displacement is larger than
    their distance: a wall slides along a boundary that is held. They are also where both move and their distance more
    than doubles. No method moves such a mesh well.

    With the mesh, it measures how much is left of the gaps between walls: the distance of nodes to the faces of other walls.
    Moved walls that cross another boundary or themselves are found too. What crossed before does not count,
    nor do faces that share a node or touch in coincident ones, as at a sharp trailing edge. Faces with a node that is neither
    moving nor fixed are left out: where they go is not known yet.

    **Arguments:**

    - `plan`: what `prepare` returned.
    - `u`: displacements (m, d) of the moving nodes, in the mesh's unit.
    - `mesh`: the mesh that the plan was made for. Default: none.
    - `nodes`: the mesh's ids of the plan's points, where the plan is of a part of it (`prepare_in_chunks`). Default: all.

    **Returns:** an `Inspection`, which names nodes of the mesh.

    **Raises:** `ValueError` when the shape of `u` is not (m, d), or a component is not finite, or the mesh has another number
    of points than the plan.
    """
    return inspected(plan, u, mesh, nodes)


def inspected(plan: Plan, u: Any, mesh: Mesh | None, nodes: Any, moved: np.ndarray | None = None) -> Inspection:
    """Checks a displacement as `inspect` does; `moved` (n, d) is what `deform` returns for it, where it is known."""
    plan.check_surface("inspect")
    if nodes is None and mesh is not None and tuple(mesh.points.shape) != tuple(plan.points.shape):
        raise ValueError(
            f"`mesh` has points of shape {tuple(mesh.points.shape)}; this plan was made for {tuple(plan.points.shape)}."
        )
    inspection = _of_plan(plan, u, moved)
    ids = (
        np.arange(len(plan.points))
        if nodes is None
        else rows_of("nodes", nodes, 2**62 if mesh is None else len(mesh.points))
    )
    if len(ids) != len(plan.points):
        raise ValueError(f"`nodes` has {len(ids)} ids; this plan has {len(plan.points)} points.")
    inspection = inspection if nodes is None else inspection.renumbered(ids)
    if mesh is None:
        return inspection
    surface, vectors = ids[np.asarray(plan.surface_nodes)], np.asarray(plan.of_surface(u), dtype=float)
    return inspection.with_faces(mesh, surface, vectors, plan.n_moving)


def _of_plan(plan: Plan, u: Any, moved: np.ndarray | None) -> Inspection:
    """Checks all that needs no faces."""
    offset = np.linalg.norm(np.asarray(plan.offset(u)), axis=1)
    points, nodes = np.asarray(plan.points), np.asarray(plan.surface_nodes)
    finite = np.isfinite(np.asarray(u)).all(axis=1)
    if not finite.all():
        row = int(np.argmin(finite))
        raise MeshError(
            f"{(~finite).sum()} of {plan.n_moving} displacements are not finite, first that of node {{node}} (row {row}).",
            nodes[: plan.n_moving][~finite],
        )
    vectors = np.asarray(plan.of_surface(u))
    is_fixed = np.isin(nodes, plan.fixed)
    tree = Tree(points, leafsize=32, balanced_tree=False, compact_nodes=False)
    size = np.asarray(tree.query(points[nodes], k=2)[0])[:, 1]
    worst = int(offset.argmax())
    pairs = torn_pairs(points[nodes], vectors, is_fixed)
    torn, rests = nodes[pairs].reshape(-1, 2), np.asarray(is_fixed[pairs].any(axis=1))
    near = points[torn[0, 0]] if len(torn) else np.full(points.shape[1], np.nan)
    ratio = float((offset / np.where(size > 0, size, np.inf)).max())
    anywhere, behind = overshoot(plan, np.asarray(u, dtype=float), moved)
    displacement = np.asarray(u, dtype=float)
    changed = np.linalg.norm(vectors[: plan.n_moving] - displacement, axis=1)
    back = np.flatnonzero(changed > PUT_BACK * np.linalg.norm(displacement, axis=1).max())
    places = points[nodes] + vectors
    rows = ended(plan, places)
    base, rows_of_sources = (
        points[nodes[: plan.n_moving]],
        np.flatnonzero(np.isin(nodes[: plan.n_moving], plan.sources)),
    )
    too_few = missed(base, displacement, rows_of_sources) if points.shape[1] == 3 and len(rows_of_sources) else 0.0
    return Inspection(
        offset=float(offset[worst]),
        offset_node=int(nodes[worst]),
        offset_ratio=ratio,
        contradictions=torn,
        near=near,
        overshoot=anywhere,
        overshoot_behind=behind,
        slope=_slope(points[nodes[: plan.n_moving]], vectors[: plan.n_moving]),
        is_fitted=isinstance(getattr(plan.method, "coarse", None), FittedRBF),
        put_back=nodes[back[np.argsort(-changed[back], kind="stable")]],
        put_back_by=float(changed.max()) if len(back) else 0.0,
        ended=nodes[rows],
        ended_at=places[rows],
        largest=float(np.linalg.norm(displacement, axis=1).max()),
        reach=plan.reach,
        rests=rests,
        touches=rests,
        missed=too_few,
        leaves=leaves_enough(base, displacement) if too_few > UNRESOLVED else None,
    )


def _slope(points: np.ndarray, u: np.ndarray) -> float:
    """Measures how steeply `u` changes along the edges of a wall, without the affine motion nearest to it."""
    pairs = edges(points, len(points))
    if not len(pairs):
        return 0.0
    terms = np.column_stack([np.ones(len(points)), points - points.mean(axis=0)])
    first, second = pairs.T
    rest = u - terms @ np.linalg.lstsq(terms, u, rcond=None)[0]
    distance, length = (np.linalg.norm(positions[second] - positions[first], axis=1) for positions in (rest, points))
    return float(np.quantile(distance / length, 0.98))
