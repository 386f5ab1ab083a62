"""Checks of a surface displacement before the mesh is moved."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import ArrayLike, Integer, Real

from .._host.package.arguments import checked, rows_of
from .._host.package.cores import Beside
from .._host.package.errors import MeshError
from .._host.package.trees import Tree
from .._host.surface.gaps import share_left
from .._host.surface.skin import edges
from .._host.surface.walls import walls
from .._mesh.mesh import Mesh
from .._methods.rbf.fitted import FittedRBF
from .._plan.deform import deform
from .._plan.judge import ended
from .._plan.plan import Plan
from .._quality.quality import quality
from .collisions import crossings, names_of, simplices
from .cures import advice_on_folds
from .inspection import Inspection
from .overshoot import overshoot
from .resolved import UNRESOLVED, leaves_enough, missed
from .torn import share_faces, torn_pairs

PUT_BACK = 0.01
"""Share of the largest motion by which planes, surfaces and pairs may change a moving node's."""

TOUCHING = 1e-9
"""Distance of a node from another wall, relative to the surface's extent: no gap there."""


@checked
def inspect(
    plan: Plan,
    u: Real[ArrayLike, "m d"] | Sequence[Any],
    *,
    mesh: Mesh | None = None,
    nodes: Integer[ArrayLike, " n"] | None = None,
) -> Inspection:
    """Checks a surface displacement on the host, and the motion that the mesh would make.

    Two neighbouring surface nodes contradict each other in two cases. One moves, the other is
    fixed, and the displacement is larger than their distance: a wall slides along a fixed boundary.
    Or both move, and their distance more than doubles. No method moves such a mesh well.

    With the mesh, it measures how much is left of the gaps between walls: the distance of nodes to
    the faces of other walls. It also finds moved walls that cross another boundary or themselves.
    Faces that crossed before do not count, nor do faces that share a node or touch in coincident
    nodes, as at a sharp trailing edge. Faces with a node that is neither moving nor fixed are left
    out: where they go is not known yet. If one step folds cells, it tries what may help: round
    walls that slide, 2, 4 and 8 steps, methods on cells.

    **Arguments:**

    - `plan`: what `prepare` returned.
    - `u`: displacements (m, d) of the moving nodes, in the mesh's unit.
    - `mesh`: the mesh that the plan was made for. Default: none.
    - `nodes`: the mesh's ids of the plan's points, where the plan is of a part of it
      (`prepare_in_chunks`). Default: all.

    **Returns:** an `Inspection`, which names nodes of the mesh.

    **Raises:** `ValueError` when the shape of `u` is not (m, d), or a component is not finite, or
    the mesh has another number of points than the plan.
    """
    if mesh is None or nodes is not None:
        return inspected(plan, u, mesh, nodes)
    moved = np.asarray(deform(plan, u))
    inspection = inspected(plan, u, mesh, nodes, moved)
    count = int(quality(mesh, moved).inverted)
    if not count:
        return inspection
    return dataclasses.replace(inspection, folds=advice_on_folds(plan, mesh, np.asarray(u, dtype=float), count))


def inspected(plan: Plan, u: Any, mesh: Mesh | None, nodes: Any, moved: np.ndarray | None = None) -> Inspection:
    """Checks a displacement as `inspect` does; `moved` (n, d) is its `deform`, where known."""
    plan.check_surface("inspect")
    if nodes is None and mesh is not None and tuple(mesh.points.shape) != tuple(plan.points.shape):
        raise ValueError(
            f"`mesh` has points of shape {tuple(mesh.points.shape)}; this plan was made for {tuple(plan.points.shape)}."
        )
    ids = (
        np.arange(len(plan.points))
        if nodes is None
        else rows_of("nodes", nodes, 2**62 if mesh is None else len(mesh.points))
    )
    if len(ids) != len(plan.points):
        raise ValueError(f"`nodes` has {len(ids)} ids; this plan has {len(plan.points)} points.")
    surface, vectors = np.asarray(plan.surface_nodes), np.asarray(plan.of_surface(u))
    _check_finite(u, surface[: plan.n_moving])
    looking = None
    if mesh is not None:
        looking = Beside(_of_faces, mesh, ids[surface], vectors.astype(float), plan.n_moving)
    inspection = _of_plan(plan, u, vectors, moved)
    inspection = inspection if nodes is None else inspection.renumbered(ids)
    if mesh is None or looking is None:
        return inspection
    faces, found = looking.result()
    touches, torn = inspection.touches, inspection.contradictions
    if faces is not None and inspection.rests.any():
        rows = np.zeros(len(mesh.points), dtype=np.int64)
        rows[ids[surface]] = np.arange(len(surface))
        touches = inspection.rests & share_faces(rows[torn], faces, len(surface))
    names = tuple(names_of(mesh, torn[0][:, None])) if len(torn) else ()
    return dataclasses.replace(inspection, torn=names, touches=touches, **found)


