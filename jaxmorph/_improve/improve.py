"""Better cells for given boundary nodes: inner nodes where the distortion of all cells is least."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, ArrayLike, Bool, Float, Int, Integer, Real

from .._boundary.boundary import node_ids, walls_of
from .._boundary.closest import Flat, Track
from .._boundary.periodic import Pairing, Periodic
from .._boundary.slide import Slide, check_repeated, tracks_of
from .._boundary.symmetry import Plane
from .._host.cells.adjacency import neighbours
from .._host.cells.topology import FACES, solid
from .._host.linear.hessians import pattern
from .._host.package.arguments import between, checked, whole
from .._host.package.errors import MeshError
from .._kernels.compile import compiled
from .._kernels.module import Module
from .._kernels.values import as_jax, is_known
from .._mesh.mesh import Mesh
from .._plan.plan import Plan
from .._plan.prepare import boundary_of
from .._quality.distortion import node_scales, target
from .._quality.proof.margin import proven_margin
from .._quality.quality import quality
from .._quality.vector import corners
from .newton import Distortion, HessianSolver, ProjectedNewton
from .ways import Ways

QUARTER = 0.05
"""Cosine between a wall's normals, where a node starts and where it ends, below which the end is taken for no minimum."""

SIZE_WEIGHT, SETTLED, MOST_STEPS = 0.5, 0.03, 60
"""Defaults of `improve`: `size_weight`, `tolerance` and `max_steps`."""

SHARPEST, GENTLER, STAGES = 1e-3, 0.3, 5
"""Softness of the barrier in the last stage, its largest share from one stage to the next, and how many there are at most."""


class Improvement(Module):
    """Holds the result of `improve`: traced arrays, and a line about them by `str`.

    - `points`: the improved points (n, d).
    - `before`, `after`: how many of the `cells` were and are inverted, as `quality` counts them.
    - `unproven`: how many bounds on det J now leave open whether they fold inside: `proven_margin` at depth 1 is not positive.
    - `energy`: mean distortion of a cell, 0 where all have their target's shape and size.
    - `residual`: largest derivative of the sum over the cells with respect to a node's place, in units of its smallest
      cell. It is far below 1 at a minimum.
    - `steps`: steps of Newton's method, rejected ones included.
    - `cells`: how many cells there are.
    """

    points: Float[Array, "n d"]
    before: Int[Array, ""]
    after: Int[Array, ""]
    unproven: Int[Array, ""]
    energy: Float[Array, ""]
    residual: Float[Array, ""]
    steps: Int[Array, ""]
    cells: int = eqx.field(static=True)

    def __str__(self) -> str:
        how = "at a minimum" if float(self.residual) < 1e-2 else f"stopped early, residual {float(self.residual):.1g}"
        unproven = int(self.unproven)
        proven = "proven to fold nowhere inside" if unproven == 0 else f"proven to fold nowhere but for {unproven}"
        return (
            f"{int(self.before)} of {self.cells} cells were inverted, {int(self.after)} are now, {proven}; "
            f"mean distortion {float(self.energy):.3g} after {int(self.steps)} steps, {how}"
        )


@dataclasses.dataclass(frozen=True)
class Kept:
    """Names the nodes that are `held`, and along what others are led: `tracks` and `pairings`, of node ids."""

    held: np.ndarray
    tracks: tuple[Track, ...]
    pairings: tuple[Pairing, ...]


