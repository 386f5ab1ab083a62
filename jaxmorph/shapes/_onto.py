"""A wall onto a target: a scan, another CAD surface, or a function of closest places."""

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy import ndarray
from scipy import sparse
from scipy.linalg import null_space
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation

from jaxmorph import Facets, FarthestPoints, MeshError, Plane
from jaxmorph.extend import Module, area_vectors, between, checked, closest, host_call, norm

from ._arguments import Column, Numbers, Positions, positions, shown_place
from ._features import (
    Borders,
    Clip,
    Planes,
    Rail,
    borders_of,
    clipped,
    guides_of,
    height_of,
)
from ._smooth import stiffness_of
from ._tolerances import ON_SYMMETRY, RESTED, SAME_LENGTH

Target = Facets | Callable
Motion = tuple[ndarray, ndarray]

FIRST = 0.5
LAST = 0.01  # first and last length over the wall's extent
PROJECTION_STEPS = 8
SECTION_STEPS = 4  # onto the section of a CAD model with a plane
STEEPEST = 10.0  # square of the longest of them, over the distance from the model
SETTLED = 4  # steps from one to the other, and at the last
OTHER_UNIT = 300.0  # extent of a CAD model over the wall's that is that of another unit
FAR = 0.2  # distance over the wall's extent from which on there are three times as many steps
# weight of edges, corners and planes over the stiffness; of staying, against sliding away
HARD = 100.0
STAYING = 1e-4


