"""Derivatives by design variables as files."""

import csv
import io
import json
import os
import pathlib

import jax
import numpy as np
from jaxtyping import PyTree

from jaxmorph._host.package.arguments import checked
from jaxmorph._host.package.files import complete, output_path
from jaxmorph.shapes import names

from .._host.package.text import GRADIENTS


@checked
def write_gradient(path: str | os.PathLike[str], parameters: PyTree, gradient: PyTree) -> None:
    """Writes design variables by name, each with its value and its derivative.

    Names come from `shapes.names`. A table (.csv) has the columns `variable`, `value` and
    `dJ_dvalue`; JSON has an object for each name, with `value` and `dJ_dvalue`. Numbers that are
    not finite are `null` in JSON.

    **Arguments:**

    - `path`: the file.
    - `parameters`: what a shape takes.
    - `gradient`: dJ/d(parameters), as `shapes.pullback` gives it.

    **Raises:** `ValueError` for another ending, and for a gradient of another structure.
    """
    path, variables = check_gradient_output(path), names(parameters)
    if names(gradient) != variables:
        raise ValueError(f"a gradient of {len(names(gradient))} numbers for {len(variables)} design variables.")
    values, slopes = (
        [float(number) for leaf in jax.tree.leaves(tree) for number in np.ravel(leaf)]
        for tree in (parameters, gradient)
    )
    stream = io.StringIO()
    if path.suffix.lower() == ".csv":
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerows([("variable", "value", "dJ_dvalue"), *zip(variables, values, slopes, strict=True)])
    else:
        rows = zip(variables, values, slopes, strict=True)
        finite = lambda number: number if np.isfinite(number) else None  # noqa: E731
        table = {name: {"value": finite(value), "dJ_dvalue": finite(slope)} for name, value, slope in rows}
        json.dump(table, stream, indent=1)
    with complete(path) as partial:
        partial.write_text(stream.getvalue(), encoding="utf-8")


@checked
def check_gradient_output(path: str | os.PathLike[str]) -> pathlib.Path:
    """Raises `ValueError` for a file that `write_gradient` cannot write; returns its path."""
    return output_path(path, *GRADIENTS)
