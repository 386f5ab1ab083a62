"""Bounds on the least det J of each cell, tightened by subdivision where they straddle zero."""

import dataclasses
import functools
from collections.abc import Iterator

import jax
import numpy as np
from jaxtyping import Float, Int

from .._kernels.callback import host_call
from .._kernels.values import Either, constant, namespace
from . import bernstein
from .bernstein import Space
from .jacobian_form import form_of
from .vector import PerCell, in_blocks

Values = Float[np.ndarray, " k"]
PathRows = Int[np.ndarray, " p"]
Path = Int[np.ndarray, "l p"]
BernsteinForms = Float[np.ndarray, "f k"]

ROOM = 1 << 16  # coefficients in a block: they stay in the processor's cache
DEPTH = 4  # default of `proof`: parts of a sixteenth of a cell's edges where the sign is open
FEW_PARTS = (
    64  # open parts of a cell up to which they are cut beyond the depth, at most twice as often
)


@dataclasses.dataclass(frozen=True, eq=False)
class LeastValues:
    """Bounds (k,) of k polynomials' least values: `lower`, and the value `upper` at `at`."""

    lower: Values  # beyond round-off
    upper: Values  # beyond round-off
    at: BernsteinForms  # places among the factors of the space
    is_flat: np.ndarray  # (k,) both are zero to round-off: no subdivision decides the sign


def blocks(rows: PathRows, coefficients: int) -> Iterator[Int[np.ndarray, " q"]]:
    """Yields rows of so many `coefficients` each, some at a time."""
    size = max(1, ROOM // coefficients)
    return (rows[start : start + size] for start in range(0, len(rows), size))


def bounds(
    space: Space, coefficients: Float[np.ndarray, "n k"], round_off: Values, depth: int
) -> LeastValues:
    """Bounds polynomials, on parts of a 2^depth-th or less where the sign needs them."""
    k = coefficients.shape[1]
    d = sum(m for m, _ in space)
    corners = bernstein.corners(space)
    lower, upper = np.full((2, k), np.inf)
    at = np.zeros((d, k))

    def look(values: Float[np.ndarray, "n p"], cell: np.ndarray, path: Path) -> None:
        """Looks at parts of cells, and cuts those of open sign; negative cells are done. The `path`
        to a part has the number that it has among its parent's parts, level by level.
        """
        corner = values[corners].argmin(axis=0)
        lowest = values[corners].min(axis=0)
        before = upper.copy()
        np.minimum.at(upper, cell, lowest)
        rows = np.flatnonzero((lowest == upper[cell]) & (lowest < before[cell]))
        at[:, cell[rows]] = _place_in_cell(space, path[:, rows], corner[rows])
        # where a corner is zero to round-off, closer bounds cannot be positive: only what may be
        # negative is of interest
        least = values.min(axis=0)
        level = len(path)
        slack = round_off[cell]
        is_open = (least < -slack) | ((least <= slack) & (lowest > slack))
        is_open &= ~(upper[cell] < -slack)
        if level >= depth:
            is_open &= (level < 2 * depth) & (
                np.bincount(cell[is_open], minlength=k)[cell] <= FEW_PARTS
            )
        np.minimum.at(lower, cell[~is_open], least[~is_open])
        rows = np.flatnonzero(is_open)
        rows = rows[np.argsort(cell[rows], kind="stable")]  # parts of a cell are counted together
        for some in blocks(rows, bernstein.count_coefficients(space) * 2**d):
            below = np.vstack([np.tile(path[:, some], 2**d), np.repeat(np.arange(2**d), len(some))])
            look(bernstein.halved(space, values[:, some]), np.tile(cell[some], 2**d), below)

    look(coefficients, np.arange(k), np.zeros((0, k), dtype=int))
    is_flat = (np.abs(lower) <= round_off) & (np.abs(upper) <= round_off)
    return LeastValues(lower=lower - round_off, upper=upper + round_off, at=at, is_flat=is_flat)


def _place_in_cell(space: Space, path: Path, corner: PathRows) -> Float[np.ndarray, "f p"]:
    """Places of parts' corners, by barycentric coordinates from the parts outwards."""
    corners = np.unravel_index(corner, [m + 1 for m, _ in space])
    paths = np.unravel_index(path, [2**m for m, _ in space])
    found = []
    for (m, _), own, parts in zip(space, corners, paths, strict=True):
        coordinates = np.eye(m + 1)[own]
        for part in parts[::-1]:
            coordinates = np.einsum("pi,pij->pj", coordinates, bernstein.children(m)[part])
        found.append(coordinates[:, 1:].T)
    return np.concatenate(found)


def least_jacobian(kind: str, x: list[Float[Either, "nodes k"]]) -> PerCell:
    """The least det J of curved cells, in the handedness of their volume. `x` are the components of
    the nodes, relative to the first one. Where det J is positive all over, it is the least at a
    corner. Elsewhere the place is that of `proof`: a negative value is found wherever the bounds
    say `invalid`.
    """
    form = form_of(kind)
    k = x[0].shape[1]
    if namespace(x[0]) is np:
        at = _least_places(kind, *x)
    else:
        shape = jax.ShapeDtypeStruct((sum(m for m, _ in form.space), k), x[0].dtype)
        at = host_call(functools.partial(_least_places, kind), shape, *map(constant, x))
    return form.values(form.columns(x), at)


def _least_places(kind: str, *x: Float[np.ndarray, "nodes k"]) -> BernsteinForms:
    form = form_of(kind)

    def found(*x: np.ndarray) -> np.ndarray:
        components = [np.asarray(component, float) for component in x]
        columns = form.columns(components)
        values = form.determinant(columns)
        sign = np.where(form.mean(values) < 0, -1.0, 1.0)
        return form.inside(
            bounds(form.space, sign * values, form.round_off(components, columns), DEPTH).at
        )

    with np.errstate(all="ignore"):  # coordinates may be NaN
        return in_blocks(
            np, found, *x, size=max(1, ROOM // bernstein.count_coefficients(form.space))
        ).astype(x[0].dtype)
