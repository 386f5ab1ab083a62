"""The report of `proof`."""

import dataclasses
import re
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from ..._host.package.arguments import checked, whole

WORST = 5
"""Cells that the table lists."""


@dataclasses.dataclass(frozen=True, eq=False)
class Proof:
    """Proves of each of k cells that it folds nowhere inside, or shows where it folds.

    det J is that of the map from the reference cell, in the handedness of the mesh: positive where
    the cell is not folded. Cells stand one type after another, as in `mesh.cells`.

    - `lower`, `upper`: the least det J of the cell is between these, round-off included.
    - `size`: mean of det J over the undeformed cell, without sign: its volume over the volume of
      the reference cell.
    - `margin`: `lower` over `size`. It is 1 for an undeformed simplex, parallelogram or
      parallelepiped.
    - `is_valid`: `lower` is positive, so the cell folds nowhere.
    - `is_invalid`: `upper` is negative, and so is det J, evaluated at `reference`. Coordinates that
      are NaN count as well.
    - `is_unknown`: neither. `is_flat`: unknown cells whose det J touches zero to round-off, which
      no depth decides.
    - `reference`, `near`: where det J is `upper`, in the reference cell and in space (k, d).
    - `time`: when, from 0 at `base` to 1 at `points`; None without `base`. Bounds then hold for the
      whole motion.
    - `types`: type and number of cells; `depth`: how often cells were cut where the sign was open.
    - `ids`: the file's number of each cell, `Mesh.cell_ids`, by which tables and messages name it.
    - `counted`: False for boundary elements, which have no det J; their numbers are NaN.

    Reference cells have corners at 0 and 1: a triangle or tetrahedron is below the diagonal, a
    pyramid's apex is above its first corner. A piece of a polyhedron is valid or unknown: a
    polyhedron whose piece is folded may itself be sound.
    """

    lower: Float[np.ndarray, " k"]
    upper: Float[np.ndarray, " k"]
    size: Float[np.ndarray, " k"]
    is_valid: Bool[np.ndarray, " k"]
    is_invalid: Bool[np.ndarray, " k"]
    is_flat: Bool[np.ndarray, " k"]
    reference: Float[np.ndarray, "k d"]
    near: Float[np.ndarray, "k d"]
    time: Float[np.ndarray, " k"] | None
    counted: Bool[np.ndarray, " k"]
    ids: Int[np.ndarray, " k"]
    types: tuple[tuple[str, int], ...]
    depth: int

    @property
    def margin(self) -> Float[np.ndarray, " k"]:
        """The lower bound over the size of the undeformed cell."""
        return self.lower / np.where(self.size > 0, self.size, 1)

    @property
    def is_unknown(self) -> Bool[np.ndarray, " k"]:
        """Cells that are neither valid nor invalid."""
        return self.counted & ~self.is_valid & ~self.is_invalid

    @property
    def count(self) -> int:
        """Number of cells that count."""
        return int(self.counted.sum())

    @property
    def valid(self) -> int:
        """Number of valid cells."""
        return int(self.is_valid.sum())

    @property
    def invalid(self) -> int:
        """Number of invalid cells."""
        return int(self.is_invalid.sum())

    @property
    def unknown(self) -> int:
        """Number of cells that are neither."""
        return int(self.is_unknown.sum())

    @property
    def from_start(self) -> int:
        """Number of cells that are invalid where the motion begins; 0 without a motion."""
        return 0 if self.time is None else int((self.is_invalid & (self.time == 0)).sum())

    @property
    def min_margin(self) -> float:
        """The smallest margin; NaN where a coordinate is."""
        return float(self.margin[self.counted].min())

    @checked
    def worst(self, k: int = WORST) -> np.ndarray:
        """Lists the ids of the worst cells: invalid, then unknown, then of the smallest margin.

        **Raises:** `ValueError` for a `k` that is negative or no whole number.
        """
        whole("k", k, 0)
        ids = np.flatnonzero(self.counted)
        rank = np.where(self.is_invalid, 0, np.where(self.is_valid, 2, 1))[ids]
        value = np.where(self.is_invalid, self.upper / np.where(self.size > 0, self.size, 1), self.margin)[ids]
        return ids[np.lexsort((np.where(np.isnan(value), -np.inf, value), rank))][:k]

    def raise_if_unproven(self) -> None:
        """Raises `ValueError` for invalid or unknown cells: how many, and where the first is."""
        if self.valid == self.count:
            return
        first = self.worst(1)[0]
        start = f", {self.from_start} from the start" if self.from_start else ""
        cure = "Try smaller steps or `improve`." if self.invalid else "Try a larger `depth`."
        raise ValueError(
            f"{self.invalid} of {self.count} cells fold inside{start}, {self.unknown} are not proven, first cell {self.ids[first]} "
            f"({self.type_of(first)}) near ({', '.join(_numbers(self.near[first]))}). {cure}"
        )

    def type_of(self, cell: int | np.integer) -> str:
        """Names the type of a cell."""
        ends = np.cumsum([count for _, count in self.types])
        return self.types[int(np.searchsorted(ends, cell, side="right"))][0]

    def __repr__(self) -> str:
        return f"Proof({self.valid} valid, {self.invalid} invalid, {self.unknown} unknown)"

    def __str__(self) -> str:
        when = "" if self.time is None else " during the motion"
        lines = [f"{self.count} cells: {self.valid} proven valid, {self.invalid} invalid, {self.unknown} unknown"]
        if self.from_start:
            lines.append(f"{self.from_start} of them are invalid from the start of the motion.")
        if flat := int((self.is_flat & self.counted).sum()):
            lines.append(f"{flat} of the unknown have det J = 0 to round-off: no depth decides them.")
        lines.append(f"least det J{when} over the undeformed cell's mean, at depth {self.depth}:")
        time = "" if self.time is None else f"{'time':<5}"
        lines.append(f"{'cell':<8}{'type':<10}{'at least':>9}{'at most':>9} {time}{'inside':<15}near")
        for cell in self.worst():
            size = self.size[cell] if self.size[cell] > 0 else 1
            time = "" if self.time is None else f"{_short(self.time[cell]):<5}"
            inside, near = " ".join(map(_short, self.reference[cell])), " ".join(_numbers(self.near[cell]))
            numbers = f"{self.lower[cell] / size:>9.2g}{self.upper[cell] / size:>9.2g}"
            kind = re.sub("^(tri|tet|hex)[a-z]*", r"\1", self.type_of(cell))
            lines.append(f"{self.ids[cell]:<8}{kind:<10}{numbers} {time}{inside:<15}{near}")
        return "\n".join(lines)


def _short(share: Any) -> str:
    """Writes a number from 0 to 1 without a leading zero."""
    return f"{share + 0.0:.2g}".removeprefix("0") or "0"


def _numbers(place: np.ndarray) -> list[str]:
    place = np.where(np.abs(place) < 1e-4 * np.abs(place).max(), 0.0, place)
    return [f"{x:.3g}" for x in place.tolist()]
