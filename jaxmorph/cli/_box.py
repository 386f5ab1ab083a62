"""The file of a free-form deformation box."""

import json
import pathlib
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxmorph.shapes import FreeForm

from ._toml import read


def read_box(given: str, d: int) -> tuple[FreeForm, Float[np.ndarray, "*counts d"]]:
    """Reads a box and the displacements of its control points from a TOML file, or from the same table as JSON text.

    The table has `low`, `high`, `points`, and a list `moved` of tables with `at` and `by`.

    Raises `ValueError` for what does not fit a mesh in `d` dimensions.
    """
    where = "--box" if given.lstrip().startswith("{") else given
    if where == "--box":
        try:
            table = json.loads(given)
        except (json.JSONDecodeError, RecursionError) as error:
            raise ValueError(f"{where}: not a table in JSON ({error}).") from None
    else:
        table = read(where, pathlib.Path(given).read_bytes())
    expected = {"low", "high", "points", "moved"}
    if set(table) != expected or not isinstance(table["moved"], list):
        raise ValueError(
            f"{where}: low, high, points and a list moved expected, found {', '.join(table) or 'nothing'}."
        )
    low, high = (_numbers(where, name, table[name], d) for name in ("low", "high"))
    counts = _numbers(where, "points", table["points"], d)
    if not (low < high).all() or not (counts >= 2).all() or (counts != np.floor(counts)).any():
        raise ValueError(f"{where}: low must be below high, and points 2 or more whole numbers of control points.")
    control = np.zeros((*counts.astype(int), d))
    for entry in table["moved"]:
        if not isinstance(entry, dict) or set(entry) != {"at", "by"}:
            raise ValueError(f"{where}: each of moved has at and by, found {entry}.")
        at = _numbers(where, "at", entry["at"], d)
        if (at < 0).any() or (at >= counts).any() or (at != np.floor(at)).any():
            raise ValueError(f"{where}: at = {entry['at']} is none of the control points 0 to {counts - 1}.")
        control[tuple(at.astype(int))] += _numbers(where, "by", entry["by"], d)
    return FreeForm(low, np.diag(high - low), counts.astype(int).tolist()), control


def _numbers(where: str, name: str, values: Any, d: int) -> Float[np.ndarray, " d"]:
    good = isinstance(values, list) and len(values) == d and all(type(value) in (int, float) for value in values)
    if not good or not np.isfinite(values).all():
        raise ValueError(f"{where}: {name} needs {d} numbers for a mesh in {d}-D, found {values}.")
    return np.array(values, float)
