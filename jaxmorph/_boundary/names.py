"""Points, nodes, planes and patches as a caller names them, checked."""

import contextlib
import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Int, Integer

from .._host.package.arguments import real_array, rows_of, shown
from .._host.package.errors import MeshError, check_all_finite, check_none, warn
from .._kernels.values import is_known
from .._mesh.mesh import Mesh
from .outer_faces import Ids
from .periodic import Periodic
from .slide import Slide
from .symmetry import Mirrors, Plane

USE = 'prepare(mesh, "airfoil", "farfield") with a Mesh, or prepare(points, moving_ids, fixed_ids)'

# smallest extent of a mesh, relative to the length whose cube is the smallest normal number
LEAST_EXTENT = 1e4
PAIRS = "pairs such as jm.Periodic('lower', 'upper', translation=(0, 1))"
PLANES_EXAMPLE = (
    "jm.Plane(normal=(0, 1), origin=(0, 0)), jm.Plane.through(points, nodes), or the name of a "
    "patch of the mesh"
)
SLIDES = "slides such as jm.Slide('shroud', jm.Revolution((1, 0, 0))), or names of patches"
SYMMETRY = frozenset({"BCSymmetryPlane", "symmetry", "symmetryPlane", "axis"})

INNER_KINDS = "cyclic", "processor", "empty", "wedge", "overset"
"""Prefixes of kinds of patches that are no outer boundary; overset grids lie inside others."""

Nodes = str | Sequence[str] | Integer[jax.Array | np.ndarray, " _k"] | Sequence[int | np.integer]


@dataclasses.dataclass(frozen=True, eq=False)
class Named:
    """Points, and what a caller names among them: ids of nodes, planes, pairs and slides.

    A node is once in `moving`, and in `fixed` if it does not move. `pairs` have the nodes of both
    sides, `slides` those of their patch, ascending.
    """

    points: np.ndarray
    moving: Int[np.ndarray, " m"]
    fixed: Int[np.ndarray, " f"]
    free: Int[np.ndarray, " g"]
    planes: tuple[Plane, ...]
    pairs: list[tuple[Periodic, np.ndarray, np.ndarray]]
    slides: list[tuple[Slide, np.ndarray]]

    @classmethod
    def of(cls, mesh: Any, moving: Any, fixed: Any, symmetry: Any, **others: Any) -> "Named":
        """Finds the nodes; the `others` are lists of periodic, sliding and free patches."""
        patches = mesh if isinstance(mesh, Mesh) else None
        points = checked_points(mesh.points if isinstance(mesh, Mesh) else mesh)
        pairs = several("periodic", others.pop("periodic"), Periodic, PAIRS)
        if patches is not None:
            lists = {"fixed": fixed, "symmetry": symmetry, **others}
            fixed, symmetry = by_kinds(patches, moving, pairs, lists)
        slides = [
            Slide(entry) if isinstance(entry, str) else entry  # a name slides along its own faces
            for entry in several("sliding", others["sliding"], (Slide, str), SLIDES)
        ]
        check_named_once(slides, fixed=fixed, symmetry=symmetry)

        def nodes(name: str, values: Any) -> Ids:
            return nodes_named(values, name, patches, len(points))

        def ascending(name: str, values: Any) -> Ids:
            return np.unique(nodes(name, values))

        moves = nodes("moving", moving)
        return cls(
            points=points,
            moving=moves,
            fixed=_leave_out(moves, nodes("fixed", fixed), fixed),
            free=nodes("free", others["free"]),
            planes=planes_named(symmetry, points, patches),
            pairs=[
                (pair, ascending("periodic", pair.patch), ascending("periodic", pair.partner))
                for pair in pairs
            ],
            slides=[(slide, ascending("sliding", slide.patch)) for slide in slides],
        )


