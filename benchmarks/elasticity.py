"""Elasticity on the paper's wing, end to end: set-up, a motion, its pullback, in CPU seconds, and the largest resident memory.

python benchmarks/elasticity.py [--points 64943] [--modes]

`--modes` asks instead for the smallest volume of a cell over its undeformed one in modes of the wing, by elasticity and by the
default, with a symmetry plane and with that plane held still. Else the wing bends by a quarter of its span. Programs are
compiled before a motion is timed; the set-up includes their compilation.
"""

import argparse
import resource

import agard445
import jax
import numpy as np
from _measure import about, cpu_seconds, once, table

import jaxmorph as jm

MODES = (1, 0.25), (1, 0.5), (2, 0.3)
"""Mode, and how far the tip's trailing edge goes, in semi-spans."""


def modes(mesh: jm.Mesh) -> None:
    rows = []
    for name, method in (("`LinearElasticity()`", jm.LinearElasticity()), ("the default", None)):
        for what, fixed, symmetry in (
            ("symmetry plane", "farfield", "symmetry"),
            ("held still", ("farfield", "symmetry"), ()),
        ):
            plan = jm.prepare(mesh, "wing", fixed, symmetry=symmetry, method=method)
            wall = np.asarray(plan.points)[np.asarray(plan.moving)]
            moved = [jm.deform(plan, agard445.mode(wall, mode, size)) for mode, size in MODES]
            least = [float(jm.quality(mesh, points).min_volume_ratio) for points in moved]
            rows.append([name, what, *(f"{ratio:.3f}" for ratio in least)])
    table(rows, ("method", "plane", *(f"mode {mode} at {size}" for mode, size in MODES)))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--points", type=int, default=64_943)
    parser.add_argument("--modes", action="store_true")
    asked = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    mesh = agard445.mesh(points=asked.points)
    about(points=len(mesh.points))
    if asked.modes:
        modes(mesh)
        return
    plan, setup, _ = once(
        lambda: jm.prepare(
            mesh, "wing", "farfield", symmetry="symmetry", method=jm.LinearElasticity()
        )
    )
    assert isinstance(plan, jm.Plan)
    wall = np.asarray(plan.points)[np.asarray(plan.moving)]
    span = wall[:, 1].max()
    u = np.zeros_like(wall)
    u[:, 2] = 0.25 * span * (wall[:, 1] / span) ** 2
    w = np.random.default_rng(0).normal(size=plan.points.shape)
    seconds = cpu_seconds(
        {"deform": lambda: jm.deform(plan, u), "pullback": lambda: jm.pullback(plan, u, w)},
        repeats=3,
    )
    report = jm.quality(mesh, jm.deform(plan, u))
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    rows = [
        ["set-up, s", f"{setup:.1f}", "6"],
        ["`deform`, s", f"{seconds['deform']:.2f}", "2"],
        ["`pullback` over `deform`", f"{seconds['pullback'] / seconds['deform']:.2f}", "1.2"],
        ["memory, GB", f"{memory / 1e9:.2f}", "1"],
        [
            "inverted cells, smallest Jacobian ratio",
            f"{int(report.inverted)}, {float(report.min_jacobian_ratio):.2f}",
            "0",
        ],
    ]
    table(rows)


if __name__ == "__main__":
    main()
