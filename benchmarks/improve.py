"""What `improve` repairs, and what it costs: the paper's airfoil pitched beyond its limit, its wing with a flap.

python benchmarks/improve.py [--wing]
python benchmarks/improve.py --worst [--points 1200] [--row "pitch 180" ...]

`--worst` compares `improve` and `improve(worst=True)` on awkward.py's motions, and on the championship's motions after which
`prepare`'s default leaves the smallest Jacobian ratios. `--row` chooses rows by the words with which their names begin.
"""

import argparse
import sys
import time
from collections.abc import Iterator

import agard445
import jax
import jax.numpy as jnp
import numpy as np
from _arena import all_cases
from _measure import about, table
from awkward import motions
from limits import pitch

import jaxmorph as jm
from jaxmorph import cases

SPAN, ROOT, TIP, SWEPT = (
    0.762,
    0.5577,
    0.3682,
    0.8094,
)  # metres: semi-span, chords, and the tip's leading edge behind the root's


def flap(base: np.ndarray, degrees: float) -> np.ndarray:
    """Aft 25 % of the chord from 0.4 to 0.8 of the span, gradually over 0.1 at both ends; trailing edge down."""
    eta = base[:, 1] / SPAN
    hinge = SWEPT * eta + 0.75 * (ROOT + (TIP - ROOT) * eta)
    rise = np.clip(np.minimum(eta - 0.4, 0.8 - eta) / 0.1, 0, 1)
    angle = np.where(base[:, 0] > hinge, degrees * rise**2 * (3 - 2 * rise), 0)
    about_hinge = np.stack([base[:, 0] - hinge, base[:, 2]], axis=1)
    moved = jm.shapes.rotate(about_hinge, -np.deg2rad(angle), np.zeros(2)) - about_hinge
    return np.stack([moved[:, 0], np.zeros(len(base)), moved[:, 1]], axis=1)


def report(name: str, mesh: jm.Mesh, points) -> jm.Improvement:
    """One line of the table: compilation included in the first time, not in the second."""
    took = []
    for _ in range(2):
        wall, cpu = time.perf_counter(), time.process_time()
        result = jax.block_until_ready(jm.improve(mesh, points))
        took.append(f"{time.perf_counter() - wall:.1f} | {time.process_time() - cpu:.1f}")
    quality = jm.quality(mesh, result.points)
    print(
        f"| {name} | {int(result.before)} | {int(result.after)} | {float(quality.max_skewness):.3f} | {int(result.steps)} "
        f"| {float(result.residual):.0e} | {took[0]} | {took[1]} |",
        flush=True,
    )
    return result


def derivative(mesh: jm.Mesh, plan: jm.Plan, base: np.ndarray) -> None:
    """Of the mean smooth skewness of the improved mesh by the angle, against a difference."""

    @jax.jit
    def objective(degrees):
        angle = -jnp.deg2rad(degrees)
        z = (base[:, 0] - 0.25 + 1j * base[:, 1]) * (jnp.exp(1j * angle) - 1)
        points = jm.deform(plan, jnp.stack([z.real, z.imag], axis=1))
        return jnp.mean(
            jm.smooth_quality(mesh, jm.improve(mesh, points, tolerance=1e-6).points).skewness
        )

    slope = jax.jit(jax.grad(objective))
    float(slope(15.0))
    took = []
    for function in (objective, slope):
        cpu = time.process_time()
        found = float(function(15.0))
        took.append(time.process_time() - cpu)
    difference = (float(objective(15.01)) - float(objective(14.99))) / 0.02
    print(
        f"\nd(mean smooth skewness)/d(degree) at 15 degrees: {found:.9f}, by differences {difference:.9f}; "
        f"CPU {took[1]:.1f} s, of the value {took[0]:.1f} s"
    )


def pitched(points: int):
    """Makes the airfoil's rows: name, mesh, plan and displacements."""
    mesh = cases.naca0015(points=points)
    wall, far = mesh.patch("airfoil"), mesh.patch("farfield")
    base = mesh.points[wall]
    default, graph = (
        jm.prepare(mesh.points, wall, far),
        jm.prepare(mesh.points, wall, far, method=jm.DelaunayGraph()),
    )
    for plan, name, degrees in (
        (default, "default", 15),
        (default, "default", 60),
        (graph, "graph mapping", 90),
        (default, "default", 150),
    ):
        yield f"airfoil, {degrees} degrees, {name}", mesh, plan, pitch(base, degrees)


