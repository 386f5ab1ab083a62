"""Method, sources and support radius, chosen for a family of motions instead of guessed."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Real

from .._boundary.boundary import Boundary
from .._boundary.images import Images
from .._boundary.periodic import Periodic
from .._boundary.slide import Slide
from .._boundary.symmetry import Plane
from .._host.package.arguments import between, checked, whole
from .._host.sources.reduction import KDTree
from .._kernels.compile import compiled
from .._mesh.mesh import Mesh
from .._methods.base import AbstractMethod, check_kind
from .._methods.nearwall import NearWall
from .._methods.rbf.basis import WendlandC2
from .._methods.rbf.fitted import FittedRBF
from .._methods.rbf.rbf import RBF
from .._methods.reconstruction import SurfaceReconstruction
from .._methods.surface import Surface
from .._plan.plan import Plan
from .._plan.prepare import surface_of
from .choice import Choice, best
from .resolved import leaves_enough
from .rivals import judged, others, tried


@checked
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
    methods: Mapping[str, AbstractMethod] | None = None,
) -> Choice:
    """Chooses a method, its sources and support radius for a family of motions.

    It also decides whether to fit the field to the wall.

    For each number of `leaves` a thin plate spline, a Wendland C2 function and a fitted thin plate
    spline are tried. In 3-D one more number is tried where the motions need more sources. The
    radius of the Wendland C2 function minimises the sum of `error` and `rounding` (see `Choice`).
    Optimistix's golden section search finds it between 0.2 and 10 times the moving nodes' extent.

    Of the rows that invert fewest cells and keep 80 % of the best Jacobian ratio, the first is
    chosen whose angle is within a degree of the best. Rows stand in the order of the table: radial
    functions by their number of leaves, then fitted fields, then all other methods. Fields that
    interpolate and miss the surface by more than `tolerance` are left out, unless no other row
    inverts as few cells.

    The other methods are, in this order: `DelaunayGraph`, `Multiscale.whole`, `Biharmonic`,
    `LinearElasticity`, `TorsionalSprings`, `InverseDistance(rotations=True)` and `RigidBlend`,
    corrected by `NearWall`. The last two are not linear in `u`. Methods on the cells are skipped
    beyond 100,000 points in 2-D and 40,000 in 3-D; inverse distances beyond 3e8 pairs of a point
    and a node of the surface. The table says so. Every motion is deformed and judged once for each
    row.

    **Arguments:**

    - `mesh`, `moving`, `fixed`, `symmetry`, `periodic`, `sliding`: as for `prepare`.
    - `motions`: displacements (s, m, d) of the moving nodes that the mesh is to bear: modes, or
      samples.
    - `leaves`: numbers of leaves of the k-d tree to try, default 8, 32, 128.
    - `tolerance`: the error on the surface that is allowed, relative to the largest displacement.
      Default 0.01.
    - `methods`: other methods to try, by their names in the table. Default: the methods above. With
      `{}` there are radial functions alone.

    **Returns:** a `Choice`.

    **Raises:** `ValueError` when `motions` is not (s, m, d), is zero or not finite, for no
    `leaves`, and for `methods` that are no methods by name. Also what `prepare` raises where it
    refuses every candidate.
    """
    boundary = Boundary(mesh, moving, fixed, symmetry=symmetry, periodic=periodic, sliding=sliding)
    boundary.warn_of_free_faces()
    motions = _checked_motions(motions, (len(boundary.moving), mesh.points.shape[1]))
    _check_tries(leaves, tolerance, methods)
    leaves = _resolving(leaves, boundary.points[boundary.moving], motions)
    known = boundary.alone() if len(boundary.guided) else boundary
    surface, images, _ = surface_of(known)
    columns = _columns(motions, len(known.nodes), images)
    rows, plans, refused = [], [], None
    for trial in _tries(leaves):
        row, plan = _radial(boundary, surface, columns, motions, trial)
        refused = plan if isinstance(plan, Exception) else refused
        rows.append(row | judged(mesh, plan, motions))
        plans.append(plan if isinstance(plan, Plan) else None)
    for row, plan in others(mesh, boundary, methods, motions):
        rows.append(row)
        plans.append(plan)
    if all(plan is None for plan in plans):
        raise refused or ValueError("every candidate was refused.")
    chosen = best(rows, tolerance)
    return Choice(plans[chosen].method, plans[chosen], tuple(rows), chosen)


def _checked_motions(motions: Any, expected: tuple[int, int]) -> np.ndarray:
    motions = np.asarray(motions, dtype=float)
    if motions.ndim != 3 or motions.shape[1:] != expected or not np.any(motions):
        raise ValueError(
            f"`motions` has shape {motions.shape}; expected (s, {expected[0]}, {expected[1]}), not all zero."
        )
    bad = np.argwhere(~np.isfinite(motions))
    if len(bad):
        raise ValueError(
            f"{len(bad)} components of `motions` are not finite, the first in motion {bad[0, 0]}, of moving node {bad[0, 1]}."
        )
    return motions


def _check_tries(leaves: Sequence[int], tolerance: float, methods: Mapping[str, AbstractMethod] | None) -> None:
    if not len(leaves):
        raise ValueError("`leaves` is empty: name at least one number of leaves to try.")
    for count in leaves:
        whole("leaves", count)
    between("tolerance", tolerance, 0, ends="[)")
    for name, method in (methods or {}).items():
        if not isinstance(name, str):
            raise ValueError(f"a name in `methods` is {name!r}; names are words, as in methods={{'soft': ...}}.")
        check_kind(method, AbstractMethod, f'methods["{name}"]', "jm.LinearElasticity()")


def _tries(leaves: Sequence[int]) -> list[tuple[bool, int, bool]]:
    """Lists the trials: whether the field is fitted, leaves, whether the basis has a radius."""
    interpolating = [(False, count, with_radius) for count in leaves for with_radius in (False, True)]
    return interpolating + [(True, count, False) for count in leaves]


def _resolving(leaves: Sequence[int], points: np.ndarray, motions: np.ndarray) -> Sequence[int]:
    """Adds a number of leaves in 3-D whose sources resolve all motions, if no number does yet."""
    if points.shape[1] == 2:
        return leaves
    enough = max(leaves_enough(points, motion) or 0 for motion in motions)
    return (*leaves, enough) if enough > max(leaves) else leaves


def _columns(motions: np.ndarray, nodes: int, images: Images) -> np.ndarray:
    """Lists the displacements of all rows of the surface, with images, motion after motion.

    They are scaled to a largest component of 1.
    """
    columns = []
    for motion in motions:
        vectors = np.zeros((nodes, motion.shape[1]))
        vectors[: len(motion)] = motion
        columns.append(np.asarray(images.extended(jnp.asarray(vectors))))
    joined = np.concatenate(columns, axis=1)
    return joined / np.abs(joined).max()


def _radial(
    boundary: Boundary, surface: Surface, columns: np.ndarray, motions: np.ndarray, trial: tuple[bool, int, bool]
) -> tuple[dict[str, Any], Plan | Exception]:
    """Tries one radial function: the first cells of its row, and the plan or what refused it."""
    is_fit, count, with_radius = trial
    row: dict[str, Any] = {"leaves": count} | dict.fromkeys(("sources", "radius", "error", "rounding"))
    try:
        coarse, facts = _candidate(surface, columns, count, with_radius)
        row |= facts
        plan = tried(boundary, SurfaceReconstruction(FittedRBF(coarse) if is_fit else coarse, NearWall()))
    except ValueError as error:  # sources that determine no field
        plan = error
    if is_fit:
        row |= {"error": _left(plan, motions) if isinstance(plan, Plan) else None, "rounding": None}
    name = "fitted" if is_fit else "Wendland C2" if with_radius else "thin plate"
    return {"method": name} | row | {"fit": is_fit}, plan


def _candidate(surface: Surface, columns: np.ndarray, count: int, with_radius: bool) -> tuple[RBF, dict[str, Any]]:
    rbf = RBF(reduction=KDTree(count, extremes=True))
    ids, points, values = map(jnp.asarray, (rbf.chosen(surface), surface.points, columns))
    radius = None
    if with_radius:
        extent = _extent(surface.points[: surface.moving]) or _extent(surface.points)
        radius = extent * math.exp(float(_log_radius(rbf, ids, points, values, jnp.asarray(extent))))
        rbf = eqx.tree_at(lambda it: it.basis, rbf, WendlandC2(radius))
    missed, rounding = _errors(rbf, ids, points, values)
    return rbf, {"sources": len(ids), "radius": radius, "error": float(missed), "rounding": float(rounding)}


def _extent(points: np.ndarray) -> float:
    return float(np.ptp(points, axis=0).max())


@compiled
def _log_radius(rbf: RBF, ids, points, values, extent) -> Float[Array, ""]:

    def loss(log_radius, _):
        wide = eqx.tree_at(lambda it: it.basis, rbf, WendlandC2(extent * jnp.exp(log_radius)))
        return jnp.log(sum(_errors(wide, ids, points, values)))

    bounds = {"lower": math.log(0.2), "upper": math.log(10.0)}
    start = jnp.zeros((), points.dtype)
    import optimistix as optx  # not before it is needed: it takes a quarter of a second

    return optx.minimise(loss, optx.GoldenSearch(0.02, 0.02), start, options=bounds, max_steps=30, throw=False).value


@compiled
def _errors(rbf: RBF, ids, points, values) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Computes the root mean square error on the surface, and an estimate of its rounding.

    The estimate is the size of the weights times the unit of rounding.
    """
    field = rbf.field(ids, rbf.fit(ids, points, points), points, values)
    missed = values - jax.lax.map(lambda x: field(x, None), points, batch_size=256)
    unit = float(jnp.finfo(field.beta.dtype).eps)
    return jnp.sqrt(jnp.mean(missed**2)), unit * jnp.max(jnp.sum(jnp.abs(field.beta), axis=1))


def _left(plan: Plan, motions: np.ndarray) -> float:
    """Measures the root mean square of what the coarse field leaves to the correction."""
    left = np.stack([np.asarray(plan.offset(jnp.asarray(u, plan.points.dtype))) for u in motions])
    return float(np.sqrt(np.mean(left**2)) / np.abs(motions).max())
