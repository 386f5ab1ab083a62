"""Boxes of free-form deformation as files."""

import os
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxmorph._host.package.arguments import checked
from jaxmorph._host.package.files import input_path
from jaxmorph.shapes import FreeForm, Hexahedron

from .._host.package.text import read

PLACES = ("low", "high"), ("corners",)
"""Names that say where a box lies: two corners of one along the axes, or all of them."""

NEEDED, OPTIONAL = ("points", "moved"), ("degree", "continuity")

MOST = 10**6
"""Control points that a box may have."""


@checked
def read_box(
    source: str | os.PathLike[str] | Mapping[str, Any], dimensions: int
) -> tuple[FreeForm | Hexahedron, Float[np.ndarray, "*counts d"]]:
    """Reads a box of control points, and the displacements of its control points.

    The table has `low` and `high` (two corners of a box along the axes), or `corners` (eight, in
    2-D four, as `Hexahedron` takes them). It has `points` (numbers of control points), and a list
    `moved`. Each of `moved` is a table of `at` (a control point's numbers, from 0) and `by` (its
    displacement). `degree` and `continuity` are as in `FreeForm`.

    **Arguments:**

    - `source`: a TOML file, or its table.
    - `dimensions`: of the mesh, 2 or 3.

    **Returns:** the box, and displacements (*counts, d).

    **Raises:** `ValueError` for what is no such table, does not fit the dimensions, or moves a
    control point that is held.
    """
    d, where = dimensions, "--box" if isinstance(source, Mapping) else str(source)
    table = dict(source) if isinstance(source, Mapping) else read(where, input_path(source).read_bytes())
    places = next((names for names in PLACES if set(table) & set(names)), PLACES[0])
    needed = {*places, *NEEDED}
    if not needed <= set(table) <= {*needed, *OPTIONAL} or not isinstance(table["moved"], list):
        listed = ", ".join(table) or "nothing"
        raise ValueError(f"{where}: low and high or corners, points and a list moved expected, found {listed}.")
    counts = _numbers(where, "points", table["points"], d)
    if not (counts >= 2).all() or (counts != np.floor(counts)).any():
        raise ValueError(f"{where}: points must be 2 or more whole numbers of control points.")
    if counts.prod() > MOST:
        raise ValueError(f"{where}: points = {table['points']} are {counts.prod():.3g} control points; {MOST} at most.")
    options = {name: table[name] for name in OPTIONAL if name in table}
    if any(type(value) is not int for value in options.values()):
        raise ValueError(f"{where}: degree and continuity are whole numbers, found {options}.")
    try:
        box = _placed(where, table, counts.astype(int).tolist(), options)
    except ValueError as error:
        message = str(error).removeprefix(f"{where}: ")
        raise ValueError(f"{where}: {message}") from None
    control = np.zeros((*box.counts, d))
    for entry in table["moved"]:
        if not isinstance(entry, dict) or set(entry) != {"at", "by"}:
            raise ValueError(f"{where}: each of moved has at and by, found {entry}.")
        at = _numbers(where, "at", entry["at"], d)
        if (at < 0).any() or (at >= counts).any() or (at != np.floor(at)).any():
            raise ValueError(f"{where}: at = {entry['at']} is none of the control points 0 to {counts - 1}.")
        if not box.free[tuple(at.astype(int))]:
            raise ValueError(f"{where}: control point {entry['at']} is held by continuity = {box.continuity}.")
        control[tuple(at.astype(int))] += _numbers(where, "by", entry["by"], d)
    return box, control


def _placed(where: str, table: dict[str, Any], counts: list[int], options: dict[str, int]) -> FreeForm | Hexahedron:
    d = len(counts)
    if "corners" in table:
        rows = table["corners"] if isinstance(table["corners"], list) else [table["corners"]]
        return Hexahedron(np.array([_numbers(where, "corners", row, d) for row in rows]), counts, **options)
    low, high = (_numbers(where, name, table[name], d) for name in PLACES[0])
    if not (low < high).all():
        raise ValueError("low must be below high.")
    return FreeForm(low, np.diag(high - low), counts, **options)


def _numbers(where: str, name: str, values: Any, d: int) -> Float[np.ndarray, " d"]:
    good = isinstance(values, list) and len(values) == d and all(type(value) in (int, float) for value in values)
    if not good or not np.isfinite(values).all():
        raise ValueError(f"{where}: {name} needs {d} numbers for a mesh in {d}-D, found {values}.")
    return np.array(values, float)
