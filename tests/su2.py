"""A mesh file of SU2 as people write it."""

import pathlib

PLAIN = """NDIME= 2
NELEM= 3
9 0 1 4 3 0
5 1 2 4 1
5 2 5 4 2
NPOIN= 6
0.0 0.0 0
1.5 0.25 1
2e0 0.0 2
0.0 1.0000000000000002 3
1.0 1.0 4
2.00 1.0E+00 5
NMARK= 2
MARKER_TAG= lower
MARKER_ELEMS= 2
3 0 1
3 1 2
MARKER_TAG= upper
MARKER_ELEMS= 2
3 3 4 0
3 4 5 1
"""

BOX = """FFD_NBOX= 1
FFD_NLEVEL= 1
FFD_TAG= MAIN_BOX
FFD_LEVEL= 0
FFD_DEGREE_I= 2
FFD_DEGREE_J= 1
FFD_BLENDING= BEZIER
FFD_PARENTS= 0
FFD_CHILDREN= 0
FFD_CORNER_POINTS= 4
-0.5	-0.5
2.5	-0.5
2.5	1.5
-0.5	1.25
FFD_CONTROL_POINTS= 12
{control}
FFD_SURFACE_POINTS= 3
lower	0	1.6e-01	2.5e-01	5.0e-01
lower	1	6.6e-01	4.0e-01	5.0e-01
upper	4	5.0e-01	7.0e-01	5.0e-01
"""
ROWS = [
    (i, j, k, 0.1 * i + 0.01 * j, i - j, k - 0.5)
    for i in range(3)
    for j in range(2)
    for k in range(2)
]
CONTROL = "\n".join("\t".join(map(str, row)) for row in ROWS)


def written(path: pathlib.Path, text: str) -> pathlib.Path:
    """Writes a text as it is, whatever ends its lines."""
    path.write_bytes(text.encode())
    return path
