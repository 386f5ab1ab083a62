"""The rows of a surface as a method sees them: in an order of places, with images."""

import dataclasses
import itertools
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._host.package.rounding import Tree, rows_in
from .._kernels.values import as_jax
from .boundary import Boundary
from .outer_faces import mask, row_of
from .periodic import Pairing
from .symmetry import Plane, facing, tolerance


class Images(eqx.Module):
    """The own rows of a surface in canonical order, extended by their images.

    Methods see extended rows alone: no result depends on how nodes are numbered. Extended row i is
    the image of own row `rows[i]` by the transform `kind[i]`: x -> `matrices` x + `shifts`. Kind 0
    is the identity. Own row j lies on plane k where `on_plane[j, k]`. `pairings` pair own rows;
    `powers[t, q]` is the power of periodic transform q in transform t.
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
        shifts = self.shifts
        moved = []
        for p, (old, new) in enumerate(zip(self.pairings, pairings, strict=True)):
            shift = jnp.asarray(new.shift, shifts.dtype)
            shifts = (
                shifts
                + self.powers[:, p, None] * (shift - jnp.asarray(old.shift, shifts.dtype))[None]
            )
            moved.append(dataclasses.replace(old, shift=shift))
        return dataclasses.replace(self, shifts=shifts, pairings=tuple(moved))

    def points(self, points: Float[Array, "o d"]) -> Float[Array, "b d"]:
        rows = self.vectors(points)
        return rows if len(self.shifts) == 1 else rows + self.shifts.astype(points.dtype)[self.kind]

    def vectors(self, u: Float[Array, "o d"]) -> Float[Array, "b d"]:
        if len(self.matrices) == 1:
            return u[self.rows]
        turns = self.matrices.astype(u.dtype)[self.kind]
        image = jnp.einsum("bij,bj->bi", turns, u[self.rows], precision="highest")
        return jnp.where(self.kind[:, None] == 0, u[self.rows], image)

    def kept(self, u: Float[Array, "o d"]) -> Float[Array, "o d"]:
        """Projects displacements: rows stay on their planes, and periodic pairs move alike."""
        u = self.within(u, self.on_plane)
        for pairing in self.pairings:
            u = pairing.alike(u)
        return u

    def within(self, u: Float[Array, "n d"], on_plane: Bool[Array, "n p"]) -> Float[Array, "n d"]:
        for k, normal in enumerate(self.normals):
            normal = normal.astype(u.dtype)
            u = jnp.where(on_plane[:, k, None], u - (u @ normal)[:, None] * normal[None], u)
        return u

    @property
    def planes(self) -> tuple[Plane, ...]:
        return tuple(map(Plane, self.normals, self.origins))


@dataclasses.dataclass(frozen=True)
class Copies:
    """The places of the images of a surface's own rows, on the host."""

    places: (
        np.ndarray
    )  # (t, o) number of the place of an own row's image by a transform; equal numbers coincide
    roots: np.ndarray  # (o,) the own row that an own row repeats by a periodic transform, or itself
    rows: np.ndarray  # (b,) own row of an extended row; no place twice
    kind: np.ndarray  # (b,) transform of an extended row
    matrices: np.ndarray  # (t, d, d) of the transforms
    sides: np.ndarray  # (o, s) True for own rows on a side of a periodic pair

    @property
    def first(self) -> np.ndarray:
        """The first extended row (b,) that is an image of a row's own row or periodic partner."""
        _, first, inverse = np.unique(self.roots[self.rows], return_index=True, return_inverse=True)
        return first[inverse]

    def faces(self, corners: Int[np.ndarray, "k c"]) -> Int[np.ndarray, "l c"]:
        """Extends faces between own rows by their images: each once, none on periodic sides."""
        # The images of a face are rows of place numbers, equal for one face. The extended row of a
        # place is found by its number.
        is_between = self.sides[corners].all(axis=1)
        corners = corners[~is_between.any(axis=-1)]
        faces = self.places[:, corners]
        is_mirrored = np.linalg.det(self.matrices) < 0
        faces[is_mirrored] = faces[is_mirrored][..., ::-1]  # counterclockwise again
        faces = faces.reshape(-1, corners.shape[1])
        place = self.places[self.kind, self.rows]
        first = np.sort(np.unique(np.sort(faces, axis=1), axis=0, return_index=True)[1])
        return rows_in(place, faces[first]).astype(np.int32)


