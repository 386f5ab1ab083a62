"""The least det J of curved cells: the host finds where it is, traced code computes it there."""

import functools

import jax
import numpy as np
from jaxtyping import Float

from ..._host.cells.topology import DIMENSION, HIGH_ORDER
from ..._kernels.callback import host_call
from ..._kernels.values import Either, constant, namespace
from ..batches import in_blocks
from . import bernstein
from .form import form_of
from .search import ROOM, bounds

DEPTH = 4
"""Number of cuts of a cell where its sign is open, as in `proof`."""


def has_least(kind: str, d: int) -> bool:
    """Checks whether cells of a type are curved and fill a space of d dimensions."""
    return kind in HIGH_ORDER and DIMENSION[kind] == d


def least_jacobian(kind: str, x: list[Float[Either, "nodes k"]]) -> Float[Either, " k"]:
    """Computes the least det J of curved cells, in the handedness of their volume.

    `x` are the components of the nodes, relative to the first one. Where det J is positive all
    over, it is the least at a corner. Where it is not, the place is that of `proof`: a negative
    value is found wherever the bounds say `invalid`.
    """
    form, k = form_of(kind), x[0].shape[1]
    if namespace(x[0]) is np:
        at = _places(kind, *x)
    else:
        shape = jax.ShapeDtypeStruct((sum(m for m, _ in form.space), k), x[0].dtype)
        at = host_call(functools.partial(_places, kind), shape, *map(constant, x))
    return form.values(form.columns(x), at)


def _places(kind: str, *x: Float[np.ndarray, "nodes k"]) -> Float[np.ndarray, "f k"]:
    """Finds where det J is least, among the factors of the reference cell."""
    size = max(1, ROOM // bernstein.count(form_of(kind).space))
    with np.errstate(all="ignore"):  # coordinates may be NaN
        return in_blocks(np, functools.partial(_found, kind), *x, size=size).astype(x[0].dtype)


def _found(kind: str, *x: Float[np.ndarray, "nodes k"]) -> Float[np.ndarray, "f k"]:
    form, components = form_of(kind), [np.asarray(component, float) for component in x]
    columns = form.columns(components)
    values = form.determinant(columns)
    sign = np.where(form.mean(values) < 0, -1.0, 1.0)
    return form.inside(bounds(form.space, sign * values, form.round_off(components, columns), DEPTH).at)
