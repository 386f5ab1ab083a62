"""What each method does to the cells at a wall: inverted cells, wall orthogonality, first-cell height, overshoot, limits.

python benchmarks/walls.py [--part shapes --part kinks ...] [--case naca0015 ...] [--method default ...] [--all-methods]
                           [--points 39666] [--json walls.json]

Columns: inverted cells (18 runs together for the kinks); the smallest corner Jacobian over its undeformed value; degrees by which
the first grid line has left its own angle to the wall, mean and largest; smallest and largest height of a first cell over its
undeformed one; skewness, its mean weighted by area, and the largest; the largest motion of a node off the surface over the
largest of the surface, behind a part that rests and anywhere.
"""

import argparse
import gc
import json
import pathlib
import sys
import time
from collections.abc import Callable, Iterator, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from _measure import about
from _walls import PARTS, Case, camber, flap, pitch

import jaxmorph as jm
from jaxmorph import cases

COARSE, FEW = (jm.RBF(reduction=jm.KDTree(leaves, extremes=True)) for leaves in (64, 16))
"""Coarse fields of the corrections that are compared: they interpolate at many sources, and at about half as many."""


def on_default(correction: jm.AbstractMethod) -> jm.AbstractMethod:
    """`prepare`'s default with another correction."""
    return eqx.tree_at(lambda method: method.correction, jm.SurfaceReconstruction(), correction)


METHODS: dict[str, Callable[[float], jm.AbstractMethod]] = {
    "default": lambda size: jm.SurfaceReconstruction(),
    "default, multiscale": lambda size: on_default(jm.Multiscale()),
    "default, both": lambda size: on_default(jm.NearWall(jm.Multiscale())),
    "published": lambda size: jm.SurfaceReconstruction.published(8, 2),
    "classic RBF": lambda size: jm.RBF.classic(jm.ThinPlateSpline()),
    "graph alone": lambda size: jm.DelaunayGraph(),
    "graph": lambda size: jm.SurfaceReconstruction(COARSE, jm.DelaunayGraph()),
    "layer": lambda size: jm.SurfaceReconstruction(COARSE, jm.NearWall()),
    "multiscale": lambda size: jm.SurfaceReconstruction(COARSE, jm.Multiscale()),
    "multiscale, layer": lambda size: jm.SurfaceReconstruction(
        COARSE, jm.NearWall(jm.Multiscale())
    ),
    "few, layer": lambda size: jm.SurfaceReconstruction(FEW, jm.NearWall()),
    "few, multiscale": lambda size: jm.SurfaceReconstruction(FEW, jm.Multiscale()),
    "few, both": lambda size: jm.SurfaceReconstruction(FEW, jm.NearWall(jm.Multiscale())),
    "multiscale, whole": lambda size: jm.Multiscale.whole(2 * size, 0.1),
    "elasticity": lambda size: jm.LinearElasticity(),
    "torsional": lambda size: jm.TorsionalSprings(),
}
"""By name, for a body of a size. "layer" is `NearWall`; "both" and "multiscale, layer" are it around `Multiscale`."""

STANDARD = ("default", "layer", "published", "classic RBF", "graph alone")
"""Methods of the documentation's table: the default, the default without its fit, and three to measure it against."""

DENSE = 4_000
"""Surface nodes of the classic RBF, at most: it is left out of the wing, where it takes minutes and gigabytes."""

COLUMNS = (
    "inverted",
    "ratio",
    "line",
    "line max",
    "height",
    "height max",
    "skew",
    "skew max",
    "behind",
    "anywhere",
)


def prepared(case: Case, name: str) -> jm.Plan:
    size = float(np.ptp(case.mesh.points[case.moving], axis=0).max())
    method = METHODS[name](size)
    return jm.prepare(case.mesh, case.moving, case.fixed, method=method, symmetry=case.symmetry)


