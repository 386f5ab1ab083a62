"""One mesh and one motion, tried by several methods and in several numbers of steps."""

import dataclasses
from collections.abc import Callable, Iterable

import numpy as np
from jaxtyping import Float, Int

import jaxmorph as jm

from . import _gates
from ._judged import Judged
from ._method import Patches, in_double
from ._motion import Motion
from ._requests import Deform
from ._tables import inverted_cells


@dataclasses.dataclass(frozen=True)
class Attempt:
    """All that one attempt needs but the method and the number of steps."""

    request: Deform
    patches: Patches
    motion: Motion
    before: Judged

    @property
    def base(self) -> Float[np.ndarray, "n d"]:
        """The undeformed points."""
        return np.asarray(self.patches.mesh.points, dtype=float)

    @property
    def wall(self) -> Float[np.ndarray, "m d"]:
        """The undeformed points of the moving nodes."""
        return self.base[self.patches.nodes]

    def points(
        self,
        chunks: Iterable[tuple[Int[np.ndarray, " c"], jm.Plan]],
        steps: int,
        done: Callable[[float], None] | None = None,
    ) -> Float[np.ndarray, "n d"]:
        """Moves the points chunk by chunk, in double precision; `done` is called with the finished share."""
        path, points = self.motion.path(self.wall, steps), self.base.copy()
        is_moved = np.zeros(len(points), dtype=bool)
        for nodes, plan in chunks:
            moved = jm.deform(plan, path[0]) if steps == 1 else jm.march(plan, path)[1]
            here = np.flatnonzero(np.isin(nodes, self.patches.nodes))
            of_wall = np.searchsorted(self.patches.nodes, nodes[here])
            points[nodes] = in_double(self.base[nodes], moved, here, path[-1][of_wall], plan.method.exact)
            is_moved[nodes] = True
            if done is not None:
                done(is_moved.mean())
        return points

    def wall_quality(self, points: Float[np.ndarray, "n d"]) -> jm.WallQuality | None:
        """Measures the first grid line at the moving nodes; None where no side of a cell lies there, or no line begins."""
        try:
            wall = jm.wall_quality(self.patches.mesh, self.patches.nodes, points)
        except ValueError:
            return None
        return wall if len(wall.nodes) else None

    def judge(self, points: Float[np.ndarray, "n d"]) -> tuple[Judged, list[str]]:
        """Judges the moved mesh: its quality, and one sentence for each fault."""
        after = Judged(self.patches.mesh, points, self.before)
        bad = inverted_cells(after)
        return after, [*([bad] if bad else []), *_gates.failures(self.request.gates, self.before, after)]
