"""Checks of a surface displacement before the mesh is moved, in numbers and in sentences."""

import dataclasses
import functools
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from jaxtyping import ArrayLike, Float, Integer, Real
from scipy import sparse
from scipy.spatial.distance import cdist

from .._host.linear.products import dot_rows, row_lengths
from .._host.package.arguments import checked, finite_array, real_array, rows_of
from .._host.package.cores import beside
from .._host.package.errors import check_none
from .._host.package.rounding import Tree, extent_of, roundoff
from .._host.rows import mark
from .._host.sources.reduction import KDTree, drop_close
from .._host.surface.gaps import least_share_left
from .._host.surface.skin import edges
from .._host.surface.walls import walls
from .._host.tolerances import PUT_BACK, RESTS, SAME
from .._mesh.mesh import Mesh
from .._methods.rbf.fitted import FittedRBF
from .._plan.deform import deform
from .._plan.judge import ended, ends
from .._plan.plan import Plan, extended
from .._quality.verdict import judge
from .crossings import Crossings, names_of, simplices, wall_crossings
from .cures import advice_on_folds

STEEP = 0.5  # slope of a displacement along the wall above which a fitted field strains cells more
NARROW = 0.2  # share of a gap, left after a motion, below which one step folds cells in it
UNRESOLVED = 1 / 3  # share of the largest displacement that sources may miss between them
DISTANCES_TOGETHER = 4096  # points whose distances are held together
LEAVES = (64, 128, 256, 512, 1024, 2048)  # numbers of leaves of a k-d tree that are tried


@dataclasses.dataclass(frozen=True)
class Inspection:
    """Findings of `inspect`; lengths are in the mesh's units, nodes are the mesh's.

    - `warnings`: one sentence for each thing that no method moves well.
    - `advice`: one sentence for each other method, or number of steps, that may do better; and how
      many cells one step folds, and how many were folded before.
    - `contradictions`: pairs (k, 2) of neighbouring surface nodes that are torn apart, the worst
      first.
    - `crossings`: where moved walls cross another boundary or themselves; None without a mesh.
    - `is_hopeless`: whether walls cross, and not because they are torn from what they could slide
      along.
    - `overshoot`: the largest motion of a node off the surface over the largest motion of the
      surface. `overshoot_behind`: the same behind a thin body's part that rests while its other
      side moves (below an airfoil with a bump on its upper side).
    - `slope`: how steeply the displacement changes along the wall, per length and without its
      affine part. It is exceeded on 2 % of the edges.
    - `missed`: residual of an interpolation of the displacement from the moving sources in 3-D,
      relative to the largest displacement.
    """

    warnings: tuple[str, ...]
    advice: tuple[str, ...]
    contradictions: np.ndarray
    crossings: Crossings | None
    is_hopeless: bool
    overshoot: float
    overshoot_behind: float
    slope: float
    missed: float
    _motion: "_Motion" = dataclasses.field(repr=False)

    @functools.cached_property
    def offset(self) -> float:
        """The largest displacement that the correction has to carry (eq. 5; 0 for a method without
        one).
        """
        return float(row_lengths(np.asarray(self._motion.plan.offset(self._motion.u))).max())

    @functools.cached_property
    def gap_left(self) -> float | None:
        """The smallest share of a gap between walls that is left. It is 1 if no gap becomes
        smaller; None without a mesh, or with one wall. It is searched when it is asked for.
        """
        left = self._motion.least_gap(below=1.0)[0]
        return left if np.isfinite(left) else None

    def __str__(self) -> str:
        return "\n".join((*self.warnings, *self.advice)) or "nothing to warn of."


