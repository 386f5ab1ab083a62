"""Periodic patches, their pairs of nodes, and the transforms between these."""

import contextlib
import dataclasses
import itertools
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._host.linear.products import row_lengths
from .._host.package.arguments import between, check_patch, whole
from .._host.package.errors import check_none, worst_first
from .._host.package.rounding import Tree, extent_of, spacing
from .._host.tolerances import ALIGNED, MISMATCH, NO_TURN, SAME, SAME_TRANSFORM
from .._kernels.values import Either
from .outer_faces import Ids, Points
from .symmetry import Plane, facing, optional, tolerance

Nodal = Float[Array, "n d"]  # a place, or a displacement, of every node


@dataclasses.dataclass(frozen=True, eq=False, init=False)
class Periodic:
    """Two patches of which the second repeats the first.

    Examples are passages of a cascade, sectors of a wheel and ends of a duct. A method sees the
    neighbours of the surface, and every pair of nodes takes its mean displacement. Both patches
    move: they may change shape, but stay copies of each other. Without `translation`, `rotation`,
    `about` and `axis`, the transform is the translation between the middles of the patches. If the
    patches do not match, it is a rotation about an axis of coordinates (in 2-D about the origin).

    **Arguments:**

    - `patch`, `partner`: names of patches, or ids of their nodes; the transform leads from the
      first to the second.
    - `translation`: vector (d,), in the mesh's units. Default: found.
    - `rotation`: angle in radians. Default: found from the middles of the patches.
    - `about`: a point (d,) on the axis of the rotation. Default: the origin.
    - `axis`: direction (3,) of the rotation's axis, only in 3-D.
    - `copies`: images of the surface on either side. Default 1. With 2, cells are a little better,
      and work takes longer.

    **Raises:** `ValueError` for a translation with a rotation, and for less than one copy.
    """

    patch: str | np.ndarray
    partner: str | np.ndarray
    translation: np.ndarray | None
    rotation: float | None
    about: np.ndarray | None
    axis: np.ndarray | None
    copies: int

    def __init__(
        self,
        patch,
        partner,
        *,
        translation=None,
        rotation=None,
        about=None,
        axis=None,
        copies: int = 1,
    ):
        if translation is not None and not (rotation is None and about is None and axis is None):
            raise ValueError("a periodic pair has a translation or a rotation, not both.")
        whole("copies", copies)
        check_patch("patch", patch)
        check_patch("partner", partner)
        if rotation is not None:
            between("rotation", rotation)
            rotation = float(rotation)
        vectors = {"translation": translation, "about": about, "axis": axis}
        vectors = {name: optional(name, value, (2,), (3,)) for name, value in vectors.items()}
        vars(self).update(
            patch=patch, partner=partner, rotation=rotation, copies=int(copies), **vectors
        )

    @property
    def name(self) -> str:
        sides = (self.patch, self.partner)
        names = (repr(side) if isinstance(side, str) else f"of {len(side)} nodes" for side in sides)
        return f"the periodic patches {' and '.join(names)}"

    @property
    def patches(self) -> list[str]:
        """The names of the two sides, where they have names."""
        return [side for side in (self.patch, self.partner) if isinstance(side, str)]

    @property
    def is_rotation(self) -> bool:
        return not (self.rotation is None and self.about is None and self.axis is None)


