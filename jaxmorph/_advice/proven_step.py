"""The largest step that keeps whole cells above a bound, by Bernstein polynomials in the step."""

import dataclasses

import numpy as np
from jaxtyping import Float, Int

from .._host.cells.topology import DIMENSION
from .._mesh.mesh import Mesh
from .._quality.proof import bernstein
from .._quality.proof.form import form_of, nodes_of
from .._quality.proof.proof import DEPTH, proof
from .._quality.proof.search import ROOM
from .first_roots import first_roots


def least_undeformed(mesh: Mesh) -> Float[np.ndarray, " k"]:
    """Finds the least det J that is proven of each undeformed cell.

    **Raises:** `ValueError` for cells that are not proven valid.
    """
    undeformed = proof(mesh, mesh.points)
    if undeformed.valid < undeformed.count:
        first = undeformed.worst(1)[0]
        raise ValueError(
            f"{undeformed.count - undeformed.valid} of {undeformed.count} cells of the undeformed mesh are not proven valid, first "
            f"cell {first}: no step can be. jm.proof(mesh) lists them; proven=False looks at corners alone."
        )
    return undeformed.lower


def proven_share(
    mesh: Mesh, signs: dict[str, np.ndarray], ends: tuple[np.ndarray, np.ndarray], bounds: Float[np.ndarray, " k"]
) -> tuple[float, int]:
    """Finds the share of the straight way on which all cells keep their bound, at most 1.

    Also finds the cell that ends it, or -1. `ends` are the points (n, d) at both, `signs` those of
    `signs_of`. At each instant the least coefficient is a lower bound
    on det J, so the step ends where the first coefficient falls below. Only cells that would end it
    are cut.
    """
    search, offset = _Search(), 0
    for kind, ids in mesh.cells.items():
        if DIMENSION[kind] == mesh.points.shape[1]:
            bound = bounds[offset : offset + len(ids)]
            search.through(_Cells(kind, np.asarray(ids).T, signs[kind], ends, bound), offset)
        offset += len(ids)
    return search.step, search.cell


@dataclasses.dataclass(frozen=True, eq=False)
class _Cells:
    """Cells of one type, ids (nodes, k), with sign and bound (k,) of each between two `ends`."""

    kind: str
    ids: np.ndarray
    sign: np.ndarray
    ends: tuple[np.ndarray, np.ndarray]
    bound: np.ndarray

    @property
    def space(self) -> bernstein.Space:
        return form_of(self.kind).space

    def excess(self, cells: Int[np.ndarray, " c"]) -> Float[np.ndarray, "t n c"]:
        """Computes Bernstein coefficients, in time by space, of det J less the bound."""
        form, ids = form_of(self.kind, True), self.ids[:, cells]
        x = [np.concatenate(parts) for parts in zip(*(nodes_of(end, ids) for end in self.ends), strict=True)]
        columns = form.columns(x)
        values = self.sign[cells] * form.determinant(columns) - form.round_off(x, columns) - self.bound[cells]
        return values.reshape(-1, bernstein.count(self.space), len(cells))


class _Search:
    """Holds the largest step so far, which some cell's bound or coefficient ends, and that cell."""

    def __init__(self) -> None:
        self.step, self.cell = 1.0, -1

    def through(self, cells: _Cells, offset: int) -> None:
        """Looks at all cells, then into cells that may end the step before any corner does."""
        size = max(1, ROOM // (4 * bernstein.count(cells.space)))
        blocks = np.split(np.arange(cells.ids.shape[1]), range(size, cells.ids.shape[1], size))
        for block in blocks:
            self._look(cells.space, cells.excess(block), block + offset, 0)

    def _look(self, space: bernstein.Space, excess: np.ndarray, cell: np.ndarray, level: int) -> None:
        """Takes values at corners, which are certain, and cuts the parts that may end the step."""
        corners = bernstein.corners(space)
        self._take(_first(excess[:, corners]), cell)
        least = _first(excess)
        if level == DEPTH:
            self._take(least, cell)
            return
        rows, size = np.flatnonzero(least < self.step), max(1, ROOM // (32 * excess.shape[1]))
        for start in range(0, len(rows), size):
            some = rows[start : start + size]
            t, n, _ = excess.shape
            parts = bernstein.halved(space, np.moveaxis(excess[:, :, some], 0, 1).reshape(n, -1))
            parts = np.moveaxis(parts.reshape(n, -1, t, len(some)), 2, 0).reshape(t, n, -1)
            self._look(space, parts, np.tile(cell[some], parts.shape[2] // len(some)), level + 1)

    def _take(self, steps: Float[np.ndarray, " p"], cell: Int[np.ndarray, " p"]) -> None:
        if len(steps) and steps.min() < self.step:
            self.step, self.cell = float(steps.min()), int(cell[steps.argmin()])


def _first(excess: Float[np.ndarray, "t n p"]) -> Float[np.ndarray, " p"]:
    """Finds when each part's first coefficient falls below 0; infinity if none does in 0 to 1."""
    steps = np.full(excess.shape[1:], np.inf)
    falls = excess.min(axis=0) < 0
    steps[falls] = first_roots(_powers(excess[:, falls]))
    return steps.min(axis=0)


def _powers(values: Float[np.ndarray, "t k"]) -> Float[np.ndarray, "4 k"]:
    """Turns Bernstein coefficients of degree 2 or 3 into coefficients of powers, lowest first."""
    if len(values) == 3:
        a, b, c = values
        return np.stack([a, 2 * (b - a), a - 2 * b + c, np.zeros_like(a)])
    a, b, c, d = values
    return np.stack([a, 3 * (b - a), 3 * (a - 2 * b + c), d - 3 * c + 3 * b - a])
