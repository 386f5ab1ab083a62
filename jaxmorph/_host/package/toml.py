"""TOML, read and written."""

import json
import re
import tomllib
from typing import Any


def read(name: str, content: bytes) -> dict[str, Any]:
    """Reads a table from content. Raises `ValueError` for what is no TOML, or nested too deep."""
    try:
        text = content.decode()
        return tomllib.loads(text.replace("\r\n", "\n"))
    except ValueError as error:  # also for letters that are not UTF-8, and for numbers of thousands of digits
        raise ValueError(f"{name}: not TOML ({error}).") from None
    except RecursionError:
        keys = re.split(r"(?m)^[ \t]*([\w-]+)[ \t]*=", content.decode())[1:]
        values = {key: value.count("[") + value.count("{") for key, value in zip(keys[::2], keys[1::2], strict=True)}
        deepest = max(values, key=values.__getitem__, default="the file")
        raise ValueError(f"{name}: {deepest} is nested too deep: thousands of brackets in each other.") from None


def written(value: Any) -> str:
    """Formats a value in TOML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(written, value))}]"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(key)} = {written(entry)}" for key, entry in value.items()) + " }"
    return json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007f")
