"""Sliding patches: the surfaces that a caller names, checked, and made into walls."""

import dataclasses
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array
from scipy.spatial import Delaunay, QhullError

from .._host.cells.adjacency import parts_of
from .._host.cells.pieces import linear_cells
from .._host.linear.products import dot_rows, normals, row_lengths, unit_rows
from .._host.package.arguments import check_patch
from .._host.package.errors import MeshError, check_none, place_of, worst_first
from .._host.package.rounding import canonical_order, extent_of
from .._host.rows import Rows, join_ids
from .._host.surface.walls import sort_faces
from .._host.tolerances import (
    ALIGNED,
    ALONG_AXIS,
    CONTINUES,
    DEVIATION,
    NO_AREA,
    NO_EDGE,
    SAME,
    SAME_STATION,
)
from .._mesh.mesh import Mesh
from .face_search import FaceSearch
from .outer_faces import Faces, Ids
from .symmetry import Plane, optional
from .walls import AbstractWall, Flat, OnFaces, Round

Walls = list[tuple[AbstractWall, np.ndarray]]


@dataclasses.dataclass(frozen=True, eq=False, init=False)
class Revolution:
    """A surface of revolution: cylinder, cone, disc, any shroud or hub; in 2-D a circle.

    **Arguments:**

    - `axis`: direction (3,) of the axis, of any length; None in 2-D.
    - `origin`: a point (d,) on the axis, in 2-D the centre. Default: zero.
    - `profile`: points (k, 2) of the surface: ascending places along the axis from the origin, and
      radii, joined by a cubic spline. Default: a line if the patch's nodes lie on one (cylinder,
      cone, disc), otherwise a spline through the nodes.

    **Raises:** `ValueError` for an axis that is zero, and another profile.
    """

    axis: np.ndarray | None
    origin: np.ndarray | None
    profile: np.ndarray | None

    def __init__(self, axis=None, origin=None, profile=None):
        axis = optional("axis", axis, (3,))
        origin = optional("origin", origin, (2,), (3,))
        profile = optional("profile", profile, (None, 2))
        if axis is not None and not np.any(axis):
            raise ValueError(
                "the axis of a surface of revolution is a direction in 3-D that is not zero, not "
                f"{axis}."
            )
        if profile is not None and not (np.diff(profile[:, 0]) > 0).all():
            raise ValueError(
                "`profile` must be (k, 2): places along the axis, ascending, and radii."
            )
        vars(self).update(axis=axis, origin=origin, profile=profile)


@dataclasses.dataclass(frozen=True, eq=False)
class Slide:
    """Lets the nodes of a patch move along its surface.

    Examples are blade tips along a shroud, and a body along the sides of its box. Nodes between two
    sliding patches, or a patch and a symmetry plane, stay on both. Corners of the mesh, the apex of
    a cone, and fixed nodes do not move. Moving nodes of the patch stay on it. On a plane, a
    cylinder and other given surfaces the motion is smooth. On the patch's own faces the motion has
    a kink where a node crosses an edge. Nodes of curved cells follow the polynomials of their
    faces, if these are of one type.

    **Arguments:**

    - `patch`: name of a patch, several names, or ids of nodes.
    - `on`: the surface: a `Plane` (in 2-D a line), a `Revolution`, or None for the patch's own
      faces, which needs a mesh. Faces in one plane make a plane. Edges that turn by more than 60
      degrees divide the faces, and keep their nodes. Default None.
    """

    patch: str | Sequence[str] | np.ndarray
    on: Plane | Revolution | None = None

    def __post_init__(self) -> None:
        check_patch("patch", self.patch)
        if not (self.on is None or isinstance(self.on, Plane | Revolution)):
            raise ValueError(
                "a patch slides on a jm.Plane, a jm.Revolution or its own faces (None), not "
                f"{self.on!r}."
            )

    @property
    def name(self) -> str:
        return (
            f"the sliding patch {self.patch!r}"
            if isinstance(self.patch, str)
            else "a sliding patch"
        )


