"""The rows of a surface as a method sees them: in an order of places, with images."""

import dataclasses
import itertools
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._host.cells.adjacency import parts_of
from .._host.package.rounding import Tree
from .._host.rows import Rows
from .._kernels.values import Either, as_jax
from .boundary import Boundary
from .outer_faces import mask, row_of
from .periodic import Pairing
from .symmetry import Plane, edges_of, facing, tolerance

DIFFERENT = 1e-3  # difference of two matrices of mirrors; the narrowest angle is a degree


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
    # pairs of planes that meet at another than a right angle
    edges: tuple[tuple[int, int], ...] = eqx.field(static=True, default=())

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
        for is_on, normal in self.normals_of(on_plane):
            normal = normal.astype(u.dtype)
            u = jnp.where(is_on[:, None], u - (u @ normal)[:, None] * normal[None], u)
        return u

    def normals_of(self, on_plane: Bool[Either, "n p"]) -> list[tuple[Bool[Either, " n"], Array]]:
        """Lists rows (n,), and the unit normal along which they do not move, to apply in turn."""
        sides = [(on_plane[:, k], normal) for k, normal in enumerate(self.normals)]
        for first, second in self.edges:  # the second normal would bring back some of the first
            normal = self.normals[second]
            across = self.normals[first] - (self.normals[first] @ normal) * normal
            is_on = on_plane[:, first] & on_plane[:, second]
            sides.append((is_on, across / jnp.linalg.norm(across)))
        return sides

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
        return Rows(place).of(faces[first]).astype(np.int32)


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
    mirrors, after = _mirrors(planes, d)
    powers, mirror = _elements(len(mirrors), pairs)
    transforms = np.stack(
        [mirrors[m] @ _repeated(pairs, power, d) for power, m in zip(powers, mirror, strict=True)]
    )
    matrices = transforms[:, :-1, :-1]
    shifts = transforms[:, :-1, -1]
    places, roots = _numbered(powers, mirror, after, pairs, on_plane[order])
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
    edges = edges_of(planes)
    return Images(*as_jax((normals, origins, on_plane, *of_rows)), edges=edges), Copies(
        places, roots, rows, kind, matrices, sides
    )


def _mirrors(
    planes: Sequence[Plane], dimension: int
) -> tuple[Float[np.ndarray, "g e e"], Int[np.ndarray, "g p"]]:
    """Affine matrices of all products of mirrors, and the number of each after one more mirror.

    The plane's own mirror comes before the product. Planes that face another have no mirror.
    """
    # Products are found from the shortest on; a product that is known gets no new number.
    is_facing = facing(planes)
    products = np.eye(dimension + 1)[None]
    after: list[list[int]] = []
    while len(after) < len(products):
        number = len(after)
        after.append([number] * len(planes))
        for k in np.flatnonzero(~is_facing)[::-1]:
            product = products[number] @ _mirror(planes[k])
            away = np.abs((products - product)[:, :-1, :-1]).max(axis=(1, 2))
            after[-1][k] = int(away.argmin())
            if away.min() > DIFFERENT:
                after[-1][k] = len(products)
                products = np.concatenate([products, product[None]])
    return products, np.reshape(after, (len(products), len(planes))).astype(int)


def _mirror(plane: Plane) -> Float[np.ndarray, "e e"]:
    affine = np.eye(len(plane.normal) + 1)
    affine[:-1] -= 2 * np.outer(plane.normal, np.append(plane.normal, -plane.origin @ plane.normal))
    return affine


def _elements(
    mirrors: int, pairings: Sequence[Pairing]
) -> tuple[Int[np.ndarray, "t q"], Int[np.ndarray, " t"]]:
    # A transform is a power of every periodic transform, then a product of mirrors. The sort by the
    # sum of powers is stable.
    powers = itertools.product(*(pairing.powers for pairing in pairings))
    elements = sorted(
        itertools.product(powers, range(mirrors)), key=lambda element: sum(map(abs, element[0]))
    )
    every, mirror = (np.array(part, dtype=np.int32) for part in zip(*elements, strict=True))
    return every, mirror


def _numbered(
    powers: Int[np.ndarray, "t q"],
    mirror: Int[np.ndarray, " t"],
    after: Int[np.ndarray, "g p"],
    pairings: Sequence[Pairing],
    on_plane: Bool[np.ndarray, "o p"],
) -> tuple[Int[np.ndarray, "t o"], Int[np.ndarray, " o"]]:
    # Each image position is one integer of mixed radix: a product of mirrors, then a digit for the
    # periodic power of each pairing, then the source row. On a plane, a product is the same with
    # and without the plane's mirror first, and has the lower number. Rows on second sides have the
    # integer of the row that they repeat: equal integers, one position.
    count = len(on_plane)
    roots = np.arange(count)
    radix = len(after)
    kinds, kind = np.unique(on_plane, axis=0, return_inverse=True)
    own = np.arange(radix)
    lowest = []
    for planes in kinds:
        other = after[:, planes]
        part = parts_of(np.repeat(own, other.shape[1]), other.ravel(), radix)
        lowest.append(np.unique(part, return_index=True)[1][part])
    places = np.reshape(lowest, (len(kinds), radix))[kind.ravel()][:, mirror].T
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


def _repeated(
    pairings: Sequence[Pairing], powers: np.ndarray, dimension: int
) -> Float[np.ndarray, "e e"]:
    affine = np.eye(dimension + 1)
    for pairing, k in zip(pairings, powers, strict=True):
        affine = pairing.power(int(k)) @ affine
    return affine
