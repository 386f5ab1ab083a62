"""Tables of nodes: node id, x, y[, z], in text, and SU2's restart files in binary."""

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from .._host.package.arguments import checked
from .._host.package.files import input_path, read_arrays, real_array
from .._host.package.rounding import rows_in
from ._format import faults_of
from ._text import PathLike, Section, decoded

FACT = re.compile(rb"^[ \t]*[A-Za-z_]+[ \t]*=.*$", re.MULTILINE)
"""A line `NAME= value`, as SU2's older restarts have behind their rows."""
NAME = re.compile(rb"\"[^\"]*\"|[^\s,;]+")
IDS = ("pointid", "point_id", "id", "node", "globalindex", "global_index")
"""Headers of the column of node ids, which is the first one otherwise."""
MAGIC = 535532
"""The first number of a binary restart, in four bytes of either order."""
HEADER = 5
"""Whole numbers at its beginning: `MAGIC`, the counts of columns and nodes, and two zeros."""
WIDTH = 33
"""Bytes of the name of one of its columns."""


@checked
def read_surface(path: PathLike, d: int) -> tuple[Int[ndarray, " m"], Float[ndarray, "m d"]]:
    """Reads ids and d numbers each, from lines `id, x, y[, z]`: SU2's surfaces, or CSV.

    Numbers stand between blanks, commas or semicolons; a header line and what follows `%` or `#`
    are skipped. The numbers are positions or displacements.

    **Arguments:**

    - `path`: the file.
    - `d`: how many numbers follow each id, 2 or 3.

    **Returns:** node ids (m,) and numbers (m, d).

    **Raises:** `ValueError`, with file and line, for other contents and duplicate or broken ids.
    """
    path = input_path(path)
    with faults_of(path):
        return read_table(path, d)


def read_table(path: Path, d: int, wanted: tuple[str, ...] = ()) -> tuple[Int[ndarray, " m"], Float[ndarray, "m d"]]:
    """Reads node ids and d numbers for each; with `wanted` those of columns with these headers."""
    text = path.read_bytes()
    if wanted and MAGIC in (int.from_bytes(text[:4], "little"), int.from_bytes(text[:4], "big")):
        return _restart(text, wanted[:d])
    text = FACT.sub(b"", re.sub(rb"[%#][^\n]*", b"", text))
    start = _after_header(text)
    names = [name.strip(b"\"'").lower().decode(errors="replace") for name in NAME.findall(text[:start])]
    section = Section(path, re.sub(rb"[,;]", b" ", text), start, len(text))
    rows = section.rows(np.float64)
    if not len(rows.counts):
        raise ValueError(f"no rows of node id and {d} numbers in this file.")
    columns, width, expected = list(range(d + 1)), d + 1, f"a node id and {d} numbers"
    if wanted and {*wanted[:d]} <= {*names}:
        columns = [next((k for k, name in enumerate(names) if name in IDS), 0), *map(names.index, wanted[:d])]
        if max(columns) > d:
            width, expected = len(names), f"{len(names)} numbers, as in the header,"
    rows.refuse(rows.counts != width, lambda k: f"{expected} expected, found {rows.counts[k]} numbers.")
    table = rows.values.reshape(-1, width)[:, columns]
    ids = np.abs(np.floor(table[:, 0]))
    is_wrong = ~np.isfinite(table).all(axis=1) | (ids != table[:, 0])
    rows.refuse(is_wrong, lambda k: f"found {table[k].tolist()}, not a node id and {d} finite numbers.")
    copies = np.setdiff1d(np.arange(len(ids)), np.unique(ids, return_index=True)[1])
    rows.refuse(copies, lambda k: f"node {ids[k]:.0f} comes a second time.")
    return ids.astype(np.int64), np.ascontiguousarray(table[:, 1:])


def read_named(
    path: Path, names: tuple[str, ...], ids: Int[ndarray, " m"] | None = None
) -> tuple[Int[ndarray, " m"], ndarray, str]:
    """Reads node ids (if absent `ids`, or 0, 1, 2, ...), an array of `names`, and its name."""
    arrays = read_arrays(path)
    found = [name for name in names if name in arrays]
    if len(found) != 1:
        listed = ", ".join(arrays) or "none"
        raise ValueError(f"one array {' or '.join(names)} expected, found {listed}.")
    values = real_array(path, arrays, found[0])
    ids = arrays.get("ids", np.arange(len(np.atleast_1d(values))) if ids is None else ids)
    if ids.dtype.kind not in "iu" or ids.ndim != 1:
        raise ValueError(f"ids must be whole numbers (n,), found {ids.dtype} of shape {ids.shape}.")
    copies = len(ids) - len(np.unique(ids))
    if copies:
        raise ValueError(f"{copies} of its {len(ids)} node ids come a second time.")
    return ids, values, found[0]


def in_order(
    ids: ndarray,
    values: ndarray,
    d: int,
    wanted: Int[ndarray, " m"],
    known: tuple[ndarray, str],
) -> Float[ndarray, "m d"]:
    """Returns the values of the nodes `wanted` from a file's, in the order of its `ids`.

    Raises `ValueError` for values that are not finite or not (ids, d), for ids that are not among
    those `known`, with what these are called, and for missing ones.
    """
    if values.shape != (len(ids), d) or not np.isfinite(values).all():
        raise ValueError(f"finite values of shape ({len(ids)}, {d}) expected, found shape {values.shape}.")
    foreign, missing = np.setdiff1d(ids, known[0]), np.setdiff1d(wanted, ids)
    faults = [f"{foreign.size} of its {len(ids)} node ids are not of {known[1]} (first {x})" for x in foreign[:1]]
    faults += [f"{missing.size} of the {len(wanted)} nodes are missing (first {x})" for x in missing[:1]]
    if faults:
        raise ValueError(f"{', and '.join(faults)}.")
    return values[rows_in(ids, wanted)]


def _restart(path: Path, content: bytes, wanted: tuple[str, ...]) -> tuple[Int[ndarray, " n"], Float[ndarray, "n d"]]:
    """Reads columns of a binary restart, which has a row for each node in the order of the mesh."""
    order = "<" if int.from_bytes(content[:4], "little") == MAGIC else ">"
    begin = 4 * HEADER
    k, n = map(int, np.frombuffer(content[:begin].ljust(begin, b"\0"), f"{order}i4")[1:3])
    start = begin + WIDTH * k
    size = start + 8 * n * k
    if k < 1 or n < 1 or len(content) < size:
        raise ValueError(
            f"a binary restart of {n} nodes and {k} columns has {size} bytes or more, found {len(content)}."
        )
    words = np.frombuffer(content, f"S{WIDTH}", k, begin).tolist()
    names = [decoded(word.partition(b"\0")[0]).strip("\"' ").lower() for word in words]
    missing = ", ".join(name for name in wanted if name not in names)
    if missing:
        raise ValueError(f"a binary restart without the columns {missing}; it has {', '.join(names)}.")
    values = np.frombuffer(content, f"{order}f8", n * k, start).reshape(n, k)[:, [*map(names.index, wanted)]]
    return np.arange(n), values.astype(float)


def _after_header(text: bytes) -> int:
    """Finds where the line after a header begins: a first line that begins with a name."""
    first = len(text) - len(text.lstrip())
    end = text.find(b"\n", first)
    word = text[first : end if end >= 0 else len(text)].split()[:1]
    is_name = bool(word) and word[0].strip(b"\"'")[:1].isalpha() and word[0].lower() not in (b"nan", b"inf")
    return (end + 1 if end >= 0 else len(text)) if is_name else 0
