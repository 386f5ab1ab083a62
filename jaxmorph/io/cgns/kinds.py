"""The types of a CGNS file's boundary conditions, and groups of their families."""

from collections.abc import Iterable
from typing import Any

from .conditions import Condition
from .zone import children, word

SYMMETRY = "BCSymmetryPlane"
UNSAID = ("", "Null", "FamilySpecified")


def kinds_of(file: Any, conditions: list[Condition]) -> dict[str, str]:
    """Finds each patch's type: its conditions' or family's; several in turn, if they differ."""
    families = _of_families(file, "FamilyBC_t")
    types: dict[str, list[str]] = {}
    for condition in conditions:
        kind = condition.kind
        types.setdefault(condition.patch, []).extend(families.get(condition.patch, []) if kind in UNSAID else [kind])
    kinds = {
        patch: ", ".join(dict.fromkeys(kind for kind in several if kind not in UNSAID))
        for patch, several in types.items()
    }
    return {patch: kind for patch, kind in kinds.items() if kind}


def _of_families(file: Any, label: str) -> dict[str, list[str]]:
    """Reads the words of each family's nodes of a label."""
    families = [family for _, base in children(file, "CGNSBase_t") for family in children(base, "Family_t")]
    return {name: [word(node) for _, node in children(family, label) if " data" in node] for name, family in families}


def symmetry_of(kinds: dict[str, str]) -> tuple[str, ...]:
    """Lists the patches that lie in symmetry planes."""
    return tuple(patch for patch, kind in kinds.items() if kind == SYMMETRY)


def groups_of(file: Any, conditions: list[Condition], names: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Lists patches by the families that their family is part of, and by additional families.

    gmsh names physical groups so. Names of patches are no groups.
    """
    above = _of_families(file, "FamilyName_t")
    groups: dict[str, dict[str, None]] = {}
    for patch, _, condition in conditions:
        more = [word(family) for _, family in children(condition, "AdditionalFamilyName_t")]
        for group in [*above.get(patch, []), *more]:
            groups.setdefault(group, {})[patch] = None
    known = set(names)
    groups = {name: {patch: None for patch in several if patch in known} for name, several in groups.items()}
    return {name: tuple(several) for name, several in groups.items() if name not in known and several}