class Pairing(eqx.Module):
    """Pairs of nodes, and the transform x -> `matrix` x + `shift` from `first` to `second`."""

    first: Int[Either, " q"]  # ids or rows of the nodes
    second: Int[Either, " q"]  # their partners
    alone: Int[Either, " s"]  # nodes on the axis of a rotation, which the transform does not move
    matrix: Float[Either, "d d"]
    shift: Float[Either, " d"]
    keeps: Float[Either, "d d"]  # projection onto the vectors that the transform does not turn
    turn: int = eqx.field(static=True)  # sectors in a whole turn; 0 if no power is the identity
    copies: int = eqx.field(
        static=True
    )  # images on either side; 0 for pairs that do no more than move alike
    is_rotation: bool = eqx.field(static=True)

    @property
    def nodes(self) -> np.ndarray:
        return np.concatenate([self.first, self.second, self.alone])

    @property
    def powers(self) -> list[int]:
        """The powers of the transform that make images, the nearest first: 0, 1, -1, 2, ..."""
        powers = sorted(range(-self.copies, self.copies + 1), key=lambda k: (abs(k), -k))
        equal = {
            k % self.turn if self.turn else k: k for k in powers[::-1]
        }  # the nearest of equal images
        return list(equal.values())[::-1]

    def power(self, k: int) -> Float[np.ndarray, "e e"]:
        """The affine matrix (d + 1, d + 1) of a power of the transform."""
        affine = np.eye(len(self.shift) + 1)
        affine[:-1] = np.column_stack([self.matrix, self.shift])
        return np.linalg.matrix_power(affine, k)

    @property
    def inverse(self) -> "Pairing":
        back = self.power(-1)[:-1]
        return dataclasses.replace(
            self, first=self.second, second=self.first, matrix=back[:, :-1], shift=back[:, -1]
        )

    def renumbered(self, place: Int[np.ndarray, " n"]) -> "Pairing":
        """Renumbers node k to `place[k]`. Pairs with a node of place -1 are dropped."""
        pairs = place[np.stack([self.first, self.second])]
        alone = place[np.asarray(self.alone)]
        first, second = pairs[:, (pairs >= 0).all(axis=0)]
        return dataclasses.replace(self, first=first, second=second, alone=alone[alone >= 0])

    def at(self, points: Nodal) -> "Pairing":
        """Moves pairs to other base points: translations follow, rotations stay. Traced."""
        if self.is_rotation:
            return self
        difference = points[self.second] - points[self.first]
        mean = jnp.mean(difference, axis=0)
        # The median is the value of most pairs, free of round-off; the mean has a smooth
        # derivative.
        shift = mean + jax.lax.stop_gradient(jnp.median(difference, axis=0) - mean)
        shift = jnp.where(jnp.abs(shift) < SAME * jnp.max(jnp.abs(shift)), 0, shift)
        return dataclasses.replace(self, shift=shift)

    def misses(self, points: Points) -> Float[np.ndarray, " q"]:
        """Distances of second nodes from their partners' images, on the host."""
        return row_lengths(points[self.first] @ self.matrix.T + self.shift - points[self.second])

    def matched(self, base: Nodal, points: Nodal) -> Nodal:
        """Makes pairs match bit for bit if a translation does so at `base`. Traced."""
        if self.is_rotation:
            return points
        shift = jnp.asarray(self.shift, points.dtype)[None]
        matched = base[self.first] + shift == base[self.second]
        return points.at[self.second].set(
            jnp.where(matched, points[self.first] + shift, points[self.second])
        )

    def alike(self, u: Nodal) -> Nodal:
        """Makes displacements of a pair equal after the transform, by their mean. Traced."""
        matrix = jnp.asarray(self.matrix, u.dtype)
        keeps = jnp.asarray(self.keeps, u.dtype)
        mean = (u[self.first] + _product(u[self.second], matrix)) / 2
        u = u.at[self.first].set(mean).at[self.second].set(_product(mean, matrix.T))
        return u.at[self.alone].set(_product(u[self.alone], keeps)) if len(self.alone) else u

    def led(self, u: Nodal) -> Nodal:
        """Moves the second nodes as the first nodes move, after the transform. Traced."""
        return u.at[self.second].set(_product(u[self.first], jnp.asarray(self.matrix, u.dtype).T))


def _product(rows: Nodal, matrix: Float[Array, "d d"]) -> Nodal:
    return jnp.matmul(rows, matrix, precision="highest")


def _differ(first: np.ndarray, second: np.ndarray, size: float) -> bool:
    """Whether affine matrices differ, in lengths of a mesh of this `size`."""
    units = np.append(np.ones(len(first) - 1), size)
    return bool((np.abs(first - second)[:-1] > SAME_TRANSFORM * units).any())


