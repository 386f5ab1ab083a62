"""Numbers of the flags of a motion, checked: vectors, directions, angles and lengths."""

import numpy as np
from jaxtyping import Float

from ._groups import Group

Points = Float[np.ndarray, "m d"]


def vector_of(option: str, values: list[float] | None, d: int) -> np.ndarray:
    """Returns the d numbers of a flag, zeros without the flag. Raises `ValueError` for others."""
    if values is None:
        return np.zeros(d)
    if len(values) != d or not np.isfinite(values).all():
        found = " ".join(f"{value:g}" for value in values)
        raise ValueError(f"{option} needs {d} numbers for a mesh in {d}-D, found: {found}.")
    return np.array(values)


def direction_of(option: str, values: list[float] | None, d: int) -> np.ndarray:
    """Scales a vector to length 1; in 2-D the default is the first axis."""
    if values is None and d == 3:
        raise ValueError(f"{option} X Y Z is missing.")
    vector = vector_of(option, values if values is not None else [1.0, 0.0], d)
    length = np.linalg.norm(vector)
    if length == 0:
        raise ValueError(f"{option} needs a direction, found {' '.join(['0'] * d)}.")
    return vector / length


def angle_of(option: str, degrees: float) -> float:
    """Returns an angle in degrees. Raises `ValueError` for numbers that are not finite."""
    if not np.isfinite(degrees):
        raise ValueError(f"{option} needs an angle in degrees, found {degrees}.")
    return degrees


def axis_of(option: str, group: Group, d: int) -> np.ndarray | None:
    """Returns the axis of rotation and bending, of length 1; None in 2-D."""
    if d == 2:
        if group.axis is not None:
            raise ValueError("--axis is for meshes in 3-D; this one is in 2-D.")
        return None
    if group.axis is None:
        raise ValueError(f"{option} needs --axis X Y Z for a mesh in 3-D.")
    return direction_of("--axis", group.axis, 3)


def length_of(option: str, flag: float | None, surface: Points, about: np.ndarray, along: np.ndarray) -> float:
    """Measures the line along which a surface is bent or twisted.

    By default the line ends where the surface does.
    """
    length = float(((surface - about) @ along).max()) if flag is None else flag
    if not (np.isfinite(length) and length > 0):
        reason = "and no node lies ahead of --about in that direction" if flag is None else f"found {length:g}"
        raise ValueError(f"{option} needs a --length above 0, {reason}.")
    return length
