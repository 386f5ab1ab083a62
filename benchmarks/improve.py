"""What `improve` repairs, and what it costs: the paper's airfoil pitched beyond its limit, its wing with a flap.

python benchmarks/improve.py [--wing]
"""

import argparse
import time

import jax
import jax.numpy as jnp
import numpy as np
from _measure import about
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
        return jnp.mean(jm.smooth_quality(mesh, jm.improve(mesh, points, tolerance=1e-6).points).skewness)

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


def airfoil(points: int) -> None:
    mesh = cases.naca0015(points=points)
    wall, far = mesh.patch("airfoil"), mesh.patch("farfield")
    base = mesh.points[wall]
    default, graph = jm.prepare(mesh.points, wall, far), jm.prepare(mesh.points, wall, far, method=jm.DelaunayGraph())
    for plan, name, degrees in ((default, "default", 15), (graph, "graph mapping", 90), (default, "default", 150)):
        report(f"airfoil, {degrees} degrees, {name}", mesh, jm.deform(plan, pitch(base, degrees)))
    derivative(mesh, default, base)


def wing(points: int) -> None:
    mesh = cases.agard445(points=points)
    moving, far = mesh.patch("wing"), mesh.patch("farfield")
    plan = jm.prepare(mesh.points, moving, far, symmetry=jm.Plane((0, 1, 0), (0, 0, 0)))
    for degrees in (30, 45, 60):
        report(f"wing, flap {degrees} degrees, default", mesh, jm.deform(plan, flap(mesh.points[moving], degrees)))


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--wing", action="store_true", help="the wing instead of the airfoil")
    parser.add_argument("--points", type=int)
    arguments = parser.parse_args()
    about(points=arguments.points or (64_943 if arguments.wing else 39_666))
    print("\n| case | inverted before | after | max skewness | steps | residual | first, s | CPU | again, s | CPU |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    if arguments.wing:
        wing(arguments.points or 64_943)
    else:
        airfoil(arguments.points or 39_666)
