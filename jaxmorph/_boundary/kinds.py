"""What a file says that patches are, and what that means for `prepare`."""

from typing import Any

import numpy as np

from .._host.package.errors import warn
from .._mesh.mesh import Mesh
from .symmetry import check_planes

SYMMETRY = frozenset({"BCSymmetryPlane", "symmetry", "symmetryPlane", "axis"})
INSIDE = "cyclic", "processor", "empty", "wedge"
"""How the kinds of patches begin that are no outer boundary."""


def by_kinds(mesh: Mesh, moving: tuple[str, ...], periodic: set[str], planes_of: Any) -> tuple[list[str], list[str]]:
    """Chooses fixed and symmetry patches from the kinds that the file has, where a caller names moving ones alone.

    Symmetry patches that lie in planes are symmetry. All others of which the file says what they are stay. It warns of what it
    chose. Nothing is chosen where the file says nothing.
    """
    others = {
        name: kind for name, kind in mesh.kinds.items() if name not in {*moving, *periodic} and len(mesh.patches[name])
    }
    fixed = [name for name, kind in others.items() if kind not in SYMMETRY and not kind.startswith(INSIDE)]
    symmetry, planes = [], []
    for name in (name for name, kind in others.items() if kind in SYMMETRY):
        try:
            lying = planes_of(mesh, name)
            check_planes([*planes, *lying], np.asarray(mesh.points))
        except ValueError:  # a bent one is left for the caller to name
            continue
        symmetry.append(name)
        planes += lying
    lists = [("`fixed`", fixed), ("`symmetry`", symmetry)]
    said = [
        f"{what} are " + ", ".join(f"{name!r} ({others[name]})" for name in names) for what, names in lists if names
    ]
    if said:
        warn(
            f"No patches beside `moving` are named. By their kinds in the file {' and '.join(said)}. Name them to say so."
        )
    return fixed, symmetry