def _leave_out(moving: Int[np.ndarray, " m"], fixed: Int[np.ndarray, " f"], named: Any) -> Ids:
    """Lists fixed nodes that do not move, each where it comes first."""
    if names_in(named) and not len(fixed):
        raise ValueError(
            f"the patches of `fixed`, {shown(named)}, have no nodes: nothing would be "
            "fixed. Name others, or leave `fixed` out."
        )
    unique, counts = np.unique(moving, return_counts=True)
    check_none(
        unique[counts > 1], "{count} nodes are named more than once in `moving`, first node {node}."
    )
    fixed = fixed[np.sort(np.unique(fixed, return_index=True)[1])]
    return fixed[~np.isin(fixed, moving)]


def nothing_in(*lists: Any) -> bool:
    """Checks whether all lists are as by default: an array without an id is a choice."""
    return all(isinstance(named, tuple) and not named for named in lists)


def checked_points(points: Any) -> np.ndarray:
    if isinstance(points, str | bytes) or points is None:
        raise ValueError(f"`prepare` takes a mesh or points first, not {points!r}. Call {USE}.")
    if not is_known(points):
        raise ValueError(
            "the points are traced, inside of jit, grad or vmap, but ids are found on the host: "
            "call `prepare` outside, and `refit(plan, points)` inside."
        )
    array = real_array("points", points, (None, 2), (None, 3))
    if array.dtype not in (np.float32, np.float64):
        array = array.astype(np.float64)
    check_all_finite(array)
    dtype = jax.dtypes.canonicalize_dtype(array.dtype)  # the precision of the plan
    size = np.abs(array).max(axis=1, initial=0)
    far = np.flatnonzero(size > np.finfo(dtype).max ** (1 / 3))
    if len(far):
        raise MeshError(
            f"{len(far)} of {len(array)} points are too far out for {dtype}, first node {{node}} "
            f"at {size[far[0]]:.3g}: "
            "volumes overflow. Choose a larger unit of length.",
            far,
        )
    extent = float(np.ptp(array, axis=0).max(initial=0)) if len(array) else 0.0
    if 0 < extent < LEAST_EXTENT * float(np.finfo(dtype).tiny) ** (1 / 3):
        raise ValueError(
            f"all {len(array)} points lie within {extent:.3g}, too near each other for {dtype}: "
            "volumes underflow. "
            "Choose a smaller unit of length."
        )
    return array


def names_in(values: Any) -> tuple[str, ...] | None:
    if isinstance(values, str):
        return (values,)
    is_list = isinstance(values, list | tuple | set | frozenset)
    return (
        tuple(values)
        if is_list and values and all(isinstance(name, str) for name in values)
        else None
    )


def nodes_named(values: Any, name: str, mesh: Mesh | None, n: int) -> Ids:
    names = names_in(values)
    if names is None:
        if values is None or isinstance(values, Mesh | Plane):
            raise ValueError(
                f"`{name}` must be node ids or names of patches, not {shown(values)}. Call {USE}."
            )
        if n == 0:
            raise ValueError(f"the mesh has no points. Call {USE}.")
        return rows_of(name, values, n)
    if mesh is None:
        raise ValueError(
            f"`{name}` names patches ({', '.join(map(repr, names))}), but points alone have no "
            "patches: pass the mesh, "
            f"prepare(mesh, ...), or node ids, mesh.patch({names[0]!r})."
        )
    return mesh.patch(*names).astype(np.int64)


def several(name: str, value: Any, kinds: type | tuple[type, ...], example: str) -> list[Any]:
    entries = [value] if isinstance(value, kinds) else value
    is_list = isinstance(entries, Sequence | set | frozenset) and not isinstance(
        entries, str | bytes
    )
    wrong = [entry for entry in entries if not isinstance(entry, kinds)] if is_list else [value]
    if wrong:
        raise ValueError(f"`{name}` holds {shown(wrong[0])}: pass {example}.")
    return list(entries)