def walls_of(
    slides: Sequence[tuple[Slide, np.ndarray]], points: np.ndarray, mesh: Mesh | None, lists: Faces
) -> Walls:
    """Makes the walls of all patches; `lists` are the `fixed` and `moving` nodes."""
    walls = []
    faces = None
    if mesh is not None:
        outer = mesh.outer_faces
        faces = mesh.linear.cells if outer is None else outer.corners  # of a surface, its cells
    for k, (slide, nodes) in enumerate(slides):
        for name, listed in lists.items():
            check_none(
                nodes if np.isin(nodes, listed).all() else nodes[:0],
                f"all {{count}} nodes of {slide.name} are in `{name}`, first node {{node}} at "
                f"({{place}}): the patch would not "
                "slide. Remove them from one list.",
                points,
            )
        if any(np.array_equal(nodes, other) for _, other in slides[:k]):
            raise ValueError(
                f"{slide.name} comes twice in `sliding`. Its nodes slide along one surface. "
                "Remove one."
            )
        walls += with_own_curves(walls_of_patch(slide, nodes, points, faces, lists["moving"]), mesh)
    return walls


def walls_of_patch(
    slide: Slide,
    nodes: Ids,
    points: np.ndarray,
    faces: Faces | None,
    moving: np.ndarray | Sequence[int] = (),
) -> Walls:
    """Makes walls: own faces are divided at sharp edges, and filled up below `moving` bodies."""
    exact = points.astype(float)
    dimension = points.shape[1]
    if not len(nodes):
        raise ValueError(f"{slide.name} has no nodes.")
    nodes = nodes[canonical_order(exact[nodes])]
    if slide.on is None:
        return _of_faces(slide, nodes, exact, faces, np.isin(nodes, moving))
    if isinstance(slide.on, Revolution):
        wall = _of_revolution(slide, slide.on, exact[nodes])
    elif len(slide.on.normal) == dimension:
        wall = Flat(slide.on.normal, slide.on.origin)
    else:
        raise ValueError(
            f"the plane of {slide.name} has {len(slide.on.normal)} components, the mesh "
            f"{dimension} dimensions."
        )
    off = np.abs(np.asarray(wall.height(jnp.asarray(exact[nodes]))[0]))
    allowed = DEVIATION * extent_of(exact[nodes])
    check_none(
        nodes[worst_first(off, allowed)],
        f"{slide.name} does not lie on its surface: {{count}} of {len(nodes)} nodes are off, the "
        f"worst is node {{node}} at "
        f"({{place}}), {off.max():.3g} away (allowed {allowed:.3g}). Give the right surface, or "
        "None for the patch's faces.",
        exact,
    )
    return [(wall, nodes)]


def _of_revolution(slide: Slide, on: Revolution, patch: np.ndarray) -> AbstractWall:
    dimension = patch.shape[1]
    if (on.axis is None) != (dimension == 2):
        raise ValueError(
            f"{slide.name}: a surface of revolution has an axis in 3-D, and none in 2-D."
        )
    origin = np.zeros(dimension) if on.origin is None else on.origin
    if origin.shape != (dimension,):
        raise ValueError(
            f"{slide.name}: `origin` has shape {origin.shape}; the mesh has {dimension} dimensions."
        )
    axis = np.zeros(dimension) if on.axis is None else on.axis / np.linalg.norm(on.axis)
    line, profile = _line_or_profile(patch, on.profile, axis, origin)
    if line is None:
        from scipy.interpolate import (
            CubicSpline,
        )  # here: it would take a tenth of the time of all imports

        spline = CubicSpline(*profile.T, bc_type="natural" if len(profile) > 2 else "not-a-knot")
        return Round(axis, origin, spline.x, spline.c)
    a, b, c = line
    if abs(b) < ALONG_AXIS:
        return Flat(axis, origin + c / a * axis)
    return Round(axis, origin, np.array([0, np.inf]), np.array([[0], [0], [-a / b], [c / b]]))


