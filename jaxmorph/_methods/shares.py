"""The share of the fit in a coarse field: the largest that trial motions of the walls allow."""

import dataclasses
import itertools
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.sparse import csr_array, diags_array

from .._host.cells.topology import CORNERS, DIMENSION, FRAMES, SHAPES
from .._host.linear.products import FLAT, cofactors
from .._kernels.compile import compiled
from .._kernels.values import as_jax, is_known
from .base import AbstractMethod
from .nearwall import WallPlace
from .rbf.fitted import FittedRBF
from .reconstruction import SurfaceReconstruction
from .sparse import Interpolation

KEPT = 0.8
"""Smallest Jacobian ratio that least squares alone leave after a trial motion."""

LARGEST = {2: 0.2, 3: 0.5}
"""Largest displacement of a trial motion, relative to half of the body's length."""

SHARES = {1.0: 0.82, 0.5: 0.92, 0.25: 0.92, 0.1: 0.92}
"""Shares, and how much of the ratio by least squares they must keep in all trial motions.

The whole fit may lose more: it alone keeps grid lines at right angles to the wall.
"""

CELLS = {2: 20_000, 3: 6_000}
"""Most cells that are judged, by dimension."""

WALLS = 8
"""Most walls that get trial motions of their own."""

AT_ONCE = 8
"""Motions that are evaluated together."""

LEAN = 0.02
"""Share of the inertia that is added along the coordinates, more along the first ones."""

Cells = Mapping[str, np.ndarray]


@dataclasses.dataclass(frozen=True)
class WallTrial:
    """Data of trial motions: the walls, and cells near them.

    - `surface` (b, d): the surface's rows. `vectors` extends motions (t, m, d) of the moving nodes
      to displacements (b, s, t, d) of them, for the fit and for least squares.
    - `moving` (m, d), `walls` (m,): the moving nodes, and the wall of each.
    - `points` (k, d), `placed`: points near the walls, and their places. `cells` have rows of them.
    """

    surface: Float[Array, "b d"]
    vectors: Callable[[Any], Float[Array, "b s t d"]]
    moving: Float[np.ndarray, "m d"]
    walls: np.ndarray
    points: Float[np.ndarray, "k d"]
    placed: Any
    cells: Cells


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


