"""Small files of the command line's own, written completely or not at all."""

import os
import pathlib


def save(path: pathlib.Path, content: bytes) -> None:
    """Under a temporary name until it is complete; `OSError` where it cannot be."""
    partial = path.with_name(f".{path.stem}.{os.getpid()}.partial{path.suffix}")
    try:
        partial.write_bytes(content)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
