"""Sliding patches: the surfaces that a caller names, checked, and made into walls."""

import dataclasses
from collections.abc import Mapping, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from .._host.cells.adjacency import parts_of
from .._host.cells.pieces import boundary_sides, linear_cells
from .._host.cells.topology import solid
from .._host.linear.products import normals
from .._host.package.arguments import check_patch, finite_array
from .._host.package.errors import MeshError, place_of, worst_first
from .._host.package.rounding import canonical_order
from .._host.surface.walls import in_order
from .._mesh.mesh import Mesh
from .faces import CurvedFaces, Faceted, FlatFaces, faces_around
from .holes import CONTINUES, filled
from .symmetry import Plane
from .tracks import SMOOTH
from .walls import AbstractWall, Flat, Round

Walls = list[tuple[AbstractWall, np.ndarray]]

DEVIATION = 1e-5  # distance of nodes on a surface, relative to the patch's extent: files have few digits


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
        axis = None if axis is None else finite_array("axis", axis, (3,)).astype(float)
        origin = None if origin is None else finite_array("origin", origin, (2,), (3,)).astype(float)
        profile = None if profile is None else finite_array("profile", profile, (None, 2)).astype(float)
        if axis is not None and not np.any(axis):
            raise ValueError(f"the axis of a surface of revolution is a direction in 3-D that is not zero, not {axis}.")
        if profile is not None and not (np.diff(profile[:, 0]) > 0).all():
            raise ValueError("`profile` must be (k, 2): places along the axis, ascending, and radii.")
        for name, value in {"axis": axis, "origin": origin, "profile": profile}.items():
            object.__setattr__(self, name, value)


@dataclasses.dataclass(frozen=True, eq=False, init=False)
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
    on: Plane | Revolution | None

    def __init__(self, patch, on: Plane | Revolution | None = None):
        check_patch("patch", patch)
        if not (on is None or isinstance(on, Plane | Revolution)):
            raise ValueError(f"a patch slides on a jm.Plane, a jm.Revolution or its own faces (None), not {on!r}.")
        object.__setattr__(self, "patch", patch)
        object.__setattr__(self, "on", on)

    @property
    def name(self) -> str:
        return f"the sliding patch {self.patch!r}" if isinstance(self.patch, str) else "a sliding patch"


def walls_of_patch(
    slide: Slide,
    nodes: Int[np.ndarray, " k"],
    points: np.ndarray,
    faces: Mapping[str, np.ndarray] | None,
    moving: np.ndarray | Sequence[int] = (),
) -> Walls:
    """Makes walls: own faces are divided at sharp edges, and filled up below `moving` bodies."""
    exact, dimension = points.astype(float), points.shape[1]
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
            f"the plane of {slide.name} has {len(slide.on.normal)} components, the mesh {dimension} dimensions."
        )
    off = np.abs(np.asarray(wall.height(jnp.asarray(exact[nodes]))[0]))
    allowed = DEVIATION * np.ptp(exact[nodes], axis=0).max()
    wrong = nodes[worst_first(off, allowed)]
    if wrong.size:
        place = place_of(exact[wrong[0]])
        raise MeshError(
            f"{slide.name} does not lie on its surface: {len(wrong)} of {len(nodes)} nodes are off, the worst is node {{node}} at "
            f"({place}), {off.max():.3g} away (allowed {allowed:.3g}). Give the right surface, or None for the patch's faces.",
            wrong,
        )
    return [(wall, nodes)]


def _of_revolution(slide: Slide, on: Revolution, patch: np.ndarray) -> Round:
    dimension = patch.shape[1]
    if (on.axis is None) != (dimension == 2):
        raise ValueError(f"{slide.name}: a surface of revolution has an axis in 3-D, and none in 2-D.")
    origin = np.zeros(dimension) if on.origin is None else on.origin
    if origin.shape != (dimension,):
        raise ValueError(f"{slide.name}: `origin` has shape {origin.shape}; the mesh has {dimension} dimensions.")
    axis = np.zeros(dimension) if on.axis is None else on.axis / np.linalg.norm(on.axis)
    profile = on.profile
    if profile is None:
        line, profile = _line_or_profile(patch, axis, origin)
    else:
        line = None if len(profile) > 1 else np.array([0, 1, profile[0, 1]])
    if line is not None:
        return Round(axis, origin, line)
    from scipy.interpolate import CubicSpline  # here: it would take a tenth of the time of all imports

    spline = CubicSpline(*profile.T, bc_type="natural" if len(profile) > 2 else "not-a-knot")
    return Round(axis, origin, np.array([0.0, 1.0, 0.0]), spline.x, spline.c)


def _line_or_profile(patch: np.ndarray, axis: np.ndarray, origin: np.ndarray) -> tuple[np.ndarray | None, np.ndarray]:
    arm, size = patch - origin, np.ptp(patch, axis=0).max()
    along = arm @ axis
    profile = np.stack([along, np.linalg.norm(arm - along[:, None] * axis, axis=1)], axis=1)
    middle, normal, is_solid = profile.mean(axis=0), np.array([0.0, 1.0]), patch.shape[1] == 3
    if is_solid and np.ptp(profile) > 0 and np.ptp(profile[:, 1]) > 1e-9 * size:
        normal = np.linalg.svd(profile - middle, full_matrices=False)[2][-1]
    is_line = not is_solid or np.abs((profile - middle) @ normal).max() <= DEVIATION * size
    profile = profile[np.argsort(profile[:, 0], kind="stable")]
    profile = profile[np.append(True, np.diff(profile[:, 0]) > 1e-6 * size)]
    return np.array([*normal, middle @ normal]) if is_line else None, profile


