"""The kinds of patches in a file, and their meaning for `prepare`."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from .._host.package.errors import warn
from .._mesh.mesh import Mesh
from .boundary import planes_of
from .periodic import Periodic
from .symmetry import check_planes

SYMMETRY = frozenset({"BCSymmetryPlane", "symmetry", "symmetryPlane", "axis"})
INSIDE = "cyclic", "processor", "empty", "wedge"
"""Beginnings of the kinds of patches that are no outer boundary."""


def by_kinds(mesh: Any, moving: Any, periodic: Any) -> tuple[list[str], list[str]]:
    """Chooses fixed and symmetry patches from the kinds that the file has, where a caller names moving ones alone.

    Symmetry patches that lie in planes are symmetry. All others of which the file says what they are stay. It warns of what it
    chose. Nothing is chosen where the file says nothing, and where `moving` are no names.
    """
    names = (
        [moving]
        if isinstance(moving, str)
        else list(moving)
        if isinstance(moving, list | tuple | set | frozenset)
        else []
    )
    if not isinstance(mesh, Mesh) or not names or not all(isinstance(name, str) for name in names):
        return [], []
    pairs = [periodic] if isinstance(periodic, Periodic) else periodic if isinstance(periodic, Iterable) else ()
    sides = [side for pair in pairs if isinstance(pair, Periodic) for side in (pair.patch, pair.partner)]
    elsewhere = {*mesh.patch_names(*names), *(side for side in sides if isinstance(side, str))}
    kinds = {name: kind for name, kind in mesh.kinds.items() if name not in elsewhere and len(mesh.patches[name])}
    fixed = [name for name, kind in kinds.items() if kind not in SYMMETRY and not kind.startswith(INSIDE)]
    symmetry, planes = [], []
    for name in (name for name, kind in kinds.items() if kind in SYMMETRY):
        try:
            more = [*planes, *planes_of(mesh, name)]
            check_planes(more, np.asarray(mesh.points))
        except ValueError:  # a bent one is left for the caller to name
            continue
        symmetry, planes = [*symmetry, name], more
    clauses = [
        f"{what} are " + ", ".join(f"{name!r} ({kinds[name]})" for name in patches)
        for what, patches in (("`fixed`", fixed), ("`symmetry`", symmetry))
        if patches
    ]
    if clauses:
        warn(
            f"No patches beside `moving` are named. By their kinds in the file {' and '.join(clauses)}. Name them to say so."
        )
    return fixed, symmetry
