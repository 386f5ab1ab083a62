"""Values at nodes and in cells of an old mesh, carried over to a new one in the same place."""

import dataclasses
import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental.sparse import BCOO
from jaxtyping import Array, ArrayLike, Int, Real
from numpy import ndarray
from scipy.sparse import block_array, coo_array, diags_array
from scipy.sparse.linalg import splu

from .._host.cells.topology import ByType, Pair, numbers_by_name
from .._host.package.arguments import checked
from .._host.package.rounding import Tree
from .._mesh.mesh import Mesh
from .._quality.quality import quality
from .region import chosen_cells

SIMPLICES = numbers_by_name(
    {
        "triangle": "012",
        "quad": "012 023",
        "tetra": "0123",
        "pyramid": "0124 0234",
        "wedge": "0125 0154 0453",
        "hexahedron": "0126 0236 0376 0746 0456 0516",
    }
)
SIMPLICES_TRIED = (16, 256)  # simplices nearest to a place among which it is sought
AROUND = 16  # old cells whose centres give a linear field at a new one
SAMPLES = 3  # steps of the lattice of samples in a simplex
LINK = 1e-3  # share in corrections of cells that meet at a corner
REFINEMENTS = 8  # of a solution, for round-off
LOST = 1e-12  # volume over the largest cell's that a conservative operator may lose
PAIRS_AT_ONCE = 1 << 17  # pairs of places and simplices at a time
MISSED = -1e-9  # barycentric coordinate of a place outside of all simplices


@dataclasses.dataclass(frozen=True, eq=False)
class Remeshed:
    """A mesh with new cells in the place of worn ones, from `remesh`.

    - `mesh`: the new mesh, of N points; its coordinates are where the old mesh has moved.
    - `of_old` (n,): the new id of each old node, -1 for one that is gone.
    - `weights` (N, n): linear interpolation of values at nodes, a sparse matrix of JAX. It is the
      identity at nodes that stay, and exact for linear fields.
    - `cells_of_old` (k,): the new number of each old cell, -1 for one that is gone.
    - `old`: the old mesh, moved.

    `transfer` and `transfer_cells` are traced and linear; their transposes carry cotangents back.
    """

    mesh: Mesh
    of_old: Int[ndarray, " n"]
    weights: BCOO
    cells_of_old: Int[ndarray, " k"]
    old: Mesh

    @property
    def replaced(self) -> float:
        """The share of the old cells that are gone."""
        return float(np.mean(self.cells_of_old < 0))

    @checked
    def transfer(self, values: Real[ArrayLike, "n *c"]) -> Real[Array, "m *c"]:
        """Interpolates values at the nodes of the old mesh at those of the new one. Traced.

        **Raises:** `ValueError` for another number of values.
        """
        return _apply(self.weights, values)

    @checked
    def transfer_cells(
        self, values: Real[ArrayLike, "k *c"], *, conservative: bool = False
    ) -> Real[Array, "m *c"]:
        """Carries values of cells, in the order of `cells`, to the cells of the new mesh. Traced.

        Cells that stay keep their values. Others get combinations of values of old cells near
        them, exact for fields that are linear between the cells' centres (means of corners). With
        `conservative`, values are means over cells. Their integral stays, and so does a constant,
        but no linear field. Volumes of intersections are then those of samples, corrected by as
        little as makes the sums exact.

        **Raises:** `ValueError` for another number of values. With `conservative`, also for old
        cells that are inverted.
        """
        return _apply(self._conserving if conservative else self._linear, values)

    @functools.cached_property
    def _linear(self) -> BCOO:
        return self._of_cells(lambda old, new: _linear_rows(old.centres, new.centres))

    @functools.cached_property
    def _conserving(self) -> BCOO:
        return self._of_cells(_conserving_rows)

    def _of_cells(self, rows_of_new: Callable[..., coo_array]) -> BCOO:
        """Joins the identity on cells that stay and rows of new cells, from cells that are gone."""
        is_gone = self.cells_of_old < 0
        stay = np.flatnonzero(~is_gone)
        count = sum(map(len, self.mesh.cells.values()))
        is_new = np.ones(count, bool)
        is_new[self.cells_of_old[stay]] = False
        part = coo_array((int(is_new.sum()), int(is_gone.sum())))
        if is_gone.any():
            part = rows_of_new(_Part.of(self.old, is_gone), _Part.of(self.mesh, is_new))
        return _sparse(
            (count, len(is_gone)),
            np.concatenate([self.cells_of_old[stay], np.flatnonzero(is_new)[part.row]]),
            np.concatenate([stay, np.flatnonzero(is_gone)[part.col]]),
            np.concatenate([np.ones(len(stay)), part.data]),
        )


