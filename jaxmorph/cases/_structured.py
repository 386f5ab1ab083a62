"""Parts of all structured meshes: ids in a block, the cells between them, spacings that grow."""

from collections.abc import Callable
from typing import cast

import numpy as np
from scipy.optimize import brentq

from .._host.package.arguments import between


def ids_of(*shape: int) -> np.ndarray:
    """Numbers the nodes of a block of the given shape, the last index running fastest."""
    return np.arange(np.prod(shape)).reshape(shape)


def quads(ids: np.ndarray) -> np.ndarray:
    """Makes the cells (k, 4) between the nodes of a block, counter-clockwise.

    Rows run along y, columns along x.
    """
    return np.stack([ids[:-1, :-1], ids[:-1, 1:], ids[1:, 1:], ids[1:, :-1]], axis=-1).reshape(-1, 4)


def hexahedra(ids: np.ndarray) -> np.ndarray:
    """Makes the cells (k, 8) between the nodes of a block.

    Layers run along z, rows along y, columns along x.
    """
    floor, lid = ids[:-1], ids[1:]
    return np.concatenate([np.stack([quads(layer) for layer in part]) for part in (floor, lid)], axis=-1).reshape(-1, 8)


def geometric(cells: int, first: float, samples: int | None = None) -> np.ndarray:
    """Divides [0, 1] into `cells` that grow by a constant factor from `first`.

    It is even where `first` is 1 / cells or more. With `samples` the growth is that of `cells`, and
    so many cells sample it.
    """
    samples = cells if samples is None else samples
    between("first_cell", first, 0)
    if first * cells >= 1:
        return np.linspace(0, 1, samples + 1)
    growth = root(lambda beta: np.log(np.expm1(beta / cells) / np.expm1(beta) / first), 1e-9, 700.0)
    return np.expm1(growth * np.linspace(0, 1, samples + 1)) / np.expm1(growth)


def two_sided(cells: int, first: float) -> np.ndarray:
    """Divides [0, 1] into `cells` by a hyperbolic tangent.

    The first and the last cell are about `first` high.
    """
    between("first_cell", first, 0)
    if first * cells >= 1:
        return np.linspace(0, 1, cells + 1)

    def missing(delta):
        return np.log((1 - np.tanh(delta * (1 - 2 / cells)) / np.tanh(delta)) / 2 / first)

    delta = root(missing, 1e-6, 18.0)
    share = 0.5 + 0.5 * np.tanh(np.linspace(-delta, delta, cells + 1)) / np.tanh(delta)
    share[[0, -1]] = 0, 1
    return share


def root(function: Callable[[float], float], lower: float, upper: float) -> float:
    """Finds where a function crosses zero, to the last digits of a spacing."""
    return float(cast(float, brentq(function, lower, upper, xtol=1e-14)))