@dataclasses.dataclass(frozen=True, eq=False)
class _Motion:
    """A motion of a plan's surface by `u` (m, d), whose points are `ids` of a mesh."""

    plan: Plan
    u: Any
    ids: np.ndarray
    mesh: Mesh | None

    @functools.cached_property
    def displacement(self) -> np.ndarray:
        return np.asarray(self.u, dtype=float)

    @functools.cached_property
    def vectors(self) -> np.ndarray:
        """Displacements (o, d) of the surface's nodes, put back on planes and pairs."""
        return np.asarray(self.plan.of_surface(self.u))

    @functools.cached_property
    def points(self) -> np.ndarray:
        """Points (o, d) of the surface."""
        return np.asarray(self.plan.points)[np.asarray(self.plan.surface_nodes)]

    @functools.cached_property
    def nodes(self) -> np.ndarray:
        """The mesh's ids (o,) of the surface's nodes."""
        return self.ids[np.asarray(self.plan.surface_nodes)]

    @functools.cached_property
    def size(self) -> np.ndarray:
        return row_lengths(self.displacement)

    @functools.cached_property
    def is_fixed(self) -> np.ndarray:
        return np.isin(np.asarray(self.plan.surface_nodes), self.plan.fixed)

    @functools.cached_property
    def torn(self) -> np.ndarray:
        """Pairs (k, 2) of rows of the surface that contradict each other, the worst first."""
        return torn_pairs(self.points, self.vectors, self.is_fixed)

    @functools.cached_property
    def faces(self) -> np.ndarray | None:
        """Simplices (s, d) of the boundary's faces, in rows of the surface; None without a mesh."""
        return None if self.mesh is None else simplices(self.mesh, self.nodes)[0]

    @functools.cached_property
    def rests(self) -> np.ndarray:
        """Whether one node of a torn pair is fixed while the other node moves."""
        return np.asarray(self.is_fixed[self.torn].any(axis=1), dtype=bool)

    @functools.cached_property
    def touches(self) -> np.ndarray:
        """Whether the boundaries of a torn pair have faces in common there; or else `rests`."""
        if self.faces is None or not self.rests.any():
            return self.rests
        return self.rests & share_faces(self.torn, self.faces, len(self.nodes))

    def least_gap(self, below: float) -> tuple[float, int]:
        """The smallest share of a gap that is left, where it is less than `below`, and the node."""
        if self.faces is None:
            return np.inf, 0
        before = self.points.astype(float)
        wall = walls(before, self.plan.n_moving, {"simplex": self.faces})
        scale = SAME * extent_of(before)
        after = before + self.vectors.astype(float)
        share, row = least_share_left(before, after, wall, self.faces, scale, below)
        return share, int(self.nodes[row])

    @functools.cached_property
    def missed(self) -> float:
        base = self.points[: self.plan.n_moving]
        sources = np.flatnonzero(np.isin(self.plan.moving, self.plan.sources))
        if base.shape[1] < 3 or not len(sources):
            return 0.0
        return measure_missed(base, self.displacement, sources)

    @functools.cached_property
    def slope(self) -> float:
        n = self.plan.n_moving
        return _slope(self.points[:n], self.vectors[:n])

    def check_finite(self) -> None:
        is_finite = np.isfinite(self.displacement).all(axis=1)
        check_none(
            np.asarray(self.plan.moving)[~is_finite],
            f"{{count}} of {self.plan.n_moving} displacements are not finite, first that of node "
            f"{{node}} (row {int(np.argmin(is_finite))}).",
        )

    def advice_on_cells(self, moved: Any, is_hopeless: bool) -> tuple[str, ...]:
        """Cures of cells that one step folds, unless walls cross, and cells folded before."""
        assert self.mesh is not None
        verdict = judge(self.mesh, moved)
        folds = ""
        if verdict.spoilt and not is_hopeless:
            folds = advice_on_folds(self.plan, self.mesh, self.displacement, verdict)
        return tuple(filter(None, (folds, verdict.note)))

    def warnings(self, crossings: str) -> Iterator[str]:
        """What no method moves well; `crossings` is what is said of walls that cross, or empty."""
        if len(self.torn):
            first, second = self.torn[0]
            place = ", ".join(f"{x:.4g}" for x in self.points[first])
            of = ""
            if self.mesh is not None:
                names = names_of(self.mesh, self.nodes[self.torn[:1]].reshape(-1, 1))
                of = " of " + " and ".join(repr(name) if name else "no patch" for name in names)
            yield (
                f"{len(self.torn)} pairs of neighbouring surface nodes are torn apart by more than "
                f"their distance, the worst nodes {self.nodes[first]} and {self.nodes[second]}{of} "
                f"near ({place}). {remedies(self.rests, self.touches)}"
            )
        if crossings:
            yield crossings
        changed = row_lengths(self.vectors[: self.plan.n_moving] - self.displacement)
        count = int(np.sum(changed > PUT_BACK * self.size.max()))
        if count:
            yield (
                f"{count} moving nodes do not go where `u` sends them, the worst is node "
                f"{self.nodes[changed.argmax()]}, by {changed.max():.3g}: they stay on their plane "
                "or surface, and pairs take the mean. Give a motion that does."
            )
        rows = ended(self.plan, self.points + self.vectors)
        if len(rows):
            yield ends(self.nodes[rows], (self.points + self.vectors)[rows])

    def advice(self) -> Iterator[str]:
        """What may do better where the motion is large or steep for the plan's method."""
        left, node = self.least_gap(below=NARROW)
        if left < NARROW:
            yield (
                f"{100 * left:.2g} % of the gap between node {node} and another wall "
                "is left. Go there in several steps, each of which leaves half of it or more: "
                "`march(plan, path, rebuild=True)`."
            )
        largest = float(self.size.max())
        if self.plan.reach < largest:
            yield (
                f"the field ends {self.plan.reach:.2g} from the surface, which moves by "
                f"{largest:.2g}: cells fold between. Take a radius of several times the motion, "
                "`jm.CompactRBF(radius)`, or a method without one."
            )
        base = self.points[: self.plan.n_moving]
        leaves = leaves_enough(base, self.displacement) if self.missed > UNRESOLVED else None
        if leaves is not None:
            yield (
                "the sources do not resolve the displacement: between them "
                f"{100 * self.missed:.0f} % of it is missed. Take "
                f"SurfaceReconstruction(FittedRBF(RBF(reduction=KDTree({leaves}, "
                "extremes=True))))."
            )
        is_fitted = isinstance(getattr(self.plan.method, "coarse", None), FittedRBF)
        if is_fitted and self.slope > STEEP:
            yield (
                f"the displacement changes by {self.slope:.2g} per length along the wall. The "
                "fitted field keeps grid lines close to their angle to the wall, and may cost a "
                "quarter of the smallest Jacobian ratio where that is above 0.5. "
                "SurfaceReconstruction(RBF(reduction=KDTree(64, extremes=True))) does without; "
                "`compare` tries both."
            )


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
    Or both move, and their distance more than doubles. With the mesh, it measures how much is left
    of gaps between walls, and finds moved walls that come to cross another boundary or themselves.
    If one step folds cells, it tries cures: round walls that slide, 2, 4 and 8 steps, methods on
    cells.

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
    extended(plan, u)  # checks the shape
    u = real_array("u", u, (None, None))
    ids = _ids_of_points(plan, mesh, nodes)
    whole = mesh if nodes is None else None
    motion = _Motion(plan, u, ids, mesh)
    motion.check_finite()
    if moved is not None or whole is not None:
        moved = deform(plan, u) if moved is None else moved
        moved = finite_array("moved", moved, plan.points.shape)
    crossing = None
    if mesh is not None:
        part = None if np.array_equal(ids, np.arange(len(mesh.points))) else ids
        crossing = beside(wall_crossings, plan, mesh, motion.displacement[None], moved, part)
    anywhere, behind = overshoot(plan, motion.displacement, moved)
    crossings = None if crossing is None else crossing.result()
    hopeless = bool(crossings) and not motion.touches.any()
    of_cells = () if whole is None else motion.advice_on_cells(moved, hopeless)
    return Inspection(
        warnings=tuple(motion.warnings("" if crossings is None else str(crossings))),
        advice=(*of_cells, *motion.advice()),
        contradictions=motion.nodes[motion.torn].reshape(-1, 2),
        crossings=crossings,
        is_hopeless=hopeless,
        overshoot=anywhere,
        overshoot_behind=behind,
        slope=motion.slope,
        missed=motion.missed,
        _motion=motion,
    )