def images_of(boundary: Boundary, order: np.ndarray) -> tuple[Images, Copies]:
    """Makes the images of a boundary's nodes (o,), and the list of their places; moving nodes come
    first.

    The own rows of the `Copies` are those of the nodes in an `order` (o,), which keeps moving nodes
    first. Parallel planes make no images. Of several rows and images at one place, one counts. The
    nearest images come first.
    """
    planes = boundary.planes
    nodes = boundary.nodes
    (n, d), own, on_plane = boundary.points.shape, nodes[order], boundary.on_planes[nodes]
    numbers = row_of(own, n), row_of(nodes, n)
    pairs, own_pairs = (
        tuple(pairing.renumbered(row) for pairing in boundary.pairings) for row in numbers
    )
    powers, flags = _elements(planes, pairs)
    transforms = np.stack(
        [_transform(planes, pairs, *element, d) for element in zip(powers, flags, strict=True)]
    )
    matrices = transforms[:, :-1, :-1]
    shifts = transforms[:, :-1, -1]
    places, roots = _numbered(powers, flags, pairs, on_plane[order])
    if pairs:
        x = boundary.points[own]
        places = _joined(
            places, np.einsum("tij,oj->toi", matrices, x.astype(float)) + shifts[:, None], x
        )
    # each place once: moving rows first, own rows before images
    kind, rows = np.divmod(np.sort(np.unique(places, return_index=True)[1]), len(nodes))
    first = np.argsort(rows >= len(boundary.moving), kind="stable")
    rows = rows[first].astype(np.int32)
    kind = kind[first].astype(np.int32)
    listed = [
        mask(len(nodes), side, pairing.alone)
        for pairing in pairs
        for side in (pairing.first, pairing.second)
    ]
    sides = np.array(listed, dtype=bool).reshape(-1, len(nodes)).T
    normals, origins = np.reshape(
        [(plane.normal, plane.origin) for plane in planes], (-1, 2, d)
    ).swapaxes(0, 1)
    of_rows = order[rows].astype(np.int32), kind, matrices, shifts, powers, own_pairs
    return Images(*as_jax((normals, origins, on_plane, *of_rows))), Copies(
        places, roots, rows, kind, matrices, sides
    )


def _elements(
    planes: Sequence[Plane], pairings: Sequence[Pairing]
) -> tuple[Int[np.ndarray, "t q"], Int[np.ndarray, "t p"]]:
    # A transform is a power of every periodic transform, then a mirror flag of every plane. The
    # sort by the sum of powers is stable.
    flags = itertools.product(
        *((False,) if is_facing else (False, True) for is_facing in facing(planes))
    )
    powers = itertools.product(*(pairing.powers for pairing in pairings))
    elements = sorted(
        itertools.product(powers, flags), key=lambda element: sum(map(abs, element[0]))
    )
    every, mirrored = (np.array(part, dtype=np.int32) for part in zip(*elements, strict=True))
    return every, mirrored


def _numbered(
    powers: Int[np.ndarray, "t q"],
    flags: Int[np.ndarray, "t p"],
    pairings: Sequence[Pairing],
    on_plane: Bool[np.ndarray, "o p"],
) -> tuple[Int[np.ndarray, "t o"], Int[np.ndarray, " o"]]:
    # Each image position is one integer of mixed radix: a bit for each mirror plane, then a digit
    # for the periodic power of each pairing, then the source row. Rows on a plane, on an axis, and
    # on second sides have the integer of the row that they repeat: equal integers, one position.
    count, size = on_plane.shape
    roots = np.arange(count)
    radix = 1 << size
    bits = 1 << np.arange(size)
    places = (flags @ bits)[:, None] & ~(on_plane @ bits)[None]
    for power, pairing in zip(powers.T, pairings, strict=True):
        span = pairing.turn or 2 * pairing.copies + 2
        steps = (power[:, None] + mask(count, pairing.second)[None] + pairing.copies) % span
        steps[:, pairing.alone] = 0
        places = places + radix * steps
        radix = radix * span
        to_first = np.arange(count)
        to_first[pairing.second] = pairing.first
        roots = to_first[roots]
    return places + radix * roots[None], roots


def _joined(
    places: Int[np.ndarray, "t o"], at: Float[np.ndarray, "t o d"], points: np.ndarray
) -> np.ndarray:
    """Gives one number to images that coincide, for example where walls meet a periodic side."""
    # Pairs of nearby places are sorted, own rows first, and the second place takes the number of
    # the first. Two images by one transform keep their numbers: nodes that coincide in the mesh
    # stay two.
    numbers, first = np.unique(places, return_index=True)
    first = np.sort(first)  # own rows come before images
    kind = first // len(points)
    pairs = Tree(at.reshape(-1, at.shape[-1])[first]).query_pairs(
        tolerance(points), output_type="ndarray"
    )
    pairs = np.sort(pairs, axis=1)
    pairs = pairs[kind[pairs[:, 0]] != kind[pairs[:, 1]]]
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    joined = numbers.copy()
    for into, other in np.searchsorted(numbers, places.ravel()[first[pairs]]):
        if joined[other] == numbers[other]:
            joined[other] = joined[into]
    return joined[np.searchsorted(numbers, places)]


def _transform(
    planes: Sequence[Plane],
    pairings: Sequence[Pairing],
    powers: np.ndarray,
    flags: np.ndarray,
    dimension: int,
) -> Float[np.ndarray, "e e"]:
    """The affine matrix of one image: first periodic transforms, then reflections."""
    affine = np.eye(dimension + 1)
    for pairing, k in zip(pairings, powers, strict=True):
        affine = pairing.power(int(k)) @ affine
    for plane in itertools.compress(planes, flags):
        mirror = np.eye(dimension + 1)
        mirror[:-1] -= 2 * np.outer(
            plane.normal, np.append(plane.normal, -plane.origin @ plane.normal)
        )
        affine = mirror @ affine
    return affine
