"""Tolerances that decide what is equal, zero, on a surface, at an edge: one name a question.

Lengths are shares of the extent of the points unless something else is said. Where coordinates are
of single precision their round-off is larger, and counts instead (`roundoff`, `resolution`).
"""

import numpy as np

# --- Numbers and places

# Relative difference up to which numbers are equal, and share of an extent up to which two places
# are one: lengths and areas of a regular mesh, components of a shift. Equal ones go by place.
SAME = 1e-9
# What zero becomes where XLA's programs flush smaller numbers to zero; its square is zero.
NEAR_ZERO = 1e-290
# Divisor in the place of zero, of ratios whose numerator is then zero too.
LEAST_DIVISOR = 1e-300
# Weight over the largest one up to which a node of a polynomial has no share in it.
NO_WEIGHT = 1e-12

# --- Planes, surfaces and repeats

# Distance from a plane within which a node lies on it: a symmetry plane, a side of the hull.
ON_PLANE = 1e-8
# Distance from a boundary face's plane of nodes that may lie on one plane with it.
NEAR_PLANE = 1e-3
# Distance from a plane up to which a surface that crosses itself on it is held there.
PLANAR = 1e-6
# Distance of a patch's nodes from the surface they slide on, of new base points from their plane:
# files have few digits.
DEVIATION = 1e-5
# Component of a unit normal that is zero: the plane is at right angles to an axis. Also the radius
# that is none, over a patch's extent: the apex of a cone.
ALONG_AXIS = 1e-7
# Difference of two cosines that is none, and sine of the angle between parallel directions.
ALIGNED = 1e-9
# Difference from one of the cosine between the normals of one plane.
SAME_NORMAL = 1e-12
# Difference of equal matrices and shifts of repeats, of angles of mirrors in radians, and of a
# number of sectors, relative, from a whole one.
SAME_TRANSFORM = 1e-6
# Difference of the matrices of two images in mirrors, which may be a degree from each other.
OTHER_IMAGE = 1e-3
# Sine of half the angle of a rotation that is none.
NO_TURN = 1e-12
# Distance of a node from its partner's image, over the spacing of nodes: they are a pair.
MISMATCH = 1e-4
# Distance along an axis of two nodes that give a profile one place.
SAME_STATION = 1e-6
# Change of radius, or of place along the axis, over the radius, of a patch that is round.
ROUND_PATCH = 1e-3

# --- Faces of a wall

# Distance beyond faces in a plane, and share of a corner in a place on faces: at their end.
END = 1e-9
# Square of a distance from a vertex, over that of its longest edge: at the vertex.
AT_VERTEX = 1e-20
# Length of a sum of unit normals, over their number, that is no direction: a thin plate's.
CANCELLED = 1e-3
# Area of a triangle over the largest one: a quad ends in a point there.
NO_AREA = 1e-14
# Cosine of the angle below which two sliding patches meet without an edge.
NO_EDGE = np.cos(np.deg2rad(5))
# Least cosine of a hole's faces to those around it, of faces of one wall: a dome's rim is no hole.
CONTINUES = 0.5
# Angle, in radians, of two faces of a CAD model that meet smoothly.
SMOOTH_SEAM = np.deg2rad(1)
# Cosine of a concave corner's angle from which on its faces are two walls.
CONCAVE = np.cos(np.deg2rad(45))
# Cosine of the angle between a tip's edges below which the wall is sharp there.
SHARP_TIP = np.cos(np.deg2rad(60))
# How far faces may be apart, over their size, where they meet after a motion.
MEETS = 1e-9
# The same before the motion: faces that nearly touched do not cross anew. Also the height of a
# node over a face, over its size, that is on neither side.
MET_BEFORE = 1e-6
# Share of the largest displacement below which a part of the surface rests.
RESTS = 1e-3
# Share of the largest motion up to which planes, surfaces and pairs leave a node as it is.
PUT_BACK = 0.01

# --- Cells

# Jacobian over the product of a corner's edges up to which it is flat; in 2-D the sine.
FLAT_CORNER = 1e-4
# Volume of a polyhedron's piece over the mean one below which its sign says nothing.
LEAST_PIECE = 1e-3
# Difference of two margins of proofs that is round-off.
SAME_MARGIN = 1e-6
# Share of a pyramid's height by which places stay off its apex, where det J has directions.
OFF_APEX = 1e-6
# Motion of a graph's nodes, over the distance of the nearest one, by a fixed function of place: of
# several triangulations it decides. At 1e-9 location is slow, at 1e-7 weights go wrong.
JITTER = 1e-8
# Rounding of coordinates for the triangulation, relative as the `JITTER`, and well below it.
SNAP = 2e-9
# A point whose smallest weight in a simplex is below minus this is searched again.
OUTSIDE_WEIGHT = 1e-6

# --- Solutions

# Residual over the right side, and error over the solution, that end conjugate gradients.
ACCURACY = 1e-9
# Residual over the right side that is enough for a step of Newton's method.
ROUGH = 1e-2
# The same where a derivative is solved for.
SOLVED_EXACTLY = 1e-10
# Residual over the right side above which a system counts as singular.
SOLVED = 1e-6
# Least eigenvalue of a node's block, of order one, that its inverse takes.
LEAST_CURVATURE = 1e-8
# Added to a Hessian's diagonal (order one): it may be singular where cells are inverted.
SHIFT = 1e-12
