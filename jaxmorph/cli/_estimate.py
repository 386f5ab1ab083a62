"""Memory and time, foreseen before the work starts."""

import argparse
import dataclasses
import os

import numpy as np

from jaxmorph import Mesh

from ._method import Choice

LARGE = 500_000
"""Points from which on the estimate is told."""

PAIR = 1.8e-9
"""Seconds for a pair of a point and a source, one core."""

POINT = {"graph": 4e-6, "none": 4e-7}
"""Seconds of preparation for a point, with and without location in the Delaunay graph."""

KEPT = {"graph": 400, "none": 60}
"""Bytes that a plan and the quality report keep for a point of the mesh and its cells."""


@dataclasses.dataclass(frozen=True)
class Estimate:
    """For n points, b surface nodes and s sources: bytes at the most, and seconds of the two long stages."""

    n: int
    b: int
    s: int
    memory: float
    preparing: float
    deforming: float

    @property
    def is_large(self) -> bool:
        return self.n >= LARGE

    @property
    def is_too_large(self) -> bool:
        return self.memory > _physical_memory()

    def __str__(self) -> str:
        return (
            f"estimate {self.n} points, {self.b} surface nodes, {self.s} sources: about {self.memory / 1e9:.2g} GB, "
            f"{self.preparing:.2g} s to prepare, {self.deforming:.2g} s to deform"
        )


def estimate(mesh: Mesh, moving: int, fixed: int, choice: Choice, arguments: argparse.Namespace) -> Estimate:
    """From what was measured on one core (double precision; the order of magnitude is what it is good for)."""
    n, d = mesh.points.shape
    s = choice.sources
    if arguments.method == "rbf":
        s += fixed
    kind = "none" if arguments.method == "rbf" else "graph"
    size = np.dtype(arguments.dtype).itemsize / 8
    cells = sum(len(corners) for corners in mesh.cells.values())
    memory = size * (n * KEPT[kind] + 3 * 8 * s**2 + 3 * d * 8 * n) + cells * 8 * 40
    deforming = arguments.steps * (n * s * PAIR + 1e-10 * s**3)
    return Estimate(n, moving + fixed, s, memory, 1.0 + n * POINT[kind] + 1e-10 * s**3, 1.0 + deforming)


def _physical_memory() -> float:
    try:
        return float(os.sysconf("SC_PAGE_SIZE")) * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return float("inf")
