"""Reading and writing of a large mesh: CPU time and memory for a box of hexahedra, moved, beside pandas and polars.

python benchmarks/files.py [--side 216] [--formats su2 foam]

pandas and polars read the same numbers from plain tables, polars with one thread. Each runs in a process of its own.
"""

import argparse
import os
import pathlib
import subprocess
import sys
import tempfile
import time

import numpy as np
from _measure import about, table

import jaxmorph as jm
from jaxmorph import io

HEADER = "FoamFile\n{{\n    version 2.0;\n    format ascii;\n    class {};\n    object {};\n}}\n"
ROWS = 1 << 18
SOURCES = {
    "su2": ("box.su2", "b.su2"),
    "foam": ("foam", "b"),
    "plot3d": ("box.xyz", "b.xyz"),
    "gmsh": ("box.msh", "b.msh"),
}


def box(side: int) -> jm.Mesh:
    axis = np.linspace(0, 1, side)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    ids = np.arange(side**3, dtype=np.int32).reshape(side, side, side)
    low, high = slice(-1), slice(1, None)
    square = [(low, low), (high, low), (high, high), (low, high)]
    corners = np.stack([ids[(*ij, k)].ravel() for k in (low, high) for ij in square], axis=1)
    outer = (points == 0).any(axis=1) | (points == 1).any(axis=1)
    return jm.Mesh(points, {"hexahedron": corners}, {"outside": np.flatnonzero(outer)})


