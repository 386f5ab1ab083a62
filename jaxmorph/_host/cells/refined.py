"""Fine lattices in cells of high order: where they are, and the linear pieces between them."""

import functools

import numpy as np

from .lagrange import Lagrange, _cell
from .pieces import _of_lattice
from .shape_functions import collapsed, values


def lattice_of(shape: str, m: int) -> Lagrange:
    """Returns the lattice of m steps along each edge of a shape."""
    return _cell(shape, m, True)


@functools.cache
def places_of(kind: str, m: int) -> np.ndarray:
    """Returns the shape functions (s, nodes) of a type at a lattice of m steps."""
    lattice = lattice_of(kind.rstrip("0123456789"), m)
    return values(kind, collapsed(kind, lattice.reference))


@functools.cache
def steps_of(shape: str, m: int) -> dict[str, np.ndarray]:
    """Returns the linear pieces of a lattice of m steps, as rows of it, by type."""
    return {piece: np.array(rows) for piece, rows in _of_lattice(lattice_of(shape, m)).items() if len(rows)}
