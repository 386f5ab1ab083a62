"""Bases, reductions and solvers of radial basis functions: what a reduced field misses at the wall, in chords."""

import jax
import numpy as np

import jaxmorph as jm
from jaxmorph import cases

jax.config.update("jax_enable_x64", True)
mesh = cases.naca0015(points=400)
wall = mesh.points[mesh.patch("airfoil")]
u = 0.05 * np.sin(np.pi * wall[:, :1]) * np.array([0.0, 1.0])


def missed(method: jm.RBF) -> float:
    """Measures the largest distance of a wall node from where `u` puts it."""
    plan = jm.prepare(mesh, "airfoil", "farfield", method=method)
    return float(np.abs(jm.deform(plan, u)[plan.moving] - wall - u).max())


radius = 3.0
for basis in (
    jm.ThinPlateSpline(),
    jm.CubicSpline(),
    jm.LinearSpline(),
    jm.Multiquadric(0.2),
    jm.InverseMultiquadric(0.2),
    jm.InverseQuadratic(0.2),
    jm.Gaussian(0.1),
    jm.WendlandC0(radius),
    jm.WendlandC2(radius),
    jm.WendlandC4(radius),
    jm.WendlandC6(radius),
    jm.CompactC0(radius),
    jm.CompactC1(radius),
    jm.CompactC2a(radius),
    jm.CompactC2b(radius),
):
    every = jm.RBF(basis, jm.AllPoints(), jm.FarthestPoints(12), degree=1)
    left = missed(every)
    print(f"{type(basis).__name__:20}{left:8.1e}")
    assert left < 1e-9

for name, reduction in {
    "corners of boxes": jm.KDTree(4, jm.Corners()),
    "Gauss points": jm.KDTree(4, jm.GaussPoints()),
    "middles": jm.KDTree(8, jm.Centre(), extremes=True),
    "spread": jm.FarthestPoints(12),
    "greedy": jm.Greedy(12, u[None]),
}.items():
    left = missed(jm.RBF(reduction=reduction, fixed_reduction=jm.Graded()))
    print(f"{name:20}{left:8.1e}")
    assert left < 0.05

for solver in (jm.Direct(), jm.Iterative(1e-10)):
    left = missed(jm.RBF(reduction=jm.AllPoints(), fixed_reduction=jm.Graded(), solver=solver))
    print(f"{type(solver).__name__:20}{left:8.1e}")
    assert left < 1e-8
