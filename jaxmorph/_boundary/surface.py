"""The surface of a mesh as methods see it: in an order of places, with images."""

import dataclasses
import itertools
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from .._host.cells.adjacency import parts_of
from .._host.package.rounding import Tree
from .._host.rows import Rows, first_of_equals, mark
from .._host.surface.walls import ordered_rows
from .._host.tolerances import OTHER_IMAGE
from .._kernels.values import as_jax
from .._methods.surface import Cells, Surface
from .conditions import Conditions
from .images import Images
from .periodic import Pairing
from .symmetry import Plane, facing, oblique_pairs, tolerance


def surface_of(
    boundary: Conditions, pairings: Sequence[Pairing] = (), order: np.ndarray | None = None
) -> tuple[Surface, Images]:
    """Returns the surface that a method sees, and its images by planes and `pairings`.

    The `order` (o,) of the surface's nodes, moving nodes first, follows from their places, unless
    it is known. Methods see this order, so that no result depends on how nodes are numbered.
    """
    nodes = boundary.nodes
    points = boundary.points[nodes]
    on_plane = boundary.on[nodes]
    moving = len(boundary.moving)
    faces = boundary.surface_faces
    order = ordered_rows(points, moving, faces) if order is None else order
    place = np.argsort(order)
    row = Rows(nodes).of(np.arange(len(boundary.points)))
    own = tuple(pairing.renumbered(row) for pairing in pairings)
    ordered = tuple(pairing.renumbered(place) for pairing in own)
    copies = _copies_of(on_plane[order], boundary.planes, ordered, points[order], moving)
    rows = order[copies.rows]
    images = _images_of(boundary.planes, on_plane, copies, rows, own)
    if faces is not None:
        faces = {kind: copies.faces(place[corners]) for kind, corners in faces.items()}
    is_guided = rows >= moving + len(boundary.fixed)
    places = points[order]
    if len(copies.transforms) > 1:
        places = np.asarray(images.points(jnp.asarray(points)))
    surface = Surface(
        points=places,
        nodes=np.where(copies.kind == 0, nodes[rows], -1),
        moving=int((rows < moving).sum()),
        images=copies.first,
        faces=faces,
        is_open=boundary.is_open,
        cells=_cells_of(boundary),
        in_planes=is_guided & on_plane[rows].any(axis=1),
        listed=rows,
        hidden=np.isin(nodes[rows], boundary.hidden),
    )
    return surface, images


def _normals_of_planes(planes: Sequence[Plane], dimension: int) -> Float[np.ndarray, "p d"]:
    return np.reshape([plane.normal for plane in planes], (-1, dimension))


def _cells_of(boundary: Conditions) -> Cells | None:
    if boundary.cells is None:
        return None
    normals = _normals_of_planes(boundary.planes, boundary.points.shape[1])
    return Cells(boundary.cells, normals, boundary.on)


def _images_of(
    planes: Sequence[Plane],
    on_plane: Bool[np.ndarray, "o p"],
    copies: "Copies",
    rows: Int[np.ndarray, " b"],
    pairings: tuple[Pairing, ...],
) -> Images:
    d = copies.transforms.shape[1] - 1
    parts = {
        "normals": _normals_of_planes(planes, d),
        "origins": np.reshape([plane.origin for plane in planes], (-1, d)),
        "on_plane": on_plane,
        "rows": rows.astype(np.int32),
        "kind": copies.kind,
        "matrices": copies.transforms[:, :-1, :-1],
        "shifts": copies.transforms[:, :-1, -1],
        "powers": copies.powers,
        "pairings": pairings,
    }
    return Images(**as_jax(parts), edges=oblique_pairs(planes))


