"""Design variables: motions of a whole wall, sections, boxes, modes, combinations, and gradients back to their parameters."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxmorph as jm
from jaxmorph import cases, shapes

jax.config.update("jax_enable_x64", True)
mesh = cases.naca0015(points=400)
wall = mesh.points[mesh.patch("airfoil")]

# Motions are functions of positions; their angles are radians.
half_turn = shapes.rotate(wall, np.pi, about=(0.5, 0))
larger = shapes.scale(wall, 1.1, about=(0, 0))
lifted = shapes.translate(wall, (0, 0.1))

# Sections.
upper = shapes.upper_side(mesh, "airfoil")
chord: shapes.Chord = shapes.Chord((0.0, 0.0), (1.0, 0.0))
bumps = shapes.Part(shapes.HicksHenne([0.3, 0.6], chord=chord), upper)
foil = shapes.CST(3)
thicker = shapes.NACA4(0.0, 0.4, 0.15)(wall, [0.02, 0.4, 0.16])
loop = np.searchsorted(mesh.patch("airfoil"), shapes.wall_loop(mesh, "airfoil"))
curve = shapes.BSplineCurve(wall[loop], 8)
print("bumps", bumps.neutral().shape, "CST", jax.tree.map(jnp.shape, foil.neutral()))
print("curve", curve.neutral().shape, "normals", shapes.wall_normals(mesh, "airfoil").shape)

# Boxes: between planes, in any hexahedron, several at once, with fewer parameters.
box = shapes.FreeForm.around(wall, (4, 3), margin=0.1)
slanted = shapes.Hexahedron([[-0.1, -0.2], [1.1, -0.3], [1.1, 0.3], [-0.1, 0.2]], (4, 3))
both: shapes.Together = shapes.Together(box, slanted)
rising = np.zeros((4, 3, 2, 2))  # controls, components; two parameters
rising[1, :, 1, 0] = rising[2, :, 1, 1] = 1
two: shapes.AbstractLinearShape = shapes.Linked(box, rising.reshape(-1, 2))
print("box", box.neutral().shape, "linked", two.neutral().shape)

# Modes, and a shape for some rows of the wall alone.
modes = shapes.Modes(np.stack([np.sin(k * np.pi * wall[:, :1]) * [0.0, 1.0] for k in (1, 2)]))
pitch = shapes.Function(lambda x, angle: shapes.rotate(x, angle, (0.8, 0)), 0.0)
flap: shapes.AbstractShape = shapes.OnRows(pitch, np.flatnonzero(wall[:, 0] > 0.8))

# All together: parameters by name, gradients by name.
wing = shapes.Chain({"modes": modes, "flap": flap})
parameters = shapes.varied(wing.neutral(), {"flap": 0.05, "modes[0]": 0.01})
plan = jm.prepare(mesh, "airfoil", "farfield")
u = shapes.displacement(wing, plan, parameters)
print(f"moves by up to {float(jnp.abs(u).max()):.3f} chords")
dJ_dpoints = np.ones(mesh.points.shape)
whole = shapes.pullback(wing, plan, parameters, dJ_dpoints)
by_wall = shapes.project(wing, wall, parameters, jm.pullback(plan, u, dJ_dpoints))
assert jax.tree.all(jax.tree.map(lambda a, b: jnp.allclose(a, b), whole, by_wall))
print(shapes.names(whole))
found: shapes.Fit = shapes.fit(modes, wall, wall + 0.02 * modes.fields[1])
assert np.allclose(found.parameters, [0, 0.02])

# Onto another wall, which a design variable may change.
facets = jm.Facets.of(cases.naca4("0012", points=400, sharp=True), "airfoil")
target = jm.Facets.of(cases.naca4("2412", points=800, sharp=True), "airfoil")
onto: shapes.Onto = shapes.Onto(facets, target)
by_camber = jax.jacfwd(lambda s: onto(facets.points, target.points * jnp.stack([1.0, s])[None]))
print("onto", by_camber(1.0).shape)

# Wings: twist and dihedral at stations, whole twists and bends.
wing_mesh = cases.wing(points=600, stations=5)
span = wing_mesh.points[wing_mesh.patch("wing")]
axis = shapes.ReferenceAxis([[0.25, 0, 0], [0.25, 1, 0], [0.25, 2, 0]])
print(jax.tree.map(jnp.shape, axis.neutral()))
twisted = shapes.twist(span, 0.1, (0.25, 0, 0), (0, 1, 0), 2.0)
bent = shapes.bend(span, 0.2, (0, 0, 0), (0, 1, 0), 2.0, axis=(1, 0, 0))
bricks = cases.bricks()
print(f"volume {float(shapes.volume(bricks.points, jm.boundary_faces(bricks)['quad'])):.3f}")
