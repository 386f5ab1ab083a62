"""A motion of a mesh: its points step by step, the verdict on them, and their file."""

import contextvars
import dataclasses
import functools
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import ArrayLike, Float, Int

import jaxmorph as jm
from jaxmorph import Mesh, io

from ._output import Output, wrap
from ._parser import flag_of

SMALLEST_MOTION = 1e-4
LARGEST_MOTION = 10.0
"""Displacements over the length of what moves beyond which units are doubted."""

PROVEN_GATE = "min_proven_margin"

T = TypeVar("T")
Points = Float[np.ndarray, "n d"]


def in_background(function: Callable[..., T], *arguments: Any) -> "Future[T]":
    """Calls a function in a thread, in the context of the caller."""
    pool = ThreadPoolExecutor(1)
    future = pool.submit(contextvars.copy_context().run, function, *arguments)
    pool.shutdown(wait=False)
    return future


@dataclasses.dataclass(frozen=True, eq=False)
class Way:
    """The motion of a mesh, and the file that the moved mesh becomes.

    - `mesh`: the undeformed mesh.
    - `ends`: points (n, d) after each step, in double precision.
    - `is_straight`: nodes move along straight lines in each step, for the plan is linear.
    """

    path: Path
    mesh: Mesh
    ends: tuple[Points, ...]
    is_straight: bool = True

    @functools.cached_property
    def stored(self) -> Points:
        return io.as_written(self.path, self.mesh.moved(self.ends[-1]))

    def judge(
        self,
        limits: jm.Limits | None = None,
        before: jm.Verdict | None = None,
        part: int | None = None,
    ) -> jm.Verdict:
        return jm.judge(
            self.mesh,
            self.stored,
            limits,
            before=before,
            part=part,
            steps=self.ends[:-1],
            is_straight=self.is_straight,
        )

    def write(self, verdict: jm.Verdict) -> None:
        moved = self.mesh.moved(self.ends[-1])
        if (
            io.check_output(self.path, self.mesh) and verdict.corners is not None
        ):  # a format that holds arrays
            io.write_moved(self.path, self.mesh, moved, verdict.corners)
        else:
            io.write(self.path, moved)


def move_in_steps(
    plan: "jm.Plan", path: Any, base: Points, nodes: np.ndarray, u: Any
) -> Iterator[Points]:
    """Yields the points after each step of a path; those at `nodes` move by `u` (k, m, d)."""
    plans, end = jm.march(plan, path)
    for move, points in zip(u, [*(step.points for step in plans[1:]), end], strict=True):
        yield to_double(base, np.asarray(points)[: len(base)], nodes, move, plan.method.exact)


def to_double(
    base: Points,
    moved: Float[ArrayLike, "n d"],
    nodes: Int[np.ndarray, " m"],
    u: Float[np.ndarray, "m d"],
    is_exact: bool,
) -> Points:
    """Converts points to double precision; unmoved nodes keep all their digits."""
    moved = np.asarray(moved)
    if moved.dtype == np.float64:
        return moved
    points = base + (moved.astype(float) - base.astype(moved.dtype).astype(float))
    if is_exact:
        points[nodes] = base[nodes] + u
    return points


def warn_of_size(share: float, out: Output) -> None:
    """Warns of a motion by a `share` of the length of what moves that looks like another unit."""
    if 0 < share < SMALLEST_MOTION or share > LARGEST_MOTION:
        out.warn(
            f"the wall moves by {share:.3g} times the length of what moves: has the motion the "
            "unit of the mesh (m or mm), and are angles in degrees?"
        )


def check_picture(picture: Path | None) -> None:
    """Raises `ImportError` where an extra is missing."""
    if picture is not None:
        from jaxmorph import plot  # noqa: F401


def draw(
    picture: Path | None, mesh: Mesh, out: Output, points: Any = None, **settings: Any
) -> None:
    """Draws a mesh, or before and after; one that fails is a warning: the rest is worth more."""
    if picture is not None:
        paint(picture, out, lambda plot, file: plot.picture(file, mesh, points, **settings))


def paint(file: Path, out: Output, call: Callable[[Any, Path], None]) -> None:
    try:
        with out.progress("drawing"):
            from jaxmorph import plot

            call(plot, file)
        out.say(f"picture  {file}")
        out.facts.setdefault("picture", str(file))
    except (ValueError, OSError) as error:
        out.warn(f"no picture: {error}")


def faults(verdict: jm.Verdict) -> list[str]:
    return verdict.faults(
        lambda gate: (
            "--proven" if gate.name == PROVEN_GATE else f"{flag_of(gate.name)} {gate.limit:g}"
        )
    )


def is_kept(bad: list[str], allow_inverted: bool, output: Path, out: Output) -> bool:
    for sentence in bad:
        out.complain(sentence)
    if bad and not allow_inverted:
        out.complain(f"{output} is not written; --allow-inverted writes it anyway.")
    return not bad or allow_inverted


def finish(
    bad: list[str], allow_inverted: bool, output: Path, write: Callable[[], None], out: Output
) -> int:
    """Writes a mesh where it is good or bad ones are allowed; returns the exit status."""
    if not is_kept(bad, allow_inverted, output, out):
        return 1
    was_there = output.is_file()
    with out.progress(f"writing {output.name}"):
        write()
    out.wrote(output, was_there)
    return 1 if bad else 0


def say_verdict(
    verdict: jm.Verdict,
    out: Output,
    *,
    is_straight: bool = True,
    steps: int = 1,
    more: Sequence[str] = (),
) -> None:
    """Prints the quality before and after a motion, `more` rows, and what `--proven` proves."""
    assert verdict.before is not None
    out.say(
        f"\n{verdict.table(more)}\n",
        before=verdict.before.facts,
        after=verdict.facts,
        gates=verdict.gate_facts,
    )
    if verdict.note:
        out.say(f"{wrap(verdict.note)}\n", folded_before=verdict.before.inverted)
    for gate in (gate for gate in verdict.gates if gate.name == PROVEN_GATE):
        valid = verdict.cells - gate.beyond
        when = instants(is_straight, steps)
        out.say(wrap(f"proven: {valid} of {verdict.cells} cells fold nowhere inside, {when}."))
        out.say(proven={"cells": valid, "steps": steps, "on_the_way": is_straight})


def instants(is_straight: bool, steps: int) -> str:
    if is_straight:
        return "at every instant of the motion" + (
            f", step by step in {steps} steps" if steps > 1 else ""
        )
    end = f"where each of {steps} steps ends" if steps > 1 else "where the motion ends"
    return f"{end}, but not on the way, where nodes leave straight lines"