def measured(case: Case, plan: jm.Plan, path: np.ndarray) -> dict[str, float]:
    """All columns for one motion."""
    points = (
        jm.march(plan, jnp.asarray(path))[1]
        if len(path) > 1
        else jm.deform(plan, jnp.asarray(path[0]))
    )
    report, wall = jm.quality(case.mesh, points), jm.wall_quality(case.mesh, case.moving, points)
    seen = jm.inspect(plan, path[-1])
    return {
        "inverted": int(report.inverted),
        "ratio": float(report.min_jacobian_ratio),
        "line": float(wall.mean_angle),
        "line max": float(wall.max_angle),
        "height": float(wall.min_height),
        "height max": float(wall.max_height),
        "skew": float(report.mean_skewness),
        "skew max": float(report.max_skewness),
        "behind": seen.overshoot_behind,
        "anywhere": seen.overshoot,
    }


def summed(rows: dict[str, dict[str, float]]) -> dict[str, dict[str, float]]:
    """Random motions of one kind as one row: inverted cells summed, the worst ratio beside the mean one, means of the rest."""
    result = {}
    for kind in dict.fromkeys(name.split()[-2] for name in rows):
        part = [row for name, row in rows.items() if name.split()[-2] == kind]
        row = {column: float(np.mean([each[column] for each in part])) for column in COLUMNS}
        row["inverted"] = sum(each["inverted"] for each in part)
        row["runs inverted"] = sum(each["inverted"] > 0 for each in part)
        row["worst ratio"] = min(each["ratio"] for each in part)
        result[f"{len(part)} {kind}: mean ratio"] = row
    return result


def part_of(
    name: str, points: int, methods: list[str], only: list[str], motions: Sequence[str] = ()
) -> dict[str, dict[str, dict[str, float]]]:
    """Rows by motion and method, of all cases or of some by name, of all motions or of some."""
    rows: dict[str, dict[str, dict[str, float]]] = {method: {} for method in methods}
    for case in PARTS[name](points):
        if only and case.name not in only:
            continue
        for method in methods:
            if method == "classic RBF" and len(case.moving) + len(case.fixed) > DENSE:
                continue
            plan = prepared(case, method)
            for motion, path in case.motions.items():
                if motions and motion not in motions:
                    continue
                rows[method][f"{case.name} {motion}"] = measured(case, plan, path)
            print(".", end="", file=sys.stderr, flush=True)
        jax.clear_caches()
        gc.collect()
    if name == "kinks":
        rows = {method: summed(each) for method, each in rows.items()}
    found = dict.fromkeys(motion for each in rows.values() for motion in each)
    return {
        motion: {method: each[motion] for method, each in rows.items() if motion in each}
        for motion in found
    }


def limits(points: int, methods: list[str]) -> dict[str, dict[str, float]]:
    """How far each motion goes in one step before a cell inverts: degrees, degrees, degrees, chords."""
    mesh = cases.naca0015(points=points)
    moving, fixed = mesh.patch("airfoil"), mesh.patch("farfield")
    base, motions = mesh.points[moving], {
        "pitch": (pitch, 180.0),
        "flap": (flap, 120.0),
        "wide flap": (lambda base, angle: flap(base, angle, 0.3), 120.0),
        "camber": (camber, 2.0),
    }  # fmt: skip
    case, result = Case("limits", "naca0015", mesh, moving, fixed, {}), {}
    for method in methods:
        plan, result[method] = prepared(case, method), {}
        for name, (motion, most) in motions.items():
            low, high = 0.0, most
            while high - low > most / 256:
                middle = (low + high) / 2
                fine = not int(
                    jm.quality(mesh, jm.deform(plan, jnp.asarray(motion(base, middle)[0]))).inverted
                )
                low, high = (middle, high) if fine else (low, middle)
            result[method][name] = low
        print(".", end="", flush=True)
    jax.clear_caches()
    return result


NAMES = {
    "layer": "64 leaves",
    "graph alone": "graph mapping",
    "elasticity": "`LinearElasticity()`",
} | {"torsional": "`TorsionalSprings()`"}
"""Names of methods in the pages."""
PAGE_MOTIONS = ("camber 10 %", "flap 45")


