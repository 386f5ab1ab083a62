"""The slope of a near-wall layer: first grid lines turn with the wall, whatever moves the rest."""

from collections.abc import Iterable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._host.linear.products import cofactors, determinant, unit_rows
from .._host.package.rounding import Tree
from .._host.surface.skin import edges, nearest_held
from .._kernels.values import Either, add_at, area_vectors, as_jax, at_rows, namespace, norm
from .base import Pairs, Rows, Scalar, or_one
from .surface import Surface

# the height up to which the layer turns as a whole, relative to its width or half of the gap to the
# next wall, where it ends, and to the radius of the largest ball inside the body or the mesh that
# touches the wall there
OF_WIDTH = 0.05
OF_BALL = 0.25
SLACK = 0.1  # sine of the angle to the wall below which a node does not bound a ball
ROUND = 1 - np.cos(np.deg2rad(20))  # it is an edge where faces turn so far from their mean normal
PROBE = 4e-3  # distance from the wall at which the coarse field is probed, relative to the width
BALLS = 8  # steps to the largest ball
NEAREST = 8  # nodes nearest to a ball's centre that may bound it


class WallTurnIds(eqx.Module):
    """Rows of the surface by which its first grid lines turn.

    - `faces`: the moving walls' faces (f, c) by number of corners.
    - `pairs` (p, 2): a row, and a row beside it at about its height, or at the next node.
    - `inside`, `outside` (b,): the row that bounds the largest ball at a row, on the body's side
      and on the mesh's, or the row itself.
    - `other` (b,): the nearest row of another wall, or the row itself.
    - `wall` (b,): each row's wall.
    """

    faces: tuple[Int[Array, "_f _c"], ...]
    pairs: Pairs
    inside: Int[Array, " b"]
    outside: Int[Array, " b"]
    other: Int[Array, " b"]
    wall: Int[Array, " b"]

    @classmethod
    def found(cls, surface: Surface, width: Float[np.ndarray, " b"]) -> "WallTurnIds | None":
        """Finds the rows on the host; None for a surface whose walls have no faces."""
        x = np.asarray(surface.points, float)
        faces = [
            corners[(corners < surface.moving).all(axis=1)]
            for corners in (surface.faces or {}).values()
        ]
        faces = [corners for corners in faces if len(corners)]
        if not faces:
            return None
        normal = unit_rows(_areas(faces, x)[0])
        own = np.unique(np.concatenate([corners.ravel() for corners in faces]))
        tree = Tree(x[own])
        wall = surface.walls.number
        largest = OF_WIDTH / OF_BALL * 2 * width
        inside, outside = (_ball_bounds(tree, own, x, side * normal, largest) for side in (-1, 1))
        other = np.arange(len(x))
        other[own] = nearest_held(x, surface.moving, wall, np.stack([own, own], axis=1))
        height = _heights([inside, outside, other], x, normal, width)
        sides = edges(x, surface.moving, surface.faces)
        pairs = np.concatenate([sides, sides[:, ::-1], _beside(tree, own, x, normal, height)])
        pairs = np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0)
        ids = (tuple(faces), pairs, inside, outside, other, wall)
        found = as_jax(jax.tree.map(lambda rows: rows.astype(np.int32), ids))
        return cls(**dict(zip(cls.__dataclass_fields__, found, strict=True)))


def _areas(
    faces: Iterable[Int[Either, "_f _c"]], x: Float[Either, "b d"]
) -> tuple[Float[Either, "b d"], Float[Either, " b"]]:
    """Sums the area vectors of each row's faces, into the mesh, and their sizes."""
    xp = namespace(x)
    sums = xp.zeros((len(x), x.shape[1] + 1), x.dtype)
    for corners in faces:
        area = -area_vectors(at_rows(x, corners))
        both = xp.concatenate([area, norm(area)[:, None]], axis=1)[:, None]
        sums = add_at(sums, corners, both)
    return sums[:, :-1], sums[:, -1]


