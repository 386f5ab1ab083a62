"""Proof that cells fold nowhere inside, and the margin by which they do not."""

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import ArrayLike, Int, Real

from ..._host.cells.topology import DIMENSION
from ..._host.package.arguments import checked, whole
from ..._kernels.values import is_known
from ..._mesh.mesh import Mesh
from ..batches import in_blocks
from ..quality import places, signs_of
from . import bernstein
from .form import form_of, nodes_of
from .report import Proof
from .search import ROOM, bounds

DEPTH = 4
"""Default of `proof`: parts of a sixteenth of a cell's edges where the sign is open."""


@checked
def proof(
    mesh: Mesh,
    points: Real[ArrayLike, "n d"] | Sequence[Any] | None = None,
    *,
    base: Real[ArrayLike, "n d"] | Sequence[Any] | None = None,
    depth: int = DEPTH,
) -> Proof:
    """Proves that cells fold nowhere inside: bounds det J, at `points` or during a motion.

    `quality` judges corners, between which a hexahedron or a curved cell may fold. Here det J is
    written in the Bernstein basis, whose least coefficient is a lower bound on it. Where that is
    negative and no corner is, the cell is cut into parts, whose bounds are closer. A bound includes
    round-off, so that `valid` is a proof for the coordinates as they are.

    The handedness of all cells is that of the undeformed mesh, `mesh.points`, as `quality` finds
    it, however cells are numbered. A cell that is folded there is invalid until it is unfolded.

    It runs on the host, in double precision. `proven_margin` is traced.

    Sources: Johnen, Remacle, Geuzaine, Geometrical validity of curvilinear finite elements, J.
    Comput. Phys. 233, 2013.

    **Arguments:**

    - `mesh`: the mesh with its cells; `mesh.points` is undeformed.
    - `points`: where the nodes are now (n, d), in the unit of `mesh.points`. Default `mesh.points`.
    - `base`: where they came from (n, d). The bounds then hold at every instant of the straight
      motion from `base` to `points`. Default: none, only `points` is judged.
    - `depth`: how often a cell is cut where its sign is open, default 4. Each cut halves all edges,
      and the time. A cell with few open parts is cut up to twice as often.

    **Returns:** a `Proof`.

    **Raises:** `ValueError` for a mesh without cells of its own dimension, for a shape of `points`
    or `base` other than that of `mesh.points`, and for traced points.
    """
    whole("depth", depth, 0)
    states = {"points": mesh.points if points is None else points} | ({} if base is None else {"base": base})
    for name, x in states.items():
        places(mesh, x, name)
    if not is_known(states, mesh.points, tuple(mesh.cells.values())):
        raise ValueError("`proof` speaks on the host and takes no traced points. `proven_margin` is traced.")
    check_solid(mesh)
    reference, ends = np.asarray(mesh.points, float), tuple(np.asarray(x, float) for x in list(states.values())[::-1])
    with np.errstate(all="ignore"):  # coordinates may be NaN
        signs = signs_of(mesh)
        columns = [_proven(kind, ids, reference, ends, depth, signs[kind]) for kind, ids in mesh.cells.items()]
    joined = {name: np.concatenate([part[name] for part in columns], axis=-1) for name in columns[0]}
    types = tuple((kind, len(ids)) for kind, ids in mesh.cells.items())
    return _report(mesh, joined, types, depth, base is not None)


def check_solid(mesh: Mesh) -> None:
    """Raises `ValueError` for a mesh without cells that fill its space: they have no det J."""
    d = mesh.points.shape[1]
    if not any(DIMENSION[kind] == d and len(ids) for kind, ids in mesh.cells.items()):
        types = ", ".join(mesh.cells) or "none"
        raise ValueError(
            f"the mesh has no cells that fill {d}-D space (cells: {types}): det J is defined for these alone."
        )


def _report(mesh: Mesh, joined: dict[str, np.ndarray], types: Any, depth: int, has_time: bool) -> Proof:
    """Makes the report; pieces of polyhedra that are folded are unknown."""
    lower, upper, counted = joined["lower"], joined["upper"], joined["counted"] > 0
    is_invalid = counted & ((joined["value"] < 0) & (upper < 0) | np.isnan(upper))
    if mesh.polyhedra is not None:
        is_invalid &= ~np.isin(mesh.cell_ids, mesh.polyhedra.cut)
    is_valid = counted & (lower > 0)
    return Proof(
        lower=lower,
        upper=upper,
        size=joined["size"],
        is_valid=is_valid,
        is_invalid=is_invalid,
        is_flat=counted & (joined["is_flat"] > 0) & ~is_valid & ~is_invalid,
        reference=joined["reference"].T,
        near=joined["near"].T,
        time=joined["time"] if has_time else None,
        counted=counted,
        ids=np.asarray(mesh.cell_ids),
        types=types,
        depth=depth,
    )


def _proven(kind: str, ids: Any, reference: np.ndarray, ends: tuple, depth: int, sign: Any) -> dict[str, np.ndarray]:
    """Proves cells of one type; cells of less than d dimensions have NaN."""
    k, d = len(ids), reference.shape[1]
    if DIMENSION[kind] != d:
        rows = {name: np.full(k, np.nan) for name in ("lower", "upper", "size", "value", "is_flat", "time")}
        return rows | {"counted": np.zeros(k), "reference": np.full((d, k), np.nan), "near": np.full((d, k), np.nan)}
    size = max(1, ROOM // bernstein.count(form_of(kind, len(ends) == 2).space))
    prove = functools.partial(_bounded, kind, reference, ends, depth)
    return in_blocks(np, prove, np.asarray(ids).T, np.asarray(sign, float), size=size)


def _bounded(
    kind: str, reference: np.ndarray, ends: tuple, depth: int, ids: Int[np.ndarray, "c k"], sign: Any
) -> dict[str, np.ndarray]:
    """Proves some cells."""
    still, form = form_of(kind), form_of(kind, len(ends) == 2)
    mean = still.mean(still.coefficients(nodes_of(reference, ids)))
    x = [np.concatenate(parts) for parts in zip(*(nodes_of(end, ids) for end in ends), strict=True)]
    columns = form.columns(x)
    found = bounds(form.space, sign * form.determinant(columns), form.round_off(x, columns), depth)
    at = form.inside(found.at)
    nodes = [np.concatenate([end[ids, axis] for end in ends]) for axis in range(reference.shape[1])]
    return {
        "lower": found.lower,
        "upper": found.upper,
        "size": np.abs(mean),
        "value": sign * form.values(columns, at),
        "is_flat": found.is_flat.astype(float),
        "time": at[0],
        "counted": np.ones(ids.shape[1]),
        "reference": form.reference(at),
        "near": form.places(nodes, at).T,
    }
