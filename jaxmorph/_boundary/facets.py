"""Triangulated surfaces, polylines in 2-D: their closest places, traced, and their edges."""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int, Real

from .._host.cells.topology import DIMENSION
from .._host.linear.products import cofactors, determinant, dot, dot_rows, normals, unit_rows
from .._host.package.arguments import checked, finite_array, shown
from .._host.rows import Rows, first_of_equals
from .._host.surface.creases import Creased, cut_faces, with_extent
from .._host.surface.gaps import closest
from .._kernels.callback import host_call
from .._kernels.compile import by_place, quickly_compiled
from .._kernels.module import Module
from .._kernels.values import (
    Either,
    add_at,
    area_vectors,
    array,
    as_jax,
    is_known,
    iterate,
    namespace,
    norm,
)
from .._mesh.mesh import Mesh
from .face_search import on_simplices, smooth_normals
from .outer_faces import boundary_faces

Numbers = Real[ArrayLike, "..."] | Sequence[Any]
Places = Float[Array, "m d"]

SHARP = np.pi / 3
NEWTON = 12
WALK = 6
SEEN = -0.5
ALIKE = 0.5
PAIRS_OF_BLOCK = 2**20
"""Turn at a sharp edge. To a place along the normals: steps, facets on the way, and the share of a
facet by which it may be outside. On a curve: the least cosine of normals, as an edge of a flat end
has another edge at a right angle; directions and segments compared at once."""

QUICK_FACES = 50_000  # faces below which normals take longer to compile than to compute


class Facets(Module):
    """A surface of triangles in 3-D, or a curve of segments: of a file, a CAD model or a mesh.

    Points at one place are one vertex. Faces are turned to one sense, that of the larger area, part
    by part. Faces without extent are left out. Faces that turn by more than `angle` meet at a sharp
    edge.

    **Arguments:**

    - `points`: (n, d).
    - `faces`: rows of points, (k, 3) or (k, 4) in 3-D, (k, 2) in 2-D and for curves in 3-D, one
      array or several. Quads are cut along the shorter diagonal; of equal ones, by place.
    - `smooth`: False: the surface is its facets. True: the smooth one through their vertices, with
      the sharp edges kept, as Phong tessellation has it. Default False.
    - `angle`: radians. Default pi / 3.
    - `sides`: normals (k, d) of segments in 3-D, if they are known.
    - `model`: the CAD model of which these are facets, as `io.read_facets` gives it. Closest places
      are on its own surfaces, those to segments on its sharp edges. Faces meet at a sharp edge
      where the model has one: its faces turn there, by more than a degree.

    **Raises:** `ValueError` for faces of another shape, ids that are no rows, and no faces.

    Source: Boubekeur and Alexa, Phong tessellation, ACM Trans. Graph. 27, 2008.
    """

    points: Float[Either, "n d"]
    welded: Int[Either, " n"]  # the vertex of each point: the first point at its place
    faces: Int[Either, "k c"]  # this and the next six: as in `Creased`
    beside: Int[Either, "k c"]
    corners: Int[Either, "k c"]
    origins: Int[Either, " v"]
    part: Int[Either, " k"]
    sharp: Int[Either, "s e"]
    rim: Int[Either, "r e"]
    sides: Float[Either, "k d"] | None
    smooth: bool = eqx.field(static=True)
    angle: float = eqx.field(static=True)
    model: Any = eqx.field(static=True)

    @checked
    def __init__(
        self,
        points: Any,
        faces: Any,
        *,
        smooth: bool = False,
        angle: float = SHARP,
        sides: Any = None,
        model: Any = None,
    ):
        if model is not None and not hasattr(model, "edge_rows"):
            raise ValueError(f"`model` must be that of io.read_facets, not {shown(model)}.")
        self.model = model
        known = finite_array("points", points, (None, 2), (None, 3))
        self.points = points if isinstance(points, jax.Array) else array(known)
        self.smooth = smooth
        self.angle = angle
        exact = known.astype(float) + 0.0  # no -0.0
        first, place = first_of_equals(exact)
        self.welded = first[place]
        faces = cut_faces(faces, exact)
        if sides is None:
            self.sides = None
            is_feature = None if model is None else model.is_feature
            found = Creased.of(
                with_extent(faces, self.welded), exact, self.welded, angle, is_feature
            )
        else:
            self.sides = finite_array("sides", sides, faces.shape[:1] + exact.shape[1:])
            found = Creased.none(faces)
        self.faces = found.faces
        self.beside = found.beside
        self.corners = found.corners
        self.origins = found.origins
        self.part = found.part
        self.sharp = found.sharp
        self.rim = found.rim

    @staticmethod
    @checked
    def of(mesh: Mesh, *patches: str, smooth: bool = False, angle: float = SHARP) -> "Facets":
        """Takes the facets of a mesh: its faces as cells, else the boundary of its cells.

        With `patches` they are the faces of these, and row i is node `mesh.patch(*patches)[i]`.
        Normals of a boundary point from the body into the mesh.

        **Raises:** `ValueError` for no faces.
        """
        nodes = mesh.patch(*patches) if patches else np.arange(len(mesh.points))
        faces = _facets_of(mesh, patches)
        rows = [ids[(ids >= 0).all(axis=1)] for ids in map(Rows(nodes).of, faces)]
        return Facets(
            mesh.points[nodes], [ids for ids in rows if len(ids)], smooth=smooth, angle=angle
        )

    @checked
    def at(self, points: Numbers) -> "Facets":
        """Moves the points to other places (n, d). Traced; the edges stay as they were found.

        Facets of a CAD model become facets alone.
        """
        moved = eqx.tree_at(
            lambda facets: facets.points, self, self._like("points", points, len(self.points))
        )
        object.__setattr__(moved, "model", None)  # of the new one
        return moved

    @checked
    def closest(self, x: Numbers, facing: Numbers | None = None, *, along: bool = False) -> Places:
        """Finds the closest place to each of `x` (m, d). Traced.

        The host finds the face, so that a derivative is that of the closest place on it. With
        `facing`, directions (m, d), a face that looks the other way has no place: the sides of a
        thin body are told apart. Of segments with `sides` those have none that look 60 degrees away
        and more. On a smooth surface, or with `along`, it is the place from which
        `x` is seen along the normals, interpolated between vertices: it moves without jumps.
        """
        x = self._like("x", x)
        is_curve = self.sides is not None
        is_seen = self.smooth or (along and not is_curve)
        if self.model is None:
            return as_jax(_place(self, x, self.face(x, facing), is_seen))
        if facing is not None or along or is_curve:
            x = _place(self, x, self.face(x, facing), is_seen)
        return as_jax(_onto_model(self.model.edge_rows if is_curve else self.model.rows, x))

    @checked
    def face(self, x: Numbers, facing: Numbers | None = None) -> Int[Array, " m"]:
        """Finds the row of the face that has the place of `closest`. Traced; the host finds it."""
        x = self._like("x", x)
        none = np.zeros((0, self.points.shape[1]))
        facing = None if facing is None else self._like("facing", facing, len(x))
        given = (x, facing, self.points, self.faces, self.sides)
        given = jax.lax.stop_gradient([none if each is None else array(each) for each in given])
        return host_call(_find_faces, jax.ShapeDtypeStruct(x.shape[:1], np.int32), *given)

    @checked
    def distance(self, x: Numbers) -> Float[Array, " m"]:
        """Measures the distance of each of `x` (m, d) from the closest place. Traced."""
        x = self._like("x", x)
        return norm(x - self.closest(x))

    def _like(self, name: str, values: Any, count: int | None = None) -> Places:
        values = array(values)
        d = self.points.shape[1]
        if values.ndim != 2 or values.shape[1] != d or (count is not None and len(values) != count):
            raise ValueError(f"`{name}` has shape {values.shape}; expected ({count or 'm'}, {d}).")
        if is_known(values) and not np.isfinite(np.asarray(values)).all():
            raise ValueError(f"`{name}` holds numbers that are not finite.")
        return values

    def areas(self) -> Float[Array, "k d"]:
        """Computes area vectors of the faces, in 2-D as long as the segments. Traced."""
        with quickly_compiled(len(self.faces) < QUICK_FACES):
            return as_jax(_measure_areas(self))

    def normals(self) -> Float[Array, "n d"]:
        """Computes unit normals at the points; at a sharp edge, the mean of its sides. Traced."""
        with quickly_compiled(len(self.faces) < QUICK_FACES):
            return as_jax(_unit_normals(self))