@checked
def improve(
    mesh: Mesh,
    points: Real[ArrayLike, "n d"] | Sequence[Any],
    *,
    fixed: Integer[ArrayLike, " f"] | Sequence[int] | None = None,
    symmetry: Plane | str | Sequence[Plane | str] = (),
    periodic: Periodic | Sequence[Periodic] = (),
    sliding: Slide | str | Sequence[Slide | str] = (),
    ideal: bool = False,
    size_weight: float = SIZE_WEIGHT,
    tolerance: float = SETTLED,
    max_steps: int = MOST_STEPS,
    progress: Callable[[float, float], None] | None = None,
) -> Improvement:
    """Moves the inner nodes of a mesh from `points` to where the cells are least distorted; untangles inverted cells.

    The target of each cell is its shape on the undeformed mesh, `mesh.points`, so boundary layers keep their
    anisotropy. The energy of a cell is the mean over its corners of

        (1 - size_weight) |T|^2 / (d chi^(2/d)) + size_weight (1 + det^2 T) / (2 chi) - 1,

    with T from target to cell and chi the determinant of T, regularised: finite on inverted cells. Newton's method
    minimises it in five stages, in which the barrier at chi = 0 sharpens. Sparse systems are solved by SciPy on the
    host.

    Traced in `points`: it works under `jit`, and is differentiable in both modes with respect to the fixed nodes'
    places, by the implicit function theorem at the minimum. Derivatives are as accurate as `residual` is small, so
    lower `tolerance` for them. Derivatives with respect to the places of inner nodes, where the search starts, are
    zero. `mesh` is to be closed over, not traced. Use float64.

    Nodes of symmetry planes and of sliding patches move along these, and stay as far off them as `points` has them. The two
    nodes of a periodic pair move alike. Nodes between two walls stay on both; corners, and nodes on the axis of a rotation, stay.
    Faces have a kink at each edge: where nodes slide on these, the search may stop early. On a curved wall a node turns by less
    than 90 degrees from where it starts; near that, `residual` is infinite.

    Nothing is promised for a boundary that crosses itself: `after`, or `str` of the result, says what is left. Between the
    corners cells are checked at the end: `unproven` counts those that may fold there.

    Sources: Garanzha et al., Foldover-free maps in 50 lines of code, ACM Trans. Graph. 40, 2021; Teran et al., Robust
    quasistatic finite elements and flesh simulation, SCA 2005.

    **Arguments:**

    - `mesh`: the mesh with its cells; `mesh.points` is undeformed.
    - `points`: where the nodes are now (n, d), in the unit of `mesh.points`.
    - `fixed`: ids (f,) of nodes that stay where `points` has them, bit for bit. Default: all patches and the outer
      boundary, but for what slides.
    - `symmetry`, `periodic`, `sliding`: as `prepare` takes them, of the undeformed mesh. Default: none.
    - `ideal`: take the equilateral cell (a cube, a square) of the undeformed volume as target. Default False.
    - `size_weight`: the weight of a change of size against one of shape, 0 to 1, default 0.5.
    - `tolerance`: the last stage ends when nodes move by less than this, root mean square, in units of their smallest
      cell. Default 0.03.
    - `max_steps`: Newton steps in each stage at most, default 60.
    - `progress`: `progress(softness, energy)` is called on the host after each step. Default: none.

    **Returns:** an `Improvement`.

    **Raises:** `ValueError` for a mesh without cells of its own dimension, and for a shape of `points` other than that of
    `mesh.points`. Also for node ids that are not there, for `size_weight` outside of 0 to 1, and for planes, periodic and
    sliding patches as `prepare` does.
    """
    start = jnp.asarray(points)
    _check(mesh, start, fixed, size_weight, tolerance, max_steps)
    with jax.ensure_compile_time_eval():  # not folded into the caller's program
        kept = _kept(mesh, fixed, symmetry, sliding, periodic)
    return _improved(mesh, start, kept, ideal, size_weight, tolerance, max_steps, progress)


def improve_of(plan: Plan, mesh: Mesh, points: Float[Array, "n d"]) -> Improvement:
    """Improves the deformed mesh of a plan: its data stay, nodes slide along its walls and planes, and its pairs move alike."""
    return _improved(mesh, points, _kept_of(plan, mesh), False, SIZE_WEIGHT, SETTLED, MOST_STEPS, None)


def _improved(
    mesh: Mesh,
    start: Array,
    kept: Kept,
    ideal: bool,
    size_weight: float,
    tolerance: float,
    max_steps: int,
    progress: Callable[[float, float], None] | None,
) -> Improvement:
    """Improves a mesh, as `improve` does with these arguments."""
    base = start.astype(jnp.promote_types(start.dtype, jnp.result_type(float)))
    with jax.ensure_compile_time_eval():
        distortion, blocks = _prepared(mesh, base.dtype, kept, ideal, size_weight)
    softness, held = jnp.asarray(1 / GENTLER), jax.lax.stop_gradient(base)
    if distortion.ways is not None:
        distortion = eqx.tree_at(lambda it: it.ways, distortion, _ways_at(distortion.ways, held))
    y, count, stage = jnp.zeros_like(base), 0, distortion
    for last in (False,) * (STAGES - 1) + (True,):
        before, least = softness, SHARPEST if last else -2 * _least(distortion, y, held)
        softness = jnp.maximum(jnp.minimum(least, GENTLER * softness), SHARPEST)
        stage = eqx.tree_at(lambda it: it.softness, distortion, softness.astype(base.dtype))
        enough = (1e-3 * tolerance, tolerance) if last else (max(tolerance, 0.3),) * 2
        options = (last | (softness < before), jnp.asarray(enough, base.dtype), max_steps, progress)
        y, steps = _minimise(stage, jax.lax.stop_gradient(y), base if last else held, blocks, options)
        count += steps
    value, slope, improved = _ended(stage, y, base)
    cells = sum(len(ids) for ids in distortion.cells.values())
    moved = jnp.where(distortion.free[:, None], improved.astype(start.dtype), start)
    moved = moved if distortion.ways is None else distortion.ways.matched(start, moved)
    before, after = (quality(mesh, at).inverted for at in (start, moved))
    unproven = jnp.sum(~(proven_margin(mesh, moved, depth=1) > 0))
    return Improvement(
        moved, before, after, unproven, value / cells, jnp.max(jnp.abs(slope)), jnp.asarray(count), cells
    )


