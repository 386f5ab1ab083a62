"""One hand-over by hand: new cells where a motion has worn the old ones, and a field on them."""

import jax
import numpy as np

import jaxmorph as jm
from jaxmorph import cases

jax.config.update("jax_enable_x64", True)
boxes = {"upper": (-2.0, -1.0, 0.5, 1.5), "lower": (-0.5, 0.5, -1.5, -0.5)}
mesh = cases.bodies(boxes, box=(-4.0, 4.0, -3.0, 3.0))
plan = jm.prepare(mesh, "upper", ("lower", "farfield"))
points = np.asarray(jm.deform(plan, np.tile([1.2, 0.0], (plan.n_moving, 1))))

made: jm.Remeshed = jm.remesh(mesh, points, target=0.4)
print(f"{made.replaced:.0%} of the cells replaced, {jm.quality(made.mesh).inverted} inverted")
field = made.transfer(points[:, 0])
assert np.abs(field - made.mesh.points[:, 0]).max() < 1e-12
assert np.isin(mesh.patch("upper"), jm.wall_layers(mesh, "upper")).all()
