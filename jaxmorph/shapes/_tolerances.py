"""Tolerances of shapes that decide what is equal, zero, or on a plane."""

# Relative difference of equal lengths of a wall, and share of its extent of one place: tails and
# noses, the border of a target, nodes on a ball. Of weights of a face's corners: inside it.
SAME_LENGTH = 1e-9
# Sine of an angle of no degrees: a normal across the chord, directions at right angles.
LEVEL = 1e-9
# Distance from a symmetry plane, over the wall's extent, of nodes that lie on it.
ON_SYMMETRY = 1e-6
# Least over largest extent of a border that lies in a plane with a point, of files of few digits.
IN_PLANE = 1e-6
# Cosine between an axis and a line that are at right angles.
RIGHT_ANGLE = 1e-3
# Volume of a box over the product of its edges, or the cube of its diagonal, that is none.
NO_VOLUME = 1e-12
# Distance from the border of a target, over the wall's extent, of closest places on the border.
ON_BORDER = 1e-5
# Determinant of a line and a face's edges, over the largest entry: the line is along the face.
ALONG_FACE = 1e-14
# Changes of a rigid motion, in radians and arms, that end its steps.
RESTED = 1e-6

_LENGTHS = (1000, 25.4, 100, 304.8, 1 / 0.0254, 10, 12)
# Factors from one unit of length to another, of millimetres, centimetres, inches, feet and metres;
# the most frequent come first.
UNIT_FACTORS = (*_LENGTHS, *(1 / ratio for ratio in _LENGTHS))
