"""Second derivatives of an energy of |T|^2 and det T, with or without their negative part.

T = U Sigma V^T, with U and V rotations and the last singular value signed. The derivatives then
couple diagonal entries with diagonal entries, and an entry off the diagonal with its mirror image.
Some eigenvalues are closed forms, the other eigenvalues belong to one matrix (d, d). Source: twists
and flips in Smith, De Goes and Kim, Analytic eigensystems for isotropic distortion energies, ACM
Trans. Graph. 38, 2019.
"""

import functools
import itertools
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._quality.vector import Vector, cross, divide, dot, norm, stack, total

Scalar = Float[Array, "s k"]
Matrix = list[list[Scalar]]
Blocks = list[list[Array]]
SWEEPS = 5
"""Sweeps of Jacobi rotations in 3-D: four or five converge to round-off. In 2-D one rotation is
exact.
"""


def symmetric_eigen(matrix: Matrix) -> tuple[list[Scalar], list[Vector]]:
    d = len(matrix)
    start = tuple(tuple(row) for row in matrix)
    zero, one = jnp.zeros_like(matrix[0][0]), jnp.ones_like(matrix[0][0])
    identity = tuple(tuple(one if i == j else zero for j in range(d)) for i in range(d))
    state = _rotated((start, identity))
    if d == 3:  # a rotation leaves the next pair of rows in front
        state = jax.lax.fori_loop(1, 3 * SWEEPS, lambda _, state: _rotated(state), state)
    values, vectors = state
    return [values[j][j] for j in range(d)], [Vector([row[j] for row in vectors]) for j in range(d)]


def _rotated(state):
    """Rotates the first two rows and columns; in 3-D, moves all rows and columns one place on."""
    (a, v), d = state, len(state[0])
    c, s = _angle(a[0][0] - a[1][1], 2 * a[0][1])
    a, v = ([(c * row[0] + s * row[1], c * row[1] - s * row[0], *row[2:]) for row in matrix] for matrix in (a, v))
    upper, lower = zip(*[(c * x + s * y, c * y - s * x) for x, y in zip(a[0], a[1], strict=True)], strict=True)
    a = [upper, lower, *a[2:]]
    if d == 3:
        a, v = ([(*row[1:], row[0]) for row in matrix] for matrix in ([*a[1:], a[0]], v))
    return tuple(a), tuple(v)


def _angle(difference: Scalar, twice: Scalar) -> tuple[Scalar, Scalar]:
    """Cosine and sine of a rotation, up to 45 degrees, that clears an entry."""
    root = jnp.sqrt(difference**2 + twice**2)
    tangent = divide(twice, jnp.abs(difference) + root, 0.0) * jnp.where(difference < 0, -1, 1)
    c = 1 / jnp.sqrt(1 + tangent**2)
    return c, c * tangent


def rotations(stretch: list[Vector]) -> tuple[list[Vector], list[Scalar], list[Vector]]:
    """Splits T, given by its columns, into rotations U and V, and sigma, with T = U diag(sigma)
    V^T; the last entry of sigma has the sign of det T.
    """
    values, v = symmetric_eigen([[dot(a, b) for b in stretch] for a in stretch])
    v = _descending(values, v)
    images = [total(c * x for c, x in zip(stretch, column, strict=True)) for column in v]
    zero = jnp.zeros_like(values[0])
    first = _unit(images[0], Vector([zero + 1, *[zero] * (len(v) - 1)]), zero)
    if len(v) == 2:
        u = [first, Vector((-first[1], first[0]))]
    else:
        rest = images[1] - first * dot(first, images[1])
        noise = 1e3 * float(jnp.finfo(first[0].dtype).eps) * norm(images[0])
        second = _unit(rest, _across(first), noise)
        u = [first, second, cross(first, second)]
    return u, [dot(a, b) for a, b in zip(u, images, strict=True)], v


def _descending(values: list[Scalar], vectors: list[Vector]) -> list[Vector]:
    """Sorts eigenvectors by falling eigenvalue; turns the last one to be right-handed."""
    order = jnp.argsort(-jnp.stack(values), axis=0)
    picked = Vector(jnp.take_along_axis(component, order, axis=0) for component in stack(vectors))
    v = [picked.at(j) for j in range(len(vectors))]
    return [v[0], Vector((-v[0][1], v[0][0]))] if len(v) == 2 else [v[0], v[1], cross(v[0], v[1])]


def _unit(a: Vector, otherwise: Vector, noise: Scalar) -> Vector:
    """A vector's direction, or `otherwise` if it is no longer than `noise`."""
    length = norm(a)
    inverse = divide(jnp.ones_like(length), length, 0.0)
    is_long = (inverse > 0) & (length > noise)
    return Vector(jnp.where(is_long, x * inverse, y) for x, y in zip(a, otherwise, strict=True))


