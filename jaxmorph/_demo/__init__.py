"""The paper's airfoil from one command; `check` is apart, for it needs no matplotlib."""

import pathlib


def check(case: str) -> None:
    """Raises `ValueError` for a case that is not known."""
    if case != "naca0015":
        raise ValueError(
            f"no demo is called {case!r}; there are: naca0015. The wing is benchmarks/wing.py of a checkout."
        )


def run(case: str, output: pathlib.Path, *, points: int | None = None) -> int:
    """Shows a case: tables on the terminal, pictures and meshes in the folder `output`.

    `points` asks for a smaller or larger mesh than the paper's. Returns 0, or 1 when a method has
    inverted a cell. It needs float64: switch JAX's x64 mode on first.

    Raises `ValueError` for a case that is not known, `ImportError` where an extra (`plot`, `io`) is
    missing.
    """
    check(case)
    from . import _airfoil

    return _airfoil.run(pathlib.Path(output), points=points)
