"""The share of a mesh that each process of an MPI run has, and the surface of the whole mesh."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

import jaxmorph as jm
from jaxmorph._boundary.symmetry import check_dimension, on_facing


@dataclasses.dataclass(frozen=True)
class Share:
    """One process' share of a mesh: points (n, d), ids (n,), rows that move and are fixed."""

    points: np.ndarray
    nodes: np.ndarray
    moving: np.ndarray
    fixed: np.ndarray
    planes: list[jm.Plane]
    mesh: jm.Mesh | None

    @classmethod
    def checked(cls, points: Any, nodes: Any, moving: Any, fixed: Any, symmetry: Any) -> "Share":
        """Makes the share of the arguments of `prepare`. Raises `ValueError` as `prepare` does."""
        mesh = points if isinstance(points, jm.Mesh) else None
        x, ids = np.asarray(points if mesh is None else mesh.points), np.asarray(nodes)
        if x.ndim != 2 or ids.shape != (len(x),) or ids.dtype.kind not in "iu" or len(np.unique(ids)) < len(ids):
            raise ValueError(f"`nodes` must be one id for each of {len(x)} points, no id twice.")
        if not len(x) or x.dtype.kind not in "fiu" or not np.isfinite(x).all() or (ids < 0).any():
            raise ValueError("a piece needs at least one point, finite coordinates, and ids from 0 on.")
        planes = [symmetry] if isinstance(symmetry, jm.Plane) else list(symmetry)
        check_dimension(planes, x.shape[1])
        return cls(x, ids.astype(np.int64), _rows(moving, len(x)), _rows(fixed, len(x)), planes, mesh)


def surface_of(
    comm: Any, share: Share, faces: dict[str, np.ndarray] | None
) -> tuple[np.ndarray, np.ndarray, int, int, int]:
    """Gathers the points that the surface's half needs, and their ids.

    The first m points move, the next points up to `count` are fixed. Points from there to `total`
    are on parallel planes or on the boundary's `faces`. The outermost points, whose id is -1, are
    the last. All processes get equal results, and raise together.
    """
    x, ids = share.points, share.nodes
    ends = np.unique([x.argmin(axis=0), x.argmax(axis=0)])
    extent = np.concatenate(comm.allgather(x[ends]))  # a plane holds nodes to a share of the whole mesh's size
    guided = on_facing(share.planes, np.concatenate([x, extent]))[: len(x)]
    on_faces = np.isin(ids, np.concatenate([corners.ravel() for corners in (faces or {}).values()] or [ids[:0]]))
    kinds = share.moving, share.fixed, np.flatnonzero(guided | on_faces)
    shares = comm.allgather([(ids[rows], x[rows]) for rows in kinds])
    (moving, at_moving), (fixed, at_fixed), (further, at_further) = (
        _union(parts) for parts in zip(*shares, strict=True)
    )
    rest = ~np.isin(fixed, moving)
    others = ~np.isin(further, np.concatenate([moving, fixed]))
    outermost = np.concatenate(comm.allgather(x[ends[~(guided | on_faces)[ends]]]))
    everything = np.concatenate([at_moving, at_fixed[rest], at_further[others], outermost])
    names = np.concatenate([moving, fixed[rest], further[others], np.full(len(outermost), -1)])
    count = len(moving) + int(rest.sum())
    return everything, names, len(moving), count, count + int(others.sum())


def _rows(values: Any, n: int) -> np.ndarray:
    """Returns rows of the piece's points. Raises `ValueError` for what is no list of them."""
    rows = np.asarray(values)
    if rows.size == 0:
        return np.zeros(0, dtype=np.int64)
    if (
        rows.ndim != 1
        or rows.dtype.kind not in "iu"
        or rows.min() < 0
        or rows.max() >= n
        or len(np.unique(rows)) < len(rows)
    ):
        raise ValueError(f"`moving` and `fixed` are rows of the piece's {n} points, whole numbers from 0, none twice.")
    return rows.astype(np.int64)


def _union(shares: Sequence[Any]) -> tuple[np.ndarray, np.ndarray]:
    """Joins ids and coordinates, ascending. Raises `ValueError` for an id of several places."""
    ids, points = (np.concatenate([share[k] for share in shares]) for k in range(2))
    unique, first, back = np.unique(ids, return_index=True, return_inverse=True)
    mismatched = np.flatnonzero((points != points[first][back]).any(axis=1))
    if mismatched.size:
        raise ValueError(
            f"{mismatched.size} nodes lie at different places in different processes, first {ids[mismatched[0]]}."
        )
    return unique, points[first]