def near_cells(cells: Cells, nodes: np.ndarray, count: int) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Selects cells near some of `count` nodes, layer by layer: their nodes, and rows of these."""
    linear = {kind: np.asarray(ids)[:, : CORNERS[SHAPES[kind]]] for kind, ids in cells.items()}
    is_near = np.zeros(count, dtype=bool)
    is_near[nodes] = True
    if not is_near.any():  # a piece far from the walls
        is_near[[ids[0, 0] for ids in linear.values() if len(ids)][:1]] = True
    chosen = _layers(linear, is_near, CELLS[max(map(DIMENSION.__getitem__, cells), default=2)])
    used = np.unique(np.concatenate([np.zeros(0, int), *(ids.ravel() for ids in chosen.values())]))
    return used, {SHAPES[kind]: np.searchsorted(used, ids) for kind, ids in chosen.items()}


def _layers(cells: Cells, is_near: np.ndarray, most: int) -> Cells:
    """Adds layers of cells to `is_near`, while all are `most` cells at most, or thins the first."""

    def layer() -> Cells:
        return {kind: ids[is_near[ids].any(axis=1)] for kind, ids in cells.items()}

    def size(cells: Cells) -> int:
        return sum(map(len, cells.values()))

    chosen, grown = {}, layer()
    if size(grown) > most:
        return {kind: ids[:: -(-size(grown) // most)] for kind, ids in grown.items()}
    while size(chosen) < size(grown) <= most:
        chosen = grown
        for ids in chosen.values():
            is_near[ids] = True
        grown = layer()
    return chosen


def judged(method: AbstractMethod, ids: Any, factors: Any, trial: WallTrial) -> AbstractMethod:
    """Returns the method with the largest share that keeps enough in all trial motions."""
    return share_in(method, _largest_share(method, ids[0], factors[0], trial))


def _largest_share(method: Any, ids: Any, factors: Any, trial: WallTrial) -> float:
    matrix = _correction(trial.placed[1], len(trial.surface))
    if matrix is None:
        return 1.0
    used, coarse = np.unique(matrix.indices), method.coarse
    matrix = csr_array(matrix[:, used])
    places = np.concatenate([np.asarray(trial.surface)[used], trial.points])
    rows = np.asarray(_kernel(coarse, factors, as_jax(places)))
    corners = _JudgedCorners.of(np.asarray(trial.points, float), trial.cells)
    alive, trials = dict(SHARES), motions(trial.moving, trial.walls)
    while u := list(itertools.islice(trials, AT_ONCE)):
        rest = [np.zeros_like(trial.moving)] * (AT_ONCE - len(u))  # one shape, so one program
        vectors = trial.vectors(np.stack([*u, *rest]))
        weights = _weights(coarse, ids, factors, trial.surface, jnp.array([1.0, 0.0]), vectors)
        field = _times(rows, np.asarray(weights))
        offset = np.asarray(vectors)[used] - field[: len(used)]  # eq. (5)
        moved = field[len(used) :] + _times(matrix, offset)
        for k in range(len(u)):
            ratios = _Ratios.of(*(corners.gradients(moved[:, of, k]) for of in (0, 1)))
            for sign in (1, -1):
                size = sign * ratios.size(sign)
                least = ratios.least(0.0, size)
                for share, enough in list(alive.items()):
                    if ratios.least(share, size) < enough * least:
                        del alive[share]
            if not alive:
                return 0.0
    return max(alive)


def motions(points: Float[np.ndarray, "m d"], walls: np.ndarray) -> Iterator[Float[np.ndarray, "m d"]]:
    """Yields trial motions of each wall: powers, waves and bumps along the axes of its inertia.

    They are as large as half of the wall's length.
    """
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
    for axis in range(thin + 1):
        yield np.ones(len(x)), axis
        powers = [x[:, axis], x[:, axis] ** 2, x[:, axis] ** 3, np.sin(np.pi * x[:, axis])]
        waves = [np.cos(np.pi * x[:, axis]), np.sin(2 * np.pi * x[:, axis]), np.cos(2 * np.pi * x[:, axis])]
        for across in range(thin + 1):
            if across != axis:
                yield from ((height, across) for height in (powers + waves if axis < thin else powers[1:]))
        if axis == thin:
            yield x[:, axis], axis
            continue
        for side in (x[:, thin] > 0, x[:, thin] < 0):
            yield from ((side * np.exp(-(((x[:, axis] - at) / 0.24) ** 2)), thin) for at in (-0.5, 0.0, 0.5))
        yield from ((np.clip(sign * x[:, axis] - 0.4, 0, 1) ** 2 / 0.36, thin) for sign in (-1, 1))


@dataclasses.dataclass(frozen=True)
class _JudgedCorners:
    """Corners of cells: ids (d + 1, c) of a corner and the ends of its edges; inverse edges."""

    ids: np.ndarray
    inverse: np.ndarray

    @classmethod
    def of(cls, points: np.ndarray, cells: Cells) -> "_JudgedCorners":
        none = np.zeros((0, points.shape[1] + 1), dtype=int)
        ids = np.concatenate([none, *(own[:, frame] for kind, own in cells.items() for frame in FRAMES[kind])]).T
        edges = _edges(points, ids).transpose(2, 0, 1)
        has_sign = np.abs(np.linalg.det(edges)) > FLAT * np.prod(np.linalg.norm(edges, axis=1), axis=1)
        inverse = np.linalg.inv(edges[has_sign]).transpose(1, 2, 0)
        return cls(np.ascontiguousarray(ids[:, has_sign]), np.ascontiguousarray(inverse))

    def gradients(self, moved: Float[np.ndarray, "k d"]) -> Float[np.ndarray, "d d c"]:
        """Computes gradients of a displacement."""
        edges = _edges(moved, self.ids)
        return np.sum([edges[:, k, None] * self.inverse[k][None] for k in range(len(edges))], axis=0)


def _edges(values: np.ndarray, ids: np.ndarray) -> Float[np.ndarray, "d d c"]:
    values = np.ascontiguousarray(values.T)
    return np.stack([values[:, end] - values[:, ids[0]] for end in ids[1:]], axis=1)


@dataclasses.dataclass(frozen=True)
class _Ratios:
    """Corner Jacobians after a motion, relative to before: det(1 + size (s F + (1 - s) P)).

    `terms` (k, j, c) are the coefficients of size^k s^j (1 - s)^(k - j), for gradients F by the fit
    and P by least squares.
    """

    terms: list[list[np.ndarray]]

    @classmethod
    def of(cls, fit: Float[np.ndarray, "d d c"], plain: Float[np.ndarray, "d d c"]) -> "_Ratios":
        def square(a: np.ndarray, b: np.ndarray) -> np.ndarray:
            return np.trace(a) * np.trace(b) - (a * b.swapaxes(0, 1)).sum(axis=(0, 1))

        def cube(a: np.ndarray, b: np.ndarray) -> np.ndarray:
            return (a * np.array(cofactors([*b]))).sum(axis=(0, 1))

        terms = [[np.trace(plain), np.trace(fit)], [square(plain, plain) / 2, square(plain, fit), square(fit, fit) / 2]]
        if len(fit) == 3:
            terms.append([cube(plain, plain) / 3, cube(fit, plain), cube(plain, fit), cube(fit, fit) / 3])
        return cls(terms)

    def coefficients(self, share: float) -> list[np.ndarray]:
        """Returns the coefficients of size, size^2, ... for a share of the fit."""
        mixed = []
        for k, parts in enumerate(self.terms, 1):
            weights = [share**j * (1 - share) ** (k - j) for j in range(k + 1)]
            mixed.append(np.add.reduce([weight * part for weight, part in zip(weights, parts, strict=True) if weight]))
        return mixed

    def least(self, share: float, size: float) -> float:
        return float(_polynomial(self.coefficients(share), size).min(initial=np.inf))

    def size(self, sign: int) -> float:
        """Finds the size of a motion that leaves the ratio `KEPT`, or the largest size."""
        size, terms = LARGEST[len(self.terms)], self.coefficients(0.0)
        while len(terms[0]):
            ratios = _polynomial(terms, sign * size)
            worst = int(ratios.argmin())
            if ratios[worst] >= KEPT - 1e-6:
                break
            low, terms_of_worst = 0.0, [term[[worst]] for term in terms]
            for _ in range(40):
                middle = (low + size) / 2
                is_kept = _polynomial(terms_of_worst, sign * middle).item() >= KEPT
                low, size = (middle, size) if is_kept else (low, middle)
            size = low
        return size


def _polynomial(terms: list[np.ndarray], size: float) -> Float[np.ndarray, " c"]:
    total = np.zeros_like(terms[0])
    for term in reversed(terms):
        total = size * (total + term)
    return 1 + total


def _correction(placed: Any, count: int) -> csr_array | None:
    """Assembles the correction's matrix from surface rows to points, if it interpolates."""
    if isinstance(placed, Interpolation):
        weights = np.asarray(placed.weights)
        if placed.reached is not None:
            weights = np.where(np.asarray(placed.reached).reshape(len(weights), -1), weights, 0)
        starts = np.arange(0, weights.size + 1, weights.shape[1])
        return csr_array((weights.ravel(), np.asarray(placed.nodes).ravel(), starts), (len(weights), count))
    correction = _correction(placed.correction, count) if isinstance(placed, WallPlace) else None
    if correction is None:
        return None
    return csr_array(_correction(placed.wall, count) + diags_array(np.asarray(placed.outside)) @ correction)


@compiled
def _kernel(coarse: FittedRBF, factors: Any, points: Float[Array, "k d"]) -> Float[Array, "k t"]:
    rbf = factors.rbf
    return coarse.rbf.expansion.rows(rbf.sources, rbf.scale, (points - rbf.centre[None]) * rbf.scale)


@compiled
def _weights(coarse: FittedRBF, ids: Any, factors: Any, surface: Array, shares: Array, vectors: Array) -> Array:
    """Computes weights (k, s, t, d) of the field for shares and displacements (b, s, t, d)."""

    def weights(share: Float[Array, ""], vectors: Float[Array, "b d"]) -> Float[Array, "k d"]:
        field = dataclasses.replace(coarse, share=share).field(ids, factors, surface, vectors)
        return jnp.concatenate([field.beta, field.alpha], axis=1).T

    return jax.vmap(jax.vmap(weights, (None, 1), 1), (0, 1), 1)(shares, vectors)


def _times(matrix: Any, columns: np.ndarray) -> np.ndarray:
    """Multiplies along the first axis."""
    return (matrix @ columns.reshape(len(columns), -1)).reshape(-1, *columns.shape[1:])
