"""A mesh prepared some nodes at a time: memory holds the surface and one chunk, not all nodes."""

import warnings
from collections.abc import Iterator

import numpy as np
from jaxtyping import Int

from .._boundary.boundary import Boundary
from .._host.package.arguments import whole
from .._host.package.errors import MeshError
from .._methods.base import AbstractMethod, check_kind
from .halves import half_of
from .plan import Plan
from .prepare import between_planes, default_for, plan_of, refuse_cells


def prepare_in_chunks(
    boundary: Boundary, *, size: int | None = None, method: AbstractMethod | None = None
) -> Iterator[tuple[Int[np.ndarray, " c"], Plan]]:
    """Yields the nodes (c,) and the plan of every chunk of a mesh, one chunk after the other.

    The surface is prepared once, and chunks are attached to it. Points move as with a plan of the
    whole mesh.

    ```python
    points = np.array(mesh.points)
    for nodes, plan in jm.prepare_in_chunks(jm.Boundary(mesh, "wing", "far"), size=1_000_000):
        points[nodes] = jm.deform(plan, u)
    ```

    Nodes of no cell, which stay, are in no chunk of a `size`.

    **Arguments:**

    - `boundary`: the mesh's boundary.
    - `size`: most inner nodes of a chunk, beside all nodes of the surface. None makes one chunk.
    - `method`: `SurfaceReconstruction()` by default.

    **Raises:** `ValueError` for a size below 1, and where `prepare` does. With a size, also for a
    method that solves on cells. A wrong point raises with its chunk; a `MeshError` names nodes of
    the whole mesh.
    """
    check_kind(boundary, Boundary, "boundary", 'jm.Boundary(mesh, "wall", "far")')
    check_kind(method, AbstractMethod, "method", "jm.RBF()", optional=True)
    if size is not None:
        whole("size", size)
        if method is not None:
            refuse_cells(method)
    return _chunks(boundary, method, size)


def _chunks(
    boundary: Boundary, method: AbstractMethod | None, size: int | None
) -> Iterator[tuple[Int[np.ndarray, " c"], Plan]]:
    # A chunk of k has the surface and every k-th other node. A chunk that is one node short takes
    # the first other node again: so all chunks have one length and share compiled code.
    points = boundary.points
    if size is None:
        yield np.arange(len(points)), plan_of(boundary, method)
        return
    method = default_for(boundary) if method is None else method
    boundary = between_planes(boundary, method)
    half, surface = half_of(boundary, method, np.arange(len(points))), np.unique(boundary.nodes)
    others = np.setdiff1d(np.arange(len(points)), np.union1d(surface, boundary.loose), assume_unique=True)
    count = max(1, -(-len(others) // size))
    steps = count * np.arange(-(-len(others) // count))
    for k in range(count):
        nodes = np.sort(np.concatenate([surface, others[(k + steps) % max(1, len(others))]]))
        with warnings.catch_warnings():
            if k > 0:
                warnings.simplefilter("ignore")  # about the surface: they came with the first chunk
            try:
                plan = half.attach(points[nodes], nodes)
            except MeshError as error:
                raise error.renumbered(nodes) from None
        yield nodes, plan
