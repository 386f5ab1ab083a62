"""The method that the command line asks for."""

import argparse
import dataclasses

import jax
import numpy as np
from jaxtyping import Float, Int

import jaxmorph as jm

SEARCHES = 24
"""Reductions tried to find one of about as many sources as asked for."""

LEAVES = 16
"""Leaves of the wall's k-d tree in the library's own choice."""


@dataclasses.dataclass(frozen=True)
class Choice:
    """A method (None: the library's own choice), what to call it, and how many sources it has on the moving patches."""

    method: jm.AbstractMethod | None
    name: str
    sources: int


def choose(method: str, sources: int | None, wall: np.ndarray) -> Choice:
    """The method asked for. `ValueError` for sources where they mean nothing."""
    if sources is not None and method != "paper":
        raise ValueError(f"--sources is for --method paper; {method} has no sources to choose.")
    if method == "rbf":
        full = jm.RBF(reduction=jm.AllPoints(), fixed_reduction=jm.AllPoints())
        return Choice(full, "full radial basis functions", len(wall))
    if method == "dgm":
        return Choice(jm.DelaunayGraph(), "Delaunay graph mapping", 0)
    if sources is None:
        count = len(jm.KDTree(LEAVES, extremes=True)(wall))
        return Choice(None, "reduced radial basis functions + graph", count)
    reduction = about(sources, wall)
    count = len(reduction(wall))
    name = f"reduced radial basis functions ({count} wall sources) + graph"
    return Choice(jm.SurfaceReconstruction(jm.FittedRBF(jm.RBF(reduction=reduction))), name, count)


def about(sources: int, wall: np.ndarray) -> jm.AbstractReduction:
    """The k-d tree whose number of leaves gives the number of sources closest to the one asked for."""
    d = wall.shape[1]
    if sources < d + 1:
        raise ValueError(f"--sources must be {d + 1} or more in {d}-D, found {sources}.")
    if sources >= len(wall):
        return jm.AllPoints()
    tried: dict[int, int] = {}
    low, high = 1, min(sources, len(wall))
    for _ in range(SEARCHES):
        leaves = (low + high) // 2
        tried[leaves] = len(jm.KDTree(leaves, extremes=True)(wall))
        low, high = (leaves + 1, high) if tried[leaves] < sources else (low, leaves - 1)
        if low > high:
            break
    best = min(tried, key=lambda leaves: (abs(tried[leaves] - sources), leaves))
    return jm.KDTree(best, extremes=True)


def prepare(
    arguments: argparse.Namespace,
    mesh: jm.Mesh,
    moving: list[str],
    method: jm.AbstractMethod | None,
    nodes: Int[np.ndarray, " c"] | None = None,
) -> jm.Plan:
    """The plan of the mesh, or of some of its nodes (ascending ids).

    An error names the symmetry patch that is not plane, and the patches left out that hold nodes outside of the hull.
    """
    planes = []
    for name in arguments.symmetry:
        try:
            planes.append(jm.Plane.through(mesh.points, mesh.patch(name)))
        except ValueError as error:
            raise ValueError(f"--symmetry {name}: {error}") from None
    nodes = np.arange(len(mesh.points)) if nodes is None else nodes
    points = np.asarray(mesh.points)[nodes].astype(arguments.dtype, copy=False)
    moves, stays = (np.searchsorted(nodes, mesh.patch(*names)) for names in (moving, arguments.fixed))
    try:
        return jm.prepare(points, moves, stays, method=method, symmetry=planes)
    except jm.MeshError as caught:
        error = caught.renumbered(nodes)
        left = [name for name in mesh.patches if name not in {*moving, *arguments.fixed, *arguments.symmetry}]
        left = [name for name in left if np.isin(error.nodes, mesh.patch(name)).any()]
        others = f" Patches there that neither move nor stay: {', '.join(left)}." if left else ""
        raise ValueError(f"{error}{others}") from None


def check_patches(arguments: argparse.Namespace, mesh: jm.Mesh, moving: list[str]) -> None:
    """`ValueError` for what can be known of the patches before any work."""
    known = ", ".join(mesh.patches) or "none"
    for option, names, do in (("--moving", moving, "move"), ("--fixed", arguments.fixed, "stay")):
        if not names:
            raise ValueError(f"{option} is missing: name the patches that {do}; this mesh has: {known}.")
        if not len(mesh.patch(*names)):
            raise ValueError(f"{option} {' '.join(names)}: there are no nodes in it.")
    for name in arguments.symmetry:
        mesh.patch(name)
    if getattr(arguments, "chunk", None) is not None and arguments.chunk < 1:
        raise ValueError(f"--chunk must be 1 or more, found {arguments.chunk}.")
    both = sorted(set(moving) & set(arguments.fixed))
    if both:
        raise ValueError(f"{', '.join(both)} cannot be both --moving and --fixed.")
    if not len(mesh.cells):
        raise ValueError(f"{arguments.file}: the mesh has no cells.")


def in_double(
    base: Float[np.ndarray, "n d"], plan: jm.Plan, moved: jax.Array | np.ndarray, u: Float[np.ndarray, "m d"]
) -> Float[np.ndarray, "n d"]:
    """Moved points in double precision: nodes that a plan in single precision leaves alone keep all their digits."""
    if moved.dtype == np.float64:
        return np.asarray(moved)
    nodes = np.asarray(plan.moving)
    points = base + (np.asarray(moved, float) - np.asarray(plan.points, float))
    if plan.method.exact:
        points[nodes] = base[nodes] + u
    return points
