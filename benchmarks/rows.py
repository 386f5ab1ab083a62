"""The default against the best of three others, on generated meshes of every kind: its law is never to lose.

    python -m benchmarks.rows [--case NAME ...] [--json rows.json] [--seed 0]

Each motion is as large as the best of the published method, 64 interpolated leaves and the classic RBF can do with half of the
smallest Jacobian ratio left, times a random share from 0.3 to 1. A row is short where the default inverts cells and the best does
not, or keeps less than 0.8 of a best ratio of 0.5 or more. It leans where the default's first grid lines are off by more than the
best other method's and half a degree. Each motion has two rows: with the mesh, and with its points alone.
"""

import argparse
import contextlib
import json
import pathlib
import sys
import warnings
from collections.abc import Iterator
from typing import NamedTuple

sys.path.insert(0, str(pathlib.Path(__file__).parent))

import jax
import numpy as np
from _rows import Case, all_cases

import jaxmorph as jm

ENOUGH = 0.8
"""Least ratio of the default, relative to the best."""

MORE = 0.5
"""Degrees by which the mean angle of first grid lines may exceed the best."""

RIVALS = {
    "published": lambda: jm.SurfaceReconstruction.published(),
    "64 leaves": lambda: jm.SurfaceReconstruction(
        jm.RBF(reduction=jm.KDTree(64, extremes=True)), jm.NearWall()
    ),
    "classic": lambda: jm.RBF.classic(),
}


class Row(NamedTuple):
    """Numbers of a motion by method: smallest Jacobian ratio (at most zero with inverted cells), mean angle of first grid lines in
    degrees, and first heights, 2nd and 98th percentile.
    """

    case: str
    motion: str
    whole: bool
    amount: float
    ratios: dict[str, float]
    angles: dict[str, float]
    heights: dict[str, tuple[float, float]]

    @property
    def best(self) -> float:
        return max(value for name, value in self.ratios.items() if name in RIVALS)

    @property
    def is_short(self) -> bool:
        value = self.ratios["default"]
        return value <= 0 < self.best or (self.best >= 0.5 and value < ENOUGH * self.best)

    @property
    def leans(self) -> bool:
        least = min(value for name, value in self.angles.items() if name in RIVALS)
        return self.whole and self.angles["default"] > least + MORE


def ratio(case: Case, plan: jm.Plan, motion, amount: float) -> float:
    """Moves the mesh and measures its cells."""
    report = jm.quality(case.mesh, jm.deform(plan, motion(case.base, amount)))
    return min(float(report.min_jacobian_ratio), 0.0 if int(report.inverted) else np.inf)


def at_wall(case: Case, plan: jm.Plan, motion, amount: float) -> tuple[float, tuple[float, float]]:
    """Moves the mesh and measures its first grid lines: mean angle, and heights."""
    points = jm.deform(plan, motion(case.base, amount))
    lines = jm.wall_quality(case.mesh, case.mesh.patch(*case.moving), points)
    low, high = np.percentile(np.asarray(lines.height), [2, 98]).tolist()
    return float(lines.mean_angle), (low, high)


def largest(case: Case, plans: list[jm.Plan], motion) -> float:
    """Finds the amount at which the best of the plans keeps half, to 3 %."""

    def best(amount: float) -> float:
        return max(ratio(case, plan, motion, amount) for plan in plans)

    low, high = 0.0, 1.0
    while best(high) > 0.5 and high < 4:
        low, high = high, 2 * high
    while high - low > 0.03 * high:
        middle = (low + high) / 2
        low, high = (middle, high) if best(middle) > 0.5 else (low, middle)
    return low


def rows_of(case: Case, rng: np.random.Generator, default=lambda: None) -> Iterator[Row]:
    """Runs all motions of a case, first with the mesh, then with its points alone."""
    amounts: dict[str, float] = {}
    for whole in (True, False):
        methods = {"default": case.prepared(default(), whole)}
        for name, make in RIVALS.items():
            with contextlib.suppress(
                ValueError
            ):  # the classic RBF refuses nodes that nearly coincide
                methods[name] = case.prepared(make(), whole)
        rivals = [plan for name, plan in methods.items() if name in RIVALS]
        for name, motion in case.motions.items():
            if name not in amounts:
                amounts[name] = largest(case, rivals, motion) * rng.uniform(0.3, 1)
            found = {
                method: ratio(case, plan, motion, amounts[name]) for method, plan in methods.items()
            }
            lines = {m: at_wall(case, plan, motion, amounts[name]) for m, plan in methods.items()}
            angles = {method: angle for method, (angle, _) in lines.items()}
            heights = {method: span for method, (_, span) in lines.items()}
            yield Row(case.name, name, whole, amounts[name], found, angles, heights)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--case", nargs="+")
    parser.add_argument("--json", type=pathlib.Path)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    warnings.simplefilter("ignore")
    rows: list[Row] = []
    for case in all_cases():
        if asked.case and case.name not in asked.case:
            continue
        found = list(rows_of(case, np.random.default_rng([asked.seed, *case.name.encode()])))
        rows += found
        for row in found:
            if row.is_short or row.leans:
                how = "mesh" if row.whole else "points"
                numbers = "  ".join(
                    f"{name} {value:.2f} / {row.angles[name]:.1f}"
                    for name, value in row.ratios.items()
                )
                print(f"{row.case}, {row.motion} {row.amount:.3g}, {how}: {numbers}", flush=True)
        jax.clear_caches()
        if asked.json:
            asked.json.write_text(json.dumps([row._asdict() for row in rows], indent=1))
    share = np.array([row.ratios["default"] / max(row.best, 1e-9) for row in rows])
    inverted = sum(row.ratios["default"] <= 0 < row.best for row in rows)
    print(
        f"{len(rows)} rows, {sum(row.is_short for row in rows)} short, {inverted} of them inverted, "
        f"{sum(row.leans for row in rows)} lean"
    )
    angles = {
        name: [row.angles[name] for row in rows if row.whole and name in row.angles]
        for name in ("default", *RIVALS)
    }
    for name, values in angles.items():
        print(f"{name}: mean angle of first lines, median over rows {np.median(values):.2f}")
    print(
        "the default over the best: "
        + ", ".join(f"{q} % {np.percentile(share, q):.2f}" for q in (0, 5, 10, 50, 90))
    )


if __name__ == "__main__":
    main()
