"""Tables of surface nodes: node id, x, y[, z]."""

import os
import pathlib
import re

import numpy as np
from jaxtyping import Float, Int

from .._host.package.arguments import checked
from .._host.package.files import input_path
from .text.sections import Section

FACT = re.compile(rb"^[ \t]*[A-Za-z_]+[ \t]*=.*$", re.MULTILINE)
"""A line `NAME= value`, such as those behind the rows of SU2's older restarts."""
IDS = (b"pointid", b"point_id", b"id", b"node", b"globalindex", b"global_index")
"""Names that headers give to the column of node ids, which is the first one otherwise."""


@checked
def read_surface(path: str | os.PathLike[str], d: int) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m d"]]:
    """Reads ids and d numbers each, from lines `id, x, y[, z]`: SU2's surfaces, or CSV.

    Numbers stand between blanks, commas or semicolons; a header line and what follows `%` or `#`
    are skipped. The numbers are positions or displacements, as the caller knows.

    **Arguments:**

    - `path`: the file.
    - `d`: how many numbers follow each id, 2 or 3.

    **Returns:** node ids (m,) and numbers (m, d).

    **Raises:** `ValueError`, with file and line, for other contents and for ids that come twice or
    are no whole numbers.
    """
    return read_table(input_path(path), d)


def read_table(
    path: pathlib.Path, d: int, wanted: tuple[str, ...] = ()
) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m d"]]:
    """Reads node ids and d numbers for each.

    Columns that a header calls as `wanted` are taken, whatever stands beside them; else all.
    """
    text = path.read_bytes()
    for mark in (b"%", b"#"):
        text = b"\n".join(line.partition(mark)[0] for line in text.split(b"\n"))
    text = FACT.sub(b"", text)
    start = _after_header(text)
    names = [name.strip(b"\"'").lower() for name in re.findall(rb"\"[^\"]*\"|[^\s,;]+", text[:start])]
    text = text.replace(b",", b" ").replace(b";", b" ")
    section = Section(path, text, start, len(text))
    rows = section.rows(np.float64)
    if not len(rows.counts):
        raise ValueError(f"{path}: no rows of node id and {d} numbers in this file.")
    columns = [0, *range(1, d + 1)]
    if wanted and all(name.encode() in names for name in wanted[:d]):
        number = next((k for k, name in enumerate(names) if name in IDS), 0)
        columns = [number, *(names.index(name.encode()) for name in wanted[:d])]
    width = len(names) if max(columns) > d else d + 1
    wrong = np.flatnonzero(rows.counts != width)
    if wrong.size:
        expected = f"a node id and {d} numbers" if width == d + 1 else f"{width} numbers, as in the header,"
        contents = f"found {rows.counts[wrong[0]]} numbers"
        raise section.error(f"{expected} expected, {contents}.", int(wrong[0]))
    table = rows.values.reshape(-1, width)[:, columns]
    wrong = np.flatnonzero(~np.isfinite(table).all(axis=1) | (table[:, 0] != np.floor(table[:, 0])) | (table[:, 0] < 0))
    if wrong.size:
        raise section.error(f"found {table[wrong[0]].tolist()}, not a node id and {d} finite numbers.", int(wrong[0]))
    ids = table[:, 0].astype(np.int64)
    _, first = np.unique(ids, return_index=True)
    if len(first) < len(ids):
        row = int(np.setdiff1d(np.arange(len(ids)), first)[0])
        raise section.error(f"node {ids[row]} comes a second time.", row)
    return ids, np.ascontiguousarray(table[:, 1:])


def _after_header(text: bytes) -> int:
    """Finds where the line after a header begins: a first line that begins with a name."""
    first = len(text) - len(text.lstrip())
    end = text.find(b"\n", first)
    word = text[first : end if end >= 0 else len(text)].split()[:1]
    is_name = bool(word) and word[0].strip(b"\"'")[:1].isalpha() and word[0].lower() not in (b"nan", b"inf")
    return (end + 1 if end >= 0 else len(text)) if is_name else 0
