"""Airfoils on the command line: bumps, class and shape functions, on either side."""

from typing import Any

import numpy as np

from jaxmorph import Mesh, shapes
from jaxmorph._host.package.files import input_path

from .._host.package.text import read
from ._groups import as_json

SIDES = ("upper", "lower")
CHORD = ("nose", "tail", "up")


def bumps(flag: str, source: str, mesh: Mesh, patches: tuple[str, ...]) -> dict[str, tuple[shapes.Chain, Any]]:
    """Makes the shape of `--hicks-henne`: lists of [centre, height] by side."""
    table = _table(flag, source, ("width",))
    bumps = {side: _numbers(flag, table, side, (None, 2)) for side in SIDES if side in table}
    width = table.get("width", 3.0)
    chord, masks = _sides(flag, table, mesh, patches)
    parts = {side: shapes.HicksHenne(rows[:, 0], width, chord=chord) for side, rows in bumps.items()}
    chain = shapes.Chain({side: shapes.Part(part, masks[side]) for side, part in parts.items()})
    return {flag: (chain, {side: rows[:, 1] for side, rows in bumps.items()})}


def class_functions(
    flag: str, source: str, mesh: Mesh, patches: tuple[str, ...]
) -> dict[str, tuple[shapes.Chain, Any]]:
    """Makes the shape of `--cst`: weights and the ordinate of the edge by side."""
    table = _table(flag, source, ("exponents",))
    numbers = {side: _numbers(flag, table, side, (None,)) for side in SIDES if side in table}
    for side, weights in numbers.items():
        if len(weights) < 3:
            raise ValueError(
                f"--{flag}: {side} has {len(weights)} numbers; two weights or more are expected, then the ordinate of the edge."
            )
    exponents = tuple(_numbers(flag, {"exponents": table.get("exponents", [0.5, 1.0])}, "exponents", (2,)).tolist())
    chord, masks = _sides(flag, table, mesh, patches)
    parts = {side: shapes.CST(len(weights) - 2, exponents, chord=chord) for side, weights in numbers.items()}
    return {flag: (shapes.Chain({side: shapes.Part(part, masks[side]) for side, part in parts.items()}), numbers)}


def _table(flag: str, source: str, more: tuple[str, ...]) -> dict[str, Any]:
    table = as_json(flag, source)
    table = read(source, input_path(source).read_bytes()) if table is None else table
    known = (*SIDES, *more, *CHORD)
    foreign = [name for name in table if name not in known]
    if foreign or not set(table) & set(SIDES):
        listed = ", ".join(table) or "nothing"
        raise ValueError(f"--{flag}: upper or lower expected, and perhaps {', '.join(known[2:])}; found {listed}.")
    return table


def _numbers(flag: str, table: dict[str, Any], name: str, shape: tuple[int | None, ...]) -> np.ndarray:
    try:
        values = np.array(table[name], float)
    except (TypeError, ValueError):
        values = np.zeros(0)
    fits = values.ndim == len(shape) and all(n in (None, m) for n, m in zip(shape, values.shape, strict=False))
    if not fits or not values.size or not np.isfinite(values).all():
        what = "a list of [centre, height]" if shape == (None, 2) else "a list of numbers"
        raise ValueError(f"--{flag}: {name} is {what}, found {str(table[name])[:60]}.")
    return values


def _sides(
    flag: str, table: dict[str, Any], mesh: Mesh, patches: tuple[str, ...]
) -> tuple[shapes.Chord, dict[str, np.ndarray]]:
    """Finds the chord, and by the normals of the wall the nodes on either side."""
    nodes, d = mesh.patch(*patches), mesh.points.shape[1]
    ends = {name: _numbers(flag, table, name, (d,)) for name in CHORD if name in table}
    if ends:
        if not {"nose", "tail"} <= set(ends):
            raise ValueError(f"--{flag}: a chord has a nose and a tail; found {', '.join(ends)} alone.")
        chord = shapes.Chord(**ends)
    elif d == 2:
        chord = shapes.Chord.along(np.asarray(mesh.points)[nodes])
    else:
        raise ValueError(f"--{flag}: a wall in 3-D needs its chord: nose, tail and up, three numbers each.")
    upper = shapes.wall_normals(mesh, *patches) @ np.asarray(chord.up) >= 0
    return chord, {"upper": upper, "lower": ~upper}