def airfoil(points: int) -> None:
    for name, mesh, plan, u in pitched(points):
        report(name, mesh, jm.deform(plan, u))
        if name.startswith("airfoil, 15"):
            derivative(mesh, plan, mesh.points[mesh.patch("airfoil")])


def wing(points: int) -> None:
    mesh = agard445.mesh(points=points)
    moving, far = mesh.patch("wing"), mesh.patch("farfield")
    plan = jm.prepare(mesh.points, moving, far, symmetry=jm.Plane((0, 1, 0), (0, 0, 0)))
    for degrees in (30, 45, 60):
        report(
            f"wing, flap {degrees} degrees, default",
            mesh,
            jm.deform(plan, flap(mesh.points[moving], degrees)),
        )


HARDEST = {
    "cascade": ("pitch 45", "heave 0.5", "pitch 15"),
    "O-grid": ("pitch 45",),
    **{f"bricks, {kind}": ("dent",) for kind in ("hexahedron", "tetra", "pyramid", "wedge")},
}
"""Motions of the championship's cases without planes after which the default's Jacobian ratios are smallest."""


def hard_rows(points: int, chosen: tuple[str, ...]):
    """Makes the mesh and the moved points of each row."""
    for name, mesh, plan, u in pitched(points):
        if name.startswith(chosen):
            yield name, mesh, jm.deform(plan, u)
    for name, make in motions(points).items():
        if name.startswith(chosen):
            mesh, moving, fixed, motion, steps = make()
            path = np.stack([motion((j + 1) / steps) for j in range(steps)])
            plan = jm.prepare(mesh, moving, fixed)
            yield f"{name}, one step", mesh, jm.deform(plan, path[-1])
            yield f"{name}, {steps} steps", mesh, jm.march(plan, path)[1]
    wanted = {(case, motion) for case, names in HARDEST.items() for motion in names}
    wanted = {(case, motion) for case, motion in wanted if f"{case}: {motion}".startswith(chosen)}
    for case in all_cases(points) if wanted else ():
        for motion in (motion for motion in case.motions if (case.name, motion) in wanted):
            yield (
                f"{case.name}: {motion}",
                case.mesh,
                jm.deform(case.plan(None), case.motions[motion](case.wall, 1.0)),
            )


def worst(points: int, chosen: tuple[str, ...]) -> Iterator[list[str]]:
    """Makes the table of `improve` and `improve(worst=True)`, its heads first; with CPU seconds of a second call."""
    yield [
        "motion",
        "inverted before",
        "ratio, skewness before",
        "`improve`",
        "`worst=True`",
        "CPU, s",
        "`worst`",
    ]
    for name, mesh, moved in hard_rows(points, chosen):
        line, took = [name, str(int(jm.quality(mesh, moved).inverted))], []
        for is_worst in (None, False, True):
            found = moved
            for _ in range(0 if is_worst is None else 2):
                began = time.process_time()
                found = jax.block_until_ready(jm.improve(mesh, moved, worst=bool(is_worst))).points
                cpu = time.process_time() - began
            quality = jm.quality(mesh, found)
            took += [] if is_worst is None else [f"{cpu:.1f}"]
            line.append(
                f"{float(quality.min_jacobian_ratio):.3f}, {float(quality.max_skewness):.3f}"
            )
        yield [*line, *took]
        jax.clear_caches()


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--wing", action="store_true", help="the wing instead of the airfoil")
    parser.add_argument("--points", type=int)
    parser.add_argument(
        "--worst", action="store_true", help="`improve` against `improve(worst=True)`"
    )
    parser.add_argument("--row", nargs="+", default=[""], help="words that begin a row's name")
    arguments = parser.parse_args()
    if arguments.worst:
        about(points=arguments.points or 1200)
        lines = worst(arguments.points or 1200, tuple(arguments.row))
        table(lines, next(lines))
        sys.exit()
    about(points=arguments.points or (64_943 if arguments.wing else 39_666))
    print(
        "\n| case | inverted before | after | max skewness | steps | residual | first, s | CPU | again, s | CPU |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    if arguments.wing:
        wing(arguments.points or 64_943)
    else:
        airfoil(arguments.points or 39_666)
