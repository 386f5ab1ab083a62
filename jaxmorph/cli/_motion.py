"""The motion of a surface that the command line describes, made of the library's shapes."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxmorph import Mesh, io, shapes
from jaxmorph._host.package.errors import place_of, worst_first

from ._airfoil import bumps, class_functions
from ._early import lattice_files
from ._groups import MOTIONS, Group, as_json
from ._parser import flag_of
from ._requests import Deform
from ._vectors import Points, angle_of, axis_of, direction_of, length_of, vector_of

Parts = dict[str, tuple[shapes.AbstractShape, Any]]
"""Shapes by name in the order in which they are applied, with their parameters."""


@dataclasses.dataclass(frozen=True)
class Motion:
    """Shape of the moving nodes, and its parameters by name of the patches, then of the flag.

    `boxes` are the boxes with a file for their lattice, with the two names of their parameters.
    """

    shape: shapes.Chain
    parameters: dict[str, dict[str, Any]]
    boxes: tuple[tuple[Path, shapes.FreeForm | shapes.Hexahedron, tuple[str, str]], ...] = ()

    def path(self, surface: Points, steps: int) -> Float[np.ndarray, "k m d"]:
        """Computes the total displacement at the end of each of `steps` equal steps."""
        return np.asarray(shapes.path(self.shape, surface, self.parameters, steps))

    def varied(self, changes: Mapping[str, Sequence[float]]) -> "Motion":
        """Sets parameters by name. Raises `ValueError` for names that are none."""
        try:
            return dataclasses.replace(self, parameters=shapes.varied(self.parameters, changes))
        except ValueError as error:
            raise ValueError(f"--set: {error}") from None

    def write_lattices(self) -> list[Path]:
        """Writes the lattice of each box before and after its motion, and returns the files."""
        files = []
        for file, box, (patches, name) in self.boxes:
            for place, control in zip(lattice_files(file), (None, self.parameters[patches][name]), strict=True):
                files.append(place)
                io.write_lattice(place, box.lattice(control))
        return files


def motion(request: Deform, mesh: Mesh, moving: Int[np.ndarray, " m"]) -> Motion:
    """Makes the requested motion of the nodes `moving`.

    A patch moves as the groups that name it, one after the other. A node of several patches moves
    as the first of them.

    Raises `ValueError` if there is none, if it does not fit the mesh or the nodes, and where
    patches of a node move it differently.
    """
    chains, owned, parameters, boxes = {}, {}, {}, []
    sides = _sides(request.groups, mesh, moving)
    for number, group in enumerate(request.groups):
        nodes = mesh.patch(*group.patches)
        try:
            parts = _parts(group, mesh, nodes)
        except ValueError as error:
            raise ValueError(f"{group.title}: {error}" if len(request.groups) > 1 else str(error)) from None
        key = _key(group, chains)
        chain = shapes.Chain({name: shape for name, (shape, _) in parts.items()})
        chains[key] = shapes.OnRows(chain, np.searchsorted(moving, nodes))
        owned[key] = shapes.OnRows(_on_some(chain, _is_moved(sides, number, nodes)), chains[key].rows)
        parameters[key] = {name: values for name, (_, values) in parts.items()}
        if group.lattice is not None:
            boxes.append((group.lattice, parts["box"][0], (key, "box")))
    made = Motion(shapes.Chain(owned), parameters, tuple(boxes)).varied(dict(request.set))
    _check_agreement(request.groups, sides, chains, made, Wall(moving, np.asarray(mesh.points, float)[moving]))
    return made


@dataclasses.dataclass(frozen=True)
class Side:
    """Moving nodes that the same groups name: the `groups` by number, all `nodes`, and its `own`.

    A node of several sides is the first one's own.
    """

    groups: tuple[int, ...]
    nodes: np.ndarray
    own: np.ndarray


class Wall(NamedTuple):
    """Ids and undeformed points of the moving nodes."""

    nodes: np.ndarray
    points: Points


def _sides(groups: Sequence[Group], mesh: Mesh, moving: np.ndarray) -> list[Side]:
    """Sorts the moving nodes by the groups that name their patches."""
    names = [mesh.patch_names(*group.patches) for group in groups]
    by_groups: dict[tuple[int, ...], list[str]] = {}
    for patch in dict.fromkeys(name for patches in names for name in patches):
        numbers = tuple(number for number, patches in enumerate(names) if patch in patches)
        by_groups.setdefault(numbers, []).append(patch)
    sides, left = [], moving
    for numbers, patches in by_groups.items():
        nodes = mesh.patch(*patches)
        sides.append(Side(numbers, nodes, np.intersect1d(nodes, left)))
        left = np.setdiff1d(left, nodes)
    return sides


def _is_moved(sides: list[Side], number: int, nodes: np.ndarray) -> np.ndarray:
    """Marks the nodes of a group that move with it: those that are not another side's own."""
    return np.isin(nodes, np.concatenate([side.own for side in sides if number in side.groups]))