class Onto(Module):
    """Takes a wall onto a target: `onto(x, points)` has the nodes' new places. Traced in both.

    The nodes end on the target, sharp edges and corners on sharp edges and corners, the border in a
    symmetry plane on the target's section. Faces of the wall keep their shape as well as they can,
    so that its spacing stays. A rigid motion comes first where the wall is far off, and that halves
    the distance. This motion and the edges are found once, with the nodes given here.

    **Arguments:**

    - `wall`: such as `Facets.of(mesh, "wing")`.
    - `target`: `Facets` of any resolution, open, or larger than the wall. Or a function that takes
      positions (m, d) to the closest places (m, d) of a surface, without a search for edges.
    - `symmetry`: planes in which the border of the wall stays. Default: none.
    - `features`: pairs of curves by ids, nodes of the wall and points of the target: edges between
      the first go onto edges between the second (in 2-D nodes onto points). Default: sharp edges.
    - `length`: 0, the default: the wall goes onto the target. Else it stays near the target,
      without waves much shorter than this length, such as the noise of a scan.

    **Raises:** `ValueError` for different dimensions, a target that does not reach a plane, and
    corners that would share one of the target.

    Source: Amberg, Romdhani and Vetter, Optimal step nonrigid ICP algorithms, CVPR 2007; Sorkine
    and Alexa, As-rigid-as-possible surface modeling, SGP 2007.
    """

    wall: Facets
    target: Facets | None
    function: Callable | None = eqx.field(static=True)
    clips: tuple[Clip, ...]
    guides: tuple[Rail, ...]
    borders: Borders
    turn: Float[Array | ndarray, "d d"]
    shift: Float[Array | ndarray, " d"]
    lengths: Float[Array | ndarray, " s"]
    is_exact: bool = eqx.field(static=True)

    @checked
    def __init__(
        self,
        wall: Facets,
        target: Target,
        *,
        symmetry: Planes = (),
        features: Sequence[Any] = (),
        length: float = 0.0,
    ):
        between("length", length, 0, ends="[)")
        self.borders = borders_of(wall, symmetry)
        x = np.asarray(wall.points, float)
        planes = [plane for plane, _ in self.borders]
        extent = np.ptp(x, axis=0).max()
        last = length or LAST * np.ptp(x, axis=0).max()
        if isinstance(target, Facets) and target.points.shape[1] != x.shape[1]:
            raise ValueError(
                f"the wall is in {x.shape[1]}-D, its target in {target.points.shape[1]}-D."
            )
        if isinstance(target, Facets) and target.model is not None:
            _check_unit(np.ptp(np.asarray(target.points), axis=0).max() / extent)
        self.wall = wall
        self.is_exact = length == 0
        self.function = None
        self.target = None
        nearest = target.closest if isinstance(target, Facets) else target
        self.turn, self.shift = _rigid(wall, target, nearest, planes)
        self.clips = ()
        self.guides = ()
        start = x @ self.turn.T + self.shift
        if isinstance(target, Facets):
            for plane in planes:
                clip, target = clipped(
                    target, plane, np.sign(np.median(plane.height(x))), ON_SYMMETRY * extent
                )
                self.clips += (clip,)
            self.target = _turn_normals(target, wall.at(start))
            if self.is_exact or features:  # edges of noise are none
                self.guides = guides_of(wall.at(start), self.target, planes, features)
            nearest = target.closest
        else:
            self.function = target
        far = np.linalg.norm(np.asarray(nearest(start)) - start, axis=1).max()
        steps = PROJECTION_STEPS * (1 + 2 * int(far > FAR * extent))
        self.lengths = np.append(
            np.geomspace(max(FIRST * extent, last), last, steps), np.full(SETTLED, last)
        )

    def __call__(self, x: Numbers, points: Numbers | None = None) -> Positions:
        """Takes nodes (m, d) to places; `points` (n, d) are the target's, by default as given."""
        x = positions(x, like=self.wall.points.shape)
        target = self.target
        if target is not None and points is not None:
            points = positions(points, "points")
            for clip in self.clips:
                points = clip(points)
            target = target.at(points)
        return _move_walls(self, x, target)

    def _places(self, y: Positions, facing: Positions, target: Facets | None) -> Positions:
        if target is None:
            assert self.function is not None
            places = jnp.asarray(self.function(y), y.dtype)
            for _ in self.borders:
                places = jnp.asarray(self.function(self._in_planes(places)), y.dtype)
            return self._in_planes(places)
        places = target.closest(y, facing, along=True)
        for guide in self.guides:
            places = places.at[guide.rows].set(guide.places(y, facing, target))
        places = self._in_planes(places)
        return places if target.model is None else self._on_sections(places, target)

    def _on_sections(self, y: Positions, target: Facets) -> Positions:
        """Takes nodes in planes onto the model in these: its facets were cut there, not itself."""
        for rows in [rows for _, rows in self.borders for _ in range(SECTION_STEPS)]:
            # the foot lies along the normal: as far again in the plane as its share there is less
            off = target.closest(y)[rows] - y[rows]
            across = self._in_planes(y.at[rows].add(off))[rows] - y[rows]
            squared = jnp.sum(across**2, axis=1)
            share = jnp.sum(off**2, axis=1) / jnp.where(squared > 0, squared, jnp.inf)
            y = y.at[rows].add(jnp.minimum(share, STEEPEST)[:, None] * across)
        return y

    def _in_planes(self, y: Positions) -> Positions:
        for plane, rows in self.borders:
            y = y.at[rows].add(
                -height_of(y[rows], plane)[:, None] * jnp.asarray(plane.normal, y.dtype)[None]
            )
        return y

    def _weights(self, y: Positions, facing: Positions, mass: Column, hard: Column):
        """Weights (m, d, d) of distances from places: across the wall, across curves, or whole."""
        one = jnp.eye(y.shape[1], dtype=y.dtype)
        weights = mass[:, None, None] * facing[:, :, None] * facing[:, None]
        for guide in self.guides:
            along = y[guide.beside[:, 1]] - y[guide.beside[:, 0]]
            squared = jnp.sum(along**2, axis=1)
            share = (
                along[:, :, None]
                * along[:, None]
                / jnp.where(squared > 0, squared, 1)[:, None, None]
            )
            weights = weights.at[guide.rows].set(hard[guide.rows, None, None] * (one[None] - share))
        for plane, rows in self.borders:
            normal = jnp.asarray(plane.normal, y.dtype)
            weights = weights.at[rows].add(hard[rows, None, None] * jnp.outer(normal, normal)[None])
        return weights

    def _nearer(self, y: Positions, step: Any, start: Positions, target: Facets | None) -> Any:
        # Each face keeps its shape, at last turned as the wall is now: K y = K R x_0. Each node is
        # drawn to the tangent plane at its closest place c: N y = N c. The length of K falls: the
        # wall first goes as a whole, at the end its faces only resist sliding.
        length, is_last = step
        faces = jnp.asarray(self.wall.faces)
        m, d = y.shape
        size, local = stiffness_of(start[faces])
        local = length**2 * local
        mass = jnp.zeros(m, y.dtype).at[faces].add(size[:, None] / d)
        stiff = jnp.zeros(m, y.dtype).at[faces].add(jnp.diagonal(local, axis1=1, axis2=2))
        facing = self.wall.at(y).normals()
        weights = self._weights(y, facing, mass, mass + HARD * stiff)
        off = _times(weights, self._places(y, facing, target) - y)
        shape = start[faces]
        if self.is_exact:
            shape = jnp.where(
                is_last, _rotated(shape, area_vectors(shape), area_vectors(y[faces])), shape
            )
        off = off.at[faces].add(_times(local, shape - y[faces]))
        weights = weights + STAYING * mass[:, None, None] * jnp.eye(d, dtype=y.dtype)[None]

        def product(v):
            return _times(weights, v).at[faces].add(_times(local, v[faces]))

        def solve(_, right):
            return host_call(
                _solve_motion, jax.ShapeDtypeStruct((m, d), y.dtype), faces, local, weights, right
            )

        return y + jax.lax.custom_linear_solve(product, off, solve, symmetric=True)


