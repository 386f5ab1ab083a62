"""Names of patches in a mesh file, for the tab key and for faults told before JAX is imported."""

import contextlib
import re
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

from jaxmorph.extend import decoded, patch_names

TAG = re.compile(rb"MARKER_?TAG[ \t]*=[ \t]*([^%\r\n]*)")


def _markers(file: Path) -> list[str]:
    text = file.read_bytes()
    starts = [(text.rfind(b"\n", 0, match.start()) + 1, match) for match in TAG.finditer(text)]
    return [decoded(match[1].strip()) for start, match in starts if not text[start : match.start()].strip()]


def check_names(file: Path, names: Sequence[str]) -> None:
    """Raises `ValueError` for names that no marker of an SU2 file has; not for other files."""
    if file.suffix.lower() == ".su2" and names and (markers := _markers(file)):
        patch_names(names, dict.fromkeys(markers), {})


def completer(prefix: str, parsed_args: Namespace, **_: object) -> list[str]:
    """Lists patches and groups of the mesh that the words before name; none for what is no mesh."""
    file = getattr(parsed_args, "file", None)
    with contextlib.suppress(Exception):  # the shell's line is no place for a fault
        if file is not None and file.suffix.lower() == ".su2":
            return _markers(file)
        if file is not None:
            from jaxmorph import io

            mesh = io.read(file)
            return [*mesh.patches, *mesh.groups]
    return []
