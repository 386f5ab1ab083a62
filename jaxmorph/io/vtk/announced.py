"""What a file of VTK announces and VTK does not compare with what it has read."""

from typing import Any, NamedTuple

from jaxmorph._mesh import vtk


class Announced(NamedTuple):
    """Numbers of nodes in all cells, and of arrays in fields; None where a file does not say it."""

    nodes: int | None = None
    arrays: int | None = None

    def check(self, data: Any) -> None:
        """Raises `ValueError` for a data set that has other nodes, or fewer arrays."""
        nodes = sum(cells.GetNumberOfConnectivityIds() for cells in vtk.cell_arrays(data) if cells)
        if self.nodes not in (None, nodes):
            raise ValueError(f"{self.nodes} numbers in connectivity, {nodes} expected: a damaged file.")
        fields = (data.GetPointData(), data.GetCellData(), data.GetFieldData())
        arrays = sum(field.GetNumberOfArrays() for field in fields)
        if arrays < (self.arrays or 0):
            raise ValueError(f"{arrays} of {self.arrays} arrays were found: a damaged file, or one cut short.")
