"""The motion of a surface that the command line describes."""

import argparse
import dataclasses

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from jaxmorph import Mesh, io


@dataclasses.dataclass(frozen=True)
class Motion:
    """A displacement from a file, then scaling, then rotation, both about one point, then translation."""

    displacement: Float[np.ndarray, "m d"]
    scale: Float[np.ndarray, " d"]
    rotation: Float[np.ndarray, " 3"]
    about: Float[np.ndarray, " d"]
    translation: Float[np.ndarray, " d"]

    def path(self, surface: Float[np.ndarray, "m d"], steps: int) -> Float[np.ndarray, "k m d"]:
        """Total displacements at the end of each of so many equal steps."""
        return np.stack([self._at(surface, (j + 1) / steps) - surface for j in range(steps)])

    def _at(self, surface: Float[np.ndarray, "m d"], share: float) -> Float[np.ndarray, "m d"]:
        d = surface.shape[1]
        rotation = Rotation.from_rotvec(share * self.rotation).as_matrix()[:d, :d]
        arm = surface + share * self.displacement - self.about
        return self.about + (arm * (1 + share * (self.scale - 1))) @ rotation.T + share * self.translation


def motion(arguments: argparse.Namespace, mesh: Mesh, moving: np.ndarray) -> Motion:
    """The motion asked for. `ValueError` where none is, or where it does not fit the mesh or the moving nodes."""
    d = mesh.points.shape[1]
    asked = (arguments.displacement, arguments.scale, arguments.rotate, arguments.translate)
    if all(part is None for part in asked):
        raise ValueError("no motion: give one of --rotate, --translate, --scale, --displacement.")
    scale = [1.0] * d if arguments.scale is None else arguments.scale
    return Motion(
        displacement=_from_file(arguments, mesh, moving),
        scale=_vector("--scale", scale * d if len(scale) == 1 else scale, d),
        rotation=_rotation(arguments, d),
        about=_vector("--about", arguments.about, d),
        translation=_vector("--translate", arguments.translate, d),
    )


def _vector(option: str, values: list[float] | None, d: int) -> np.ndarray:
    if values is None:
        return np.zeros(d)
    if len(values) != d or not np.isfinite(values).all():
        found = " ".join(f"{value:g}" for value in values)
        raise ValueError(f"{option} needs {d} numbers for a mesh in {d}-D, found: {found}.")
    return np.array(values)


def _rotation(arguments: argparse.Namespace, d: int) -> np.ndarray:
    """Axis times angle in radians."""
    if arguments.axis is not None and d == 2:
        raise ValueError("--axis is for meshes in 3-D; this one is in the plane.")
    if arguments.rotate is None:
        if arguments.axis is not None:
            raise ValueError("--axis without --rotate.")
        if arguments.about is not None and arguments.scale is None:
            raise ValueError("--about without --rotate or --scale.")
        return np.zeros(3)
    if not np.isfinite(arguments.rotate):
        raise ValueError(f"--rotate needs an angle in degrees, found {arguments.rotate}.")
    if d == 3 and arguments.axis is None:
        raise ValueError("--rotate needs --axis X Y Z for a mesh in 3-D.")
    axis = _vector("--axis", arguments.axis, 3) if d == 3 else np.array([0.0, 0.0, 1.0])
    length = np.linalg.norm(axis)
    if length == 0:
        raise ValueError("--axis needs a direction, found 0 0 0.")
    return np.radians(arguments.rotate) * axis / length


def _from_file(arguments: argparse.Namespace, mesh: Mesh, moving: np.ndarray) -> np.ndarray:
    """Displacement of each moving node, in their order; zeros without a file."""
    points = np.asarray(mesh.points)
    if arguments.displacement is None:
        if arguments.displacement_from is not None:
            raise ValueError("--displacement-from without --displacement.")
        return np.zeros((len(moving), points.shape[1]))
    return io.read_displacement(
        arguments.displacement,
        mesh,
        moving,
        before=arguments.displacement_from,
        is_position=arguments.displacement_is == "position",
    )
