"""What keeps a motion from folding cells: a way that turns, and cures, tried before named."""

import contextlib
import dataclasses
import warnings
from collections.abc import Iterator
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Real
from scipy.spatial.transform import Rotation

from .._boundary.boundary import Boundary, with_cells
from .._host.package.arguments import checked, finite_array, whole
from .._mesh.mesh import Mesh
from .._plan.deform import deform
from .._plan.plan import Plan
from .._plan.prepare import plan_of, prepare
from .._plan.steps import march
from .._quality.quality import quality
from .largest_step import largest_step
from .methods import METHODS, MOST_POINTS

# largest change of radius, or of place along the axis, over the radius, of a round patch
ROUND = 1e-3
# angle of a motion in radians from which on its path turns, and round patches may slide
TURNS = 0.1
STEPS = 2, 4, 8  # numbers of steps that are tried


@dataclasses.dataclass(frozen=True, eq=False)
class Turn:
    """A displacement on the way that turns as it does: the nearest rotation, and the rest.

    - `u`: the displacements (m, d) at the end of the way.
    - `arms`: positions (m, 3) relative to a point on the axis of rotation, `centre` (3,).
    - `axis`: its direction (3,); z in 2-D.
    - `angle`: radians, from 0 to pi; 0 where less than 0.1: the way is then straight.
    """

    u: Float[np.ndarray, "m d"]
    arms: Float[np.ndarray, "m 3"]
    centre: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    angle: float

    @staticmethod
    @checked
    def of(x: Real[ArrayLike, "m d"], u: Real[ArrayLike, "m d"]) -> "Turn":
        """Finds the rotation (Kabsch, Acta Crystallographica A 32, 1976), on the host.

        **Arguments:**

        - `x`: positions (m, d) of the moving nodes, as `plan.moving_points`.
        - `u`: their displacements (m, d), in the unit of `x`.

        **Raises:** `ValueError` for `x` and `u` of different shapes, and what is not finite.
        """
        x = finite_array("x", x, (None, None))
        u = finite_array("u", u, x.shape)
        points = in_space(x)
        way = in_space(u)
        middle = points.mean(axis=0)
        mean = way.mean(axis=0)
        vector = _rotation(points - middle, points - middle + way - mean)
        angle = float(np.linalg.norm(vector))
        if angle <= TURNS:
            return Turn(u, points - middle, middle, np.array([0.0, 0.0, 1.0]), 0.0)
        change = np.eye(3) - Rotation.from_rotvec(vector).as_matrix()
        centre = middle + np.linalg.lstsq(change, mean, rcond=1e-9)[0]
        return Turn(u, points - centre, centre, vector / angle, angle)

    def at(self, share: Any) -> Float[Array, "m d"]:
        """Computes the displacement (m, d) after a share of the way, 0 to 1: the `motion` of
        `fewest_steps`. Traced. The rotation goes on evenly, the rest in proportion.
        """
        d = self.u.shape[1]
        across = np.cross(self.axis, self.arms)
        inward = np.cross(self.axis, across)
        sine = jnp.sin(share * self.angle) - share * jnp.sin(self.angle)
        versine = (1 - jnp.cos(share * self.angle)) - share * (1 - jnp.cos(self.angle))
        return share * self.u + (sine * across + versine * inward)[:, :d].astype(self.u.dtype)

    def path(self, steps: int) -> Float[Array, "k m d"]:
        """Computes the displacements after equal steps, the `path` of `march`; the last is `u`.

        **Raises:** `ValueError` for fewer than one step.
        """
        whole("steps", steps)
        return jnp.stack(
            [*(self.at(step / steps) for step in range(1, steps)), jnp.asarray(self.u)]
        )

    def keeps(self, points: Real[ArrayLike, "k d"]) -> bool:
        """Whether the rotation takes a surface to itself: round about its axis, or flat across."""
        points = finite_array("points", points, (None, self.u.shape[1]))
        if not self.angle:
            return False
        arms = in_space(points) - self.centre
        height = arms @ self.axis
        radius = np.linalg.norm(arms - height[:, None] * self.axis, axis=1)
        slack = ROUND * radius.max()
        return bool(np.ptp(radius) <= slack or (points.shape[1] == 3 and np.ptp(height) <= slack))


def _rotation(
    arms: Float[np.ndarray, "m 3"], moved: Float[np.ndarray, "m 3"]
) -> Float[np.ndarray, "3"]:
    """The vector of the rotation: along the axis, radians long."""
    if not arms[:, 2].any() and not moved[:, 2].any():  # in a plane: never about an axis in it
        return np.array([0, 0, np.arctan2(np.cross(arms, moved)[:, 2].sum(), np.vdot(arms, moved))])
    with (
        contextlib.suppress(ValueError),
        warnings.catch_warnings(),
    ):  # nodes at one place, or on one line
        warnings.simplefilter("ignore")
        return Rotation.align_vectors(moved, arms)[0].as_rotvec()
    return np.zeros(3)


def in_space(points: Float[np.ndarray, "k d"]) -> Float[np.ndarray, "k 3"]:
    return np.pad(points.astype(float), ((0, 0), (0, 3 - points.shape[1])))


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
    motion is large, methods on cells where it is not. `inspect` tries all by the number of inverted
    cells; a caller with limits of its own, such as `jaxmorph deform`, tries them by these.

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
    return _cures(
        boundary, boundary.mesh, finite_array("u", u, boundary.points[boundary.moving].shape)
    )


def _cures(boundary: Boundary, mesh: Mesh, u: Float[np.ndarray, "m d"]) -> Iterator[Cure]:
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


def advice_on_folds(plan: Plan, mesh: Mesh, u: Float[np.ndarray, "m d"], count: int) -> str:
    """Says from where on a motion folds `count` cells, and what was tried and helps."""
    said = f"one step folds {count} cells"
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
            is_cured = not int(quality(mesh, _moved(plan, mesh, u, cure)).inverted)
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


def _moved(plan: Plan, mesh: Mesh, u: np.ndarray, cure: Cure) -> np.ndarray:
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
        method = METHODS[cure.method].make(float(np.ptp(points[moving], axis=0).max()))
        cured = plan_of(with_cells(plan.boundary, mesh), method)
    return np.asarray(deform(cured, u))
