"""Memory and time, foreseen before the work starts."""

import argparse
import dataclasses
import os

import numpy as np

from jaxmorph import Mesh
from jaxmorph._host.topology import FACES

from ._method import Choice

LARGE, LONG = 500_000, 30.0
"""Points, and seconds, from which on the estimate is told."""

START = 0.3e9
"""Bytes of the process before it has read anything."""

PAIR, POINT, CELL, SOURCES = 1.8e-9, {2: 5e-6, 3: 15e-6}, 8e-6, 1e-10
"""Seconds: of the sum for a pair of point and source, of preparing a point in 2-D and 3-D, of judging a cell; for sources cubed."""

FACE = 200
"""Bytes for each face of each cell while cells are judged: neighbours are found by sorting them."""

COMPILING = 2.0
"""Seconds that each stage takes on the smallest mesh."""


@dataclasses.dataclass(frozen=True)
class Estimate:
    """For n points, b surface nodes and s sources: bytes at the most, and seconds of the three long stages."""

    n: int
    b: int
    s: int
    memory: float
    preparing: float
    deforming: float
    judging: float

    @property
    def seconds(self) -> float:
        return self.preparing + self.deforming + self.judging

    @property
    def is_large(self) -> bool:
        return self.n >= LARGE or self.seconds >= LONG

    @property
    def is_too_large(self) -> bool:
        return self.memory > _physical_memory()

    def __str__(self) -> str:
        return (
            f"estimate {self.n} points, {self.b} surface nodes, {self.s} sources: about {self.memory / 1e9:.2g} GB, "
            f"{self.seconds:.2g} s"
        )


def estimate(mesh: Mesh, b: int, choice: Choice, arguments: argparse.Namespace) -> Estimate:
    """From measurements on one core of a server processor: good for the order of magnitude.

    With --chunk the plan is that of one chunk, but mesh and reports stand whole, and what depends on the surface is done for each.
    """
    n, d = mesh.points.shape
    s = b if arguments.method == "rbf" else choice.sources
    planned = n if arguments.chunk is None else min(n, b + arguments.chunk)
    parts = 1 if arguments.chunk is None else max(1, -(-(n - b) // arguments.chunk))
    size = np.dtype(arguments.dtype).itemsize / 8
    quality = FACE * sum(len(ids) * len(FACES[kind]) for kind, ids in mesh.cells.items())
    memory = START + size * (500 * (n + planned) + 24 * s**2) + quality
    solve = SOURCES * s**3
    preparing = COMPILING + (0 if arguments.method == "rbf" else (n + (parts - 1) * b) * POINT[d]) + parts * solve
    return Estimate(
        *(n, b, s, memory),
        preparing=preparing,
        deforming=COMPILING + arguments.steps * (n * s * PAIR + parts * solve),
        judging=COMPILING + 2 * CELL * sum(len(ids) for ids in mesh.cells.values()),
    )


def _physical_memory() -> float:
    try:
        return float(os.sysconf("SC_PAGE_SIZE")) * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return float("inf")
