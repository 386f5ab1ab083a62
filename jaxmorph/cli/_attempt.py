"""One mesh and one motion, tried by several methods and in several numbers of steps."""

import dataclasses
import warnings
from collections.abc import Callable, Iterable

import numpy as np
from jaxtyping import Float, Int

import jaxmorph as jm
from jaxmorph._advice.cures import Cure, cures
from jaxmorph._host.package.cores import Beside

from ._method import Patches
from ._motion import Motion
from ._output import Output
from ._requests import Deform
from ._way import Way, followed, in_double

PATIENCE = 120.0
"""Seconds that an attempt may have taken for others to be tried after it."""


@dataclasses.dataclass(frozen=True)
class Attempt:
    """All that an attempt needs but the method and the steps.

    `judging` judges the undeformed mesh in another thread.
    """

    request: Deform
    patches: Patches
    motion: Motion
    judging: Beside[jm.Verdict]

    @property
    def before(self) -> jm.Verdict:
        """The verdict on the undeformed mesh. Raises `ValueError` for what cannot be judged."""
        return self.judging.result()

    @property
    def base(self) -> Float[np.ndarray, "n d"]:
        """The undeformed points."""
        return np.asarray(self.patches.mesh.points, dtype=float)

    @property
    def wall(self) -> Float[np.ndarray, "m d"]:
        """The undeformed points of the moving nodes."""
        return self.base[self.patches.nodes]

    def way(
        self,
        chunks: Iterable[tuple[Int[np.ndarray, " c"], jm.Plan]],
        steps: int,
        done: Callable[[float], None] | None = None,
    ) -> Way:
        """Moves the points chunk by chunk, in double precision; `done` takes the finished share.

        Steps before the last one are kept for `--proven` alone.
        """
        path = self.motion.path(self.wall, steps)
        ends = {step: self.base.copy() for step in (range(steps) if self.request.gates.proven else [steps - 1])}
        is_moved, is_straight = np.zeros(len(self.base), dtype=bool), True
        for nodes, plan in chunks:
            here = np.flatnonzero(np.isin(nodes, self.patches.nodes))
            of_wall = np.searchsorted(self.patches.nodes, nodes[here])
            for step, moved in enumerate(followed(plan, path)):
                if step in ends:
                    u = path[step][of_wall]
                    ends[step][nodes] = in_double(self.base[nodes], moved, here, u, plan.method.exact)
            is_moved[nodes] = True
            is_straight &= plan.is_linear
            if done is not None:
                done(is_moved.mean())
        return Way(self.request.output, self.patches.mesh, tuple(ends.values()), is_straight)

    def judge(self, way: Way) -> jm.Verdict:
        return way.judge(self.request.gates.limits, self.before)


def explain(attempt: Attempt, bad: list[str], out: Output) -> None:
    """Prints what is wrong, and other flags that cure it, if an attempt with them succeeds."""
    request = attempt.request
    for sentence in bad[:-1]:
        out.complain(sentence)
    if any(gate.beyond for gate in attempt.before.gates):  # no way of moving the mesh cures it
        out.complain(bad[-1])
        return
    if out.seconds > PATIENCE or not request.dry_run:
        out.complain(f"{bad[-1]} No other flags were tried.")
        return
    trials, worked = _trials(attempt), ""
    with out.progress("trying others") as stage:
        for k, cure in enumerate(trials):
            if _works(attempt, cure):
                worked = _flags(attempt, cure)
                break
            stage.done((k + 1) / len(trials))
    tried = ", ".join(_flags(attempt, cure) for cure in trials)
    advice = f"With {worked} all is well." if worked else f"A dry run with each of {tried} does not cure it."
    out.complain(f"{bad[-1]} {advice}" if trials else bad[-1])
    out.say(suggestion=worked)


def _trials(attempt: Attempt) -> list[Cure]:
    """Lists cures in the order in which they are tried: the default method first."""
    patches, request = attempt.patches, attempt.request
    moving = patches.nodes
    fixed = np.setdiff1d(patches.fixed_nodes, moving)
    found = [Cure(method="default"), *cures(patches.mesh, moving, fixed, attempt.motion.path(attempt.wall, 1)[-1])]
    found = [dataclasses.replace(cure, steps=cure.steps * request.steps) for cure in found]
    return [cure for cure in found if cure.method != request.method.method]


def _flags(attempt: Attempt, cure: Cure) -> str:
    flags = [f"--sliding {' '.join(cure.sliding)} in place of --fixed"] if cure.sliding else []
    flags += [f"--method {cure.method}"] if cure.method else []
    return " ".join([*flags, *([f"--steps {cure.steps}"] if cure.steps != attempt.request.steps else [])])


def _works(attempt: Attempt, cure: Cure) -> bool:
    """Checks whether a cure leaves the mesh good. False if it is refused."""
    patches, method = attempt.patches, attempt.request.method
    fixed = tuple(name for name in patches.fixed if name not in cure.sliding)
    attempt = dataclasses.replace(
        attempt, patches=dataclasses.replace(patches, fixed=fixed, sliding=(*patches.sliding, *cure.sliding))
    )
    method = dataclasses.replace(method, method=cure.method or method.method)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            chunks = attempt.patches.chunks(attempt.patches.method(method), attempt.request.chunk)
            way = attempt.way(chunks, cure.steps)
        except (ValueError, ImportError):  # ImportError: a solver for large 3-D meshes is not installed
            return False
        return attempt.judge(way).ok