@compiled
def _minimise(distortion: Distortion, y, base, blocks, options):
    """Runs one stage from y; where it is not wanted, it returns y as it is."""
    wanted, (relative, absolute), max_steps, progress = options

    def on_host(softness, energy):
        progress(float(softness), float(energy))  # numbers, since what is done with arrays of JAX may wait

    def tell(**report):
        if progress is not None:
            jax.debug.callback(on_host, distortion.softness, report["loss_this_step"][1])

    solver = ProjectedNewton(
        rtol=relative,
        atol=absolute,
        norm=optx.rms_norm,
        distortion=distortion,
        base=jax.lax.stop_gradient(base),
        pattern=blocks,
        verbose=tell,
    )
    adjoint = optx.ImplicitAdjoint(HessianSolver(distortion, solver.base, blocks))
    tags = frozenset({lx.positive_semidefinite_tag})

    def minimum(y):
        run = optx.minimise(distortion, solver, y, base, max_steps=max_steps, adjoint=adjoint, throw=False, tags=tags)
        return run.value, run.stats["num_steps"]

    return jax.lax.cond(wanted, minimum, lambda y: (y, jnp.asarray(0)), y)


@compiled
def _ways_at(ways: Ways, start: Float[Array, "n d"]) -> Ways:
    return ways.at(start)


@compiled
def _least(distortion: Distortion, y, base):
    return distortion.least(y, base)


@compiled
def _ended(distortion: Distortion, y, base):
    value, slope = jax.value_and_grad(distortion)(y, base)
    points, ways = distortion.points(y, base), distortion.ways
    if ways is not None and not ways.is_linear:
        # a quarter of a turn from its start a node's slope vanishes, minimum or not
        along = jnp.abs(jnp.sum(ways.normals * ways.at(points).normals, axis=2))
        along = jnp.where(jnp.sum(ways.normals**2, axis=2) > 0, along, 1)
        least = jnp.min(along, where=distortion.free[:, None], initial=1.0)
        slope = jnp.where(least > QUARTER, slope, jnp.inf)
    return value, slope, points


def _check(mesh: Mesh, points, fixed, size: float, tolerance: float, max_steps: int) -> None:
    n, d = mesh.points.shape
    if not solid(mesh.cells, d):
        types = ", ".join(mesh.cells) or "none"
        raise ValueError(f"the mesh has no cells that fill {d}-D space (cells: {types}); there is nothing to improve.")
    if tuple(points.shape) != (n, d):
        raise ValueError(f"`points` has shape {tuple(points.shape)}; this mesh has {(n, d)}.")
    if is_known(points) and not (finite := np.isfinite(np.asarray(points)).all(axis=1)).all():
        raise MeshError(
            f"{(~finite).sum()} of {n} points are not finite, first node {{node}}.", np.flatnonzero(~finite)
        )
    if fixed is not None:
        node_ids(fixed, "fixed", n)
    if is_known(size):
        between("size_weight", size, 0, 1, "[]")
    between("tolerance", tolerance, 0, ends="[)")
    whole("max_steps", max_steps)


def _kept(mesh: Mesh, fixed, symmetry, sliding, periodic) -> Kept:
    """Finds what is held of a mesh, and along what."""
    walls, pairings = walls_of(mesh, symmetry, sliding, periodic, () if fixed is None else fixed)
    tracks, corners = tracks_of(walls, (), np.asarray(mesh.points))
    ways = [nodes for _, nodes in walls]
    ways += [np.append(side, each.alone) for each in pairings for side in (each.first, each.second)]
    held = _boundary(mesh, ways) if fixed is None else np.asarray(fixed, dtype=int)
    return Kept(np.append(held, corners), tracks, pairings)


