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
from .._boundary.names import check_finite
from .._host.cells.pieces import owners
from .._host.package.arguments import between, checked, whole
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
    keep their anisotropy. The target of a cell that is folded there, or has a folded corner, is the
    nearest parallelogram, parallelepiped or the like, else the equilateral cell of the size around.
    So a mesh that arrives folded is unfolded, too. The energy of a cell is the mean over its
    corners of

        (1 - size_weight) |T|^2 / (d chi^(2/d)) + size_weight (1 + det^2 T) / (2 chi) - 1,

    with T from target to cell, and chi the determinant of T, regularised: finite on inverted cells.
    Newton's method minimises the sum in five stages, in which the barrier at chi = 0 sharpens.
    SciPy solves the sparse systems on the host. With `worst`, stages follow that raise the worst
    cell at the cost of the mean. The energy e of a corner becomes e / ((1 - s e) (1 - r / det T)):
    it stays below 1 / s, and det T above r. Both bounds close in from stage to stage. The result
    has the largest of the stages' smallest Jacobians. It is the result without `worst` where no
    stage has a larger smallest Jacobian ratio, or where one inverts more cells or proves fewer. So
    it is where the ratio gains 0.5 % or less and the largest skewness grows. Traced in `points`,
    and differentiable in both modes with respect to the places of the fixed nodes, by the implicit
    function theorem: derivatives are as accurate as `residual` is small. Those with respect to the
    places of inner nodes, where the search starts, are zero. Close over `mesh`; do not trace it.
    Use float64. Nodes of symmetry planes and sliding patches move along them, and keep the distance
    that `points` has. The two nodes of a periodic pair move alike. Nodes between two walls stay on
    both. Corners, and nodes on the axis of a rotation, do not move. The surface of a patch's own
    faces is a smooth one through their nodes. On a curved wall a node turns by less than 90 degrees
    from its start; near 90 degrees, `residual` is infinite. Nothing is promised for a boundary that
    crosses itself: see `after`, or `str` of the result. Sources: Garanzha et al., Foldover-free
    maps in 50 lines of code, ACM Trans. Graph. 40, 2021; Teran et al., Robust quasistatic finite
    elements and flesh simulation, SCA 2005; Garanzha et al., In the Quest for Scale-optimal
    Mappings, ACM Trans. Graph. 43, 2024.

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
    with jax.ensure_compile_time_eval():  # not folded into the caller's program
        boundary = mesh if isinstance(mesh, Conditions) else Boundary(mesh, ())
    if (own := boundary.mesh) is None:
        raise ValueError(
            "this boundary has points alone: make it of the mesh, jm.Boundary(mesh, ...)."
        )
    check_solid(own, "there is nothing to improve")
    start = places(own, points)
    if is_known(start):
        check_finite(np.asarray(start))
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
    gain = stiff_report.min_jacobian_ratio - report.min_jacobian_ratio
    is_round = stiff_report.max_skewness <= report.max_skewness
    is_better = jnp.where(is_round, gain >= 0, gain > GAIN * jnp.abs(report.min_jacobian_ratio))
    is_better &= (stiff.after <= found.after) & (stiff.unproven <= found.unproven)
    chosen = jax.tree.map(lambda new, old: jnp.where(is_better, new, old), stiff, found)
    return eqx.tree_at(lambda it: it.steps, chosen, stiff.steps)


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
