"""The kinds of patches in a file, and their meaning for `prepare`."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from .._host.package.errors import warn
from .._mesh.mesh import Mesh
from .names import names_in, planes_of
from .periodic import Periodic
from .symmetry import check_planes

SYMMETRY = frozenset({"BCSymmetryPlane", "symmetry", "symmetryPlane", "axis"})
"""Kinds of symmetry planes."""

INSIDE = "cyclic", "processor", "empty", "wedge"
"""Beginnings of the kinds of patches that are no outer boundary."""


def by_kinds(mesh: Any, moving: Any, periodic: Any) -> tuple[list[str], list[str]]:
    """Chooses fixed and symmetry patches by their kinds in the file, if only moving ones are named.
    Symmetry patches that lie in planes slide; all other patches with a kind are fixed. A warning
    names the choice. Nothing is chosen without kinds, or where `moving` are no names.
    """
    names = names_in(moving)
    if not isinstance(mesh, Mesh) or names is None:
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
        except ValueError:  # a bent patch: the caller must name it
            continue
        symmetry, planes = [*symmetry, name], more
    clauses = [
        f"{what} are " + ", ".join(f"{name!r} ({kinds[name]})" for name in patches)
        for what, patches in (("`fixed`", fixed), ("`symmetry`", symmetry))
        if patches
    ]
    if clauses:
        warn(
            f"No patches beside `moving` are named. By their kinds in the file {' and '.join(clauses)}. Name the patches to "
            "choose otherwise."
        )
    return fixed, symmetry
