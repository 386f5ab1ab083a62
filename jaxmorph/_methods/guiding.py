"""Methods for nodes along boundaries, and for a grid without fixed nodes."""

from .base import AbstractMethod
from .delaunay import DelaunayGraph
from .inverse_distance import InverseDistance
from .multiscale import Multiscale
from .nearwall import NearWall
from .rbf.fitted import FittedRBF
from .reconstruction import SurfaceReconstruction


def carrying() -> AbstractMethod:
    """Returns IDWarp's method, for a body whose grid nothing holds, as an overset grid."""
    return InverseDistance(rotations=True)


def guiding(method: AbstractMethod) -> AbstractMethod:
    """Returns the method that guides nodes along boundaries: the coarse field of `method`, with a
    `Multiscale` correction. Such nodes lie outside of the hull of moving and fixed nodes, where no
    graph reaches, and have no cells among themselves. Near moving and fixed nodes they follow
    exactly.
    """
    coarse = method.coarse if isinstance(method, SurfaceReconstruction) else method
    if coarse.needs_cells or isinstance(coarse, DelaunayGraph | NearWall):
        coarse = FittedRBF()
    if coarse is method and coarse.exact:
        return coarse
    layered = isinstance(method, SurfaceReconstruction) and isinstance(method.correction, NearWall)
    return SurfaceReconstruction(coarse, NearWall(Multiscale(), method.correction.width) if layered else Multiscale())
