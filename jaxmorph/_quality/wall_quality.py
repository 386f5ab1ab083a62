"""Measures of the first grid line off a wall, per wall node."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._host.cells.first_lines import Lines, first_lines
from .._host.package.arguments import between, checked, rows_of
from .._kernels.compile import by_place
from .._kernels.module import Module
from .._kernels.values import Either, as_jax, is_known, largest, namespace, smallest
from .._mesh.mesh import Mesh
from .quality import places
from .vector import Points, Vector, angle, cross_product, dot, unit_of

Heights = Float[Either, " w"]


class WallQuality(Module):
    """Result of `wall_quality` at w wall nodes: arrays (w,).

    - `nodes`: their ids, ascending, without nodes from which no edge leaves the wall.
    - `angle`: degrees by which the first grid line has left its own angle to the wall; 0 on the
      undeformed mesh.
    - `height`: distance from the wall at which that line ends, along the wall's normal, over the
      undeformed one: 1 there, negative where the line points out of the mesh.
    """

    nodes: Int[Array, " w"]
    angle: Float[Array, " w"]
    height: Float[Array, " w"]

    @property
    def mean_angle(self) -> Array:
        return jnp.mean(self.angle, axis=-1)

    @property
    def max_angle(self) -> Array:
        return largest(self.angle, axis=-1)

    @property
    def min_height(self) -> Array:
        return smallest(self.height, axis=-1)

    @property
    def max_height(self) -> Array:
        return largest(self.height, axis=-1)

    def __str__(self) -> str:
        angle = f"{float(self.mean_angle):.3g} (mean), {float(self.max_angle):.3g} (max)"
        height = self.height
        return (
            f"{len(self.nodes)} wall nodes: first grid line {angle} degrees off its own angle to "
            "the wall; "
            f"first cell {float(height.min()):.3g} to {float(height.max()):.3g} of its height"
        )


@checked
def wall_quality(
    mesh: Mesh,
    wall: str | Sequence[str] | Int[Any, " k"],
    points: Float[Any, "n d"] | None = None,
    *,
    softness: float | None = None,
) -> WallQuality:
    """Measures wall orthogonality and first-cell height relative to the undeformed mesh.

    The area-weighted mean of skewness hides both. The first grid line of a wall node is the edge
    that leaves the wall most nearly along its normal on the undeformed mesh. The wall's normal at a
    node is that of the faces around it, weighted by their area. In 3-D a neighbour on the wall says
    how the wall turns about the normal. Traced over `points`. The ids are found on the host at each
    call: close over the mesh. Of curved cells all nodes of the wall count. The normal is that of
    the sides' own polynomials at the node. The first grid line goes through the whole cell: its
    angle is that of its tangent at the wall, its height that of its other end.

    **Arguments:**

    - `mesh`: the undeformed mesh with its cells.
    - `wall`: a patch, several patches, or node ids (k,).
    - `points`: where the nodes are now (n, d), in the unit of `mesh.points`. Default `mesh.points`.
    - `softness`: in degrees. `angle` has a kink where it is zero; sqrt(angle^2 + softness^2) -
      softness takes its place, smooth and less by `softness` at most. Default None: none. `height`
      has no kink.

    **Raises:** `ValueError` for an unknown patch, ids out of range, nodes that hold no side of a
    cell on the boundary, a mesh without cells, and another shape of `points`.
    """
    current = places(mesh, points)
    if softness is not None and is_known(softness):
        between("softness", softness, 0)
    names = (wall,) if isinstance(wall, str) else wall
    has_names = (
        np.ndim(names) == 1 and len(names) > 0 and all(isinstance(name, str) for name in names)
    )
    ids = mesh.patch(*names) if has_names else rows_of("wall", wall, len(mesh.points))
    cells = jax.tree.map(np.asarray, mesh.cells)
    lines = first_lines(cells, mesh.topology.outer(ids), np.asarray(mesh.points), ids)
    with jax.ensure_compile_time_eval():
        reference = jnp.asarray(mesh.points, dtype=current.dtype)
    return WallQuality(*as_jax((lines.nodes, *_measure_lines(lines, reference, current, softness))))


@by_place
def _measure_lines(
    lines: Lines, reference: Points, points: Points, softness: Any
) -> tuple[Heights, Heights]:
    xp = namespace(points)
    (start, high), (now, height) = (_components(lines, x) for x in (reference, points))
    degrees = xp.rad2deg(angle(start, now))
    if softness is not None:
        degrees = xp.sqrt(degrees**2 + softness**2) - softness
    return degrees, xp.where(high == 0, 1, height / xp.where(high == 0, 1, high))


def _components(lines: Lines, x: Points) -> tuple[Vector, Heights]:
    xp = namespace(x)
    areas = xp.zeros((len(lines.nodes), x.shape[1]), x.dtype)
    for rows, area in lines.areas(x):
        if xp is np:
            np.add.at(areas, rows[rows < len(areas)], area[rows < len(areas)])
        else:
            areas = areas.at[rows].add(area, mode="drop")
    normal = unit_of(Vector(areas.T))
    line = Vector(lines.directions(x).T)
    height = dot(normal, Vector((x[lines.ends] - x[lines.nodes]).T))
    if len(normal) == 2:
        return Vector([dot(normal, line), *cross_product(normal, line)]), height
    beside = Vector((x[lines.beside] - x[lines.nodes]).T)
    tangent = unit_of(beside - normal * dot(beside, normal))
    return Vector(
        dot(axis, line) for axis in (normal, tangent, cross_product(normal, tangent))
    ), height
