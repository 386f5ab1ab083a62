"""A motion of a mesh: its points step by step, the verdict on them, and the file that they become."""

import dataclasses
import functools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import ArrayLike, Float, Int

import jaxmorph as jm
from jaxmorph import Mesh, io

from ._output import Output, wrapped
from ._parser import flag_of


@dataclasses.dataclass(frozen=True, eq=False)
class Way:
    """The motion of a mesh, and the file that the moved mesh becomes.

    - `mesh`: the undeformed mesh.
    - `ends`: points (n, d) after each step, in double precision.
    - `is_straight`: nodes move along straight lines in each step, for the plan is linear.
    """

    path: Path
    mesh: Mesh
    ends: tuple[Float[np.ndarray, "n d"], ...]
    is_straight: bool

    @functools.cached_property
    def stored(self) -> Float[np.ndarray, "n d"]:
        """The last points as the file holds them, rounded where it is in single precision."""
        return io.as_written(self.path, self.mesh.moved(self.ends[-1]))

    def judge(self, limits: jm.Limits, before: jm.Verdict | None = None, part: int | None = None) -> jm.Verdict:
        motion: dict[str, Any] = {"steps": self.ends[:-1], "is_straight": self.is_straight}
        return jm.judge(self.mesh, self.stored, limits, before=before, part=part, **motion)

    def write(self, verdict: Callable[[], jm.Verdict]) -> None:
        """Writes the moved mesh; a format that holds arrays waits for the verdict on its cells."""
        moved = self.mesh.moved(self.ends[-1])
        if io.check_output(self.path, self.mesh):
            io.write_moved(self.path, self.mesh, moved, verdict().corners)
        else:
            io.write(self.path, moved)


def followed(plan: jm.Plan, path: Any) -> Iterator[jax.Array]:
    """Yields the points at the end of each step of a path of total displacements (k, m, d)."""
    if len(path) == 1:
        yield jm.deform(plan, path[0])
        return
    plans, end = jm.march(plan, path)
    yield from (step.points for step in plans[1:])
    yield end


def in_double(
    base: Float[np.ndarray, "n d"],
    moved: Float[ArrayLike, "n d"],
    nodes: Int[np.ndarray, " m"],
    u: Float[np.ndarray, "m d"],
    is_exact: bool,
) -> Float[np.ndarray, "n d"]:
    """Converts moved points to double precision.

    Nodes that do not move in single precision keep all their digits.
    """
    moved = np.asarray(moved)
    if moved.dtype == np.float64:
        return moved
    points = base + (moved.astype(float) - base.astype(moved.dtype).astype(float))
    if is_exact:
        points[nodes] = base[nodes] + u
    return points


def faults(verdict: jm.Verdict) -> list[str]:
    """Lists what is wrong, with limits by their flags."""
    return verdict.faults(lambda gate: "--proven" if gate.name == PROVEN else f"{flag_of(gate.name)} {gate.limit:g}")


PROVEN = "min_proven_margin"
"""The limit that `--proven` sets."""


def say_proven(verdict: jm.Verdict, is_straight: bool, steps: int, out: Output) -> None:
    """Says how many cells the gate `--proven` has proven, and for which instants of the motion."""
    beyond = [gate.beyond for gate in verdict.gates if gate.name == PROVEN]
    if not beyond:
        return
    valid = verdict.cells - beyond[0]
    wrapped(out, f"proven: {valid} of {verdict.cells} cells fold nowhere inside, {instants(is_straight, steps)}.")
    out.say(proven={"cells": valid, "steps": steps, "on_the_way": is_straight})


def instants(is_straight: bool, steps: int) -> str:
    """Writes for which instants of a motion `--proven` holds."""
    if is_straight:
        return "at every instant of the motion" + (f", step by step in {steps} steps" if steps > 1 else "")
    end = f"where each of {steps} steps ends" if steps > 1 else "where the motion ends"
    return f"{end}, but not on the way, where nodes leave straight lines"
