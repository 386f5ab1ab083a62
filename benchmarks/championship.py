"""Every method on every case: quality after a motion, how far it goes, what it costs, and whether its derivative is right.

python -m benchmarks.championship [--points 2000] [--case C-grid ...] [--method default ...] [--json championship.json]
                                  [--entry NAME=FOLDER ...] [--write FOLDER] [--peers]
                                  [--join championship.json ...] [--picture championship.png] [--csv championship.csv]

`--peers` adds others to the same table: SciPy's `RBFInterpolator` with every node of the surface as a source, torchrbf's likewise
and mmgpy's `propagate_displacement` on triangles, quads and tetrahedra where they are installed, and OpenFOAM's
`displacementLaplacian` and `displacementSBRStress` where `moveDynamicMesh` is. They have no rows where nodes slide in
planes. `move` of OpenFOAM is the CPU time of the whole program, files included; that of SciPy and torchrbf includes the solve,
which they do anew for each motion.

`--join` takes over the rows of earlier runs, for cases and methods that do not run now. `--picture` draws all methods against
all motions. `--csv` writes all rows as a table with four digits.

`--write FOLDER` writes, for another tool, each case and motion as CASE/MOTION.npz: `points` (n, d), `moving` (m,) and `fixed` (f,)
node ids, `u` (m, d), and `cells_TYPE` (k, corners). `--entry NAME=FOLDER` reads that tool's CASE/MOTION.npz, each with `points`
(n, d), its moved points, and judges them in the same table, if the wall is where it belongs.

The JSON file is {"format": "jaxmorph championship", "version": 1, "points": ..., "rows": [...]}. A row has `case`, `motion`,
`method`, and numbers, each null where it was not measured: `inverted` cells; `max_skewness`, `mean_skewness` (by area);
`min_jacobian` over its undeformed value; `angle`, degrees by which the first grid line has left its angle to the wall, in the
mean; `min_height`, smallest first cell over its undeformed height; `behind`, largest motion of a node behind a part of the wall
that rests over the largest of the wall; `limit`, the multiple of the motion at which the first cell inverts, at most 4; CPU
seconds `setup`, `move` and `gradient`; `memory`, largest resident memory of the process so far, bytes; `derivative`, the relative
error of <w, J v> against a central difference. `error` says why a method refused.
"""

import argparse
import csv
import json
import pathlib
import resource
import sys
import time
import warnings
from importlib.util import find_spec
from typing import Any

sys.path.insert(0, str(pathlib.Path(__file__).parent))

import jax
import matplotlib.pyplot as plt
import numpy as np
from _arena import METHODS, Case, all_cases
from _measure import about
from scipy.interpolate import RBFInterpolator

import jaxmorph as jm
from jaxmorph._advice.inspect import overshoot

MOST = 4.0
CLOSE = 1.1
"""Largest skewness over the best one of a row up to which a method is as good as the best."""

NUMBERS = (
    *(
        "inverted",
        "max_skewness",
        "mean_skewness",
        "min_jacobian",
        "angle",
        "min_height",
        "behind",
        "limit",
    ),
    *("setup", "move", "gradient", "memory", "derivative"),
)


def quality(case: Case, points) -> dict[str, float]:
    report = jm.quality(case.mesh, points)
    wall = jm.wall_quality(case.mesh, case.moving, points)
    return {
        "inverted": int(report.inverted),
        "max_skewness": float(report.max_skewness),
        "mean_skewness": float(report.mean_skewness),
        "min_jacobian": float(np.min(report.jacobian_ratio)),
        "angle": float(wall.mean_angle),
        "min_height": float(wall.min_height),
    }


def limit(case: Case, plan: jm.Plan, motion) -> float:
    """Multiple of the motion that leaves no cell inverted, to 2 %."""

    def fine(amount: float) -> bool:
        return int(jm.quality(case.mesh, jm.deform(plan, motion(case.wall, amount))).inverted) == 0

    low, high = 0.0, MOST
    if fine(high):
        return high
    while high - low > 0.02 * high:
        middle = (low + high) / 2
        low, high = (middle, high) if fine(middle) else (low, middle)
    return low


