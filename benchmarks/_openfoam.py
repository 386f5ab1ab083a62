"""OpenFOAM's mesh motion for championship.py: each case written as one of OpenFOAM's, moved by `moveDynamicMesh`, and read back.

Meshes in 2-D become one layer of cells between two `empty` patches. Times hold reading and writing of files.
"""

import pathlib
import re
import resource
import shutil
import subprocess
import sys
import tempfile

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).parents[1] / "tests"))

import foam
from _arena import Case

from jaxmorph._host.cells.topology import FACES

METHODS = {
    "OpenFOAM Laplacian 1/d^2": ("displacementLaplacian", "quadratic inverseDistance (moving)", 1),
    "OpenFOAM Laplacian 1/V": ("displacementLaplacian", "inverseVolume", 1),
    "OpenFOAM SBRStress 1/d^2": ("displacementSBRStress", "quadratic inverseDistance (moving)", 10),
}
"""Solver, diffusivity, and number of steps: the explicit part of the stress lags behind by one, and fails in a single step."""

SCHEMES = {
    "ddtSchemes": "Euler",
    "gradSchemes": "Gauss linear",
    "divSchemes": "Gauss linear",
    "laplacianSchemes": "Gauss linear corrected",
    "interpolationSchemes": "linear",
    "snGradSchemes": "corrected",
}


def is_there() -> bool:
    return shutil.which("moveDynamicMesh") is not None


def _head(kind: str, name: str) -> str:
    return f"FoamFile {{ version 2.0; format ascii; class {kind}; object {name}; }}\n"


def _solid(case: Case) -> tuple[np.ndarray, list[list[list[int]]]]:
    """Returns points in 3-D, and each cell as its faces seen from outside."""
    points, n = np.asarray(case.mesh.points), len(case.mesh.points)
    if case.mesh.polyhedra is not None:
        return points, _whole(case.mesh.polyhedra.faces)
    cells: list[list[list[int]]] = []
    for kind, corners in case.mesh.cells.items():
        for ids in np.asarray(corners).tolist():
            if points.shape[1] == 3:
                cells.append([[ids[i] for i in face] for face in FACES[kind]])
            else:
                sides = [[a, b, b + n, a + n] for a, b in zip(ids, [*ids[1:], ids[0]], strict=True)]
                cells.append([ids[::-1], [i + n for i in ids], *sides])
    if points.shape[1] == 2:
        points = np.concatenate([np.column_stack([points, np.full(n, z)]) for z in (0.0, 0.1)])
    return points, cells


def _whole(faces) -> list[list[list[int]]]:
    """Returns polyhedra as their faces, each seen from outside."""
    cells: list[list[list[int]]] = [
        [] for _ in range(int(max(faces.owner.max(), faces.neighbour.max())) + 1)
    ]
    sides = np.stack(
        [
            faces.owner,
            np.pad(
                faces.neighbour, (0, len(faces.owner) - len(faces.neighbour)), constant_values=-1
            ),
        ]
    )
    for corners, owner, neighbour in zip(
        np.split(faces.labels, faces.starts[1:-1]), *sides.tolist(), strict=True
    ):
        cells[owner].append(corners.tolist())
        if neighbour >= 0:
            cells[neighbour].append(corners[::-1].tolist())
    return cells


def prepare(folder: pathlib.Path, case: Case) -> list[int]:
    """Writes a case but for its motion. Returns the moving patch's points in OpenFOAM's order."""
    n, d = case.mesh.points.shape
    points, cells = _solid(case)
    moving = set(case.mesh.patch(case.moving).tolist())

    def is_moving(face):
        return all(i % n in moving for i in face)

    def is_flat(face):
        return d == 2 and len({i >= n for i in face}) == 1

    # a node of both patches moves: the last patch has the last word
    kinds = [
        ("empty", "empty", is_flat),
        ("still", "patch", lambda face: not is_moving(face)),
        ("moving", "wall", is_moving),
    ]
    foam.write_case(folder, points, cells, kinds if d == 2 else kinds[1:])
    outer = [sides[0][1] for sides in foam.polyhedral(cells)[3]]
    order = [i for face in outer if not is_flat(face) and is_moving(face) for i in face]
    schemes = "\n".join(f"{name} {{ default {scheme}; }}" for name, scheme in SCHEMES.items())
    solver = 'solvers { "cellDisplacement.*" { solver PCG; preconditioner DIC; tolerance 1e-10; relTol 0; } }'
    for name, text in (("fvSchemes", schemes), ("fvSolution", solver)):
        (folder / "system" / name).write_text(_head("dictionary", name) + text)
    return list(dict.fromkeys(order))


