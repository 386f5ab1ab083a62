"""Images of the surface: mirrored in symmetry planes and repeated by periodic transforms before a method sees it."""

import dataclasses
import itertools
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.spatial import KDTree

from .._kernels.values import as_jax
from .periodic import Pairing
from .symmetry import Plane, facing, tolerance


class Images(eqx.Module):
    """Extends the own rows of a surface by their images.

    Extended row i is the image of own row `rows[i]` by the transform `kind[i]`, x -> `matrices` x + `shifts`; kind 0 is the row
    itself. Own row j lies on the planes k for which `on_plane[j, k]`; `pairings` pair own rows, and `powers` are how often each
    transform takes each of them.
    """

    normals: Float[Array, "p d"]
    origins: Float[Array, "p d"]
    on_plane: Bool[Array, "o p"]
    rows: Int[Array, " b"]
    kind: Int[Array, " b"]
    matrices: Float[Array, "t d d"]
    shifts: Float[Array, "t d"]
    powers: Int[Array, "t q"]
    pairings: tuple[Pairing, ...]

    def at(self, pairings: Sequence[Pairing]) -> "Images":
        """Takes the shifts from `pairings` that differ only in their translations. Traced."""
        shifts, moved = self.shifts, []
        for p, (old, new) in enumerate(zip(self.pairings, pairings, strict=True)):
            shift = jnp.asarray(new.shift, shifts.dtype)
            shifts = shifts + self.powers[:, p, None] * (shift - jnp.asarray(old.shift, shifts.dtype))[None]
            moved.append(eqx.tree_at(lambda pairing: pairing.shift, old, shift))
        return eqx.tree_at(lambda images: (images.shifts, images.pairings), self, (shifts, tuple(moved)))

    def points(self, points: Float[Array, "o d"]) -> Float[Array, "b d"]:
        """Computes the coordinates of all rows, images too."""
        return self.vectors(points) + self.shifts.astype(points.dtype)[self.kind]

    def vectors(self, u: Float[Array, "o d"]) -> Float[Array, "b d"]:
        """Computes the displacements of all rows, images too."""
        turns = self.matrices.astype(u.dtype)[self.kind]
        image = jnp.einsum("bij,bj->bi", turns, u[self.rows], precision="highest")
        return jnp.where(self.kind[:, None] == 0, u[self.rows], image)

    def extended(self, u: Float[Array, "o d"]) -> Float[Array, "b d"]:
        """Computes the displacements of all rows from any of the original rows."""
        return self.vectors(self.kept(u))

    def kept(self, u: Float[Array, "o d"]) -> Float[Array, "o d"]:
        """Changes displacements of the own rows so that rows on a plane stay in it, and periodic ones move alike."""
        u = self.within(u, self.on_plane)
        for pairing in self.pairings:
            u = pairing.alike(u)
        return u

    def within(self, u: Float[Array, "n d"], on_plane: Bool[Array, "n p"]) -> Float[Array, "n d"]:
        """Removes the components of displacements normal to the planes on which the nodes lie."""
        for k, normal in enumerate(self.normals):
            normal = normal.astype(u.dtype)
            u = jnp.where(on_plane[:, k, None], u - (u @ normal)[:, None] * normal[None], u)
        return u

    @property
    def planes(self) -> tuple[Plane, ...]:
        """The symmetry planes, on the host."""
        return tuple(Plane(*each) for each in zip(self.normals, self.origins, strict=True))


