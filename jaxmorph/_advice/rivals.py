"""Methods that `choose` tries beside radial functions, and how it measures them."""

import dataclasses
import functools
import math
import time
import warnings
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._boundary.boundary import Boundary
from .._host.package.rounding import Tree
from .._mesh.mesh import Mesh
from .._methods.base import AbstractMethod
from .._methods.inverse_distance import InverseDistance
from .._plan.deform import deform
from .._plan.plan import Plan
from .._plan.prepare import plan_of
from .._quality.quality import quality
from .._quality.wall_quality import wall_quality
from .methods import METHODS

MOST_POINTS = {2: 100_000, 3: 40_000}
"""Points of a mesh, by dimension, up to which methods on its cells are tried."""

MOST_PAIRS = 300_000_000
"""Points times nodes of the surface up to which inverse distances are tried."""


@dataclasses.dataclass(frozen=True)
class Extent:
    """Lengths of a boundary, from the points of its moving and its fixed nodes."""

    moving: Float[np.ndarray, "m d"]
    fixed: Float[np.ndarray, "f d"]

    @property
    def size(self) -> float:
        return float(np.ptp(self.moving, axis=0).max())

    @property
    def gap(self) -> float:
        """The distance from moving to fixed nodes; 20 times the size without fixed nodes."""
        return float(Tree(self.moving).query(self.fixed)[0].min()) if len(self.fixed) else 20 * self.size


def too_large(method: AbstractMethod, boundary: Boundary) -> str | None:
    """Returns why a mesh is too large to try a method by default; None if it is small enough."""
    n, d = boundary.points.shape
    if method.needs_cells and n > MOST_POINTS[d]:
        return f"{n} points; a solve on the cells is tried up to {MOST_POINTS[d]}"
    if isinstance(method, InverseDistance) and n * len(boundary.nodes) > MOST_PAIRS:
        return f"{n} points times {len(boundary.nodes)} nodes of the surface; tried up to {MOST_PAIRS} pairs"
    return None


def tried(boundary: Boundary, method: AbstractMethod | None) -> Plan | Exception:
    """Prepares a plan, or returns what `prepare` raised."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a bad condition, which is in the table
        try:
            return plan_of(boundary, method)
        except (ValueError, ImportError) as error:  # ImportError: a solver for large 3-D meshes is not installed
            return error


def others(
    mesh: Mesh, boundary: Boundary, methods: Mapping[str, AbstractMethod] | None, motions: np.ndarray
) -> list[tuple[dict[str, Any], Plan | None]]:
    """Tries the named methods, by default all of the list.

    It returns a row of the table and a plan for each method; None for a method without a plan.
    """
    wall = Extent(boundary.points[boundary.moving], boundary.points[boundary.fixed])
    makers = {entry.name: functools.partial(entry.make, wall) for entry in METHODS if entry.is_tried}
    if methods is not None:
        makers = {name: lambda method=method: method for name, method in methods.items()}
    entries = []
    for name, make in makers.items():
        row = {"method": name, "leaves": None, "sources": None, "radius": None, "fit": False, "error": None}
        try:
            method = make()
            reason = too_large(method, boundary) if methods is None else None
            plan = ValueError(f"skipped: {reason}") if reason else tried(boundary, method)
        except ValueError as error:  # lengths that make no method
            plan = error
        if isinstance(plan, Plan):
            row["sources"] = len(plan.sources) or None
        entries.append(
            (row | {"rounding": None} | judged(mesh, plan, motions), plan if isinstance(plan, Plan) else None)
        )
    return entries


def judged(mesh: Mesh, plan: Plan | Exception, motions: np.ndarray) -> dict[str, Any]:
    """Measures the moved meshes, and the CPU time of one compiled `deform`."""
    if isinstance(plan, Exception):
        nothing = dict.fromkeys(("inverted", "jacobian", "angle", "seconds"), math.nan)
        return nothing | {"refused": str(plan) or repr(plan)}
    moved = [deform(plan, jnp.asarray(u, plan.points.dtype)) for u in motions]
    jax.block_until_ready(moved)
    began = time.process_time()
    jax.block_until_ready(deform(plan, jnp.asarray(motions[0], plan.points.dtype)))
    seconds = time.process_time() - began
    reports = [quality(mesh, points) for points in moved]
    least = min(float(report.min_jacobian_ratio) for report in reports)
    try:
        angle = float(np.mean([wall_quality(mesh, np.asarray(plan.moving), points).mean_angle for points in moved]))
    except ValueError:  # no cell has a side on the wall
        angle = math.nan
    count = sum(int(report.inverted) for report in reports)
    return {"inverted": count, "jacobian": least, "angle": angle, "seconds": seconds, "refused": None}
