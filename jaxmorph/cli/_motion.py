"""The motion of a surface that the command line describes, made of the library's shapes."""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

import jaxmorph as jm
from jaxmorph import Mesh, io, shapes
from jaxmorph._host.package.text import read
from jaxmorph.extend import input_path

from ._early import is_given, lattice_files
from ._output import coordinates, some
from ._parser import flag_of
from ._requests import MOTIONS, Deform, MotionFlags, Table

Points = Float[np.ndarray, "m d"]
Parametrised = tuple[shapes.AbstractShape, Any]

SIDES = ("upper", "lower")
CHORD = ("nose", "tail", "up")


@dataclasses.dataclass(frozen=True)
class Motion:
    """Shape and parameters, by name of the patches, then of the flag; `boxes` with lattices."""

    shape: shapes.Chain
    parameters: dict[str, dict[str, Any]]
    boxes: tuple[tuple[Path, shapes.FreeForm | shapes.Hexahedron, tuple[str, str]], ...] = ()

    def path(self, surface: Points, steps: int) -> Float[np.ndarray, "k m d"]:
        return np.asarray(shapes.path(self.shape, surface, self.parameters, steps))

    def at(self, surface: Points, share: float) -> Points:
        values = jax.tree.map(lambda a, b: a + share * (b - a), self.shape.neutral(), self.parameters)
        return dataclasses.replace(self, parameters=values).path(surface, 1)[0]

    def varied(self, changes: Mapping[str, Sequence[float]]) -> "Motion":
        try:
            return dataclasses.replace(self, parameters=shapes.varied(self.parameters, changes))
        except ValueError as error:
            raise ValueError(f"--set: {error}") from None

    def write_lattices(self) -> list[Path]:
        files = []
        for file, box, (patches, name) in self.boxes:
            for place, control in zip(lattice_files(file), (None, self.parameters[patches][name]), strict=True):
                files.append(place)
                io.write_lattice(place, box.lattice(control))
        return files


def motion(request: Deform, mesh: Mesh, moving: Int[np.ndarray, " m"]) -> Motion:
    """Makes the requested motion of the nodes `moving`.

    A patch moves as the groups that name it, one after the other; a node of several patches as the
    first of them. Raises `ValueError` for no motion, one that does not fit the mesh or the nodes,
    and patches that move a common node differently.
    """
    groups, chains, parameters, boxes = request.groups, {}, {}, []
    for group in groups:
        key, patch = _key(group, chains), MovingPatch(group, mesh, mesh.patch(*group.patches))
        try:
            parts = patch.parts()
        except ValueError as error:
            raise ValueError(f"{group.title}: {error}" if len(groups) > 1 else str(error)) from None
        chain = shapes.Chain({name: shape for name, (shape, _) in parts.items()})
        chains[key] = shapes.OnRows(chain, np.searchsorted(moving, patch.nodes))
        parameters[key] = {name: values for name, (_, values) in parts.items()}
        if group.lattice is not None:
            boxes.append((group.lattice, parts["box"][0], (key, "box")))
    sides = _sides(groups, mesh, moving)
    owned = {key: _of_own(chain, moving, sides, number) for number, (key, chain) in enumerate(chains.items())}
    made = Motion(shapes.Chain(owned), parameters, tuple(boxes)).varied(dict(request.set))
    _check_agreement(made, chains, groups, sides, (moving, np.asarray(mesh.points, float)[moving]))
    return made


@dataclasses.dataclass(frozen=True)
class SharedSide:
    """Moving nodes of the same groups: `groups` by number, `nodes`, and its `own` among them."""

    groups: tuple[int, ...]
    nodes: np.ndarray
    own: np.ndarray

    def flags(self, groups: Sequence[MotionFlags]) -> str:
        words = []
        for group in (groups[number] for number in self.groups):
            flags = [flag_of(name) for name in MOTIONS if is_given(group, name)]
            words.append(" ".join(["--moving", *group.patches, *flags]))
        return ", then ".join(words)


