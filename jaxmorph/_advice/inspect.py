"""Checks of a surface displacement before the mesh is moved, in numbers and in sentences."""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from jaxtyping import ArrayLike, Float, Integer, Real
from scipy import sparse
from scipy.spatial.distance import cdist

from .._boundary.outer_faces import mask, row_of
from .._host.package.arguments import checked, finite_array, rows_of
from .._host.package.cores import beside
from .._host.package.errors import check_none
from .._host.package.rounding import Tree, roundoff
from .._host.sources.reduction import KDTree, drop_close
from .._host.surface.gaps import share_left
from .._host.surface.skin import edges
from .._host.surface.walls import walls
from .._mesh.mesh import Mesh
from .._methods.rbf.fitted import FittedRBF
from .._plan.deform import deform
from .._plan.judge import ended, ends
from .._plan.plan import Plan
from .._quality.verdict import judge
from .crossings import SAME, Crossings, names_of, simplices, wall_crossings
from .cures import advice_on_folds

STEEP = 0.5  # slope of a displacement along the wall above which a fitted field strains cells more
NARROW = 0.2  # share of a gap, left after a motion, below which one step folds cells in it
# share of the largest motion by which planes, surfaces and pairs may change a moving node's
PUT_BACK = 0.01
# distance of a node from another wall, relative to the surface's extent: no gap there
TOUCHING = 1e-9
RESTS = 1e-3  # share of the largest displacement below which a part of the surface rests
UNRESOLVED = 1 / 3  # share of the largest displacement that sources may miss between them
ROWS = 4096  # points whose distances are held together
LEAVES = (64, 128, 256, 512, 1024, 2048)  # numbers of leaves of a k-d tree that are tried


