"""The motion of a surface that the command line describes, made of the library's shapes."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Array, Float, Int

from jaxmorph import Mesh, io, shapes

from ._box import read_box
from ._groups import MOTIONS, Group

Points = Float[np.ndarray, "m d"]
Shape = Callable[[Float[Array | np.ndarray, "m d"], float], Float[Array | np.ndarray, "m d"]]
"""Moves points by a share, from 0 to 1, of a motion."""


@dataclasses.dataclass(frozen=True)
class Motion:
    """Displacements from files, then shapes one after the other."""

    displacement: Points
    shapes: tuple[Shape, ...]

    def at(self, x: Points, share: float) -> Points:
        """Moves points by a share of each part."""
        moved: Float[Array | np.ndarray, "m d"] = x + share * self.displacement
        for shape in self.shapes:
            moved = shape(moved, share)
        return np.asarray(moved)


@dataclasses.dataclass(frozen=True)
class Motions:
    """Motions one after the other, each of some rows of a surface."""

    parts: list[tuple[Int[np.ndarray, " k"], Motion]]

    def path(self, surface: Points, steps: int) -> Float[np.ndarray, "k m d"]:
        """Computes the total displacement at the end of each of `steps` equal steps."""
        return np.stack([self._at(surface, (j + 1) / steps) - surface for j in range(steps)])

    def _at(self, surface: Points, share: float) -> Points:
        x = np.array(surface, float)
        for rows, motion in self.parts:
            x[rows] = motion.at(x[rows], share)
        return x


def motions(groups: Sequence[Group], mesh: Mesh, moving: Int[np.ndarray, " m"]) -> Motions:
    """Makes the requested motion of the nodes `moving`.

    Raises `ValueError` if there is none, or if it does not fit the mesh or the nodes.
    """
    parts = []
    for group in groups:
        nodes = mesh.patch(*group.patches)
        try:
            parts.append((np.searchsorted(moving, nodes), _motion(group, mesh, nodes)))
        except ValueError as error:
            raise ValueError(f"{group.name}: {error}" if len(groups) > 1 else str(error)) from None
    return Motions(parts)


def _motion(group: Group, mesh: Mesh, nodes: np.ndarray) -> Motion:
    points = np.asarray(mesh.points)
    d = points.shape[1]
    if not group.mode and all(getattr(group, name) is None for name in MOTIONS if name != "mode"):
        raise ValueError(f"no motion: give one of {', '.join(f'--{name}' for name in MOTIONS)}.")
    _check_used(group)
    about = _vector("--about", group.about, d)
    parts = [
        _box(group, d),
        _scale(group, about),
        _twist(group, points[nodes], about),
        _bend(group, points[nodes], about),
        _rotate(group, about),
        _translate(group, d),
    ]
    displacement = _from_file(group, mesh, nodes) + _from_modes(group, mesh, nodes)
    return Motion(displacement, tuple(part for part in parts if part is not None))


def _box(group: Group, d: int) -> Shape | None:
    if group.box is None:
        return None
    box, control = read_box(group.box, d)
    return lambda x, share: box(x, share * control)


def _scale(group: Group, about: np.ndarray) -> Shape | None:
    if group.scale is None:
        return None
    d = len(about)
    factors = _vector("--scale", group.scale * d if len(group.scale) == 1 else group.scale, d)
    return lambda x, share: shapes.scale(x, 1 + share * (factors - 1), about)


def _twist(group: Group, surface: Points, about: np.ndarray) -> Shape | None:
    if group.twist is None:
        return None
    if len(about) == 2:
        raise ValueError("--twist is for meshes in 3-D; this one is in 2-D.")
    angle, along = _angle("--twist", group.twist), _direction("--along", group.along, 3)
    length = _length("--twist", group.length, surface, about, along)
    return lambda x, share: shapes.twist(x, share * angle, about, along, length)


def _bend(group: Group, surface: Points, about: np.ndarray) -> Shape | None:
    if group.bend is None:
        return None
    d = len(about)
    angle, axis = _angle("--bend", group.bend), _axis("--bend", group, d)
    along = _direction("--along", group.along, d)
    if axis is not None and abs(axis @ along) > 1e-3:
        raise ValueError("--bend needs --axis and --along at right angles.")
    length = _length("--bend", group.length, surface, about, along)
    return lambda x, share: shapes.bend(x, share * angle, about, along, length, axis)


def _rotate(group: Group, about: np.ndarray) -> Shape | None:
    if group.rotate is None:
        return None
    angle, axis = _angle("--rotate", group.rotate), _axis("--rotate", group, len(about))
    return lambda x, share: shapes.rotate(x, share * angle, about, axis)


def _translate(group: Group, d: int) -> Shape | None:
    if group.translate is None:
        return None
    vector = _vector("--translate", group.translate, d)
    return lambda x, share: shapes.translate(x, share * vector)


def _check_used(group: Group) -> None:
    """Raises `ValueError` for a flag without the flag that it belongs to."""
    needs = {
        "axis": ("rotate", "bend"),
        "about": ("rotate", "scale", "bend", "twist"),
        "along": ("bend", "twist"),
        "length": ("bend", "twist"),
        "displacement_from": ("displacement",),
    }
    for name, owners in needs.items():
        if getattr(group, name) is not None and all(getattr(group, owner) is None for owner in owners):
            flags = [f"--{each.replace('_', '-')}" for each in (name, *owners)]
            raise ValueError(f"{flags[0]} without {' or '.join(flags[1:])}.")


def _vector(option: str, values: list[float] | None, d: int) -> np.ndarray:
    if values is None:
        return np.zeros(d)
    if len(values) != d or not np.isfinite(values).all():
        given = " ".join(f"{value:g}" for value in values)
        raise ValueError(f"{option} needs {d} numbers for a mesh in {d}-D, found: {given}.")
    return np.array(values)


def _direction(option: str, values: list[float] | None, d: int) -> np.ndarray:
    """Scales a vector to length 1; in 2-D the default is the first axis."""
    if values is None and d == 3:
        raise ValueError(f"{option} X Y Z is missing.")
    vector = _vector(option, values if values is not None else [1.0, 0.0], d)
    length = np.linalg.norm(vector)
    if length == 0:
        raise ValueError(f"{option} needs a direction, found {' '.join(['0'] * d)}.")
    return vector / length


def _angle(option: str, degrees: float) -> float:
    """Converts degrees to radians. Raises `ValueError` for numbers that are not finite."""
    if not np.isfinite(degrees):
        raise ValueError(f"{option} needs an angle in degrees, found {degrees}.")
    return float(np.radians(degrees))


def _axis(option: str, group: Group, d: int) -> np.ndarray | None:
    """Returns the axis of rotation and bending, of length 1; None in 2-D."""
    if d == 2:
        if group.axis is not None:
            raise ValueError("--axis is for meshes in 3-D; this one is in 2-D.")
        return None
    if group.axis is None:
        raise ValueError(f"{option} needs --axis X Y Z for a mesh in 3-D.")
    return _direction("--axis", group.axis, 3)


def _length(option: str, given: float | None, surface: Points, about: np.ndarray, along: np.ndarray) -> float:
    """Measures the line along which a surface is bent or twisted: by default it ends where the surface does."""
    length = float(((surface - about) @ along).max()) if given is None else given
    if not (np.isfinite(length) and length > 0):
        reason = "and no node lies ahead of --about in that direction" if given is None else f"found {length:g}"
        raise ValueError(f"{option} needs a --length above 0, {reason}.")
    return length


def _from_file(group: Group, mesh: Mesh, nodes: np.ndarray) -> np.ndarray:
    """Reads the displacement of each moving node, in their order; zeros without a file."""
    if group.displacement is None:
        return np.zeros((len(nodes), mesh.points.shape[1]))
    is_position = group.displacement_is == "position"
    return io.read_displacement(
        group.displacement, mesh, nodes, before=group.displacement_from, is_position=is_position
    )


def _from_modes(group: Group, mesh: Mesh, nodes: np.ndarray) -> np.ndarray | float:
    """Sums mode shapes, each times its amplitude."""
    parts = []
    for file, amplitude in group.mode:
        if not np.isfinite(amplitude):
            raise ValueError(f"--mode {file} needs an amplitude, found {amplitude}.")
        parts.append(amplitude * io.read_displacement(file, mesh, nodes, is_position=False))
    return sum(parts, 0.0)
