"""The result of `choose`, and the rule by which it picks a row of its table."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .._methods.base import AbstractMethod
from .._plan.plan import Plan

COLUMNS = ("leaves", "sources", "radius", "fit", "error", "rounding", "inverted", "jacobian", "angle", "seconds")

WORTH, NEAR = 0.8, 1.0
"""Share of the best Jacobian ratio that the chosen row has, and degrees beyond the best angle."""


@dataclasses.dataclass(frozen=True)
class Choice:
    """Result of `choose`: the `method`, its `plan`, and a table of all trials (`str`).

    `chosen` is the method's row of `table`. Each row has

    - `method`: its name; radial functions are `thin plate`, `Wendland C2` and `fitted`;
    - `leaves`: leaves of the k-d tree on the moving nodes, None for other methods;
    - `sources`: how many control points in all, None without any;
    - `radius`: the radius of the Wendland C2 function, None for other functions;
    - `fit`: whether the field is fitted to the wall, `FittedRBF`, instead of interpolating;
    - `error`: the coarse field's error on the surface, relative to the largest displacement: root
      mean square over surface and motions; None for other methods;
    - `rounding`: the error by rounding in float64, also relative to the largest displacement; None
      with the fit;
    - `inverted`: inverted cells in all motions;
    - `jacobian`: the smallest Jacobian ratio in any; NaN where the row was refused;
    - `angle`: degrees by which first grid lines leave their angle to the wall, mean over nodes and
      motions. It is NaN where no cell has a side on the wall;
    - `seconds`: CPU time of one compiled `deform`;
    - `refused`: why `prepare` refused or the mesh is too large, or None.
    """

    method: AbstractMethod
    plan: Plan
    table: tuple[dict[str, Any], ...]
    chosen: int

    def __str__(self) -> str:
        rows = [COLUMNS, *([_shown(row[name]) for name in COLUMNS] for row in self.table)]
        names = [" method", *(("*" if i == self.chosen else " ") + row["method"] for i, row in enumerate(self.table))]
        width = max(map(len, names))
        lines = [
            f"{name:<{width}}" + "".join(f"{cell:>10}" for cell in row) for name, row in zip(names, rows, strict=True)
        ]
        return "\n".join([*lines, *(f"{row['method']}: {row['refused']}" for row in self.table if row["refused"])])


def _shown(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def best(rows: Sequence[Mapping[str, Any]], tolerance: float) -> int:
    """Picks the row of a table by the rule in the docstring of `choose`."""
    usable = [i for i, row in enumerate(rows) if not row["refused"]]
    fewest = min(rows[i]["inverted"] for i in usable)
    sound = [i for i in usable if rows[i]["inverted"] == fewest]
    sound = [i for i in sound if rows[i]["fit"] or not (rows[i]["error"] or 0) > tolerance] or sound
    ratios = np.nan_to_num([rows[i]["jacobian"] for i in sound], nan=-np.inf)
    most = ratios.max()
    worth = [i for i, ratio in zip(sound, ratios, strict=True) if ratio >= most - (1 - WORTH) * abs(most)] or sound
    angles = np.nan_to_num([rows[i]["angle"] for i in worth], nan=np.inf)  # inf everywhere: no cell lies on the wall
    return next(i for i, angle in zip(worth, angles, strict=True) if angle <= angles.min() + NEAR)