def planes_named(symmetry: Any, points: np.ndarray, mesh: Mesh | None) -> tuple[Plane, ...]:
    planes: list[Plane] = []
    for entry in several(
        "symmetry", symmetry, Plane if mesh is None else (Plane, str), PLANES_EXAMPLE
    ):
        of_entry = (
            (entry,) if isinstance(entry, Plane) or mesh is None else Plane.of_patch(mesh, entry)
        )
        planes += [
            new for new in of_entry if not any(new.equals(plane, points) for plane in planes)
        ]
    return tuple(planes)


def check_named_once(slides: Sequence[Slide], **lists: Any) -> None:
    for slide in slides:
        for name, values in lists.items():
            both = set(names_in(slide.patch) or ()) & set(names_in(values) or ())
            if both:
                raise ValueError(
                    f"the patch {min(both)!r} is named in `sliding` and in `{name}`: it would not "
                    "slide. Remove it from one list."
                )


def by_kinds(
    mesh: Mesh, moving: Any, periodic: Sequence[Periodic], lists: Mapping[str, Any]
) -> tuple[Any, Any]:
    """Adds to `fixed` and `symmetry` of the lists by kinds in the file, where all are of names.

    Symmetry patches in no list that lie in planes slide. If only `moving` are named, all other
    outer patches with a kind are fixed. A warning names the choice.
    """
    is_alone = nothing_in(*lists.values())
    fixed, symmetry = lists["fixed"], lists["symmetry"]
    names = _names_of_all(moving, *lists.values())
    if names is None:
        return fixed, symmetry
    kinds = _outer_kinds(mesh, {*mesh.patch_names(*names)}.union(*(p.patches for p in periodic)))
    mirrors = [name for name in kinds if kinds[name] in SYMMETRY]
    others = [name for name in kinds if name not in mirrors] if is_alone else []
    mirrors = _in_planes(mesh, mirrors)
    clauses = _clauses(kinds, fixed=others, symmetry=[*mirrors])
    if clauses:
        alone = "No patches beside `moving` are named. " if is_alone else ""
        warn(f"{alone}By their kinds in the file {clauses}. Name the patches to choose otherwise.")
    given = several("symmetry", symmetry, (Plane, str), PLANES_EXAMPLE)
    return others or fixed, [*given, *itertools.chain(*mirrors.values())]


def _names_of_all(moving: Any, *lists: Any) -> tuple[str, ...] | None:
    """Lists all names of patches; None where a list has ids, or nothing moves by name."""
    names = names_in(moving)
    for values in lists if names else ():
        entries = [values] if isinstance(values, str | Slide | Plane) else values
        for entry in entries if isinstance(entries, list | tuple | set | frozenset) else (None,):
            named = names_in(entry.patch if isinstance(entry, Slide) else entry)
            if names is None or (named is None and not isinstance(entry, Plane)):
                return None
            names += named or ()
    return names


def _clauses(kinds: Mapping[str, str], **lists: list[str]) -> str:
    shown = {
        name: ", ".join(f"{patch!r} ({kinds[patch]})" for patch in patches)
        for name, patches in lists.items()
    }
    return " and ".join(f"`{name}` are {patches}" for name, patches in shown.items() if patches)


def _outer_kinds(mesh: Mesh, elsewhere: set[str]) -> dict[str, str]:
    return {
        name: kind
        for name, kind in mesh.kinds.items()
        if not (kind.startswith(INNER_KINDS) or name in elsewhere) and len(mesh.patches[name])
    }


def _in_planes(mesh: Mesh, names: list[str]) -> dict[str, tuple[Plane, ...]]:
    """Finds the planes of the patches that lie in planes; the caller must name a bent one."""
    points = np.asarray(mesh.points)
    planes: dict[str, tuple[Plane, ...]] = {}
    for name in names:
        with contextlib.suppress(ValueError):
            more = planes | {name: Plane.of_patch(mesh, name)}
            mirrors = Mirrors.of(tuple(itertools.chain(*more.values())), points)
            mirrors.check(points, mesh.topology.loose)
            planes = more
    return planes