@dataclasses.dataclass(frozen=True)
class Copies:
    """Lists, on the host, where the images of a surface's own rows stand.

    - `places` (t, o): a number for the place of each own row's image by each of t transforms; equal ones coincide.
    - `roots` (o,): the own row for which a row stands that a periodic transform leads to.
    - `rows`, `kind` (b,): own row and transform of each extended row, no place twice; the first `moving` ones move.
    - `matrices` (t, d, d), `shifts` (t, d): the transforms.
    - `powers` (t, q): how often each of them takes each periodic one.
    - `sides` (o, s): which own rows lie on which sides of the periodic pairs.
    """

    places: np.ndarray
    roots: np.ndarray
    rows: np.ndarray
    kind: np.ndarray
    moving: int
    matrices: np.ndarray
    shifts: np.ndarray
    powers: np.ndarray
    sides: np.ndarray

    @property
    def first(self) -> np.ndarray:
        """The first extended row (b,) that repeats each extended row or its periodic partner."""
        _, first, inverse = np.unique(self.roots[self.rows], return_index=True, return_inverse=True)
        return first[inverse]

    def faces(self, corners: Int[np.ndarray, "k c"]) -> Int[np.ndarray, "l c"]:
        """Extends faces between own rows by their images: each place once, and none between a copy and the next."""
        between = self.sides[corners].all(axis=1)
        corners = corners[~between.any(axis=-1)]
        wanted = self.places[:, corners]
        flipped = np.linalg.det(self.matrices) < 0
        wanted[flipped] = wanted[flipped][..., ::-1]  # seen from outside, as the face is
        wanted = wanted.reshape(-1, corners.shape[1])
        at = self.places[self.kind, self.rows]
        order = np.argsort(at)
        once = np.sort(np.unique(np.sort(wanted, axis=1), axis=0, return_index=True)[1])
        return order[np.searchsorted(at[order], wanted[once])].astype(np.int32)


def copies(
    planes: Sequence[Plane],
    pairings: Sequence[Pairing],
    on_plane: Bool[np.ndarray, "o p"],
    moving: int,
    points: Float[np.ndarray, "o d"],
) -> Copies:
    """Finds the images of own rows at `points`, the first `moving` of them moving; `pairings` are of own rows.

    Parallel planes make no images. Nor does a row whose image would stand where another row does. The nearest images come first.
    """
    flags = list(itertools.product(*((False,) if has_other else (False, True) for has_other in facing(planes))))
    powers = [pairing.powers for pairing in pairings]
    elements = sorted(
        itertools.product(itertools.product(*powers), flags), key=lambda each: sum(map(abs, each[0]))
    )  # stable: as they come among those as near
    matrices, shifts = map(
        np.stack, zip(*(_transform(planes, pairings, *element) for element in elements), strict=True)
    )
    places, roots = _numbered(elements, pairings, on_plane)
    if pairings:
        places = _joined(places, np.einsum("tij,oj->toi", matrices, points.astype(float)) + shifts[:, None], points)
    rows, kind = _once(places, moving)
    lying = [np.union1d(side, pairing.alone) for pairing in pairings for side in (pairing.first, pairing.second)]
    sides = np.zeros((len(points), len(lying)), dtype=bool)
    for column, rows_there in zip(sides.T, lying, strict=True):
        column[rows_there] = True
    taken = np.array([exponents for exponents, _ in elements], dtype=np.int32).reshape(len(elements), len(pairings))
    return Copies(places, roots, rows, kind, int((rows < moving).sum()), matrices, shifts, taken, sides)


def _numbered(
    elements: Sequence[tuple], pairings: Sequence[Pairing], on_plane: Bool[np.ndarray, "o p"]
) -> tuple[Int[np.ndarray, "t o"], Int[np.ndarray, " o"]]:
    """Numbers the place of each row's image by each transform; finds the row for which each row stands."""
    # Each image position is one integer of mixed radix: a bit for each mirror plane, then a digit
    # for the periodic power of each pairing, then the source row. Rows on a plane, on an axis, and
    # on second sides have the integer of the row that they repeat: equal integers, one position.
    count, size = on_plane.shape
    roots, radix = np.arange(count), 1 << size
    places = np.array([[np.array(flag, dtype=np.int64) @ (1 << np.arange(size))] for _, flag in elements])
    places = places & ~(on_plane @ (1 << np.arange(size)))[None]
    for p, pairing in enumerate(pairings):
        power = np.array([exponents[p] for exponents, _ in elements])[:, None]
        ahead = np.zeros(count, dtype=np.int64)
        ahead[pairing.second] = 1
        span = pairing.turn or 2 * pairing.copies + 2
        steps = (power + ahead[None] + pairing.copies) % span
        steps[:, pairing.alone] = 0
        places, radix = places + radix * steps, radix * span
        to_first = np.arange(count)
        to_first[pairing.second] = pairing.first
        roots = to_first[roots]
    return places + radix * roots[None], roots


