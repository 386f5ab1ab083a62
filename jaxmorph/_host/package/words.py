"""Words that a user has mistyped; the command line reads this without NumPy."""

import difflib
from collections.abc import Iterable


def similar(word: str, known: Iterable[str]) -> str | None:
    """Finds the known word that was probably meant, in small letters or capitals; None if none."""
    words = {other.lower(): other for other in known}
    near = difflib.get_close_matches(word.lower(), list(words), n=1)
    return words[near[0]] if near else None