def _sides(groups: Sequence[MotionFlags], mesh: Mesh, moving: np.ndarray) -> list[SharedSide]:
    names = [mesh.patch_names(*group.patches) for group in groups]
    by_groups: dict[tuple[int, ...], list[str]] = {}
    for patch in dict.fromkeys(name for patches in names for name in patches):
        numbers = tuple(number for number, patches in enumerate(names) if patch in patches)
        by_groups.setdefault(numbers, []).append(patch)
    sides, left = [], moving
    for numbers, patches in by_groups.items():
        nodes = mesh.patch(*patches)
        sides.append(SharedSide(numbers, nodes, np.intersect1d(nodes, left)))
        left = np.setdiff1d(left, nodes)
    return sides


def _of_own(chain: shapes.OnRows, moving: np.ndarray, sides: list[SharedSide], number: int) -> shapes.OnRows:
    """Restricts the motion of a group to the nodes that are no other side's own."""
    own = np.concatenate([side.own for side in sides if number in side.groups])
    shape, is_moved = chain.shape, np.isin(moving[chain.rows], own)
    if is_moved.all():
        return chain
    some = shapes.Function(lambda x, values: jnp.where(is_moved[:, None], shape(x, values), x), shape.neutral())
    return shapes.OnRows(some, chain.rows)


def _check_agreement(
    made: Motion,
    chains: Mapping[str, shapes.OnRows],
    groups: Sequence[MotionFlags],
    sides: list[SharedSide],
    wall: tuple[np.ndarray, Points],
) -> None:
    """Raises `ValueError` where two sides move a common node differently, beyond round-off."""
    nodes, points = wall
    for side in sides:
        rows = np.searchsorted(nodes, np.setdiff1d(side.nodes, side.own))
        if not len(rows):
            continue
        own = {key: chain for number, (key, chain) in enumerate(chains.items()) if number in side.groups}
        alone = Motion(shapes.Chain(own), {key: made.parameters[key] for key in own})
        u, other = (way.path(points, 1)[-1] for way in (made, alone))
        off = np.linalg.norm(u[rows] - other[rows], axis=1)
        order = np.argsort(-off, kind="stable")
        wrong = rows[order[off[order] > 1e-9 * np.abs(u).max() + 1e-13 * np.abs(points).max()]]
        if len(wrong):
            first = next(owner for owner in sides if nodes[wrong[0]] in owner.own)
            raise ValueError(
                f"{first.flags(groups)} and {side.flags(groups)} move {len(wrong)} common nodes differently, by up to "
                f"{off.max():.3g}: nodes {some(nodes[wrong])}, the first near {coordinates(points[wrong[0]])}. Name both "
                "patches after one --moving, or take the common nodes out of one of the patches."
            )


def _key(group: MotionFlags, others: Mapping[str, Any]) -> str:
    """Names a group by `--name` or by its patches, with a number if the name is taken."""
    name = group.name or "+".join(group.patches)
    if group.name in others:
        raise ValueError(f"--name {group.name}: another --moving has this name.")
    return next(key for key in (name, *(f"{name}{k}" for k in range(2, len(others) + 3))) if key not in others)


