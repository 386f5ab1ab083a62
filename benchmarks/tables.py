"""The tables of figures in the pages: puts today's into the pages, or fails where one has moved.

    python -m benchmarks.tables [NAME ...] [--check]

In a page such a table stands below a line `<!-- table NAME -->`, with the name of an entry of `TABLES`. Nothing in it is a time.
`--check` writes nothing, and names each figure that differs from the page's by more than two units of its last digit and by more
than 2 %, and each count that was 0 or is 0 now.
"""

import argparse
import importlib
import pathlib
import re
import sys
import warnings

import jax

PAGES = pathlib.Path(__file__).parents[1] / "docs" / "pages"
TABLES = {
    "gaps": "gaps.rows",
    "boundaries": "boundaries.rows",
    "limits": "limits.rows",
    "awkward": "awkward.rows",
    "wall": "walls.at_the_wall",
    "wall by cells": "walls.by_cells",
}
"""A function of a script that makes the rows of each table, heads first."""
TOLERANCE = 0.02
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


def marked(name: str) -> re.Pattern[str]:
    """Makes the pattern of a table in a page: the line with its name, then its lines."""
    return re.compile(rf"(?<=<!-- table {re.escape(name)} -->\n\n)(?:\|.*\n)+")


def has_moved(before: str, after: str) -> bool:
    """Compares two cells of a table."""
    if NUMBER.sub("#", before) != NUMBER.sub("#", after):
        return True
    for old, new in zip(NUMBER.findall(before), NUMBER.findall(after), strict=True):
        decimals = len(old.partition(".")[2])
        allowed = max(2 * 10.0**-decimals, TOLERANCE * abs(float(old)))
        is_none = not decimals and (float(old) == 0) != (float(new) == 0)
        if is_none or abs(float(new) - float(old)) > allowed * (1 + 1e-9):
            return True
    return False


def differences(before: str, after: str) -> list[str]:
    """Lists the rows of a table that have moved, old and new."""
    old, new = before.splitlines(), after.splitlines()
    if len(old) != len(new):
        return [f"{len(old)} lines in the page, {len(new)} now"]
    cells = [
        (one, other, one.split("|"), other.split("|")) for one, other in zip(old, new, strict=True)
    ]
    return [
        f"{one}\n  now {other}"
        for one, other, a, b in cells
        if len(a) != len(b) or any(map(has_moved, a, b))
    ]  # fmt: skip


def made(name: str) -> str:
    """Runs the script of a table."""
    module, _, function = TABLES[name].partition(".")
    heads, *rows = getattr(importlib.import_module(module), function)()
    lines = [heads, ["---"] * len(heads), *rows]
    text = "".join(f"| {' | '.join(line)} |\n" for line in lines)
    return text.replace("| --- ", "|---").replace("--- |", "---|").replace("|  |", "| |")


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("name", nargs="*", help=f"{', '.join(TABLES)}; all by default")
    parser.add_argument(
        "--check", action="store_true", help="fail where a figure of a page has moved"
    )
    asked = parser.parse_args()
    sys.path.insert(
        0, str(pathlib.Path(__file__).parent)
    )  # scripts import each other by their names
    jax.config.update("jax_enable_x64", True)
    warnings.simplefilter("ignore")
    moved = 0
    for name in asked.name or TABLES:
        table = made(name)
        (page,) = [page for page in PAGES.glob("*.md") if marked(name).search(page.read_text())]
        text = page.read_text()
        (present,) = marked(name).findall(text)
        found = differences(present, table)
        moved += len(found)
        print(f"{page.name}, {name}: {len(found)} rows have moved", *found, sep="\n", flush=True)
        if not asked.check:
            page.write_text(marked(name).sub(lambda _, table=table: table, text))
        jax.clear_caches()
    return int(asked.check and moved > 0)


if __name__ == "__main__":
    sys.exit(main())
