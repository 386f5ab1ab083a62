"""Pictures: a mesh before and after, its histogram, its sources, a cut and a whole of a mesh in 3-D, an optimisation."""

import jax
import matplotlib as mpl
import numpy as np

import jaxmorph as jm
from jaxmorph import cases, plot, shapes

mpl.use("agg")
jax.config.update("jax_enable_x64", True)
mesh = cases.naca0015(points=400)
plan = jm.prepare(mesh, "airfoil", "farfield")
u = 0.05 * np.sin(np.pi * plan.moving_points[:, :1]) * np.array([0.0, 1.0])
points = jm.deform(plan, u)
report = jm.quality(mesh, points)
window = ((-0.5, 1.5), (-0.6, 0.6))
plot.mesh(mesh, points, values=report.skewness, label="skewness", window=window).figure.savefig(
    "mesh.png"
)
plot.before_after(mesh, points, window=window).figure.savefig("before_after.png")
plot.histogram({"before": jm.quality(mesh), "after": report}).figure.savefig("histogram.png")
plot.sources(plan, window=plot.whole(plan.moving_points)).figure.savefig("sources.png")
plot.graph(plan, u).figure.savefig("graph.png")
plot.picture("picture.png", mesh, np.asarray(points))
wall = jm.Facets.of(mesh, "airfoil")
target = wall.at(1.02 * np.asarray(wall.points))
plot.distances("distances.png", wall, target, shapes.onto(wall, target))

history = shapes.History("run.jsonl")
for step in range(3):
    history.add(np.full(2, 0.1 * step), 1.0 / (1 + step), measures={"lift": 0.5 + 0.01 * step})
plot.convergence(history, bounds={"lift": (0.5, np.inf)}).figure.savefig("convergence.png")

wing = cases.wing(points=600, stations=5)
plane = jm.Plane((0, 1, 0), (0, 1, 0))
plot.surface(wing, patch="wing").screenshot("wing.png")
plot.cut(wing, plane=plane).screenshot("cut.png")
raised = wing.points + 0.1 * wing.points[:, 1:2] ** 2 * np.array([0, 0, 1])
plot.before_after_3d(wing, raised, patch="wing").screenshot("bent.png")