def _kept_of(plan: Plan, mesh: Mesh) -> Kept:
    """Finds what a plan holds, and along what; boundary nodes that it leaves free are held."""
    named = boundary_of(plan)
    flat = [(Flat(plane.normal, plane.origin), np.flatnonzero(plane.holds(named.points))) for plane in named.planes]
    sliding = np.concatenate([np.zeros(0, dtype=int), *(track.rows for track in named.tracks)])
    flat = [(wall, np.setdiff1d(nodes, sliding)) for wall, nodes in flat]
    tracks, corners = tracks_of(flat, (), named.points)
    data = np.concatenate([named.moving, named.fixed])
    joined = [pairing.nodes for pairing in named.pairings]
    known = np.concatenate([data, sliding, *joined, *(nodes for _, nodes in flat)])
    held = np.concatenate([_boundary(mesh, [known]), data, corners])
    return Kept(held, (*named.tracks, *tracks), named.pairings)


def _prepared(mesh: Mesh, dtype, kept: Kept, ideal: bool, size: float):
    """Prepares the energy, and on the host the pattern of its Hessian."""
    n, d = mesh.points.shape
    cells = _cells(mesh)
    tracks, pairings = kept.tracks, kept.pairings
    free = np.zeros(n, dtype=bool)
    free[np.concatenate([ids.ravel() for ids in cells.values()])] = True
    free[kept.held] = False
    check_repeated(tracks, kept.held, pairings, np.asarray(mesh.points), free)
    leads, leading = _leads(pairings, free), bool(tracks or pairings)
    distortion = _energy(
        {kind: jnp.asarray(ids) for kind, ids in cells.items()},
        jnp.asarray(mesh.points, dtype),
        jnp.asarray(free),
        Ways(*as_jax((tracks, pairings, leads != np.arange(n), np.zeros((n, d - 1, d))))) if leading else None,
        ideal,
        size,
    )
    groups = [leads[ids] for ids in cells.values()] + [np.arange(n)[:, None]] * leading
    return jax.lax.stop_gradient(distortion), pattern(groups, n, d)


def _leads(pairings: Sequence[Pairing], free: Bool[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """Finds for each node the one that it moves with. It clears `free` of all whose partners are held."""
    leads = np.arange(len(free))
    for pairing in pairings:
        leads[pairing.second] = leads[pairing.first]
        free[pairing.alone] = False
    free[np.isin(leads, np.unique(leads[~free]))] = False
    return leads


@compiled
def _energy(cells: dict[str, Array], reference: Float[Array, "n d"], free: Bool[Array, " n"], ways, ideal: bool, size):
    targets = {kind: target(kind, corners(reference, ids), ideal) for kind, ids in cells.items()}
    scale = node_scales(cells, targets, len(reference))
    return Distortion(cells, targets, scale, free, jnp.ones((), reference.dtype), ways, float(size))


def _cells(mesh: Mesh) -> dict[str, np.ndarray]:
    return {kind: np.asarray(ids) for kind, ids in solid(mesh.linear.cells, mesh.points.shape[1]).items()}


def _boundary(mesh: Mesh, ways: Sequence[np.ndarray]) -> np.ndarray:
    """Lists the nodes of patches and outer faces, except the nodes of one wall or periodic side."""
    cells = _cells(mesh)
    behind, _ = neighbours(cells)
    walls = [np.isin(np.arange(len(mesh.points)), nodes) for nodes in ways]
    nodes, first = [np.asarray(ids) for ids in mesh.patches.values()], 0
    nodes = [ids for ids in nodes if not any(on[ids].all() for on in walls)]
    for kind, ids in cells.items():
        faces = FACES[kind]
        alone = behind[first : first + len(ids) * len(faces)].reshape(len(ids), len(faces)) < 0
        for i, face in enumerate(faces):
            outer = ids[alone[:, i]][:, list(face)]
            for on in walls:
                outer = outer[~on[outer].all(axis=1)]
            nodes.append(outer.ravel())
        first += len(ids) * len(faces)
    return np.unique(np.concatenate([np.zeros(0, int), *nodes])).astype(int)
