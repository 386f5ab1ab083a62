"""Overset grids: a collar around the body and a background block follow one surface, so what overlaps stays together."""

import jax
import numpy as np

import jaxmorph as jm
from jaxmorph import cases

jax.config.update("jax_enable_x64", True)
mesh = cases.naca0015(points=400)
half = jm.prepare_surface(jm.Boundary(mesh, "airfoil", "farfield"))
wall = mesh.points[half.moving]
u = 0.05 * np.sin(np.pi * wall[:, :1]) * np.array([0.0, 1.0])

near = np.flatnonzero(np.abs(mesh.points - [0.5, 0.0]).max(axis=1) < 1)
collar = half.attach(mesh.points[near], near)
x, y = np.meshgrid(np.linspace(-2, 3, 26), np.linspace(-2, 2, 21))
grid = np.stack([x.ravel(), y.ravel()], axis=1)
background = np.append(grid, mesh.points[near[-1:]], axis=0)  # and a point of the collar
block = half.attach(background, np.full(len(background), -1))  # -1: no node of the mesh
apart = float(np.abs(jm.deform(collar, u)[-1] - jm.deform(block, u)[-1]).max())
print(f"a point in both is {apart:.0e} apart")
assert apart < 1e-13