def _of_faces(
    slide: Slide, nodes: np.ndarray, points: np.ndarray, faces: Mapping[str, np.ndarray] | None, moves: np.ndarray
) -> Walls:
    if faces is None:
        raise ValueError(
            f"{slide.name} slides on its faces, but points alone have no faces: pass the mesh with its cells, or a surface, "
            "jm.Slide(nodes, jm.Plane(normal, origin))."
        )
    dimension = points.shape[1]
    row = np.full(len(points), -1)
    row[nodes] = np.arange(len(nodes))
    pieces = [np.zeros((0, dimension), dtype=np.int64)]
    for corners in faces.values():
        # quads are cut into triangles about the node that comes first by place
        of_patch = in_order(row[corners][(row[corners] >= 0).all(axis=1)])
        pieces += [of_patch[:, [0, k, k + 1][:dimension]] for k in range(1, max(2, of_patch.shape[1] - 1))]
    elements = np.concatenate(pieces)
    if not len(elements):
        raise ValueError(f"{slide.name} holds no boundary faces of the mesh; name the surface that it slides on.")
    if not np.ptp(points[nodes], axis=0).max() > 0:
        place = place_of(points[nodes[0]])
        raise MeshError(f"all {len(nodes)} nodes of {slide.name} stand at ({place}): its faces have no extent.", nodes)
    elements = filled(elements, points[nodes], moves)
    flat = _flat(nodes, points, elements)
    return _parted(nodes, points, elements) if flat is None else [(flat, nodes)]


def _parted(nodes: np.ndarray, points: np.ndarray, elements: np.ndarray) -> Walls:
    """Makes a wall of each part of faces, rows of `nodes`, between sharp edges."""
    area = normals(points[nodes[elements]])
    size = np.linalg.norm(area, axis=1)
    has_area = size > 1e-14 * size.max()  # a quad that ends in a point has a triangle without area
    elements = elements[has_area].astype(np.int32)
    part = _smooth_parts(elements, area[has_area] / size[has_area, None])
    is_whole = part.max() == 0 or len(np.unique(elements)) < len(nodes)  # nodes of no face belong to all parts
    if is_whole:
        return [(Faceted(nodes, points[nodes], elements, faces_around(elements, len(nodes))), nodes)]
    walls = []
    for number in range(part.max() + 1):
        rows = np.unique(elements[part == number])
        corners, ids = np.searchsorted(rows, elements[part == number]).astype(np.int32), nodes[rows]
        flat = _flat(ids, points, corners)
        walls.append((flat or Faceted(ids, points[ids], corners, faces_around(corners, len(ids))), ids))
    return walls


def _flat(nodes: np.ndarray, points: np.ndarray, elements: np.ndarray) -> FlatFaces | None:
    try:
        plane = Plane.through(points, nodes)
    except ValueError:
        return None
    return FlatFaces(plane.normal, plane.origin, nodes, points[nodes], elements)


def _smooth_parts(elements: Int[np.ndarray, "e d"], normals: Float[np.ndarray, "e d"]) -> Int[np.ndarray, " e"]:
    """The parts of a patch between edges (2-D: corners) that turn by more than 60 degrees. Faces
    that fold back onto each other, the two sides of a thin plate, are one part.
    """
    ids = np.repeat(np.arange(len(elements)), elements.shape[1])
    touch = csr_array((np.ones(ids.size), (elements.ravel(), ids)))
    beside = (touch.T @ touch).tocoo()
    cosine = np.sum(normals[beside.row] * normals[beside.col], axis=1)
    joined = (cosine > CONTINUES - 1e-9) | (cosine < -SMOOTH)
    return parts_of(beside.row[joined], beside.col[joined], len(elements))


def with_own_curves(walls: Walls, mesh: Mesh | None) -> Walls:
    """Replaces the linear pieces of walls by the curved faces that they are pieces of. Walls whose
    faces are of two types, or that have faces across holes, keep their pieces.
    """
    if mesh is None or not mesh.is_curved:
        return walls
    return [(_curved(wall, mesh) if type(wall) is Faceted else wall, nodes) for wall, nodes in walls]


def _curved(wall: Faceted, mesh: Mesh) -> AbstractWall:
    cells = {kind: np.asarray(ids) for kind, ids in solid(mesh.cells, mesh.points.shape[1]).items()}
    nodes = np.asarray(wall.nodes)
    sides = {kind: ids for kind, ids in boundary_sides(cells, len(mesh.points), nodes).items() if len(ids)}
    pieces = sum(len(ids) * (2 if kind == "quad" else 1) for kind, ids in linear_cells(sides).items())
    if len(sides) != 1 or pieces != len(wall.faces):
        return wall
    ((kind, ids),) = sides.items()
    place = np.full(len(mesh.points), -1)
    place[nodes] = np.arange(len(nodes))
    rows = place[ids].astype(np.int32)
    rows = rows[np.lexsort(np.sort(rows, axis=1).T)]
    return CurvedFaces(wall.nodes, wall.vertices, wall.faces, faces_around(rows, len(nodes)), rows, kind)
