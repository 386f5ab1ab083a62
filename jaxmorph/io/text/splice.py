"""Texts with other words in place of some of their own."""

import numpy as np

WIDEST = 64
"""Bytes of the longest piece that is handled in one row of a table with all others."""


def spliced(text: bytes, starts: np.ndarray, ends: np.ndarray, lines: bytes) -> bytes:
    """Replaces what stands between `starts` and `ends` of a text by `lines`, without line ends.

    Pieces of text and lines alternate. Each becomes a row of a table as wide as the widest of its
    kind, and the rows are written one after the other without what is beyond their ends.
    """
    breaks = np.append(np.flatnonzero(np.frombuffer(lines, np.uint8) == ord("\n")), len(lines))
    first = np.append(0, breaks[:-1] + 1)
    begins = np.append(0, ends[:-1])
    if max(int((starts - begins)[1:].max(initial=0)), int((breaks - first).max())) > WIDEST:
        return _joined(text, starts, ends, lines)
    head, begins[0] = text[: starts[0]], starts[0]
    own = _rows(text, begins, starts - begins)
    new = _rows(lines, first, breaks - first)
    table, inside = (np.concatenate(pair, axis=1) for pair in zip(own, new, strict=True))
    return b"".join((head, table[inside].tobytes(), text[ends[-1] :]))


def _rows(text: bytes, starts: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gathers bytes from each of `starts`, as wide as the longest; a mask marks own bytes."""
    width = max(int(sizes.max()), 1)
    windows = np.ndarray(len(text) + 1, f"V{width}", text + bytes(width), strides=(1,))
    return windows[starts].view(np.uint8).reshape(-1, width), np.arange(width) < sizes[:, None]


def _joined(text: bytes, starts: np.ndarray, ends: np.ndarray, lines: bytes) -> bytes:
    pieces: list[bytes] = [b""] * (2 * len(starts) + 1)
    begins, stops = starts.tolist(), ends.tolist()
    pieces[0::2] = map(text.__getitem__, map(slice, [0, *stops], [*begins, len(text)]))
    pieces[1::2] = lines.split(b"\n")
    return b"".join(pieces)