def merged(pairings: Sequence[Pairing], size: float) -> tuple[Pairing, ...]:
    """Joins all pairings of one transform, such as the sides of a passage cut into patches."""
    joined: list[Pairing] = []
    for pairing in pairings:
        pairs = itertools.product(enumerate(joined), (pairing, pairing.inverse))
        equal = [
            (k, other, way)
            for (k, other), way in pairs
            if not _differ(way.power(1), other.power(1), size)
        ]
        for k, other, way in equal[:1]:
            first, second = np.unique(
                np.hstack([[side.first, side.second] for side in (other, way)]), axis=1
            )
            alone = np.unique([*other.alone, *way.alone]).astype(np.int32)
            copies = max(other.copies, way.copies)
            joined[k] = dataclasses.replace(
                other, first=first, second=second, alone=alone, copies=copies
            )
        joined += [] if equal else [pairing]
    return tuple(joined)


def check_pairings(pairings: Sequence[Pairing], planes: Sequence[Plane], size: float) -> None:
    """Refuses transforms that turn a symmetry plane, or that do not commute."""
    pairings = [pairing for pairing in pairings if pairing.copies]  # others may lie across a plane
    for pairing, plane in itertools.product(pairings, planes):
        normal = plane.normal
        if (
            np.abs(pairing.matrix @ normal - normal).max() > ALIGNED
            or abs(normal @ pairing.shift) > SAME * size
        ):
            raise ValueError(
                f"a periodic transform moves the symmetry plane with normal {normal.tolist()}: "
                "the plane must be parallel to "
                "the translation, or at right angles to the rotation's axis."
            )
    for first, second in itertools.combinations([pairing.power(1) for pairing in pairings], 2):
        if _differ(first @ second, second @ first, size):
            raise ValueError("two periodic transforms must commute: all rotations need one axis.")


def paired(
    periodic: Periodic, first: Ids, second: Int[np.ndarray, " l"], points: Points
) -> Pairing:
    ways = [periodic]
    if periodic.translation is None and not periodic.is_rotation:
        axes = (
            [{"axis": axis} for axis in np.eye(3)] if points.shape[1] == 3 else [{"about": (0, 0)}]
        )
        ways += [
            Periodic(periodic.patch, periodic.partner, copies=periodic.copies, **axis)
            for axis in axes
        ]
    errors = []
    for way in ways:
        try:
            return _paired(way, first, second, points)
        except ValueError as error:
            errors.append(error)
    raise errors[0]


def across_one_layer(
    planes: Sequence[Plane], on: Bool[np.ndarray, "n p"], points: Points
) -> tuple[Pairing, ...]:
    """Pairs the nodes of two parallel planes that hold all nodes, around one layer of cells. The
    pairs move alike, and make no images. There are none where the planes' nodes do not match.
    """
    pairs = zip(planes, map(np.flatnonzero, on.T), strict=True)
    for (one, first), (other, second) in itertools.combinations(pairs, 2):
        normal = one.normal
        if facing((one, other)).all() and 2 * len(first) == 2 * len(second) == len(points):
            pair = Periodic(
                first, second, translation=(other.origin - one.origin) @ normal * normal
            )
            with contextlib.suppress(ValueError):
                return (dataclasses.replace(_paired(pair, first, second, points), copies=0),)
    return ()


def _paired(
    periodic: Periodic, first: Ids, second: Int[np.ndarray, " l"], points: Points
) -> Pairing:
    exact = points.astype(float)
    if not len(first) or not len(second):
        raise ValueError(f"{periodic.name}: one of them has no nodes.")
    matrix, shift, keeps, angle = _transform(
        periodic, exact[first].mean(axis=0), exact[second].mean(axis=0)
    )
    partner = _partners(periodic, first, second, points, exact[first] @ matrix.T + shift)
    is_alone = first == partner
    sectors = 2 * np.pi / abs(angle) if angle else 0
    turn = round(sectors) if abs(sectors - round(sectors)) < SAME_TRANSFORM * sectors else 0
    copies = (
        periodic.copies
        if turn or not angle
        else max(1, min(periodic.copies, int((sectors - 1) / 2)))
    )
    pairs = first[~is_alone].astype(np.int32), partner[~is_alone].astype(np.int32)
    if not angle and periodic.translation is None:
        shift = _sharp(
            np.median(exact[pairs[1]] - exact[pairs[0]], axis=0)
        )  # most pairs have it bit for bit
    return Pairing(
        *pairs,
        first[is_alone].astype(np.int32),
        matrix,
        shift,
        keeps,
        turn,
        copies,
        periodic.is_rotation,
    )