def _on_some(chain: shapes.Chain, is_moved: np.ndarray) -> shapes.AbstractShape:
    if is_moved.all():
        return chain
    return shapes.Function(lambda x, values: jnp.where(is_moved[:, None], chain(x, values), x), chain.neutral())


def _check_agreement(
    groups: Sequence[Group], sides: list[Side], chains: Mapping[str, shapes.OnRows], made: Motion, wall: Wall
) -> None:
    """Raises `ValueError` where two sides move a common node differently, beyond round-off."""
    keys = list(chains)
    for side in sides:
        rows = np.searchsorted(wall.nodes, np.setdiff1d(side.nodes, side.own))
        if not len(rows):
            continue
        u = made.path(wall.points, 1)[-1]
        alone = shapes.Chain({keys[number]: chains[keys[number]] for number in side.groups})
        other = Motion(alone, {name: made.parameters[name] for name in alone.names}).path(wall.points, 1)[-1]
        off = np.linalg.norm(u[rows] - other[rows], axis=1)
        wrong = rows[worst_first(off, 1e-9 * np.abs(u).max() + 1e-13 * np.abs(wall.points).max())]
        if not len(wrong):
            continue
        first = next(owner for owner in sides if wall.nodes[wrong[0]] in owner.own)
        told = ", ".join(map(str, wall.nodes[wrong[:5]])) + (", ..." if len(wrong) > 5 else "")
        raise ValueError(
            f"{_flags(groups, first)} and {_flags(groups, side)} move {len(wrong)} common nodes differently, by up to "
            f"{off.max():.3g}: nodes {told}, the first near ({place_of(wall.points[wrong[0]])}). Name both patches after one "
            "--moving, or take the common nodes out of one of the patches."
        )


def _flags(groups: Sequence[Group], side: Side) -> str:
    """Writes the flags that move a side."""
    words = []
    for number in side.groups:
        group = groups[number]
        flags = [flag_of(name) for name in MOTIONS if getattr(group, name) not in (None, ())]
        words.append(" ".join(["--moving", *group.patches, *flags]))
    return ", then ".join(words)


def _key(group: Group, others: Mapping[str, Any]) -> str:
    """Names a group by `--name` or by its patches, with a number if the name is taken."""
    name = group.name or "+".join(group.patches)
    if group.name in others:
        raise ValueError(f"--name {group.name}: another --moving has this name.")
    return next(key for key in (name, *(f"{name}{k}" for k in range(2, len(others) + 3))) if key not in others)


def _parts(group: Group, mesh: Mesh, nodes: np.ndarray) -> Parts:
    surface, d = np.asarray(mesh.points)[nodes], mesh.points.shape[1]
    about = vector_of("--about", group.about, d)
    return {
        **_displacement(group, mesh, nodes),
        **_modes(group, mesh, nodes),
        **_box(group, d),
        **_airfoil(group, mesh),
        **_scale(group, about),
        **_twist(group, surface, about),
        **_bend(group, surface, about),
        **_rotate(group, about),
        **_translate(group, d),
    }


