"""Floating point numbers out of text and into it, many at once: by SciPy's reader and writer of Matrix Market files.

They round correctly and write the fewest digits, as `float` and `repr` do, and take a third of the time.
"""

import io
import warnings

import numpy as np
import scipy.io

ENOUGH = 1 << 14
"""Bytes from which on this pays."""

_BLANKS = b" \t\n\r\v\f"
_LINES = bytes.maketrans(_BLANKS, b"\n" * len(_BLANKS))
_DIGITS = b"0123456789"
_MARKS = b".+-eE"


def parse_rows(text: bytes, dtype: type) -> tuple[np.ndarray, int]:
    """The numbers of lines that hold as many each, between single blanks, and that many; 0 for any other text.

    A text without its digits and marks is the blanks between the words. There is one word more than blanks on each line, or
    fewer, so if there are as many numbers as that in all, then also on each line.
    """
    left = text.translate(None, _DIGITS)
    gaps = left.translate(None, _MARKS)
    width = gaps.find(b"\n") + 1
    lines = len(gaps) // max(width, 1)
    if not width or gaps != (b" " * (width - 1) + b"\n") * lines:
        return np.zeros(0, dtype), 0
    values = _parse(text, left, dtype, width * lines)
    return values, width if len(values) == width * lines else 0


def parse(text: bytes, dtype: type) -> np.ndarray:
    """The numbers of a text, or those up to the first thing that is none; in double precision, or int64."""
    if not np.issubdtype(dtype, np.floating):
        return parse_slowly(text, dtype)
    left = text.translate(None, _DIGITS)
    if left.translate(None, _MARKS + _BLANKS):
        return parse_slowly(text, dtype)
    solid = np.frombuffer(b" " + text, np.uint8) > 32
    return _parse(text, left, dtype, int(np.count_nonzero(solid[1:] & ~solid[:-1])))


def _parse(text: bytes, left: bytes, dtype: type, count: int) -> np.ndarray:
    """`parse` of a text of digits, marks and blanks; `left` is what it is without the digits."""
    if np.issubdtype(dtype, np.floating) and len(text) >= ENOUGH and _is_plain(text, left):
        head = b"%%%%MatrixMarket matrix array real general\n%d 1\n" % count
        try:
            values = scipy.io.mmread(io.BytesIO(head + text.translate(_LINES).strip(b"\n")))
            values = np.asarray(values, dtype).ravel()
            return _signed_zeros(text, values) if b"-" in left else values
        except (ValueError, OverflowError):
            pass
    return parse_slowly(text, dtype)


def _signed_zeros(text: bytes, values: np.ndarray) -> np.ndarray:
    """With the sign of zeros, which the reader loses because it adds what it reads to zeros."""
    zeros = np.flatnonzero(values == 0)
    if len(zeros):
        codes = np.frombuffer(b" " + text, np.uint8)
        solid = codes > 32
        first = codes[1:][np.flatnonzero(solid[1:] & ~solid[:-1])[zeros]]
        values[zeros[first == ord("-")]] = -0.0
    return values


def parse_slowly(text: bytes, dtype: type) -> np.ndarray:
    """The numbers of a text, up to the first thing that is none (`numpy.fromstring` rounds correctly)."""
    if not text.strip():
        return np.zeros(0, dtype)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        try:
            return np.fromstring(text, dtype, sep=" ")
        except ValueError:
            return np.zeros(0, dtype)


def _is_plain(text: bytes, left: bytes) -> bool:
    """Whether every word is a decimal number as a whole: the reader stops at the end of a number and skips what follows it."""
    marks = np.frombuffer(left, np.uint8)
    dots = marks == ord(".")
    if (dots[1:] & dots[:-1]).any():
        return False
    if not any(mark in left for mark in (b"-", b"+", b"e", b"E")):
        return True
    codes = np.frombuffer(b" " + text + b" ", np.uint8)
    for mark in b"eE":
        at = np.flatnonzero(codes == mark) if mark in left else np.zeros(0, np.int64)
        before, after = codes[at - 1], codes[at + 1]
        if not ((_is_digit(before) | (before == ord("."))) & (_is_digit(after) | _is_sign(after))).all():
            return False
    for sign in b"+-":
        at = np.flatnonzero(codes == sign) if sign in left else np.zeros(0, np.int64)
        before, after = codes[at - 1], codes[at + 1]
        if not (((before <= 32) | (before | 32 == ord("e"))) & (_is_digit(after) | (after == ord(".")))).all():
            return False
    # within a word nothing but a sign comes after an exponent's mark
    exponents = (marks | 32) == ord("e")
    follows = marks[1:][exponents[:-1]]
    beyond = marks[2:][(exponents[:-2] & _is_sign(marks[1:-1]))]
    return not (_is_mark(follows) & ~_is_sign(follows)).any() and not _is_mark(beyond).any()


def _is_mark(codes: np.ndarray) -> np.ndarray:
    return codes > 32


def _is_sign(codes: np.ndarray) -> np.ndarray:
    return (codes == ord("+")) | (codes == ord("-"))


def _is_digit(codes: np.ndarray) -> np.ndarray:
    return (codes >= ord("0")) & (codes <= ord("9"))


def lines(values: np.ndarray) -> bytes:
    """One number a line, the fewest digits that read back bit for bit."""
    if 16 * len(values) < ENOUGH:
        return repr(values.tolist())[1:-1].encode().replace(b", ", b"\n")
    file = io.BytesIO()
    scipy.io.mmwrite(file, values.reshape(-1, 1), symmetry="general")
    text = file.getvalue()
    head = b"\n%d 1\n" % len(values)
    return text[text.index(head) + len(head) : -1]
