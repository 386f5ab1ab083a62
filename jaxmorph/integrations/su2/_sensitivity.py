"""Sensitivities as SU2's adjoint solvers leave them: by nodes, and by the angle of attack."""

import dataclasses
import os
import pathlib
import re

import numpy as np
from jaxtyping import Float

from jaxmorph import io, shapes
from jaxmorph.extend import checked, complete, finite_array, input_path, output_path

from ._config import Config
from ._options import Options

FILES = {
    "SOLUTION_ADJ_FILENAME": "solution_adj",
    "VOLUME_SENS_FILENAME": "volume_sens",
    "SURFACE_SENS_FILENAME": "surface_sens",
}
"""Options that name a file of sensitivities, and SU2's default names."""

EXTENSIONS = {
    **{"DRAG": "cd", "LIFT": "cl", "SIDEFORCE": "csf", "EFFICIENCY": "eff", "THRUST": "ct", "TORQUE": "cq"},
    **{f"MOMENT_{axis}": f"cm{axis.lower()}" for axis in "XYZ"},
    **{f"FORCE_{axis}": f"cf{axis.lower()}" for axis in "XYZ"},
    **{"EQUIVALENT_AREA": "ea", "NEARFIELD_PRESSURE": "nfp", "FIGURE_OF_MERIT": "merit"},
}
"""SU2's suffixes of an adjoint file's name, by the objective."""

NORMAL = ("surface_sensitivity", "sensitivity")
"""Columns of the continuous adjoint's derivative by a motion into the body."""
ANGLE = 4
"""Place of the derivative by the angle of attack among the eight numbers behind a restart."""


@dataclasses.dataclass(frozen=True, eq=False)
class Sensitivity:
    """Derivatives of an objective from a file.

    - `path`: the file.
    - `by_nodes`: by the positions of all nodes (n, d), or of the moving ones (m, d).
    - `by_angle`: by the angle of attack, None where the file does not say.
    """

    path: pathlib.Path
    by_nodes: Float[np.ndarray, "k d"]
    by_angle: float | None


@checked
def read_sensitivity(config: Config, path: str | os.PathLike[str] | None = None) -> Sensitivity:
    """Reads the sensitivities that a config file is about.

        sensitivity = su2.read_sensitivity(su2.read_config("config.cfg"))

    A discrete adjoint gives sensitivities of all nodes, or of the surface's nodes after SU2_DOT.
    With `MATH_PROBLEM= CONTINUOUS_ADJOINT` the column `Surface_Sensitivity` is a derivative along
    the wall's normals.

    **Arguments:**

    - `config`: what `read_config` returned.
    - `path`: the file. Default: the first existing one of `SOLUTION_ADJ_FILENAME`,
      `VOLUME_SENS_FILENAME` and `SURFACE_SENS_FILENAME`, or `SURFACE_ADJ_FILENAME` of a continuous
      adjoint. Endings, and SU2's suffix of the objective (`_cd`), may be missing in the name.

    **Raises:** `ValueError` for no file, and as `io.read_sensitivity` does.
    """
    is_normal = config.options.text("MATH_PROBLEM").upper() == "CONTINUOUS_ADJOINT"
    file = input_path(path) if path is not None else _file(config.options, is_normal)
    by_nodes = _by_normals(config, file) if is_normal else None
    if by_nodes is None:
        by_nodes = io.read_sensitivity(file, config.mesh, moving=config.mesh.patch(*config.moving))
    return Sensitivity(file, by_nodes, _by_angle(file))


def _file(options: Options, is_normal: bool) -> pathlib.Path:
    objective = options.text("OBJECTIVE_FUNCTION", "DRAG")
    kind = "combo" if "," in objective else EXTENSIONS.get(objective.strip("() "), "*")
    defaults = {"SURFACE_ADJ_FILENAME": "surface_adjoint"} if is_normal else FILES
    names = {option: options.path.parent / options.text(option, default) for option, default in defaults.items()}
    for name in names.values():
        if found := _present(name, kind):
            return found
    tried = ", ".join(f"{option}= {name.name}" for option, name in names.items())
    raise ValueError(
        f"{options.path}: no file of sensitivities is there ({tried}), with _{kind} or without: give --sensitivity."
    )


def _present(name: pathlib.Path, kind: str) -> pathlib.Path | None:
    """Finds the file of a name, with or without the objective and an ending; one alone for `*`."""
    is_full = name.suffix in (".dat", ".csv")
    stem, ending = (name.stem, name.suffix) if is_full else (name.name, ".dat")
    endings = dict.fromkeys([ending, ".csv", ".dat"])
    for pattern in (f"{stem}_{kind}", stem):
        found = [file for ending in endings for file in sorted(name.parent.glob(pattern + ending))]
        if len(found) == 1 or (found and "*" not in pattern):
            return found[0]
    return None


def _by_normals(config: Config, file: pathlib.Path) -> Float[np.ndarray, "m d"] | None:
    """Reads derivatives along the wall's normals, which point into the flow; None without them."""
    with file.open("rb") as stream:
        names = [name.strip(b"\"' \r\n\t").decode(errors="replace").lower() for name in stream.readline().split(b",")]
    column = next((names.index(name) for name in NORMAL if name in names), None)
    if column is None:
        return None
    try:
        rows = np.loadtxt(file, delimiter=",", skiprows=1, usecols=(0, column), ndmin=2)
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from None
    if not np.isfinite(rows).all():
        raise ValueError(f"{file}: values that are not finite.")
    nodes = config.mesh.patch(*config.moving)
    missing = np.setdiff1d(nodes, rows[:, 0])
    if len(missing):
        raise ValueError(f"{file}: {len(missing)} of {len(nodes)} nodes of DV_MARKER are missing, first {missing[0]}.")
    normals = shapes.wall_normals(config.mesh, *config.moving)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    slopes = dict(rows.tolist())
    values = np.array([slopes[node] for node in nodes.tolist()])
    return -values[:, None] * normals / np.where(length > 0, length, 1)


def _by_angle(file: pathlib.Path) -> float | None:
    """Finds the derivative by the angle of attack: behind the rows, or in the file .meta beside."""
    sizes = np.fromfile(file, "<i4", count=5)
    is_restart = len(sizes) == 5 and sizes[0] == 535532
    begin = 20 + 33 * int(sizes[1]) + 8 * int(sizes[1]) * int(sizes[2]) if is_restart else -1
    if begin > 0 and file.stat().st_size == begin + 4 + 64:
        return float(np.fromfile(file, "<f8", count=8, offset=begin + 4)[ANGLE])
    for text in ([] if begin > 0 else [file]) + [file.with_suffix(".meta")]:
        found = re.search(rb"SENS_AOA\s*=\s*([-+.\deE]+)", text.read_bytes()) if text.is_file() else None
        if found:
            return float(found[1])
    return None


@checked
def write_gradient(path: str | os.PathLike[str], gradient: Float[np.ndarray, " n"], objective: str = "DRAG") -> None:
    """Writes a derivative a line below a line with the name of the objective: `of_grad.dat`.

    **Arguments:**

    - `path`: the file.
    - `gradient`: (n,), in the order of the design variables.
    - `objective`: its name, as `OBJECTIVE_FUNCTION` has it.

    **Raises:** `ValueError` for values that are not finite, and a missing folder.
    """
    values = finite_array("gradient", gradient, (None,))
    lines = [f"{objective} gradient ", *map(repr, values.astype(float).tolist()), ""]
    with complete(output_path(path)) as partial:
        partial.write_text("\n".join(lines), encoding="utf-8")
