"""How far each method goes before the first inverted cell, on the paper's airfoil: pitching, and a flap deflected.

python benchmarks/limits.py [--points 39666] [--method "elasticity 1/V" ...]
"""

import argparse
from collections.abc import Iterator, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from _measure import about, table

import jaxmorph as jm
from jaxmorph import cases

METHODS = {
    "classic RBF, 732 sources": jm.RBF.classic(),
    "graph mapping": jm.DelaunayGraph(),
    "the paper's, 4 + 6": jm.SurfaceReconstruction.published(1, 2),
    "the paper's, 32 + 6": jm.SurfaceReconstruction.published(8, 2),
    "the default": None,
    "the default without its fit": jm.SurfaceReconstruction(
        jm.RBF(reduction=jm.KDTree(64, extremes=True))
    ),
    "elasticity 1/V": jm.LinearElasticity(),
    "elasticity 1/d": jm.LinearElasticity(jm.ByDistance(1.0)),
    "elasticity 1/d^2": jm.LinearElasticity(jm.ByDistance(2.0)),
    "torsional springs": jm.TorsionalSprings(),
    "Laplacian 1/d^2": jm.Laplacian(),
    "springs 1/l^2": jm.SpringAnalogy(),
    "inverse distance": jm.InverseDistance(),
    "inverse distance, turning": jm.InverseDistance(rotations=True),
}


def pitch(base: np.ndarray, degrees: float) -> jax.Array:
    """Nose up about the quarter chord."""
    return jm.shapes.rotate(base, -np.deg2rad(degrees), [0.25, 0.0]) - base


def flap(base: np.ndarray, degrees: float) -> jax.Array:
    """Downwards behind 70 % of the chord, blended over a tenth of it before the hinge."""
    share = np.clip((base[:, 0] - 0.65) / 0.1, 0, 1)
    return (
        jm.shapes.rotate(base, -np.deg2rad(degrees) * share**2 * (3 - 2 * share), [0.7, 0.0]) - base
    )


def limit(plan: jm.Plan, mesh: jm.Mesh, motion, most: float, steps: int) -> float:
    """Degrees reached in so many steps, to 1 degree."""

    def fine(degrees: float) -> bool:
        path = np.stack([motion(degrees * (j + 1) / steps) for j in range(steps)])
        return int(jm.quality(mesh, jm.march(plan, jnp.asarray(path))[1]).inverted) == 0

    low, high = 0.0, most
    if fine(most):
        return most
    while high - low > 1:
        middle = (low + high) / 2
        low, high = (middle, high) if fine(middle) else (low, middle)
    return low


def rows(points: int = 39_666, methods: Sequence[str] = tuple(METHODS)[:6]) -> Iterator[list[str]]:
    """Makes the table, its heads first."""
    mesh = cases.naca0015(points=points)
    base = mesh.points[mesh.patch("airfoil")]
    yield ["method", "pitch to 180, 1 step", "in 9 steps", "flap to 120, 1 step", "in 9 steps"]
    for name in methods:
        method = METHODS[name]
        whole = method is None or method.needs_cells or not method.linear
        plan = jm.prepare(
            mesh if whole else mesh.points,
            mesh.patch("airfoil"),
            mesh.patch("farfield"),
            method=method,
        )
        reached = []
        for motion, most in ((pitch, 180.0), (flap, 120.0)):
            for steps in (1, 9):
                degrees = limit(plan, mesh, lambda a, motion=motion: motion(base, a), most, steps)
                reached.append(f"{degrees:.0f}" + ("+" if degrees == most else ""))
        yield [name, *reached]


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=39_666)
    parser.add_argument("--method", nargs="+", choices=METHODS, default=list(METHODS))
    asked = parser.parse_args()
    about(points=asked.points, first_cell=1e-5)
    lines = rows(asked.points, asked.method)
    table(lines, next(lines))
