"""A file of a cube of hexahedra, moved whole and by ranges: CPU and peak memory of `jaxmorph deform` as a process.

python benchmarks/ranges.py --side 100 --ranges 100000 [--kind su2 cgns zones structured]

`cgns` is one unstructured zone, `zones` two of them, `structured` one block of lattice nodes.
"""

import argparse
import pathlib
import sys
import tempfile

import h5py
import numpy as np
from _measure import about, table
from end_to_end import measured

import jaxmorph as jm
from jaxmorph import io
from jaxmorph.io._structured import block_cells

sys.path.insert(0, str(pathlib.Path(__file__).parents[1] / "tests"))
import cgns

SIDES = ("sides", "sides", "sides", "sides", "floor", "roof")
"""Boundary conditions of a block: i, j and k, each at its first and last node."""


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


def block(points: np.ndarray, file: h5py.Group, name: str, *, is_lattice: bool, left_out: tuple[int, ...] = ()) -> None:
    """Writes lattice nodes (i, j, k, 3) as a zone, with a condition for each side but those left out."""
    shape = points.shape[:3]
    ids = 1 + np.arange(np.prod(shape)).reshape(shape, order="F")
    axes = [points[..., axis] if is_lattice else points[..., axis].ravel(order="F") for axis in range(3)]
    cells = None if is_lattice else int(np.prod(np.array(shape) - 1))
    zone = cgns.zone(file, name, tuple(axes), cells)
    if not is_lattice:
        cgns.elements(zone, "cells", 17, block_cells(ids)[1], 1, cells)
    for number, side in enumerate(SIDES):
        if number not in left_out:
            low, high = [1, 1, 1], list(shape)
            (high if number % 2 == 0 else low)[number // 2] = 1 if number % 2 == 0 else shape[number // 2]
            nodes = ids.take(-(number % 2), axis=number // 2).ravel()
            places, what = ((low, high), "PointRange") if is_lattice else (nodes[None], "PointList")
            cgns.condition(zone, f"{side} {number}", places, side, "Vertex", what)


def write_cube(path: pathlib.Path, kind: str, side: int) -> None:
    """Writes the cube as an SU2 file, or a CGNS file of one zone, of two, or of a structured one."""
    if kind == "su2":
        return io.write(path, cube(side))
    x = np.linspace(0, 1, side)
    points = np.stack(np.meshgrid(x, x, x, indexing="ij"), axis=-1)
    with h5py.File(path, "w", track_order=True) as file:
        base = cgns.base(file, 3, 3)
        if kind == "zones":
            block(points[: side // 2 + 1], base, "left", is_lattice=False, left_out=(1,))
            block(points[side // 2 :], base, "right", is_lattice=False, left_out=(0,))
        else:
            block(points, base, "all", is_lattice=kind == "structured")


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--side", type=int, default=100, help="nodes each way")
    parser.add_argument("--ranges", type=int, default=100_000)
    parser.add_argument("--kind", nargs="*", default=["su2"], choices=("su2", "cgns", "zones", "structured"))
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
    rows = []
    for kind in options.kind:
        with tempfile.TemporaryDirectory() as name:
            folder, ending = pathlib.Path(name), "su2" if kind == "su2" else "cgns"
            write_cube(folder / f"cube.{ending}", kind, options.side)
            for what, more in (("whole", []), (f"--ranges {options.ranges}", ["--ranges", str(options.ranges)])):
                command = [
                    sys.executable,
                    "-m",
                    "jaxmorph",
                    "deform",
                    f"cube.{ending}",
                    f"{what.split()[0].strip('-')}.{ending}",
                    *flags,
                    *more,
                ]
                rows.append([kind, what, *measured(command, folder, JAX_ENABLE_COMPILATION_CACHE="0")])
            whole, parts = (io.read(folder / f"{what}.{ending}").points for what in ("whole", "ranges"))
            rows[-1].append(f"{np.abs(whole - parts).max():.0e}")
    table([[*row, *[""] * (6 - len(row))] for row in rows], ("file", "", "CPU s", "wall s", "peak, GB", "difference"))


if __name__ == "__main__":
    main()
