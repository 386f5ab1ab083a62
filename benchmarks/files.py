"""Reading and writing of a large mesh: seconds and memory for a box of hexahedra, moved, in several formats; and pandas.

python benchmarks/files.py [--side 100]
"""

import argparse
import io as text_io
import pathlib
import subprocess
import sys
import tempfile
import time

import numpy as np

import jaxmorph as jm
from jaxmorph import io

HEADER = "FoamFile\n{{\n    version 2.0;\n    format ascii;\n    class {};\n    object {};\n}}\n"


def box(side: int) -> jm.Mesh:
    axis = np.linspace(0, 1, side)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    ids = np.arange(side**3).reshape(side, side, side)
    low, high = slice(-1), slice(1, None)
    square = [(low, low), (high, low), (high, high), (low, high)]
    corners = np.stack([ids[(*ij, k)].ravel() for k in (low, high) for ij in square], axis=1)
    outer = (points == 0).any(axis=1) | (points == 1).any(axis=1)
    return jm.Mesh(points, {"hexahedron": corners}, {"outside": np.flatnonzero(outer)})


def write_foam(case: pathlib.Path, side: int, points: np.ndarray) -> None:
    """The faces across each axis, inner ones first."""
    ids, cells = np.arange(side**3).reshape(side, side, side), np.arange((side - 1) ** 3).reshape((side - 1,) * 3)
    inner, outer = [], []
    for axis in range(3):
        nodes, behind = np.moveaxis(ids, (axis, (axis + 1) % 3, (axis + 2) % 3), (0, 1, 2)), np.moveaxis(
            cells, (axis, (axis + 1) % 3, (axis + 2) % 3), (0, 1, 2))  # fmt: skip
        faces = np.stack([nodes[:, :-1, :-1], nodes[:, 1:, :-1], nodes[:, 1:, 1:], nodes[:, :-1, 1:]], axis=-1)
        inner.append((faces[1:-1].reshape(-1, 4), behind[:-1].ravel(), behind[1:].ravel()))
        outer.append((faces[-1].reshape(-1, 4), behind[-1].ravel()))
        outer.append((faces[0].reshape(-1, 4)[:, ::-1], behind[0].ravel()))
    faces = np.concatenate([part[0] for part in (*inner, *outer)])
    owner = np.concatenate([part[1] for part in (*inner, *outer)])
    neighbour = np.concatenate([part[2] for part in inner])
    folder = case / "constant" / "polyMesh"
    folder.mkdir(parents=True)
    for name, kind, row, values in (
        ("points", "vectorField", "(%r %r %r)\n", points),
        ("faces", "faceList", "4(%d %d %d %d)\n", faces),
        ("owner", "labelList", "%d\n", owner),
        ("neighbour", "labelList", "%d\n", neighbour),
    ):
        body = (row * len(values)) % tuple(values.ravel().tolist())
        (folder / name).write_text(HEADER.format(kind, name) + f"{len(values)}\n(\n{body})\n")
    start = len(neighbour)
    entry = f"1\n(\n outside {{ type patch; nFaces {len(faces) - start}; startFace {start}; }}\n)\n"
    (folder / "boundary").write_text(HEADER.format("polyBoundaryMesh", "boundary") + entry)


def write_plot3d(path: pathlib.Path, side: int, points: np.ndarray) -> None:
    coordinates = points.reshape(side, side, side, 3).transpose(3, 2, 1, 0).ravel()
    path.write_text(f"1\n{side} {side} {side}\n" + "%r\n" * len(coordinates) % tuple(coordinates.tolist()))


def peak_memory() -> float:
    """Of this process so far, in MB (Linux)."""
    status = pathlib.Path("/proc/self/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) / 1e3


def measure(source: str, target: str) -> None:
    """In a process of its own: one line with read, write, and the peak of memory over that of the imports."""
    before = peak_memory()
    start = time.perf_counter()
    mesh = io.read(source)
    read = time.perf_counter() - start
    points = mesh.points + 1e-4 * np.random.default_rng(0).random(mesh.points.shape)
    start = time.perf_counter()
    io.write(target, mesh.moved(points))
    written = time.perf_counter() - start
    peak = peak_memory() - before
    np.testing.assert_array_equal(io.read(target).points, points)
    print(
        f"{pathlib.Path(source).name:<10} read {read:6.1f} s   write {written:6.1f} s   memory {peak:6.0f} MB",
        flush=True,
    )


def pandas_rows(points: np.ndarray) -> None:
    try:
        import pandas
    except ImportError:
        print("pandas is not installed: its figures are left out")
        return
    start = time.perf_counter()
    text = pandas.DataFrame(points).to_csv(None, sep=" ", header=False, index=False)
    written = time.perf_counter() - start
    start = time.perf_counter()
    pandas.read_csv(text_io.StringIO(text), sep=" ", header=None)
    print(f"pandas     read {time.perf_counter() - start:6.1f} s   write {written:6.1f} s   (coordinates alone)")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--side", type=int, default=100, help="nodes along a side of the box")
    parser.add_argument("--measure", nargs=2, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.measure:
        measure(*chosen.measure)
        return
    with tempfile.TemporaryDirectory() as folder:
        here, mesh = pathlib.Path(folder), box(chosen.side)
        print(f"{len(mesh.points)} points, {len(mesh.cells['hexahedron'])} hexahedra", flush=True)
        write_foam(here / "foam", chosen.side, mesh.points)
        write_plot3d(here / "box.xyz", chosen.side, mesh.points)
        io.write(here / "box.su2", mesh)
        io.write(here / "box.msh", mesh)
        for source, target in (("box.su2", "b.su2"), ("foam", "b"), ("box.xyz", "b.xyz"), ("box.msh", "b.msh")):
            command = [sys.executable, __file__, "--measure", str(here / source), str(here / target)]
            subprocess.run(command, check=True)
        pandas_rows(mesh.points)


if __name__ == "__main__":
    main()