def costs(plan: jm.Plan, u: np.ndarray) -> dict[str, float]:
    """CPU seconds of one motion and one gradient, compiled before, and the derivative's error."""
    rng = np.random.default_rng(0)
    w, v = rng.normal(size=plan.points.shape), rng.normal(size=u.shape) * np.abs(u).max()
    pulled = jm.pullback(plan, u, w)
    h = (
        1.0 if plan.method.linear else 1e-6
    )  # a small step would amplify the round-off of an ill-conditioned solve
    difference = (jm.deform(plan, u + h * v) - jm.deform(plan, u - h * v)) / (2 * h)
    expected = np.vdot(difference, w)
    error = abs(np.vdot(v, pulled) - expected) / (np.linalg.norm(difference) * np.linalg.norm(w))
    began = time.process_time()
    jax.block_until_ready(jm.deform(plan, u))
    middle = time.process_time()
    jax.block_until_ready(jm.pullback(plan, u, w))
    return {
        "move": middle - began,
        "gradient": time.process_time() - middle,
        "derivative": float(error),
    }


def rows_of(case: Case, name: str) -> list[dict]:
    """Runs one method on all motions of one case; where it refuses, the rows say why."""
    began = time.process_time()
    try:
        plan = case.plan(METHODS[name](case.extent))
    except ValueError as error:
        return [row(case, motion, name, {}, str(error)[:200]) for motion in case.motions]
    rows, setup = [], time.process_time() - began
    for motion, make in case.motions.items():
        u = make(case.wall, 1.0)
        numbers = (
            quality(case, jm.deform(plan, u))
            | costs(plan, u)
            | {"setup": setup, "limit": limit(case, plan, make)}
        )
        numbers["behind"] = overshoot(plan, u)[1]
        numbers["memory"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
        rows.append(row(case, motion, name, numbers))
    return rows


def row(
    case: Case, motion: str, method: str, numbers: dict[str, float], error: str | None = None
) -> dict:
    known = dict.fromkeys(NUMBERS) | {
        key: value if np.isfinite(value) else None for key, value in numbers.items()
    }
    return {"case": case.name, "motion": motion, "method": method, "error": error} | known


def place(folder: pathlib.Path, case: Case, motion: str) -> pathlib.Path:
    return folder / case.name.replace(" ", "_") / f"{motion.replace(' ', '_')}.npz"


def write(folder: pathlib.Path, case: Case) -> None:
    """Writes the motions of a case for another tool."""
    arrays: dict[str, Any] = {f"cells_{kind}": corners for kind, corners in case.mesh.cells.items()}
    arrays |= {"moving": case.mesh.patch(case.moving), "fixed": case.mesh.patch(*case.fixed)}
    for motion, make in case.motions.items():
        file = place(folder, case, motion)
        file.parent.mkdir(parents=True, exist_ok=True)
        np.savez(file, points=case.mesh.points, u=make(case.wall, 1.0), **arrays)


def missed(case: Case, points: np.ndarray, u: np.ndarray) -> str | None:
    """Says that the wall is not where it belongs, if it is not."""
    miss = np.abs(points[case.mesh.patch(case.moving)] - case.wall - u).max() / np.abs(u).max()
    return f"the wall misses its motion by {miss:.2g} of it" if not miss <= 1e-6 else None


def entered(name: str, folder: pathlib.Path, case: Case) -> list[dict]:
    """Judges another tool's moved points."""
    rows = []
    for motion, make in case.motions.items():
        file = place(folder, case, motion)
        if file.exists():
            with np.load(file) as data:
                points = data["points"]
            error = missed(case, points, make(case.wall, 1.0))
            rows.append(row(case, motion, name, {} if error else quality(case, points), error))
    return rows


def scipy_rbf(case: Case, nodes: np.ndarray, u: np.ndarray) -> np.ndarray:
    points = np.asarray(case.mesh.points)
    return RBFInterpolator(points[nodes], u, kernel="thin_plate_spline", degree=1)(points)


def torch_rbf(case: Case, nodes: np.ndarray, u: np.ndarray) -> np.ndarray:
    import torch  # pyright: ignore[reportMissingImports]
    from torchrbf import RBFInterpolator  # pyright: ignore[reportMissingImports]

    points = np.asarray(case.mesh.points)
    known, values, everywhere = (
        torch.tensor(each, dtype=torch.float64) for each in (points[nodes], u, points)
    )
    with torch.no_grad():
        return RBFInterpolator(known, values, kernel="thin_plate_spline", degree=1)(
            everywhere
        ).numpy()


def mmgpy_laplacian(case: Case, nodes: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Moves nodes to the mean of their neighbours' displacements; quads are cut into triangles."""
    from mmgpy.lagrangian import propagate_displacement  # pyright: ignore[reportMissingImports]

    cells, points = case.mesh.cells, np.asarray(case.mesh.points)
    kinds = [np.asarray(cells[kind]) for kind in ("triangle", "tetra") if kind in cells]
    if "quad" in cells:
        kinds.append(np.asarray(cells["quad"])[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3))
    (simplices,) = kinds
    known, whole = np.zeros(len(points), dtype=bool), np.zeros_like(points)
    known[nodes], whole[nodes] = True, u
    return propagate_displacement(points, simplices.astype(np.int32), known, whole)


def of_peers(case: Case) -> list[dict]:
    """Runs the peers that are installed on all motions of a case without symmetry planes."""
    if case.symmetry:
        return []
    rows, points = [], np.asarray(case.mesh.points)
    moving, fixed = case.mesh.patch(case.moving), case.mesh.patch(*case.fixed)
    nodes = np.concatenate([moving, fixed[~np.isin(fixed, moving)]])
    peers = {"SciPy RBF": scipy_rbf}
    if find_spec("torchrbf"):
        peers["torchrbf"] = torch_rbf
    if find_spec("mmgpy") and set(case.mesh.cells) in ({"triangle"}, {"quad"}, {"tetra"}):
        peers["mmgpy Laplacian"] = mmgpy_laplacian
    for motion, make in case.motions.items():
        u = np.zeros((len(nodes), points.shape[1]))
        u[: len(moving)] = make(case.wall, 1.0)
        for name, displacement in peers.items():
            began = time.process_time()
            moved = points + displacement(case, nodes, u)
            numbers = {"move": time.process_time() - began}
            moved[nodes] = points[nodes] + u  # as far as the solve is exact they are there
            rows.append(row(case, motion, name, quality(case, moved) | numbers))
    import _openfoam  # here: it takes what the tests write cases with

    if _openfoam.is_there():
        for name, motion, u, moved, seconds in _openfoam.moved(case, list(_openfoam.METHODS)):
            if isinstance(moved, Exception):
                rows.append(row(case, motion, name, {}, str(moved)))
                continue
            error = missed(case, moved, u)
            rows.append(
                row(
                    case,
                    motion,
                    name,
                    {} if error else quality(case, moved) | {"move": seconds},
                    error,
                )
            )
    return rows


def compared(
    rows: list[dict],
) -> list[tuple[str, int, int, float, float, float, float, float, float]]:
    """Compares methods over all rows by largest skewness, relative to the best of the row, which inverts no cell.

    For each method: its rows, without rows that it refuses; rows with inverted cells; the share within `CLOSE` of the best; its
    worst ratio to the best where it inverts none; medians of skewness, angle, limit and time.
    """
    best: dict[tuple, float] = {}
    for each in rows:
        if each["inverted"] == 0:
            key = each["case"], each["motion"]
            best[key] = min(best.get(key, np.inf), each["max_skewness"])
    summary = []
    for name in dict.fromkeys(each["method"] for each in rows):
        own = [each for each in rows if each["method"] == name and each["inverted"] is not None]
        over = [ratio_to_best(each, best) for each in own if (each["case"], each["motion"]) in best]
        medians = [
            float(np.median([each[key] for each in own if each[key] is not None] or [np.nan]))
            for key in ("max_skewness", "angle", "limit", "move")
        ]
        share = sum(value <= CLOSE for value in over) / max(1, len(over))
        worst = max((value for value in over if np.isfinite(value)), default=np.nan)
        summary.append(
            (name, len(own), sum(each["inverted"] > 0 for each in own), share, worst, *medians)
        )
    return sorted(summary, key=lambda line: (line[2], -line[3]))


def ratio_to_best(row: dict, best: dict[tuple, float]) -> float:
    """Divides a row's largest skewness by the best one of its motion; infinity where cells are inverted."""
    return (
        row["max_skewness"] / best[row["case"], row["motion"]] if row["inverted"] == 0 else np.inf
    )


def draw(rows: list[dict], file: pathlib.Path) -> None:
    """Draws methods against motions: the largest skewness over the smallest of the motion's, and where cells are inverted.

    It is read at half of its size on a phone, so letters are large, and the name of a case stands above its motions.
    """
    names = [name for name, *_ in compared(rows)]
    motions = dict.fromkeys((each["case"], each["motion"]) for each in rows)
    cases = dict.fromkeys(case for case, _ in motions)
    lines = [
        line
        for case in cases
        for line in ((case, None), *(each for each in motions if each[0] == case))
    ]
    skewness = np.full((len(lines), len(names)), np.nan)
    for each in rows:
        if each["inverted"] == 0:
            skewness[lines.index((each["case"], each["motion"])), names.index(each["method"])] = (
                each["max_skewness"]
            )
    least = np.nanmin(
        np.where(np.isnan(skewness).all(axis=1, keepdims=True), 1, skewness), axis=1, keepdims=True
    )
    figure, ax = plt.subplots(figsize=(7.2, 16.5), layout="constrained")
    ax.set_facecolor("#9a9a9a")
    image = ax.imshow(skewness / least, cmap="YlOrBr", vmin=1, vmax=2, aspect="auto")
    for j, i in np.argwhere(skewness == least):
        ax.text(i, j, "1", ha="center", va="center", fontsize=13)
    for j, (case, motion) in enumerate(lines):
        if motion is None:
            ax.axhspan(j - 0.5, j + 0.5, color="white")
            ax.text(-0.4, j, case, va="center", fontsize=13, weight="bold")
    ax.set_xticks(range(len(names)), names, rotation=90, fontsize=13)
    ax.xaxis.tick_top()
    ax.set_yticks(range(len(lines)), [motion or "" for _, motion in lines], fontsize=13)
    ax.tick_params(length=0)
    ax.spines[:].set_visible(False)
    bar = figure.colorbar(image, extend="max", aspect=40, location="bottom", pad=0.01)
    bar.set_label("largest skewness / the motion's best", fontsize=13)
    bar.ax.tick_params(labelsize=13)
    figure.savefig(file, dpi=100)


def save(rows: list[dict], file: pathlib.Path) -> None:
    """Writes the rows with four digits, case by case; the cost of a row stays in the JSON file, which says where it ran."""
    keys = [
        "case",
        "motion",
        "method",
        "inverted",
        "max_skewness",
        "mean_skewness",
        "min_jacobian",
        "angle",
        "limit",
        "error",
    ]
    with file.open("w", newline="") as out:
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(keys)
        for row in sorted(rows, key=lambda row: [row[key] for key in keys[:3]]):
            values = [row[key] for key in keys]
            writer.writerow(
                [f"{value:.4g}" if isinstance(value, float) else value for value in values]
            )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--points", type=int, default=2000)
    parser.add_argument("--case", nargs="+")
    parser.add_argument("--method", nargs="+", choices=METHODS)
    parser.add_argument("--entry", nargs="+", default=[])
    parser.add_argument("--write", type=pathlib.Path)
    parser.add_argument("--json", type=pathlib.Path)
    parser.add_argument("--peers", action="store_true")
    parser.add_argument("--join", nargs="+", type=pathlib.Path, default=[])
    parser.add_argument("--picture", type=pathlib.Path)
    parser.add_argument("--csv", type=pathlib.Path)
    asked = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    warnings.simplefilter("ignore")
    about(points=asked.points)
    rows = []
    print(
        "\n| case | motion | method | inverted | skewness | Jacobian | angle | height | behind | limit | move |"
    )
    print("|---" * 11 + "|")
    for case in all_cases(asked.points):
        if asked.case and case.name not in asked.case:
            continue
        if asked.write:
            write(asked.write, case)
        groups = [rows_of(case, name) for name in asked.method or METHODS]
        groups += [
            entered(name, pathlib.Path(folder), case)
            for name, _, folder in (e.partition("=") for e in asked.entry)
        ]
        groups += [of_peers(case)] if asked.peers else []
        for each in (each for group in groups for each in group):
            rows.append(each)
            keys = (
                "inverted",
                "max_skewness",
                "min_jacobian",
                "angle",
                "min_height",
                "behind",
                "limit",
                "move",
            )
            cells = ["-" if each[key] is None else f"{each[key]:.3g}" for key in keys]
            print(
                "| " + " | ".join([each["case"], each["motion"], each["method"], *cells]) + " |",
                flush=True,
            )
        jax.clear_caches()
        if asked.json:
            content = {
                "format": "jaxmorph championship",
                "version": 1,
                "points": asked.points,
                "rows": rows,
            }
            asked.json.write_text(json.dumps(content, indent=1))
    now = {(each["case"], each["method"]) for each in rows}
    earlier = (each for file in asked.join for each in json.loads(file.read_text())["rows"])
    rows += [each for each in earlier if (each["case"], each["method"]) not in now]
    if asked.picture:
        draw(rows, asked.picture)
    if asked.csv:
        save(rows, asked.csv)
    heads = (
        "method",
        "rows",
        "inverted",
        "within 10 %",
        "worst ratio",
        "median skewness",
        "angle",
        "limit",
        "move (s)",
    )
    print(f"\n{len(rows)} rows\n\n| " + " | ".join(heads) + " |\n" + "|---" * len(heads) + "|")
    for name, *numbers in compared(rows):
        print(f"| {name} | " + " | ".join(f"{number:.3g}" for number in numbers) + " |")


if __name__ == "__main__":
    main()
