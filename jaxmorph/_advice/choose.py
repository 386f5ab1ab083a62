"""Sources and support radius, chosen for a family of motions instead of guessed."""

import dataclasses
import math
import warnings
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, ArrayLike, Float, Real

from .._host.reduction import KDTree
from .._kernels.compile import compiled
from .._mesh.mesh import Mesh
from .._methods.base import AbstractMethod, Surface
from .._methods.basis import WendlandC2
from .._methods.fitted import FittedRBF
from .._methods.nearwall import NearWall
from .._methods.rbf import RBF
from .._methods.reconstruction import SurfaceReconstruction
from .._plan.door import Boundary, boundary
from .._plan.images import Images
from .._plan.periodic import Periodic
from .._plan.plan import Plan, deform
from .._plan.prepare import plan_of, surface_of
from .._plan.slide import Slide
from .._plan.symmetry import Plane
from .._quality.quality import quality
from .._quality.wall import wall_quality

COLUMNS = ("leaves", "sources", "radius", "fit", "error", "rounding", "inverted", "jacobian", "angle")

WORTH, NOTICEABLE = 0.8, 0.1
"""Share of the smallest Jacobian ratio that a fitted field keeps, at least, and degrees by which it is closer to the angle."""


@dataclasses.dataclass(frozen=True)
class Choice:
    """Holds the result of `choose`: the `method`, its `plan`, and a table of all that were tried, as text by `str`.

    `chosen` is the method's row of `table`. Each row has

    - `leaves`: those of the k-d tree on the moving nodes;
    - `sources`: how many control points in all;
    - `radius`: that of the Wendland C2 function, None for a thin plate spline;
    - `fit`: whether the field is fitted to the wall, `FittedRBF`, instead of interpolating;
    - `error`: the coarse field's error on the surface, relative to the largest displacement: root mean square over
      surface and motions;
    - `rounding`: the error that float64 makes of the system's condition, relative to it too; None with the fit;
    - `inverted`: inverted cells in all motions;
    - `jacobian`: the smallest Jacobian ratio in any; NaN where `prepare` refused;
    - `angle`: degrees by which first grid lines leave their angle to the wall, mean over nodes and motions. It is NaN where
      no cell has a side on the wall.
    """

    method: AbstractMethod
    plan: Plan
    table: tuple[dict[str, Any], ...]
    chosen: int

    def __str__(self) -> str:
        rows = [COLUMNS, *([_shown(row[name]) for name in COLUMNS] for row in self.table)]
        marks = [" ", *("*" if i == self.chosen else " " for i in range(len(self.table)))]
        return "\n".join(mark + "".join(f"{cell:>10}" for cell in row) for mark, row in zip(marks, rows, strict=True))


