"""Judge a moved mesh: quality by corners, faces, wall and boundary, limits, and a proof that no cell folds."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxmorph as jm
from jaxmorph import cases

jax.config.update("jax_enable_x64", True)
mesh = cases.naca0015(points=400)
plan = jm.prepare(mesh, "airfoil", "farfield")
u = 0.05 * np.sin(np.pi * plan.moving_points[:, :1]) * np.array([0.0, 1.0])
points = jm.deform(plan, u)

report: jm.QualityReport = jm.quality(mesh, points)
print(report)
print("inverted:", int(jm.inverted(mesh, points).sum()))

faces: jm.FaceQuality = jm.face_quality(mesh, points)  # as checkMesh does
print(f"non-orthogonality up to {faces.non_orthogonality.max():.0f} degrees")

wall: jm.WallQuality = jm.wall_quality(mesh, "airfoil", points)
print(f"first grid lines off by {np.abs(wall.angle).max():.1f} degrees")

kept: jm.BoundaryQuality = jm.boundary_quality(plan, points)
print(f"off planes by {kept.off_plane}, off surfaces by {kept.off_surface}")

smooth: jm.SmoothQuality = jm.smooth_quality(mesh, points)  # without kinks, for optimisers
print(f"about the largest skewness: {jm.soft_maximum(smooth.skewness, 200.0):.3f}")

verdict: jm.Verdict = jm.judge(mesh, points, limits=jm.Limits(max_skewness=0.9))
print(verdict)

proof: jm.Proof = jm.proof(mesh, points, base=mesh.points)
print(f"{proof.valid} cells proven valid at every instant of the motion")
print(f"least margin {float(jm.proven_margin(mesh, points).min()):.2f}")

print({kind: ids.shape for kind, ids in jm.boundary_faces(mesh, "airfoil").items()})
try:
    jm.prepare(mesh, [0, 0, 1], "farfield")
except jm.MeshError as error:
    print(error, "Nodes:", error.nodes)
assert jnp.isfinite(jm.distortion(mesh, points)).all()
