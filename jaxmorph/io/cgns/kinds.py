"""The types of a CGNS file's boundary conditions."""

from typing import Any

from .zone import Zone, children, word

SYMMETRY = "BCSymmetryPlane"
UNSAID = ("", "Null", "FamilySpecified")


def kinds_of(file: Any, zones: list[Zone]) -> dict[str, str]:
    """Finds each patch's type: its conditions' or family's; several in turn, if they differ."""
    families = {}
    for _, base in children(file, "CGNSBase_t"):
        for name, family in children(base, "Family_t"):
            families[name] = [
                word(condition) for _, condition in children(family, "FamilyBC_t") if " data" in condition
            ]
    types: dict[str, list[str]] = {}
    for zone in zones:
        for patch, _, condition in zone.conditions():
            kind = word(condition) if " data" in condition else ""
            types.setdefault(patch, []).extend(families.get(patch, []) if kind in UNSAID else [kind])
    kinds = {
        patch: ", ".join(dict.fromkeys(kind for kind in several if kind not in UNSAID))
        for patch, several in types.items()
    }
    return {patch: kind for patch, kind in kinds.items() if kind}


def symmetry_of(kinds: dict[str, str]) -> tuple[str, ...]:
    """Lists the patches that lie in symmetry planes."""
    return tuple(patch for patch, kind in kinds.items() if kind == SYMMETRY)