def link_meshes(old: Mesh, mesh: Mesh, of_old: ndarray, cells_of_old: ndarray) -> Remeshed:
    """Finds how values at nodes pass from an old mesh, moved, to the new one in its place."""
    stay = np.flatnonzero(of_old >= 0)
    new = np.arange(len(stay), len(mesh.points))
    nodes = np.zeros((0, 1), int)
    shares = nodes.astype(float)
    if len(new):
        region = _Part.of(old, cells_of_old < 0)
        simplex, shares = region.locate(np.asarray(mesh.points, float)[new])
        nodes = region.simplices[simplex]
    weights = _sparse(
        (len(mesh.points), len(of_old)),
        np.concatenate([of_old[stay], np.repeat(new, nodes.shape[1])]),
        np.concatenate([stay, nodes.ravel()]),
        np.concatenate([np.ones(len(stay)), shares.ravel()]),
    )
    return Remeshed(mesh, of_old, weights, cells_of_old, old)


def _sparse(shape: tuple[int, int], *entries: ndarray) -> BCOO:
    rows, columns, values = entries
    return BCOO((jnp.asarray(values), jnp.asarray(np.stack([rows, columns], axis=1))), shape=shape)


@jax.jit
def _multiply(weights: BCOO, values: Array) -> Array:
    return weights @ values


def _apply(weights: BCOO, values: ArrayLike) -> Array:
    rows = jnp.asarray(values)
    if not rows.ndim or len(rows) != weights.shape[1]:
        raise ValueError(
            f"`values` has shape {rows.shape}; the old mesh has {weights.shape[1]} rows of values."
        )
    flat = _multiply(weights, rows.reshape(len(rows), -1).astype(weights.dtype))
    return flat.reshape(-1, *rows.shape[1:])


def simplices_in(cells: ByType) -> Pair:
    """Cuts cells into simplices between their corners (s, d + 1), with the cell (s,) of each."""
    rows = {kind: np.array(SIMPLICES[kind]) for kind in cells}
    pieces = [np.asarray(ids)[:, rows[kind]] for kind, ids in cells.items()]
    counts = np.concatenate([np.full(len(piece), piece.shape[1]) for piece in pieces])
    simplices = np.concatenate([piece.reshape(-1, piece.shape[2]) for piece in pieces])
    return simplices, np.repeat(np.arange(len(counts)), counts)


def signed_volumes(corners: ndarray) -> ndarray:
    """Volumes (s,) of simplices (s, d + 1, d) times d!."""
    return np.linalg.det(corners[:, 1:] - corners[:, :1])