def _ids_of_points(plan: Plan, mesh: Mesh | None, nodes: Any) -> np.ndarray:
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


def _slope(points: np.ndarray, u: np.ndarray) -> float:
    """Measures how steeply `u` changes along the edges of a wall, without its affine part."""
    pairs = edges(points, len(points))
    if not len(pairs):
        return 0.0
    terms = np.column_stack([np.ones(len(points)), points - points.mean(axis=0)])
    first, second = pairs.T
    rest = u - terms @ np.linalg.lstsq(terms, u, rcond=None)[0]
    distance, length = (
        row_lengths(positions[second] - positions[first]) for positions in (rest, points)
    )
    return float(np.quantile(distance / length, 0.98))


def torn_pairs(points: np.ndarray, vectors: np.ndarray, is_fixed: np.ndarray) -> np.ndarray:
    count = min(2 * points.shape[1], len(points) - 1)
    distance, nearest = map(np.asarray, Tree(points).query(points, k=count + 1))
    first = np.repeat(np.arange(len(points)), count)
    second = nearest[:, 1:].ravel()
    distance = distance[:, 1:].ravel()
    difference = row_lengths(vectors[first] - vectors[second])
    after = row_lengths((points + vectors)[first] - (points + vectors)[second])
    mixed = is_fixed[first] != is_fixed[second]
    scale = SAME * extent_of(points)
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
    size = row_lengths(u)
    inner = np.flatnonzero(~mark(len(points), moving, plan.fixed))
    if not size.max() or not inner.size:
        return 0.0, 0.0
    moved = np.asarray(deform(plan, u)) if moved is None else moved
    share = row_lengths((moved - points)[inner]) / size.max()
    base = points[moving]
    active = np.flatnonzero(size > size.max() / 2)
    rows = np.flatnonzero(share > RESTS)
    reach = extent_of(base)
    far, nearest = map(
        np.asarray, Tree(base).query(points[inner[rows]], distance_upper_bound=reach)
    )
    rows = rows[np.isfinite(far)]
    nearest = nearest[np.isfinite(far)]
    far = far[np.isfinite(far)]
    away = points[inner[rows]] - base[nearest]
    towards = base[active[np.asarray(Tree(base[active]).query(base[nearest])[1])]] - base[nearest]
    is_opposite = dot_rows(away, towards) < -far * row_lengths(towards) / 2
    behind = (size[nearest] <= RESTS * size.max()) & is_opposite
    return float(share.max()), float(share[rows[behind]].max(initial=0.0))


