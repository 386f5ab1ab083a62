"""The motion of a surface that the command line describes, made of the library's shapes."""

import dataclasses
import functools
import itertools
import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

import jaxmorph as jm
from jaxmorph import Mesh, io, shapes
from jaxmorph.extend import as_jax

from ._early import is_given
from ._output import format_place, plural, some
from ._parser import flag_of
from ._requests import Deform, MotionFlags, Names

Points = Float[np.ndarray, "m d"]
Parametrised = tuple[shapes.AbstractShape, Any]


class Wall(NamedTuple):
    """What goes onto a target, of which the file is told."""

    wall: jm.Facets
    target: jm.Facets
    file: Path


class MotionGroup(NamedTuple):
    """Patches that move: shapes and parameters by flag, and the rows of their nodes."""

    patches: Names
    shape: shapes.Chain
    values: dict[str, Any]
    rows: np.ndarray
    nodes: np.ndarray
    wall: "Wall | None" = None


@dataclasses.dataclass(frozen=True)
class Motion:
    """Groups and parameters by name of the group; a patch moves as the groups that name it in turn.

    `sides` are rows of the nodes of patches that the same groups name. A node of several moves as
    on the first of them.
    """

    groups: dict[str, MotionGroup]
    sides: dict[Names, np.ndarray]
    parameters: dict[str, dict[str, Any]]

    @property
    def shape(self) -> shapes.Function:
        return shapes.Function(
            self.moved, {name: group.shape.neutral() for name, group in self.groups.items()}
        )

    @property
    def walls(self) -> "dict[str, tuple[np.ndarray, Wall]]":
        """Walls with a target and their nodes, by file; by name too where several have one."""
        found = [(name, group.nodes, group.wall) for name, group in self.groups.items()]
        files = [wall.file.name for _, _, wall in found if wall]
        return {
            wall.file.name + f" ({name})" * (files.count(wall.file.name) > 1): (nodes, wall)
            for name, nodes, wall in found
            if wall
        }

    def moved(self, x: Any, parameters: Mapping[str, Any]) -> Any:
        moved = x
        for names, rows in reversed(self.sides.items()):
            alone = self.alone(names, x, parameters)
            moved = alone if _are_all(rows, x) else moved.at[rows].set(alone[rows])
        return moved

    def alone(self, names: Names, x: Any, parameters: Mapping[str, Any]) -> Any:
        for name in names:
            rows = self.groups[name].rows
            shape = self.groups[name].shape
            if _are_all(rows, x):  # without six programs that gather and scatter
                x = shape(x, parameters[name])
            else:
                x = x.at[rows].set(shape(x[rows], parameters[name]))
        return x

    def check(self, x: Any, moving: np.ndarray) -> None:
        """Raises `ValueError` where sides move a common node differently, beyond round-off."""
        if sum(map(len, self.sides.values())) == len(moving):
            return
        u = np.asarray(self.moved(x, self.parameters) - x)
        for names, rows in self.sides.items():
            off = np.linalg.norm(u - (self.alone(names, x, self.parameters) - x), axis=1)[rows]
            wrong = rows[off > 1e-9 * np.abs(u).max() + 1e-13 * np.abs(x).max()]
            if len(wrong):
                first = next(
                    other for other, of_other in self.sides.items() if wrong[0] in of_other
                )
                walls = [self.groups[name].wall for name in (*first, *names)]
                onto = ", and a surface of both after --onto" if all(walls) else ""
                raise ValueError(
                    f"{' then '.join(first)} and {' then '.join(names)} move {len(wrong)} common "
                    "nodes differently, by up to "
                    f"{off.max():.3g}: nodes {some(moving[wrong])}, the first near "
                    f"{format_place(x[wrong[0]])}. Name both "
                    f"patches after one --moving{onto}, or take the common nodes out of one of the "
                    "patches."
                )

    def path(self, surface: Points, steps: int) -> Float[np.ndarray, "k m d"]:
        return np.asarray(shapes.path(self.shape, surface, self.parameters, steps))

    def at(self, surface: Points, share: float) -> Points:
        values = jax.tree.map(
            lambda a, b: a + share * (b - a), self.shape.neutral(), self.parameters
        )
        return np.asarray(shapes.path(self.shape, surface, values, 1))[0]


def _are_all(rows: np.ndarray, x: Any) -> bool:
    return np.array_equal(rows, np.arange(len(x)))


def motion(request: Deform, mesh: Mesh, moving: Int[np.ndarray, " m"]) -> Motion:
    """Makes the requested motion of the nodes `moving`.

    Raises `ValueError` for no motion, one that does not fit the mesh or the nodes, and patches that
    move a common node differently.
    """
    groups: dict[str, MotionGroup] = {}
    for flags in request.groups:
        try:
            groups[_name_group(flags, groups)] = _make_group(flags, request, mesh, moving)
        except ValueError as error:
            raise ValueError(
                f"{flags.title}: {error}" if len(request.groups) > 1 else str(error)
            ) from None
    parameters = {name: group.values for name, group in groups.items()}
    try:
        made = Motion(
            groups, _find_sides(groups, mesh, moving), shapes.varied(parameters, dict(request.set))
        )
    except ValueError as error:
        raise ValueError(f"--set: {error}") from None
    made.check(as_jax(np.asarray(mesh.points, float)[moving]), moving)
    return made


