"""Texts with other words in place of some of their own."""

import numpy as np

WIDEST = 64
"""Bytes of a text that are one row of a table at most."""


def spliced(text: bytes, starts: np.ndarray, ends: np.ndarray, lines: bytes) -> bytes:
    """Replaces what stands between `starts` and `ends` of a text by `lines`, without line ends.

    Pieces of text and lines alternate. Each becomes a row of a table as wide as the widest of its
    kind, and the rows are written one after the other without what is beyond their ends. A long
    piece becomes several rows, and no line follows but the last of them.
    """
    begins = np.append(0, ends[:-1])
    rows = 1 + (starts - begins) // WIDEST
    last = np.cumsum(rows) - 1
    place = np.repeat(begins - WIDEST * (last + 1 - rows), rows) + WIDEST * np.arange(rows.sum())
    own = _rows(text, place, np.minimum(np.repeat(starts, rows) - place, WIDEST))
    breaks = np.append(np.flatnonzero(np.frombuffer(lines, np.uint8) == ord("\n")), len(lines))
    first, size = np.zeros((2, len(place)), np.int64)
    first[last] = np.append(0, breaks[:-1] + 1)
    size[last] = breaks - first[last]
    table, inside = (np.concatenate(pair, axis=1) for pair in zip(own, _rows(lines, first, size), strict=True))
    return table[inside].tobytes() + text[ends[-1] :]


def _rows(text: bytes, starts: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gathers bytes from each of `starts`, as wide as the longest; a mask marks own bytes."""
    width = max(int(sizes.max()), 1)
    windows = np.ndarray(len(text) + 1, f"V{width}", text + bytes(width), strides=(1,))
    return windows[starts].view(np.uint8).reshape(-1, width), np.arange(width) < sizes[:, None]
