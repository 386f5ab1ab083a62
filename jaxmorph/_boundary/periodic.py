"""Pairs the nodes of two periodic patches and checks the pairs."""

import contextlib
import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._host.package.arguments import between, check_patch, finite_array, whole
from .._host.package.cores import Tree
from .._host.package.errors import MeshError, place_of
from .symmetry import Plane, tolerance

ALONG_AXIS = 1e-9
"""Component of a translation, relative to the largest one, below which it is zero."""

MISMATCH = 1e-4
"""Distance of two nodes of a pair after the transform, relative to the distance to the next node, that files may have."""


@dataclasses.dataclass(frozen=True, eq=False, init=False)
class Periodic:
    """Joins two patches of which the second repeats the first: passages of a cascade, sectors of a wheel, ends of a duct.

    The surface is repeated by the transform before a method sees it, so the field knows its neighbours. What is left is made
    equal by averaging each pair of nodes. Both patches move: they may change shape, but stay copies
    of each other.

    Without any of `translation`, `rotation`, `about` and `axis` the transform is the translation between the middles of the
    patches. If they do not match, it is a rotation about an axis of coordinates (the origin in 2-D).

    **Arguments:**

    - `patch`, `partner`: names of patches, or ids of their nodes. The transform leads from `patch` to `partner`.
    - `translation`: vector (d,), in the mesh's units. Default: found.
    - `rotation`: angle in radians. Default: found from the middles of the patches.
    - `about`: a point (d,) that the rotation keeps. Default: the origin.
    - `axis`: direction (3,) of the rotation's axis, in 3-D alone.
    - `copies`: how often the surface is repeated on either side. Default 1; 2 gives a little better cells, and takes longer.

    **Raises:** `ValueError` for a translation with a rotation, and for less than one copy.
    """

    patch: str | np.ndarray
    partner: str | np.ndarray
    translation: np.ndarray | None
    rotation: float | None
    about: np.ndarray | None
    axis: np.ndarray | None
    copies: int

    def __init__(self, patch, partner, *, translation=None, rotation=None, about=None, axis=None, copies: int = 1):
        if translation is not None and not (rotation is None and about is None and axis is None):
            raise ValueError("a periodic pair has a translation or a rotation, not both.")
        whole("copies", copies)
        check_patch("patch", patch)
        check_patch("partner", partner)
        if rotation is not None:
            between("rotation", rotation)
        vectors = (("translation", translation), ("about", about), ("axis", axis))
        translation, about, axis = (
            None if each is None else finite_array(name, each, (2,), (3,)).astype(float) for name, each in vectors
        )
        values = {"patch": patch, "partner": partner, "translation": translation, "about": about, "axis": axis}
        values |= {"rotation": None if rotation is None else float(rotation), "copies": int(copies)}
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def name(self) -> str:
        """Names both patches for a message."""
        names = [
            repr(side) if isinstance(side, str) else f"of {len(side)} nodes" for side in (self.patch, self.partner)
        ]
        return f"the periodic patches {names[0]} and {names[1]}"

    @property
    def is_rotation(self) -> bool:
        """Checks whether the transform is a rotation."""
        return not (self.rotation is None and self.about is None and self.axis is None)


