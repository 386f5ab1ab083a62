"""Hands a mesh over to a remesher before cells invert: a body passes another by six of its lengths.

Needs `pip install mmgpy` (0.17 here), which takes points and triangles. Prints:

    Mesh(2127 points in 2-D; 4032 triangle; patches: upper (16), lower (16), farfield (192))
    40% of the way; the smallest Jacobian ratio is 0.20
    remeshed: Mesh(702 points in 2-D; 1182 triangle; patches: upper (16), lower (16), farfield (192))
    80% of the way; the smallest Jacobian ratio is 0.20
    remeshed: Mesh(672 points in 2-D; 1122 triangle; patches: upper (16), lower (16), farfield (192))
    100% of the way; the smallest Jacobian ratio is 0.76
"""

import jax
import mmgpy
import numpy as np
from scipy.spatial import KDTree

import jaxmorph as jm
from jaxmorph import cases

jax.config.update("jax_enable_x64", True)


def remeshed(mesh, points, **options):
    """Makes new triangles on moved points. Nodes and edges of the boundary stay."""
    triangles = np.asarray(mesh.cells["triangle"])
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, count = np.unique(sides, axis=0, return_counts=True)
    edges = edges[count == 1]  # of one triangle: the boundary
    new = mmgpy.MmgMesh2D()
    new.set_mesh_size(len(points), len(triangles), 0, len(edges))
    new.set_vertices(np.asarray(points, dtype=np.float64))
    new.set_triangles(triangles.astype(np.int32))
    new.set_edges(edges.astype(np.int32))
    new.set_required_edges(np.arange(len(edges), dtype=np.int32))
    new.set_required_vertices(np.unique(edges).astype(np.int32))
    new.remesh(verbose=-1, **options)
    tree, patches = KDTree(new.get_vertices()), {}
    for name in mesh.patches:
        apart, patches[name] = tree.query(np.asarray(points)[mesh.patch(name)])
        assert apart.max() == 0, f"nodes of {name} have moved"
    return jm.Mesh(new.get_vertices(), {"triangle": new.get_triangles()}, patches)


mesh = cases.bodies({"upper": (-4.0, -3.0, 0.5, 1.5), "lower": (-0.5, 0.5, -1.5, -0.5)})
quads = np.asarray(mesh.cells["quad"])
mesh = jm.Mesh(
    mesh.points, {"triangle": quads[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)}, mesh.patches
)
print(mesh)
done = 0.0
while done < 1:
    plan = jm.prepare(mesh, "upper", ("lower", "farfield"))
    way = (1 - done) * np.array([6.0, 0.0])

    def motion(share, plan=plan, way=way):
        return np.broadcast_to(share * way, (plan.n_moving, 2))

    steps = jm.fewest_steps(plan, mesh, motion, max_steps=4, min_jacobian_ratio=0.2)
    done += steps.fraction * (1 - done)
    print(
        f"{done:.0%} of the way; the smallest Jacobian ratio is {steps.report.min_jacobian_ratio:.2f}"
    )
    if steps.fraction < 1:
        mesh = remeshed(mesh, steps.points, hgrad=1.3, hmax=0.6)
        print("remeshed:", mesh)
