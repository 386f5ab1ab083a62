"""Curving: wall nodes of a mesh of high order go onto a curved surface, the inside follows."""

from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Integer

from .._boundary.names import nodes_named
from .._boundary.outer_faces import outer_faces
from .._boundary.symmetry import Plane
from .._host.cells.lagrange import lagrange_types
from .._host.cells.topology import DIMENSION
from .._host.package.arguments import checked, finite_array, shown
from .._host.package.errors import MeshError, place_of, warn
from .._host.surface.gaps import closest
from .._mesh.mesh import Mesh
from .._methods.base import AbstractMethod
from .._plan.deform import deform
from .._plan.prepare import prepare
from .._quality.quality import quality

Surface = Mesh | Callable[[np.ndarray], Any] | Float[Any, "m d"]


@checked
def curve(
    mesh: Mesh,
    surface: Surface,
    moving: str | Sequence[str] | Integer[Any, " m"],
    fixed: str | Sequence[str] | Integer[Any, " f"] = (),
    *,
    method: AbstractMethod | None = None,
    symmetry: Plane | str | Sequence[Plane | str] = (),
) -> Mesh:
    """Puts the nodes of a wall onto a curved surface; the nodes between the boundaries follow.

    This makes a curved mesh of a straight one: `elevate` gives a mesh of linear cells the nodes.
    `quality` of the result, or `proof`, tells whether curved cells are valid.

    **Arguments:**

    - `mesh`: a mesh of order 2 to 4.
    - `surface`: where the wall is. A function takes the nodes (m, d) of the wall to their places on
      it (m, d). An array (m, d) has these places, in the order of `mesh.patch(moving)`. A `Mesh`
      finer than the wall has it as its cells of dimension d - 1, else as its whole boundary; nodes
      go to the nearest place on its linear faces.
    - `moving`: the patches of the wall, or node ids (m,).
    - `fixed`, `method`, `symmetry`: as `prepare` takes them.

    **Returns:** the mesh with other points; a warning tells of cells that were invalid before.
    **Raises:** `ValueError` for a mesh of linear cells alone, and places of another shape or not
    finite. Also for a surface farther from a node than the wall's face is long.
    """
    if not mesh.is_curved:
        raise ValueError(
            f"{mesh} has linear cells alone, which stay straight: `elevate(mesh, 2)` gives it nodes to curve."
        )
    nodes = nodes_named(moving, "moving", mesh, len(mesh.points))
    wall = np.asarray(mesh.points)[nodes]
    places = _places(surface, wall)
    _check_reach(mesh, nodes, places - wall)
    before = quality(mesh)
    if int(before.inverted):
        warn(f"{int(before.inverted)} of {before.count} cells are invalid before the wall is curved, and may stay so.")
    plan = prepare(mesh, nodes, fixed, method=method, symmetry=symmetry)
    return mesh.moved(deform(plan, jnp.asarray(places - wall)))


def _places(surface: Any, wall: np.ndarray) -> np.ndarray:
    if isinstance(surface, Mesh):
        return _nearest(surface, wall)
    if callable(surface):
        surface = surface(wall)
        if not hasattr(surface, "shape"):
            raise ValueError(f"`surface` gives {shown(surface)} for the nodes of the wall, not places {wall.shape}.")
    return finite_array("surface", surface, wall.shape)


def _nearest(surface: Mesh, wall: np.ndarray) -> np.ndarray:
    d, linear = wall.shape[1], surface.linear
    if surface.points.shape[1] != d:
        raise ValueError(f"`surface` has points in {surface.points.shape[1]}-D, the mesh in {d}-D.")
    faces = {kind: np.asarray(ids) for kind, ids in linear.cells.items() if DIMENSION[kind] == d - 1 and len(ids)}
    outer = None if faces else outer_faces(surface)
    faces = faces if outer is None else outer.corners
    cut = {"line": [[0, 1]], "triangle": [[0, 1, 2]], "quad": [[0, 1, 2], [0, 2, 3]]}
    simplices = [ids[:, rows] for kind, ids in faces.items() for rows in cut[kind]]
    if not sum(map(len, simplices)):
        raise ValueError(f"`surface` has no faces of {d - 1} dimensions, and no boundary: {surface}.")
    corners = np.asarray(surface.points, dtype=float)[np.concatenate(simplices)]
    simplex, weights, _ = closest(corners, wall)
    return np.einsum("mc,mcd->md", weights, corners[simplex])


def _check_reach(mesh: Mesh, nodes: np.ndarray, u: np.ndarray) -> None:
    """Raises `ValueError` for places farther from their nodes than faces there are long."""
    points, reach = np.asarray(mesh.points), np.zeros(len(mesh.points))
    outer = outer_faces(mesh)
    for ids in () if outer is None else outer.corners.values():
        extent = np.linalg.norm(np.ptp(points[ids], axis=1), axis=1)
        np.maximum.at(reach, ids.ravel(), np.repeat(extent, ids.shape[1]))
    order = max(lagrange_types()[kind].order for kind in mesh.cells)
    far = np.flatnonzero(np.linalg.norm(u, axis=1) > order * reach[nodes])
    if len(far):
        raise MeshError(
            f"{len(far)} of {len(nodes)} nodes of the wall are farther from the surface than its faces there are long, the first "
            f"is node {{node}} at ({place_of(points[nodes[far[0]]])}), {np.linalg.norm(u[far[0]]):.3g} away: is it the wall's?",
            nodes[far],
        )
