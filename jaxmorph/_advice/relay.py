"""A motion over several meshes: a new one takes over before the cells of the last one break."""

import copy
import dataclasses
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Real

from .._boundary.conditions import renumbered
from .._boundary.names import Nodes, nodes_named
from .._host.package.arguments import between, check_fields, checked, finite_array
from .._mesh.mesh import Mesh
from .._plan.deform import deform
from .._plan.plan import Plan
from .._plan.prepare import plan_of
from .._quality.limits import Limits
from .._quality.verdict import Verdict, judge
from .largest_step import DesignedMesh
from .remesh import with_new_cells, worn_cells
from .transfer import Remeshed
from .turn import Turn

MOVES_AHEAD = 3  # moves like the last one, within which an old cell that breaks is replaced
MOVES_TO_LAST = 5  # moves like the last one that new cells should last
LAYERS = 2  # of cells around worn ones
GROWTHS = (0.3, 0.25, 0.35, 0.4)  # of sizes of new cells, tried in turn


@dataclasses.dataclass(frozen=True, eq=False)
class Relay:
    """A motion of a wall that goes on over several meshes, each moved by one plan.

        state = jm.Relay(jm.prepare(mesh, "body", "channel"), mesh)
        for u in path:
            state = state.moved(u)
            if state.remeshed is not None:
                field = state.remeshed.transfer(field)

    Each move is tried first. Where it would break a limit, `remesh` makes new cells on the points
    before it. They take the place of all that would break within three moves like it. Other sizes
    are tried until the new ones last for five. The move then goes on from there. Displacements
    are total ones, of the first mesh's moving nodes in their order: so are design variables.
    Derivatives are exact on one mesh (`points_at`); across a hand-over they begin anew.

    - `plan`, `mesh`: of the mesh that moves now; its first mesh's to begin with.
    - `limits`: of every move, relative to that mesh. Default: a Jacobian ratio of 0.3.
    - `keep`, `target`: as `remesh` takes them; the default of `target` is 0.1.
    - `start` (m, d): the displacement at which `mesh` took over. Default: none.
    - `u` (m, d), `points` (n, d): the last displacement, and the points there.
    - `verdict`: of these points; None before the first move.
    - `remeshed`: the `Remeshed` by which `mesh` took over in the last move, or None.
    - `count`: the number of hand-overs up to now.

    **Raises:** `ValueError` for a mesh that is not the plan's.
    """

    plan: Plan
    mesh: Mesh
    limits: Limits = dataclasses.field(
        default_factory=lambda: Limits(min_jacobian_ratio=0.3), kw_only=True
    )
    keep: Nodes = dataclasses.field(default=(), kw_only=True)
    target: float = dataclasses.field(default=0.1, kw_only=True)
    start: Any = dataclasses.field(init=False)
    u: Any = dataclasses.field(init=False)
    points: Any = dataclasses.field(init=False)
    verdict: Verdict | None = dataclasses.field(default=None, init=False)
    remeshed: Remeshed | None = dataclasses.field(default=None, init=False)
    count: int = dataclasses.field(default=0, init=False)

    def __post_init__(self):
        check_fields(self)
        between("target", self.target, 0, 1)
        self.plan.check_mesh(self.mesh)
        none = np.zeros((self.plan.n_moving, self.mesh.points.shape[1]))
        keep = nodes_named(self.keep, "keep", self.mesh, len(self.mesh.points))
        vars(self).update(keep=keep, start=none, u=none, points=self.mesh.points)

    def _with(self, values: dict[str, Any]) -> "Relay":
        other = copy.copy(self)
        vars(other).update(values)
        return other

    @checked
    def points_at(self, u: Real[ArrayLike, "m d"]) -> Float[Array, "n d"]:
        """Moves the present mesh by a total displacement. Traced, with exact derivatives."""
        if np.shape(u) != self.start.shape:
            raise ValueError(f"`u` has shape {np.shape(u)}; this wall's is {self.start.shape}.")
        return deform(self.plan, jnp.asarray(u) - self.start)

    @checked
    def design(
        self, displacement: Callable[[Any], Any], *, min_jacobian_ratio: float = 0.0
    ) -> DesignedMesh:
        """Makes the present mesh, moved by design variables, for `shapes.MeshGuard`.

        - `displacement`: takes design variables and returns the total displacement (m, d).
        - `min_jacobian_ratio`: as of `DesignedMesh`.
        """
        return DesignedMesh(
            self.plan,
            self.mesh,
            lambda variables: displacement(variables) - self.start,
            min_jacobian_ratio=min_jacobian_ratio,
        )

    @property
    def measures(self) -> dict[str, float]:
        """Numbers of the last move for `shapes.History.add`."""
        ratio = (
            1.0
            if self.verdict is None or self.verdict.judged is None
            else self.verdict.judged.ratio
        )
        return {"jacobian_ratio": float(ratio), "hand_overs": float(self.count)}

    @checked
    def moved(self, u: Real[ArrayLike, "m d"]) -> "Relay":
        """Moves the wall to a total displacement (m, d), on the host, and hands over before that
        where it must.

        **Raises:** `ValueError` for another shape of `u`, where `remesh` does, and where the move
        breaks a limit on the new mesh, too.
        """
        u = finite_array("u", u, self.start.shape)
        state, verdict = self._after(u)
        if verdict.ok:
            return state
        new = self._handed_over(u, np.asarray(verdict.bad))
        after, verdict = new._after(u)
        if verdict.ok:
            return after._with({"remeshed": new.remeshed})
        raise ValueError(
            f"this move breaks a limit right after a hand-over, too: {verdict.faults()[0]} Take "
            "smaller moves, or other limits."
        )

    def _after(self, u: np.ndarray) -> "tuple[Relay, Verdict]":
        points = np.asarray(self.points_at(u))
        verdict = judge(self.mesh, points, self.limits)
        values = {"u": u, "points": points, "verdict": verdict, "remeshed": None}
        return self._with(values), verdict

    def _handed_over(self, u: np.ndarray, bad: np.ndarray) -> "Relay":
        """Takes new cells that last for some moves like that to `u`, which breaks `bad` ones, or
        else the best tried.
        """
        step = Turn.of(np.asarray(self.points)[np.asarray(self.plan.moving)], u - self.u)
        moved = self.mesh.moved(self.points)
        worn = worn_cells(self.mesh, moved, self.target)
        worn[bad] = True
        worn[self._breaking(step, MOVES_AHEAD)] = True
        best: Relay | None = None
        least = np.inf
        failure = ValueError()
        for growth in GROWTHS:
            try:
                new = self._with_new_cells(moved, worn, growth)
            except ValueError as error:
                failure = error
                continue
            left = new._breaking(step, MOVES_TO_LAST)
            if len(left) < least:
                best = new
                least = len(left)
            if not least:
                break
            assert new.remeshed is not None
            worn = worn | np.isin(new.remeshed.cells_of_old, left)
        if best is None:
            raise failure
        return best

    def _breaking(self, step: Turn, moves: int) -> np.ndarray:
        """The cells that break a limit within some moves like a step."""
        points = self.points_at(self.u + np.asarray(step.at(moves)))
        return np.asarray(judge(self.mesh, np.asarray(points), self.limits).bad)

    def _with_new_cells(self, moved: Mesh, worn: np.ndarray, growth: float) -> "Relay":
        keep = np.asarray(self.keep)
        stay = np.union1d(keep, np.asarray(self.plan.surface_nodes))
        made = with_new_cells(self.mesh, moved, worn, stay, layers=LAYERS, growth=growth)
        values = {
            "plan": _prepared(self.plan, made),
            "mesh": made.mesh,
            "keep": made.of_old[keep],
            "start": self.u,
            "points": made.mesh.points,
            "remeshed": made,
            "count": self.count + 1,
        }
        return self._with(values)


def _prepared(plan: Plan, made: Remeshed) -> Plan:
    """Prepares the conditions of a plan again, on the new mesh."""
    old = plan.boundary
    place = made.of_old
    stay = np.flatnonzero(place >= 0)
    on = np.zeros((len(made.mesh.points), old.on.shape[1]), bool)
    on[place[stay]] = old.on[stay]
    pairings, tracks = renumbered(old.pairings, old.tracks, place)
    lists = {name: place[getattr(old, name)] for name in ("moving", "fixed", "guided", "loose")}
    known = old.altered(
        points=np.asarray(made.mesh.points), on=on, pairings=pairings, tracks=tracks, **lists
    )
    # the first `prepare` has warned of free faces
    return plan_of(known.with_mesh(made.mesh).altered(left=None), plan.method)
