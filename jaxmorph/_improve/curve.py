"""Curving: wall nodes of a mesh of high order go onto a curved surface, the inside follows."""

from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Integer

from .._boundary.facets import Facets
from .._boundary.names import nodes_named
from .._boundary.symmetry import Plane
from .._host.cells.lagrange import lagrange_types
from .._host.linear.products import row_lengths
from .._host.package.arguments import checked, finite_array, shown
from .._host.package.errors import check_none, warn, worst_first
from .._mesh.mesh import Mesh
from .._methods.base import AbstractMethod
from .._plan.deform import deform
from .._plan.prepare import prepare
from .._quality.quality import quality


@checked
def curve(
    mesh: Mesh,
    surface: Mesh | Callable[[np.ndarray], Any] | Float[Any, "m d"],
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
            f"{mesh} has linear cells alone, which stay straight: `elevate(mesh, 2)` gives it "
            "nodes to curve."
        )
    nodes = nodes_named(moving, "moving", mesh, len(mesh.points))
    wall = np.asarray(mesh.points)[nodes]
    places = _places_on(surface, wall)
    _check_reach(mesh, nodes, places - wall)
    before = quality(mesh)
    if int(before.inverted):
        warn(
            f"{int(before.inverted)} of {before.count} cells are invalid before the wall is "
            "curved, and may stay so."
        )
    plan = prepare(mesh, nodes, fixed, method=method, symmetry=symmetry)
    return mesh.moved(deform(plan, jnp.asarray(places - wall)))


def _places_on(surface: Any, wall: np.ndarray) -> np.ndarray:
    if isinstance(surface, Mesh):
        return np.asarray(Facets.of(surface).closest(wall))
    if callable(surface):
        surface = surface(wall)
        if not hasattr(surface, "shape"):
            raise ValueError(
                f"`surface` gives {shown(surface)} for the nodes of the wall, not places "
                f"{wall.shape}."
            )
    return finite_array("surface", surface, wall.shape)


def _check_reach(mesh: Mesh, nodes: np.ndarray, u: np.ndarray) -> None:
    """Raises `ValueError` for places farther from their nodes than faces there are long."""
    points = np.asarray(mesh.points)
    reach = np.zeros(len(mesh.points))
    outer = mesh.outer_faces
    for ids in () if outer is None else outer.corners.values():
        extent = row_lengths(np.ptp(points[ids], axis=1))
        np.maximum.at(reach, ids.ravel(), np.repeat(extent, ids.shape[1]))
    order = max(lagrange_types()[kind].order for kind in mesh.cells)
    away = row_lengths(u)
    check_none(
        nodes[worst_first(away, order * reach[nodes])],
        f"{{count}} of {len(nodes)} nodes of the wall are farther from the surface than its faces "
        "there are long, the worst is "
        f"node {{node}} at ({{place}}), {away.max():.3g} away: is it the wall's?",
        points,
    )
