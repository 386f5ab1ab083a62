"""Checks of a surface displacement before the mesh is moved."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import ArrayLike, Float, Integer, Real
from scipy import sparse
from scipy.spatial.distance import cdist

from .._boundary.outer_faces import outer_faces
from .._host.cells.adjacency import parts_of
from .._host.package.arguments import checked, finite_array, rows_of
from .._host.package.cores import Beside
from .._host.package.errors import MeshError
from .._host.package.rounding import Tree, roundoff
from .._host.sources.reduction import KDTree, drop_close
from .._host.surface.gaps import crossing_faces, share_left
from .._host.surface.skin import edges
from .._host.surface.walls import walls
from .._mesh.mesh import Mesh
from .._methods.rbf.fitted import FittedRBF
from .._plan.deform import deform
from .._plan.judge import ended
from .._plan.plan import Plan
from .._quality.quality import quality
from .cures import advice_on_folds
from .inspection import Crossings, Inspection

PUT_BACK = 0.01  # share of the largest motion by which planes, surfaces and pairs may change a moving node's
TOUCHING = 1e-9  # distance of a node from another wall, relative to the surface's extent: no gap there
SAME = 1e-9  # distance of nodes at one place, relative to the extent: two sides of a cut or of a sharp edge
RESTS = 1e-3  # share of the largest displacement below which a part of the surface rests
UNRESOLVED = 1 / 3  # share of the largest displacement that sources may miss between them
ROWS = 4096  # points in a block of distances from all sources
LEAVES = (64, 128, 256, 512, 1024, 2048)  # numbers of leaves of a k-d tree that are tried


@checked
def inspect(
    plan: Plan,
    u: Real[ArrayLike, "m d"] | Sequence[Any],
    *,
    mesh: Mesh | None = None,
    nodes: Integer[ArrayLike, " n"] | None = None,
    moved: Float[ArrayLike, "n d"] | None = None,
) -> Inspection:
    """Checks a surface displacement on the host, and the motion that the mesh would make.

    Two neighbouring surface nodes contradict each other in two cases. One moves, the other is
    fixed, and the displacement is larger than their distance: a wall slides along a fixed boundary.
    Or both move, and their distance more than doubles. No method moves such a mesh well. With the
    mesh, it measures how much is left of gaps between walls, and finds moved walls that cross
    another boundary or themselves. Faces that crossed before do not count, nor do faces that share
    a node or touch in coincident nodes, as at a sharp trailing edge. Faces with a node that is
    neither moving nor fixed are left out. If one step folds cells, it tries cures: round walls that
    slide, 2, 4 and 8 steps, methods on cells.

    **Arguments:**

    - `plan`: from `prepare`.
    - `u`: displacements (m, d) of the moving nodes, in the mesh's unit.
    - `mesh`: the mesh that the plan was made for. Default: none.
    - `nodes`: the mesh's ids of the plan's points, where the plan is of a part of it
      (`prepare_in_chunks`). Default: all. No cures are tried for a part.
    - `moved`: what `deform(plan, u)` returned, where it is at hand. Default: computed where needed.

    **Returns:** an `Inspection`, which names nodes of the mesh. **Raises:** `ValueError` for a `u`
    that is not (m, d) or not finite, and for a mesh with another number of points than the plan.
    """
    if moved is not None:
        moved = finite_array("moved", moved, plan.points.shape)
    if mesh is None or nodes is not None:
        return _inspected(plan, u, mesh, nodes, moved)
    moved = np.asarray(deform(plan, u)) if moved is None else moved
    inspection = _inspected(plan, u, mesh, nodes, moved)
    count = int(quality(mesh, moved).inverted)
    if not count:
        return inspection
    return dataclasses.replace(inspection, folds=advice_on_folds(plan, mesh, np.asarray(u, dtype=float), count))


def _inspected(plan: Plan, u: Any, mesh: Mesh | None, nodes: Any, moved: np.ndarray | None = None) -> Inspection:
    plan.check_surface("inspect")
    if nodes is None and mesh is not None:
        plan.check_mesh(mesh)
    count = len(plan.points)
    most = 2**62 if mesh is None else len(mesh.points)
    ids = rows_of("nodes", np.arange(count) if nodes is None else nodes, most)
    if len(ids) != count:
        raise ValueError(f"`nodes` has {len(ids)} ids; this plan has {count} points.")
    surface, vectors = np.asarray(plan.surface_nodes), np.asarray(plan.of_surface(u))
    _check_finite(u, surface[: plan.n_moving])
    if mesh is None:
        return _of_plan(plan, u, vectors, moved).renumbered(ids)
    looking = Beside(_of_faces, mesh, ids[surface], vectors.astype(float), plan.n_moving)
    inspection = _of_plan(plan, u, vectors, moved).renumbered(ids)
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
    """Checks what needs faces: the faces' simplices, and the findings, by field. The mesh's `nodes`
    (o,) move by `vectors` (o, d); the caller gave the first `moving` vectors.
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
    points, nodes, displacement = np.asarray(plan.points), np.asarray(plan.surface_nodes), np.asarray(u, dtype=float)
    moving, surface, is_fixed = nodes[: plan.n_moving], points[nodes], np.isin(nodes, plan.fixed)
    offset, size = np.linalg.norm(np.asarray(plan.offset(u)), axis=1), np.linalg.norm(displacement, axis=1)
    tree = Tree(points, leafsize=32, balanced_tree=False, compact_nodes=False)
    spacing = np.asarray(tree.query(surface, k=2)[0])[:, 1]
    pairs = torn_pairs(surface, vectors, is_fixed)
    torn, rests = nodes[pairs].reshape(-1, 2), np.asarray(is_fixed[pairs].any(axis=1))
    anywhere, behind = overshoot(plan, displacement, moved)
    changed = np.linalg.norm(vectors[: plan.n_moving] - displacement, axis=1)
    back = np.flatnonzero(changed > PUT_BACK * size.max())
    rows, sources = ended(plan, surface + vectors), np.flatnonzero(np.isin(moving, plan.sources))
    too_few = missed(points[moving], displacement, sources) if points.shape[1] == 3 and len(sources) else 0.0
    return Inspection(
        offset=float(offset.max()),
        offset_node=int(nodes[offset.argmax()]),
        offset_ratio=float((offset / np.where(spacing > 0, spacing, np.inf)).max()),
        contradictions=torn,
        near=points[torn[0, 0]] if len(torn) else np.full(points.shape[1], np.nan),
        overshoot=anywhere,
        overshoot_behind=behind,
        slope=_slope(points[moving], vectors[: plan.n_moving]),
        is_fitted=isinstance(getattr(plan.method, "coarse", None), FittedRBF),
        put_back=nodes[back[np.argsort(-changed[back], kind="stable")]],
        put_back_by=float(changed.max()) if len(back) else 0.0,
        ended=nodes[rows],
        ended_at=(surface + vectors)[rows],
        largest=float(size.max()),
        reach=plan.reach,
        rests=rests,
        touches=rests,
        missed=too_few,
        leaves=leaves_enough(points[moving], displacement) if too_few > UNRESOLVED else None,
    )


