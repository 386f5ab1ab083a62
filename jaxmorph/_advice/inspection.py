"""The findings of `inspect`, in numbers and in sentences."""

import dataclasses
from collections.abc import Iterator

import numpy as np

from .._plan.judge import ends

STEEP = 0.5  # slope of a displacement along the wall above which a fitted field strains cells more
NARROW = 0.2  # share of a gap, left after a motion, below which one step folds cells in it


@dataclasses.dataclass(frozen=True, eq=False)
class Crossings:
    """Pairs of boundary faces that cross or touch only after the motion; true if any do.

    A wall that has passed through another wall completely does not cross it any more, and is not
    found.
    """

    nodes: np.ndarray  # (k, 2) one node of each of the two faces
    patches: tuple[tuple[str, str], ...]  # names of both patches of each pair; "" without a patch
    places: np.ndarray  # (k, d) a point of each crossing, in the mesh's unit

    def __len__(self) -> int:
        return len(self.nodes)

    def __str__(self) -> str:
        if not len(self):
            return ""
        pairs = dict.fromkeys(tuple(sorted(pair)) for pair in self.patches)
        between = ", ".join(_between(*pair) for pair in pairs)
        place = ", ".join(f"{x:.4g}" for x in self.places[0])
        count = f"{len(self)} {'pair' if len(self) == 1 else 'pairs'}"
        return (
            f"{count} of boundary faces cross each other after the motion ({between}), first near ({place}). No mesh can follow: "
            "move the wall less, or both walls together."
        )


def _between(first: str, second: str) -> str:
    one, other = (repr(name) if name else "faces of no patch" for name in (first, second))
    return f"{one} and itself" if first == second else f"{one} and {other}"


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
      none folds, and without a mesh.
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
                f"{len(self.contradictions)} pairs of neighbouring surface nodes are torn apart by more than their distance, the "
                f"worst nodes {first} and {second}{f' of {both}' if both else ''} near ({place}). "
                f"{remedies(self.rests, self.touches)}"
            )
        if self.crossings:
            yield str(self.crossings)
        if len(self.put_back):
            yield (
                f"{len(self.put_back)} moving nodes do not go where `u` sends them, the worst is node {self.put_back[0]}, by "
                f"{self.put_back_by:.3g}: they stay on their plane or surface, and pairs take the mean. Give a motion that does."
            )
        if len(self.ended):
            yield ends(self.ended, self.ended_at)

    @property
    def advice(self) -> tuple[str, ...]:
        """One sentence for another method, or for more steps, that may do better."""
        return tuple(self._advice())

    def _advice(self) -> Iterator[str]:
        if self.folds:
            yield self.folds
        if self.gap_left is not None and self.gap_left < NARROW:
            yield (
                f"{100 * self.gap_left:.2g} % of the gap between node {self.gap_node} and another wall is left. Go there in "
                "several steps, each of which leaves half of it or more: `march(plan, path, rebuild=True)`."
            )
        if self.reach < self.largest:
            yield (
                f"the field ends {self.reach:.2g} from the surface, which moves by {self.largest:.2g}: cells fold between. Take a "
                "radius of several times the motion, `jm.CompactRBF(radius)`, or a method without one."
            )
        if self.leaves is not None:
            yield (
                f"the sources do not resolve the displacement: between them {100 * self.missed:.0f} % of it is missed. Take "
                f"SurfaceReconstruction(FittedRBF(RBF(reduction=KDTree({self.leaves}, extremes=True))))."
            )
        if self.is_fitted and self.slope > STEEP:
            yield (
                f"the displacement changes by {self.slope:.2g} per length along the wall. The fitted field keeps grid lines close "
                "to their angle to the wall, and may cost a quarter of the smallest Jacobian ratio where that is above 0.5. "
                "SurfaceReconstruction(RBF(reduction=KDTree(64, extremes=True))) does without; `compare` tries both."
            )

    def renumbered(self, ids: np.ndarray) -> "Inspection":
        ids, names = np.asarray(ids), ("contradictions", "put_back", "ended")
        rows = {name: ids[getattr(self, name)] for name in names}
        return dataclasses.replace(self, offset_node=int(ids[self.offset_node]), **rows)

    def __str__(self) -> str:
        return "\n".join((*self.warnings, *self.advice)) or "nothing to warn of."


def remedies(rests: np.ndarray, touches: np.ndarray) -> str:
    slides, gap, both = (int(mask.sum()) for mask in (touches, rests & ~touches, ~rests))
    at = "" if slides == len(rests) else f"At {slides} of them a fixed boundary touches the moving one. "
    texts = (
        f"{at}Name the fixed boundary in `sliding` (--sliding) in place of `fixed`, or make it a symmetry plane, if it slides "
        "along the moving one. Name it in `free` (--free) if its nodes may follow, as those of a duct's ends.",
        f"{gap} of them lie across a gap to a fixed wall, which is narrower than the motion: cells in it shear as much.",
        f"In {both} of them both nodes move, and come to more than twice their distance. Row i of `u` moves node "
        "`plan.moving[i]`: is the order right? If so, the motion is too steep for the spacing of the nodes: smooth it "
        "(`shapes.Smoother`), or refine the surface.",
    )
    return " ".join(text for text, count in zip(texts, (slides, gap, both), strict=True) if count)