def _partners(
    periodic: Periodic,
    first: np.ndarray,
    second: np.ndarray,
    points: np.ndarray,
    images: np.ndarray,
) -> np.ndarray:
    exact = points[second].astype(float)
    distance, nearest = map(np.asarray, Tree(exact).query(images))
    gaps = np.minimum(spacing(exact), extent_of(points.astype(float)))
    allowed = np.maximum(MISMATCH * gaps[nearest], 2 * tolerance(points))
    check_none(
        first[worst_first(distance, allowed)],
        f"{periodic.name} do not match: {{count}} of {len(first)} nodes of the first have no "
        f"partner, the worst is node {{node}} "
        f"at ({{place}}): {distance[distance > allowed].max(initial=0):.3g} from the nearest "
        "after the transform. Check "
        "`translation`, or `rotation`, `about` and `axis`; they lead from the first patch to the "
        "second.",
        points,
    )
    check_none(
        np.setdiff1d(second, second[nearest]),
        f"{periodic.name} do not match: {{count}} of {len(second)} nodes of the second have no "
        f"partner, first node {{node}} at "
        "({place}). Both patches need equal nodes: mesh one as the copy of the other.",
        points,
    )
    return second[nearest]


def _transform(
    periodic: Periodic, middle: np.ndarray, other: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Matrix and shift of a transform, the projection on what it does not turn, and its angle."""
    d = len(middle)
    _check_vectors(periodic, d)
    if not periodic.is_rotation:
        shift = _sharp(other - middle) if periodic.translation is None else periodic.translation
        if not np.abs(shift).max() > 0:
            raise ValueError(
                f"{periodic.name}: the translation is zero; give `rotation`, `about` or `axis`."
            )
        return np.eye(d), shift, np.eye(d), 0.0
    about = np.zeros(d) if periodic.about is None else periodic.about
    axis = (
        np.array([0.0, 0, 1])
        if periodic.axis is None
        else periodic.axis / np.linalg.norm(periodic.axis)
    )
    angle = periodic.rotation
    if angle is None:
        start, end = (
            np.cross(axis, np.pad(place - about, (0, 3 - d))) for place in (middle, other)
        )
        angle = float(np.arctan2(axis @ np.cross(start, end), start @ end))
    if not abs(np.sin(angle / 2)) > NO_TURN:
        raise ValueError(f"{periodic.name}: the angle of the rotation is zero.")
    along = np.outer(axis, axis)[:d, :d]
    across = np.cross(axis, np.eye(3)).T[:d, :d]
    matrix = np.cos(angle) * (np.eye(d) - along) + np.sin(angle) * across + along  # Rodrigues
    return matrix, about - matrix @ about, along, angle


def _check_vectors(periodic: Periodic, dimension: int) -> None:
    for name in ("translation", "about", "axis"):
        value = getattr(periodic, name)
        if value is not None and value.shape != (dimension,):
            raise ValueError(
                f"{periodic.name}: `{name}` has shape {value.shape}; the mesh has {dimension} "
                "dimensions."
            )
    if dimension == 2 and periodic.axis is not None:
        raise ValueError(f"{periodic.name}: a rotation in 2-D has no `axis`; give `about`.")
    if (
        dimension == 3
        and periodic.is_rotation
        and (periodic.axis is None or not periodic.axis.any())
    ):
        raise ValueError(f"{periodic.name}: a rotation in 3-D needs an `axis` that is not zero.")


def _sharp(shift: np.ndarray) -> np.ndarray:
    """Clears components of a translation that are round-off: their coordinates stay bit for bit."""
    return np.where(np.abs(shift) < SAME * np.abs(shift).max(), 0, shift)
