"""SU2's restart files in binary: numbers by node, and the names of their columns."""

import pathlib

import numpy as np
from jaxtyping import Float

MAGIC = 535532
"""The first number of the file, in four bytes of either order."""
HEADER = 5
"""Whole numbers at the beginning: `MAGIC`, the counts of columns and nodes, and two zeros."""
WIDTH = 33
"""Bytes of a column's name."""


def is_restart(path: pathlib.Path) -> bool:
    """Says whether a file begins as SU2's binary restarts do."""
    with path.open("rb") as stream:
        head = stream.read(4)
    return len(head) == 4 and MAGIC in (int.from_bytes(head, "little"), int.from_bytes(head, "big"))


def read_restart(path: pathlib.Path) -> tuple[list[str], Float[np.ndarray, "n k"]]:
    """Reads the columns' names and their values, a row for each node in the order of the mesh.

    Raises `ValueError` for a file that is cut short.
    """
    content = path.read_bytes()
    order = "<" if int.from_bytes(content[:4], "little") == MAGIC else ">"
    begin = 4 * HEADER
    k, n = np.frombuffer(content[:begin].ljust(begin, b"\0"), f"{order}i4")[1:3].astype(int).tolist()
    start = begin + WIDTH * k
    if k < 1 or n < 1 or len(content) < start + 8 * n * k:
        raise ValueError(
            f"{path}: a binary restart of {n} nodes and {k} columns has {start + 8 * n * k} bytes or more, found {len(content)}."
        )
    names = [content[begin + WIDTH * i : begin + WIDTH * (i + 1)].partition(b"\0")[0] for i in range(k)]
    values = np.frombuffer(content, f"{order}f8", count=n * k, offset=start).reshape(n, k).astype(float)
    return [name.decode(errors="replace").strip("\"' ").lower() for name in names], values
