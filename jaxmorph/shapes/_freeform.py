"""Free-form deformation: a lattice of control points carries the points inside."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from jaxmorph.extend import between, checked, is_known, whole

from ._arguments import Numbers, check_finite, known_positions, positions, positions_in, slack
from ._lattice import splines, sums
from ._shape import AbstractLinearShape, Linked, Move


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
        self.counts = _checked_counts(counts, d)
        self.degrees, self.continuity = _checked_degrees(degree, self.counts), continuity
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
        """Makes the box along the axes around points (m, d).

        `margin` is the room on each side, relative to the longest edge of the points' box.

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
        return jnp.zeros((*self.counts, len(self.counts)))

    @property
    def free(self) -> Bool[np.ndarray, "..."]:
        """Mask (*counts,) of the control points that `continuity` leaves free."""
        layers = 0 if self.continuity is None else self.continuity + 1
        return np.pad(np.ones([count - 2 * layers for count in self.counts], bool), layers)

    def at(self, x: Numbers) -> Move:
        x = positions_in(x, self.counts)
        t = self.coordinates(x)
        inside = self.holds(t)[:, None]
        # what is outside has no weight, and a place where none of its powers is large
        within = jnp.where(inside, t, 0.5)
        weights = [splines(*along) for along in zip(within.T, self.counts, self.degrees, strict=True)]
        weights[0] = jnp.where(inside, weights[0], 0)
        free = self.free[..., None]
        return lambda control: sums(weights, jnp.where(free, self._numbers(control, x), 0))

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

        - `free`: mask (*counts,) of free controls, or (*counts, d) of coordinates; all by default.
        - `groups`: lists of controls (i, j[, k]) that move alike.
        - `mirror`: direction of the lattice whose halves are mirror images; its edge is along an
          axis.

        **Raises:** `ValueError` for arrays or controls of another lattice, an edge along no axis,
        and nothing free.
        """
        needed = *self.counts, len(self.counts)
        free = np.ones(needed, bool) if free is None else np.asarray(free)
        free = np.repeat(free[..., None], needed[-1], axis=-1) if free.shape == self.counts else free
        if free.shape != needed or free.dtype != bool:
            raise ValueError(f"`free` has shape {free.shape} of {free.dtype}; expected {self.counts} or {needed}.")
        _check_groups(groups, self.counts)
        reflected = None if mirror is None else _reflection(np.asarray(self.axes), mirror)
        matrix = _link_matrix(free & self.free[..., None], groups, reflected)
        if not matrix.shape[1]:
            raise ValueError("no control point is left free.")
        return Linked(self, matrix)

    @checked
    def raise_if_outside(self, x: Numbers) -> None:
        """Raises `ValueError` where positions (m, d) are outside the box, and would stay."""
        known = known_positions(x)
        outside = np.flatnonzero(~np.asarray(self.holds(self.coordinates(jnp.asarray(known)))))
        if len(outside):
            raise ValueError(
                f"{len(outside)} of {len(known)} positions are outside the box, first row {outside[0]} at "
                f"({_place(known[outside[0]])}). Try a larger box."
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
                f"{torn.sum()} of {len(x)} nodes stay outside the box while its border passes them, row {worst} at "
                f"({_place(x[worst])}) by {moves[worst]:.3g}. Try continuity=0 or more, or a larger box."
            )


def _checked_counts(counts: Sequence[Any], d: int) -> tuple[int, ...]:
    if any(int(count) != count for count in counts):
        raise ValueError(f"`counts` is {tuple(counts)}; expected whole numbers.")
    counts = tuple(int(count) for count in counts)
    if len(counts) != d or min(counts) < 2:
        raise ValueError(f"`counts` is {counts}; a box in {d}-D needs {d} numbers, 2 or more each.")
    return counts


def _checked_degrees(degree: Any, counts: tuple[int, ...]) -> tuple[int, ...]:
    d = len(counts)
    degrees = (degree,) * d if degree is None or isinstance(degree, int) else tuple(degree)
    if len(degrees) != d:
        raise ValueError(f"`degree` has {len(degrees)} numbers; a box in {d}-D needs one, or {d}.")
    degrees = tuple(count - 1 if p is None else int(p) for p, count in zip(degrees, counts, strict=True))
    if any(not 1 <= p < count for p, count in zip(degrees, counts, strict=True)):
        raise ValueError(f"degrees {degrees} do not fit counts {counts}: each lies from 1 to count - 1.")
    return degrees


def _place(point: np.ndarray) -> str:
    return ", ".join(f"{x:.6g}" for x in point)


def _link_matrix(
    free: Bool[np.ndarray, "..."], groups: Sequence[Sequence[tuple[int, ...]]], mirror: tuple[int, np.ndarray] | None
) -> Float[np.ndarray, "p q"]:
    """Builds the matrix from free parameters to the flattened displacements of all controls.
    `mirror` is the reflected direction of the lattice, with the signs (d,) of the reflection.
    """
    ids, count = np.arange(free.size).reshape(free.shape), free.size
    pairs = [(ids[:0], ids[:0], ids[:0])]
    pairs += [(ids[group[0]], ids[control], np.ones(free.shape[-1])) for group in groups for control in group[1:]]
    if mirror is not None:
        pairs.append((ids, np.flip(ids, axis=mirror[0]), np.broadcast_to(mirror[1], ids.shape)))
    a, b, sign = (np.concatenate([array.ravel() for array in arrays]) for arrays in zip(*pairs, strict=True))
    # each displacement stands twice, as itself and as its opposite (+ count); what is linked to its
    # own opposite is zero; the first of a part has the lower label
    opposite = np.where(sign < 0, count, 0)
    rows, columns = np.concatenate([a, a + count]), np.concatenate([b + opposite, b + count - opposite])
    links = coo_array((np.ones(len(rows), bool), (rows, columns)), (2 * count, 2 * count))
    itself, other = connected_components(links, directed=False)[1].reshape(2, count)
    moves = (itself != other) & ~np.isin(itself, [itself[~free.ravel()], other[~free.ravel()]])
    parts, column = np.unique(np.minimum(itself, other)[moves], return_inverse=True)
    matrix = np.zeros((count, len(parts)))
    matrix[moves, column] = np.where(itself < other, 1.0, -1.0)[moves]
    return matrix


def _check_groups(groups: Sequence[Sequence[tuple[int, ...]]], counts: tuple[int, ...]) -> None:
    lattice = set(np.ndindex(counts))
    bad = [control for group in groups for control in group if tuple(control) not in lattice]
    if bad:
        raise ValueError(f"{len(bad)} entries of `groups` are no control of {counts}, first {bad[0]}.")


def _reflection(axes: Float[np.ndarray, "d d"], mirror: int) -> tuple[int, np.ndarray]:
    if whole("mirror", mirror, 0) >= len(axes):
        raise ValueError(f"`mirror` is {mirror}; the lattice has directions 0 to {len(axes) - 1}.")
    edge = np.abs(axes[mirror])
    signs = np.where(edge > 1e-9 * edge.max(), -1, 1)
    if (signs < 0).sum() != 1:
        raise ValueError(f"edge {mirror} of the box is along no axis: its controls cannot be mirrored.")
    return mirror, signs