def _of_faces(
    mesh: Mesh, nodes: np.ndarray, vectors: np.ndarray, moving: int
) -> tuple[np.ndarray | None, dict[str, Any]]:
    """Checks what needs faces: the faces' simplices, and what is found of them, by field.

    The mesh's `nodes` (o,) move by `vectors` (o, d); the caller gave the first `moving` vectors.
    """
    cut, left, node = simplices(mesh, nodes), None, None
    if cut is None:
        return None, {}
    if len(cut[0]):
        before = np.asarray(mesh.points, dtype=float)[nodes]
        wall = walls(before, moving, {"simplex": cut[0]})
        share = share_left(before, before + vectors, wall, cut[0], TOUCHING * np.ptp(before, axis=0).max())
        if np.isfinite(share).any():
            left, node = float(share.min()), int(nodes[share.argmin()])
    return cut[0], {"crossings": crossings(cut, mesh, nodes, vectors), "gap_left": left, "gap_node": node}


def _of_plan(plan: Plan, u: Any, vectors: np.ndarray, moved: np.ndarray | None) -> Inspection:
    """Checks all that needs no faces, of displacements `vectors` (o, d) of the surface."""
    offset = np.linalg.norm(np.asarray(plan.offset(u)), axis=1)
    points, nodes = np.asarray(plan.points), np.asarray(plan.surface_nodes)
    displacement = np.asarray(u, dtype=float)
    is_fixed = np.isin(nodes, plan.fixed)
    tree = Tree(points, leafsize=32, balanced_tree=False, compact_nodes=False)
    size = np.asarray(tree.query(points[nodes], k=2)[0])[:, 1]
    worst = int(offset.argmax())
    pairs = torn_pairs(points[nodes], vectors, is_fixed)
    torn, rests = nodes[pairs].reshape(-1, 2), np.asarray(is_fixed[pairs].any(axis=1))
    ratio = float((offset / np.where(size > 0, size, np.inf)).max())
    anywhere, behind = overshoot(plan, displacement, moved)
    changed = np.linalg.norm(vectors[: plan.n_moving] - displacement, axis=1)
    back = np.flatnonzero(changed > PUT_BACK * np.linalg.norm(displacement, axis=1).max())
    places = points[nodes] + vectors
    rows = ended(plan, places)
    base = points[nodes[: plan.n_moving]]
    too_few = _missed(plan, nodes[: plan.n_moving], displacement)
    return Inspection(
        offset=float(offset[worst]),
        offset_node=int(nodes[worst]),
        offset_ratio=ratio,
        contradictions=torn,
        near=points[torn[0, 0]] if len(torn) else np.full(points.shape[1], np.nan),
        overshoot=anywhere,
        overshoot_behind=behind,
        slope=_slope(base, vectors[: plan.n_moving]),
        is_fitted=isinstance(getattr(plan.method, "coarse", None), FittedRBF),
        put_back=nodes[back[np.argsort(-changed[back], kind="stable")]],
        put_back_by=float(changed.max()) if len(back) else 0.0,
        ended=nodes[rows],
        ended_at=places[rows],
        largest=float(np.linalg.norm(displacement, axis=1).max()),
        reach=plan.reach,
        rests=rests,
        touches=rests,
        missed=too_few,
        leaves=leaves_enough(base, displacement) if too_few > UNRESOLVED else None,
    )


def _check_finite(u: Any, nodes: np.ndarray) -> None:
    """Raises `ValueError` for displacements of moving `nodes` (m,) that are not finite."""
    finite = np.isfinite(np.asarray(u)).all(axis=1)
    if not finite.all():
        row = int(np.argmin(finite))
        raise MeshError(
            f"{(~finite).sum()} of {len(nodes)} displacements are not finite, first that of node {{node}} (row {row}).",
            nodes[~finite],
        )


def _missed(plan: Plan, nodes: np.ndarray, displacement: np.ndarray) -> float:
    """Measures, in 3-D, the part of a displacement of `nodes` (m,) that the sources miss."""
    rows = np.flatnonzero(np.isin(nodes, plan.sources))
    return (
        missed(np.asarray(plan.points)[nodes], displacement, rows) if plan.points.shape[1] == 3 and len(rows) else 0.0
    )


def _slope(points: np.ndarray, u: np.ndarray) -> float:
    """Measures how steeply `u` changes along the edges of a wall, without its affine part."""
    pairs = edges(points, len(points))
    if not len(pairs):
        return 0.0
    terms = np.column_stack([np.ones(len(points)), points - points.mean(axis=0)])
    first, second = pairs.T
    rest = u - terms @ np.linalg.lstsq(terms, u, rcond=None)[0]
    distance, length = (np.linalg.norm(positions[second] - positions[first], axis=1) for positions in (rest, points))
    return float(np.quantile(distance / length, 0.98))