def move(
    folder: pathlib.Path, case: Case, order: list[int], u: np.ndarray, method: str
) -> tuple[np.ndarray, float]:
    """Runs one method for one motion. Returns moved points (n, d) and CPU seconds. Raises `ValueError` with what failed."""
    n, d = case.mesh.points.shape
    solver, diffusivity, count = METHODS[method]
    whole = np.zeros((n, 3))
    whole[case.mesh.patch(case.moving), :d] = u
    motion = f'dynamicFvMesh dynamicMotionSolverFvMesh; motionSolverLibs ("libfvMotionSolvers.so"); solver {solver};\n'
    text = f"{motion}{solver}Coeffs {{ diffusivity {diffusivity}; }}"
    (folder / "constant" / "dynamicMeshDict").write_text(
        _head("dictionary", "dynamicMeshDict") + text
    )
    patches = "still { type fixedValue; value uniform (0 0 0); }\n" + (
        "empty { type empty; }" if d == 2 else ""
    )
    field = "dimensions [0 1 0 0 0 0 0]; internalField uniform (0 0 0);\n"
    for old in folder.glob("[0-9]*"):
        shutil.rmtree(old)
    (folder / "0").mkdir()
    (folder / "0" / "pointDisplacement").write_text(
        _head("pointVectorField", "pointDisplacement")
        + f"{field}boundaryField {{ moving {{ }}\n{patches} }}"
    )
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    for step in range(count):
        _step(folder, step, whole[np.array(order) % n] * (step + 1) / count)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    rows = re.findall(
        r"^\(([^()]+)\)$", (folder / str(count) / "polyMesh" / "points").read_text(), re.MULTILINE
    )
    points = np.array([row.split() for row in rows], dtype=float)[:n, :d]
    return points, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _step(folder: pathlib.Path, step: int, displacement: np.ndarray) -> None:
    """Runs one step, with the moving patch's total displacement at its end."""
    file = folder / str(step) / "pointDisplacement"
    values = "\n".join("(" + " ".join(f"{x:.17g}" for x in row) + ")" for row in displacement)
    patch = f"moving {{ type fixedValue; value nonuniform List<vector> {len(displacement)} (\n{values}\n); }}"
    file.write_text(re.sub(r"moving\s*\{.*?\}", patch, file.read_text(), count=1, flags=re.DOTALL))
    (folder / "system" / "controlDict").write_text(
        _head("dictionary", "controlDict")
        + f"application moveDynamicMesh; startFrom startTime; startTime {step}; stopAt endTime; endTime {step + 1}; deltaT 1; "
        + "writeControl timeStep; writeInterval 1; writeFormat ascii; writePrecision 17; timeFormat general;"
    )
    done = subprocess.run(
        ["moveDynamicMesh"],
        cwd=folder,
        env=foam.ENVIRONMENT,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode or not (folder / str(step + 1) / "polyMesh" / "points").exists():
        raise ValueError(
            f"moveDynamicMesh ended with {done.returncode}: {(done.stderr or done.stdout)[-150:]}"
        )


def moved(case: Case, names: list[str]):
    """Yields (method, motion, u, points or the error, CPU seconds) for all motions of a case without symmetry planes."""
    if case.symmetry:
        return
    with tempfile.TemporaryDirectory() as place:
        folder = pathlib.Path(place, "case")
        order = prepare(folder, case)
        for name in names:
            for motion, make in case.motions.items():
                u = make(case.wall, 1.0)
                try:
                    yield name, motion, u, *move(folder, case, order, u, name)
                except ValueError as error:
                    yield name, motion, u, error, None
