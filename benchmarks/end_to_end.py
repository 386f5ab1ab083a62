"""From file to file, as processes: CPU and wall seconds and the peak of memory, beside OpenFOAM, SciPy and PyGeM.

python benchmarks/end_to_end.py [--cases su2 hexahedra foam] [--side 100]

- su2: the paper's airfoil, 39,666 points, turned by 5 degrees.
- hexahedra, foam: a box of side^3 points, as SU2 and as an OpenFOAM case; its bottom rises to a hill of a tenth of the side.

`jaxmorph deform` runs with an empty cache of compiled code, again, and on one core. Its stages are timed in one more process, by
the calls of Python. OpenFOAM's `moveDynamicMesh` solves displacementLaplacian (inverseDistance) on the case for the same motion.
SciPy's RBFInterpolator and PyGeM's RBF, where it is installed, take the same points from an array, and as many sources as jaxmorph
has by default; they read, judge and write no mesh.
"""

import argparse
import importlib
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import time
from typing import Any

import numpy as np
from _measure import about, table
from files import HEADER, box, write_foam

HEIGHT = 0.1

Case = tuple[str, str, list[str], Any, Any, Any]
"""Source, target, names of what moves and stays, points, and ids of what moves and stays."""

SOLVER = """dynamicFvMesh dynamicMotionSolverFvMesh;
motionSolverLibs (fvMotionSolvers);
motionSolver displacementLaplacian;
diffusivity inverseDistance (bottom);
"""
SYSTEM = {
    "controlDict": "application moveDynamicMesh; startFrom startTime; startTime 0; stopAt endTime; endTime 1; deltaT 1; "
    "writeControl timeStep; writeInterval 1; writeFormat ascii; writePrecision 16;",
    "fvSchemes": "ddtSchemes { default Euler; } gradSchemes { default Gauss linear; } divSchemes { default none; } "
    "laplacianSchemes { default Gauss linear corrected; } interpolationSchemes { default linear; } "
    "snGradSchemes { default corrected; }",
    "fvSolution": "solvers { cellDisplacement { solver GAMG; smoother GaussSeidel; tolerance 1e-8; relTol 0; } "
    "cellDisplacementFinal { solver GAMG; smoother GaussSeidel; tolerance 1e-8; relTol 0; } }",
}


def hill(points: np.ndarray) -> np.ndarray:
    """Displacements of the bottom's points."""
    u = np.zeros_like(points)
    u[:, 2] = HEIGHT * (np.sin(np.pi * points[:, 0]) * np.sin(np.pi * points[:, 1])) ** 2
    return u


def measured(
    command: list[str], folder: pathlib.Path, most: int | None = None, **environment: str
) -> list[str]:
    """Runs a command on at most so many cores: their number, CPU seconds, wall seconds and peak memory, as words of a table.

    A small process starts it: the peak of a process begins with that of the one which started it.
    """
    places = sorted(os.sched_getaffinity(0))[:most]
    starter = (
        "import os, sys, time\n"
        f"os.sched_setaffinity(0, {places})\n"
        "began = time.perf_counter()\n"
        "_, status, used = os.wait4(os.spawnvp(os.P_NOWAIT, sys.argv[1], sys.argv[1:]), 0)\n"
        "said = status, used.ru_utime + used.ru_stime, time.perf_counter() - began, used.ru_maxrss\n"
        "open('measured', 'w').write(' '.join(map(str, said)))\n"
    )
    with (folder / "log").open("w") as log:
        subprocess.run(
            [sys.executable, "-S", "-c", starter, *command],
            cwd=folder,
            env=os.environ | environment,
            stdout=log,
            stderr=log,
        )
    status, cpu, wall, peak = map(float, (folder / "measured").read_text().split())
    if status:
        last = (folder / "log").read_text().strip().splitlines()[-1:]
        return [str(len(places)), "-", "-", f"failed: {last[0] if last else status}"]
    return [str(len(places)), f"{cpu:.1f}", f"{wall:.1f}", f"{peak / 1e6:.2f}"]


