"""An airfoil as thin as its mesh allows, by twenty bumps without scaling; then the least area that keeps thickness and chord.

Without a guard the first step of SLSQP inverts cells.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import scipy.optimize

import jaxmorph as jm
from jaxmorph import cases, shapes

jax.config.update("jax_enable_x64", True)
mesh = cases.naca0015(points=1500)
method = jm.SurfaceReconstruction.published(8, 2)
plan = jm.prepare(mesh, "airfoil", "farfield", method=method)
wall = mesh.points[mesh.patch("airfoil")]
upper = shapes.upper_side(mesh, "airfoil")
loop = shapes.wall_loop(mesh, "airfoil")
ring = np.searchsorted(plan.moving, loop)  # rows of the wall, counterclockwise

bump = shapes.HicksHenne(np.linspace(0.05, 0.95, 10))
sides = [shapes.Part(bump, side) for side in (upper, ~upper)]
weights = jnp.concatenate([jax.jacfwd(side.at(wall))(jnp.zeros(10)) for side in sides], axis=2)


def motion(p):
    return weights @ p


thin = jax.jit(jax.value_and_grad(lambda p: shapes.area(wall + motion(p), ring)))
designed = jm.DesignedMesh(plan, mesh, motion, min_jacobian_ratio=0.1)
guard = shapes.MeshGuard(designed)
history = shapes.History("thin.jsonl")  # a line of JSON for each call


def flow(p):
    value, slope = thin(p)
    history.add(p, value, measures={"smallest Jacobian ratio": guard.smallest(p)})
    return float(value), np.asarray(slope)


common = {
    "jac": True,
    "method": "SLSQP",
    "bounds": [(-0.04, 0.04)] * 20,
    "options": {"maxiter": 40},
}
start = np.zeros(20)
scipy.optimize.minimize(flow, start, **common)
broken = history.column("smallest Jacobian ratio").min()
before = len(history)
kept = scipy.optimize.minimize(guard.guarded(flow), start, constraints=guard.constraint(), **common)
smallest = history.column("smallest Jacobian ratio")[before:].min()
print(f"smallest Jacobian ratio {broken:.2f} without the guard, {smallest:.2f} with it")
assert broken < 0 < 0.1 <= smallest

# A descent that leaves out what lowers the smallest corners keeps the mesh valid.
rows: shapes.QualityRows = guard.quality_rows(kept.x, 5)
slope = np.asarray(thin(kept.x)[1])
basis = np.linalg.svd(rows.matrix, full_matrices=False)[2]
change = slope - basis.T @ (basis @ slope)
assert np.abs(rows.matrix @ change).max() < 1e-9 * np.abs(rows.matrix).max()

# The same bound as a search of optimistix: a step that would invert a cell is shortened.
solver = optx.BFGS(1e-4, 1e-4)
solver = eqx.tree_at(lambda s: s.search, solver, jm.ValidSteps(designed))
found = optx.minimise(
    lambda p, _: jnp.sum((p + 0.02) ** 2), solver, jnp.zeros(20), max_steps=20, throw=False
)
assert not jm.inverted(mesh, jm.deform(plan, motion(found.value))).any()

# The least area that keeps four fifths of the thickness, the centre and the chord.
segments = np.column_stack([ring, np.roll(ring, -1)])
stations = [[x, 0.0] for x in (0.05, 0.2, 0.35, 0.5, 0.65, 0.8, 0.95)]
lines = shapes.Stations.on(wall, segments, stations, [0.0, 1.0])
first = shapes.thickness(wall, lines)
tail, nose = int(wall[:, 0].argmax()), int(wall[:, 0].argmin())


def limits(p):
    """Not negative where all holds."""
    x = wall + motion(p)
    held = [
        shapes.thickness(x, lines) - 0.8 * first,
        0.005 - jnp.abs(shapes.centroid(x, ring) - shapes.centroid(wall, ring)),
        1.001 - shapes.chord(x, nose, tail),
    ]
    return jnp.concatenate([jnp.atleast_1d(each) for each in held])


constraint = {"type": "ineq", "fun": jax.jit(limits), "jac": jax.jit(jax.jacrev(limits))}
best = scipy.optimize.minimize(thin, start, constraints=constraint, **common)
print(f"area {best.fun / float(shapes.area(wall, ring)):.2f} of the first, within all limits")
assert limits(best.x).min() > -1e-6
