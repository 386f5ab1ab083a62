"""What each patch of an OpenFOAM case does by the types in its `pointDisplacement`."""

import re
from collections.abc import Iterator
from typing import Any, NamedTuple

from jaxmorph import Mesh
from jaxmorph._host.package.arguments import checked

from .._format import content_of
from .case import NAME, CaseContent, is_time
from .file import FoamFile, load_file, parse_nested

FIELD = "pointDisplacement"
VALUED = ("fixedValue", "uniformFixedValue")
"""Types of patches that are fixed where their value is zero, and move where it is not."""
WITHOUT_VALUES = {
    "zeroGradient": "free",
    "calculated": "free",
    "slip": "sliding",
    "fixedNormalSlip": "sliding",
    "surfaceSlipDisplacement": "sliding",
    "cyclicAMI": "fixed",
    "cyclicACMI": "fixed",
}
"""What patches do that get no displacement of their own."""
OF_THE_MESH = ("empty", "wedge", "symmetry", "symmetryPlane", "cyclic", "cyclicSlip", "processor")
"""Types that the mesh itself knows."""

_VALUES = re.compile(rb"nonuniform\s+List<(\w+)>\s*(\d+)\s*\(")
_WIDTHS = {b"scalar": 1, b"vector": 3}

Words = list[Any]


class FoamEntry(NamedTuple):
    """An entry of a dictionary: `key words;`, or `key { inner }`."""

    key: str
    words: Words
    inner: Words | None


@checked
def patch_roles(mesh: Mesh) -> dict[str, str]:
    """Tells which patches of an OpenFOAM case move by the boundary of its `pointDisplacement`.

    That of the first time that has one is read, else of `0.orig`.

    - `fixedValue` and `uniformFixedValue` of zero: fixed. Others move, though something else, such
      as preCICE, may move a patch that begins at zero.
    - `slip`, `fixedNormalSlip`, `surfaceSlipDisplacement`: sliding.
    - `zeroGradient`, `calculated`: free. `cyclicAMI`, `cyclicACMI`: fixed.
    - All other types have values: moving.

    Types that the mesh knows are left out (`symmetry`, `cyclic`, `empty` and so on), and patches
    whose entry a directive or a variable hides.

    **Arguments:**

    - `mesh`: what `read` returned of a case.

    **Returns:** "moving", "fixed", "sliding" or "free" by patch; nothing without the file.
    """
    content = content_of(mesh, NAME)
    file = None if content is None else _find_field(content)
    if file is None:
        return {}
    entries = {entry.key: entry for entry in _entries(parse_nested(_without_lists(file)))}
    if "boundaryField" not in entries or entries["boundaryField"].inner is None:
        return {}
    inside = entries["internalField"].words if "internalField" in entries else []
    patches = list(_entries(entries["boundaryField"].inner))
    roles = {}
    for name in mesh.patches:
        groups = [group for group, names in mesh.groups.items() if name in names]
        entry = _find_entry(patches, name, groups)
        role = "" if entry is None else _role(entry, inside)
        if role:
            roles[name] = role
    return roles


def _find_field(content: CaseContent) -> FoamFile | None:
    case = content.case
    if case is None:
        return None
    region = content.place.parent
    times = sorted(filter(is_time, case.iterdir()), key=lambda folder: float(folder.name))
    for time in (*times, case / "0.orig"):
        folder = time / region
        if any((folder / name).is_file() for name in (FIELD, f"{FIELD}.gz")):
            return load_file(folder, FIELD)
    return None


def _without_lists(file: FoamFile) -> bytes:
    """Cuts lists of values out, which may be long, or binary: who has one has no uniform value."""
    data = file.data
    parts = []
    at = file.end
    while match := _VALUES.search(data, at):
        end = data.find(b";", match.end())
        if file.is_binary:
            size = _WIDTHS.get(match[1], 1) * file.dtype("scalar").itemsize
            end = match.end() + int(match[2]) * size + 1
        parts.append(data[at : match.start()] + b"nonuniform")
        at = max(end, match.end())
    return b"".join([*parts, data[at:]])


def _entries(words: Words) -> Iterator[FoamEntry]:
    """Yields the entries of a dictionary; a directive before one is left out."""
    pending: Words = []
    for word in words:
        if isinstance(word, list):
            if pending:
                yield FoamEntry(str(pending[-1]), [], word)
            pending = []
        elif word == ";":
            if pending:
                yield FoamEntry(str(pending[0]), pending[1:], None)
            pending = []
        else:
            pending.append(word)


def _find_entry(entries: list[FoamEntry], name: str, groups: list[str]) -> FoamEntry | None:
    """Finds a patch's entry as OpenFOAM does: by its name, its groups, then the last pattern."""
    by_name = {entry.key.strip('"'): entry for entry in entries if entry.inner is not None}
    for key in (name, *reversed(groups)):
        if key in by_name:
            return by_name[key]
    patterns = [entry for entry in by_name.values() if entry.key.startswith('"')]
    return next((entry for entry in reversed(patterns) if _fits(entry.key, name)), None)


def _fits(pattern: str, name: str) -> bool:
    try:
        return re.fullmatch(pattern.strip('"'), name) is not None
    except re.error:
        return False


def _role(entry: FoamEntry, inside: Words) -> str:
    own = {
        found.key: found.words if found.inner is None else ["{"]
        for found in _entries(entry.inner or [])
    }
    kind = "".join(own.get("type", [])).strip('"')
    if kind.startswith(("$", "#")) or kind in ("", *OF_THE_MESH):
        return ""
    if kind in VALUED:
        return _role_of_value(own.get("uniformValue", own.get("value", [])), inside)
    return WITHOUT_VALUES.get(kind, "moving")


def _role_of_value(value: Words, inside: Words) -> str:
    if value == ["$internalField"]:
        value = inside
    if not value or any(str(word).startswith(("$", "#")) for word in value):
        return ""
    numbers = [word for word in value if word not in ("uniform", "constant", "(", ")")]
    return "fixed" if all(_is_zero(word) for word in numbers) else "moving"


def _is_zero(word: Any) -> bool:
    try:
        return float(word) == 0
    except (TypeError, ValueError):
        return False
