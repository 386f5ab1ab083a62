"""What keeps a motion from folding cells: each cure is tried before it is named."""

import contextlib
import dataclasses
import warnings
from collections.abc import Iterator

import numpy as np
from jaxtyping import ArrayLike, Float, Real
from scipy.spatial.transform import Rotation

from .._boundary.boundary import Boundary, with_cells
from .._host.package.arguments import checked, finite_array
from .._mesh.mesh import Mesh
from .._plan.deform import deform
from .._plan.plan import Plan
from .._plan.prepare import plan_of, prepare
from .._plan.steps import march
from .._quality.quality import quality
from .largest_step import largest_step
from .methods import METHODS, MOST_POINTS

STEPS = 2, 4, 8  # numbers of steps that are tried
ROUND = 1e-3  # largest change of radius, or of place along the axis, over the radius, of a round patch
TURNS = 0.1  # angle of a motion in radians from which on its path turns, and round patches may slide


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


@dataclasses.dataclass(frozen=True)
class Turn:
    """The rigid motion, in space, nearest to a displacement; `shift` is along the axis."""

    rotation: Rotation
    centre: Float[np.ndarray, "3"]
    shift: Float[np.ndarray, "3"]

    @classmethod
    def of(cls, points: Float[np.ndarray, "m 3"], u: Float[np.ndarray, "m 3"]) -> "Turn":
        middle, way, rotation = points.mean(axis=0), u.mean(axis=0), Rotation.identity()
        with contextlib.suppress(ValueError), warnings.catch_warnings():  # nodes at one place, or on one line
            warnings.simplefilter("ignore")
            found = Rotation.align_vectors(points + u - middle - way, points - middle)[0]
            rotation = found if found.magnitude() > TURNS else rotation
        change = np.eye(3) - rotation.as_matrix()
        arm = np.linalg.lstsq(change, way, rcond=1e-9)[0]
        return cls(rotation, middle + arm, way - change @ arm)

    def path(self, points: Float[np.ndarray, "m 3"], u: Float[np.ndarray, "m 3"], steps: int) -> list[np.ndarray]:
        """The displacement at the end of each step; all but the rotation grows evenly."""
        arms = points - self.centre
        rest = u + arms - self.rotation.apply(arms)
        shares = [step / steps for step in range(1, steps + 1)]
        return [(self.rotation**share).apply(arms) - arms + share * rest for share in shares]

    def keeps(self, points: Float[np.ndarray, "k 3"], dimension: int) -> bool:
        if not self.rotation.magnitude():
            return False
        axis = self.rotation.as_rotvec() / self.rotation.magnitude()
        height = (points - self.centre) @ axis
        radius = np.linalg.norm(points - self.centre - height[:, None] * axis, axis=1)
        slack = ROUND * radius.max()
        return bool(np.ptp(radius) <= slack or (dimension == 3 and np.ptp(height) <= slack))


def in_space(points: Float[np.ndarray, "k d"]) -> Float[np.ndarray, "k 3"]:
    return np.pad(points.astype(float), ((0, 0), (0, 3 - points.shape[1])))


@checked
def cures(boundary: Boundary, u: Real[ArrayLike, "m d"]) -> Iterator[Cure]:
    """Lists changes that may keep a motion from folding cells, the surest first; none is tried.

    Fixed patches that are round about the axis of the motion may slide. More steps help where the
    motion is large, methods on cells where it is not. `inspect` tries all by the number of inverted
    cells; a caller with limits of its own, such as `jaxmorph deform`, tries them by these.

    **Arguments:**

    - `boundary`: a boundary of a `Mesh`.
    - `u`: displacements (m, d) of the moving nodes.

    **Returns:** an iterator of `Cure`; an empty one for meshes so large that trials take minutes.
    **Raises:** `ValueError` for a boundary without a mesh, and a `u` of another shape.
    """
    if boundary.mesh is None:
        raise ValueError("`boundary` is of points alone: there are no cells to fold. Pass jm.Boundary(mesh, ...).")
    return _cures(boundary, boundary.mesh, finite_array("u", u, boundary.points[boundary.moving].shape))


def _cures(boundary: Boundary, mesh: Mesh, u: Float[np.ndarray, "m d"]) -> Iterator[Cure]:
    points, dimension = in_space(np.asarray(mesh.points)), mesh.points.shape[1]
    if len(points) > MOST_POINTS[dimension]:
        return
    turn = Turn.of(points[boundary.moving], in_space(u))
    names = tuple(
        name
        for name, nodes in mesh.patches.items()
        if len(nodes) and np.isin(nodes, boundary.fixed).all() and turn.keeps(points[nodes], dimension)
    )
    if names:
        yield Cure(sliding=names)
    yield from (Cure(steps=steps) for steps in STEPS)
    yield from (Cure(method=name) for name, method in METHODS.items() if method.is_cure)


def advice_on_folds(plan: Plan, mesh: Mesh, u: Float[np.ndarray, "m d"], count: int) -> str:
    """Says from where on a motion folds `count` cells, and what was tried and helps."""
    said, tried = f"one step folds {count} cells", []
    if plan.is_linear:
        said += f", the first after {100 * largest_step(plan, np.zeros_like(u), u, mesh).step:.3g} % of the motion"
    for cure in _cures(plan.boundary, mesh, u):
        if _folds_none(plan, mesh, u, cure):
            how = ""
            if cure.steps > 1:
                turn = Turn.of(in_space(np.asarray(plan.moving_points)), in_space(u))
                turns = ", on a path that turns as the wall does (`shapes.path`)" if turn.rotation.magnitude() else ""
                how = f": `march(plan, path)`{turns}"
            return f"{said}. With {cure} none folds{how}."
        tried.append(str(cure))
    last = f"{', '.join(tried)} do not cure it" if tried else "jm.fewest_steps tells how many steps it takes"
    return f"{said}: {last}."


def _folds_none(plan: Plan, mesh: Mesh, u: np.ndarray, cure: Cure) -> bool:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return not int(quality(mesh, _moved(plan, mesh, u, cure)).inverted)
        except (ValueError, ImportError):  # ImportError: a solver for large 3-D meshes is not installed
            return False


def _moved(plan: Plan, mesh: Mesh, u: np.ndarray, cure: Cure) -> np.ndarray:
    moving, fixed, points = np.asarray(plan.moving), np.asarray(plan.fixed), np.asarray(mesh.points)
    if cure.steps > 1:
        base, motion = in_space(points[moving]), in_space(u)
        path = Turn.of(base, motion).path(base, motion, cure.steps)
        return np.asarray(march(plan, np.stack(path)[..., : points.shape[1]])[1])
    if cure.sliding:
        others, planes = np.setdiff1d(fixed, mesh.patch(*cure.sliding)), plan.images.planes
        cured = prepare(mesh, moving, others, method=plan.method, symmetry=planes, sliding=cure.sliding)
    else:
        method = METHODS[cure.method].make(float(np.ptp(points[moving], axis=0).max()))
        cured = plan_of(with_cells(plan.boundary, mesh), method)
    return np.asarray(deform(cured, u))
