"""Arrays that solvers give, checked."""

from typing import Any

import numpy as np


def faces(points: Any, conn: Any, sizes: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns a definition as arrays."""
    points = _array("pts", points, float).reshape(-1, 3) if np.size(points) == 0 else _array("pts", points, float)
    corners, counts = _array("conn", conn, np.int64).ravel(), _array("faceSizes", sizes, np.int64).ravel()
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise ValueError(f"`pts` has shape {points.shape}; expected finite coordinates (k, 3).")
    if (counts < 3).any() or counts.sum() != len(corners):
        raise ValueError(
            f"`faceSizes` adds up to {counts.sum()}, and `conn` has {len(corners)} corners; a face has 3 or more."
        )
    if corners.size and (corners.min() < 0 or corners.max() >= len(points)):
        raise ValueError(
            f"`conn` goes from {corners.min()} to {corners.max()}; `pts` has points 0 to {len(points) - 1}."
        )
    return points, corners, counts


def _array(name: str, values: Any, kind: type) -> np.ndarray:
    """Returns numbers as an array; whole ones may come as floats."""
    try:
        if np.iscomplexobj(values):
            raise TypeError
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"`{name}` must be real numbers, not {values!r}.") from None
    if kind is not float and not (array == np.floor(array)).all():
        raise ValueError(f"`{name}` must be whole numbers.")
    return array.astype(kind)


def reals(name: str, values: Any, shape: tuple[int, ...]) -> np.ndarray:
    array = _array(name, values, float)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"`{name}` has shape {array.shape}; this process has {shape}, of finite numbers.")
    return array


def numbers(name: str, values: Any, shape: tuple[int, ...], kind: type) -> np.ndarray:
    """Returns real numbers, or complex ones where `kind` is complex."""
    if kind is not complex:
        return reals(name, values, shape)
    return reals(name, np.real(values), shape) + 1j * reals(name, np.imag(values), shape)
