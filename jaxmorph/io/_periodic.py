"""Periodic and symmetry patches, as files name them."""

import jaxmorph as jm

from .._host.package.arguments import checked
from ._format import Source


@checked
def periodic(mesh: jm.Mesh) -> tuple[jm.Periodic, ...]:
    """Lists the periodic patches that a mesh's file names: `cyclic` ones of an OpenFOAM case, periodic interfaces of CGNS.

    **Arguments:**

    - `mesh`: what `read` returned.

    **Returns:** pairs for `prepare(..., periodic=)`; none for other formats.
    """
    return mesh.source.periodic if isinstance(mesh.source, Source) else ()


@checked
def symmetry(mesh: jm.Mesh) -> tuple[str, ...]:
    """Lists the symmetry patches that a mesh's file names: `symmetry` and `symmetryPlane` of an OpenFOAM case, the axis of wedges.

    In CGNS these are of the type `BCSymmetryPlane`, their own or their family's.

    **Arguments:**

    - `mesh`: what `read` returned.

    **Returns:** names for `prepare(..., symmetry=)`; none for other formats.
    """
    return mesh.source.symmetry if isinstance(mesh.source, Source) else ()