def measure_missed(points: np.ndarray, u: np.ndarray, sources: np.ndarray) -> float:
    """Measures the residual of an interpolation of `u` (m, d) from `sources` at `points` (m, d),
    relative to the largest displacement, and zero without one. The interpolation is that by
    distances, and a constant; SciPy's `RBFInterpolator` takes a tenth of a second to import.
    """
    largest = row_lengths(u).max(initial=0)
    rows = drop_close(points, sources, roundoff(points))
    if largest == 0 or not len(rows):
        return 0.0
    system = np.pad(-cdist(points[rows], points[rows]), (0, 1), constant_values=1.0)
    system[-1, -1] = 0
    weights = np.linalg.solve(system, np.pad(u[rows], ((0, 1), (0, 0))))
    blocks = [
        slice(start, start + DISTANCES_TOGETHER)
        for start in range(0, len(points), DISTANCES_TOGETHER)
    ]
    off = [
        u[block] - weights[-1] + cdist(points[block], points[rows]) @ weights[:-1]
        for block in blocks
    ]
    return float(row_lengths(np.concatenate(off)).max() / largest)


def leaves_enough(points: np.ndarray, u: np.ndarray) -> int | None:
    """The least of `LEAVES` whose sources miss less than a third of `u`, or None."""
    for leaves in LEAVES:
        sources = KDTree(leaves, extremes=True)(points)
        if measure_missed(points, u, sources) <= UNRESOLVED:
            return leaves
        if len(sources) == len(points):
            break
    return None