@dataclasses.dataclass(frozen=True)
class Inspection:
    """Findings of `inspect`; lengths are in the mesh's units.

    - `offset`, `offset_node`: the largest displacement that the correction has to carry (eq. 5; 0
      for a method without one), and its node.
    - `offset_ratio`: the largest ratio of a node's offset to the distance of its nearest mesh node.
    - `contradictions`: pairs (k, 2) of neighbouring surface nodes that are torn apart, the worst
      first; `near` (d,) is where the worst pair lies, `torn` the patches of its two nodes.
    - `rests` (k,): whether one node of a pair is fixed while the other node moves. `touches` (k,):
      whether the boundaries of the two have faces in common there; without a mesh as `rests`.
    - `overshoot`: the largest motion of a node off the surface over the largest motion of the
      surface. `overshoot_behind`: the same behind a thin body's part that rests while its other
      side moves (below an airfoil with a bump on its upper side).
    - `slope`: how steeply the displacement changes along the wall, per length and without its
      affine part. It is exceeded on 2 % of the edges.
    - `is_fitted`: whether the coarse field is a `FittedRBF`, as in `prepare`'s default.
    - `crossings`: where moved walls cross another boundary or themselves; None without a mesh.
    - `put_back`: moving nodes (k,) that do not go where `u` sends them, the worst first, by
      `put_back_by` at most. Their plane, surface or pair changes the motion by more than a
      hundredth of the largest motion.
    - `ended`, `ended_at`: sliding nodes (k,) that come to the end of their surface, and where they
      are after the motion (k, d).
    - `gap_left`, `gap_node`: the smallest share of a gap between walls that is left, and the node
      there. It is 1 or more if no gap becomes smaller; None without a mesh, or with one wall.
    - `largest`: the largest displacement of a moving node.
    - `reach`: how far from the surface a field of compact support reaches; infinity for others.
    - `missed`: residual of an interpolation of the displacement from the moving sources in 3-D,
      relative to the largest displacement.
    - `leaves`: leaves of a `KDTree` whose sources miss less than a third of it. None if the plan's
      do already, or if no number does.
    - `folds`: how many cells one step folds, from where on, and what was found to help. Empty if
      none folds, where walls cross, and without a mesh.
    - `folded_before`: how many cells were folded before the motion; empty if none were.
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
    put_back: np.ndarray
    put_back_by: float
    ended: np.ndarray
    ended_at: np.ndarray
    largest: float
    reach: float
    rests: np.ndarray
    touches: np.ndarray
    missed: float
    leaves: int | None
    crossings: Crossings | None = None
    gap_left: float | None = None
    gap_node: int | None = None
    torn: tuple[str, ...] = ()
    folds: str = ""
    folded_before: str = ""

    @property
    def is_hopeless(self) -> bool:
        """Whether walls cross, and not because they are torn from what they could slide along."""
        return bool(self.crossings) and not self.touches.any()

    @property
    def warnings(self) -> tuple[str, ...]:
        """One sentence for each thing that no method moves well."""
        return tuple(self._warnings())

    def _warnings(self) -> Iterator[str]:
        if len(self.contradictions):
            first, second = self.contradictions[0]
            place = ", ".join(f"{x:.4g}" for x in self.near)
            both = " and ".join(repr(name) if name else "no patch" for name in self.torn)
            yield (
                f"{len(self.contradictions)} pairs of neighbouring surface nodes are torn apart "
                "by more than their distance, the "
                f"worst nodes {first} and {second}{f' of {both}' if both else ''} near ({place}). "
                f"{remedies(self.rests, self.touches)}"
            )
        if said := "" if self.crossings is None else str(self.crossings):
            yield said
        if len(self.put_back):
            yield (
                f"{len(self.put_back)} moving nodes do not go where `u` sends them, the worst is "
                f"node {self.put_back[0]}, by "
                f"{self.put_back_by:.3g}: they stay on their plane or surface, and pairs take the "
                "mean. Give a motion that does."
            )
        if len(self.ended):
            yield ends(self.ended, self.ended_at)

    @property
    def advice(self) -> tuple[str, ...]:
        """One sentence for another method, or for more steps, that may do better."""
        return tuple(self._advice())

    def _advice(self) -> Iterator[str]:
        yield from filter(None, (self.folds, self.folded_before))
        if self.gap_left is not None and self.gap_left < NARROW:
            yield (
                f"{100 * self.gap_left:.2g} % of the gap between node {self.gap_node} and another "
                "wall is left. Go there in "
                "several steps, each of which leaves half of it or more: `march(plan, path, "
                "rebuild=True)`."
            )
        if self.reach < self.largest:
            yield (
                f"the field ends {self.reach:.2g} from the surface, which moves by "
                f"{self.largest:.2g}: cells fold between. Take a "
                "radius of several times the motion, `jm.CompactRBF(radius)`, or a method "
                "without one."
            )
        if self.leaves is not None:
            yield (
                "the sources do not resolve the displacement: between them "
                f"{100 * self.missed:.0f} % of it is missed. Take "
                f"SurfaceReconstruction(FittedRBF(RBF(reduction=KDTree({self.leaves}, "
                "extremes=True))))."
            )
        if self.is_fitted and self.slope > STEEP:
            yield (
                f"the displacement changes by {self.slope:.2g} per length along the wall. The "
                "fitted field keeps grid lines close "
                "to their angle to the wall, and may cost a quarter of the smallest Jacobian "
                "ratio where that is above 0.5. "
                "SurfaceReconstruction(RBF(reduction=KDTree(64, extremes=True))) does without; "
                "`compare` tries both."
            )

    def renumbered(self, ids: np.ndarray) -> "Inspection":
        ids = np.asarray(ids)
        names = ("contradictions", "put_back", "ended")
        rows = {name: ids[getattr(self, name)] for name in names}
        return dataclasses.replace(self, offset_node=int(ids[self.offset_node]), **rows)

    def __str__(self) -> str:
        return "\n".join((*self.warnings, *self.advice)) or "nothing to warn of."


def remedies(rests: np.ndarray, touches: np.ndarray) -> str:
    slides, gap, both = (int(mask.sum()) for mask in (touches, rests & ~touches, ~rests))
    at = (
        ""
        if slides == len(rests)
        else f"At {slides} of them a fixed boundary touches the moving one. "
    )
    texts = (
        f"{at}Name the fixed boundary in `sliding` (--sliding) in place of `fixed`, or make it a "
        "symmetry plane, if it slides "
        "along the moving one. Name it in `free` (--free) if its nodes may follow, as those of a "
        "duct's ends.",
        f"{gap} of them lie across a gap to a fixed wall, which is narrower than the motion: "
        "cells in it shear as much.",
        f"In {both} of them both nodes move, and come to more than twice their distance. Row i of "
        "`u` moves node "
        "`plan.moving[i]`: is the order right? If so, the motion is too steep for the spacing of "
        "the nodes: smooth it "
        "(`shapes.Smoother`), or refine the surface.",
    )
    return " ".join(text for text, count in zip(texts, (slides, gap, both), strict=True) if count)


@checked
def inspect(
    plan: Plan,
    u: Real[ArrayLike, "m d"] | Sequence[Any],
    *,
    mesh: Mesh | None = None,
    nodes: Integer[ArrayLike, " n"] | None = None,
    moved: Float[ArrayLike, "n d"] | None = None,
) -> Inspection:
    """Checks a surface displacement on the host, and the motion that the mesh would make.

    Two neighbouring surface nodes contradict each other in two cases. One moves, the other is
    fixed, and the displacement is larger than their distance: a wall slides along a fixed boundary.
    Or both move, and their distance more than doubles. No method moves such a mesh well. With the
    mesh, it measures how much is left of gaps between walls, and finds moved walls that cross
    another boundary or themselves. Faces that crossed before do not count, nor do faces that share
    a node or touch in coincident nodes, as at a sharp trailing edge. Faces with a node that is
    neither moving nor fixed are left out. If one step folds cells, it tries cures: round walls that
    slide, 2, 4 and 8 steps, methods on cells.

    **Arguments:**

    - `plan`: from `prepare`.
    - `u`: displacements (m, d) of the moving nodes, in the mesh's unit.
    - `mesh`: the mesh that the plan was made for. Default: none.
    - `nodes`: the mesh's ids of the plan's points, where the plan is of a part of it
      (`prepare_in_chunks`). Default: all. No cures are tried for a part.
    - `moved`: what `deform(plan, u)` returned, where it is at hand. Default: computed where needed.

    **Returns:** an `Inspection`, which names nodes of the mesh. **Raises:** `ValueError` for a `u`
    that is not (m, d) or not finite, and for a mesh with another number of points than the plan.
    """
    plan.check_surface("inspect")
    ids = _ids(plan, mesh, nodes)
    is_whole = mesh is not None and nodes is None
    surface = np.asarray(plan.surface_nodes)
    vectors = np.asarray(plan.of_surface(u))
    finite = np.isfinite(np.asarray(u)).all(axis=1)
    n = plan.n_moving
    check_none(
        surface[:n][~finite],
        f"{{count}} of {n} displacements are not finite, first that of node {{node}} (row "
        f"{int(np.argmin(finite))}).",
    )
    if moved is not None or is_whole:
        moved = finite_array(
            "moved", deform(plan, u) if moved is None else moved, plan.points.shape
        )
    if mesh is None:
        return _of_plan(plan, u, vectors, moved).renumbered(ids)
    looking = beside(_of_faces, plan, mesh, ids, vectors.astype(float))
    crossing = beside(
        wall_crossings,
        plan,
        mesh,
        np.asarray(u, float)[None],
        moved,
        None if np.array_equal(ids, np.arange(len(mesh.points))) else ids,
    )
    inspection = _of_plan(plan, u, vectors, moved).renumbered(ids)
    faces, found = looking.result()
    found["crossings"] = crossing.result()
    torn = inspection.contradictions
    if len(faces) and inspection.rests.any():
        rows = row_of(ids[surface], len(mesh.points))
        found["touches"] = inspection.rests & share_faces(rows[torn], faces, len(surface))
    found["torn"] = tuple(names_of(mesh, torn[:1].reshape(-1, 1)))
    inspection = dataclasses.replace(inspection, **found)
    if not is_whole:
        return inspection
    verdict = judge(mesh, moved)
    if verdict.spoilt and not inspection.is_hopeless:
        inspection = dataclasses.replace(
            inspection, folds=advice_on_folds(plan, mesh, np.asarray(u, dtype=float), verdict)
        )
    return dataclasses.replace(inspection, folded_before=verdict.note)


def _ids(plan: Plan, mesh: Mesh | None, nodes: Any) -> np.ndarray:
    count = len(plan.points)
    if mesh is not None and nodes is None:
        plan.check_mesh(mesh)
    ids = rows_of(
        "nodes",
        np.arange(count) if nodes is None else nodes,
        2**62 if mesh is None else len(mesh.points),
    )
    if len(ids) != count:
        raise ValueError(f"`nodes` has {len(ids)} ids; this plan has {count} points.")
    return ids


def _of_faces(
    plan: Plan, mesh: Mesh, ids: np.ndarray, vectors: np.ndarray
) -> tuple[np.ndarray, dict[str, Any]]:
    """Finds the boundary faces' simplices, and what is left of gaps, by field, where the surface
    moves by `vectors` (o, d).
    """
    nodes = ids[np.asarray(plan.surface_nodes)]
    cut = simplices(mesh, nodes)
    if not len(cut[0]):
        return cut[0], {}
    before = np.asarray(mesh.points, dtype=float)[nodes]
    wall = walls(before, plan.n_moving, {"simplex": cut[0]})
    share = share_left(
        before, before + vectors, wall, cut[0], TOUCHING * np.ptp(before, axis=0).max()
    )
    if not np.isfinite(share).any():
        return cut[0], {}
    return cut[0], {"gap_left": float(share.min()), "gap_node": int(nodes[share.argmin()])}


def _of_plan(plan: Plan, u: Any, vectors: np.ndarray, moved: np.ndarray | None) -> Inspection:
    """Checks all that needs no faces, of displacements `vectors` (o, d) of the surface."""
    points = np.asarray(plan.points)
    nodes = np.asarray(plan.surface_nodes)
    displacement = np.asarray(u, dtype=float)
    moving = nodes[: plan.n_moving]
    surface = points[nodes]
    is_fixed = np.isin(nodes, plan.fixed)
    offset = np.linalg.norm(np.asarray(plan.offset(u)), axis=1)
    size = np.linalg.norm(displacement, axis=1)
    tree = Tree(points, leafsize=32, balanced_tree=False, compact_nodes=False)
    spacing = np.asarray(tree.query(surface, k=2)[0])[:, 1]
    pairs = torn_pairs(surface, vectors, is_fixed)
    torn = nodes[pairs].reshape(-1, 2)
    rests = np.asarray(is_fixed[pairs].any(axis=1))
    anywhere, behind = overshoot(plan, displacement, moved)
    changed = np.linalg.norm(vectors[: plan.n_moving] - displacement, axis=1)
    back = np.flatnonzero(changed > PUT_BACK * size.max())
    rows = ended(plan, surface + vectors)
    sources = np.flatnonzero(np.isin(moving, plan.sources))
    too_few = (
        missed(points[moving], displacement, sources)
        if points.shape[1] == 3 and len(sources)
        else 0.0
    )
    return Inspection(
        offset=float(offset.max()),
        offset_node=int(nodes[offset.argmax()]),
        offset_ratio=float((offset / np.where(spacing > 0, spacing, np.inf)).max()),
        contradictions=torn,
        near=points[torn[0, 0]] if len(torn) else np.full(points.shape[1], np.nan),
        overshoot=anywhere,
        overshoot_behind=behind,
        slope=_slope(points[moving], vectors[: plan.n_moving]),
        is_fitted=isinstance(getattr(plan.method, "coarse", None), FittedRBF),
        put_back=nodes[back[np.argsort(-changed[back], kind="stable")]],
        put_back_by=float(changed.max()) if len(back) else 0.0,
        ended=nodes[rows],
        ended_at=(surface + vectors)[rows],
        largest=float(size.max()),
        reach=plan.reach,
        rests=rests,
        touches=rests,
        missed=too_few,
        leaves=leaves_enough(points[moving], displacement) if too_few > UNRESOLVED else None,
    )


def _slope(points: np.ndarray, u: np.ndarray) -> float:
    """Measures how steeply `u` changes along the edges of a wall, without its affine part."""
    pairs = edges(points, len(points))
    if not len(pairs):
        return 0.0
    terms = np.column_stack([np.ones(len(points)), points - points.mean(axis=0)])
    first, second = pairs.T
    rest = u - terms @ np.linalg.lstsq(terms, u, rcond=None)[0]
    distance, length = (
        np.linalg.norm(positions[second] - positions[first], axis=1) for positions in (rest, points)
    )
    return float(np.quantile(distance / length, 0.98))


def torn_pairs(points: np.ndarray, vectors: np.ndarray, is_fixed: np.ndarray) -> np.ndarray:
    count = min(2 * points.shape[1], len(points) - 1)
    distance, nearest = map(np.asarray, Tree(points).query(points, k=count + 1))
    first = np.repeat(np.arange(len(points)), count)
    second = nearest[:, 1:].ravel()
    distance = distance[:, 1:].ravel()
    difference = np.linalg.norm((vectors[first] - vectors[second]), axis=1)
    after = np.linalg.norm((points + vectors)[first] - (points + vectors)[second], axis=1)
    mixed = is_fixed[first] != is_fixed[second]
    scale = SAME * np.ptp(points, axis=0).max()
    excess = np.where(mixed, difference, after - distance) / (distance + scale)
    torn = np.flatnonzero((excess > 1) & (distance > scale) & (first < second))
    return np.stack([first, second], axis=1)[torn[np.argsort(-excess[torn], kind="stable")]]


def share_faces(pairs: np.ndarray, faces: np.ndarray, count: int) -> np.ndarray:
    """Marks pairs (k, 2) of rows on one of `faces` (f, corners), or on two that share a node."""
    corners = np.repeat(np.arange(len(faces)), faces.shape[1])
    entries = np.ones(faces.size, dtype=np.int64), (faces.ravel(), corners)
    holds = sparse.csr_matrix(entries, shape=(count, len(faces)))
    around = holds @ holds.T  # neighbours of each row, and itself
    return np.asarray(around[pairs[:, 0]].multiply(around[pairs[:, 1]]).sum(axis=1)).ravel() > 0


def overshoot(
    plan: Plan, u: Float[np.ndarray, "m d"], moved: np.ndarray | None = None
) -> tuple[float, float]:
    """Compares the largest motion off the surface with that of the surface; also behind what rests.

    A node lies behind a part that rests if three conditions hold. The nearest node of the moving
    surface rests. The part that moves lies on the other side of this node, as the upper side of an
    airfoil does for nodes below it. And the node is no farther away than the surface is long.
    `moved` is what `deform` returns, where it is known.
    """
    points = np.asarray(plan.points)
    moving = np.asarray(plan.moving)
    size = np.linalg.norm(u, axis=1)
    inner = np.flatnonzero(~mask(len(points), moving, plan.fixed))
    if not size.max() or not inner.size:
        return 0.0, 0.0
    moved = np.asarray(deform(plan, u)) if moved is None else moved
    share = np.linalg.norm((moved - points)[inner], axis=1) / size.max()
    base = points[moving]
    active = np.flatnonzero(size > size.max() / 2)
    rows = np.flatnonzero(share > RESTS)
    reach = np.ptp(base, axis=0).max()
    far, nearest = map(
        np.asarray, Tree(base).query(points[inner[rows]], distance_upper_bound=reach)
    )
    rows = rows[np.isfinite(far)]
    nearest = nearest[np.isfinite(far)]
    far = far[np.isfinite(far)]
    away = points[inner[rows]] - base[nearest]
    towards = base[active[np.asarray(Tree(base[active]).query(base[nearest])[1])]] - base[nearest]
    is_opposite = np.sum(away * towards, axis=1) < -far * np.linalg.norm(towards, axis=1) / 2
    behind = (size[nearest] <= RESTS * size.max()) & is_opposite
    return float(share.max()), float(share[rows[behind]].max(initial=0.0))


def missed(points: np.ndarray, u: np.ndarray, sources: np.ndarray) -> float:
    """Measures the residual of an interpolation of `u` (m, d) from `sources` at `points` (m, d),
    relative to the largest displacement, and zero without one. The interpolation is that by
    distances, and a constant; SciPy's `RBFInterpolator` takes a tenth of a second to import.
    """
    largest = np.linalg.norm(u, axis=1).max(initial=0)
    rows = drop_close(points, sources, roundoff(points))
    if largest == 0 or not len(rows):
        return 0.0
    system = np.pad(-cdist(points[rows], points[rows]), (0, 1), constant_values=1.0)
    system[-1, -1] = 0
    weights = np.linalg.solve(system, np.pad(u[rows], ((0, 1), (0, 0))))
    blocks = [slice(start, start + ROWS) for start in range(0, len(points), ROWS)]
    off = [
        u[block] - weights[-1] + cdist(points[block], points[rows]) @ weights[:-1]
        for block in blocks
    ]
    return float(np.linalg.norm(np.concatenate(off), axis=1).max() / largest)


def leaves_enough(points: np.ndarray, u: np.ndarray) -> int | None:
    """The least of `LEAVES` whose sources miss less than a third of `u`, or None."""
    for leaves in LEAVES:
        sources = KDTree(leaves, extremes=True)(points)
        if missed(points, u, sources) <= UNRESOLVED:
            return leaves
        if len(sources) == len(points):
            break
    return None
