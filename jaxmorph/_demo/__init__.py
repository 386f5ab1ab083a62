"""The paper's test cases, from one command: tables, pictures and deformed meshes."""

import importlib
import pathlib

CASES = {"naca0015": "_airfoil", "agard445": "_wing"}
"""Name of a case, and the module whose `run` shows it."""


def check(case: str) -> None:
    """Raises `ValueError` for a case that is not known."""
    if case not in CASES:
        raise ValueError(f"no demo is called {case!r}; there are: {', '.join(CASES)}.")


def run(case: str, output: pathlib.Path, *, points: int | None = None) -> int:
    """Shows a case: tables on the terminal, pictures and meshes in the folder `output`.

    `points` asks for a smaller or larger mesh than the paper's. Returns 0, or 1 when a method has
    inverted a cell. It needs float64: switch JAX's x64 mode on first.

    Raises `ValueError` for a case that is not known, `ImportError` where an extra (`plot`, `io`) is
    missing.
    """
    check(case)
    module = importlib.import_module(f"{__name__}.{CASES[case]}")
    return module.run(pathlib.Path(output), points=points)