class Pairing(eqx.Module):
    """Holds pairs of nodes, and the transform x -> `matrix` x + `shift` that leads from `first` to `second`.

    - `first`, `second` (q,): ids of nodes, or rows of them.
    - `alone` (s,): nodes on the axis of a rotation, which the transform does not move.
    - `keeps` (d, d): projection on the vectors that the transform does not turn.
    - `turn`: how many sectors make a whole turn, 0 where the transform never comes back.
    - `copies`: as `Periodic` has it.
    - `is_rotation`: whether the transform turns.
    """

    first: Int[Array | np.ndarray, " q"]
    second: Int[Array | np.ndarray, " q"]
    alone: Int[Array | np.ndarray, " s"]
    matrix: Float[Array | np.ndarray, "d d"]
    shift: Float[Array | np.ndarray, " d"]
    keeps: Float[Array | np.ndarray, "d d"]
    turn: int = eqx.field(static=True)
    copies: int = eqx.field(static=True)
    is_rotation: bool = eqx.field(static=True)

    @property
    def nodes(self) -> np.ndarray:
        """Ids of all nodes of both patches, on the host."""
        return np.concatenate([self.first, self.second, self.alone])

    @property
    def powers(self) -> list[int]:
        """Lists how often images are transformed, the nearest first: 0, 1, -1, 2, ..., no place twice in a whole turn."""
        every = sorted(range(-self.copies, self.copies + 1), key=lambda k: (abs(k), -k))
        return list({k % self.turn: k for k in every[::-1]}.values())[::-1] if self.turn else every

    def power(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Returns matrix and shift of the transform applied k times, on the host."""
        dimension = len(self.shift)
        once = np.eye(dimension + 1)
        once[:dimension, :dimension], once[:dimension, dimension] = self.matrix, self.shift
        if k < 0:
            once[:dimension, :dimension], once[:dimension, dimension] = self.matrix.T, -self.matrix.T @ self.shift
        whole = np.linalg.matrix_power(once, abs(k))
        return whole[:dimension, :dimension], whole[:dimension, dimension]

    @property
    def inverse(self) -> "Pairing":
        """The same pairs the other way round, on the host."""
        matrix, shift = self.power(-1)
        return Pairing(
            self.second, self.first, self.alone, matrix, shift, self.keeps, self.turn, self.copies, self.is_rotation
        )

    def renumbered(self, place: Int[np.ndarray, " n"]) -> "Pairing":
        """Renumbers the pairs: node k becomes `place[k]`. Pairs with a node of place -1 are dropped."""
        first, second, alone = (place[np.asarray(nodes)] for nodes in (self.first, self.second, self.alone))
        is_complete = (first >= 0) & (second >= 0)
        numbers = first[is_complete], second[is_complete], alone[alone >= 0]
        return eqx.tree_at(lambda pairing: (pairing.first, pairing.second, pairing.alone), self, numbers)

    def at(self, points: Float[Array, "n d"]) -> "Pairing":
        """Returns the pairs of other base points: a translation is theirs, a rotation stays. Traced."""
        if self.is_rotation:
            return self
        difference = points[self.second] - points[self.first]
        mean = jnp.mean(difference, axis=0)
        # the value of most pairs, where round-off has no part, with the derivative of the mean
        shift = mean + jax.lax.stop_gradient(jnp.median(difference, axis=0) - mean)
        shift = jnp.where(jnp.abs(shift) < ALONG_AXIS * jnp.max(jnp.abs(shift)), 0, shift)
        return eqx.tree_at(lambda pairing: pairing.shift, self, shift)

    def misses(self, points: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " q"]:
        """Measures, on the host, how far the transform leads each pair's first node from its second."""
        return np.linalg.norm(points[self.first] @ self.matrix.T + self.shift - points[self.second], axis=1)

    def matched(self, base: Float[Array, "n d"], points: Float[Array, "n d"]) -> Float[Array, "n d"]:
        """Puts partners that a translation led to bit for bit at `base` there again. Traced."""
        if self.is_rotation:
            return points
        shift = jnp.asarray(self.shift, points.dtype)[None]
        matched = base[self.first] + shift == base[self.second]
        return points.at[self.second].set(jnp.where(matched, points[self.first] + shift, points[self.second]))

    def alike(self, u: Float[Array, "n d"]) -> Float[Array, "n d"]:
        """Makes the displacements of each pair equal after the transform: both take the mean. Traced."""
        matrix, keeps = jnp.asarray(self.matrix, u.dtype), jnp.asarray(self.keeps, u.dtype)
        mean = (u[self.first] + _product(u[self.second], matrix)) / 2
        u = u.at[self.first].set(mean).at[self.second].set(_product(mean, matrix.T))
        return u.at[self.alone].set(_product(u[self.alone], keeps)) if len(self.alone) else u

    def led(self, u: Float[Array, "n d"]) -> Float[Array, "n d"]:
        """Moves the second node of each pair as the first one moves, after the transform. Traced."""
        return u.at[self.second].set(_product(u[self.first], jnp.asarray(self.matrix, u.dtype).T))


def _product(rows: Float[Array, "n d"], matrix: Float[Array, "d d"]) -> Float[Array, "n d"]:
    return jnp.matmul(rows, matrix, precision="highest")


def paired(
    periodic: Periodic, first: Int[np.ndarray, " k"], second: Int[np.ndarray, " l"], points: Float[np.ndarray, "n d"]
) -> Pairing:
    """Finds the pairs of two patches' nodes. Raises `ValueError`, with the worst node, where they do not match."""
    if periodic.translation is not None or periodic.is_rotation:
        return _paired(periodic, first, second, points)
    try:
        return _paired(periodic, first, second, points)
    except ValueError as error:
        refused = error
    sides, copies = (periodic.patch, periodic.partner), periodic.copies
    axes = [{"axis": axis} for axis in np.eye(3)] if points.shape[1] == 3 else [{"about": (0, 0)}]
    for axis in axes:
        with contextlib.suppress(ValueError):
            return _paired(Periodic(*sides, copies=copies, **axis), first, second, points)
    raise refused


def _paired(
    periodic: Periodic, first: Int[np.ndarray, " k"], second: Int[np.ndarray, " l"], points: Float[np.ndarray, "n d"]
) -> Pairing:
    exact = points.astype(float)
    if not len(first) or not len(second):
        raise ValueError(f"{periodic.name}: one of them has no nodes.")
    matrix, shift, angle = _transform(periodic, exact[first].mean(axis=0), exact[second].mean(axis=0))
    images = exact[first] @ matrix.T + shift
    tree = Tree(exact[second])
    distance, nearest = map(np.asarray, tree.query(images))
    spacing = np.ptp(exact, axis=0).max() if len(second) < 2 else np.asarray(tree.query(exact[second], k=2)[0])[:, 1]
    allowed = np.maximum(MISMATCH * np.broadcast_to(spacing, len(second))[nearest], 2 * tolerance(points))
    unmatched = np.flatnonzero(distance > allowed)
    if unmatched.size or len(np.unique(nearest)) < len(second):
        _refuse(periodic, (first, second), (distance, unmatched, nearest), points)
    same = first == second[nearest]
    whole = 2 * np.pi / abs(angle) if angle else 0
    turn = round(whole) if abs(whole - round(whole)) < 1e-6 * whole else 0
    copies = periodic.copies if turn or not angle else max(1, min(periodic.copies, int((whole - 1) / 2)))
    pairs = first[~same].astype(np.int32), second[nearest][~same].astype(np.int32)
    if not periodic.is_rotation and periodic.translation is None:
        shift = _sharp(np.median(exact[pairs[1]] - exact[pairs[0]], axis=0))  # most pairs have it bit for bit
    alone, keeps = first[same].astype(np.int32), _keeps(periodic, len(shift))
    return Pairing(*pairs, alone, matrix, shift, keeps, turn, copies, periodic.is_rotation)


def _keeps(periodic: Periodic, dimension: int) -> np.ndarray:
    """Projects on what the transform does not turn: all, or the direction of the axis, or nothing."""
    if not periodic.is_rotation:
        return np.eye(dimension)
    return np.eye(dimension) - _generator(periodic.axis, dimension)[1]


def _refuse(periodic: Periodic, nodes: tuple, matches: tuple, points: np.ndarray) -> None:
    """Raises `ValueError`, with the worst node without a partner."""
    first, second = nodes
    distance, apart, nearest = matches
    if not apart.size:
        lonely = second[np.setdiff1d(np.arange(len(second)), nearest)]
        place = place_of(points[lonely[0]])
        raise MeshError(
            f"{periodic.name} do not match: {len(lonely)} of {len(second)} nodes of the second have no partner, first node "
            f"{{node}} at ({place}). Both need the same nodes: mesh one as the copy of the other.",
            lonely,
        )
    worst_first = apart[np.argsort(-distance[apart], kind="stable")]
    place = place_of(points[first[worst_first[0]]])
    raise MeshError(
        f"{periodic.name} do not match: {len(apart)} of {len(first)} nodes of the first have no partner, the worst is node "
        f"{{node}} at ({place}): {distance[worst_first[0]]:.3g} from the nearest after the transform. Check `translation`, or "
        "`rotation`, `about` and `axis`; they lead from the first patch to the second.",
        first[worst_first],
    )


def _transform(periodic: Periodic, middle: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Returns matrix, shift and angle (0 for a translation) of the transform."""
    dimension = len(middle)
    for name in ("translation", "about", "axis"):
        value = getattr(periodic, name)
        if value is not None and value.shape != (dimension,):
            raise ValueError(f"{periodic.name}: `{name}` has shape {value.shape}; the mesh has {dimension} dimensions.")
    if not periodic.is_rotation:
        shift = other - middle if periodic.translation is None else periodic.translation
        shift = _sharp(shift) if periodic.translation is None else shift
        if not np.abs(shift).max() > 0:
            raise ValueError(f"{periodic.name}: the translation is zero; give `rotation`, `about` or `axis`.")
        return np.eye(dimension), shift, 0.0
    if dimension == 3 and (periodic.axis is None or not np.linalg.norm(periodic.axis) > 0):
        raise ValueError(f"{periodic.name}: a rotation in 3-D needs an `axis` that is not zero.")
    if dimension == 2 and periodic.axis is not None:
        raise ValueError(f"{periodic.name}: a rotation in 2-D has no `axis`; give `about`.")
    about = np.zeros(dimension) if periodic.about is None else periodic.about
    cross, plane = _generator(periodic.axis, dimension)
    angle = periodic.rotation
    if angle is None:
        start, end = plane @ (middle - about), plane @ (other - about)
        angle = float(np.arctan2(end @ cross @ start, end @ start))
    if not abs(np.sin(angle / 2)) > 1e-12:
        raise ValueError(f"{periodic.name}: the angle of the rotation is zero.")
    matrix = np.eye(dimension) + np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross)
    return matrix, about - matrix @ about, angle


def _sharp(shift: np.ndarray) -> np.ndarray:
    """Clears the components of a translation that are round-off: the usual case keeps coordinates bit for bit."""
    return np.where(np.abs(shift) < ALONG_AXIS * np.abs(shift).max(), 0, shift)


def _generator(axis: np.ndarray | None, dimension: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns the matrix of the cross product with the axis, and the projection onto the plane at right angles to it."""
    if axis is None:
        return np.array([[0.0, -1.0], [1.0, 0.0]]), np.eye(dimension)
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return cross, -cross @ cross


def merged(pairings: Sequence[Pairing], size: float) -> tuple[Pairing, ...]:
    """Makes one of all pairs with one transform, or with its inverse: the sides of a passage that are cut into patches."""
    # Each pairing, or its inverse, joins the first earlier one with its transform; a transform that is new begins another.
    different: list[Pairing] = []
    for pairing in pairings:
        for k, other in enumerate(different):
            alike = [way for way in (pairing, pairing.inverse) if _is_same_transform(way, other, size)]
            if alike:
                different[k] = _union(other, alike[0])
                break
        else:
            different.append(pairing)
    return tuple(different)


def _is_same_transform(one: Pairing, other: Pairing, size: float) -> bool:
    is_same_turn = np.abs(one.matrix - other.matrix).max() < 1e-9
    return bool(is_same_turn and np.abs(one.shift - other.shift).max() < 1e-6 * size)


def _union(one: Pairing, other: Pairing) -> Pairing:
    both = [np.stack([pairing.first, pairing.second], axis=1) for pairing in (one, other)]
    first, second = np.unique(np.concatenate(both), axis=0).T
    alone, copies = np.unique(np.concatenate([one.alone, other.alone])), max(one.copies, other.copies)
    return Pairing(first, second, alone, one.matrix, one.shift, one.keeps, one.turn, copies, one.is_rotation)


def check_pairings(pairings: Sequence[Pairing], planes: Sequence[Plane], size: float) -> None:
    """Raises `ValueError` for transforms that do not keep each other's images: a plane that is turned, axes that differ."""
    for k, pairing in enumerate(pairings):
        for normal in (plane.normal for plane in planes):
            along = pairing.matrix @ normal
            if np.abs(along - normal).max() > 1e-9 or abs(normal @ pairing.shift) > 1e-9 * size:
                raise ValueError(
                    f"the symmetry plane with normal {normal.tolist()} is not kept by a periodic transform: it must stand along "
                    "the translation, or at right angles to the rotation's axis."
                )
        for other in pairings[:k]:
            there = pairing.matrix @ other.shift + pairing.shift - other.matrix @ pairing.shift - other.shift
            back = pairing.matrix @ other.matrix - other.matrix @ pairing.matrix
            if np.abs(there).max() > 1e-6 * size or np.abs(back).max() > 1e-6:
                raise ValueError("two periodic transforms must give the same in either order: rotations need one axis.")
