"""What users write: TOML, mistyped names, names of patches. It needs no NumPy."""

import contextlib
import difflib
import re
import tomllib
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

SENSITIVITIES = (".csv", ".npz")
GRADIENTS = (".csv", ".json")
LATTICES = (".vts",)


def parse_toml(name: str, content: bytes) -> dict[str, Any]:
    try:
        text = content.decode()
        return tomllib.loads(text.replace("\r\n", "\n"))
    except (
        ValueError
    ) as error:  # also for letters that are not UTF-8, and for numbers of thousands of digits
        raise ValueError(f"{name}: not TOML ({error}).") from None
    except RecursionError:
        keys = re.split(r"(?m)^[ \t]*([\w-]+)[ \t]*=", content.decode())[1:]
        values = {
            key: value.count("[") + value.count("{")
            for key, value in zip(keys[::2], keys[1::2], strict=True)
        }
        deepest = max(values, key=values.__getitem__, default="the file")
        raise ValueError(
            f"{name}: {deepest} is nested too deep: thousands of brackets in each other."
        ) from None


def similar(word: str, known: Iterable[str]) -> str | None:
    """The known word that was probably meant, in small letters or capitals; None if none."""
    words = {other.lower(): other for other in known}
    near = difflib.get_close_matches(word.lower(), list(words), n=1)
    return words[near[0]] if near else None


SHOWN_NAMES = 12  # names that an error lists


def patch_names(
    names: Sequence[str], patches: Collection[str], groups: Mapping[str, Sequence[str]]
) -> tuple[str, ...]:
    """Lists patches of names: a patch, a group, or the matches of a whole regular expression.

    `groups` has lists of patches by name. **Raises:** `ValueError` for a name without any, with the
    names that there are.
    """
    listed: list[str] = []
    for name in names:
        found = [patch for patch in groups.get(name, ()) if patch in patches]
        if name in patches:
            found = [name]
        elif name not in groups:
            with contextlib.suppress(re.error):
                found = [patch for patch in patches if re.fullmatch(name, patch)]
            if not found:
                known = list_names(patches, groups)
                raise ValueError(
                    f"no patch is called {name!r}{_suggest(name, [*patches, *groups])}; {known}."
                )
        listed += found
    return tuple(dict.fromkeys(listed))


def _suggest(name: str, known: Sequence[str]) -> str:
    shell = re.sub(r"(?<![.\])])\*", ".*", name)
    if (
        shell != name
        and not re.search(r"[\[(\\]", shell)
        and any(re.fullmatch(shell, patch) for patch in known)
    ):
        return f" (patterns are regular expressions: {shell!r})"
    near = similar(name, known)
    return f" (did you mean {near!r}?)" if near else ""


def list_names(patches: Collection[str], groups: Mapping[str, Sequence[str]]) -> str:
    names = [repr(name) for name in patches]
    more = f" and {len(names) - SHOWN_NAMES} more" if len(names) > SHOWN_NAMES else ""
    of_groups = f", and the groups {', '.join(map(repr, groups))}" if groups else ""
    return f"this mesh has: {', '.join(names[:SHOWN_NAMES]) or 'none'}{more}{of_groups}"


def decoded(raw: bytes) -> str:
    """Decodes a name in a file: UTF-8, or else Latin-1, which older programs write."""
    try:
        return raw.decode()
    except UnicodeDecodeError:
        return raw.decode("latin-1")
