"""Methods that `choose` tries beside radial functions: which, up to what size of mesh, and when one is better than another."""

import math
import time
import warnings
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import KDTree

from .._boundary.boundary import Boundary
from .._mesh.mesh import Mesh
from .._methods.base import AbstractMethod
from .._methods.cells.elasticity import LinearElasticity
from .._methods.cells.laplacian import Biharmonic
from .._methods.cells.springs import TorsionalSprings
from .._methods.delaunay import DelaunayGraph
from .._methods.inverse_distance import InverseDistance
from .._methods.multiscale import Multiscale
from .._methods.nearwall import NearWall
from .._methods.reconstruction import SurfaceReconstruction
from .._methods.rigid import RigidBlend
from .._plan.plan import Plan, deform
from .._plan.prepare import plan_of
from .._quality.quality import quality
from .._quality.wall_quality import wall_quality

WORTH, NOTICEABLE = 0.8, 1.0
"""Share of the smallest Jacobian ratio that a better method keeps, at least, and degrees by which it is closer to the angle."""

MOST_POINTS = {2: 100_000, 3: 40_000}
"""Points of a mesh up to which methods that solve on its cells are tried, by dimension: some ten seconds each."""

MOST_PAIRS = 300_000_000
"""Points times nodes of the surface up to which inverse distances are tried."""


def rivals(named: Boundary) -> dict[str, Callable[[], AbstractMethod]]:
    """Lists the methods that are tried by default, those that are linear in `u` first. Lengths are those of the boundary."""
    moving, fixed = named.points[named.moving], named.points[named.fixed]
    size = float(np.ptp(moving, axis=0).max())
    outer = float(KDTree(moving).query(fixed)[0].min()) if len(fixed) else 20 * size
    return {
        "graph": DelaunayGraph,
        "multiscale": lambda: Multiscale.whole(2 * size, 0.1),
        "biharmonic": Biharmonic,
        "elasticity": LinearElasticity,
        "torsional": TorsionalSprings,
        "turning": lambda: InverseDistance(rotations=True),
        "rigid": lambda: SurfaceReconstruction(RigidBlend(0.25 * size, outer), NearWall()),
    }


def too_large(method: AbstractMethod, named: Boundary) -> str | None:
    """Says why a mesh is too large for a method to be tried by default; None where it is not."""
    n, d = named.points.shape
    if method.needs_cells and n > MOST_POINTS[d]:
        return f"{n} points; a solve on the cells is tried up to {MOST_POINTS[d]}"
    if isinstance(method, InverseDistance) and n * len(named.nodes) > MOST_PAIRS:
        return f"{n} points times {len(named.nodes)} nodes of the surface; tried up to {MOST_PAIRS} pairs"
    return None


def tried(named: Boundary, method: AbstractMethod | None) -> Plan | Exception:
    """Prepares a plan, or returns what `prepare` raised."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a condition that the table tells
        try:
            return plan_of(named, method)
        except (ValueError, ImportError) as error:  # ImportError: a solver for large 3-D meshes is not installed
            return error


def others(
    mesh: Mesh, named: Boundary, methods: Mapping[str, AbstractMethod] | None, motions: np.ndarray
) -> list[tuple[dict[str, Any], Plan | None]]:
    """Tries the named methods, or those of `rivals`: a row of the table and a plan each, None where there is none."""
    makers = rivals(named) if methods is None else {name: lambda each=each: each for name, each in methods.items()}
    entries = []
    for name, make in makers.items():
        row = {"method": name, "leaves": None, "sources": None, "radius": None, "fit": False, "error": None}
        try:
            method = make()
            reason = too_large(method, named) if methods is None else None
            plan = ValueError(f"skipped: {reason}") if reason else tried(named, method)
        except ValueError as error:  # lengths that make no method
            plan = error
        if isinstance(plan, Plan):
            row["sources"] = len(plan.sources) or None
        entries.append(
            (row | {"rounding": None} | judged(mesh, plan, motions), plan if isinstance(plan, Plan) else None)
        )
    return entries


def judged(mesh: Mesh, plan: Plan | Exception, motions: np.ndarray) -> dict[str, Any]:
    """Measures the moved meshes and the CPU time of one `deform`, compiled before."""
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


def is_better(row: dict[str, Any], other: dict[str, Any]) -> bool:
    """Tells whether a row's method is to be taken in place of another's."""
    if row["inverted"] != other["inverted"]:
        return row["inverted"] < other["inverted"]
    closer = np.nan_to_num(other["angle"] - row["angle"])
    least = max(other["jacobian"], 0.0)
    holds_angle = closer > NOTICEABLE and row["jacobian"] >= WORTH * least
    holds_cells = closer > -NOTICEABLE and WORTH * row["jacobian"] > least
    return bool(holds_angle or holds_cells)