class MovingPatch(NamedTuple):
    group: MotionFlags
    mesh: Mesh
    nodes: np.ndarray

    @property
    def dimension(self) -> int:
        return self.mesh.points.shape[1]

    def parts(self) -> "dict[str, Parametrised]":
        return {name.replace("_", "-"): make(self) for name, make in PARTS.items() if is_given(self.group, name)}

    def argument(self, name: str, option: str) -> Any:
        if name == "length":
            return self.length(option)
        if name != "axis":
            return self.vector("about") if name == "about" else self.direction(name)
        if self.dimension == 2 and self.group.axis is not None:
            raise ValueError("--axis is for meshes in 3-D; this one is in 2-D.")
        if self.dimension == 3 and self.group.axis is None:
            raise ValueError(f"{option} needs --axis X Y Z for a mesh in 3-D.")
        return self.direction("axis") if self.dimension == 3 else None

    def vector(self, name: str) -> np.ndarray:
        values, d = getattr(self.group, name), self.dimension
        if values is None:
            return np.zeros(d)
        if len(values) != d:
            found = " ".join(f"{value:g}" for value in values)
            raise ValueError(f"{flag_of(name)} needs {d} numbers for a mesh in {d}-D, found: {found}.")
        return np.array(values)

    def direction(self, name: str) -> np.ndarray:
        """Scales a vector to length 1; in 2-D the default is the first axis."""
        if getattr(self.group, name) is None:
            if self.dimension == 3:
                raise ValueError(f"{flag_of(name)} X Y Z is missing.")
            return np.array([1.0, 0.0])
        vector = self.vector(name)
        return vector / np.linalg.norm(vector)

    def length(self, option: str) -> float:
        """Measures the line of a bend or twist, by default to the end of the surface."""
        given = self.group.length
        ahead = (np.asarray(self.mesh.points)[self.nodes] - self.vector("about")) @ self.direction("along")
        length = float(ahead.max()) if given is None else given
        if not (np.isfinite(length) and length > 0):
            reason = "and no node lies ahead of --about in that direction" if given is None else f"found {length:g}"
            raise ValueError(f"{option} needs a --length above 0, {reason}.")
        return length


def _displacement(patch: MovingPatch) -> Parametrised:
    group = patch.group
    assert group.displacement is not None
    how: dict[str, Any] = {"before": group.displacement_from, "is_position": group.displacement_is == "position"}
    u = io.read_displacement(group.displacement, patch.mesh, patch.nodes, **how)
    turn = jm.Turn.of(np.asarray(patch.mesh.points)[patch.nodes], u)
    return shapes.Function(lambda x, share: x + turn.at(share), 0.0), 1.0


def _modes(patch: MovingPatch) -> Parametrised:
    files, amplitudes = zip(*patch.group.mode, strict=True)
    fields = [io.read_displacement(file, patch.mesh, patch.nodes, is_position=False) for file in files]
    return shapes.Modes(np.stack(fields)), np.array(amplitudes)


def _box(patch: MovingPatch) -> Parametrised:
    assert patch.group.box is not None
    return io.read_box(patch.group.box, patch.dimension)


def _scale(patch: MovingPatch) -> Parametrised:
    about, given = patch.vector("about"), patch.group.scale or ()
    factors = given[0] if len(given) == 1 else patch.vector("scale")
    return shapes.Function(lambda x, factors: shapes.scale(x, factors, about), np.ones_like(factors)), factors


TURNS: dict[str, tuple[Callable, tuple[str, ...]]] = {
    "twist": (shapes.twist, ("about", "along", "length")),
    "bend": (shapes.bend, ("about", "along", "length", "axis")),
    "rotate": (shapes.rotate, ("about", "axis")),
}
"""Motions by an angle, and their other arguments."""


def _turned(name: str, patch: MovingPatch) -> Parametrised:
    function, needs = TURNS[name]
    if name == "twist" and patch.dimension == 2:
        raise ValueError("--twist is for meshes in 3-D; this one is in 2-D.")
    found = {need: patch.argument(need, flag_of(name)) for need in needs}
    if name == "bend" and found["axis"] is not None and abs(found["axis"] @ found["along"]) > 1e-3:
        raise ValueError("--bend needs --axis and --along at right angles.")
    turn = jax.jit(lambda x, angle: function(x, jnp.radians(angle), *found.values()))
    return shapes.Function(turn, 0.0), getattr(patch.group, name)


def _translate(patch: MovingPatch) -> Parametrised:
    return shapes.Function(shapes.translate, np.zeros(patch.dimension)), patch.vector("translate")


