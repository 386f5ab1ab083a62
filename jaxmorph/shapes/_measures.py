"""Measures of walls for constraints: ids from the host, floats in the trace.

A wall in 2-D is a loop: ids (k,) of its nodes in order, counter-clockwise, without repeating the
first. A wall in 3-D is a set of triangles (k, 3) or quads (k, 4), outward from what they enclose.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._host.package.arguments import as_array, checked
from .._kernels.values import is_known, slack
from ._arguments import Numbers, positions, rows_of, vector
from ._walls import triangles_of


@checked
def area(x: Numbers, loop: Any) -> Float[Array, ""]:
    """Computes the area within a loop (2-D), positive where the loop runs counter-clockwise.

    **Arguments:**

    - `x`: positions (n, 2).
    - `loop`: ids (k,) of the loop's nodes in order, as `wall_loop` returns them.

    **Returns:** a number, in the square of the unit of `x`.

    **Raises:** `ValueError` for other shapes.
    """
    a, b = _segments(x, loop)
    return 0.5 * jnp.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


@checked
def centroid(x: Numbers, loop: Any) -> Float[Array, " 2"]:
    """Computes the centre of the area within a loop (2-D).

    **Arguments:** `x` and `loop` as in `area`.

    **Returns:** a position (2,).

    **Raises:** `ValueError` for other shapes.
    """
    x = positions(x)
    a, b = _segments(x, loop)
    origin = a[0]
    a, b = a - origin[None, :], b - origin[None, :]
    twice = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return origin + jnp.sum((a + b) * twice[:, None], axis=0) / (3 * jnp.sum(twice))


@checked
def volume(x: Numbers, faces: Any, plane: Numbers | None = None) -> Float[Array, ""]:
    """Computes the volume within faces (3-D), positive where they are outward.

    **Arguments:**

    - `x`: positions (n, 3).
    - `faces`: ids (k, 3) or (k, 4), one array or a list of them.
    - `plane`: a point (3,) of the plane that closes an open wall, such as a symmetry plane; None
      for a closed wall.

    **Returns:** a number, in the cube of the unit of `x`.

    **Raises:** `ValueError` for an open wall without a plane, and for a border that is not in one
    plane with the point.
    """
    x = positions(x)
    triangles = triangles_of(faces, x)
    origin = x[triangles[0, 0]] if plane is None else vector("plane", plane, x)
    _check_closed(x, triangles, None if plane is None else origin)
    a, b, c = (x[triangles[:, k]] - origin[None, :] for k in range(3))
    return jnp.sum(a * jnp.cross(b, c)) / 6


@checked
def chord(x: Numbers, nose: Any, tail: Any) -> Float[Array, ""]:
    """Computes the distance from nose to tail of an airfoil.

    **Arguments:**

    - `x`: positions (n, d).
    - `nose`, `tail`: a node, or several whose mean counts, as for a blunt tail.

    **Returns:** a number, in the unit of `x`.

    **Raises:** `ValueError` for nodes that are no rows of `x`.
    """
    x = positions(x)
    known = (rows_of(name, ids, len(x)) for name, ids in (("nose", nose), ("tail", tail)))
    ends = [jnp.mean(x[np.atleast_1d(ids)], axis=0) for ids in known]
    return jnp.linalg.norm(ends[1] - ends[0])


@checked
def curvature(x: Numbers, loop: Any) -> Float[Array, " k"]:
    """Computes the curvature at each node of a loop (2-D), positive where convex.

    It is the curvature of the circle through the node and its neighbours.

    **Arguments:** `x` and `loop` as in `area`.

    **Returns:** curvatures (k,), in the inverse unit of `x`.

    **Raises:** `ValueError` for other shapes.
    """
    x = positions(x)
    here, after = _segments(x, loop)
    before = jnp.roll(here, 1, axis=0)
    a, b, c = here - before, after - here, after - before
    lengths = jnp.sqrt(jnp.sum(a**2, axis=1) * jnp.sum(b**2, axis=1) * jnp.sum(c**2, axis=1))
    return 2 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / lengths


@checked
def leading_edge_radius(x: Numbers, loop: Any, tail: int, around: int = 4) -> Float[Array, ""]:
    """Computes the radius of the nose of an airfoil (2-D).

    The circle is closest to the node farthest from the tail and `around` nodes on each side of it.

    **Arguments:**

    - `x`: positions (n, 2).
    - `loop`: ids (k,) of the airfoil's nodes in order.
    - `tail`: a node of the trailing edge.
    - `around`: nodes on each side of the nose, 1 or more. Their circle is the osculating circle to
      second order in their spacing.

    **Returns:** a radius, in the unit of `x`.

    **Raises:** `ValueError` for a tail that is not in the loop, and for too many nodes.
    """
    x = positions(x)
    loop = rows_of("loop", loop, len(x))
    if loop.ndim != 1:
        raise ValueError(f"`loop` has shape {loop.shape}; expected the ids (k,) of the airfoil's nodes in order.")
    if tail not in loop or not 1 <= around < len(loop) // 2:
        raise ValueError(
            f"node {tail} must be in the loop, and {around} nodes on each side of its nose fit in {len(loop)}."
        )
    away = jnp.sum((x[loop] - x[tail][None, :]) ** 2, axis=1)
    farthest = jnp.argmax(away >= (1 - slack(x.dtype)) * away.max())  # of nodes as far the first in the loop
    order = (farthest + jnp.arange(-around, around + 1)) % len(loop)
    near = x[jnp.asarray(loop)[order]]
    centre = near[around]
    arms = near - centre[None, :]
    size = jax.lax.stop_gradient(jnp.sqrt(jnp.max(jnp.sum(arms**2, axis=1))))  # the result does not depend on it
    arms = arms / size
    # |p|^2 = 2 p . c + e: linear least squares for the centre c
    system = jnp.concatenate([2 * arms, jnp.ones((len(arms), 1), arms.dtype)], axis=1)
    solution = jnp.linalg.solve(system.T @ system, system.T @ jnp.sum(arms**2, axis=1))
    return size * jnp.sqrt(solution[0] ** 2 + solution[1] ** 2 + solution[2])


@checked
def trailing_edge_angle(x: Numbers, upper: Any, lower: Any) -> Float[Array, ""]:
    """Computes the angle in radians between the two sides at the trailing edge.

    **Arguments:**

    - `x`: positions (n, 2).
    - `upper`, `lower`: two nodes (ahead, at the edge) of each side.

    **Returns:** an angle in radians, 0 or more.

    **Raises:** `ValueError` for anything but two nodes.
    """
    x = positions(x)
    upper, lower = as_array("upper", upper), as_array("lower", lower)
    if upper.shape != (2,) or lower.shape != (2,):
        raise ValueError(f"`upper` is {upper}, `lower` {lower}; expected two nodes each, (ahead, at the edge).")
    known = (rows_of(name, ids, len(x)) for name, ids in (("upper", upper), ("lower", lower)))
    a, b = (x[ids[1]] - x[ids[0]] for ids in known)
    return jnp.abs(jnp.arctan2(a[0] * b[1] - a[1] * b[0], a @ b))


def _segments(x: Numbers, loop: Any) -> tuple[Float[Array, "k 2"], Float[Array, "k 2"]]:
    x, loop = positions(x), as_array("loop", loop)
    if x.shape[1] != 2 or loop.ndim != 1 or len(loop) < 3:
        raise ValueError(f"`x` has shape {x.shape} and `loop` {loop.shape}; expected (n, 2) and three nodes or more.")
    loop = rows_of("loop", loop, len(x))
    return x[loop], x[np.roll(loop, -1)]


def _check_closed(x: Float[Array, "n 3"], triangles: Int[np.ndarray, "k 3"], plane: Float[Array, " 3"] | None) -> None:
    """Raises `ValueError` for edges of only one triangle, unless a plane closes them."""
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    border = unique[count == 1]
    if not len(border):
        return
    if plane is None:
        raise ValueError(
            f"the wall is open: {len(border)} edges have one face, first {border[0].tolist()}. Give `plane`."
        )
    if is_known(x, plane):
        arms = np.asarray(x)[np.unique(border)] - np.asarray(plane)
        sizes = np.linalg.svd(arms, compute_uv=False)
        if len(sizes) == 3 and sizes[-1] > 1e-6 * sizes[0]:
            raise ValueError(
                f"the wall's border of {len(border)} edges does not lie in a plane through {np.asarray(plane)}."
            )
