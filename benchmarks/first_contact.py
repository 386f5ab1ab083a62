"""First contacts, each in a process of its own on one core: CPU seconds and peak memory, with an empty cache of code and again.

python benchmarks/first_contact.py [--only info deform] [--check]

`--check` ends with 1 where a contact takes more than twice its goal.
"""

import argparse
import pathlib
import sys
import tempfile

import numpy as np
from _measure import about, table
from end_to_end import measured, write_bytecode
from files import HEADER, box, write_foam

CONFIG = """DV_KIND= HICKS_HENNE
DV_MARKER= ( airfoil )
DV_PARAM= ( 1, 0.5 )
DV_VALUE= 0.01
MESH_FILENAME= larger.su2
MESH_OUT_FILENAME= moved.su2
"""
MOVE = "--moving airfoil --fixed farfield --rotate 5"
GOALS = {
    "info": (0.8, 0.8),
    "deform": (1.8, 1.8),
    "su2 def": (2.5, 1.5),
    "paper's airfoil": (3.0, 2.5),
    "USMesh": (8.0, 4.0),
    "onto": (2.0, 2.0),
    "judge": (2.5, 2.0),
}
"""CPU seconds: first, again."""
COMMANDS = {
    "info": "info small.su2",
    "deform": f"deform small.su2 moved.su2 {MOVE}",
    "su2 def": "su2 def config.cfg",
    "paper's airfoil": f"deform paper.su2 moved.su2 {MOVE}",
}
CALLS = {
    "USMesh": """from mpi4py import MPI
from jaxmorph.integrations.idwarp import USMesh
USMesh({"gridFile": "case", "fileType": "OpenFOAM"}, comm=MPI.COMM_SELF).getSurfaceCoordinates()
""",
    "onto": """import jax
jax.config.update("jax_enable_x64", True)
import jaxmorph as jm
import onto
jm.shapes.onto(jm.Facets.of(onto.in_prisms(270), "wall"), onto.scan(1200))
""",
    "judge": """import numpy as np
import jax
jax.config.update("jax_enable_x64", True)
import jaxmorph as jm
mesh = jm.cases.naca0015()
plan = jm.prepare(mesh, "airfoil", "farfield")
jm.judge(mesh, jm.deform(plan, 0.01 * np.asarray(plan.moving_points)))
""",
}


def write_files(folder: pathlib.Path, side: int = 40) -> None:
    from jaxmorph import cases, io

    for name, count in (("small", 1601), ("larger", 3750), ("paper", 39666)):
        io.write(folder / f"{name}.su2", cases.naca0015(points=count))
    (folder / "config.cfg").write_text(CONFIG)
    write_foam(folder / "case", side, np.asarray(box(side).points))
    faces = (side - 1) ** 2
    first = 3 * faces * (side - 2)
    entry = " {} {{ type {}; nFaces {}; startFace {}; }}\n"
    patches = [("far", "patch", 5 * faces, first), ("floor", "wall", faces, first + 5 * faces)]
    text = "2\n(\n" + "".join(entry.format(*patch) for patch in patches) + ")\n"
    path = folder / "case/constant/polyMesh/boundary"
    path.write_text(HEADER.format("polyBoundaryMesh", "boundary") + text)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="+", default=[*COMMANDS, *CALLS])
    parser.add_argument("--check", action="store_true")
    given = parser.parse_args()
    chosen = given.only
    about(cases=len(chosen))
    heads = ("what", "CPU s, first", "again", "goals", "GB, first", "again")
    rows = []
    late = []
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        write_files(folder)
        write_bytecode(str(folder / "bytecode"))
        for what in chosen:
            command = [sys.executable, "-m", "jaxmorph", *COMMANDS.get(what, "").split()]
            if what in CALLS:
                command = [sys.executable, "-c", CALLS[what]]
            settings = {
                "JAX_COMPILATION_CACHE_DIR": str(folder / what),
                "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",  # as the commands have it
                "PYTHONPATH": str(pathlib.Path(__file__).parent),
            }
            first, again = (measured(command, folder, 1, **settings) for _ in range(2))
            goals = GOALS[what]
            rows.append([what, first[1], again[1], "{}, {}".format(*goals), first[3], again[3]])
            late += [
                what
                for run, goal in zip((first, again), goals, strict=True)
                if not is_within(run[1], goal)
            ]
    table(rows, heads)
    if given.check and late:
        sys.exit(f"more than twice the goal: {', '.join(dict.fromkeys(late))}")


def is_within(seconds: str, goal: float) -> bool:
    return seconds != "-" and float(seconds) <= 2 * goal


if __name__ == "__main__":
    main()