def _box(group: Group, d: int) -> Parts:
    if group.box is None:
        return {}
    table = as_json("box", group.box)
    return {"box": io.read_box(group.box if table is None else table, d)}


def _airfoil(group: Group, mesh: Mesh) -> Parts:
    parts: Parts = {}
    if group.hicks_henne is not None:
        parts |= bumps("hicks-henne", group.hicks_henne, mesh, tuple(group.patches))
    if group.cst is not None:
        parts |= class_functions("cst", group.cst, mesh, tuple(group.patches))
    return parts


def _scale(group: Group, about: np.ndarray) -> Parts:
    if group.scale is None:
        return {}
    is_one = len(group.scale) == 1 and np.isfinite(group.scale).all()
    factors = vector_of("--scale", group.scale, 1 if is_one else len(about))
    factors = factors[0] if len(factors) == 1 else factors
    shape = shapes.Function(lambda x, factors: shapes.scale(x, factors, about), np.ones_like(factors))
    return {"scale": (shape, factors)}


def _twist(group: Group, surface: Points, about: np.ndarray) -> Parts:
    if group.twist is None:
        return {}
    if len(about) == 2:
        raise ValueError("--twist is for meshes in 3-D; this one is in 2-D.")
    angle, along = angle_of("--twist", group.twist), direction_of("--along", group.along, 3)
    length = length_of("--twist", group.length, surface, about, along)
    shape = _by_angle(lambda x, angle: shapes.twist(x, angle, about, along, length))
    return {"twist": (shape, angle)}


def _bend(group: Group, surface: Points, about: np.ndarray) -> Parts:
    if group.bend is None:
        return {}
    d = len(about)
    angle, axis = angle_of("--bend", group.bend), axis_of("--bend", group, d)
    along = direction_of("--along", group.along, d)
    if axis is not None and abs(axis @ along) > 1e-3:
        raise ValueError("--bend needs --axis and --along at right angles.")
    length = length_of("--bend", group.length, surface, about, along)
    shape = _by_angle(lambda x, angle: shapes.bend(x, angle, about, along, length, axis))
    return {"bend": (shape, angle)}


def _rotate(group: Group, about: np.ndarray) -> Parts:
    if group.rotate is None:
        return {}
    angle, axis = angle_of("--rotate", group.rotate), axis_of("--rotate", group, len(about))
    return {"rotate": (_by_angle(lambda x, angle: shapes.rotate(x, angle, about, axis)), angle)}


def _by_angle(function: Callable) -> shapes.Function:
    """Makes a shape of an angle in degrees, compiled as one program."""
    return shapes.Function(jax.jit(lambda x, angle: function(x, jnp.radians(angle))), 0.0)


def _translate(group: Group, d: int) -> Parts:
    if group.translate is None:
        return {}
    return {"translate": (shapes.Function(shapes.translate, np.zeros(d)), vector_of("--translate", group.translate, d))}


def _displacement(group: Group, mesh: Mesh, nodes: np.ndarray) -> Parts:
    if group.displacement is None:
        return {}
    is_position = group.displacement_is == "position"
    u = io.read_displacement(group.displacement, mesh, nodes, before=group.displacement_from, is_position=is_position)
    return {"displacement": (shapes.Function(lambda x, factor: x + factor * u, 0.0), 1.0)}


def _modes(group: Group, mesh: Mesh, nodes: np.ndarray) -> Parts:
    """Reads mode shapes; each has an amplitude."""
    if not group.mode:
        return {}
    fields = [io.read_displacement(file, mesh, nodes, is_position=False) for file, _ in group.mode]
    return {"mode": (shapes.Modes(np.stack(fields)), np.array([amplitude for _, amplitude in group.mode]))}