def _line_or_profile(
    patch: np.ndarray, given: np.ndarray | None, axis: np.ndarray, origin: np.ndarray
) -> tuple[np.ndarray | None, np.ndarray]:
    """The line a z + b r = c of a patch, if it lies on one; places and radii of nodes, sorted."""
    if given is not None:
        return (None if len(given) > 1 else np.array([0, 1, given[0, 1]])), given
    arm = patch - origin
    size = extent_of(patch)
    along = arm @ axis
    profile = np.stack([along, row_lengths(arm - along[:, None] * axis)], axis=1)
    middle = profile.mean(axis=0)
    normal = np.array([0.0, 1.0])
    if axis.any() and np.ptp(profile[:, 1]) > SAME * size:
        normal = np.linalg.svd(profile - middle, full_matrices=False)[2][-1]
    is_line = not axis.any() or np.abs((profile - middle) @ normal).max() <= DEVIATION * size
    profile = profile[np.argsort(profile[:, 0], kind="stable")]
    profile = profile[np.append(True, np.diff(profile[:, 0]) > SAME_STATION * size)]
    return np.array([*normal, middle @ normal]) if is_line else None, profile


def _of_faces(
    slide: Slide, nodes: np.ndarray, points: np.ndarray, faces: Faces | None, moves: np.ndarray
) -> Walls:
    if faces is None:
        raise ValueError(
            f"{slide.name} slides on its faces, but points alone have no faces: pass the mesh "
            "with its cells, or a surface, "
            "jm.Slide(nodes, jm.Plane(normal, origin))."
        )
    dimension = points.shape[1]
    pieces = []
    for corners in Rows(nodes).renumbered(faces).values():
        # quads are cut into triangles about the node that comes first by place
        of_patch = sort_faces(corners[(corners >= 0).all(axis=1)])
        pieces += [
            of_patch[:, [0, k, k + 1][:dimension]] for k in range(1, max(2, of_patch.shape[1] - 1))
        ]
    elements = join_ids(pieces).reshape(-1, dimension)
    if not len(elements):
        raise ValueError(
            f"{slide.name} holds no boundary faces of the mesh; name the surface that it slides on."
        )
    if not extent_of(points[nodes]) > 0:
        place = place_of(points[nodes[0]])
        raise MeshError(
            f"all {len(nodes)} nodes of {slide.name} stand at ({place}): its faces have no extent.",
            nodes,
        )
    return _parted(nodes, points, filled(elements, points[nodes], moves))


def _parted(nodes: np.ndarray, points: np.ndarray, elements: np.ndarray) -> Walls:
    """Makes a wall of each part of faces, rows of `nodes`, between edges (2-D: corners) that turn
    by more than 60 degrees. Faces that fold back, the two sides of a thin plate, are one part.
    """
    area = normals(points[nodes[elements]])
    size = row_lengths(area)
    # a quad that ends in a point has a triangle without area
    has_area = size > NO_AREA * size.max()
    elements = elements[has_area]
    unit = area[has_area] / size[has_area, None]
    walls = []
    faces = np.repeat(np.arange(len(elements)), elements.shape[1])
    touch = csr_array((np.ones(faces.size), (elements.ravel(), faces)))
    beside = (touch.T @ touch).tocoo()
    cosine = dot_rows(unit[beside.row], unit[beside.col])
    joined = (cosine > CONTINUES - ALIGNED) | (cosine < -NO_EDGE)
    part = parts_of(beside.row[joined], beside.col[joined], len(elements))
    if len(np.unique(elements)) < len(nodes):  # nodes of no face belong to all parts
        part[:] = 0
    for number in range(part.max() + 1):
        corners = elements[part == number]
        rows = np.unique(corners) if part.any() else np.arange(len(nodes))
        ids = nodes[rows]
        corners = np.searchsorted(rows, corners).astype(np.int32)
        try:
            plane = Plane.through(points, ids)
            own = FaceSearch(ids, points[ids], corners)
            walls.append((Flat(plane.normal, plane.origin, own), ids))
        except ValueError:
            walls.append((OnFaces(FaceSearch.of(ids, points[ids], corners)), ids))
    return walls