def stages(source: str, target: str, moving: str, fixed: str, motion: str) -> None:
    """In a process of its own: CPU seconds of each stage, by the calls of Python."""
    began, spent = 0.0, {}  # of the process: imports count

    def done(name: str, result: object) -> object:
        nonlocal began
        jax.block_until_ready(jax.tree.leaves(result))
        spent[name], began = time.process_time() - began, time.process_time()
        return result

    import jax

    jax.config.update("jax_enable_x64", True)
    import jaxmorph as jm
    from jaxmorph import io

    done("import", jm.prepare)
    mesh = io.read(source)
    done("read", None)
    plan = jm.prepare(mesh, moving, fixed)
    done("prepare", plan)
    u = np.load(motion)
    done("deform", moved := jm.deform(plan, u))
    done("judge", jm.quality(mesh, moved).mean_skewness)
    io.write(target, mesh.moved(moved))
    done("write", None)
    print(" ".join(f"{name} {value:.2f}" for name, value in spent.items()), plan.sources.size)


def peer(name: str, folder: str, count: str) -> None:
    """In a process of its own: moves the points by another tool's interpolation."""
    points, nodes, u = (np.load(f"{folder}/{each}.npy") for each in ("points", "nodes", "values"))
    chosen = np.linspace(0, len(nodes) - 1, int(count)).astype(int)
    sources, values = points[nodes[chosen]], u[chosen]
    if name == "SciPy":
        from scipy.interpolate import RBFInterpolator

        moved = points + RBFInterpolator(sources, values, kernel="thin_plate_spline", degree=1)(
            points
        )
    else:
        moved = importlib.import_module("pygem").RBF(
            sources, sources + values, func="thin_plate_spline"
        )(points)
    np.save(f"{folder}/moved.npy", moved)


def laplacian(case: pathlib.Path, points: np.ndarray, side: int) -> None:
    """Adds to a case what `moveDynamicMesh` reads."""
    for name, text in SYSTEM.items():
        (case / "system").mkdir(exist_ok=True)
        (case / "system" / name).write_text(HEADER.format("dictionary", name) + text + "\n")
    (case / "constant" / "dynamicMeshDict").write_text(
        HEADER.format("dictionary", "dynamicMeshDict") + SOLVER
    )
    rows = np.lexsort(
        (points[:, 1], points[:, 0])
    )  # faces of the bottom are listed by x, then y, each from its first corner
    rows = rows[points[rows, 2] == 0]
    first = _as_faces_name_them(rows.reshape(side, side))
    vectors = "".join(f"({x:.17g} {y:.17g} {z:.17g})\n" for x, y, z in hill(points[first]))
    values = f"type fixedValue; value nonuniform List<vector> {len(first)}\n(\n{vectors});"
    field = (
        "dimensions [0 1 0 0 0 0 0]; internalField uniform (0 0 0);\nboundaryField { bottom { "
        + values
        + " } walls { type fixedValue; value uniform (0 0 0); } }\n"
    )
    (case / "0").mkdir()
    (case / "0" / "pointDisplacement").write_text(
        HEADER.format("pointVectorField", "pointDisplacement") + field
    )


def _as_faces_name_them(ids: np.ndarray) -> np.ndarray:
    """Orders the bottom's points (side, side) as OpenFOAM does: as the faces of the patch name them first."""
    faces = (
        np.stack([ids[:-1, :-1], ids[1:, :-1], ids[1:, 1:], ids[:-1, 1:]], axis=-1)
        .reshape(-1, 4)[:, ::-1]
        .ravel()
    )
    return faces[np.sort(np.unique(faces, return_index=True)[1])]


def box_case(folder: pathlib.Path, kind: str, side: int) -> Case:
    """Writes a box."""
    from jaxmorph import io

    mesh = box(side)
    bottom = np.flatnonzero(mesh.points[:, 2] == 0)
    others = np.setdiff1d(mesh.patches["outside"], bottom)
    if kind == "hexahedra":
        import jaxmorph as jm

        io.write(
            folder / "box.su2",
            jm.Mesh(mesh.points, mesh.cells, {"bottom": bottom, "walls": others}),
        )
        source, target = "box.su2", "moved.su2"
    else:
        case = folder / "case"
        write_foam(case, side, np.asarray(mesh.points))
        faces = (side - 1) ** 2
        start = 3 * faces * (side - 2)
        entry = "2\n(\n walls {{ type wall; nFaces {}; startFace {}; }}\n bottom {{ type wall; nFaces {}; startFace {}; }}\n)\n"
        text = entry.format(5 * faces, start, faces, start + 5 * faces)
        (case / "constant/polyMesh/boundary").write_text(
            HEADER.format("polyBoundaryMesh", "boundary") + text
        )
        laplacian(case, np.asarray(mesh.points), side)
        source, target = "case", "moved"
    return source, target, ["bottom", "walls"], mesh.points, bottom, others