def _check_finite(u: Any, nodes: np.ndarray) -> None:
    finite = np.isfinite(np.asarray(u)).all(axis=1)
    if not finite.all():
        row = int(np.argmin(finite))
        raise MeshError(
            f"{(~finite).sum()} of {len(nodes)} displacements are not finite, first that of node {{node}} (row {row}).",
            nodes[~finite],
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


def torn_pairs(points: np.ndarray, vectors: np.ndarray, is_fixed: np.ndarray) -> np.ndarray:
    count = min(2 * points.shape[1], len(points) - 1)
    distance, nearest = map(np.asarray, Tree(points).query(points, k=count + 1))
    first, second = np.repeat(np.arange(len(points)), count), nearest[:, 1:].ravel()
    distance = distance[:, 1:].ravel()
    difference = np.linalg.norm((vectors[first] - vectors[second]), axis=1)
    after = np.linalg.norm((points + vectors)[first] - (points + vectors)[second], axis=1)
    mixed = is_fixed[first] != is_fixed[second]
    scale = SAME * np.ptp(points, axis=0).max()
    excess = np.where(mixed, difference, after - distance) / (distance + scale)
    torn = np.flatnonzero((excess > 1) & (distance > scale) & (first < second))
    return np.stack([first, second], axis=1)[torn[np.argsort(-excess[torn], kind="stable")]]


def share_faces(pairs: np.ndarray, faces: np.ndarray, count: int) -> np.ndarray:
    """Marks pairs (k, 2) of rows on one of `faces` (f, corners), or on two that share a node."""
    corners = np.repeat(np.arange(len(faces)), faces.shape[1])
    entries = np.ones(faces.size, dtype=np.int64), (faces.ravel(), corners)
    holds = sparse.csr_matrix(entries, shape=(count, len(faces)))
    around = holds @ holds.T  # neighbours of each row, and itself
    return np.asarray(around[pairs[:, 0]].multiply(around[pairs[:, 1]]).sum(axis=1)).ravel() > 0


def crossings(cut: tuple[np.ndarray, np.ndarray], mesh: Mesh, nodes: np.ndarray, vectors: np.ndarray) -> Crossings:
    """Finds where `nodes` (o,), moved by `vectors` (o, d), make the boundary `cut` cross itself."""
    (faces, ids), points = cut, np.asarray(mesh.points, dtype=float)
    before = points[nodes]
    close = Tree(before).query_pairs(SAME * np.ptp(points, axis=0).max(), output_type="ndarray")
    place = parts_of(close[:, 0], close[:, 1], len(before))  # nodes that nearly coincide are at one place
    pairs, places = crossing_faces(before, before + vectors, faces, place)
    single = np.sort(np.unique(np.sort(ids[pairs], axis=1), axis=0, return_index=True)[1])
    pairs, places = pairs[single], places[single]
    first, second = (names_of(mesh, nodes[faces[pairs[:, k]]]) for k in range(2))
    return Crossings(nodes[faces[pairs, 0]], tuple(zip(first, second, strict=True)), places)


def simplices(mesh: Mesh, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Cuts the boundary faces between `nodes` (o,) into simplices (f, d), rows of `nodes`, seen
    from outside; None without faces. Also returns the number (f,) of the file's face of each.
    """
    outer = outer_faces(mesh)
    if outer is None:
        return None
    rows = np.full(len(mesh.points), -1)
    rows[nodes] = np.arange(len(nodes))
    parts = []
    for kind, corners in outer.corners.items():
        triangles = ([0, 1, 2], [0, 2, 3]) if corners.shape[1] == 4 else ([*range(corners.shape[1])],)
        parts += [(rows[corners[:, triangle]], outer.ids[kind]) for triangle in triangles]
    faces, ids = (np.concatenate(part) for part in zip(*parts, strict=True))
    known = (faces >= 0).all(axis=1)
    return faces[known], ids[known]


def names_of(mesh: Mesh, faces: np.ndarray) -> list[str]:
    """Names the smallest patch with all nodes of each face (k, corners); "" without any."""
    names = np.full(len(faces), "", dtype=object)
    for name, nodes in sorted(mesh.patches.items(), key=lambda item: -len(item[1])):
        inside = np.zeros(len(mesh.points), dtype=bool)
        inside[np.asarray(nodes)] = True
        names[inside[faces].all(axis=1)] = name
    return names.tolist()


def overshoot(
    plan: Plan, u: Float[np.ndarray, "m d"], moved: Float[np.ndarray, "n d"] | None = None
) -> tuple[float, float]:
    """Compares the largest motion off the surface with that of the surface; also behind what rests.

    A node lies behind a part that rests if three conditions hold. The nearest node of the moving
    surface rests. The part that moves lies on the other side of this node, as the upper side of an
    airfoil does for nodes below it. And the node is no farther away than the surface is long.
    `moved` is what `deform` returns, where it is known.
    """
    points, moving = np.asarray(plan.points), np.asarray(plan.moving)
    size = np.linalg.norm(u, axis=1)
    is_inner = np.ones(len(points), dtype=bool)
    is_inner[moving] = is_inner[np.asarray(plan.fixed)] = False
    inner = np.flatnonzero(is_inner)
    if not size.max() or not inner.size:
        return 0.0, 0.0
    moved = np.asarray(deform(plan, u)) if moved is None else moved
    share = np.linalg.norm((moved - points)[inner], axis=1) / size.max()
    largest, base, active = float(share.max()), points[moving], np.flatnonzero(size > size.max() / 2)
    extent = np.ptp(base, axis=0).max()
    is_near = ((points[inner] > base.min(axis=0) - extent) & (points[inner] < base.max(axis=0) + extent)).all(axis=1)
    inner, share = inner[is_near & (share > RESTS)], share[is_near & (share > RESTS)]
    if not inner.size:
        return largest, 0.0
    nearest = np.asarray(Tree(base).query(points[inner])[1])
    towards = (base[active[np.asarray(Tree(base[active]).query(base)[1])]] - base)[nearest]
    away = points[inner] - base[nearest]
    far = np.linalg.norm(away, axis=1)
    is_opposite = np.sum(away * towards, axis=1) < -far * np.linalg.norm(towards, axis=1) / 2
    behind = (size[nearest] <= RESTS * size.max()) & is_opposite & (far < extent)
    return largest, float(share[behind].max(initial=0.0))


def missed(points: np.ndarray, u: np.ndarray, sources: np.ndarray) -> float:
    """Measures the residual of an interpolation of `u` (m, d) from `sources` at `points` (m, d),
    relative to the largest displacement, and zero without one. The interpolation is that by
    distances, and a constant; SciPy's `RBFInterpolator` takes a tenth of a second to import.
    """
    largest = np.linalg.norm(u, axis=1).max(initial=0)
    rows = drop_close(points, sources, roundoff(points))
    if largest == 0 or not len(rows):
        return 0.0
    system = np.pad(-cdist(points[rows], points[rows]), (0, 1), constant_values=1.0)
    system[-1, -1] = 0
    weights = np.linalg.solve(system, np.pad(u[rows], ((0, 1), (0, 0))))
    off = [
        u[start : start + ROWS] - weights[-1] + cdist(points[start : start + ROWS], points[rows]) @ weights[:-1]
        for start in range(0, len(points), ROWS)
    ]
    return float(np.linalg.norm(np.concatenate(off), axis=1).max() / largest)


def leaves_enough(points: np.ndarray, u: np.ndarray) -> int | None:
    """The least of `LEAVES` whose sources miss less than a third of `u`, or None."""
    for leaves in LEAVES:
        sources = KDTree(leaves, extremes=True)(points)
        if missed(points, u, sources) <= UNRESOLVED:
            return leaves
        if len(sources) == len(points):
            break
    return None
