"""Sensitivities by nodes, as adjoint solvers write them, and derivatives by design variables."""

import csv
import io
import json
import re
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Float, Int, PyTree
from numpy import ndarray

import jaxmorph as jm
from jaxmorph import Mesh
from jaxmorph._host.package.arguments import checked, finite_array, rows_of
from jaxmorph._host.package.files import PathLike, complete, input_path, output_path
from jaxmorph._host.package.text import GRADIENTS, SENSITIVITIES

from ._displacement import read_named, read_table, sort_by_id, take_labels
from ._format import faults_of, source_of
from .openfoam.case import NAME
from .openfoam.file import load_file

NAMES = ("sensitivity_x", "sensitivity_y", "sensitivity_z")


@checked
def read_sensitivity(
    path: PathLike, mesh: Mesh, *, moving: Int[ndarray, " m"] | None = None
) -> Float[ndarray, "k d"]:
    """Reads dJ/d(points) for every node of the mesh: what `pullback` takes.

    With `moving` it may be for every node of a wall, for `shapes.project`. The file is one of

    - a table with a header that names `Sensitivity_x`, `Sensitivity_y`[, `Sensitivity_z`]: SU2's
      volume sensitivities and adjoint restarts, .csv or .dat, in text or binary;
    - a table of rows of node id and as many numbers as the mesh has dimensions, in any order, by
      the ids that `read_displacement` takes;
    - .npz of `sensitivity` (n, d), with `ids` where its rows are not in the order of the nodes;
    - for a mesh from an OpenFOAM case, a field of vectors at its points, `pointSensVec...` of
      `adjointOptimisationFoam`. It is zero off the walls, and must not be divided by areas
      (`includeSurfaceArea true`). Vectors of both planes of a 2-D case are added.

    **Arguments:**

    - `path`: the file.
    - `mesh`: the mesh of whose nodes it speaks.
    - `moving`: ids (m,) of the moving nodes. A file of these and not all nodes is then the
      sensitivity of the surface itself, such as SU2's `surface_sens.csv`.

    **Returns:** sensitivities (n, d), in the unit of J over the unit of the points; from a
    surface's file (m, d), for `moving` alone.

    **Raises:** `ValueError` for missing, foreign or duplicate nodes, and values that are not
    finite.
    """
    path = input_path(path)
    n, d = mesh.points.shape
    moving = None if moving is None else rows_of("moving", moving, n)
    with faults_of(path):
        if path.suffix.lower() == ".npz":
            ids, values, _ = read_named(path, ("sensitivity",))
        elif is_foam_file(path):
            ids = np.arange(n)
            values = read_point_vectors(path, mesh)
        else:
            ids, values = read_table(path, d, NAMES)
        wanted = np.arange(n) if moving is None or len(ids) >= n else moving
        known = (np.arange(n), f"the mesh, 0 to {n - 1}")
        return sort_by_id(ids, values, d, wanted, known, take_labels(mesh, wanted))


@checked
def write_sensitivity(
    path: PathLike, ids: Int[ndarray, " m"], values: Float[ndarray, "m d"]
) -> None:
    """Writes dJ/d(nodes) by node id: a table (.csv), or .npz of `ids` and `sensitivity`.

    **Arguments:**

    - `path`: the file.
    - `ids`, `values`: the nodes' ids, as `plan.moving`, and a row for each, as `pullback` gives.

    **Raises:** `ValueError` for another ending, bad ids, and values of another shape or that are
    not finite.
    """
    path = output_path(path, *SENSITIVITIES)
    ids = rows_of("ids", ids, 2**62)
    values = finite_array("values", values, (len(ids), 2), (len(ids), 3)).astype(float)
    if path.suffix.lower() == ".npz":
        stream = io.BytesIO()
        np.savez_compressed(stream, ids=ids, sensitivity=values)
        content = stream.getvalue()
    else:
        header = ",".join(["id", *(f"dJ_d{axis}" for axis in "xyz"[: values.shape[1]])])
        rows = [
            f"{node},{','.join(map(repr, row))}"
            for node, row in zip(ids.tolist(), values.tolist(), strict=True)
        ]
        content = "\n".join([header, *rows, ""]).encode()
    with complete(path) as partial:
        partial.write_bytes(content)


_INTERNAL = re.compile(rb"internalField\s+(nonuniform\s+List<vector>|uniform)")
_VECTORS_END = re.compile(rb"\)\s*\)\s*;")


def is_foam_file(path: Path) -> bool:
    if path.suffix == ".gz":
        return True
    with path.open("rb") as file:
        return b"FoamFile" in file.read(1 << 14)


def read_point_vectors(path: Path, mesh: Mesh) -> Float[ndarray, "n d"]:
    """Reads a `pointVectorField` for the nodes of a case's mesh; in 2-D both planes add up."""
    source = source_of(mesh, NAME)
    if source is None:
        raise ValueError("a file of OpenFOAM; it needs a mesh that was read from an OpenFOAM case.")
    file = load_file(path.parent, path.name)
    kind = file.header.get("class", "no class")
    entry = _INTERNAL.search(file.data, file.end)
    if kind != "pointVectorField" or entry is None or entry[1] == b"uniform":
        found = f"{kind}{' with one value for all points' if kind == 'pointVectorField' else ''}"
        raise file.error(f"a pointVectorField with a list of vectors expected, found {found}")
    stop = None if file.is_binary else _VECTORS_END.search(file.data, entry.end())
    data = file.data if stop is None else file.data[: stop.end()]
    values = file._replace(data=data, end=entry.end()).numbers("scalar", 3)
    content = source.content
    if len(values) != len(content.points):
        raise file.error(
            f"{len(content.points)} vectors expected, one for each point of the case, found "
            f"{len(values)}"
        )
    return values if content.plane is None else content.plane.added(values)


@checked
def write_gradient(path: PathLike, parameters: PyTree, gradient: PyTree) -> None:
    """Writes design variables by name, each with its value and its derivative.

    Names come from `shapes.names`. A table (.csv) has the columns `variable`, `value` and
    `dJ_dvalue`; JSON has an object for each name, with `value` and `dJ_dvalue`, `null` for what is
    not finite.

    **Arguments:**

    - `path`: the file.
    - `parameters`, `gradient`: what a shape takes, and dJ/d(parameters) of `shapes.pullback`.

    **Raises:** `ValueError` for another ending, and for a gradient of another structure.
    """
    path = output_path(path, *GRADIENTS)
    variables = jm.shapes.names(parameters)
    given = jm.shapes.names(gradient)
    if given != variables:
        raise ValueError(
            f"a gradient of {len(given)} numbers for {len(variables)} design variables."
        )
    trees = (jax.tree.leaves(tree) for tree in (parameters, gradient))
    rows = list(
        zip(
            variables,
            *([float(x) for leaf in tree for x in np.ravel(leaf)] for tree in trees),
            strict=True,
        )
    )
    stream = io.StringIO()
    if path.suffix.lower() == ".csv":
        csv.writer(stream, lineterminator="\n").writerows(
            [("variable", "value", "dJ_dvalue"), *rows]
        )
    else:
        keys = ("value", "dJ_dvalue")
        table = {
            name: {key: x if np.isfinite(x) else None for key, x in zip(keys, pair, strict=True)}
            for name, *pair in rows
        }
        json.dump(table, stream, indent=1)
    with complete(path) as partial:
        partial.write_text(stream.getvalue(), encoding="utf-8")
