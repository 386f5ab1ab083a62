"""The share of the fit in a coarse field: the largest that trial motions of the walls allow."""

import dataclasses
import itertools
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.sparse import csr_array, diags_array

from .._host.cells.topology import CORNERS, DIMENSION, FRAMES, SHAPES
from .._host.linear.products import FLAT, cofactors, dot
from .._kernels.compile import compiled
from .._kernels.values import as_jax, is_known
from .base import Rows, Scalar
from .corrections import WallPlace
from .rbf.fitted import FittedRBF
from .reconstruction import SurfaceReconstruction
from .sparse import Interpolation
from .surface import ByKind

KEPT = 0.8  # smallest Jacobian ratio that least squares alone leave after a trial motion
LARGEST = {
    2: 0.2,
    3: 0.5,
}  # largest displacement of a trial motion, relative to half of the body's length

# Shares, and how much of the ratio by least squares they must keep in all trial motions. The whole
# fit may lose more: it alone keeps grid lines at right angles to the wall.
SHARES = {1.0: 0.82, 0.5: 0.92, 0.25: 0.92, 0.1: 0.92}

CELLS = {2: 20_000, 3: 6_000}  # most cells that are judged, by dimension
WALLS = 8  # most walls that get trial motions of their own
AT_ONCE = 8  # motions that are evaluated together
LEAN = 0.02  # share of the inertia that is added along the coordinates, more along the first ones


def has_fit(method: Any) -> bool:
    return isinstance(method, SurfaceReconstruction) and isinstance(method.coarse, FittedRBF)


def needs_share(method: Any, ids: Any) -> bool:
    """Checks whether the fit's share in a coarse field is open."""
    return has_fit(method) and method.coarse.share is None and len(ids[0].edges) > 0


def share_of(method: Any) -> float | None:
    """Returns the share of the fit, None where it is open, traced or the method has no fit."""
    share = method.coarse.share if has_fit(method) else None
    return float(share) if share is not None and is_known(share) else None


def share_in(method: Any, share: Any) -> Any:
    return dataclasses.replace(method, coarse=dataclasses.replace(method.coarse, share=share))


