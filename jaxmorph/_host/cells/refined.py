"""Fine lattices in cells of high order: where they are, and the linear pieces between them."""

import functools

import numpy as np

from .lagrange import of_order
from .pieces import of_lattice
from .shape_functions import collapsed, values


@functools.cache
def places_of(kind: str, m: int) -> np.ndarray:
    """Returns the shape functions (s, nodes) of a type at a lattice of m steps."""
    lattice = of_order(kind.rstrip("0123456789"), m)
    return values(kind, collapsed(kind, lattice.reference))


@functools.cache
def steps_of(shape: str, m: int) -> dict[str, np.ndarray]:
    """Returns the linear pieces of a lattice of m steps, as rows of it, by type."""
    return {piece: np.array(rows) for piece, rows in of_lattice(of_order(shape, m)).items() if len(rows)}