def _check_unit(ratio: float) -> None:
    if not 1 / OTHER_UNIT < ratio < OTHER_UNIT:
        raise ValueError(
            f"the CAD model is {ratio:.3g} times as large as the wall, in the numbers of its file. "
            "Do both have one unit? Scale the mesh, or write the file in the unit of the mesh."
        )


@eqx.filter_jit
def _move_walls(onto: Onto, x: Positions, target: Facets | None) -> Positions:
    turn, shift = (jnp.asarray(part, x.dtype) for part in (onto.turn, onto.shift))
    start = jnp.matmul(x, turn.T, precision="highest") + shift[None]
    is_last = np.arange(len(onto.lengths)) >= PROJECTION_STEPS
    # a CAD model is searched at the last step alone, its facets before
    facets = target if target is None else target.at(target.points)
    nearer = lambda y, step: (onto._nearer(y, step, start, facets), None)  # noqa: E731
    y = jax.lax.scan(nearer, start, (jnp.asarray(onto.lengths, x.dtype), is_last))[0]
    return (
        onto._places(y, onto.wall.at(y).normals(), target) if onto.is_exact else onto._in_planes(y)
    )


def _times(matrices: Float[Array, "k i j"], vectors: Any) -> Any:
    form = "kij,kj->ki" if vectors.ndim == 2 else "kij,kjd->kid"
    return jnp.einsum(form, matrices, vectors, precision="highest")


def _rotated(
    corners: Float[Array, "k c d"], old: Float[Array, "k d"], new: Float[Array, "k d"]
) -> Any:
    """Turns faces by the shortest way, as their area vectors turned."""
    d = corners.shape[2]
    old, new, corners = (
        jnp.pad(rows, [(0, 0)] * (rows.ndim - 1) + [(0, 3 - d)]) for rows in (old, new, corners)
    )
    old, new = (rows / jnp.where(norm(rows) > 0, norm(rows), 1)[:, None] for rows in (old, new))
    cosine = jnp.sum(old * new, axis=1)[:, None, None]
    axis = jnp.broadcast_to(jnp.cross(old, new)[:, None], corners.shape)
    across = jnp.cross(axis, corners)
    return (corners + across + jnp.cross(axis, across) / jnp.maximum(1 + cosine, 0.01))[..., :d]


