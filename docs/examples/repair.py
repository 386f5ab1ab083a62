"""What to do about a motion that folds cells: look, ask for cures, take steps, unfold, raise the order, curve."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxmorph as jm
from jaxmorph import cases, shapes

jax.config.update("jax_enable_x64", True)
mesh = cases.naca0015(points=400)
boundary = jm.Boundary(mesh, "airfoil", "farfield")
plan = jm.prepare(boundary)
wall = plan.moving_points
u = np.asarray(shapes.rotate(wall, np.deg2rad(120), about=(0.25, 0)) - wall)

inspection: jm.Inspection = jm.inspect(plan, u, mesh=mesh)
print(*inspection.warnings, sep="\n")
cure: jm.Cure = next(jm.cures(boundary, u))
print(cure)

turn: jm.Turn = jm.Turn.of(wall, jnp.asarray(u))  # the path turns as the displacement does
plans, points = jm.march(plan, turn.path(4))
assert np.abs(jm.replay(plans, turn.path(4)) - points).max() < 1e-12
print("four steps:", int(jm.quality(mesh, points).inverted), "inverted")

steps: jm.Steps = jm.fewest_steps(plan, mesh, u)
print(f"{steps.count} steps for {steps.fraction:.0%}")

mended: jm.Improvement = jm.improve(mesh, jm.deform(plan, u))
print(mended)

largest: jm.LargestStep = jm.largest_step(plan, jnp.zeros(u.shape), jnp.asarray(u), mesh)
print(f"one step is valid up to {float(largest.step):.2f} of the motion")

compared: jm.Comparison = jm.compare(boundary, 0.1 * u[None], {"graph": jm.DelaunayGraph()})
print(compared)

straight = jm.elevate(mesh, 2)
curved = jm.curve(straight, lambda x: x + [0, 0.001] * np.sin(9 * x[:, :1]), "airfoil", "farfield")
print({kind: len(ids) for kind, ids in curved.cells.items()})