@by_place
def _measure_areas(facets: Facets) -> Float[Either, "k d"]:
    return area_vectors(facets.points[facets.faces])


@by_place
def _unit_normals(facets: Facets) -> Float[Either, "n d"]:
    above = _normals_of(facets)
    xp = namespace(above)
    total = add_at(xp.zeros(facets.points.shape, above.dtype), facets.origins, above)
    length = norm(total)
    return (total / xp.where(length > 0, length, 1)[:, None])[facets.welded]


def _normals_of(facets: Facets) -> Float[Either, "v d"]:
    return smooth_normals(facets.points[facets.origins], facets.corners)


def _onto_model(rows: Callable[..., Any], x: Float[Either, "m d"]) -> Float[Either, "m d"]:
    """The closest places on a model; its host finds them, and their derivatives."""
    if namespace(x) is np:
        return rows(x)[:, 0].astype(x.dtype)
    shape = jax.ShapeDtypeStruct((len(x), 4, 3), x.dtype)
    still = jax.lax.stop_gradient(x)
    found = host_call(rows, shape, still)
    return found[:, 0] + jnp.einsum("mkd,mk->md", found[:, 1:], x - still, precision="highest")


@by_place
def _place(
    facets: Facets, x: Float[Either, "m d"], face: Int[Either, " m"], is_seen: bool
) -> Float[Either, "m d"]:
    """Finds the place on each face that is closest to x, or from which x is seen."""
    xp = namespace(x)
    flat = on_simplices(x, facets.points[facets.faces[face]])
    if not is_seen:
        return flat
    above = _normals_of(facets)

    def shares(face, steps):
        corners = facets.points[facets.faces[face]]
        normals = above[facets.corners[face]]
        return _along_normals(x, corners, normals, steps), corners, normals

    def walk(face):
        # from the host's facet over the edges beyond which the place is, until it is inside
        at = shares(face, NEWTON // 2)[0]
        lowest = xp.argmin(at, axis=1)
        after = facets.beside[face, (lowest + 1) % at.shape[1]]
        return xp.where(xp.min(at, axis=1) < 0, after.astype(face.dtype), face)

    at, corners, normals = shares(iterate(walk, face, WALK), NEWTON)
    inside = xp.min(at, axis=1)
    at = xp.clip(at, 0, 1)
    at = at / xp.sum(at, axis=1)[:, None]
    place = _weighted(at, corners)
    along = _weighted(at, normals)
    unit = along / norm(along)[:, None]
    height = xp.sum((corners - place[:, None]) * normals, axis=2)
    lift = xp.sum(_weighted(at * height, normals) * unit, axis=1)
    place = place + 0.5 * facets.smooth * lift[:, None] * unit
    # far from a rough surface no place may be seen along the normals
    return xp.where(inside[:, None] > SEEN, place, flat)


def _weighted(shares: Float[Either, "m c"], rows: Float[Either, "m c d"]) -> Float[Either, "m d"]:
    return namespace(rows).sum(shares[:, :, None] * rows, axis=1)


def _along_normals(
    x: Float[Either, "m d"],
    corners: Float[Either, "m c d"],
    normals: Float[Either, "m c d"],
    steps: int,
) -> Float[Either, "m c"]:
    # Shares of the corners in the place p from which x is seen along the normal n: p + h n = x, by
    # Newton's method. A smooth surface lies above p as in Phong tessellation, but along n.
    xp = namespace(x)
    sides = corners[:, 1:] - corners[:, :1]
    bends = normals[:, 1:] - normals[:, :1]

    def nearer(z):
        height = z[:, -1:]
        along = normals[:, 0] + _weighted(z[:, :-1], bends)
        off = corners[:, 0] + _weighted(z[:, :-1], sides) + height * along - x
        columns = [*xp.moveaxis(sides + height[:, :, None] * bends, (1, 2), (0, 1)), along.T]
        size = determinant(columns)
        change = xp.stack([dot(row, off.T) for row in cofactors(columns)], axis=1)
        return z - change / xp.where(size != 0, size, xp.inf)[:, None]

    count = corners.shape[1]
    start = xp.where(xp.arange(count) < count - 1, xp.asarray(1 / count, x.dtype), 0)
    at = iterate(nearer, xp.broadcast_to(start, (len(x), count)), steps)[:, :-1]
    return xp.concatenate([1 - xp.sum(at, axis=1)[:, None], at], axis=1)


def _facets_of(mesh: Mesh, patches: tuple[str, ...]) -> list[np.ndarray]:
    d = mesh.points.shape[1]
    cells = mesh.linear.cells
    faces = [
        np.asarray(ids) for kind, ids in cells.items() if DIMENSION[kind] == d - 1 and len(ids)
    ]
    is_filled = any(DIMENSION[kind] == d for kind in cells)
    if faces and not (patches and is_filled):
        return faces
    return [ids[:, ::-1] for ids in boundary_faces(mesh, *patches).values()]


def _find_faces(
    x: np.ndarray, facing: np.ndarray, points: np.ndarray, faces: np.ndarray, sides: np.ndarray
) -> np.ndarray:
    corners = points.astype(float)[faces]
    x = x.astype(float)
    face = closest(corners, x)[0]
    if not len(facing):
        return face
    if len(sides):
        return _find_alike(face, x, unit_rows(facing), corners, unit_rows(sides))
    unit = unit_rows(normals(corners))
    away = np.flatnonzero(dot_rows(unit[face], facing) < 0)
    # These look for the closest face again, among those that look along the largest component.
    axis = np.abs(facing[away]).argmax(axis=1)
    side = 2 * axis + (facing[away, axis] > 0)
    for number in np.unique(side):
        component = unit[:, number // 2] * (1 if number % 2 else -1)
        rows = away[side == number]
        kept = np.flatnonzero(component > 0)
        if len(kept):
            face[rows] = kept[closest(corners[kept], x[rows])[0]]
    return face


def _find_alike(
    face: np.ndarray, x: np.ndarray, facing: np.ndarray, corners: np.ndarray, unit: np.ndarray
) -> np.ndarray:
    """Takes the closest segment that looks alike, where the closest of all does not. One of no
    direction looks like any.
    """
    is_known = np.asarray(unit.any(axis=1))
    away = np.flatnonzero((dot_rows(unit[face], facing) < ALIKE) & is_known[face])
    step = max(PAIRS_OF_BLOCK // len(unit), 1)
    for rows in [away[at : at + step] for at in range(0, len(away), step)]:
        row, segment = np.nonzero((facing[rows] @ unit.T >= ALIKE) | ~is_known)
        off = norm(on_simplices(x[rows[row]], corners[segment]) - x[rows[row]])
        order = np.lexsort((segment, off, row))
        found, first = np.unique(row[order], return_index=True)
        face[rows[found]] = segment[order[first]]
    return face
