"""One mesh and one motion, tried by several methods and in several numbers of steps."""

import dataclasses
import warnings
from collections.abc import Callable, Iterable

import numpy as np
from jaxtyping import Float, Int

import jaxmorph as jm
from jaxmorph._advice.methods import METHODS, entry
from jaxmorph._advice.rivals import MOST_POINTS
from jaxmorph._host.package.cores import Beside

from ._judged import Judged
from ._method import NamedMethod, Patches, in_double
from ._motion import Motion
from ._output import Output
from ._parts import Method
from ._requests import Deform
from ._summary import Summary
from ._tables import faults
from ._way import Way, followed

MORE = "more --sources or --steps"
CURES = tuple(method.name for method in METHODS if method.is_cure)
"""Methods that are tried after the default, where the mesh is small enough for them."""

PATIENCE = 120.0
"""Seconds that an attempt may have taken for others to be tried after it."""


@dataclasses.dataclass(frozen=True)
class Attempt:
    """All that an attempt needs but the method and the steps.

    `summing` sums up the `undeformed` mesh in another thread.
    """

    request: Deform
    patches: Patches
    motion: Motion
    undeformed: Judged
    summing: Beside[Summary]

    @property
    def before(self) -> Summary:
        """The summary of the undeformed mesh. Raises `ValueError` for what cannot be judged."""
        return self.summing.result()

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
        return Way.into(self.request.output, self.patches.mesh, list(ends.values()), is_straight)

    def judge(self, way: Way) -> tuple[Judged, Summary, list[str]]:
        """Judges the moved mesh, sums it up, and writes one sentence for each fault."""
        judged = Judged(self.patches.mesh, way.ends[-1], self.undeformed, way)
        after = Summary.from_judged(judged, self.request.gates.limits)
        return judged, after, faults(self.before, after)


def explain(attempt: Attempt, choice: NamedMethod, bad: list[str], out: Output) -> None:
    """Prints what is wrong, and other flags that cure it, if an attempt with them succeeds."""
    request = attempt.request
    for sentence in bad[:-1]:
        out.complain(sentence)
    if any(gate.beyond for gate in attempt.before.gates):  # no way of moving the mesh cures it
        out.complain(bad[-1])
        return
    hint = _hint(choice)
    if out.seconds > PATIENCE or not request.dry_run:
        out.complain(f"{bad[-1]} Try {hint}.")
        return
    worked = _tried(attempt, choice, out)
    advice = f"With {worked} all is well." if worked else f"A dry run with {hint} does not cure it."
    out.complain(f"{bad[-1]} {advice}")
    out.say(suggestion=worked)


def _hint(choice: NamedMethod) -> str:
    """Returns what to try after a method fails."""
    if choice.entry.name == "default":
        return f"{MORE}, or --method {' or '.join(CURES)}"
    default = "--method default"
    return {"some": f"{default}, or {MORE}", "all": f"more --steps, or {default}"}.get(choice.entry.sources, default)


def _tried(attempt: Attempt, choice: NamedMethod, out: Output) -> str:
    """Returns other flags of the first attempt whose mesh is good; empty if there is none."""
    first, steps = attempt.request.method, attempt.request.steps
    n, d = attempt.base.shape
    trials = _trials(first, steps, choice.sources, len(attempt.wall), n <= MOST_POINTS[d])
    with out.progress("trying others") as stage:
        for k, (method, number) in enumerate(trials):
            if _works(attempt, method, number):
                flags = [f"--method {method.method}"] if method.method != first.method else []
                flags += [f"--sources {method.sources}"] if method.sources != first.sources else []
                return " ".join([*flags, *([f"--steps {number}"] if number != steps else [])])
            stage.done((k + 1) / len(trials))
    return ""


def _trials(first: Method, steps: int, sources: int, most: int, with_cells: bool) -> list[tuple[Method, int]]:
    """Lists methods and numbers of steps, in the order in which they are tried."""
    if first.method != "default":
        better = dataclasses.replace(first, method="default")
        slower = [(first, 2 * steps)] if entry(first.method).sources == "all" else []
        return [*slower, (better, steps), (better, 4 * steps)]
    more = [dataclasses.replace(first, sources=min(factor * sources, most)) for factor in (2, 4)]
    trials = [(more[0], steps), (first, 2 * steps), (more[1], 4 * steps)]
    if with_cells and first.sources is None:
        trials += [(dataclasses.replace(first, method=name), steps) for name in CURES]
    return [trial for trial in trials if trial != (first, steps)]


def _works(attempt: Attempt, method: Method, steps: int) -> bool:
    """Checks whether another method leaves the mesh good. False if it refuses."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            chunks = attempt.patches.chunks(attempt.patches.method(method), attempt.request.chunk)
            way = attempt.way(chunks, steps)
        except (ValueError, ImportError):  # ImportError: a solver for large 3-D meshes is not installed
            return False
        return not attempt.judge(way)[2]
