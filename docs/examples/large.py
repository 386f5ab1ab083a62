"""Large meshes and other places: in chunks, in pieces, over devices, in files, in a solver without Python."""

import warnings

import jax
import numpy as np

import jaxmorph as jm
from jaxmorph import cases

jax.config.update("jax_enable_x64", True)
mesh = cases.naca0015(points=400)
boundary = jm.Boundary(mesh, "airfoil", "farfield")
plan = jm.prepare(boundary)
u = 0.05 * np.sin(np.pi * plan.moving_points[:, :1]) * np.array([0.0, 1.0])
whole = np.asarray(jm.deform(plan, u))

moved = np.empty_like(whole)
for nodes, chunk in jm.prepare_in_chunks(boundary, size=150):
    moved[nodes] = jm.deform(chunk, u)
assert np.abs(moved - whole).max() < 1e-10

half: jm.SurfaceHalf = jm.prepare_surface(boundary)  # one process
few = np.arange(100)
piece = half.attach(mesh.points[few], few)  # any other
assert np.abs(jm.deform(piece, u) - whole[few]).max() < 1e-10

over = jm.shard(plan, jax.devices())
assert np.abs(jm.deform(over, u) - whole).max() < 1e-10

jm.save("airfoil.npz", plan)
assert (np.asarray(jm.deform(jm.load("airfoil.npz"), u)) == whole).all()

jm.export(plan, "airfoil.plan")  # for jmplan.h
layer = jm.Layer(points=np.arange(len(mesh.points)), axes=(0, 1))
jm.export(plan, "layer.plan", layer=layer)  # of a 3-D mesh of one layer of cells

with warnings.catch_warnings(record=True):
    left: jm.FreeFaces = jm.Boundary(mesh, "airfoil").left  # nobody named the far field
print(left)
