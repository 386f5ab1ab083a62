"""IDWarp's mesh objects for complex steps: what is imaginary is a step, or a change by it."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Complex

from ._mesh import USMesh
from ._multi import MultiUSMesh


class USMesh_C(USMesh):
    """`USMesh` with complex coordinates, called as `idwarp.USMesh_C`.

    The real parts move the mesh as `USMesh` does. The imaginary parts come from the derivative, as
    in `warpDerivFwd`, so a step may be as small as 1e-200.
    """

    _step: np.ndarray | None = None

    def getSurfaceCoordinates(self) -> Complex[np.ndarray, "k 3"]:
        """Returns the surface's points that this process has, with their steps."""
        points = super().getSurfaceCoordinates()
        return points + 1j * (np.zeros_like(points) if self._step is None else self._step)

    def setSurfaceCoordinates(self, coordinates: Any) -> None:
        """Sets the surface's points and steps, as `getSurfaceCoordinates` orders them."""
        values = np.asarray(coordinates, complex)
        super().setSurfaceCoordinates(np.real(values))
        self._step = self._rows("coordinates", np.imag(values))

    def warpMesh(self) -> None:
        """Moves the mesh from its first place to where the surface is, with the steps."""
        super().warpMesh()
        if self._step is not None:
            self._moved = self._moved + 1j * self._defined().pushforward(self._step)


class MultiUSMesh_C(MultiUSMesh):
    """`MultiUSMesh` with complex coordinates, called as `idwarp.MultiUSMesh_C`: see `USMesh_C`."""

    _mesh_class = USMesh_C
    _number = complex

    def __init__(
        self, CGNSFile: str, optionsDict: Mapping[str, Mapping[str, Any]], comm: Any = None, debug: bool = False
    ):
        super().__init__(CGNSFile, optionsDict, comm, "D", debug)
