"""Plans for the motion solver in `native/openfoam`: of a case, and of each of its parts."""

import os
import pathlib
from typing import Any

import numpy as np

from jaxmorph import Layer, Mesh, Plan, export
from jaxmorph._host.package.arguments import checked
from jaxmorph._host.package.files import named

from .._format import source_of
from .case import NAME, content_of
from .parts import Decomposed, global_nodes

PLAN = "jaxmorph.plan"


@checked
def export_case(path: str | os.PathLike[str], mesh: Mesh, plan: Plan) -> list[pathlib.Path]:
    """Writes `constant/jaxmorph.plan` for OpenFOAM's motion solver, and one in each `processor*`.

    ```python
    mesh = io.read("case")
    io.export_case("case", mesh, jm.prepare(mesh, "wing", ["inlet", "outlet"]))
    ```

    **Arguments:**

    - `path`: the folder of the case; of a region `case/constant/REGION`.
    - `mesh`: what `io.read(path)` returned.
    - `plan`: what `prepare` made of it, as `jm.export` takes it.

    **Returns:** the files. **Raises:** `ValueError` as `jm.export` does, for a mesh of another
    source, for a case between wedges, and for parts of another mesh.
    """
    place, content = pathlib.Path(path), _content(path, mesh)
    plan.check_mesh(mesh)
    region = place.name if place.parent.name == "constant" else ""
    root = place.parent.parent if region else place
    file = root / "constant" / region / PLAN
    with named(file):
        export(plan, file, layer=_layer(content))
    if not (root / "processor0").is_dir():
        return [file]
    case, files = Decomposed(path), [file]
    for k in range(len(case)):
        part = case.read(k)
        ids = global_nodes(part)
        rows = ids if content.plane is None else content.plane.file_nodes()[ids]
        _check_part(case.folder(k), np.asarray(part.points), np.asarray(plan.points), rows)
        files.append(case.folder(k) / "constant" / region / PLAN)
        export(plan, files[-1], nodes=rows, layer=_layer(content_of(part)))
    return files


def _content(path: str | os.PathLike[str], mesh: Mesh) -> Any:
    if not pathlib.Path(path).is_dir():
        raise ValueError(f"{path}: no folder of an OpenFOAM case.")
    source = source_of(mesh, NAME)
    if source is None or source.content is None:
        raise ValueError("`mesh` was not read from an OpenFOAM case: use jm.export(plan, path).")
    if source.content.plane is not None and source.content.plane.kind == "wedge":
        raise ValueError(f"{path}: a case between wedges; OpenFOAM moves both planes, and a plan moves one.")
    return source.content


def _layer(content: Any) -> Layer | None:
    if content.plane is None:
        return None
    first, second = np.abs(content.plane.axes[0]).argmax(axis=1).tolist()
    return Layer(content.plane.file_nodes(), (first, second))


def _check_part(folder: pathlib.Path, part: np.ndarray, whole: np.ndarray, rows: np.ndarray) -> None:
    away = np.abs(part - whole[rows]).max(axis=1) if rows.max(initial=-1) < len(whole) else np.full(len(part), np.inf)
    wrong = away > 1e-9 * np.abs(whole).max()  # parts are written as text
    if wrong.any():
        raise ValueError(
            f"{folder}: {wrong.sum()} of {len(part)} points lie elsewhere than in the case, first point {wrong.argmax()}: the "
            "parts are of another mesh. Run decomposePar -force."
        )