def at_the_wall() -> Iterator[list[str]]:
    """Makes the page's table of the paper's airfoil, its heads first."""
    yield [
        "motion, method",
        "Jacobian ratio",
        "first line off",
        "first cell's height",
        "skewness",
        "overshoot",
    ]
    found = part_of(
        "shapes",
        39_666,
        ["default", "layer", "classic RBF", "graph alone"],
        ["naca0015"],
        PAGE_MOTIONS,
    )
    for motion, methods in found.items():
        for method, row in methods.items():
            yield [
                f"{motion.removeprefix('naca0015 ')}, {NAMES.get(method, method)}",
                f"{row['ratio']:.2f}",
                f"{row['line']:.1f} / {row['line max']:.1f}",
                f"{row['height']:.2f} to {row['height max']:.2f}",
                f"{row['skew']:.4f} / {row['skew max']:.3f}",
                f"{row['behind']:.2f} / {row['anywhere']:.2f}",
            ]


def by_cells() -> Iterator[list[str]]:
    """Makes the page's table of methods that solve on the cells, its heads first."""
    yield [
        "method",
        "largest skewness",
        "first line off, mean / max",
        "smallest Jacobian ratio",
        "first cell's height",
    ]
    found = part_of(
        "shapes",
        12_000,
        ["default", "elasticity", "torsional", "classic RBF"],
        ["naca0015"],
        ["camber 10 %"],
    )
    for methods in found.values():
        for method, row in methods.items():
            yield [
                NAMES.get(method, method),
                f"{row['skew max']:.3f}",
                f"{row['line']:.1f} / {row['line max']:.1f}",
                f"{row['ratio']:.2f}",
                f"{row['height']:.2f} to {row['height max']:.2f}",
            ]


def show(part: str, rows: dict[str, dict[str, dict[str, float]]]) -> None:
    """100 columns wide; a motion's name on a line of its own."""
    print(
        f"\n{part:<20}{'inverted':>8}{'ratio':>7}{'line':>7}{'max':>7}{'height':>9}{'max':>7}{'skew':>9}{'max':>8}{'behind':>9}{'any':>7}"
    )
    for motion, methods in rows.items():
        print(f"- {motion}")
        for method, row in methods.items():
            cells = f"{row['inverted']:>8}{row['ratio']:>7.2f}{row['line']:>7.1f}{row['line max']:>7.1f}"
            cells += f"{row['height']:>9.2f}{row['height max']:>7.2f}{row['skew']:>9.4f}{row['skew max']:>8.3f}"
            more = (
                f"  ({row['runs inverted']} runs, worst {row['worst ratio']:.2f})"
                if "worst ratio" in row
                else ""
            )
            print(
                f"{method:<20}{cells}{row['behind']:>9.2f}{row['anywhere']:>7.2f}{more}", flush=True
            )


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--part",
        action="append",
        choices=[*PARTS, "limits"],
        help="all of them by default; may repeat",
    )
    parser.add_argument(
        "--case",
        action="append",
        default=[],
        help="of these parts, by name, as naca0015; may repeat",
    )
    parser.add_argument(
        "--method",
        action="append",
        choices=list(METHODS),
        help=f"{', '.join(STANDARD)} by default; may repeat",
    )
    parser.add_argument("--all-methods", action="store_true", help="every one: hours")
    parser.add_argument(
        "--points", type=int, default=8_000, help="of the generated airfoils; 39666 as in the paper"
    )
    parser.add_argument("--json", type=pathlib.Path, help="a file for all figures")
    options = parser.parse_args()
    methods, results = options.method or list(METHODS if options.all_methods else STANDARD), {}
    about(points=options.points)
    for part in options.part or [*PARTS, "limits"]:
        began = time.process_time()
        if part == "limits":
            results[part] = limits(options.points, methods)
            print(
                f"\n{'limits, one step':<20}{'pitch':>9}{'flap':>9}{'wide flap':>12}{'camber':>9}"
            )
            for method, row in results[part].items():
                print(
                    f"{method:<20}{row['pitch']:>9.1f}{row['flap']:>9.1f}{row['wide flap']:>12.1f}{row['camber']:>9.2f}"
                )
        else:
            results[part] = part_of(part, options.points, methods, options.case)
            show(part, results[part])
        print(f"{part}: {time.process_time() - began:.0f} s of CPU time", flush=True)
        if options.json:
            options.json.write_text(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
