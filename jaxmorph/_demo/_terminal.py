"""Common parts of both demos: methods to compare, progress on a terminal, tables and meshes."""

import contextlib
import dataclasses
import pathlib
import sys
from collections.abc import Callable, Iterator, Sequence

import numpy as np

import jaxmorph as jm
from jaxmorph import io

Say = Callable[[str], None]


@dataclasses.dataclass(frozen=True)
class Study:
    """A method to compare, None for the default; `file` names its deformed mesh, if written."""

    name: str
    method: jm.AbstractMethod | None
    rebuild: bool = False
    file: str = ""
    title: str = ""


def write(path: pathlib.Path, mesh: jm.Mesh, points: np.ndarray, values: dict[str, np.ndarray]) -> list[pathlib.Path]:
    """Writes a mesh for SU2, and a mesh with displacements and `values` of cells to look at."""
    moved, picture = mesh.moved(points), path.with_suffix(".vtu")
    io.write(path, moved)
    io.write(picture, moved, point_data={"displacement": points - mesh.points}, cell_data=values)
    return [path, picture]


@contextlib.contextmanager
def progress(steps: int) -> Iterator[Say]:
    """Yields a function that announces the next of `steps` steps; silent without a terminal."""
    try:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
    except ImportError:
        yield _silent
        return
    console = Console(stderr=True)
    if not (console.is_terminal and sys.stdout.isatty()):
        yield _silent
        return
    columns = BarColumn(20), TimeElapsedColumn(), TextColumn("{task.description}")
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=steps)
        begun = False

        def say(what: str) -> None:
            nonlocal begun
            bar.update(task, description=what, advance=int(begun))
            begun = True

        yield say


def _silent(what: str) -> None:
    """Prints nothing, where the output is no terminal."""


def table(heads: Sequence[tuple[str, ...]], rows: Sequence[tuple[str, ...]]) -> str:
    """Formats rows with a rule under the heads."""
    everything = [*heads, *rows]
    widths = [max(map(len, column)) for column in zip(*everything, strict=True)]
    lines = []
    for row in everything:
        first, *others = (
            cell.ljust(w) if k == 0 else cell.rjust(w) for k, (cell, w) in enumerate(zip(row, widths, strict=True))
        )
        lines.append("  ".join([first, *others]).rstrip())
    lines.insert(len(heads), "-" * (sum(widths) + 2 * (len(widths) - 1)))
    return "\n".join(lines)