def _heights(
    bounds: list[Either], x: Float[Either, "b d"], normal: Float[Either, "b d"], width: Either
) -> Float[Either, " b"]:
    """Computes how far up the layer turns as a whole at each row: the least of its bounds, without
    a kink. `bounds` are the rows `inside`, `outside` and `other`.
    """
    xp = namespace(x)
    inside, outside, other = bounds
    is_alone = other == xp.arange(len(x))
    limits = [
        OF_WIDTH * width,
        OF_BALL * _radius(at_rows(x, inside) - x, -normal),
        OF_BALL * _radius(at_rows(x, outside) - x, normal),
        OF_WIDTH * xp.where(is_alone, xp.inf, norm(at_rows(x, other) - x) / 2),
    ]
    is_flat = xp.min(xp.stack(limits), axis=0) <= 0
    total = sum(xp.where(is_flat, 1, limit) ** -4.0 for limit in limits)
    return xp.where(is_flat, 0, total**-0.25)


def _radius(arm: Float[Either, "*b d"], normal: Float[Either, "*n d"]) -> Float[Either, "*b"]:
    """The radius of the ball that touches a row along its normal and meets another row."""
    xp = namespace(arm)
    length = norm(arm)
    above = xp.sum(arm * normal, axis=-1) - SLACK * length
    return xp.where(above > 0, length**2 / (2 * xp.where(above > 0, above, 1)), xp.inf)


def _ball_bounds(
    tree: Tree, own: np.ndarray, x: np.ndarray, normal: np.ndarray, largest: np.ndarray
) -> np.ndarray:
    """Finds the row that bounds the largest ball at each row along its normal, or the row."""
    # a ball shrinks until the nodes nearest to its centre are not inside (shrinking balls)
    bound = np.arange(len(x))
    radius = largest[own]
    start = x[own]
    for _ in range(BALLS):
        centre = start + radius[:, None] * normal[own]
        near = own[tree.query(centre, k=range(1, min(NEAREST, len(own)) + 1))[1]]
        met = _radius(x[near] - start[:, None], normal[own][:, None])
        best = np.arange(len(own)), met.argmin(axis=1)
        least = met[best]
        is_less = least < radius
        if not is_less.any():
            break
        bound[own[is_less]] = near[best][is_less]
        radius = np.where(is_less, least, radius)
    return bound


def _beside(
    tree: Tree, own: np.ndarray, x: np.ndarray, normal: np.ndarray, height: np.ndarray
) -> np.ndarray:
    """Pairs each row with the nodes nearest to places at its height around it, along the wall."""
    n = normal[own]
    if x.shape[1] == 2:
        across = [np.stack([-n[:, 1], n[:, 0]], axis=1)]
    else:
        least = np.eye(3)[np.abs(n).argmin(axis=1)]
        first = unit_rows(np.cross(n, least))
        second = np.cross(n, first)
        across = [first, second, (first + second) / 2**0.5, (first - second) / 2**0.5]
    places = [x[own] + side * height[own][:, None] * t for t in across for side in (-1, 1)]
    return np.concatenate([np.stack([own, own[tree.query(p)[1]]], axis=1) for p in places])


