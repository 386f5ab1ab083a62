"""Checked arrays of a mesh: coordinates, cells and patches."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from .._host.cells.topology import NODES, canonical_type
from .._host.package.arguments import native, shown
from .exchange import Parts


def checked_parts(
    points: Any, cells: Mapping[str, Any] | None, patches: Mapping[str, Any] | None, source: Any = None
) -> Parts:
    """Returns coordinates as floats, cells by type in alphabetical order, and unique ids by patch.

    It raises `ValueError` for what a `Mesh` refuses.
    """
    types = {kind: canonical_type(kind) for kind in cells or {}}
    twice = sorted(kind for kind, name in types.items() if list(types.values()).count(name) > 1)
    if twice:
        raise ValueError(f"cells of one type have several names ({', '.join(twice)}): join them.")
    points, ids = floats(points), {types[kind]: ids_of(corners) for kind, corners in (cells or {}).items()}
    ids = {kind: ids[kind] for kind in sorted(ids)}  # as JAX sorts the keys of a dict
    nodes = {name: np.unique(ids_of(members)) for name, members in (patches or {}).items()}
    _check_parts(points, ids, nodes)
    return Parts(points, ids, nodes, source)


def _check_parts(points: Any, cells: Mapping[str, Any], patches: Mapping[str, Any]) -> None:
    """Raises `ValueError` for arrays of wrong shapes, and for ids outside of `points`."""
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise ValueError(f"`points` has shape {points.shape}; expected (n, 2) or (n, 3).")
    n = points.shape[0]
    for kind, corners in cells.items():
        if corners.ndim != 2 or corners.shape[1] != NODES[kind]:
            raise ValueError(f"cells of type {kind!r} have shape {corners.shape}; expected (k, {NODES[kind]}).")
    for name, ids in {**cells, **patches}.items():
        if ids.size and (ids.min() < 0 or ids.max() >= n):
            bad = int(ids.max()) if ids.max() >= n else int(ids.min())
            raise ValueError(f"{name!r} names node {bad}, but the mesh has {n} points (0 to {n - 1}).")


def floats(points) -> Any:
    """Returns coordinates as floats; a JAX array stays one, for quality traces through points."""
    if isinstance(points, type):
        raise ValueError(f"`points` is {shown(points)}; coordinates are real numbers (n, d).")
    try:
        points = points if hasattr(points, "shape") else np.asarray(points)
    except ValueError:
        raise ValueError(
            f"`points` are rows of several lengths: {shown(points)}; coordinates are (n, 2) or (n, 3)."
        ) from None
    if np.ma.is_masked(points):
        raise ValueError(
            f"`points` masks {np.ma.count_masked(points)} coordinates; a node needs all of its coordinates."
        )
    points = points.data if isinstance(points, np.ma.MaskedArray) else points
    if not (np.issubdtype(points.dtype, np.integer) or _is_floating(points.dtype)):
        raise ValueError(f"`points` holds {points.dtype}; coordinates are real numbers.")
    return points.astype(float) if np.issubdtype(points.dtype, np.integer) else native(points)


def ids_of(values) -> np.ndarray:
    """Returns node ids as an array. Raises `ValueError` for numbers that are no integers."""
    ids = np.asarray(values)
    if ids.size == 0:
        return ids.astype(np.int64)
    if ids.dtype.kind not in "iu":
        raise ValueError(f"ids must be integers, not {ids.dtype}.")
    return native(ids)


def _is_floating(dtype: Any) -> bool:
    """Checks for real numbers of any precision; only JAX knows some of the short ones."""
    if isinstance(dtype, np.dtype) and dtype.kind != "V":
        return np.issubdtype(dtype, np.floating)
    import jax.numpy as jnp

    return jnp.issubdtype(dtype, np.floating)
