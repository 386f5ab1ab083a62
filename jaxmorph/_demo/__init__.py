"""The paper's airfoil from one command."""

import pathlib


def run(output: pathlib.Path, *, points: int | None = None) -> int:
    """Shows the case: tables on the terminal, pictures and meshes in the folder `output`.

    `points` asks for a smaller or larger mesh than the paper's. Returns 0, or 1 when a method has
    inverted a cell. It needs float64: switch JAX's x64 mode on first.

    Raises `ImportError` where an extra (`plot`, `io`) is missing.
    """
    from . import _airfoil

    return _airfoil.run(pathlib.Path(output), points=points)
