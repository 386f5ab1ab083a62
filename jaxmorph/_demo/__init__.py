"""The paper's airfoil from one command."""

import pathlib


def run(output: pathlib.Path, *, points: int | None = None) -> int:
    """Shows the case: tables on the terminal, pictures and meshes in the folder `output`.

    `points` asks for another mesh size than the paper's. Returns 0, or 1 for an inverted cell.
    Needs float64: switch JAX's x64 mode on first. Raises `ImportError` for a missing extra (`plot`,
    `io`).
    """
    from . import _airfoil

    return _airfoil.run(pathlib.Path(output), points=points)
