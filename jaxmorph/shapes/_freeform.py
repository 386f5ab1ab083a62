"""Free-form deformation: a lattice of control points carries the points inside.

The box has parallel edges (`FreeForm`), or corners anywhere (`Hexahedron`).
"""

import functools
import math
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from numpy import ndarray

from jaxmorph.extend import between, checked, is_known, parts_of, whole

from ._arguments import (
    Column,
    Numbers,
    Positions,
    ShapeWeights,
    Vector,
    check_known,
    known_positions,
    piecewise,
    positions,
    shown_place,
    slack,
)
from ._shape import AbstractLinearShape, Linked, Move
from ._tolerances import LEVEL, NO_VOLUME

Control = Float[Array, "..."]  # (*counts, d)
FreeMask = Bool[ndarray, "..."]
Groups = Sequence[Sequence[tuple[int, ...]]]
Counts = Sequence[int]
Degree = int | Sequence[int | None] | None

SLAB = 8192  # points in a block: intermediate sums are larger than the result


def splines(t: Column, count: int, degree: int) -> ShapeWeights:
    """B-splines on clamped, equal knots in [0, 1]; Bernstein polynomials at the highest degree."""
    if degree == count - 1:
        return bernstein(t, degree)
    from scipy.interpolate import BSpline  # not before it is needed: it takes a tenth of a second

    breaks = np.linspace(0, 1, count - degree + 1)
    spline = BSpline(np.pad(breaks, degree, mode="edge"), np.eye(count), degree)
    return piecewise(
        t, breaks, [spline(breaks[:-1], p) / math.factorial(p) for p in range(degree + 1)]
    )


def bernstein(t: Column, degree: int) -> ShapeWeights:
    return jnp.stack(
        [math.comb(degree, k) * t**k * (1 - t) ** (degree - k) for k in range(degree + 1)], axis=1
    )


@jax.jit
def sums(weights: Sequence[Float[Array, "m _"]], control: Control) -> Positions:
    """Sums control points (*counts, d) by the weights along each direction of their lattice."""

    def one(rows: Sequence[Float[Array, " _"]]) -> Vector:
        return functools.reduce(lambda left, row: jnp.tensordot(row, left, 1), rows, control)

    return jax.lax.map(one, tuple(weights), batch_size=SLAB)


