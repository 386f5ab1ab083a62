"""Free-form deformation: a lattice of control points carries what is inside."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._host.package.arguments import between, checked
from .._host.package.errors import place_of
from .._kernels.values import is_known, slack
from . import _bspline
from ._arguments import Numbers, check_finite, known_positions, positions
from ._combine import Linked
from ._lattice import LatticeOperator, Rows, checked_counts
from ._links import check_groups, link_matrix, reflection
from ._shape import AbstractLinearShape
from ._spans import Blocks

MANY = 1000
"""Points from which on `at` sorts them, for a faster operator."""


class FreeForm(AbstractLinearShape):
    """A box of control points that carry the points inside; points outside stay.

    With the highest degree the weights are Bernstein polynomials (Sederberg and Parry, Free-form
    deformation of solid geometric models, SIGGRAPH 1986). The parameters are the displacements
    (*counts, d) of the control points.

    **Arguments:**

    - `origin`: a corner (d,) of the box.
    - `axes`: the edges (d, d) that leave it, one in each row; they need not be at right angles.
    - `counts`: numbers of control points along each edge, 2 or more.
    - `degree`: of the B-splines, one number or a number for each direction; None is the highest,
      `counts - 1`.
    - `continuity`: k holds the k + 1 outer layers of control points. What stands across the border
      then joins with k continuous derivatives. None holds none, and a wall across the border tears
      where the border moves.

    **Raises:** `ValueError` for wrong shapes, edges in one plane, counts below 2, degrees outside
    of 1 to `counts - 1`, and a continuity that leaves no control point free.
    """

    origin: Float[Array, " d"]
    axes: Float[Array, "d d"]
    counts: tuple[int, ...] = eqx.field(static=True)
    degrees: tuple[int, ...] = eqx.field(static=True)
    continuity: int | None = eqx.field(static=True)

    @checked
    def __init__(
        self,
        origin: Numbers,
        axes: Numbers,
        counts: Sequence[int],
        *,
        degree: int | Sequence[int | None] | None = None,
        continuity: int | None = None,
    ):
        origin, axes = jnp.asarray(origin, float), jnp.asarray(axes, float)
        check_finite(origin=origin, axes=axes)
        d = origin.size
        if origin.shape not in ((2,), (3,)) or axes.shape != (d, d):
            raise ValueError(f"`origin` has shape {origin.shape} and `axes` {axes.shape}; expected (d,) and (d, d).")
        if is_known(axes) and not abs(np.linalg.det(axes)) > 1e-12 * np.linalg.norm(axes, axis=1).prod():
            raise ValueError("the box is flat: its `axes` lie in one plane or one of them has no length.")
        self.origin, self.axes = origin, axes
        self.counts, self.degrees = checked_counts(counts, degree, d)
        self.continuity = continuity
        if continuity is not None and (continuity < 0 or 2 * (continuity + 1) >= min(self.counts)):
            raise ValueError(
                f"continuity={continuity} holds {continuity + 1} layers: no control of {self.counts} is free."
            )

    @staticmethod
    @checked
    def around(
        points: Numbers,
        counts: Sequence[int],
        *,
        margin: float = 0.05,
        degree: int | Sequence[int | None] | None = None,
        continuity: int | None = None,
    ) -> "FreeForm":
        """Makes the box along the axes that holds all points.

        **Arguments:**

        - `points`: positions (m, d) to be inside.
        - `counts`, `degree`, `continuity`: as for the class.
        - `margin`: room on each side, relative to the longest edge of the points' box. Default
          0.05.

        **Returns:** a `FreeForm`.

        **Raises:** `ValueError` as the class does, and for points in one plane without a margin.
        """
        points = positions(points, "points")
        if is_known(points):
            known_positions(points, "points")
        if not len(points):
            raise ValueError("`points` has no rows: there is nothing to put a box around.")
        low, high = points.min(axis=0), points.max(axis=0)
        between("margin", margin, 0, ends="[)")
        space = margin * (high - low).max()
        return FreeForm(low - space, jnp.diag(high - low + 2 * space), counts, degree=degree, continuity=continuity)

    def neutral(self) -> Float[Array, "..."]:
        """Makes the control displacements that move nothing: zeros (*counts, d)."""
        return jnp.zeros((*self.counts, len(self.counts)))

    @property
    def free(self) -> Bool[np.ndarray, "..."]:
        """Control points (*counts,) that may move: `continuity` does not hold them."""
        layers = 0 if self.continuity is None else self.continuity + 1
        free = np.ones(self.counts, bool)
        for axis, count in enumerate(self.counts):
            layer = np.arange(count)
            shape = [-1 if other == axis else 1 for other in range(len(self.counts))]
            free &= ((layer >= layers) & (layer < count - layers)).reshape(shape)
        return free

    def at(self, x: Numbers) -> LatticeOperator:
        """Computes the weights of positions (m, d) once, for many control displacements."""
        x = positions(x)
        if x.shape[1] != len(self.counts):
            raise ValueError(f"`x` has shape {x.shape}; this box is in {len(self.counts)}-D.")
        t = self.coordinates(x)
        inside = self.holds(t)
        # what is outside has no weight, and a place where none of its powers is large
        within = jnp.where(inside[:, None], t, 0.5)
        first, weights = [], []
        for t_along, count, degree in zip(within.T, self.counts, self.degrees, strict=True):
            first.append(_bspline.spans(t_along, count, degree))
            weights.append(_bspline.values(t_along, first[-1], count, degree))
        weights[0] = jnp.where(inside[:, None], weights[0], 0)
        free = None if self.continuity is None else jnp.asarray(self.free)
        if is_known(x, self) and len(x) >= MANY:
            return LatticeOperator(Blocks.sorted_by_span(tuple(weights), tuple(first), self.counts), free, self.counts)
        return LatticeOperator(Rows(tuple(weights), tuple(first), self.counts), free, self.counts)

    def coordinates(self, x: Float[Array, "m d"]) -> Float[Array, "m d"]:
        """Computes coordinates in the box, each from 0 to 1 inside."""
        inverse = jnp.linalg.inv(self.axes).astype(x.dtype)
        return (x - self.origin.astype(x.dtype)[None, :]) @ inverse

    def holds(self, t: Float[Array, "m d"]) -> Bool[Array, " m"]:
        """Marks the coordinates in the box, its border and round-off included."""
        beyond = slack(t.dtype)
        return jnp.all((t >= -beyond) & (t <= 1 + beyond), axis=1)

    def lattice(self, control: Numbers | None = None) -> Float[Array, "..."]:
        """Computes the positions (*counts, d) of the control points, displaced by `control`."""
        shares = [jnp.linspace(0, 1, count) for count in self.counts]
        t = jnp.stack(jnp.meshgrid(*shares, indexing="ij"), axis=-1)
        points = t @ self.axes + jnp.broadcast_to(self.origin, t.shape)
        return points if control is None else points + jnp.asarray(control)

    def anchors(self) -> Float[Array, "..."]:
        """Computes the positions (*counts, d) at which control points reproduce an affine field.

        Control displacements are then the field's values.

        For the highest degree they are the positions of `lattice`, else Greville's abscissae.
        """
        sizes = zip(self.counts, self.degrees, strict=True)
        shares = [jnp.asarray(_bspline.greville(count, degree)) for count, degree in sizes]
        t = jnp.stack(jnp.meshgrid(*shares, indexing="ij"), axis=-1)
        return t @ self.axes + jnp.broadcast_to(self.origin, t.shape)

    @checked
    def linked(
        self,
        *,
        free: np.ndarray | None = None,
        groups: Sequence[Sequence[tuple[int, ...]]] = (),
        mirror: int | None = None,
    ) -> Linked:
        """Makes a shape with fewer parameters (q,): frozen, linked and mirrored control points.

        **Arguments:**

        - `free`: which controls may move, (*counts,), or which of their coordinates, (*counts, d);
          all by default.
        - `groups`: lists of controls (i, j[, k]) that move alike.
        - `mirror`: direction of the lattice whose two halves move as mirror images; its edge must
          be along an axis.

        **Raises:** `ValueError` for arrays or controls that are not of this lattice, an edge along
        no axis, and nothing free.
        """
        d = len(self.counts)
        free = np.ones((*self.counts, d), bool) if free is None else np.asarray(free)
        free = np.repeat(free[..., None], d, axis=-1) if free.shape == self.counts else free.copy()
        if free.shape != (*self.counts, d) or free.dtype != bool:
            raise ValueError(
                f"`free` has shape {free.shape} of {free.dtype}; expected {self.counts} or {(*self.counts, d)}."
            )
        check_groups(groups, self.counts)
        reflected = None if mirror is None else reflection(np.asarray(self.axes), mirror)
        matrix = link_matrix(free & self.free[..., None], groups, reflected)
        if not matrix.shape[1]:
            raise ValueError("no control point is left free.")
        return Linked(self, matrix)

    @checked
    def raise_if_outside(self, x: Numbers) -> None:
        """Raises where positions (m, d) that the box should hold are outside, and would stay.

        **Raises:** `ValueError` with the number of positions and the first of them.
        """
        known = known_positions(x)
        outside = np.flatnonzero(~np.asarray(self.holds(self.coordinates(jnp.asarray(known)))))
        if len(outside):
            raise ValueError(
                f"{len(outside)} of {len(known)} positions are outside the box, first row {outside[0]} at "
                f"({place_of(known[outside[0]])}). Try a larger box."
            )

    @checked
    def raise_if_torn(self, x: Numbers, control: Numbers) -> None:
        """Raises where the border of the box passes nodes outside, and so tears a wall.

        **Arguments:**

        - `x`: positions (m, d) of the wall.
        - `control`: displacements (*counts, d) of the control points.

        **Raises:** `ValueError` with the number of nodes that are nearer to the border than it
        moves there.
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
                f"{torn.sum()} of {len(x)} nodes stay outside the box while its border passes them, row {worst} at "
                f"({place_of(x[worst])}) by {moves[worst]:.3g}. Try continuity=0 or more, or a larger box."
            )
