"""The default against the best of three others, on generated meshes of every kind: its law is never to lose.

    python -m benchmarks.rows [--case NAME ...] [--json rows.json] [--seed 0]

Each motion is as large as the best of the published method, 64 interpolated leaves and the classic RBF can do with half of the
smallest Jacobian ratio left, times a random share from 0.3 to 1. A row is short where the default inverts cells and the best does
not, or keeps less than 0.85 of the best's ratio. Each motion has two rows: with the mesh, and with its points alone.
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

ENOUGH = 0.85
"""Least ratio of the default, relative to the best."""

RIVALS = {
    "published": lambda: jm.SurfaceReconstruction.published(),
    "64 leaves": lambda: jm.SurfaceReconstruction(
        jm.RBF(reduction=jm.KDTree(64, extremes=True)), jm.NearWall()
    ),
    "classic": lambda: jm.RBF.classic(),
}


class Row(NamedTuple):
    """The smallest Jacobian ratio of a motion by method; negative and zero ones are inverted cells."""

    case: str
    motion: str
    whole: bool
    amount: float
    ratios: dict[str, float]

    @property
    def best(self) -> float:
        return max(value for name, value in self.ratios.items() if name in RIVALS)

    @property
    def is_short(self) -> bool:
        return self.ratios["default"] < ENOUGH * self.best


def ratio(case: Case, plan: jm.Plan, motion, amount: float) -> float:
    """Moves the mesh and measures it."""
    report = jm.quality(case.mesh, jm.deform(plan, motion(case.base, amount)))
    return min(float(report.min_jacobian_ratio), 0.0 if int(report.inverted) else np.inf)


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
            yield Row(case.name, name, whole, amounts[name], found)


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
            if row.is_short:
                how = "mesh" if row.whole else "points"
                numbers = "  ".join(f"{name} {value:.2f}" for name, value in row.ratios.items())
                print(f"{row.case}, {row.motion} {row.amount:.3g}, {how}: {numbers}", flush=True)
        jax.clear_caches()
        if asked.json:
            asked.json.write_text(json.dumps([row._asdict() for row in rows], indent=1))
    share = np.array([row.ratios["default"] / max(row.best, 1e-9) for row in rows])
    inverted = sum(row.ratios["default"] <= 0 < row.best for row in rows)
    print(
        f"{len(rows)} rows, {sum(row.is_short for row in rows)} short, {inverted} of them inverted"
    )
    print(
        "the default over the best: "
        + ", ".join(f"{q} % {np.percentile(share, q):.2f}" for q in (0, 5, 10, 50, 90))
    )


if __name__ == "__main__":
    main()