class FreeForm(AbstractLinearShape):
    """A box of control points that carry the points inside; points outside stay.

    With the highest degree the weights are Bernstein polynomials (Sederberg and Parry, SIGGRAPH
    1986). The parameters are the displacements (*counts, d) of the control points.

    **Arguments:**

    - `origin`: a corner (d,) of the box.
    - `axes`: the edges (d, d) from it, one in each row, at any angle.
    - `counts`: numbers of control points along each edge, 2 or more.
    - `degree`: of the B-splines, one or one for each direction; None is the highest, `counts - 1`.
    - `continuity`: k holds the k + 1 outer layers of control points, so that a wall across the
      border has k continuous derivatives. None holds none: the wall tears where the border moves.

    **Raises:** `ValueError` for other shapes or ranges, edges in one plane, and a continuity that
    leaves no control point free.
    """

    origin: Vector
    axes: Float[Array, "d d"]
    counts: tuple[int, ...] = eqx.field(static=True)
    degrees: tuple[int, ...] = eqx.field(static=True)
    continuity: int | None = eqx.field(static=True)

    @checked
    def __init__(
        self,
        origin: Numbers,
        axes: Numbers,
        counts: Counts,
        *,
        degree: Degree = None,
        continuity: int | None = None,
    ):
        origin = jnp.asarray(origin, float)
        axes = jnp.asarray(axes, float)
        check_known(origin=origin, axes=axes)
        d = origin.size
        if origin.shape not in ((2,), (3,)) or axes.shape != (d, d):
            raise ValueError(
                f"`origin` has shape {origin.shape} and `axes` {axes.shape}; expected (d,) and "
                "(d, d)."
            )
        if (
            is_known(axes)
            and not abs(np.linalg.det(axes)) > NO_VOLUME * np.linalg.norm(axes, axis=1).prod()
        ):
            raise ValueError(
                "the box is flat: its `axes` lie in one plane or one of them has no length."
            )
        self.origin = origin
        self.axes = axes
        self.continuity = continuity
        self.counts, self.degrees = _lattice_of(counts, degree, d)
        if continuity is not None and (continuity < 0 or 2 * (continuity + 1) >= min(self.counts)):
            raise ValueError(
                f"continuity={continuity} holds {continuity + 1} layers: no control of "
                f"{self.counts} is free."
            )

    @staticmethod
    @checked
    def around(
        points: Numbers,
        counts: Counts,
        *,
        margin: float = 0.05,
        degree: Degree = None,
        continuity: int | None = None,
    ) -> "FreeForm":
        """Makes the box along the axes around points (m, d).

        `margin` is the room on each side, relative to the longest edge of the points' box.

        **Raises:** `ValueError` as the class does, and for points in one plane without a margin.
        """
        points = positions(points, "points")
        check_known(points=points)
        if not len(points):
            raise ValueError("`points` has no rows: there is nothing to put a box around.")
        low = points.min(axis=0)
        high = points.max(axis=0)
        between("margin", margin, 0, ends="[)")
        space = margin * (high - low).max()
        return FreeForm(
            low - space,
            jnp.diag(high - low + 2 * space),
            counts,
            degree=degree,
            continuity=continuity,
        )

    def neutral(self) -> Control:
        return jnp.zeros((*self.counts, len(self.counts)))

    @property
    def free(self) -> FreeMask:
        """Mask (*counts,) of the control points that `continuity` leaves free."""
        layers = 0 if self.continuity is None else self.continuity + 1
        return np.pad(np.ones([count - 2 * layers for count in self.counts], bool), layers)

    def at(self, x: Numbers) -> Move:
        x = positions(x)
        t = self.coordinates(x)
        inside = self.holds(t)[:, None]
        # what is outside has no weight, and a place where none of its powers is large
        within = jnp.where(inside, t, 0.5)
        weights = [
            splines(*along) for along in zip(within.T, self.counts, self.degrees, strict=True)
        ]
        weights[0] = jnp.where(inside, weights[0], 0)
        free = self.free[..., None]
        return lambda control: sums(weights, jnp.where(free, self._numbers(control, x), 0))

    def coordinates(self, x: Positions) -> Positions:
        """Computes coordinates in the box, each from 0 to 1 inside."""
        if x.shape[1] != len(self.counts):
            raise ValueError(f"`x` has shape {x.shape}; this box is in {len(self.counts)}-D.")
        inverse = jnp.linalg.inv(self.axes).astype(x.dtype)
        return (x - self.origin.astype(x.dtype)[None, :]) @ inverse

    def holds(self, t: Positions) -> Bool[Array, " m"]:
        """Marks the coordinates in the box, its border and round-off included."""
        beyond = slack(t.dtype)
        return jnp.all((t >= -beyond) & (t <= 1 + beyond), axis=1)

    def lattice(self, control: Numbers | None = None) -> Control:
        """Computes the positions (*counts, d) of the control points, displaced by `control`."""
        shares = [jnp.linspace(0, 1, count) for count in self.counts]
        t = jnp.stack(jnp.meshgrid(*shares, indexing="ij"), axis=-1)
        points = t @ self.axes + jnp.broadcast_to(self.origin, t.shape)
        return points if control is None else points + jnp.asarray(control)

    @checked
    def linked(
        self, *, free: ndarray | None = None, groups: Groups = (), mirror: int | None = None
    ) -> Linked:
        """Makes a shape with fewer parameters (q,): frozen, linked and mirrored control points.

        **Arguments:**

        - `free`: mask (*counts,) of free controls, or (*counts, d) of coordinates; all by default.
        - `groups`: lists of controls (i, j[, k]) that move alike.
        - `mirror`: direction of the lattice whose halves are mirror images; its edge is along an
          axis.

        **Raises:** `ValueError` for arrays or controls of another lattice, an edge along no axis,
        and nothing free.
        """
        needed = *self.counts, len(self.counts)
        free = self.free if free is None else np.asarray(free)
        if free.shape not in (self.counts, needed) or free.dtype != bool:
            raise ValueError(
                f"`free` has shape {free.shape} of {free.dtype}; expected {self.counts} or "
                f"{needed}."
            )
        lattice = set(np.ndindex(self.counts))
        bad = [control for group in groups for control in group if tuple(control) not in lattice]
        if bad:
            raise ValueError(
                f"{len(bad)} entries of `groups` are no control of {self.counts}, first {bad[0]}."
            )
        reflected = None if mirror is None else _reflection(np.asarray(self.axes), mirror)
        free = np.broadcast_to(free.reshape(*self.counts, -1) & self.free[..., None], needed)
        matrix = _link_matrix(free, groups, reflected)
        if not matrix.shape[1]:
            raise ValueError("no control point is left free.")
        return Linked(self, matrix)

    @checked
    def raise_if_outside(self, x: Numbers) -> None:
        """Raises `ValueError` where positions (m, d) are outside the box, and would stay."""
        known = known_positions(x)
        outside = np.flatnonzero(~np.asarray(self.holds(self.coordinates(jnp.asarray(known)))))
        if len(outside):
            first = outside[0]
            raise ValueError(
                f"{len(outside)} of {len(known)} positions are outside the box, first row {first} "
                f"at {shown_place(known[first])}. Try a larger box."
            )

    @checked
    def raise_if_torn(self, x: Numbers, control: Numbers) -> None:
        """Raises `ValueError` where the border, moved by `control`, passes nodes outside and tears
        a wall. These nodes (m, d) are nearer to the border than it moves there.
        """
        x = known_positions(x)
        t = np.asarray(self.coordinates(jnp.asarray(x)))
        outside = ~np.asarray(self.holds(jnp.asarray(t)))
        border = np.asarray(self.origin) + np.clip(t, 0, 1) @ np.asarray(self.axes)
        moves = np.linalg.norm(np.asarray(self.at(border)(jnp.asarray(control))), axis=1)
        torn = outside & (moves > np.linalg.norm(x - border, axis=1))
        if torn.any():
            worst = int(np.where(torn, moves, 0).argmax())
            raise ValueError(
                f"{torn.sum()} of {len(x)} nodes stay outside the box while its border passes "
                f"them, row {worst} at {shown_place(x[worst])} by {moves[worst]:.3g}. Try "
                "continuity=0 or more, or a larger box."
            )