def _across(a: Vector) -> Vector:
    flat = jnp.abs(a[2]) < 0.9
    other = Vector(
        [jnp.where(flat, -a[1], jnp.zeros_like(a[0])), jnp.where(flat, a[0], -a[2]), jnp.where(flat, 0, a[1])]
    )
    return other * (1 / norm(other))


def convex(
    energy: Callable[[Scalar, Scalar], Scalar], sigma: list[Scalar], floor: Any
) -> tuple[Matrix, Matrix, Matrix]:
    """Second derivatives of energy(|T|^2 / d, det T) by the entries of U^T T V, with eigenvalues of
    at least `floor`. Three matrices (d, d), by entries (i, i) and (j, j), by (i, j) twice, and by
    (i, j) and (j, i).
    """
    d = len(sigma)
    curvature = _hessian(lambda s: energy(*_measures(s)), jnp.stack(sigma))
    values, vectors = symmetric_eigen(list(map(list, curvature)))
    values = [jnp.maximum(value, floor) for value in values]
    along = [
        [_added(w * v[i] * v[j] for w, v in zip(values, vectors, strict=True)) for j in range(d)] for i in range(d)
    ]
    squared, tau = _measures(sigma)
    slope, slant = jax.vjp(energy, squared, tau)[1](jnp.ones_like(tau))
    zero = jnp.zeros_like(tau)
    twice, mirrored = [[zero] * d for _ in sigma], [[zero] * d for _ in sigma]
    for i, j in itertools.combinations(range(d), 2):
        third = slant if d == 2 else slant * sigma[3 - i - j]
        twist, flip = (jnp.maximum(2 / d * slope + side * third, floor) for side in (1, -1))
        twice[i][j] = twice[j][i] = (flip + twist) / 2
        mirrored[i][j] = mirrored[j][i] = (flip - twist) / 2
    return along, twice, mirrored


def _measures(sigma: Sequence[Scalar] | Float[Array, "d s k"]) -> tuple[Scalar, Scalar]:
    return _added(s**2 for s in sigma) / len(sigma), functools.reduce(jnp.multiply, list(sigma))


def _added(terms: Iterable[Scalar]) -> Scalar:
    return functools.reduce(jnp.add, list(terms))


def _hessian(function, x: Float[Array, "d s k"]) -> Float[Array, "d d s k"]:
    ones = jnp.ones_like(x[0])

    def slope(x):
        return jax.vjp(function, x)[1](ones)[0]

    directions = jnp.eye(len(x), dtype=x.dtype)[:, :, None, None] + jnp.zeros_like(x)[None]
    return jax.vmap(lambda direction: jax.jvp(slope, (x,), (direction,))[1])(directions)


def blocks(
    energy: Callable[[Scalar, Scalar], Scalar],
    stretch: list[Vector],
    inverse: Sequence[Sequence[Scalar]],
    floor: Any = 0.0,
) -> Float[Array, "d d d d s k"]:
    """Second derivatives by pairs of edges, with eigenvalues of at least `floor`. The axes of the
    vectors come first, then the edges, the columns of A. `stretch` holds the columns of T = A W^-1,
    `inverse` the rows of W^-1, one for every edge.
    """
    axes = range(len(stretch))
    u, sigma, v = rotations(stretch)
    g = [jnp.stack([dot(row, v[a]) for row in inverse]) for a in axes]
    # The barrier makes XLA compute these once, not for every pair of edges that uses them.
    once = jax.lax.optimization_barrier
    g, u, (along, twice, mirrored) = once((g, list(map(tuple, u)), convex(energy, sigma, floor)))
    u, along, twice, mirrored = jax.tree.map(lambda entry: entry[None, None], (u, along, twice, mirrored))
    inner = once(_inner(g, along, twice, mirrored))
    half = once([[sum(u[a][i] * inner[a][e] for a in axes) for e in axes] for i in axes])
    return jnp.stack([jnp.stack([sum(row[e] * u[e][j] for e in axes) for j in axes]) for row in half])


def _inner(g: list[Array], along: Blocks, twice: Blocks, mirrored: Blocks) -> Blocks:
    """Computes second derivatives by the entries of U^T A V, for pairs of edges."""
    axes = range(len(g))
    pair = [[a[:, None] * b[None] for b in g] for a in g]
    inner = [[along[a][e] * pair[a][e] + mirrored[a][e] * pair[e][a] for e in axes] for a in axes]
    for a, b in itertools.permutations(axes, 2):
        inner[a][a] += twice[a][b] * pair[b][b]
    return inner
