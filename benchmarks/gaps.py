"""Walls that nearly touch: gaps that close in one step and in ten, walls that meet at a corner, a valve, a blade's tip.

    python benchmarks/gaps.py

Inverted cells and the smallest Jacobian ratio by three methods. What is left of the gap is the best ratio that a method can reach.
"""

from collections.abc import Callable, Iterator

import faults
import jax
import numpy as np
from _measure import about, table

import jaxmorph as jm

METHODS = {
    "default": lambda: jm.SurfaceReconstruction(),
    "classic RBF": lambda: jm.RBF.classic(jm.ThinPlateSpline()),
    "elasticity": lambda: jm.LinearElasticity(),
}
Motion = Callable[[float], np.ndarray]


def row(
    name: str,
    mesh: jm.Mesh,
    plans: dict[str, jm.Plan],
    motion: Motion,
    amount: float,
    steps: int = 1,
) -> list[str]:
    """One line: what is left of the gap, then each method. Each of several steps leaves an equal share of what was left."""
    shares = (
        [1 - (1 - amount) ** ((j + 1) / steps) for j in range(steps)] if steps > 1 else [amount]
    )
    path = np.stack([motion(share) for share in shares])
    left = jm.inspect(plans["default"], path[-1], mesh=mesh).gap_left
    line = [
        f"{name}{f', {steps} steps' if steps > 1 else ''}",
        "" if left is None else f"{left:.3f}",
    ]
    for method, plan in plans.items():
        points = jm.march(plan, path, rebuild=method != "elasticity" and steps > 1)[1]
        report = jm.quality(mesh, points)
        line.append(f"{int(report.inverted)}, {float(report.min_jacobian_ratio):#.3g}")
    return line


def prepared(
    mesh: jm.Mesh, moving: str, fixed: tuple[str, ...], **boundaries
) -> dict[str, jm.Plan]:
    return {
        name: jm.prepare(mesh, moving, fixed, method=make(), **boundaries)
        for name, make in METHODS.items()
    }


def rows() -> Iterator[list[str]]:
    """Makes the table, its heads first."""
    yield ["motion", "gap left", *METHODS]
    mesh = faults.channel(rows=20)
    base = mesh.points[mesh.patch("inner")]
    x = base[:, 0]
    bump = np.exp(-(((x - 0.5) / 0.1) ** 2)) * (4 * x * (1 - x)) ** 2
    plans = prepared(mesh, "inner", ("outer", "inlet", "outlet"))

    def raised(share):
        return 0.2 * share * np.column_stack([0 * x, bump])

    for amount, steps in ((0.5, 1), (0.8, 1), (0.98, 10)):
        yield row(f"channel, a bump of {amount} of the gap", mesh, plans, raised, amount, steps)

    plans = prepared(mesh, "inner", ("outer", "inlet"), sliding="outlet")

    def hinged(degrees):
        return np.asarray(jm.shapes.rotate(base, np.radians(degrees), about=(0, 0))) - base

    for degrees in (5, 8, 11):
        yield row(
            f"channel, a wall turned by {degrees} degrees about its corner",
            mesh,
            plans,
            hinged,
            degrees,
        )

    mesh = faults.valve()
    shape = mesh.points[mesh.patch("valve")].shape
    plans = prepared(mesh, "valve", ("seat", "inlet", "outlet", "top"), symmetry="middle")

    def closed(share):
        return np.broadcast_to([0, -0.1 * share], shape)

    for amount, steps in ((-4, 1), (-2, 1), (0.5, 1), (0.8, 1), (0.98, 10)):
        yield row(f"valve, its lift times {1 - amount:.3g}", mesh, plans, closed, amount, steps)

    mesh = faults.blade_tip()
    blade = mesh.points[mesh.patch("blade")]
    plans = prepared(mesh, "blade", ("hub", "inlet", "outlet", "left", "right", "shroud"))

    def leaned(degrees):
        height = np.linalg.norm(blade[:, 1:], axis=1) - 1
        return (
            np.asarray(
                jm.shapes.rotate(
                    blade, np.radians(degrees) * height, about=(0, 0, 0), axis=(1, 0, 0)
                )
            )
            - blade
        )

    for degrees in (2, 5):
        yield row(
            f"blade tip, leaned by {degrees} degrees about the shroud's axis",
            mesh,
            plans,
            leaned,
            degrees,
        )


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    about()
    lines = rows()
    table(lines, next(lines))