@dataclasses.dataclass(frozen=True, eq=False)
class _Part:
    """Some cells of a mesh (c,), and the simplices (s, d + 1) in them, with their cells (s,)."""

    points: ndarray
    simplices: ndarray
    owner: ndarray
    volumes: ndarray
    centres: ndarray

    @classmethod
    def of(cls, mesh: Mesh, chosen: ndarray) -> "_Part":
        measured = quality(mesh)
        volumes = np.asarray(measured.volume, float)[chosen]
        centres = np.asarray(measured.centroid, float)[chosen]
        points = np.asarray(mesh.points, float)
        return cls(points, *simplices_in(chosen_cells(mesh, chosen)), np.abs(volumes), centres)

    @property
    def corners(self) -> ndarray:
        return self.points[self.simplices]

    def locate(self, places: ndarray) -> Pair:
        """Finds the simplex (k,) at each place (k, d), and barycentric coordinates (k, d + 1)."""
        # Among the simplices whose middles are near, the one in whose smallest coordinate a place
        # is most inside. A place that is in none is sought again among more.
        corners = self.corners
        tree = Tree(corners.mean(axis=1))
        inverse = np.linalg.pinv(corners[:, 1:] - corners[:, :1])
        simplex = np.zeros(len(places), int)
        least = np.full(len(places), -np.inf)
        for count in SIMPLICES_TRIED:
            rows = np.flatnonzero(least < MISSED)
            for some in np.array_split(rows, 1 + len(rows) * count // PAIRS_AT_ONCE):
                near = tree.query(places[some], k=range(1, 1 + min(count, len(corners))))[1]
                away = places[some, None] - corners[near, 0]
                shares = np.einsum("kcd,kcde->kce", away, inverse[near])
                inside = np.minimum(shares.min(axis=2), 1 - shares.sum(axis=2))
                best = inside.argmax(axis=1)
                simplex[some] = np.take_along_axis(near, best[:, None], axis=1)[:, 0]
                least[some] = inside.max(axis=1)
        shares = np.zeros((len(places), corners.shape[1]))
        shares[:, 0] = 1
        for _ in range(2):  # the second time for round-off
            left = places - np.einsum("kc,kcd->kd", shares, corners[simplex])
            more = np.einsum("kd,kde->ke", left, inverse[simplex])
            shares += np.column_stack([-more.sum(axis=1), more])
        return simplex, shares

    def samples(self) -> tuple[ndarray, ndarray, ndarray]:
        """Places (p, d) in the simplices, each with its cell and a share of the cell's volume."""
        d = self.points.shape[1]
        lattice = np.array(
            [row for row in np.ndindex(*[SAMPLES] * (d + 1)) if sum(row) == SAMPLES - 1]
        )
        weights = (lattice + 1 / (d + 1)) / SAMPLES
        places = np.einsum("pc,scd->spd", weights, self.corners).reshape(-1, d)
        size = np.abs(signed_volumes(self.corners))
        whole = np.bincount(self.owner, size, len(self.volumes))
        volume = size / whole[self.owner] * self.volumes[self.owner] / len(weights)
        return places, np.repeat(self.owner, len(weights)), np.repeat(volume, len(weights))


def _linear_rows(old: ndarray, new: ndarray) -> coo_array:
    """The smallest weights, the nearer the larger, that give linear fields at new centres."""
    k = min(AROUND, len(old))
    away, near = Tree(old).query(new, k=range(1, 1 + k))
    scale = away[:, -1:] + np.finfo(float).tiny
    rows = np.ones((len(new), 1 + new.shape[1], k))
    rows[:, 1:] = ((old[near] - new[:, None]) / scale[:, :, None]).swapaxes(1, 2)
    nearness = 1 / (0.01 + (away / scale) ** 2)
    wanted = np.eye(1, rows.shape[1])
    inverse = np.linalg.pinv(np.einsum("nik,nk,njk->nij", rows, nearness, rows))
    weights = np.zeros(near.shape)
    for _ in range(3):  # the second and third time for round-off
        fault = wanted - np.einsum("nik,nk->ni", rows, weights)
        weights += nearness * np.einsum("nik,nij,nj->nk", rows, inverse, fault)
    ids = (np.repeat(np.arange(len(new)), k), near.ravel())
    return coo_array((weights.ravel(), ids), (len(new), len(old)))


def _conserving_rows(old: _Part, new: _Part) -> coo_array:
    """Means over new cells by means over old ones; sums of volumes are exact in both."""
    # Samples of the cells of either mesh, sought in the other, give volumes M of intersections.
    # M + P (a + b), with a number `a` for each new cell and `b` for each old one, has the right
    # sums of rows and columns: a linear system, singular for constants, which do not matter. The
    # pattern P is M, and small links from each cell to those at its corners. So it connects a part
    # of the region whatever the samples miss.
    shape = (len(new.volumes), len(old.volumes))
    volumes = coo_array(shape)
    pattern = coo_array(shape)
    for here, there in ((old, new), (new, old)):
        places, cell, volume = here.samples()
        found = there.owner[there.locate(places)[0]]
        ids = (found, cell) if here is old else (cell, found)
        volumes = volumes + coo_array((volume / 2, ids), shape)
        found = there.owner[there.locate(here.corners.reshape(-1, here.points.shape[1]))[0]]
        cell = np.repeat(here.owner, here.simplices.shape[1])
        ids = (found, cell) if here is old else (cell, found)
        pattern = pattern + coo_array((LINK * here.volumes[cell], ids), shape)
    pattern = coo_array(pattern + volumes)
    sums = np.concatenate([pattern.sum(axis=1), pattern.sum(axis=0)])
    system = block_array([[None, pattern], [pattern.T, None]]) + diags_array(sums)
    solve = splu((system + 1e-9 * diags_array(sums)).tocsc()).solve
    whole = np.concatenate([new.volumes, old.volumes])
    fault = whole - np.concatenate([volumes.sum(axis=1), volumes.sum(axis=0)])
    shift = np.zeros(len(whole))
    for _ in range(REFINEMENTS):
        shift += solve(fault - system @ shift)
    if np.abs(fault - system @ shift).max() > LOST * whole.max():
        raise ValueError(
            "no conservative transfer: old and new cells do not fill the same place, for some old "
            "cells are inverted; hand over earlier."
        )
    change = shift[: shape[0]][pattern.row] + shift[shape[0] :][pattern.col]
    rows = coo_array(volumes + coo_array((pattern.data * change, pattern.coords), shape))
    return coo_array((rows.data / new.volumes[rows.row], rows.coords), shape)