def _joined(places: Int[np.ndarray, "t o"], at: Float[np.ndarray, "t o d"], points: np.ndarray) -> np.ndarray:
    """Gives one number to places that coincide, as where walls meet a periodic side; nodes that coincide keep their own."""
    numbers, first = np.unique(places, return_index=True)
    count = len(points)
    first = np.sort(first)  # own rows come before images
    kind = first // count
    pairs = KDTree(at.reshape(-1, at.shape[-1])[first]).query_pairs(tolerance(points), output_type="ndarray")
    pairs = np.sort(pairs, axis=1)
    pairs = pairs[kind[pairs[:, 0]] != kind[pairs[:, 1]]]
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    one = numbers.copy()
    for into, other in np.searchsorted(numbers, places.ravel()[first[pairs]]):
        if one[other] == numbers[other]:
            one[other] = one[into]
    return one[np.searchsorted(numbers, places)]


def _once(places: Int[np.ndarray, "t o"], moving: int) -> tuple[np.ndarray, np.ndarray]:
    """Lists row and transform of each place once: moving rows first, own rows before their images."""
    count = places.shape[1]
    first = np.sort(np.unique(places, return_index=True)[1])
    kind, rows = np.divmod(first, count)
    order = np.argsort(rows >= moving, kind="stable")
    return rows[order], kind[order]


def _transform(planes: Sequence[Plane], pairings: Sequence[Pairing], powers, flags) -> tuple[np.ndarray, np.ndarray]:
    """Composes the transform of one image: periodic ones, then reflections."""
    dimension = len(planes[0].normal) if planes else len(pairings[0].shift)
    matrix, shift = np.eye(dimension), np.zeros(dimension)
    for pairing, k in zip(pairings, powers, strict=True):
        turn, by = pairing.power(k)
        matrix, shift = turn @ matrix, turn @ shift + by
    for plane, is_mirrored in zip(planes, flags, strict=True):
        if is_mirrored:
            turn = np.eye(dimension) - 2 * np.outer(plane.normal, plane.normal)
            matrix, shift = turn @ matrix, turn @ shift + 2 * (plane.origin @ plane.normal) * plane.normal
    return matrix, shift


def images_of(
    planes: Sequence[Plane],
    pairings: Sequence[Pairing],
    on_plane: Bool[np.ndarray, "n p"],
    nodes: np.ndarray,
    moving: int,
    points: Float[np.ndarray, "n d"],
) -> tuple[Images, Copies]:
    """Makes the images of the surface's `nodes` among `points`, the first `moving` of them moving, and lists where they stand."""
    place = np.full(len(on_plane), -1, dtype=np.int32)
    place[nodes] = np.arange(len(nodes))
    rows = [pairing.renumbered(place) for pairing in pairings]
    made = copies(planes, rows, on_plane[nodes], moving, points[nodes])
    dimension = made.shifts.shape[1]
    normals = np.stack([plane.normal for plane in planes]) if planes else np.zeros((0, dimension))
    origins = np.stack([plane.origin for plane in planes]) if planes else np.zeros((0, dimension))
    kind, images = made.kind.astype(np.int32), made.rows.astype(np.int32)
    parts = (normals, origins, on_plane[nodes], images, kind, made.matrices, made.shifts, made.powers)
    return Images(*as_jax((*parts, tuple(rows)))), made
