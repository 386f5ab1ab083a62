"""Every method of `prepare`, on one airfoil whose nose is raised: the smallest Jacobian ratio that each leaves."""

import warnings

import jax
import numpy as np

import jaxmorph as jm
from jaxmorph import cases

jax.config.update("jax_enable_x64", True)
mesh = cases.naca0015(points=400)
methods = {
    "the default": jm.SurfaceReconstruction(jm.FittedRBF(), jm.NearWall()),
    "the paper's": jm.SurfaceReconstruction.published(),
    "fitted alone": jm.FittedRBF(ell=0.05),
    "graph": jm.DelaunayGraph(),
    "multiscale": jm.NearWall(jm.Multiscale()),
    "local": jm.SurfaceReconstruction(jm.RBF(), jm.LocalCorrection()),
    "compact": jm.CompactRBF(radius=2.0),
    "inverse distance": jm.InverseDistance(rotations=True),
    "elasticity": jm.LinearElasticity(jm.ByVolume(1), poisson=0.3),
    "Laplace": jm.Laplacian(jm.ByDistance(2)),
    "biharmonic": jm.Biharmonic(),
    "springs": jm.SpringAnalogy(2),
    "torsional springs": jm.TorsionalSprings(),
}
# on cells so thin the biharmonic equation loses digits, and says so
warnings.filterwarnings("ignore", "the .* unknowns of Biharmonic are ill-conditioned")
wall = mesh.points[mesh.patch("airfoil")]
u = 0.05 * np.exp(-4 * wall[:, :1]) * np.array([0.0, 1.0])
for name, method in methods.items():
    plan: jm.Plan = jm.prepare(mesh, "airfoil", "farfield", method=method)
    ratio = float(jm.quality(mesh, jm.deform(plan, u)).min_jacobian_ratio)
    print(f"{name:20}{ratio:6.2f}")
    assert ratio > 0.1, name