def _bumps(patch: MovingPatch) -> Parametrised:

    def bumps(rows: np.ndarray, table: Table, chord: shapes.Chord) -> Parametrised:
        return shapes.HicksHenne(rows[:, 0], table.get("width", 3.0), chord=chord), rows[:, 1]

    return _on_sides("hicks-henne", patch.group.hicks_henne, patch, ((None, 2), "width"), bumps)


def _class_functions(patch: MovingPatch) -> Parametrised:

    def functions(weights: np.ndarray, table: Table, chord: shapes.Chord) -> Parametrised:
        if len(weights) < 3:
            raise ValueError(
                f"--cst: a side has {len(weights)} numbers; two weights or more are expected, then the ordinate of the edge."
            )
        exponents = _numbers("cst", {"exponents": [0.5, 1.0]} | table, "exponents", (2,)).tolist()
        return shapes.CST(len(weights) - 2, tuple(exponents), chord=chord), weights

    return _on_sides("cst", patch.group.cst, patch, ((None,), "exponents"), functions)


def _on_sides(
    flag: str,
    source: Path | Table | None,
    patch: MovingPatch,
    entries: tuple[tuple[int | None, ...], str],
    make: Callable,
) -> Parametrised:
    """Makes a shape for each side of an airfoil; `entries`: shape of its numbers, one more name."""
    shape, more = entries
    table = read(str(source), input_path(source).read_bytes()) if isinstance(source, Path) else source or {}
    foreign = set(table) - {*SIDES, more, *CHORD}
    if foreign or not set(table) & set(SIDES):
        listed, known = ", ".join(table) or "nothing", ", ".join((more, *CHORD))
        raise ValueError(f"--{flag}: upper or lower expected, and perhaps {known}; found {listed}.")
    chord = _chord(flag, table, patch)
    upper = shapes.wall_normals(patch.mesh, *patch.group.patches) @ np.asarray(chord.up) >= 0
    made = {side: make(_numbers(flag, table, side, shape), table, chord) for side in SIDES if side in table}
    masks = {"upper": upper, "lower": ~upper}
    chain = shapes.Chain({side: shapes.Part(part, masks[side]) for side, (part, _) in made.items()})
    return chain, {side: values for side, (_, values) in made.items()}


PARTS: dict[str, Callable[[MovingPatch], Parametrised]] = {
    "displacement": _displacement,
    "mode": _modes,
    "box": _box,
    "hicks_henne": _bumps,
    "cst": _class_functions,
    "scale": _scale,
    "twist": functools.partial(_turned, "twist"),
    "bend": functools.partial(_turned, "bend"),
    "rotate": functools.partial(_turned, "rotate"),
    "translate": _translate,
}
"""Makers of shapes by field of a group, in the order in which the shapes are applied."""


def _numbers(flag: str, table: Table, name: str, shape: tuple[int | None, ...]) -> np.ndarray:
    try:
        values = np.array(table[name], float)
    except (TypeError, ValueError):
        values = np.zeros(0)
    fits = values.ndim == len(shape) and all(n in (None, m) for n, m in zip(shape, values.shape, strict=False))
    if not fits or not values.size or not np.isfinite(values).all():
        what = "a list of [centre, height]" if shape == (None, 2) else "a list of numbers"
        raise ValueError(f"--{flag}: {name} is {what}, found {str(table[name])[:60]}.")
    return values


def _chord(flag: str, table: Table, patch: MovingPatch) -> shapes.Chord:
    ends = {name: _numbers(flag, table, name, (patch.dimension,)) for name in CHORD if name in table}
    if {"nose", "tail"} <= set(ends):
        return shapes.Chord(**ends)
    if ends:
        raise ValueError(f"--{flag}: a chord has a nose and a tail; found {', '.join(ends)} alone.")
    if patch.dimension == 2:
        return shapes.Chord.along(np.asarray(patch.mesh.points)[patch.nodes])
    raise ValueError(f"--{flag}: a wall in 3-D needs its chord: nose, tail and up, three numbers each.")