def airfoil_case(folder: pathlib.Path) -> Case:
    from jaxmorph import cases, io

    mesh = cases.naca0015()
    io.write(folder / "airfoil.su2", mesh)
    return (
        "airfoil.su2",
        "moved.su2",
        ["airfoil", "farfield"],
        mesh.points,
        mesh.patch("airfoil"),
        mesh.patch("farfield"),
    )


def run(kind: str, side: int, folder: pathlib.Path) -> list[list[str]]:
    is_airfoil = kind == "su2"
    source, target, names, points, nodes, fixed = (
        airfoil_case(folder) if is_airfoil else box_case(folder, kind, side)
    )
    if is_airfoil:
        angle = np.deg2rad(5)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        u = (points[nodes] - [0.25, 0]) @ (turn - np.eye(2)).T
    else:
        u = hill(points[nodes])
    surface = np.concatenate([nodes, fixed])
    resting = np.concatenate([u, np.zeros((len(fixed), u.shape[1]))])
    for name, values in {"points": points, "nodes": surface, "values": resting, "u": u}.items():
        np.save(folder / name, values)
    np.savetxt(
        folder / "u.dat",
        np.column_stack([nodes, points[nodes] + u]),
        fmt=["%d"] + ["%.17g"] * u.shape[1],
    )
    here = [sys.executable, str(pathlib.Path(__file__).resolve())]
    command = [
        sys.executable,
        "-m",
        "jaxmorph",
        "deform",
        source,
        target,
        "--moving",
        names[0],
        "--fixed",
        names[1],
    ]
    command += ["--displacement", "u.dat"]
    what = f"{kind}, {len(points):,} points"
    rows = []
    cache = str(folder / "cache")
    for again, most in (("first run", None), ("second run", None), ("third run", 1)):
        _forget(folder / target)
        rows.append(
            [
                what,
                f"jaxmorph deform, {again}",
                *measured(command, folder, most, XDG_CACHE_HOME=cache),
            ]
        )
    _forget(folder / target)
    parts = measured([*here, "--stages", source, target, *names, "u.npy"], folder)
    *said, count = (folder / "log").read_text().split()
    rows.append([what, "Python: " + " ".join(said), *parts])
    if kind == "foam" and shutil.which("moveDynamicMesh"):
        share = (
            pathlib.Path(str(shutil.which("moveDynamicMesh"))).resolve().parent.parent
            / "share"
            / "openfoam"
        )
        environment = {"WM_PROJECT_DIR": os.environ.get("WM_PROJECT_DIR", str(share))}
        rows.append(
            [
                what,
                "moveDynamicMesh",
                *measured(["moveDynamicMesh"], folder / "case", None, **environment),
            ]
        )
    for name in ("SciPy", "PyGeM"):
        rows.append(
            [
                what,
                f"{name}, {count} sources",
                *measured([*here, "--peer", name, str(folder), count], folder),
            ]
        )
    return rows


def write_bytecode(folder: str) -> None:
    """Compiles all modules that the commands import, as installations do: their processes read it there."""
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    os.environ["PYTHONPYCACHEPREFIX"] = folder
    modules = (
        "scipy.interpolate",
        "jaxmorph.cli._deform",
        "jaxmorph.io._su2",
        "jaxmorph.io.openfoam.case",
    )
    subprocess.run([sys.executable, "-c", f"import {', '.join(modules)}"], check=True)


def _forget(path: pathlib.Path) -> None:
    shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--cases",
        nargs="+",
        default=["su2", "hexahedra", "foam"],
        choices=["su2", "hexahedra", "foam"],
    )
    parser.add_argument(
        "--side",
        type=int,
        default=100,
        help="points along a side of the box: 100 for a million, 216 for ten",
    )
    parser.add_argument("--stages", nargs=5, help=argparse.SUPPRESS)
    parser.add_argument("--peer", nargs=3, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.stages:
        stages(*given.stages)
    elif given.peer:
        peer(*given.peer)
    else:
        about(side=given.side)
        found: list[list[str]] = []
        with tempfile.TemporaryDirectory() as bytecode:
            write_bytecode(bytecode)
            for each in given.cases:
                with tempfile.TemporaryDirectory() as place:
                    found += run(each, given.side, pathlib.Path(place))
        table(found, ("case", "what", "cores", "CPU s", "wall s", "peak GB"))