def filled(
    faces: Int[np.ndarray, "e d"], vertices: Float[np.ndarray, "v d"], moves: Bool[np.ndarray, " v"]
) -> Int[np.ndarray, "f d"]:
    """Adds faces across all holes whose rim moves, left by bodies; other holes stay open. New faces
    continue the direction of the faces around them. In 2-D a line joins two ends that move. In 3-D
    a Delaunay triangulation in the rim's mean plane makes the faces. Old faces come first.
    """
    if faces.shape[1] == 2:
        return np.concatenate([faces, _join_ends(faces, vertices, moves)]).astype(faces.dtype)
    # closed rims of moving vertices: edges (r, 2) against the faces beside them
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    size = int(faces.max()) + 1
    is_rim = ~np.isin(edges @ [1, size], edges @ [size, 1]) & moves[edges].all(axis=1)
    edges = edges[is_rim][:, ::-1]
    part = parts_of(edges[:, 0], edges[:, 1], size)[edges[:, 0]]
    rims = [edges[part == number] for number in np.unique(part)]
    # as many edges begin at a node as end
    new = [_across(rim, faces, vertices) for rim in rims if np.array_equal(*np.sort(rim, axis=0).T)]
    return np.concatenate([faces, *new]).astype(faces.dtype)


def _join_ends(faces: np.ndarray, vertices: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """Lists lines (k, 2) from moving ends to the nearest moving starts that lie ahead."""
    start, end = faces.T
    along = unit_rows(vertices[end] - vertices[start])  # zero for a face of two nodes at one place
    last = np.flatnonzero(~np.isin(end, start) & moves[end])
    first = np.flatnonzero(~np.isin(start, end) & moves[start])
    gap = vertices[start[first]][None] - vertices[end[last]][:, None]
    size = np.linalg.norm(gap, axis=2)
    ahead = np.minimum(
        np.sum(gap * along[last][:, None], axis=2), np.sum(gap * along[first][None], axis=2)
    )
    cost = np.where((size > 0) & (ahead > CONTINUES * size), size, np.inf)
    if not cost.size:
        return faces[:0]
    best = cost.argmin(axis=1)
    kept = np.isfinite(cost.min(axis=1)) & (cost.argmin(axis=0)[best] == np.arange(len(best)))
    return np.stack([end[last[kept]], start[first[best[kept]]]], axis=1)


def _across(rim: np.ndarray, faces: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Triangles (k, 3) across a rim, unless they would turn off from the faces beside it."""
    nodes = np.unique(rim)
    ends = vertices[rim]
    area = np.cross(ends[:, 0] - ends[0, 0], ends[:, 1] - ends[0, 0]).sum(axis=0)
    beside = normals(vertices[faces[np.isin(faces, nodes).sum(axis=1) > 1]])
    if not (unit_rows(beside) @ area).mean() > CONTINUES * np.linalg.norm(area):
        return faces[:0]
    axes = np.linalg.svd(area[None])[2][1:]
    try:
        corners = nodes[Delaunay(vertices[nodes] @ axes.T).simplices]
    except QhullError:
        return faces[:0]
    # within the rim a middle is to the left of an odd number of edges
    (a, b), (c, d) = np.moveaxis(ends @ axes.T, 0, 2)
    across, up = (vertices[corners].mean(axis=1) @ axes.T).T[..., None]
    with np.errstate(divide="ignore", invalid="ignore"):  # of level edges, which none crosses
        is_left = across < a + (up - b) * (c - a) / (d - b)
    corners = corners[np.sum(((b > up) != (d > up)) & is_left, axis=1) % 2 == 1]
    is_back = normals(vertices[corners]) @ area < 0
    return np.where(is_back[:, None], corners[:, ::-1], corners)


def with_own_curves(walls: Walls, mesh: Mesh | None) -> Walls:
    """Replaces the linear pieces of walls by the curved faces that they are pieces of. Walls whose
    faces are of two types, or that have faces across holes, keep their pieces.
    """
    if mesh is None or not mesh.is_curved:
        return walls
    return [
        (OnFaces(_with_curves(wall.own, mesh)) if isinstance(wall, OnFaces) else wall, nodes)
        for wall, nodes in walls
    ]


def _with_curves(own: FaceSearch, mesh: Mesh) -> FaceSearch:
    nodes = np.asarray(own.nodes)
    sides = {kind: ids for kind, (ids, _) in mesh.topology.outer(nodes).items() if len(ids)}
    pieces = sum(
        len(ids) * (2 if kind == "quad" else 1) for kind, ids in linear_cells(sides).items()
    )
    if len(sides) != 1 or pieces != len(own.faces):
        return own
    ((kind, ids),) = sides.items()
    rows = Rows(nodes).of(ids)
    return own.on_curved(rows[np.lexsort(np.sort(rows, axis=1).T)], kind)
