"""Periodic and symmetry patches, as files name them."""

import jaxmorph as jm

from .._host.package.arguments import checked
from ._format import Source


@checked
def periodic(mesh: jm.Mesh) -> tuple[jm.Periodic, ...]:
    """Lists a file's periodic patches: OpenFOAM's `cyclic`, CGNS's periodic interfaces.

    **Arguments:**

    - `mesh`: what `read` returned.

    **Returns:** pairs for `prepare(..., periodic=)`; none for other formats.
    """
    return mesh.source.periodic if isinstance(mesh.source, Source) else ()


@checked
def symmetry(mesh: jm.Mesh) -> tuple[str, ...]:
    """Lists a file's symmetry patches: OpenFOAM's `symmetry` and `symmetryPlane`, axes of wedges.

    In CGNS these are of the type `BCSymmetryPlane`, their own or their family's.

    **Arguments:**

    - `mesh`: what `read` returned.

    **Returns:** names for `prepare(..., symmetry=)`; none for other formats.
    """
    return mesh.source.symmetry if isinstance(mesh.source, Source) else ()
