"""The motion of a surface that the command line describes."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from jaxmorph import Mesh, io

from ._groups import MOTIONS, Group
from ._shapes import Box, Line, Points, bent, read_box, twisted


@dataclasses.dataclass(frozen=True)
class Motion:
    """Displacements from files, then box, scaling, twisting, bending, rotation (all but the first about one point), translation.

    `up` is where the line of bending turns to.
    """

    displacement: Points
    box: Box | None
    scale: Float[np.ndarray, " d"]
    twist: Line | None
    bend: Line | None
    up: Float[np.ndarray, " d"]
    rotation: Float[np.ndarray, " 3"]
    about: Float[np.ndarray, " d"]
    translation: Float[np.ndarray, " d"]

    def at(self, x: Points, share: float) -> Points:
        """Where points are when that share of each motion is made."""
        d = x.shape[1]
        x = x + share * self.displacement
        if self.box is not None:
            x = self.box.moved(x, share)
        x = self.about + (x - self.about) * (1 + share * (self.scale - 1))
        if self.twist is not None:
            x = twisted(x, self.twist, share)
        if self.bend is not None:
            x = bent(x, self.bend, self.up, share)
        rotation = Rotation.from_rotvec(share * self.rotation).as_matrix()[:d, :d]
        return self.about + (x - self.about) @ rotation.T + share * self.translation


@dataclasses.dataclass(frozen=True)
class Motions:
    """Motions one after the other, each of some rows of a surface."""

    parts: list[tuple[Int[np.ndarray, " k"], Motion]]

    def path(self, surface: Points, steps: int) -> Float[np.ndarray, "k m d"]:
        """Total displacements at the end of each of so many equal steps."""
        return np.stack([self._at(surface, (j + 1) / steps) - surface for j in range(steps)])

    def _at(self, surface: Points, share: float) -> Points:
        x = np.array(surface, float)
        for rows, motion in self.parts:
            x[rows] = motion.at(x[rows], share)
        return x


def motions(groups: Sequence[Group], mesh: Mesh, moving: Int[np.ndarray, " m"]) -> Motions:
    """The motion asked for, of the nodes `moving`. `ValueError` where none is, or where it does not fit the mesh or the nodes."""
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
    scale = [1.0] * d if group.scale is None else group.scale
    about = _vector("--about", group.about, d)
    surface = points[nodes]
    axis = _axis(group, d)
    up = np.cross(axis, _direction("--along", group.along, d, 3))[:d] if group.bend is not None else np.zeros(d)
    if group.bend is not None and not np.isclose(np.linalg.norm(up), 1, atol=1e-6):
        raise ValueError("--bend needs --axis and --along at right angles.")
    return Motion(
        displacement=_from_file(group, mesh, nodes) + _from_modes(group, mesh, nodes),
        box=None if group.box is None else read_box(group.box, d),
        scale=_vector("--scale", scale * d if len(scale) == 1 else scale, d),
        twist=_line("--twist", group.twist, group, surface, about),
        bend=_line("--bend", group.bend, group, surface, about),
        up=up,
        rotation=axis * np.radians(_angle("--rotate", group.rotate)),
        about=about,
        translation=_vector("--translate", group.translate, d),
    )


def _check_used(group: Group) -> None:
    """`ValueError` for a flag that belongs to another one which is not there."""
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
        found = " ".join(f"{value:g}" for value in values)
        raise ValueError(f"{option} needs {d} numbers for a mesh in {d}-D, found: {found}.")
    return np.array(values)


def _direction(option: str, values: list[float] | None, d: int, size: int) -> np.ndarray:
    """A vector of length 1, filled up with zeros to `size` components; the first axis where none is given in the plane."""
    if values is None and d == 3:
        raise ValueError(f"{option} X Y Z is missing.")
    vector = _vector(option, values if values is not None else [1.0, 0.0], d)
    length = np.linalg.norm(vector)
    if length == 0:
        raise ValueError(f"{option} needs a direction, found {' '.join(['0'] * d)}.")
    return np.append(vector / length, np.zeros(size - d))


def _angle(option: str, degrees: float | None) -> float:
    if degrees is not None and not np.isfinite(degrees):
        raise ValueError(f"{option} needs an angle in degrees, found {degrees}.")
    return degrees or 0.0


def _axis(group: Group, d: int) -> np.ndarray:
    """The axis of rotation and bending, of length 1 (or 0 where neither is asked for)."""
    if group.axis is not None and d == 2:
        raise ValueError("--axis is for meshes in 3-D; this one is in the plane.")
    if d == 2:
        return np.array([0.0, 0.0, 1.0])
    if group.rotate is None and group.bend is None:
        return np.zeros(3)
    if group.axis is None:
        raise ValueError(f"{'--rotate' if group.bend is None else '--bend'} needs --axis X Y Z for a mesh in 3-D.")
    return _direction("--axis", group.axis, 3, 3)


def _line(option: str, degrees: float | None, group: Group, surface: np.ndarray, about: np.ndarray) -> Line | None:
    if degrees is None:
        return None
    d = surface.shape[1]
    if option == "--twist" and d == 2:
        raise ValueError("--twist is for meshes in 3-D; this one is in the plane.")
    along = _direction("--along", group.along, d, d)
    length = float(((surface - about) @ along).max()) if group.length is None else group.length
    if not (np.isfinite(length) and length > 0):
        found = (
            f"found {length:g}" if group.length is not None else "and no node lies ahead of --about in that direction"
        )
        raise ValueError(f"{option} needs a --length above 0, {found}.")
    return Line(about, along, length, float(np.radians(_angle(option, degrees))))


def _from_file(group: Group, mesh: Mesh, nodes: np.ndarray) -> np.ndarray:
    """Displacement of each moving node, in their order; zeros without a file."""
    if group.displacement is None:
        return np.zeros((len(nodes), mesh.points.shape[1]))
    is_position = group.displacement_is == "position"
    return io.read_displacement(
        group.displacement, mesh, nodes, before=group.displacement_from, is_position=is_position
    )


def _from_modes(group: Group, mesh: Mesh, nodes: np.ndarray) -> np.ndarray | float:
    """Mode shapes, each times its amplitude."""
    shapes = []
    for file, amplitude in group.mode:
        if not np.isfinite(amplitude):
            raise ValueError(f"--mode {file} needs an amplitude, found {amplitude}.")
        shapes.append(amplitude * io.read_displacement(file, mesh, nodes, is_position=False))
    return sum(shapes, 0.0)
