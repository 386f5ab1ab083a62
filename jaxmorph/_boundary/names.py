"""Checked names of a caller: points, node ids, patches, planes and slides."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Int

from .._host.package.arguments import real_array, rows_of, shown
from .._host.package.errors import MeshError, warn
from .._mesh.mesh import Mesh
from .periodic import Periodic
from .slide import Slide
from .symmetry import Plane, check_planes

USE = 'prepare(mesh, "airfoil", "farfield") with a Mesh, or prepare(points, moving_ids, fixed_ids)'

SMALL = 1e4  # smallest extent of a mesh, relative to the length whose cube is the smallest normal number


def checked_points(points: Any) -> np.ndarray:
    if isinstance(points, str | bytes) or points is None:
        raise ValueError(f"`prepare` takes a mesh or points first, not {points!r}. Call {USE}.")
    array = real_array("points", points, (None, 2), (None, 3))
    if array.dtype not in (np.float32, np.float64):
        array = array.astype(np.float64)
    check_finite(array)
    dtype = jax.dtypes.canonicalize_dtype(array.dtype)  # the precision of the plan
    size = np.abs(array).max(axis=1, initial=0)
    far = np.flatnonzero(size > np.finfo(dtype).max ** (1 / 3))
    if len(far):
        raise MeshError(
            f"{len(far)} of {len(array)} points are too far out for {dtype}, first node {{node}} at {size[far[0]]:.3g}: "
            "volumes overflow. Choose a larger unit of length.",
            far,
        )
    extent = float(np.ptp(array, axis=0).max(initial=0)) if len(array) else 0.0
    if 0 < extent < SMALL * float(np.finfo(dtype).tiny) ** (1 / 3):
        raise ValueError(
            f"all {len(array)} points lie within {extent:.3g}, too near each other for {dtype}: volumes underflow. "
            "Choose a smaller unit of length."
        )
    return array


def check_finite(points: np.ndarray) -> None:
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        raise MeshError(
            f"{(~finite).sum()} of {len(points)} points are not finite, first node {{node}}.", np.flatnonzero(~finite)
        )


def names_in(values: Any) -> tuple[str, ...] | None:
    if isinstance(values, str):
        return (values,)
    is_list = isinstance(values, list | tuple | set | frozenset)
    return tuple(values) if is_list and values and all(isinstance(name, str) for name in values) else None


def nodes_named(values: Any, name: str, mesh: Mesh | None, n: int) -> Int[np.ndarray, " k"]:
    names = names_in(values)
    if names is None:
        return node_ids(values, name, n)
    if mesh is None:
        raise ValueError(
            f"`{name}` names patches ({', '.join(map(repr, names))}), but points alone have no patches: pass the mesh, "
            f"prepare(mesh, ...), or node ids, mesh.patch({names[0]!r})."
        )
    return mesh.patch(*names).astype(np.int64)


def node_ids(values: Any, name: str, n: int) -> Int[np.ndarray, " k"]:
    if values is None or isinstance(values, Mesh | Plane):
        raise ValueError(f"`{name}` must be node ids or names of patches, not {shown(values)}. Call {USE}.")
    if n == 0:
        raise ValueError(f"the mesh has no points. Call {USE}.")
    return rows_of(name, values, n)


PAIRS = "pairs such as jm.Periodic('lower', 'upper', translation=(0, 1))"
PLANES = "jm.Plane(normal=(0, 1), origin=(0, 0)), jm.Plane.through(points, nodes), or the name of a patch of the mesh"
SLIDES = "slides such as jm.Slide('shroud', jm.Revolution((1, 0, 0))), or names of patches"


def several(name: str, value: Any, kinds: type | tuple[type, ...], example: str) -> list[Any]:
    entries = [value] if isinstance(value, kinds) else value
    is_list = isinstance(entries, Sequence | set | frozenset) and not isinstance(entries, str | bytes)
    wrong = [entry for entry in entries if not isinstance(entry, kinds)] if is_list else [value]
    if wrong:
        raise ValueError(f"`{name}` holds {shown(wrong[0])}: pass {example}.")
    return list(entries)


def planes_named(symmetry: Any, points: np.ndarray, mesh: Mesh | None) -> tuple[Plane, ...]:
    planes: list[Plane] = []
    for entry in several("symmetry", symmetry, Plane if mesh is None else (Plane, str), PLANES):
        of_entry = (entry,) if isinstance(entry, Plane) or mesh is None else Plane.of_patch(mesh, entry)
        planes += [new for new in of_entry if not any(new.equals(plane, points) for plane in planes)]
    return tuple(planes)


def slides(sliding: Any) -> list[Slide]:
    """Lists slides; a name slides along its own faces."""
    entries = several("sliding", sliding, (Slide, str), SLIDES)
    return [Slide(entry) if isinstance(entry, str) else entry for entry in entries]


def check_named_once(sliding: Any, **lists: Any) -> None:
    for slide in slides(sliding):
        for name, values in lists.items():
            both = set(names_in(slide.patch) or ()) & set(names_in(values) or ())
            if both:
                raise ValueError(
                    f"the patch {min(both)!r} is named in `sliding` and in `{name}`: it would not slide. Remove it from one list."
                )


SYMMETRY = frozenset({"BCSymmetryPlane", "symmetry", "symmetryPlane", "axis"})

INSIDE = "cyclic", "processor", "empty", "wedge", "overset"
"""Prefixes of kinds of patches that are no outer boundary; overset grids lie inside others."""


def by_kinds(mesh: Any, moving: Any, periodic: Sequence[Periodic]) -> tuple[list[str], list[str]]:
    """Chooses fixed and symmetry patches by their kinds in the file, if only moving ones are named.
    Symmetry patches that lie in planes slide; all other outer patches with a kind are fixed. A
    warning names the choice. Nothing is chosen without kinds, or where `moving` are no names.
    """
    names = names_in(moving)
    if not isinstance(mesh, Mesh) or names is None:
        return [], []
    kinds = _outer_kinds(mesh, {*mesh.patch_names(*names)}.union(*(pair.patches for pair in periodic)))
    symmetry = [name for name in kinds if kinds[name] in SYMMETRY]
    fixed, symmetry = [name for name in kinds if name not in symmetry], _in_planes(mesh, symmetry)
    clauses = _clauses(kinds, fixed=fixed, symmetry=symmetry)
    if clauses:
        warn(
            f"No patches beside `moving` are named. By their kinds in the file {clauses}. Name the patches to choose otherwise."
        )
    return fixed, symmetry


def _outer_kinds(mesh: Mesh, elsewhere: set[str]) -> dict[str, str]:
    return {
        name: kind
        for name, kind in mesh.kinds.items()
        if name not in elsewhere and len(mesh.patches[name]) and not kind.startswith(INSIDE)
    }


def _clauses(kinds: Mapping[str, str], **lists: list[str]) -> str:
    shown = {name: ", ".join(f"{patch!r} ({kinds[patch]})" for patch in patches) for name, patches in lists.items()}
    return " and ".join(f"`{name}` are {patches}" for name, patches in shown.items() if patches)


def _in_planes(mesh: Mesh, names: list[str]) -> list[str]:
    """Lists the patches that lie in planes; the caller must name a bent one."""
    flat, planes = [], []
    for name in names:
        try:
            more = [*planes, *Plane.of_patch(mesh, name)]
            check_planes(more, np.asarray(mesh.points))
        except ValueError:
            continue
        flat, planes = [*flat, name], more
    return flat
