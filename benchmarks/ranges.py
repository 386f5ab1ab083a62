"""An SU2 file of a cube of hexahedra, moved whole and by ranges: CPU and peak memory of `jaxmorph deform` as a process.

python benchmarks/ranges.py --side 100 --ranges 100000
"""

import argparse
import pathlib
import sys
import tempfile

import numpy as np
from _measure import about, table
from end_to_end import measured

import jaxmorph as jm
from jaxmorph import io


def cube(side: int) -> jm.Mesh:
    """A cube of `side` nodes each way, with patches `floor`, `roof` and `sides`."""
    ids = np.arange(side**3).reshape(side, side, side)
    x = np.linspace(0, 1, side)
    low, high = slice(0, -1), slice(1, None)
    ring = [(low, low), (high, low), (high, high), (low, high)]
    corners = np.stack([ids[(*columns, end)].ravel() for end in (low, high) for columns in ring], axis=1)
    sides = np.concatenate([each.ravel() for each in (ids[0], ids[-1], ids[:, 0], ids[:, -1])])
    points = np.stack(np.meshgrid(x, x, x, indexing="ij"), axis=-1).reshape(-1, 3)
    patches = {"floor": ids[:, :, 0].ravel(), "roof": ids[:, :, -1].ravel(), "sides": sides}
    return jm.Mesh(points, {"hexahedron": corners}, patches)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--side", type=int, default=100, help="nodes each way")
    parser.add_argument("--ranges", type=int, default=100_000)
    options = parser.parse_args()
    about(nodes=options.side**3, ranges=options.ranges)
    flags = [
        "--moving",
        "floor",
        "--fixed",
        "roof",
        "--free",
        "sides",
        "--translate",
        "0",
        "0",
        "0.001",
        "--no-dry-run",
    ]
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        io.write(folder / "cube.su2", cube(options.side))
        rows = []
        for what, more in (("whole", []), (f"--ranges {options.ranges}", ["--ranges", str(options.ranges)])):
            command = [sys.executable, "-m", "jaxmorph", "deform", "cube.su2", "moved.su2", *flags, *more]
            rows.append([what, *measured(command, folder, JAX_ENABLE_COMPILATION_CACHE="0")])
        table(rows, ("", "CPU s", "wall s", "peak, GB"))


if __name__ == "__main__":
    main()
