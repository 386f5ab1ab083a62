"""The text of an SU2 file for a mesh that did not come from one."""

from collections.abc import Iterator

import numpy as np

from jaxmorph import Mesh
from jaxmorph._host.topology import VTK

from ._boundary import patch_faces

ROWS = 1 << 16
"""Rows formatted together."""


def new_text(mesh: Mesh) -> Iterator[bytes]:
    """The file in pieces. Patches become markers, with the boundary faces between their nodes as elements.

    `ValueError` for a patch that boundary faces cannot express, or whose name does not fit on the line of a tag.
    """
    points = np.asarray(mesh.points)
    n, d = points.shape
    for name in mesh.patches:
        if name != name.strip() or not name or any(mark in name for mark in "%=\r\n"):
            raise ValueError(f"{name!r} cannot be the tag of an SU2 marker: blank ends, '%', '=' or a line break.")
    markers = patch_faces(mesh)
    yield f"NDIME= {d}\nNELEM= {sum(len(corners) for corners in mesh.cells.values())}\n".encode()
    for kind, corners in mesh.cells.items():
        yield from _elements(kind, np.asarray(corners))
    yield f"NPOIN= {n}\n".encode()
    row = " ".join(["%r"] * d) + "\n"
    for start in range(0, n, ROWS):
        block = points[start : start + ROWS]
        yield ((row * len(block)) % tuple(block.ravel().tolist())).encode()
    yield f"NMARK= {len(markers)}\n".encode()
    for name, faces in markers.items():
        yield f"MARKER_TAG= {name}\nMARKER_ELEMS= {sum(map(len, faces.values()))}\n".encode()
        for kind, corners in faces.items():
            yield from _elements(kind, corners)


def _elements(kind: str, corners: np.ndarray) -> Iterator[bytes]:
    row = f"{VTK[kind]} " + " ".join(["%d"] * corners.shape[1]) + "\n"
    for start in range(0, len(corners), ROWS):
        block = corners[start : start + ROWS]
        yield ((row * len(block)) % tuple(block.ravel().tolist())).encode()
