"""Floating point numbers in text, many at once: rounded correctly, with the fewest digits."""

import io
import warnings

import numpy as np

ENOUGH = 1 << 14
"""Bytes from which SciPy's writer of Matrix Market files pays: `repr`'s digits, much faster."""

_FORTRAN = bytes.maketrans(b"Dd", b"ee")
_MARKS = b"0123456789.+-eE"


def decoded(raw: bytes) -> str:
    """Decodes a name in a file: UTF-8, or else Latin-1, which older programs write."""
    try:
        return raw.decode()
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def parse_rows(text: bytes, dtype: type) -> tuple[np.ndarray, int]:
    """Reads that many numbers of lines of equal length, between single blanks; 0 for other texts.

    A text without its digits and marks is the blanks between the words. There is one word more than
    blanks on each line, or fewer, so if there are as many numbers as that in all, then also on each
    line.
    """
    gaps = text.translate(None, _MARKS)
    width = gaps.find(b"\n") + 1
    lines = len(gaps) // max(width, 1)
    if not width or gaps != (b" " * (width - 1) + b"\n") * lines:
        return np.zeros(0, dtype), 0
    values = parse(text, dtype)
    return values, width if len(values) == width * lines else 0


def parse(text: bytes, dtype: type) -> np.ndarray:
    """Reads a text's numbers up to the first non-number (`numpy.fromstring` rounds correctly).

    Numbers of type float may have Fortran's exponents, 1.5D-3.
    """
    if not text.strip():
        return np.zeros(0, dtype)
    if np.issubdtype(dtype, np.floating) and (b"D" in text or b"d" in text):
        text = text.translate(_FORTRAN)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        try:
            return np.fromstring(text, dtype, sep=" ")
        except ValueError:
            return np.zeros(0, dtype)


def lines(values: np.ndarray) -> bytes:
    """Writes one number a line, with the fewest digits that read back as the double it is."""
    values = values.astype(float, copy=False)
    if 16 * len(values) < ENOUGH:
        return repr(values.tolist())[1:-1].encode().replace(b", ", b"\n")
    import scipy.io  # 40 modules, which a reader does not need

    file = io.BytesIO()
    scipy.io.mmwrite(file, values.reshape(-1, 1), symmetry="general")
    text = file.getvalue()
    head = b"\n%d 1\n" % len(values)
    return text[text.index(head) + len(head) : -1]
