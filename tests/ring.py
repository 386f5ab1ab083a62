"""A small 2-D mesh for the command line."""

import pathlib

import numpy as np

import jaxmorph as jm
from jaxmorph import io


def write_ring(file: pathlib.Path) -> jm.Mesh:
    """A ring of quads between a wall of 24 nodes and a far field; ids of the wall are 0 to 23."""
    angle, radius = np.meshgrid(2 * np.pi * np.arange(24) / 24, np.geomspace(1, 5, 9))
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1).reshape(-1, 2)
    ids = np.arange(len(points)).reshape(9, 24)
    after = np.roll(ids, -1, axis=1)
    quads = np.stack([ids[:-1], ids[1:], after[1:], after[:-1]], axis=-1).reshape(-1, 4)
    mesh = jm.Mesh(points, {"quad": quads}, {"wall": ids[0], "far": ids[-1]})
    io.write(file, mesh)
    return mesh