def foam_faces(side: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Faces of the box, inner ones first and in OpenFOAM's upper triangular order; their owners and neighbours."""
    ids, cells = (np.arange(k**3, dtype=np.int32).reshape(k, k, k) for k in (side, side - 1))
    inner, outer = [], []
    for axis in range(3):
        order = (axis, (axis + 1) % 3, (axis + 2) % 3)
        nodes, behind = np.moveaxis(ids, order, (0, 1, 2)), np.moveaxis(cells, order, (0, 1, 2))
        faces = np.stack(
            [nodes[:, :-1, :-1], nodes[:, 1:, :-1], nodes[:, 1:, 1:], nodes[:, :-1, 1:]], axis=-1
        )
        inner.append((faces[1:-1].reshape(-1, 4), behind[:-1].ravel(), behind[1:].ravel()))
        outer.append((faces[-1].reshape(-1, 4), behind[-1].ravel()))
        outer.append((faces[0].reshape(-1, 4)[:, ::-1], behind[0].ravel()))
    faces = np.concatenate([part[0] for part in (*inner, *outer)])
    owner = np.concatenate([part[1] for part in (*inner, *outer)])
    neighbour = np.concatenate([part[2] for part in inner])
    rows = np.lexsort((neighbour, owner[: len(neighbour)]))
    faces[: len(rows)], owner[: len(rows)] = faces[rows], owner[rows]
    return faces, owner, neighbour[rows]


def write_foam(case: pathlib.Path, side: int, points: np.ndarray) -> None:
    faces, owner, neighbour = foam_faces(side)
    folder = case / "constant" / "polyMesh"
    folder.mkdir(parents=True)
    for name, kind, row, values in (
        ("points", "vectorField", "(%r %r %r)\n", points),
        ("faces", "faceList", "4(%d %d %d %d)\n", faces),
        ("owner", "labelList", "%d\n", owner),
        ("neighbour", "labelList", "%d\n", neighbour),
    ):
        with (folder / name).open("w") as file:
            file.write(HEADER.format(kind, name) + f"{len(values)}\n(\n")
            for at in range(0, len(values), ROWS):
                part = values[at : at + ROWS]
                file.write((row * len(part)) % tuple(part.ravel().tolist()))
            file.write(")\n")
    start = len(neighbour)
    entry = f"1\n(\n outside {{ type patch; nFaces {len(faces) - start}; startFace {start}; }}\n)\n"
    (folder / "boundary").write_text(HEADER.format("polyBoundaryMesh", "boundary") + entry)


def write_plot3d(path: pathlib.Path, side: int, points: np.ndarray) -> None:
    coordinates = points.reshape(side, side, side, 3).transpose(3, 2, 1, 0).ravel()
    path.write_text(
        f"1\n{side} {side} {side}\n" + "%r\n" * len(coordinates) % tuple(coordinates.tolist())
    )


def write_tables(folder: pathlib.Path, side: int, mesh: jm.Mesh) -> None:
    """The numbers of the files as plain tables, for the peers."""
    import polars

    hexahedra = mesh.cells["hexahedron"]
    tables = {
        "points": mesh.points,
        "elements": np.column_stack([np.full(len(hexahedra), 12, np.int32), hexahedra]),
    }
    faces, owner, neighbour = foam_faces(side)
    tables["faces"] = np.column_stack([np.full(len(faces), 4, np.int32), faces])
    tables["sides"] = np.concatenate([owner, neighbour])[:, None]
    for name, values in tables.items():
        polars.DataFrame(values).write_csv(
            folder / f"{name}.csv", separator=" ", include_header=False
        )


PEER_TABLES = {"su2": ("points", "elements"), "foam": ("points", "faces", "sides")}


def peer(library: str, folder: str, kind: str) -> None:
    """In a process of its own: CPU seconds of reading the tables of a format."""
    total = 0.0
    for name in PEER_TABLES[kind]:
        path = pathlib.Path(folder) / f"{name}.csv"
        if library == "pandas":
            import pandas

            began = time.process_time()
            frame = pandas.read_csv(path, sep=" ", header=None)
        else:
            import polars

            began = time.process_time()
            frame = polars.read_csv(path, separator=" ", has_header=False)
        total += time.process_time() - began
        assert len(frame)
        del frame
    print(total)


def peak_memory() -> float:
    """Of this process so far, in MB (Linux)."""
    status = pathlib.Path("/proc/self/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) / 1e3


def measure(source: str, target: str) -> None:
    """In a process of its own: CPU and wall seconds of read and write, the peak of memory over that of the imports, and
    the size of points and cells, in MB."""
    before = peak_memory()
    cpu, wall = time.process_time(), time.perf_counter()
    mesh = io.read(source)
    print(time.process_time() - cpu, time.perf_counter() - wall)
    size = (mesh.points.nbytes + sum(corners.nbytes for corners in mesh.cells.values())) / 1e6
    while_reading = peak_memory() - before
    points = np.random.default_rng(0).random(mesh.points.shape)
    points *= 1e-4
    points += mesh.points
    cpu, wall = time.process_time(), time.perf_counter()
    io.write(target, mesh.moved(points))
    print(time.process_time() - cpu, time.perf_counter() - wall)
    print(while_reading, peak_memory() - before, size)
    del mesh
    np.testing.assert_array_equal(io.read(target).points, points)


def alone(*arguments: str) -> list[list[float]]:
    command = [sys.executable, __file__, *arguments]
    environment = os.environ | {"POLARS_MAX_THREADS": "1"}
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, env=environment)
    return [list(map(float, line.split())) for line in done.stdout.splitlines()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--side", type=int, default=100, help="nodes along a side of the box")
    parser.add_argument("--formats", nargs="+", default=list(SOURCES), choices=list(SOURCES))
    parser.add_argument("--measure", nargs=2, help=argparse.SUPPRESS)
    parser.add_argument("--peer", nargs=3, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.measure:
        return measure(*chosen.measure)
    if chosen.peer:
        return peer(*chosen.peer)
    with tempfile.TemporaryDirectory() as folder:
        compare(pathlib.Path(folder), chosen.side, chosen.formats)


def compare(here: pathlib.Path, side: int, formats: list[str]) -> None:
    mesh = box(side)
    about(points=len(mesh.points), hexahedra=len(mesh.cells["hexahedron"]))
    make = {
        "su2": lambda: io.write(here / "box.su2", mesh),
        "foam": lambda: write_foam(here / "foam", side, mesh.points),
        "plot3d": lambda: write_plot3d(here / "box.xyz", side, mesh.points),
        "gmsh": lambda: io.write(here / "box.msh", mesh),
    }
    for kind in formats:
        make[kind]()
    if set(formats) & set(PEER_TABLES):
        write_tables(here, side, mesh)
    del mesh
    rows = []
    for kind in formats:
        source, target = (str(here / name) for name in SOURCES[kind])
        (read, read_wall), (write, write_wall), (peak_read, peak, size) = alone(
            "--measure", source, target
        )
        row = [kind, f"{read:.1f} ({read_wall:.1f})", f"{write:.1f} ({write_wall:.1f})"]
        for library in ("pandas", "polars"):
            seconds = (
                alone("--peer", library, str(here), kind)[0][0] if kind in PEER_TABLES else np.nan
            )
            row.append(
                f"{seconds:.1f}: {seconds / read:.2f}, {seconds / write:.2f}"
                if seconds == seconds
                else ""
            )
        rows.append(
            [
                *row,
                f"{peak_read:.0f}, {peak:.0f}",
                f"{size:.0f}: {peak_read / size:.1f}, {peak / size:.1f}",
            ]
        )
    heads = (
        "format",
        "read, CPU s (wall)",
        "write, CPU s (wall)",
        "pandas, CPU s: of its speed, read, write",
    )
    heads += ("polars", "peak while reading, all, MB", "points and cells, MB: times these")
    table(rows, heads)


if __name__ == "__main__":
    main()