def _shown(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def choose(
    mesh: Mesh,
    moving: Any,
    fixed: Any,
    motions: Real[ArrayLike, "s m d"] | Sequence[Any],
    *,
    symmetry: Plane | Sequence[Plane] = (),
    periodic: Periodic | Sequence[Periodic] = (),
    sliding: Slide | str | Sequence[Slide | str] = (),
    leaves: Sequence[int] = (8, 32, 128),
    tolerance: float = 0.01,
) -> Choice:
    """Chooses sources, support radius, and whether to fit the field to the wall, for a family of motions.

    For each number of leaves a thin plate spline, a Wendland C2 function and a fitted thin plate spline are tried. The radius
    of the second minimises the sum of `error` and `rounding` (see `Choice`). It is found by optimistix's golden section search,
    between a fifth of the moving nodes' extent and ten times it.

    Candidates are good that invert fewest cells, miss the surface by no more than `tolerance` (asked of fields that
    interpolate), and keep 98 % of the best smallest Jacobian ratio. Of these the one with fewest sources is taken; where none
    is that good, the one with the largest Jacobian ratio. That is done for the fields that interpolate, and for the fitted ones.

    The fitted one is chosen if it inverts no more cells, leaves the grid lines closer to their angle to the wall, and keeps 80 %
    of the other's Jacobian ratio. A change of shape asks for it; a body that moves as a whole does not. Every motion is
    deformed and judged once for each of the 3 len(`leaves`) candidates.

    **Arguments:**

    - `mesh`, `moving`, `fixed`, `symmetry`, `periodic`, `sliding`: those of `prepare`.
    - `motions`: displacements (s, m, d) of the moving nodes that the mesh is to bear: modes, or samples.
    - `leaves`: numbers of leaves of the k-d tree to try, default 8, 32, 128.
    - `tolerance`: the error on the surface that is allowed, relative to the largest displacement. Default 0.01.

    **Returns:** a `Choice`.

    **Raises:** `ValueError` when `motions` is not (s, m, d), is zero or not finite, for no `leaves`, and what `prepare` raises
    where it refuses every candidate.
    """
    if not isinstance(mesh, Mesh):
        raise ValueError(f"call choose(mesh, moving, fixed, motions) with a Mesh, not {type(mesh).__name__}.")
    named = boundary(mesh, moving, fixed, symmetry, periodic=periodic, sliding=sliding)
    named.warn_of_free_faces()
    motions, expected = np.asarray(motions, dtype=float), (len(named.moving), mesh.points.shape[1])
    if motions.ndim != 3 or motions.shape[1:] != expected or not np.any(motions):
        raise ValueError(
            f"`motions` has shape {motions.shape}; expected (s, {expected[0]}, {expected[1]}), not all zero."
        )
    if not np.isfinite(motions).all():
        raise ValueError(f"{(~np.isfinite(motions)).sum()} components of `motions` are not finite.")
    if not len(leaves):
        raise ValueError("`leaves` is empty: name at least one number of leaves to try.")
    known = named.alone() if len(named.guided) else named
    surface, images, _ = surface_of(known)
    columns = _columns(motions, len(known.nodes), images)
    rows, plans, refused = [], [], None
    for is_fit, count, with_radius in _tries(leaves):
        coarse, row = _candidate(surface, columns, count, with_radius)
        plan, refused = _prepared(named, FittedRBF(coarse) if is_fit else coarse, refused)
        if is_fit:
            row |= {"error": _left(plan, motions), "rounding": None}
        rows.append(row | {"fit": is_fit} | _judged(mesh, plan, motions))
        plans.append(plan)
    if all(plan is None for plan in plans):
        raise refused or ValueError("every candidate was refused.")
    chosen = _best(rows, tolerance)
    return Choice(plans[chosen].method, plans[chosen], tuple(rows), chosen)


def _tries(leaves: Sequence[int]) -> list[tuple[bool, int, bool]]:
    """Lists what is tried: whether the field is fitted, the number of leaves, and whether its basis has a radius."""
    interpolating = [(False, count, with_radius) for count in leaves for with_radius in (False, True)]
    return interpolating + [(True, count, False) for count in leaves]


def _columns(motions: np.ndarray, nodes: int, images: Images | None) -> np.ndarray:
    """Lists the displacements of all rows of the surface, images too, motion after motion, scaled to a largest component of 1."""
    columns = []
    for motion in motions:
        vectors = np.zeros((nodes, motion.shape[1]))
        vectors[: len(motion)] = motion
        columns.append(vectors if images is None else np.asarray(images.extended(jnp.asarray(vectors))))
    joined = np.concatenate(columns, axis=1)
    return joined / np.abs(joined).max()


def _candidate(surface: Surface, columns: np.ndarray, count: int, with_radius: bool) -> tuple[RBF, dict[str, Any]]:
    rbf = RBF(reduction=KDTree(count, extremes=True))
    ids, points, values = (
        jnp.asarray(rbf.connect(surface, surface.points)[0]),
        jnp.asarray(surface.points),
        jnp.asarray(columns),
    )
    radius = None
    if with_radius:
        extent = float(np.ptp(surface.points[: surface.moving], axis=0).max())
        radius = extent * math.exp(float(_log_radius(rbf, ids, points, values, jnp.asarray(extent))))
        rbf = eqx.tree_at(lambda it: it.basis, rbf, WendlandC2(radius))
    missed, rounding = _errors(rbf, ids, points, values)
    return rbf, {
        "leaves": count,
        "sources": len(ids),
        "radius": radius,
        "error": float(missed),
        "rounding": float(rounding),
    }


@compiled
def _log_radius(rbf: RBF, ids, points, values, extent) -> Float[Array, ""]:
    """Searches the logarithm of the radius over the extent."""

    def loss(log_radius, _):
        wide = eqx.tree_at(lambda it: it.basis, rbf, WendlandC2(extent * jnp.exp(log_radius)))
        return jnp.log(sum(_errors(wide, ids, points, values)))

    bounds = {"lower": math.log(0.2), "upper": math.log(10.0)}
    start = jnp.zeros((), points.dtype)
    return optx.minimise(loss, optx.GoldenSearch(0.02, 0.02), start, options=bounds, max_steps=30, throw=False).value


@compiled
def _errors(rbf: RBF, ids, points, values) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Computes the root mean square of the error on the surface; and the size of the weights times the unit of rounding."""
    field = rbf.field(ids, rbf.fit(ids, points, points), points, values)
    missed = values - jax.lax.map(lambda x: field(x, None), points, batch_size=256)
    unit = float(jnp.finfo(field.beta.dtype).eps)
    return jnp.sqrt(jnp.mean(missed**2)), unit * jnp.max(jnp.sum(jnp.abs(field.beta), axis=1))


def _left(plan: Plan | None, motions: np.ndarray) -> float:
    """Measures the root mean square of what the coarse field leaves to the correction, over surface and motions."""
    if plan is None:
        return math.nan
    left = np.stack([np.asarray(plan.offset(jnp.asarray(u, plan.points.dtype))) for u in motions])
    return float(np.sqrt(np.mean(left**2)) / np.abs(motions).max())


def _prepared(
    named: Boundary, coarse: AbstractMethod, refused: ValueError | None
) -> tuple[Plan | None, ValueError | None]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a condition that the table tells
        try:
            return plan_of(named, SurfaceReconstruction(coarse, NearWall())), refused
        except ValueError as error:
            return None, error


def _judged(mesh: Mesh, plan: Plan | None, motions: np.ndarray) -> dict[str, Any]:
    if plan is None:
        return {"inverted": math.nan, "jacobian": math.nan, "angle": math.nan}
    moved = [deform(plan, jnp.asarray(u, plan.points.dtype)) for u in motions]
    reports = [quality(mesh, points) for points in moved]
    least = min(float(report.min_jacobian_ratio) for report in reports)
    try:
        angle = float(np.mean([wall_quality(mesh, np.asarray(plan.moving), points).mean_angle for points in moved]))
    except ValueError:  # no cell has a side on the wall
        angle = math.nan
    return {"inverted": sum(int(report.inverted) for report in reports), "jacobian": least, "angle": angle}


def _best(rows: list[dict[str, Any]], error: float) -> int:
    """Picks the fitted row or the other one, of the best of each kind."""
    usable = [i for i, row in enumerate(rows) if not math.isnan(row["jacobian"])]
    first, *others = (
        _best_of(rows, kind, error) for fit in (False, True) if (kind := [i for i in usable if rows[i]["fit"] is fit])
    )
    if not others:
        return first
    plain, fitted = rows[first], rows[others[0]]
    is_better = fitted["inverted"] < plain["inverted"]
    is_worth_it = fitted["angle"] < plain["angle"] - NOTICEABLE and fitted["jacobian"] >= WORTH * plain["jacobian"]
    return others[0] if is_better or (fitted["inverted"] == plain["inverted"] and is_worth_it) else first


def _best_of(rows: list[dict[str, Any]], usable: list[int], error: float) -> int:
    """Picks the row with fewest sources among the good ones."""
    fewest = min(rows[i]["inverted"] for i in usable)
    sound = [i for i in usable if rows[i]["inverted"] == fewest]
    best = max(rows[i]["jacobian"] for i in sound)
    near = [i for i in sound if rows[i]["jacobian"] >= best - 0.02 * abs(best)]
    good = [i for i in near if rows[i]["fit"] or rows[i]["error"] <= error]
    if good:
        return min(good, key=lambda i: (rows[i]["sources"], -rows[i]["jacobian"]))
    return max(sound, key=lambda i: rows[i]["jacobian"])
