"""Better cells for given boundary nodes: inner nodes where the distortion of all cells is least."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int, Real

from .._boundary.boundary import Boundary
from .._boundary.conditions import Conditions
from .._host.cells.pieces import owners
from .._host.package.arguments import between, checked, whole
from .._host.package.errors import check_all_finite
from .._host.tolerances import SAME_MARGIN
from .._kernels.module import Module
from .._kernels.values import is_known
from .._mesh.mesh import Mesh
from .._quality.proof import proven_margin
from .._quality.quality import check_solid, places, quality
from .._quality.report import QualityReport
from .constraints import problem_of
from .stages import Minimum, Search, judge_minimum, minimise_softly, minimise_stiffly

MINIMUM = 1e-2
GAIN = 5e-3  # relative gain in the smallest Jacobian ratio that pays for a larger skewness

Count = Int[Array, ""]


class Improvement(Module):
    """Result of `improve`: traced arrays, and a line about them by `str`.

    - `points`: the improved points (n, d).
    - `before`, `after`: number of inverted cells before and after, as `judge` counts them.
    - `unproven`: number of cells that may fold inside: `proven_margin` at depth 1 is not positive.
    - `from_start`: number of unproven cells that are not proven on the undeformed mesh either, and
      whose margin there was no larger: the motion has not harmed them.
    - `lost`: number of cells inverted after that held nodes alone invert: no free node mends them.
    - `energy`: mean distortion of a cell, 0 if all cells have the shape and size of their targets.
    - `residual`: largest derivative of the summed distortion, with `worst` the stiffened sum, with
      respect to a node's place, in units of the node's smallest cell: far below 1 at a minimum.
    - `steps`: steps of Newton's method, also rejected steps.
    - `cells`: number of cells, as `quality` counts them.
    """

    points: Float[Array, "n d"]
    before: Count
    after: Count
    unproven: Count
    from_start: Count
    lost: Count
    energy: Float[Array, ""]
    residual: Float[Array, ""]
    steps: Count
    cells: int = eqx.field(static=True)

    def __str__(self) -> str:
        residual = float(self.residual)
        unproven = int(self.unproven)
        if residual < MINIMUM:
            how = "at a minimum"
        elif residual < 1:
            how = f"near a minimum, residual {residual:.1g} (a smaller `tolerance` comes nearer)"
        else:
            how = f"stopped early, residual {residual:.1g}"
        if int(self.lost):
            how += (
                f"; {int(self.lost)} stay inverted at a corner with held nodes alone, which no "
                "free node can mend"
            )
        proven = (
            "proven to fold nowhere inside"
            if unproven == 0
            else f"proven to fold nowhere but for {unproven}"
        )
        if int(self.from_start):
            proven += f" ({int(self.from_start)} of them as on the undeformed mesh or better)"
        return (
            f"{int(self.before)} of {self.cells} cells were inverted, {int(self.after)} are now, "
            f"{proven}; "
            f"mean distortion {float(self.energy):.3g} after {int(self.steps)} steps, {how}"
        )


@checked
def improve(
    mesh: Mesh | Conditions,
    points: Real[ArrayLike, "n d"] | Sequence[Any],
    *,
    ideal: bool = False,
    size_weight: float = 0.5,
    worst: bool = False,
    tolerance: float = 0.03,
    max_steps: int = 60,
) -> Improvement:
    """Moves inner nodes to where cells are least distorted, and untangles inverted cells.

    The target of a cell is its shape on the undeformed mesh, `mesh.points`, so that boundary layers
    keep their anisotropy. A cell that is folded there is unfolded. The summed distortion of all
    cells is minimised by Newton's method (`distortion`, and theory in the pages). Nodes of symmetry
    planes and sliding patches move along them, both nodes of a periodic pair alike. With `worst`
    the worst cell is raised at the cost of the mean, unless more cells than without would invert.

    Traced in `points`, but not in `mesh`. Derivatives by the places of the fixed nodes follow from
    the implicit function theorem, and are as accurate as `residual` is small. Those by the places
    of inner nodes, where the search starts, are zero. Use float64. Nothing is promised for a
    boundary that crosses itself: see `after`, or `str` of the result.

    **Arguments:**

    - `mesh`: the mesh with its cells, or the `Boundary` of one; its points are undeformed. Moving
      and fixed nodes, and boundary nodes in no list, stay at `points`, bit for bit. Of a `Mesh` all
      nodes of patches and of the outer boundary stay.
    - `points`: moved points (n, d), in the unit of `mesh.points`.
    - `ideal`: the target is the equilateral cell (a cube, a square) of the undeformed volume.
      Default False.
    - `size_weight`: weight of a change of size against a change of shape, 0 to 1, default 0.5.
    - `worst`: raise the worst cell, default False. It takes three to six times as long.
    - `tolerance`: the last stage ends when the root mean square motion of the nodes, in units of
      their smallest cells, is smaller. Default 0.03.
    - `max_steps`: most Newton steps of a stage, default 60.

    **Raises:** `ValueError` for a mesh without cells of its dimension, another shape of `points`, a
    boundary of points alone, and a `size_weight` that is not in 0 to 1.
    """
    boundary, own = _given_boundary(mesh)
    start = places(own, points)
    if is_known(start):
        check_all_finite(np.asarray(start))
    if is_known(size_weight):
        between("size_weight", size_weight, 0, 1, "[]")
    between("tolerance", tolerance, 0, ends="[)")
    whole("max_steps", max_steps)
    base = start.astype(jnp.promote_types(start.dtype, jnp.result_type(float)))
    with jax.ensure_compile_time_eval():
        distortion, blocks = problem_of(boundary, own, base.dtype, ideal, size_weight)
    search = Search(blocks, jnp.asarray(tolerance, base.dtype), max_steps)
    plain = minimise_softly(distortion, base, search)
    found, report = _conclude(own, start, plain, plain)
    if not worst:
        return found
    stiff, stiff_report = _conclude(own, start, plain, minimise_stiffly(plain, base, search))
    is_better = _is_better(stiff, stiff_report, found, report)
    chosen = jax.tree.map(lambda new, old: jnp.where(is_better, new, old), stiff, found)
    return eqx.tree_at(lambda it: it.steps, chosen, stiff.steps)


def _given_boundary(mesh: Mesh | Conditions) -> tuple[Conditions, Mesh]:
    with jax.ensure_compile_time_eval():  # not folded into the caller's program
        boundary = mesh if isinstance(mesh, Conditions) else Boundary(mesh, ())
    if boundary.mesh is None:
        raise ValueError(
            "this boundary has points alone: make it of the mesh, jm.Boundary(mesh, ...)."
        )
    check_solid(boundary.mesh, "there is nothing to improve")
    return boundary, boundary.mesh


def _is_better(
    stiff: Improvement, stiff_report: QualityReport, plain: Improvement, report: QualityReport
) -> Array:
    """Whether the stiffened minimum is better: a larger Jacobian ratio, no more bad cells, and a
    larger skewness only where the ratio gains more than `GAIN`.
    """
    gain = stiff_report.min_jacobian_ratio - report.min_jacobian_ratio
    is_round = stiff_report.max_skewness <= report.max_skewness
    is_better = jnp.where(is_round, gain >= 0, gain > GAIN * jnp.abs(report.min_jacobian_ratio))
    return is_better & (stiff.after <= plain.after) & (stiff.unproven <= plain.unproven)


def _conclude(
    mesh: Mesh, start: Array, plain: Minimum, minimum: Minimum
) -> tuple[Improvement, QualityReport]:
    distortion = plain.distortion
    (energy, unmoved), slope, improved, fixed = judge_minimum(
        distortion, minimum, start.astype(minimum.y.dtype)
    )
    moved = jnp.where(distortion.free[:, None], improved.astype(start.dtype), start)
    moved = distortion.ways.matched(start, moved)
    report = quality(mesh, moved)
    with jax.ensure_compile_time_eval():
        own = proven_margin(mesh, mesh.points, depth=1)
        owner = owners(jax.tree.map(np.asarray, mesh.cells))
    first = quality(mesh, start)
    before, after = (jnp.sum(it.is_folded & it.counted) for it in (first, report))
    # where held nodes coincide, a cell may have no target that does not fold another
    is_worse = after > before
    moved, report = jax.tree.map(
        lambda new, old: jnp.where(is_worse, old, new), (moved, report), (start, first)
    )
    margin = proven_margin(mesh, moved, depth=1)
    lost = jnp.zeros_like(report.is_folded)
    for kind, is_fixed in fixed.items():
        lost = lost.at[owner[kind]].max(is_fixed)
    unproven = ~(margin > 0)
    as_before = (own <= 0) & (margin >= own - SAME_MARGIN)
    energy = jnp.where(is_worse, unmoved, energy)
    improvement = Improvement(
        points=moved,
        before=before,
        after=jnp.minimum(after, before),
        unproven=jnp.sum(unproven),
        from_start=jnp.sum(unproven & as_before),
        lost=jnp.sum(lost & report.is_folded),
        energy=energy / sum(map(len, distortion.cells.values())),
        residual=jnp.where(is_worse, jnp.inf, jnp.max(jnp.abs(slope))),
        steps=jnp.asarray(minimum.steps),
        cells=report.count,
    )
    return improvement, report
