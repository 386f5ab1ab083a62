"""Curved cells as fine linear pieces, for pictures in 3-D."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float, Int

from .._host.cells.lagrange import lagrange_types, node_keys, of_order
from .._host.cells.pieces import places_of, steps_of
from .._host.cells.topology import CORNERS, SHAPES
from ._cells import SEGMENTS

PIECES = 1_000_000
"""Pieces that a picture has about at most: edges of large meshes have fewer."""


def segments(cells: Mapping[str, np.ndarray]) -> int:
    """Chooses into how many pieces an edge of the cells is cut."""
    order = max((lagrange_types()[kind].order for kind in cells), default=1)
    count = sum(len(ids) * order ** lagrange_types()[kind].dimension for kind, ids in cells.items())
    dimension = max((lagrange_types()[kind].dimension for kind in cells), default=1)
    return order * int(np.clip((PIECES / max(count, 1)) ** (1 / dimension), 1, SEGMENTS))


def refined(
    cells: Mapping[str, Int[np.ndarray, "_k _s"]], points: Float[np.ndarray, "n 3"], m: int
) -> tuple[Float[np.ndarray, "p 3"], dict[str, np.ndarray], np.ndarray]:
    """Cuts curved cells into pieces with edges of 1 / m of the cells' edges.

    Neighbours share the points of their common sides, as their corners say.

    **Returns:** the points, the pieces by type in alphabetical order, and the cell of each piece.
    """
    # a point is known by the corners around it and their weights, as in `elevate`
    kinds = {kind: (np.asarray(ids), of_order(SHAPES[kind], m)) for kind, ids in cells.items() if len(ids)}
    keys, places = [], []
    for kind, (ids, lattice) in kinds.items():
        corners = ids[:, : CORNERS[SHAPES[kind]]]
        own = np.zeros((*corners.shape, 16), np.int64)
        own[:, :, -2], own[:, :, -1] = corners, 1
        keys.append(np.concatenate([own, node_keys(corners, lattice)], axis=1).reshape(-1, 16))
        places.append(np.einsum("sn,knd->ksd", places_of(kind, m), points[ids]).reshape(-1, 3))
    _, first, number = np.unique(np.concatenate(keys), axis=0, return_index=True, return_inverse=True)
    number, found, start, cell = number.ravel(), {}, 0, 0
    for ids, lattice in kinds.values():
        table = number[start : start + len(ids) * len(lattice.lattice)].reshape(len(ids), -1)
        start += table.size
        for shape, rows in steps_of(lattice.shape, m).items():
            owner = np.repeat(np.arange(cell, cell + len(ids)), len(rows))
            found.setdefault(shape, []).append((table[:, rows].reshape(-1, rows.shape[1]), owner))
        cell += len(ids)
    joined = {shape: [np.concatenate(part) for part in zip(*found[shape], strict=True)] for shape in sorted(found)}
    pieces = {shape: ids for shape, (ids, _) in joined.items()}
    return np.concatenate(places)[first], pieces, np.concatenate([owner for _, owner in joined.values()])
