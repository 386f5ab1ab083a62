"""Names of patches, from names, groups and patterns."""

import re
from collections.abc import Collection, Mapping, Sequence

from .._host.package.text import similar

SHOWN = 12
"""Names that an error lists."""


def patch_names(names: Sequence[str], patches: Collection[str], groups: Mapping[str, Sequence[str]]) -> tuple[str, ...]:
    """Lists patches of names: a patch, a group, or patches that match a whole regular expression.

    **Raises:** `ValueError` for a name without a patch.
    """
    listed: list[str] = []
    for name in names:
        if name in patches:
            listed.append(name)
        elif name in groups:
            listed += [patch for patch in groups[name] if patch in patches]
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
    """Suggests a similar known name, or the regular expression for a shell's pattern."""
    shell = re.sub(r"(?<![.\])])\*", ".*", name)
    if shell != name and not re.search(r"[\[(\\]", shell) and any(re.fullmatch(shell, patch) for patch in known):
        return f" (patterns are regular expressions: {shell!r})"
    near = similar(name, known)
    return f" (did you mean {near!r}?)" if near else ""


def _known(patches: Collection[str], groups: Mapping[str, Sequence[str]]) -> str:
    names = [repr(name) for name in patches]
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    of_groups = f", and the groups {', '.join(map(repr, groups))}" if groups else ""
    return f"this mesh has: {', '.join(names[:SHOWN]) or 'none'}{more}{of_groups}"
