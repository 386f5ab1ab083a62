"""Curved meshes as linear ones: their outer faces, and their cells in pieces that share points."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float, Int

from .._host.cells.adjacency import is_among
from .._host.cells.lagrange import node_keys, of_order
from .._host.cells.pieces import owned_sides, places_of, steps_of
from .._host.cells.topology import CORNERS, SHAPES

Cells = Mapping[str, Int[np.ndarray, "_k _s"]]


def outer_sides(
    cells: Cells, n: int, among: np.ndarray | None, between: np.ndarray | None
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Sides of one cell only, but those `between` parts, by type, and the cell of each."""
    sides, owners = {}, [np.zeros(0, np.int64)]
    for kind, (ids, owner) in sorted(owned_sides(cells, n, among).items()):
        is_outer = np.ones(len(ids), bool) if between is None else ~is_among(ids, between)
        sides[kind] = ids[is_outer]
        owners.append(owner[is_outer])
    return sides, np.concatenate(owners)


def refined(cells: Cells, points: Float[np.ndarray, "n d"], steps: int) -> tuple[np.ndarray, dict, np.ndarray]:
    """Points (p, d), linear pieces of cells by type, `steps` to an edge, and the cell of each."""
    cells = {kind: ids for kind, ids in cells.items() if len(ids)}
    new, number = _places(cells, points, steps)
    found, first = {}, 0
    for (kind, ids), table in zip(cells.items(), number, strict=True):
        for shape, rows in steps_of(SHAPES[kind], steps).items():
            owner = np.repeat(np.arange(first, first + len(ids)), len(rows))
            found.setdefault(shape, []).append((table[:, rows].reshape(-1, rows.shape[1]), owner))
        first += len(ids)
    joined = {shape: [np.concatenate(part) for part in zip(*found[shape], strict=True)] for shape in sorted(found)}
    owner = np.concatenate([np.zeros(0, np.int64), *(owner for _, owner in joined.values())])
    return new, {shape: ids for shape, (ids, _) in joined.items()}, owner


def _places(cells: Cells, points: np.ndarray, steps: int) -> tuple[np.ndarray, list[np.ndarray]]:
    """Points of the pieces, and their ids (k, s) on the lattice of each cell, by type."""
    # a point is known by the corners around it and their weights, as in `elevate`
    keys, places, counts = [np.zeros((0, 16), np.int64)], [points[:0]], []
    for kind, ids in cells.items():
        corners, lattice = ids[:, : CORNERS[SHAPES[kind]]], of_order(SHAPES[kind], steps)
        own = np.zeros((*corners.shape, 16), np.int64)
        own[:, :, -2], own[:, :, -1] = corners, 1
        keys.append(np.concatenate([own, node_keys(corners, lattice)], axis=1).reshape(-1, 16))
        places.append(np.einsum("sn,knd->ksd", places_of(kind, steps), points[ids]).reshape(-1, points.shape[1]))
        counts.append(len(keys[-1]))
    _, first, number = np.unique(np.concatenate(keys), axis=0, return_index=True, return_inverse=True)
    number, ends = number.ravel(), np.cumsum(counts, dtype=int)
    tables = [number[end - count : end] for count, end in zip(counts, ends, strict=True)]
    tables = [table.reshape(len(ids), -1) for table, ids in zip(tables, cells.values(), strict=True)]
    return np.concatenate(places)[first].astype(points.dtype), tables
