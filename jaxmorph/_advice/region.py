"""Regions of cells that are filled anew, and the layers at walls that stay."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Int
from numpy import ndarray
from scipy.sparse import csr_array

from .._host.cells.first_lines import opposite_corner
from .._host.cells.pieces import owned_sides
from .._host.cells.topology import DIMENSION, FACES, Pair
from .._host.package.arguments import checked
from .._host.rows import first_of_equals, join_ids, mark
from .._mesh.mesh import Mesh

FLATNESS = 0.75  # of layers at walls: the height of a cell over its width


def incidence(mesh: Mesh) -> csr_array:
    """The nodes of each cell, as a sparse matrix (cells, nodes) of ones."""
    nodes = join_ids(mesh.cells.values())
    sizes = np.concatenate([np.full(len(ids), ids.shape[1]) for ids in mesh.cells.values()])
    starts = np.append(0, np.cumsum(sizes))
    return csr_array((np.ones(len(nodes)), nodes, starts), (len(sizes), len(mesh.points)))


@checked
def wall_layers(mesh: Mesh, patches: str | Sequence[str]) -> Int[np.ndarray, " k"]:
    """Lists the nodes of walls and of the layers on them, ascending.

    A layer has quads, wedges and hexahedra lower than wide, each stacked on the one before. A plan
    whose moving nodes these are carries the layers as they are, however far the wall goes.

    - `mesh`: of linear cells.
    - `patches`: names of the walls, as `Mesh.patch` takes them.

    **Raises:** `ValueError` for a name without a patch.
    """
    names = (patches,) if isinstance(patches, str) else tuple(patches)
    wall = mesh.patch(*names)
    cells = chosen_cells(mesh, _layers(mesh, mark(len(mesh.points), wall)))
    return np.union1d(wall, join_ids(cells.values()))


def staying(mesh: Mesh, moved: Mesh, keep: ndarray) -> Pair:
    """Marks the cells that stay, and the nodes that must not be inside of a region."""
    n, d = mesh.points.shape
    nodes = incidence(mesh)
    low = [ids for kind, ids in mesh.cells.items() if DIMENSION[kind] < d]
    on_boundary = mark(n, *(ids for ids, _ in mesh.topology.outer().values()))
    first, place = first_of_equals(np.asarray(moved.points))
    is_double = np.bincount(place, minlength=len(first))[place] > 1
    is_kept = mark(n, keep)
    is_low = np.repeat([DIMENSION[kind] < d for kind in mesh.cells], _counts(mesh))
    cells = (nodes @ ~is_kept == 0) | (nodes @ is_double > 0) | is_low | _layers(mesh, on_boundary)
    return cells, (mark(n, *mesh.patches.values(), *low) | is_kept) & ~on_boundary


def _counts(mesh: Mesh) -> list[int]:
    return [len(ids) for ids in mesh.cells.values()]


def _layers(mesh: Mesh, front: ndarray) -> ndarray:
    """Marks the layers at walls: flat cells, each stacked on the one before."""
    # A cell belongs to a layer if it has a face within the front, which is the boundary first. The
    # nodes beyond that face are the front of the next layer.
    x = np.asarray(mesh.points)
    stacks = []
    for kind, first in zip(mesh.cells, np.cumsum([0, *_counts(mesh)]).tolist(), strict=False):
        for face in FACES[kind]:
            ends = [opposite_corner(kind, face, corner) for corner in face]
            if kind not in ("triangle", "tetra") and len(set(ends) - set(face)) == len(face):
                base, top = (np.asarray(mesh.cells[kind])[:, list(row)] for row in (face, ends))
                height = np.linalg.norm(x[top] - x[base], axis=2).mean(axis=1)
                width = np.linalg.norm(x[base] - x[np.roll(base, 1, axis=1)], axis=2).mean(axis=1)
                flat = np.flatnonzero(height < FLATNESS * width)
                stacks.append((base[flat], top[flat], first + flat))
    found = np.zeros(sum(_counts(mesh)), bool)
    while True:
        before = found.sum()
        here = [(top, cell, front[base].all(axis=1)) for base, top, cell in stacks]
        front = mark(len(x), *(top[rows] for top, _, rows in here))
        for _, cell, rows in here:
            found[cell[rows]] = True
        if found.sum() == before:
            return found


def region_of(mesh: Mesh, worn: ndarray, stays: Pair, layers: int) -> ndarray:
    """Marks the cells to replace: the worn ones, and layers around them that need not stay."""
    cells, needed = stays
    nodes = incidence(mesh)
    chosen = worn & ~cells
    here, behind = inner_faces(mesh)
    if mesh.points.shape[1] == 3:  # layers by faces are ragged: gmsh crowds points in them
        for _ in range(max(1, layers // 2)):
            chosen = (nodes @ (nodes.T @ chosen) > 0) & ~cells
        layers = 0
    for _ in range(layers):
        grown = chosen.copy()
        grown[behind[chosen[here]]] = True
        chosen = grown & ~cells
    while chosen.any():
        inside = needed & (nodes.T @ ~chosen == 0) & (nodes.T @ chosen > 0)
        lost = nodes @ inside > 0
        more = np.zeros_like(lost)
        if mesh.points.shape[1] == 2:  # its borders are loops, which pass no node twice
            edges, _ = border_of(mesh, chosen)["line"]
            pinched = nodes @ (np.bincount(edges.ravel(), minlength=len(mesh.points)) > 2) > 0
            more = pinched & ~cells & ~chosen
            lost |= pinched & ~more.any()
        if not (lost & chosen).any() and not more.any():
            break
        cells = cells | lost
        chosen = (chosen | more) & ~lost
    return chosen


def inner_faces(mesh: Mesh) -> Pair:
    """The cells on the two sides of each inner face, which is listed from both."""
    behind, _ = mesh.topology.neighbours
    counts = [np.full(len(ids), len(FACES[kind])) for kind, ids in mesh.cells.items()]
    here = np.repeat(np.arange(sum(_counts(mesh))), np.concatenate(counts))
    return here[behind >= 0], behind[behind >= 0]


def chosen_cells(mesh: Mesh, chosen: ndarray) -> dict[str, ndarray]:
    parts = np.split(chosen, np.cumsum(_counts(mesh))[:-1])
    return {
        kind: np.asarray(ids)[rows]
        for (kind, ids), rows in zip(mesh.cells.items(), parts, strict=True)
    }


def border_of(mesh: Mesh, chosen: ndarray) -> dict[str, tuple[ndarray, ndarray]]:
    return owned_sides(chosen_cells(mesh, chosen), len(mesh.points))