def near_cells(
    cells: ByKind, nodes: np.ndarray, count: int
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Selects cells near some of `count` nodes, layer by layer: their nodes, and rows of these."""
    linear = {kind: np.asarray(ids)[:, : CORNERS[SHAPES[kind]]] for kind, ids in cells.items()}
    is_near = np.zeros(count, dtype=bool)
    is_near[nodes] = True
    if not is_near.any():  # a piece far from the walls
        is_near[[ids[0, 0] for ids in linear.values() if len(ids)][:1]] = True
    chosen = _layers(linear, is_near, CELLS[max(map(DIMENSION.__getitem__, cells), default=2)])
    used = np.unique(np.concatenate([np.zeros(0, int), *(ids.ravel() for ids in chosen.values())]))
    return used, {SHAPES[kind]: np.searchsorted(used, ids) for kind, ids in chosen.items()}


def _layers(cells: ByKind, is_near: np.ndarray, most: int) -> ByKind:
    """Adds layers of cells to `is_near`, while all are `most` cells at most, or thins the first."""

    def layer() -> ByKind:
        return {kind: ids[is_near[ids].any(axis=1)] for kind, ids in cells.items()}

    def size(cells: ByKind) -> int:
        return sum(map(len, cells.values()))

    chosen = {}
    grown = layer()
    if size(grown) > most:
        return {kind: ids[:: -(-size(grown) // most)] for kind, ids in grown.items()}
    while size(chosen) < size(grown) <= most:
        chosen = grown
        for ids in chosen.values():
            is_near[ids] = True
        grown = layer()
    return chosen


def largest_share(
    method: Any,
    surface: Any,
    vectors: Callable,
    trials: Iterator[Float[np.ndarray, "m d"]],
    near: Any,
    cells: ByKind,
) -> float:
    """Finds the largest share that keeps enough in all trial motions.

    `surface` has the points, ids and factors of a plan's surface. `vectors` extends motions
    (t, m, d) of the moving nodes to displacements (b, s, t, d) of the surface's rows, for the fit
    and for least squares. `near` has points near the walls and their places, between which are the
    `cells`.
    """
    coarse = method.coarse
    rows = surface.points
    factors = surface.factors[0]
    matrix = _correction(near.placed[1], len(rows))
    if matrix is None:
        return 1.0
    used = np.unique(matrix.indices)
    matrix = csr_array(matrix[:, used])
    kernel = np.asarray(
        _kernel(coarse, factors, as_jax(np.concatenate([np.asarray(rows)[used], near.points])))
    )
    ids, inverse = _corners(np.asarray(near.points, float), cells)
    alive = dict(SHARES)
    while u := list(itertools.islice(trials, AT_ONCE)):
        rest = [np.zeros_like(u[0])] * (AT_ONCE - len(u))  # one shape, so one program
        extended = vectors(np.stack([*u, *rest]))
        weights = _weights(coarse, surface.ids[0], factors, rows, jnp.array([1.0, 0.0]), extended)
        field = _times(kernel, np.asarray(weights))
        offset = np.asarray(extended)[used] - field[: len(used)]  # eq. (5)
        moved = field[len(used) :] + _times(matrix, offset)
        for k in range(len(u)):
            fit, plain = (_gradients(_edges(moved[:, of, k], ids), inverse) for of in (0, 1))
            terms = {
                share: _invariants(share * fit + (1 - share) * plain) for share in (*alive, 0.0)
            }
            for sign in (1, -1):
                size = _size(terms[0.0], sign)
                least = _ratios(terms[0.0], size).min(initial=np.inf)
                for share, enough in list(alive.items()):
                    if _ratios(terms[share], size).min(initial=np.inf) < enough * least:
                        del alive[share]
            if not alive:
                return 0.0
    return max(alive)


def motions(
    points: Float[np.ndarray, "m d"], walls: np.ndarray
) -> Iterator[Float[np.ndarray, "m d"]]:
    """Yields trial motions, half a wall long: powers, waves, bumps along its axes of inertia."""
    labels, counts = np.unique(walls, return_counts=True)
    for label in labels[np.sort(np.argsort(-counts, kind="stable")[:WALLS])]:
        own = walls == label
        arms = points[own] - points[own].mean(axis=0)
        inertia = arms.T @ arms
        # of directions in which a body is equally long, the first of the coordinates is the longest
        inertia += LEAN * np.trace(inertia) * np.diag(np.arange(len(inertia), 0, -1))
        axes = np.linalg.eigh(inertia)[1][:, ::-1]
        along = arms @ axes
        half = np.abs(along).max(axis=0)
        along = along / np.where(half > 0, half, 1)
        for height, axis in _shapes(along):
            u = np.zeros_like(points)
            u[own] = height[:, None] * axes[:, axis] * half.max()
            yield u


def _shapes(x: Float[np.ndarray, "m d"]) -> Iterator[tuple[np.ndarray, int]]:
    """Yields heights (m,) over the axes, longest first, from -1 to 1, and the axis of motion."""
    thin = x.shape[1] - 1
    for axis, a in enumerate(x.T):
        powers = [a, a**2, a**3, np.sin(np.pi * a)]
        turn = 2 * np.pi * a
        waves = [np.cos(np.pi * a), np.sin(turn), np.cos(turn)]
        yield np.ones(len(x)), axis
        others = np.delete(np.arange(thin + 1), axis).tolist()
        yield from itertools.product(powers + waves if axis < thin else powers[1:], others)
        yield from itertools.product(_bumps(a, x[:, thin]) if axis < thin else [a], [thin])


def _bumps(a: np.ndarray, across: np.ndarray) -> list[np.ndarray]:
    """Makes bumps of each side, and bends of both ends."""
    bumps = [np.exp(-(((a - at) / 0.24) ** 2)) for at in (-0.5, 0.0, 0.5)]
    ends = [np.clip(sign * a - 0.4, 0, 1) ** 2 / 0.36 for sign in (-1, 1)]
    return [side * bump for side in (across > 0, across < 0) for bump in bumps] + ends


def _corners(points: np.ndarray, cells: ByKind) -> tuple[np.ndarray, Float[np.ndarray, "d d c"]]:
    """Lists corners of cells: ids (d + 1, c) of a corner and its edges' ends; inverse edges."""
    none = np.zeros((0, points.shape[1] + 1), dtype=int)
    ids = np.concatenate(
        [none, *(own[:, frame] for kind, own in cells.items() for frame in FRAMES[kind])]
    ).T
    edges = _edges(points, ids).transpose(2, 0, 1)
    has_sign = np.abs(np.linalg.det(edges)) > FLAT * np.prod(np.linalg.norm(edges, axis=1), axis=1)
    inverse = np.linalg.inv(edges[has_sign]).transpose(1, 2, 0)
    return np.ascontiguousarray(ids[:, has_sign]), np.ascontiguousarray(inverse)


def _edges(values: np.ndarray, ids: np.ndarray) -> Float[np.ndarray, "d d c"]:
    values = np.ascontiguousarray(values.T)
    return np.stack([values[:, end] - values[:, ids[0]] for end in ids[1:]], axis=1)


def _gradients(edges: np.ndarray, inverse: np.ndarray) -> Float[np.ndarray, "d d c"]:
    # sums of products of rows: `numpy.einsum` takes six times as long
    return np.sum([edges[:, k, None] * inverse[k][None] for k in range(len(edges))], axis=0)


def _invariants(gradient: Float[np.ndarray, "d d c"]) -> list[np.ndarray]:
    """Coefficients of size, size^2, ... in det(1 + size G), the Jacobian's ratio after a motion."""
    rows = cofactors([*gradient])
    minors = [np.trace(np.array(rows))] if len(gradient) == 3 else []
    return [np.trace(gradient), *minors, dot(rows[0], gradient[0])]


def _ratios(invariants: list[np.ndarray], size: float) -> Float[np.ndarray, " c"]:
    total: Any = 0.0
    for invariant in reversed(invariants):
        total = size * (total + invariant)
    return 1 + total


def _size(invariants: list[np.ndarray], sign: int) -> float:
    """Finds the size of a motion that leaves the ratio `KEPT`, or the largest size."""
    size = LARGEST[len(invariants)]
    while len(invariants[0]):
        ratios = _ratios(invariants, sign * size)
        worst = int(ratios.argmin())
        if ratios[worst] >= KEPT - 1e-6:
            break
        low = 0.0
        of_worst = [invariant[[worst]] for invariant in invariants]
        for _ in range(40):
            middle = (low + size) / 2
            is_kept = _ratios(of_worst, sign * middle).item() >= KEPT
            low, size = (middle, size) if is_kept else (low, middle)
        size = low
    return sign * size


def _correction(placed: Any, count: int) -> csr_array | None:
    """Assembles the correction's matrix from surface rows to points, if it interpolates."""
    if isinstance(placed, Interpolation):
        return placed.matrix(count)
    correction = _correction(placed.correction, count) if isinstance(placed, WallPlace) else None
    if correction is None:
        return None
    return csr_array(
        placed.wall.matrix(count) + diags_array(np.asarray(placed.outside)) @ correction
    )


@compiled
def _kernel(coarse: FittedRBF, factors: Any, points: Float[Array, "k d"]) -> Float[Array, "k t"]:
    rbf = factors.rbf
    return coarse.rbf.expansion.rows(
        rbf.sources, rbf.scale, (points - rbf.centre[None]) * rbf.scale
    )


@compiled
def _weights(
    coarse: FittedRBF, ids: Any, factors: Any, surface: Array, shares: Array, vectors: Array
) -> Array:
    """Computes weights (k, s, t, d) of the field for shares and displacements (b, s, t, d)."""

    def weights(share: Scalar, vectors: Rows) -> Float[Array, "k d"]:
        field = dataclasses.replace(coarse, share=share).field(ids, factors, surface, vectors)
        return jnp.concatenate([field.beta, field.alpha], axis=1).T

    return jax.vmap(jax.vmap(weights, (None, 1), 1), (0, 1), 1)(shares, vectors)


def _times(matrix: Any, columns: np.ndarray) -> np.ndarray:
    """Multiplies along the first axis."""
    return (matrix @ columns.reshape(len(columns), -1)).reshape(-1, *columns.shape[1:])
