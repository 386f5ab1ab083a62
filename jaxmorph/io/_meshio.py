"""Reading by meshio, for the formats that stand on it."""

try:
    import meshio
except ImportError as error:
    raise ImportError("this file format needs meshio: pip install 'jaxmorph[io]'") from error

import dataclasses
import pathlib
from typing import Any, NamedTuple

import numpy as np

from jaxmorph._mesh import exchange, export
from jaxmorph._mesh.arrays import checked_parts
from jaxmorph._mesh.exchange import Parts

from ._format import Arrays, MeshLike, faults_of

for _kind in ("pyramid13", "wedge15"):  # types that meshio reads and writes, and whose dimension it lacks
    meshio._mesh.topological_dimension.setdefault(_kind, 3)


class Block(NamedTuple):
    """Holds cells of one type, as meshio's blocks do."""

    type: str
    data: np.ndarray


@dataclasses.dataclass(frozen=True)
class Blocks:
    """A mesh as meshio has it, of any cell type: meshio's class refuses some of high order."""

    points: np.ndarray
    cells: list[Block]
    point_data: dict[str, Any] = dataclasses.field(default_factory=dict)
    cell_data: dict[str, Any] = dataclasses.field(default_factory=dict)
    cell_sets: dict[str, Any] = dataclasses.field(default_factory=dict)
    field_data: dict[str, Any] = dataclasses.field(default_factory=dict)


def to_mesh(path: pathlib.Path, mesh: Any, source: Any) -> Parts:
    """Makes a mesh as `Mesh.from_meshio` does; errors name the file."""
    with faults_of(path):
        return checked_parts(*exchange.parts(exchange.of_meshio(mesh))[:3], source)


def of_mesh(mesh: MeshLike, point_data: Arrays | None = None, cell_data: Arrays | None = None) -> meshio.Mesh:
    """Makes meshio's mesh as `Mesh.to_meshio` does."""
    return export.to_meshio(Parts(mesh.points, mesh.cells, mesh.patches, mesh.source), point_data, cell_data)