@dataclasses.dataclass(frozen=True)
class Copies:
    """The places of the images of a surface's own rows, on the host."""

    # (t, o) number of the place of an own row's image by a transform; equal numbers coincide
    places: np.ndarray
    roots: np.ndarray  # (o,) the own row that an own row repeats by a periodic transform, or itself
    rows: np.ndarray  # (b,) own row of an extended row; no place twice
    kind: np.ndarray  # (b,) transform of an extended row
    transforms: np.ndarray  # (t, e, e) affine matrices
    powers: np.ndarray  # (t, q) the power of each periodic transform
    sides: np.ndarray  # (o, s) True for own rows on a side of a periodic pair

    @property
    def first(self) -> np.ndarray:
        """The first extended row (b,) that is an image of a row's own row or periodic partner."""
        first, place = first_of_equals(self.roots[self.rows])
        return first[place]

    def faces(self, corners: Int[np.ndarray, "k c"]) -> Int[np.ndarray, "l c"]:
        """Extends faces between own rows by their images: each once, none on periodic sides."""
        # The images of a face are rows of place numbers, equal for one face. The extended row of a
        # place is found by its number.
        is_between = self.sides[corners].all(axis=1)
        corners = corners[~is_between.any(axis=-1)]
        faces = self.places[:, corners]
        is_mirrored = np.linalg.det(self.transforms) < 0
        faces[is_mirrored] = faces[is_mirrored][..., ::-1]  # counterclockwise again
        faces = faces.reshape(-1, corners.shape[1])
        place = self.places[self.kind, self.rows]
        first = np.sort(np.unique(np.sort(faces, axis=1), axis=0, return_index=True)[1])
        return Rows(place).of(faces[first]).astype(np.int32)


def _copies_of(
    on_plane: Bool[np.ndarray, "o p"],
    planes: Sequence[Plane],
    pairs: Sequence[Pairing],
    points: np.ndarray,
    moving: int,
) -> Copies:
    """Lists the places of own rows at `points` (o, d), and of their images. Moving rows come first.

    Parallel planes make no images. Of several rows and images at one place, one counts. The nearest
    images come first.
    """
    count, d = points.shape
    mirrors, after = _mirrors(planes, d)
    powers, mirror = _elements(len(mirrors), pairs)
    elements = zip(powers, mirror, strict=True)
    transforms = np.stack([mirrors[m] @ _repeat(pairs, power, d) for power, m in elements])
    places, roots = _number_places(powers, mirror, after, pairs, on_plane)
    if pairs:
        images = np.einsum("tij,oj->toi", transforms[:, :-1, :-1], points.astype(float))
        places = _join_images(places, images + transforms[:, None, :-1, -1], points)
    # each place once: moving rows first, own rows before images
    kind, rows = np.divmod(np.sort(np.unique(places, return_index=True)[1]), count)
    first = np.argsort(rows >= moving, kind="stable")
    sides = [
        mark(count, side, pairing.alone)
        for pairing in pairs
        for side in (pairing.first, pairing.second)
    ]
    return Copies(
        places=places,
        roots=roots,
        rows=rows[first].astype(np.int32),
        kind=kind[first].astype(np.int32),
        transforms=transforms,
        powers=powers,
        sides=np.array(sides, dtype=bool).reshape(-1, count).T,
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
            if away.min() > OTHER_IMAGE:
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


def _number_places(
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
        steps = (power[:, None] + mark(count, pairing.second)[None] + pairing.copies) % span
        steps[:, pairing.alone] = 0
        places = places + radix * steps
        radix = radix * span
        to_first = np.arange(count)
        to_first[pairing.second] = pairing.first
        roots = to_first[roots]
    return places + radix * roots[None], roots


def _join_images(
    places: Int[np.ndarray, "t o"], at: Float[np.ndarray, "t o d"], points: np.ndarray
) -> np.ndarray:
    """Gives one number to images that coincide, for example where walls meet a periodic side."""
    # Pairs of nearby places are sorted, own rows first, and the second place takes the number of
    # the first. Two images by one transform keep their numbers: nodes that coincide in the mesh
    # stay two.
    numbers, first = np.unique(places, return_index=True)
    first = np.sort(first)  # own rows come before images
    kind = first // len(points)
    pairs = Tree(at.reshape(-1, at.shape[-1])[first]).close_pairs(tolerance(points))
    pairs = pairs[kind[pairs[:, 0]] != kind[pairs[:, 1]]]
    joined = numbers.copy()
    for into, other in np.searchsorted(numbers, places.ravel()[first[pairs]]):
        if joined[other] == numbers[other]:
            joined[other] = joined[into]
    return joined[np.searchsorted(numbers, places)]


def _repeat(
    pairings: Sequence[Pairing], powers: np.ndarray, dimension: int
) -> Float[np.ndarray, "e e"]:
    affine = np.eye(dimension + 1)
    for pairing, k in zip(pairings, powers, strict=True):
        affine = pairing.power(int(k)) @ affine
    return affine