def _solve_motion(faces: ndarray, local: ndarray, weights: ndarray, right: ndarray) -> ndarray:
    m, d = right.shape
    places = [
        np.broadcast_to(ids, local.shape).ravel() for ids in (faces[:, :, None], faces[:, None])
    ]
    bent = sparse.coo_matrix((local.ravel().astype(float), places), (m, m))
    own = sparse.bsr_matrix((weights.astype(float), np.arange(m), np.arange(m + 1)))
    matrix = (sparse.kron(bent, np.eye(d)) + own).tocsc()
    factors = splu(matrix, "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return factors.solve(right.ravel().astype(float)).reshape(m, d)


def _turn_normals(target: Facets, start: Facets) -> Facets:
    """Turns parts of the target that look the other way than the wall's nodes that are closest."""
    face = np.asarray(target.face(start.points))
    areas = np.asarray(target.areas())
    alike = np.sum(
        areas[face] / np.linalg.norm(areas[face], axis=1)[:, None] * np.asarray(start.normals()),
        axis=1,
    )
    votes = np.bincount(np.asarray(target.part)[face], alike, minlength=int(target.part.max()) + 1)
    is_other = (np.where(votes == 0, alike.sum(), votes) < 0)[target.part]
    faces = np.where(is_other[:, None], target.faces[:, ::-1], target.faces)
    return Facets(
        target.points, faces, smooth=target.smooth, angle=target.angle, model=target.model
    )


FITS = 20
SAMPLE = 300
NEAR_TARGET = 0.05
WHOLE = 0.1
"""Of a rigid fit: most steps and nodes; a distance that needs none; share of whole distances."""


def _rigid(wall: Facets, target: Target, nearest: Callable, planes: Sequence[Plane]) -> Motion:
    """Finds a turn (d, d) and a shift (d,) that halve the distance, from here and from the axes.

    Nodes go to the tangent planes at their closest places, again and again; planes stay. Source:
    Chen and Medioni, Object modelling by registration, Image and Vision Computing 10, 1992.
    """
    x = np.asarray(wall.points, float)
    normals = np.asarray(wall.normals(), float)
    d = wall.points.shape[1]
    some = FarthestPoints(SAMPLE, separation=0.0)(x)
    starts = _starts(x, target, planes)
    motions = _free_motions(planes, d)

    def off(turn, shift):
        y = x[some] @ turn.T + shift
        return y, np.asarray(nearest(y), float) - y

    best = starts[0]
    least = np.sqrt(np.mean(off(*starts[0])[1] ** 2))
    for turn, shift in starts:
        for _ in range(FITS if least > NEAR_TARGET * np.ptp(x, axis=0).max() else 0):
            turn, shift, is_done = _fitted(
                *off(turn, shift), normals[some] @ turn.T, motions, turn, shift
            )
            if is_done:
                break
        left = np.sqrt(np.mean(off(turn, shift)[1] ** 2))
        best, least = ((turn, shift), left) if left < least / 2 else (best, least)
    return best


def _starts(x: ndarray, target: Target, planes: Sequence[Plane]) -> list[Motion]:
    """From where the wall is, and with its axes laid on the target's, the smallest turn first."""
    d = x.shape[1]
    starts = [(np.eye(d), np.zeros(d))]
    if planes or not isinstance(target, Facets):
        return starts
    other = np.asarray(target.points, float)[np.unique(target.faces)]
    own, axes = (
        np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2] for points in (x, other)
    )
    turns = [(axes.T * signs) @ own for signs in itertools.product((1, -1), repeat=d)]
    turns = sorted(
        (turn for turn in turns if np.linalg.det(turn) > 0), key=lambda turn: -np.trace(turn)
    )
    return starts + [(turn, other.mean(axis=0) - turn @ x.mean(axis=0)) for turn in turns]