def _find_sides(
    groups: dict[str, MotionGroup], mesh: Mesh, moving: np.ndarray
) -> dict[Names, np.ndarray]:
    patches: dict[Names, list[str]] = {}
    for patch in dict.fromkeys(itertools.chain(*(group.patches for group in groups.values()))):
        patches.setdefault(
            tuple(name for name, group in groups.items() if patch in group.patches), []
        ).append(patch)
    return {names: np.searchsorted(moving, mesh.patch(*own)) for names, own in patches.items()}


def _name_group(flags: MotionFlags, others: Mapping[str, Any]) -> str:
    """Names a group by `--name` or by its patches, with a number if the name is taken."""
    name = flags.name or "+".join(flags.patches)
    if flags.name in others:
        raise ValueError(f"--name {flags.name}: another --moving has this name.")
    return next(
        key
        for key in (name, *(f"{name}{k}" for k in range(2, len(others) + 3)))
        if key not in others
    )


def _make_group(flags: MotionFlags, request: Deform, mesh: Mesh, moving: np.ndarray) -> MotionGroup:
    nodes = mesh.patch(*flags.patches)
    if not len(nodes):
        raise ValueError(f"--moving {' '.join(flags.patches)}: there are no nodes in it.")
    _check_dimension(flags, mesh.points.shape[1])
    wall = _read_wall(flags, mesh)
    patch = MovingPatch(flags, mesh, nodes, request.boundary.symmetry, wall)
    made = {}
    values = {}
    for name in (name for name in PARTS if is_given(flags, name)):
        key = name.replace("_", "-")
        try:
            made[key], values[key] = PARTS[name](patch)
            values[key] = jax.tree.map(np.asarray, values[key])  # of one type, for one program
            made[key](patch.points, values[key])  # raises for what does not fit the patch
        except ValueError as error:
            raise ValueError(f"--{key}: {str(error).removeprefix(f'--{key}: ')}") from None
    rows = np.searchsorted(moving, patch.nodes)
    names = mesh.patch_names(*flags.patches)
    return MotionGroup(names, shapes.Chain(made), values, rows=rows, nodes=nodes, wall=wall)


VECTORS = ("scale", "translate", "about", "axis", "along")


def _check_dimension(flags: MotionFlags, d: int) -> None:
    if d == 2 and flags.axis is not None:
        raise ValueError("--axis is for meshes in 3-D, and this one is in 2-D. Leave it out.")
    if d == 2 and flags.twist is not None:
        raise ValueError("--twist is for meshes in 3-D; --rotate turns a section in 2-D.")
    for name in VECTORS:
        given = getattr(flags, name) or [0.0] * d
        if len(given) != d and (name, len(given)) != ("scale", 1):
            numbers = " ".join(f"{number:g}" for number in given)
            raise ValueError(
                f"{flag_of(name)} {numbers}: {plural(len(given), 'number')}, and this mesh is in "
                f"{d}-D: give {'X Y' if d == 2 else 'X Y Z'}."
            )


class MovingPatch(NamedTuple):
    group: MotionFlags
    mesh: Mesh
    nodes: np.ndarray
    symmetry: Names
    wall: Wall | None = None

    @property
    def points(self) -> Points:
        return np.asarray(self.mesh.points, float)[self.nodes]

    @property
    def dimension(self) -> int:
        return self.mesh.points.shape[1]

    @property
    def about(self) -> np.ndarray:
        return np.array(self.group.about or np.zeros(self.dimension))


def _displacement_shape(patch: MovingPatch) -> Parametrised:
    group = patch.group
    assert group.displacement is not None
    is_position = group.displacement_is == "position"
    u = io.read_displacement(group.displacement, patch.mesh, patch.nodes, is_position=is_position)
    turn = jm.Turn.of(patch.points, u)
    return shapes.Function(lambda x, share: x + turn.at(share), 0.0), 1.0


def _read_wall(flags: MotionFlags, mesh: Mesh) -> Wall | None:
    if flags.onto is None:
        return None
    angle = math.radians(60 if flags.onto_angle is None else flags.onto_angle)
    target = io.read_facets(flags.onto, mesh.points.shape[1], angle=angle)
    if flags.onto_scale is not None:
        if flags.onto_scale <= 0:
            raise ValueError(f"--onto-scale {flags.onto_scale:g}: a factor above 0 is expected.")
        target = _scaled_target(target, flags.onto_scale)
    return Wall(jm.Facets.of(mesh, *flags.patches, angle=angle), target, flags.onto)


