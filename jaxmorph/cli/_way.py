"""The way of a motion: the points at which its steps end, and what is proven of it."""

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

import jaxmorph as jm
from jaxmorph import Mesh, io


@dataclasses.dataclass(frozen=True, eq=False)
class Way:
    """Points (n, d) at which the steps of a motion end, the last one last.

    The last ones are as the written file will hold them, rounded where it is in single precision.

    - `is_straight`: nodes move along straight lines from one end to the next, for the plan is
      linear.
    - `moved` (n, d): the last points before they are written.
    """

    ends: tuple[Float[np.ndarray, "n d"], ...]
    is_straight: bool
    moved: Float[np.ndarray, "n d"]

    @classmethod
    def into(cls, path: Path, mesh: Mesh, ends: Sequence[np.ndarray], is_straight: bool) -> "Way":
        """Makes the way of a motion whose last points will be written to a file."""
        stored = io.as_written(path, mesh.moved(ends[-1]))
        return cls((*ends[:-1], stored), is_straight, ends[-1])

    def proofs(self, mesh: Mesh) -> list[jm.Proof]:
        """Proves each step at all of its instants; where it ends if nodes leave straight lines."""
        starts = (mesh.points, *self.ends)
        bases = starts if self.is_straight else [None] * len(starts)
        return [jm.proof(mesh, end, base=base) for base, end in zip(bases, self.ends, strict=False)]


def followed(plan: jm.Plan, path: Any) -> Iterator[jax.Array]:
    """Yields the points at the end of each step of a path of total displacements (k, m, d)."""
    if len(path) == 1:
        yield jm.deform(plan, path[0])
        return
    plans, end = jm.march(plan, path)
    yield from (step.points for step in plans[1:])
    yield end


def instants(is_straight: bool, steps: int) -> str:
    """Writes for which instants of a motion `Way.proofs` holds."""
    if is_straight:
        return "at every instant of the motion" + (f", step by step in {steps} steps" if steps > 1 else "")
    end = f"where each of {steps} steps ends" if steps > 1 else "where the motion ends"
    return f"{end}, but not on the way, where nodes leave straight lines"
