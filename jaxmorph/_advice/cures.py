"""What keeps a motion from folding cells: cures, tried before named."""

import contextlib
import dataclasses
import warnings
from collections.abc import Iterator

import numpy as np
from jaxtyping import ArrayLike, Float, Real

from .._boundary.boundary import Boundary
from .._boundary.conditions import Conditions
from .._host.package.arguments import checked, finite_array
from .._host.package.rounding import extent_of
from .._mesh.mesh import Mesh
from .._methods.inverse_distance import InverseDistance
from .._plan.deform import deform
from .._plan.plan import Plan
from .._plan.prepare import plan_of, prepare
from .._plan.steps import march
from .._quality.verdict import Verdict, judge
from .crossings import wall_crossings
from .largest_step import largest_step
from .methods import METHODS, MOST_POINTS
from .turn import Turn

STEPS = 2, 4, 8  # numbers of steps that are tried


@dataclasses.dataclass(frozen=True)
class Cure:
    """A change of a call: fixed patches that slide, more steps, or another method by name.

    - `sliding`: names of patches that slide in place of staying; often none.
    - `steps`: the number of steps; 1 for no change.
    - `method`: a name of `METHODS`, or "" for no change.
    """

    sliding: tuple[str, ...] = ()
    steps: int = 1
    method: str = ""

    def __str__(self) -> str:
        if self.sliding:
            return f"sliding={[*self.sliding]} in place of `fixed`"
        return f"{self.steps} steps" if self.steps > 1 else f"jm.{METHODS[self.method].path}()"


@checked
def cures(boundary: Boundary, u: Real[ArrayLike, "m d"]) -> Iterator[Cure]:
    """Lists changes that may keep a motion from folding cells, the surest first; none is tried.

    Fixed patches that are round about the axis of the motion may slide. More steps help where the
    motion is large, methods on cells where it is not, and neither where walls cross. `inspect`
    tries all by the number of inverted cells; a caller with limits of its own, such as `jaxmorph
    deform`, tries them by these.

    **Arguments:**

    - `boundary`: a boundary of a `Mesh`.
    - `u`: displacements (m, d) of the moving nodes.

    **Returns:** an iterator of `Cure`; an empty one for meshes so large that trials take minutes.
    **Raises:** `ValueError` for a boundary without a mesh, and a `u` of another shape.
    """
    if boundary.mesh is None:
        raise ValueError(
            "`boundary` is of points alone: there are no cells to fold. Pass jm.Boundary(mesh, "
            "...)."
        )
    vectors = finite_array("u", u, boundary.points[boundary.moving].shape)
    plan = plan_of(boundary, InverseDistance(rotations=False))
    moved = np.asarray(deform(plan, vectors))
    found = _cures(boundary, boundary.mesh, vectors)
    if wall_crossings(plan, boundary.mesh, vectors[None].astype(float), moved):
        return (cure for cure in found if cure.sliding)
    return found


def _cures(boundary: Conditions, mesh: Mesh, u: Float[np.ndarray, "m d"]) -> Iterator[Cure]:
    points = np.asarray(mesh.points)
    if len(points) > MOST_POINTS[points.shape[1]]:
        return
    turn = Turn.of(points[boundary.moving], u)
    names = tuple(
        name
        for name, nodes in mesh.patches.items()
        if len(nodes) and np.isin(nodes, boundary.fixed).all() and turn.keeps(points[nodes])
    )
    if names:
        yield Cure(sliding=names)
    yield from (Cure(steps=steps) for steps in STEPS)
    yield from (Cure(method=name) for name, method in METHODS.items() if method.is_cure)


def advice_on_folds(plan: Plan, mesh: Mesh, u: Float[np.ndarray, "m d"], verdict: Verdict) -> str:
    """Says from where on a motion folds the cells of a verdict, and what was tried and helps."""
    said = f"one step folds {verdict.spoilt} cells"
    tried = []
    if plan.is_linear:
        said += (
            f", the first after {100 * largest_step(plan, np.zeros_like(u), u, mesh).step:.3g} % "
            "of the motion"
        )
    for cure in _cures(plan.boundary, mesh, u):
        is_cured = False
        # ImportError: a solver for large 3-D meshes is not installed
        with warnings.catch_warnings(), contextlib.suppress(ValueError, ImportError):
            warnings.simplefilter("ignore")
            moved = _carry_out(plan, mesh, u, cure)
            is_cured = not judge(mesh, moved, before=verdict.before).spoilt
        if is_cured:
            how = ""
            if cure.steps > 1:
                how = f": `march(plan, jm.Turn.of(plan.moving_points, u).path({cure.steps}))`"
            return f"{said}. With {cure} none folds{how}."
        tried.append(str(cure))
    last = (
        f"{', '.join(tried)} do not cure it"
        if tried
        else "jm.fewest_steps tells how many steps it takes"
    )
    return f"{said}: {last}."


def _carry_out(plan: Plan, mesh: Mesh, u: np.ndarray, cure: Cure) -> np.ndarray:
    moving = np.asarray(plan.moving)
    fixed = np.asarray(plan.fixed)
    points = np.asarray(mesh.points)
    if cure.steps > 1:
        return np.asarray(march(plan, Turn.of(points[moving], u).path(cure.steps))[1])
    if cure.sliding:
        others = np.setdiff1d(fixed, mesh.patch(*cure.sliding))
        planes = plan.images.planes
        cured = prepare(
            mesh, moving, others, method=plan.method, symmetry=planes, sliding=cure.sliding
        )
    else:
        method = METHODS[cure.method].make(float(extent_of(points[moving])))
        cured = plan_of(plan.boundary.with_mesh(mesh), method)
    return np.asarray(deform(cured, u))
