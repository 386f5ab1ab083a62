"""Names of patches, from names, groups and patterns."""

import difflib
import re
from collections.abc import Collection, Mapping, Sequence

SHOWN = 12
"""Names that an error lists."""


def patch_names(names: Sequence[str], patches: Collection[str], groups: Mapping[str, Sequence[str]]) -> tuple[str, ...]:
    """Lists the patches that names mean: a patch, else a group, else all that a regular expression matches whole.

    **Raises:** `ValueError` for a name that means none.
    """
    listed: list[str] = []
    for name in names:
        if name in patches:
            listed.append(name)
        elif name in groups:
            listed += [each for each in groups[name] if each in patches]
        else:
            listed += _matched(name, patches, groups)
    return tuple(dict.fromkeys(listed))


def _matched(pattern: str, patches: Collection[str], groups: Mapping[str, Sequence[str]]) -> list[str]:
    try:
        matched = [name for name in patches if re.fullmatch(pattern, name)]
    except re.error:
        matched = []
    if not matched:
        raise ValueError(
            f"no patch is called {pattern!r}{_hint(pattern, [*patches, *groups])}; {_known(patches, groups)}."
        )
    return matched


def _hint(name: str, known: Sequence[str]) -> str:
    """Suggests a known name like the given one, or the regular expression for a shell's pattern."""
    shell = re.sub(r"(?<![.\])])\*", ".*", name)
    if shell != name and any(re.fullmatch(shell, each) for each in known if not re.search(r"[\[(\\]", shell)):
        return f" (patterns are regular expressions: {shell!r})"
    near = difflib.get_close_matches(name, known, n=1)
    return f" (did you mean {near[0]!r}?)" if near else ""


def _known(patches: Collection[str], groups: Mapping[str, Sequence[str]]) -> str:
    names = [repr(name) for name in patches]
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    named = f", and the groups {', '.join(map(repr, groups))}" if groups else ""
    return f"this mesh has: {', '.join(names[:SHOWN]) or 'none'}{more}{named}"