class WallTurn(eqx.Module):
    """What turns first grid lines, at each row of the surface.

    - `normal` (b, d): into the mesh, zero for rows without moving faces.
    - `height` (b,): how far up the layer turns as a whole.
    - `strength` (b,): 1 on a smooth wall, 0 at edges and corners.
    - `slopes` (p, d): weights of differences of displacement, whose sum is a derivative along the
      wall.
    - `arms` (b, d): weights whose product with displacements is the scale of a wall's motion.
    - `probes` (b, d): places near the wall at which the coarse field is evaluated, and `step`
      (b,): how far they are from it.
    """

    normal: Rows
    height: Float[Array, " b"]
    strength: Float[Array, " b"]
    slopes: Float[Array, "p d"]
    arms: Rows
    probes: Rows
    step: Float[Array, " b"]

    @classmethod
    def made(cls, ids: WallTurnIds, x: Rows, width: Float[Array, " b"]) -> "WallTurn":
        total, size = _areas(ids.faces, x)
        length = norm(total)
        normal = total / or_one(length)[:, None]
        # the mean of unit normals is shorter than one where faces turn about a node
        strength = jnp.maximum(1 - (1 - length / or_one(size)) / ROUND, 0) ** 2
        height = _heights([ids.inside, ids.outside, ids.other], x, normal, width)
        step = PROBE * or_one(width)
        return cls(
            normal=normal,
            height=height,
            strength=jnp.where(size > 0, strength, 0),
            slopes=_slopes(ids.pairs, x, normal, height),
            arms=_arms(ids.wall, x, size),
            probes=x + step[:, None] * normal,
            step=step,
        )

    def turned(self, ids: WallTurnIds, u: Rows, near: Rows, far: Rows) -> Rows:
        """Computes what the slope across the wall lacks, for displacements `u` of the wall, and of
        the coarse field at the wall (`near`) and at the probes (`far`).

        A grid line along n turns with the wall if du/dn = - sum_t t (n . du/dt). It keeps its
        length, or grows as the wall does.
        """
        first, second = ids.pairs.T
        climb = at_rows(u, second) - at_rows(u, first)
        rise = jnp.sum(at_rows(self.normal, first) * climb, axis=1)
        wanted = jnp.zeros_like(u).at[first].add(-self.slopes * rise[:, None])
        growth = _over_wall(ids.wall, jnp.sum(self.arms * u, axis=1))
        wanted = wanted + growth[:, None] * self.normal
        return self.strength[:, None] * (wanted - (far - near) / self.step[:, None])


def _over_wall(wall: Int[Array, " b"], values: Float[Array, "b *k"]) -> Float[Array, "b *k"]:
    """Sums values over each row's wall."""
    return at_rows(jnp.zeros_like(values).at[wall].add(values), wall)


def _arms(wall: Int[Array, " b"], x: Rows, size: Float[Array, " b"]) -> Rows:
    """Weights of least squares for the scale of a wall's motion about its centre."""
    weight = size[:, None]
    arm = x - _over_wall(wall, weight * x) / or_one(_over_wall(wall, weight))
    inertia = _over_wall(wall, jnp.sum(weight * arm**2, axis=1))
    return weight * arm / or_one(inertia)[:, None]


def _slopes(pairs: Pairs, x: Rows, normal: Rows, height: Float[Array, " b"]) -> Float[Array, "p d"]:
    """Weights of least squares for the derivative along the wall from differences to other rows."""
    first, second = pairs.T
    arm = at_rows(x, second) - at_rows(x, first)
    n = at_rows(normal, first)
    arm = arm - jnp.sum(arm * n, axis=1)[:, None] * n
    # rows of another side do not count; all others alike, whether near or far
    agree = jnp.maximum(jnp.sum(n * at_rows(normal, second), axis=1), 0) ** 2
    squared = jnp.sum(arm**2, axis=1)
    weight = agree / or_one(squared + at_rows(height, first) ** 2)
    product = weight[:, None, None] * arm[:, :, None] * arm[:, None]
    matrix = jnp.zeros((*x.shape, x.shape[1]), x.dtype).at[first].add(product)
    trace = jnp.trace(matrix, axis1=1, axis2=2)
    eye = jnp.eye(x.shape[1], dtype=x.dtype)
    matrix = matrix + or_one(trace)[:, None, None] * (
        normal[:, :, None] * normal[:, None] + 1e-9 * eye[None]
    )
    # symmetric: its rows are its columns, and those of the adjugate are the cofactors
    columns = list(jnp.moveaxis(matrix, 0, 2))
    adjugate = jnp.stack([jnp.stack(row) for row in cofactors(columns)])
    inverse = at_rows((adjugate / determinant(columns)[None, None]).transpose(2, 0, 1), first)
    return jnp.sum(inverse * (weight[:, None] * arm)[:, None], axis=2)


def risen(place: Scalar, height: Scalar) -> Scalar:
    """The height to which the layer turns at a distance from the wall: first the distance."""
    return height * jnp.tanh(place / or_one(height))