def _lattice_of(counts: Counts, degree: Degree, d: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    counts = tuple(whole("counts", count, 2) for count in counts)
    if len(counts) != d:
        raise ValueError(f"`counts` is {counts}; a box in {d}-D needs {d} numbers.")
    given = tuple(degree) if isinstance(degree, Sequence) else (degree,) * d
    degrees = tuple(count - 1 if p is None else p for p, count in zip(given, counts, strict=False))
    if len(given) != d or not all(1 <= p < count for p, count in zip(degrees, counts, strict=True)):
        raise ValueError(
            f"degrees {given} do not fit counts {counts}: each lies from 1 to count - 1."
        )
    return counts, degrees


def _link_matrix(
    free: FreeMask, groups: Groups, mirror: tuple[int, ndarray] | None
) -> Float[ndarray, "p q"]:
    """Builds the matrix from free parameters to the flattened displacements of all controls.
    `mirror` is the reflected direction of the lattice, with the signs (d,) of the reflection.
    """
    ids = np.arange(free.size).reshape(free.shape)
    count = free.size
    pairs: list[tuple[Any, Any, Any]] = [
        (ids[group[0]], ids[control], 1) for group in groups for control in group
    ]
    if mirror is not None:
        pairs.append((ids, np.flip(ids, axis=mirror[0]), mirror[1]))
    rows = [np.stack(np.broadcast_arrays(*pair)).reshape(3, -1) for pair in pairs]
    a, b, sign = np.concatenate([np.zeros((3, 0), int), *rows], axis=1)
    # each displacement stands twice, as itself and as its opposite (+ count); what is linked to its
    # own opposite is zero; the first of a part has the lower label
    opposite = np.where(sign < 0, count, 0)
    rows = np.concatenate([a, a + count])
    columns = np.concatenate([b + opposite, b + count - opposite])
    itself, other = parts_of(rows, columns, 2 * count).reshape(2, count)
    moves = (itself != other) & ~np.isin(itself, [itself[~free.ravel()], other[~free.ravel()]])
    parts, column = np.unique(np.minimum(itself, other)[moves], return_inverse=True)
    matrix = np.zeros((count, len(parts)))
    matrix[moves, column] = np.where(itself < other, 1.0, -1.0)[moves]
    return matrix


def _reflection(axes: Float[ndarray, "d d"], mirror: int) -> tuple[int, ndarray]:
    if whole("mirror", mirror, 0) >= len(axes):
        raise ValueError(f"`mirror` is {mirror}; the lattice has directions 0 to {len(axes) - 1}.")
    edge = np.abs(axes[mirror])
    signs = np.where(edge > LEVEL * edge.max(), -1, 1)
    if (signs < 0).sum() != 1:
        raise ValueError(
            f"edge {mirror} of the box is along no axis: its controls cannot be mirrored."
        )
    return mirror, signs


NEWTON_STEPS = 30  # a box that is no parallelepiped takes about six
OUTSIDE = 2.0  # coordinate of a position far from the box, whose place is not found

SQUARE_FACES = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
ORDER = {2: SQUARE_FACES, 3: np.array([(*corner, k) for k in (0, 1) for corner in SQUARE_FACES])}
"""Place of each corner in the lattice, in VTK's order: one face, then the opposite face."""


class Hexahedron(AbstractLinearShape):
    """A box of control points between corners that may stand anywhere: a bent `FreeForm`.

    In 2-D it is a quadrilateral. Coordinates in the box are those of a multilinear map of the unit
    cube. Positions inside move by the controls' displacements (*counts, d), the parameters,
    weighted with B-splines of these coordinates; positions outside stay. The `corners` are (8, 3)
    in the order of a cell of the mesh (VTK's and SU2's), the first four around one face; (4, 2) in
    2-D. All else is as for `FreeForm`.

    **Raises:** `ValueError` for another number of corners, a box without volume or turned inside
    out, and as `FreeForm` does.
    """

    corners: Control
    box: FreeForm

    @checked
    def __init__(
        self,
        corners: Numbers,
        counts: Counts,
        *,
        degree: Degree = None,
        continuity: int | None = None,
    ):
        listed = jnp.asarray(corners, float)
        check_known(corners=listed)
        if listed.shape not in ((4, 2), (8, 3)):
            raise ValueError(
                f"`corners` has shape {listed.shape}; expected (8, 3), or (4, 2) in 2-D."
            )
        d = listed.shape[1]
        self.corners = jnp.zeros((*(2,) * d, d), listed.dtype).at[tuple(ORDER[d].T)].set(listed)
        self.box = FreeForm(np.zeros(d), np.eye(d), counts, degree=degree, continuity=continuity)
        if is_known(self.corners):
            slopes = jax.vmap(lambda t: _slopes(t, self.corners))(jnp.asarray(ORDER[d], float))
            sizes = np.asarray(jnp.linalg.det(slopes))
            scale = np.linalg.norm(np.ptp(np.asarray(listed), axis=0)) ** d
            if not ((sizes > NO_VOLUME * scale).all() or (sizes < -NO_VOLUME * scale).all()):
                raise ValueError(
                    "the box is flat or turned inside out: list the corners around one face, "
                    "then around the opposite face."
                )

    @property
    def counts(self) -> tuple[int, ...]:
        """Numbers of control points along each direction."""
        return self.box.counts

    @property
    def continuity(self) -> int | None:
        """As for `FreeForm`."""
        return self.box.continuity

    @property
    def free(self) -> FreeMask:
        """Mask (*counts,) of the control points that `continuity` leaves free."""
        return self.box.free

    @property
    def given_corners(self) -> Float[ndarray, "c d"]:
        return np.asarray(self.corners)[tuple(ORDER[len(self.counts)].T)]

    def neutral(self) -> Control:
        return self.box.neutral()

    def at(self, x: Numbers) -> Move:
        return self.box.at(self.coordinates(x))

    @checked
    def coordinates(self, x: Numbers) -> Positions:
        """Computes coordinates in the box, from 0 to 1 inside, 2 far outside. Traced."""
        x = positions(x)
        x = positions(x, like=(len(x), len(self.counts)))
        return _box_coordinates(x, self.corners)

    def lattice(self, control: Numbers | None = None) -> Control:
        """Computes the positions (*counts, d) of the control points, displaced by `control`."""
        t = self.box.lattice()
        points = jax.vmap(lambda place: _at(place, self.corners))(
            t.reshape(-1, t.shape[-1])
        ).reshape(t.shape)
        return points if control is None else points + jnp.asarray(control)


def _at(t: Vector, corners: Control) -> Vector:
    for share in t:
        corners = (1 - share) * corners[0] + share * corners[1]
    return corners


_slopes = jax.jacfwd(_at)


@jax.jit
def _box_coordinates(x: Positions, corners: Control) -> Positions:
    corners = corners.astype(x.dtype)
    tolerance = 1e3 * jnp.finfo(x.dtype).eps * jnp.max(jnp.abs(corners))

    def nearer(t: Vector, position: Vector, corners: Control) -> Vector:
        return jnp.linalg.solve(_slopes(t, corners), position - _at(t, corners))

    def one(position: Vector) -> Vector:
        here, there = jax.lax.stop_gradient((position, corners))

        def step(_, t):
            return jnp.clip(t + jnp.clip(nearer(t, here, there), -1, 1), -1, 2)

        t = jax.lax.fori_loop(0, NEWTON_STEPS, step, jnp.full_like(here, 0.5))
        is_found = jnp.max(jnp.abs(_at(t, there) - here)) <= tolerance
        t = jnp.where(is_found, t, 0.5)
        for _ in range(2):  # carry derivatives of first to third order
            t = t + nearer(t, position, corners)
        return jnp.where(is_found, t, OUTSIDE)

    return jax.vmap(one)(x)
