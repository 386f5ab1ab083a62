"""Periodic patches, as files name them."""

import jaxmorph as jm

from ._format import source_of
from .openfoam.case import NAME
from .openfoam.cyclic import cyclic_pairs


def periodic(mesh: jm.Mesh) -> tuple[jm.Periodic, ...]:
    """Lists the periodic patches that a mesh's file names: the `cyclic` ones of an OpenFOAM case.

    **Arguments:**

    - `mesh`: what `read` returned.

    **Returns:** pairs for `prepare(..., periodic=)`; none for other formats.
    """
    source = source_of(mesh, NAME)
    if source is None:
        return ()
    return tuple(jm.Periodic(first.name, second.name) for first, second in cyclic_pairs(source.content.topology))