def _scaled_target(target: jm.Facets, factor: float) -> jm.Facets:
    if target.model is None:
        return target.at(np.asarray(target.points) * factor)
    model = target.model.scaled(factor)
    return jm.Facets(model.facets.points, model.facets.triangles, model=model)


ONTO_WORDS = {
    "`features`": "--onto-features",
    "the `angle` of `Facets`": "--onto-angle",
    "`length=(.*?)`": r"--onto-length \1",
    "`length`": "--onto-length",
    "Multiply its points by": "Give --onto-scale",
    "Scale the CAD model by (.*?), or the mesh": r"Give --onto-scale \1",
}
"""Words of `shapes.onto` for arguments, and those of the command line."""


def _onto_shape(patch: MovingPatch) -> Parametrised:
    mesh = patch.mesh
    assert patch.wall is not None
    wall, target, _ = patch.wall
    d = patch.dimension
    sides = [mesh.patch(name) for name in mesh.patch_names(*patch.symmetry)]
    touching = [nodes for nodes in sides if np.isin(nodes, patch.nodes).sum() >= d - 1]
    planes = [jm.Plane.through(np.asarray(mesh.points), nodes) for nodes in touching]
    length = patch.group.onto_length or 0.0
    try:
        features = [
            (_rows_of_wall(own, patch), list(other))
            for own, other in patch.group.onto_features or ()
        ]
        u = shapes.onto(wall, target, symmetry=planes, features=features, length=length)
    except ValueError as error:
        is_of_nodes = isinstance(error, jm.MeshError)
        said = str(error.renumbered(patch.nodes) if is_of_nodes else error)
        for word, flag in ONTO_WORDS.items():
            said = re.sub(word, flag, said)
        raise ValueError(said) from None
    return shapes.Function(lambda x, factor: x + factor * u, 0.0), 1.0


def _rows_of_wall(nodes: tuple[int, ...], patch: MovingPatch) -> np.ndarray:
    missing = np.setdiff1d(nodes, patch.nodes)
    if len(missing):
        raise ValueError(f"`features`: nodes {some(missing)} are not among those that move.")
    return np.searchsorted(patch.nodes, nodes)


def _modes_shape(patch: MovingPatch) -> Parametrised:
    files, amplitudes = zip(*patch.group.mode, strict=True)
    fields = [
        io.read_displacement(file, patch.mesh, patch.nodes, is_position=False) for file in files
    ]
    return shapes.Modes(np.stack(fields)), np.array(amplitudes)


def _box_shape(patch: MovingPatch) -> Parametrised:
    assert patch.group.box is not None
    return io.read_box(patch.group.box, patch.dimension)


def _scale_shape(patch: MovingPatch) -> Parametrised:
    about = patch.about
    given = patch.group.scale or []
    factors = given[0] if len(given) == 1 else np.array(given)
    return shapes.Function(
        lambda x, factors: shapes.scale(x, factors, about), np.ones_like(factors)
    ), factors


def _translation_shape(patch: MovingPatch) -> Parametrised:
    return shapes.Function(shapes.translate, np.zeros(patch.dimension)), np.array(
        patch.group.translate
    )


ANGLE_MOTIONS: dict[str, tuple[Callable, Names]] = {
    "twist": (shapes.twist, ("about", "along", "length")),
    "bend": (shapes.bend, ("about", "along", "length", "axis")),
    "rotate": (shapes.rotate, ("about", "axis")),
}
"""Motions by an angle, and their other arguments."""


def _turn_shape(name: str, patch: MovingPatch) -> Parametrised:
    """Makes a motion by an angle; the line of a twist or bend ends where the surface does."""
    function, needs = ANGLE_MOTIONS[name]
    flags = patch.group
    along: Any = flags.along or ([1.0, 0.0] if patch.dimension == 2 else None)
    length = flags.length
    if "along" in needs and along is None:
        raise ValueError("the direction --along X Y Z is missing.")
    if "length" in needs and length is None:
        length = ((patch.points - patch.about) @ along).max() / np.linalg.norm(along)
    given = {"about": patch.about, "along": along, "axis": flags.axis, "length": length}
    found = [None if given[need] is None else np.array(given[need], float) for need in needs]
    turn = jax.jit(lambda x, angle: function(x, jnp.radians(angle), *found))
    # checks directions and lengths; a trace does not know the angle of a bend's directions
    if name == "bend":
        function(patch.points, 0.0, *found)
    else:
        turn.eval_shape(patch.points, 0.0)
    return shapes.Function(turn, 0.0), getattr(flags, name)


PARTS: dict[str, Callable[[MovingPatch], Parametrised]] = {
    "displacement": _displacement_shape,
    "onto": _onto_shape,
    "mode": _modes_shape,
    "box": _box_shape,
    "scale": _scale_shape,
    "twist": functools.partial(_turn_shape, "twist"),
    "bend": functools.partial(_turn_shape, "bend"),
    "rotate": functools.partial(_turn_shape, "rotate"),
    "translate": _translation_shape,
}
"""Makers of shapes by field of a group, in the order in which the shapes are applied."""
