"""A wall onto a target: a scan, another CAD surface, or a function of closest places."""

import functools
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from numpy import ndarray
from scipy import sparse
from scipy.linalg import null_space
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation

from jaxmorph import Facets, FarthestPoints, MeshError, Plane
from jaxmorph.extend import (
    Either,
    Module,
    add_at,
    area_vectors,
    as_jax,
    between,
    by_place,
    checked,
    closest,
    host_call,
    namespace,
    norm,
    put_at,
)

from ._arguments import Numbers, Positions, positions, shown_place
from ._features import (
    Borders,
    Clip,
    Planes,
    Rail,
    borders_of,
    check_pairs,
    clipped,
    guides_of,
    height_of,
    length_hint,
    on_target,
)
from ._smooth import stiffness_of
from ._tolerances import ON_BORDER, ON_SYMMETRY, RESTED, SAME_LENGTH, UNIT_FACTORS

Places = Float[Either, "m d"]
Masses = Float[Either, " m"]
Target = Facets | Callable
Motion = tuple[ndarray, ndarray]

FIRST = 0.5
LAST = 0.01  # first and last length over the wall's extent
PROJECTION_STEPS = 8
SECTION_STEPS = 4  # onto the section of a CAD model with a plane
STEEPEST = 10.0  # square of the longest of them, over the distance from the model
SETTLED = 4  # steps from one to the other, and at the last
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
      without waves much shorter than this length, such as the noise of a scan. What is beyond the
      border of an open target then follows the rest of the wall.

    **Raises:** `ValueError` for different dimensions, a target in another unit, and corners that
    would share one of the target. Also for a target that does not reach a plane, without a
    `length`.

    Source: Amberg, Romdhani and Vetter, Optimal step nonrigid ICP algorithms, CVPR 2007; Sorkine
    and Alexa, As-rigid-as-possible surface modeling, SGP 2007.
    """

    wall: Facets
    target: Facets | None
    function: Callable | None = eqx.field(static=True)
    clips: tuple[Clip, ...]
    guides: tuple[Rail, ...]
    borders: Borders
    border: Int[Array | ndarray, "r e"]
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
        last = length or LAST * extent
        self.wall = wall
        self.is_exact = length == 0
        self.function = None
        self.target = None
        self.clips = ()
        self.guides = ()
        self.border = np.zeros((0, 2), int)
        slack = ON_SYMMETRY * extent
        open_ends = np.zeros((0, 2, x.shape[1]))
        if isinstance(target, Facets):
            _check_target(x, target)
            check_pairs(features)
            if not self.is_exact:
                open_ends = np.asarray(target.points, float)[_open_border(target, planes, slack)]
        nearest = target.closest if isinstance(target, Facets) else target
        self.turn, self.shift = _rigid(wall, target, nearest, planes, open_ends)
        start = x @ self.turn.T + self.shift
        if isinstance(target, Facets):
            whole = target
            target, self.clips = _cut_off(target, planes, x, may_end=not self.is_exact)
            features = on_target(features, whole, self.clips)
            self.target = _turn_normals(target, wall.at(start))
            if not self.is_exact:
                self.border = _open_border(self.target, planes, slack)
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
            places: Any = positions(points, "points")
            for clip in self.clips:
                places = clip(places)
            target = target.at(places)
        return as_jax(_move_walls(self, x, target))

    def _places(self, y: Places, facing: Places, target: Facets | None) -> Places:
        xp = namespace(y)
        if target is None:
            assert self.function is not None
            find = jax.jit(self.function)
            places = xp.asarray(find(y), y.dtype)
            for _ in self.borders:
                places = xp.asarray(find(self._in_planes(places)), y.dtype)
            return self._in_planes(places)
        places = xp.asarray(target.closest(y, facing, along=True))
        for guide in self.guides:
            own = xp.asarray(guide.places(y, facing, target))
            places = put_at(places, guide.rows, own)
        places = self._in_planes(places)
        return places if target.model is None else self._on_sections(places, target)

    def _on_sections(self, y: Places, target: Facets) -> Places:
        """Takes nodes in planes onto the model in these: its facets were cut there, not itself."""
        xp = namespace(y)
        for rows in [rows for _, rows in self.borders for _ in range(SECTION_STEPS)]:
            # the foot lies along the normal: as far again in the plane as its share there is less
            off = xp.asarray(target.closest(y[rows])) - y[rows]
            across = self._in_planes(add_at(y, rows, off))[rows] - y[rows]
            squared = xp.sum(across**2, axis=1)
            share = xp.sum(off**2, axis=1) / xp.where(squared > 0, squared, xp.inf)
            y = add_at(y, rows, xp.minimum(share, STEEPEST)[:, None] * across)
        return y

    def _is_beyond(self, places: Places, target: Facets | None) -> Bool[Either, " m"]:
        """Whether places are on the border of the target: nothing draws their nodes."""
        xp = namespace(places)
        if target is None or not len(self.border):
            return xp.zeros(len(places), bool)
        corners = xp.asarray(target.points)[self.border]
        if xp is np:
            off = _rim_distance(corners, places)
        else:
            given = jax.lax.stop_gradient((corners, places))
            structure = jax.ShapeDtypeStruct(places.shape[:1], places.dtype)
            off = host_call(_rim_distance, structure, *given)
        return off < ON_BORDER * xp.max(xp.ptp(places, axis=0))

    def _in_planes(self, y: Places) -> Places:
        xp = namespace(y)
        for plane, rows in self.borders:
            normal = xp.asarray(plane.normal, y.dtype)
            y = add_at(y, rows, -height_of(y[rows], plane)[:, None] * normal[None])
        return y

    def _weights(self, y: Places, facing: Places, mass: Masses, hard: Masses):
        """Weights (m, d, d) of distances from places: across the wall, across curves, or whole."""
        xp = namespace(y)
        one = xp.eye(y.shape[1], dtype=y.dtype)
        weights = mass[:, None, None] * facing[:, :, None] * facing[:, None]
        for guide in self.guides:
            along = y[guide.beside[:, 1]] - y[guide.beside[:, 0]]
            squared = xp.sum(along**2, axis=1)
            share = (
                along[:, :, None]
                * along[:, None]
                / xp.where(squared > 0, squared, 1)[:, None, None]
            )
            across = hard[guide.rows, None, None] * (one[None] - share)
            weights = put_at(weights, guide.rows, across)
        for plane, rows in self.borders:
            normal = xp.asarray(plane.normal, y.dtype)
            weights = add_at(weights, rows, hard[rows, None, None] * xp.outer(normal, normal)[None])
        return weights

    def _nearer(self, y: Places, step: Any, start: Places, target: Facets | None) -> Places:
        # Each face keeps its shape, at last turned as the wall is now: K y = K R x_0. Each node is
        # drawn to the tangent plane at its closest place c: N y = N c. The length of K falls: the
        # wall first goes as a whole, at the end its faces only resist sliding.
        xp = namespace(y)
        length, is_last = step
        faces = self.wall.faces
        m, d = y.shape
        size, local = stiffness_of(start[faces])
        local = length**2 * local
        none = xp.zeros(m, y.dtype)
        mass = add_at(none, faces, size[:, None] / d)
        stiff = add_at(none, faces, xp.diagonal(local, axis1=1, axis2=2))
        facing = xp.asarray(self.wall.at(y).normals())
        places = self._places(y, facing, target)
        pull = xp.where(self._is_beyond(places, target), 0, mass)
        weights = self._weights(y, facing, pull, mass + HARD * stiff)
        off = _times(weights, places - y)
        shape = start[faces]
        if self.is_exact:
            turned = _rotated(shape, area_vectors(shape), area_vectors(y[faces]))
            shape = xp.where(is_last, turned, shape)
        off = add_at(off, faces, _times(local, shape - y[faces]))
        weights = weights + STAYING * mass[:, None, None] * xp.eye(d, dtype=y.dtype)[None]
        if xp is np:
            return y + _solve_motion(faces, local, weights, off).astype(y.dtype)

        def product(v):
            return _times(weights, v).at[faces].add(_times(local, v[faces]))

        def solve(_, right):
            return host_call(
                _solve_motion, jax.ShapeDtypeStruct((m, d), y.dtype), faces, local, weights, right
            )

        return y + jax.lax.custom_linear_solve(product, off, solve, symmetric=True)


@by_place
def _move_walls(onto: Onto, x: Places, target: Facets | None) -> Places:
    xp = namespace(x)
    turn, shift, lengths = (
        xp.asarray(part, x.dtype) for part in (onto.turn, onto.shift, onto.lengths)
    )
    start = xp.sum(x[:, None] * turn[None], axis=2) + shift[None]
    is_last = np.arange(len(lengths)) >= PROJECTION_STEPS
    # a CAD model is searched at the last step alone, its facets before
    facets = None if target is None else target.at(target.points)
    nearer = functools.partial(onto._nearer, start=start, target=facets)
    y = start
    if xp is np:
        for step in zip(lengths, is_last, strict=True):
            y = nearer(y, step)
    else:
        y = jax.lax.scan(lambda y, step: (nearer(y, step), None), y, (lengths, is_last))[0]
    if not onto.is_exact:
        return onto._in_planes(y)
    return onto._places(y, xp.asarray(onto.wall.at(y).normals()), target)


def _rim_distance(corners: ndarray, x: ndarray) -> ndarray:
    return closest(corners.astype(float), x.astype(float)).distance.astype(x.dtype)


def _cut_off(
    target: Facets, planes: Sequence[Plane], x: ndarray, *, may_end: bool
) -> tuple[Facets, tuple[Clip, ...]]:
    """Cuts a target off at planes; it may end before them."""
    slack = ON_SYMMETRY * np.ptp(x, axis=0).max()
    clips = []
    for plane in planes:
        side = np.sign(np.median(plane.height(x)))
        least = (side * plane.height(np.asarray(target.points))).min()
        if not may_end or least <= slack:
            clip, target = clipped(target, plane, side, slack)
            clips.append(clip)
    return target, tuple(clips)


def _open_border(target: Facets, planes: Sequence[Plane], slack: float) -> ndarray:
    """Edges (r, 2) of the border that lie in no plane; in 2-D a point twice."""
    rim = np.asarray(target.rim)
    points = np.asarray(target.points, float)[rim]
    for plane in planes:
        apart = ~(np.abs(plane.height(points)) <= slack).all(axis=1)
        rim = rim[apart]
        points = points[apart]
    return np.broadcast_to(rim, (len(rim), 2))


CLOSE_UNIT = 1.3
NEARER = 2.0
"""Factors by which a part of a body may be smaller, and distances fall in the right unit."""


def _check_target(x: ndarray, target: Facets) -> None:
    """Refuses a target of another dimension, and one as long as the wall in another unit."""
    if target.points.shape[1] != x.shape[1]:
        raise ValueError(
            f"the wall is in {x.shape[1]}-D, its target in {target.points.shape[1]}-D."
        )
    points = np.asarray(target.points)[np.unique(target.faces)]
    own, other = (float(np.ptp(places, axis=0).max()) for places in (x, points))
    longer = np.log(other / own)
    factor = min(UNIT_FACTORS, key=lambda factor: abs(longer + np.log(factor)))
    if abs(longer + np.log(factor)) > np.log(CLOSE_UNIT):
        return
    some = x[:: 1 + len(x) // SAMPLE]
    off = np.median(target.distance(some))
    in_unit = factor * np.median(target.distance(some / factor))
    if off > FAR * own or in_unit < off / NEARER:
        cure = f"Multiply its points by {factor:.10g}."
        if target.model is not None:
            cure = f"Scale the CAD model by {factor:.10g}, or the mesh."
        raise ValueError(
            f"the target is {other:.4g} long, the wall {own:.4g}: it seems to be in another unit. "
            f"{cure}"
        )


def _times(matrices: Float[Either, "k i j"], vectors: Any) -> Any:
    form = "kij,kj->ki" if vectors.ndim == 2 else "kij,kjd->kid"
    if namespace(matrices) is np:
        return np.einsum(form, matrices, vectors)
    return jnp.einsum(form, matrices, vectors, precision="highest")


def _rotated(
    corners: Float[Either, "k c d"], old: Float[Either, "k d"], new: Float[Either, "k d"]
) -> Any:
    """Turns faces by the shortest way, as their area vectors turned."""
    xp = namespace(corners)
    d = corners.shape[2]
    old, new, corners = (
        xp.pad(rows, [(0, 0)] * (rows.ndim - 1) + [(0, 3 - d)]) for rows in (old, new, corners)
    )
    old, new = (rows / xp.where(norm(rows) > 0, norm(rows), 1)[:, None] for rows in (old, new))
    cosine = xp.sum(old * new, axis=1)[:, None, None]
    axis = xp.broadcast_to(xp.cross(old, new)[:, None], corners.shape)
    across = xp.cross(axis, corners)
    return (corners + across + xp.cross(axis, across) / xp.maximum(1 + cosine, 0.01))[..., :d]


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


def _rigid(
    wall: Facets, target: Target, nearest: Callable, planes: Sequence[Plane], open_ends: ndarray
) -> Motion:
    """Finds a turn (d, d) and a shift (d,) that halve the distance, from here and from the axes.

    Nodes go to the tangent planes at their closest places, again and again; planes stay. Nodes
    beyond the edges `open_ends` (r, 2, d) do not count, and no motion takes more of them there.
    Source: Chen and Medioni, Object modelling by registration, Image and Vision Computing 10, 1992.
    """
    x = np.asarray(wall.points, float)
    normals = np.asarray(wall.normals(), float)
    d = wall.points.shape[1]
    some = FarthestPoints(SAMPLE, separation=0.0)(x)
    starts = _starts(x, target, planes)
    motions = _free_motions(planes, d)

    extent = np.ptp(x, axis=0).max()

    def off(turn, shift):
        y = x[some] @ turn.T + shift
        places = np.asarray(nearest(y), float)
        on = np.ones(len(y), bool)
        if len(open_ends):
            on = closest(open_ends, places).distance > ON_BORDER * extent
        return y[on], places[on] - y[on], on

    best = starts[0]
    _, away, on = off(*best)
    count = on.sum()
    least = np.sqrt(np.mean(away**2)) if count else np.inf
    if least <= NEAR_TARGET * extent:
        return best  # else an open wall would slide along its target, middle onto middle
    for turn, shift in starts:
        for _ in range(FITS):
            y, away, on = off(turn, shift)
            if on.sum() < len(motions):  # too few for a motion
                break
            turn, shift, is_done = _fitted(
                y, away, (normals[some] @ turn.T)[on], motions, turn, shift
            )
            if is_done:
                break
        _, away, on = off(turn, shift)
        left = np.sqrt(np.mean(away**2)) if on.sum() >= max(count, 1) else np.inf
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
            "one there. Extend or repair the target, name pairs of curves in `features`, or stay "
            f"near it by {length_hint(x)}.",
            np.unique(bad),
        )
