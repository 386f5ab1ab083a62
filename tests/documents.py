"""Code in documents, for the tests that run it."""

import pathlib
import re

ROOT = pathlib.Path(__file__).parent.parent


def blocks(document: str) -> list[str]:
    return [code for code, _ in blocks_and_output(document)]


def blocks_and_output(document: str) -> list[tuple[str, str | None]]:
    """Python code, and what stands in a block of text right after it: what it prints."""
    text = (ROOT / document).read_text()
    return [
        (found[1], found[2])
        for found in re.finditer(
            r"```python\n(.*?)```(?:\n\n```text\n(.*?)```)?", text, flags=re.DOTALL
        )
    ]
