"""Files: what is lost in another format, displacements, sensitivities, boxes, zones, series, and OpenFOAM's cases."""

import pathlib

import jax
import numpy as np

import jaxmorph as jm
from jaxmorph import cases, io, shapes

jax.config.update("jax_enable_x64", True)
mesh = cases.naca0015(points=400)
io.write("airfoil.su2", mesh)
mesh = io.read("airfoil.su2")
plan = jm.prepare(mesh, "airfoil", "farfield")
print("periodic:", io.periodic(mesh), "symmetry:", io.symmetry(mesh))

# A displacement from a table of id, x, y; the table alone; a curve in a file.
wall = plan.moving_points
rows = [
    f"{node}, {x:.17g}, {1.05 * y:.17g}" for node, (x, y) in zip(plan.moving, wall, strict=True)
]
pathlib.Path("wall.csv").write_text("id, x, y\n" + "\n".join(rows) + "\n")
u = io.read_displacement("wall.csv", mesh, plan.moving)
ids, places = io.read_surface("wall.csv", 2)
assert np.allclose(places, wall + u)
facets: jm.Facets = jm.Facets.of(mesh, "airfoil")
np.savez("curve.npz", points=facets.points, lines=facets.faces)
print("facets:", io.read_facets("curve.npz", 2).faces.shape)

# Write, with a check before any work, and what the file will hold.
points = np.asarray(jm.deform(plan, u))
moved = mesh.moved(points)
io.check_output("moved.su2", mesh)
print("lost in gmsh's format:", *io.losses("moved.msh", mesh))
assert (io.as_written("moved.su2", moved) == points).all()
io.write("moved.su2", moved)
io.write_moved("moved.vtu", mesh, moved, jm.quality(mesh, points))  # with displacement and quality
io.write("first.vtu", mesh)
io.write_pvd("motion.pvd", ["first.vtu", "moved.vtu"], [0.0, 1.0])

# Sensitivities, by node, and gradients by name.
io.write_sensitivity("volume.csv", np.arange(len(points)), np.ones(points.shape))
dJ_dpoints = io.read_sensitivity("volume.csv", mesh)
io.write_sensitivity("wall_sens.csv", plan.moving, jm.pullback(plan, u, dJ_dpoints))
io.write_gradient("gradient.csv", {"pitch": 0.1}, {"pitch": 2.0})

# Free-form boxes: of a job file, in SU2's files, for ParaView.
raised = [{"at": [1, 1], "by": [0, 0.01]}]
table = {"low": [-0.1, -0.2], "high": [1.1, 0.2], "points": [3, 2], "moved": raised}
box, control = io.read_box(table, 2)
io.write_lattice("box.vts", box.lattice(control))
corners = [[-0.1, -0.2], [1.1, -0.2], [1.1, 0.2], [-0.1, 0.2]]
hexahedron = shapes.Hexahedron(corners, (3, 2))
named = io.Box("WING", hexahedron, hexahedron.lattice(hexahedron.neutral()))
io.write("with_box.su2", io.with_boxes(mesh, [named]))
print("boxes:", [each.name for each in io.boxes(io.read("with_box.su2"))])

# Zones of SU2.
text = pathlib.Path("airfoil.su2").read_text()
pathlib.Path("zones.su2").write_text("NZONE= 2\nIZONE= 1\n" + text + "IZONE= 2\n" + text)
first, second = io.read_zones("zones.su2")
io.write_zones("moved_zones.su2", (first.moved(points), second))