def _fitted(y, off, normals, motions, turn, shift):
    """One step: a small share of the whole distance keeps a cylinder from sliding along itself."""
    d = y.shape[1]
    middle = y.mean(axis=0)
    arm, ahead, to = (np.pad(rows, ((0, 0), (0, 3 - d))) for rows in (y - middle, normals, off))
    axes = [ahead, *(np.broadcast_to(WHOLE * axis, arm.shape) for axis in np.eye(3))]
    matrix = np.concatenate([np.concatenate([np.cross(arm, axis), axis], axis=1) for axis in axes])
    right = np.concatenate([np.sum(axis * to, axis=1) for axis in axes])
    change = motions @ np.linalg.lstsq(matrix @ motions, right, rcond=SAME_LENGTH)[0]
    step = Rotation.from_rotvec(change[:3]).as_matrix()[:d, :d]
    new = step @ turn, step @ (shift - middle) + middle + change[3 : 3 + d]
    is_done = np.linalg.norm(change[:3]) + np.linalg.norm(change[3:]) / np.linalg.norm(arm) < RESTED
    return *new, is_done


def _free_motions(planes: Sequence[Plane], d: int) -> ndarray:
    """A basis (6, k) of turns and shifts that keep planes, and in 2-D that of the drawing."""
    rows = [np.zeros((1, 6))]
    for normal in [np.pad(plane.normal, (0, 3 - d)) for plane in planes] + [np.eye(3)[2]] * (3 - d):
        rows += [
            np.hstack([np.cross(np.eye(3), normal), np.zeros((3, 3))]),
            np.hstack([np.zeros(3), normal])[None],
        ]
    return null_space(np.concatenate(rows))


@checked
def onto(
    wall: Facets,
    target: Target,
    *,
    symmetry: Planes = (),
    features: Sequence[Any] = (),
    length: float = 0.0,
) -> Float[ndarray, "m d"]:
    """Computes the displacement (m, d) of a wall's nodes onto a target, on the host.

    Arguments and errors are those of `Onto`, which is traced. `target.distance(x)` tells how far
    nodes are from it.

    **Raises:** `MeshError` too, with the nodes, where the way is not one to one: faces fold or
    collapse, or inner nodes end on the border of the target.
    """
    x = np.asarray(wall.points)
    made = Onto(wall, target, symmetry=symmetry, features=features, length=length)
    moved = np.asarray(made(x))
    _check_one_to_one(made, x, moved)
    return moved - x


COLLAPSED = 0.01  # share of a face's size that must be left, of the median of all


def _check_one_to_one(made: Onto, x: ndarray, moved: ndarray) -> None:
    faces = np.asarray(made.wall.faces)
    before = made.wall.at(x)
    after = made.wall.at(moved)
    first, last = (
        np.sum(np.asarray(wall.areas()) * np.asarray(wall.normals())[faces].mean(axis=1), axis=1)
        for wall in (before, after)
    )
    left = last / np.where(first > 0, first, np.inf)
    bad = faces[(left < COLLAPSED * np.median(left)) & (first > 0)]
    what = "fold over or collapse"
    inner = np.setdiff1d(faces, made.wall.rim)
    target = made.target
    if target is not None and made.is_exact and min(len(target.rim), len(inner)) and not len(bad):
        rim = np.broadcast_to(target.rim, (len(target.rim), 2))
        off = closest(np.asarray(target.points)[rim], moved[inner]).distance
        bad = inner[off < SAME_LENGTH * np.ptp(x, axis=0).max()][:, None]
        what = "end on the border of the target"
    if len(bad):
        many = (
            f"{len(bad)} of {len(faces)} faces" if bad.shape[1] > 1 else f"{len(bad)} inner nodes"
        )
        raise MeshError(
            f"{many} of the wall {what}, at node {{node}} near {shown_place(x[bad[0, 0]])}: the "
            "way onto the target is not one to "
            "one there. Extend or repair the target, name pairs of curves in `features`, or give "
            "a `length` to stay near it.",
            np.unique(bad),
        )
