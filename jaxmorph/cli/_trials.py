"""Trials after a bad mesh: other methods and numbers of steps that might cure it."""

import dataclasses
import warnings

from jaxmorph._advice.rivals import MOST_POINTS

from . import _gates
from ._attempt import Attempt
from ._method import NamedMethod, named_method
from ._output import Output
from ._requests import Method

MORE = "more --sources or --steps"
ON_CELLS = ("elasticity", "torsional")
"""Methods on the cells that are tried after the default, where the mesh is small enough for them."""
HINTS = {
    "default": f"{MORE}, or --method {' or '.join(ON_CELLS)}",
    "published": f"--method default, or {MORE}",
    "rbf": "more --steps",
}
"""Advice when cells are bad, for other methods to take the default."""

PATIENCE = 120.0
"""Seconds that an attempt may have taken for others to be tried after it."""


def explain(attempt: Attempt, choice: NamedMethod, bad: list[str], out: Output) -> None:
    """Tells what is wrong, and which other flags cure it, if an attempt with them does."""
    request = attempt.request
    for sentence in bad[:-1]:
        out.complain(sentence)
    if _gates.hopeless(request.gates, attempt.before):
        out.complain(bad[-1])
        return
    hint = HINTS.get(request.method.name, "--method default")
    if out.seconds > PATIENCE or not request.dry_run:
        out.complain(f"{bad[-1]} Try {hint}.")
        return
    worked = _tried(attempt, choice, out)
    advice = f"With {worked} all is well." if worked else f"A dry run with {hint} does not cure it."
    out.complain(f"{bad[-1]} {advice}")
    out.say(suggestion=worked)


def _tried(attempt: Attempt, choice: NamedMethod, out: Output) -> str:
    """Returns the flags of the first attempt whose mesh is good, beside the requested ones; nothing if none is."""
    asked, steps = attempt.request.method, attempt.request.steps
    n, d = attempt.base.shape
    trials = _trials(asked, steps, choice.sources, len(attempt.wall), n <= MOST_POINTS[d])
    with out.progress("trying others") as stage:
        for k, (method, count) in enumerate(trials):
            if _works(attempt, method, count):
                flags = [f"--method {method.name}"] if method.name != asked.name else []
                flags += [f"--sources {method.sources}"] if method.sources != asked.sources else []
                return " ".join([*flags, *([f"--steps {count}"] if count != steps else [])])
            stage.done((k + 1) / len(trials))
    return ""


def _trials(asked: Method, steps: int, sources: int, most: int, with_cells: bool) -> list[tuple[Method, int]]:
    """Lists methods and numbers of steps, in the order in which they are tried."""
    if asked.name not in ("default", "rbf"):
        better = dataclasses.replace(asked, name="default")
        return [(better, steps), (better, 4 * steps)]
    if asked.name == "rbf":
        return [(asked, 2 * steps), (asked, 4 * steps)]
    more = [dataclasses.replace(asked, sources=min(factor * sources, most)) for factor in (2, 4)]
    trials = [(more[0], steps), (asked, 2 * steps), (more[1], 4 * steps)]
    if with_cells and asked.sources is None:
        trials += [(dataclasses.replace(asked, name=name), steps) for name in ON_CELLS]
    return [trial for trial in trials if trial != (asked, steps)]


def _works(attempt: Attempt, method: Method, steps: int) -> bool:
    """Tells whether another method leaves the mesh good. False if it refuses."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            points = attempt.points(
                attempt.patches.chunks(named_method(method, attempt.wall), attempt.request.chunk), steps
            )
        except (ValueError, ImportError):  # ImportError: a solver for large 3-D meshes is not installed
            return False
        return not attempt.judge(points)[1]
