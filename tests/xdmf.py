"""Small XDMF files as FEniCS, dolfinx and meshio write them: a mesh, and numbers of its facets."""

import h5py
import numpy as np
from meshes import bricks

from jaxmorph._host.cells.topology import FACES

MESH = bricks(2)
POINTS = np.asarray(MESH.points) / 3
CELLS = np.asarray(MESH.cells["hexahedron"])
FACETS = CELLS[:, [list(face) for face in FACES["hexahedron"]]].reshape(-1, 4)
TAGS = np.full(len(FACETS), 2**64 - 1, np.uint64)
for number, axis in ((3, 0), (7, 2)):
    TAGS[(POINTS[FACETS, axis] == 0).all(axis=1)] = number
"""Facets at z = 0 and at x = 0; FEniCS gives others the largest number."""
NAMES = {f"tags_{number}": np.unique(FACETS[number == TAGS]) for number in (3, 7)}


class Writer:
    """Makes the XML of arrays, in it or in an HDF5 file beside it, in single or double precision."""

    def __init__(self, folder, form, real="f8"):
        self.folder, self.form, self.real = folder, form, real

    def item(self, values, name):
        values = np.asarray(values)
        kind = {"f": "Float", "u": "UInt"}.get(values.dtype.kind, "Int")
        values = values.astype(self.real) if kind == "Float" else values
        text = " ".join(map(str, values.ravel().tolist()))
        if self.form == "HDF":
            with h5py.File(self.folder / "a.h5", "a") as file:
                file.require_dataset(name, values.shape, values.dtype, data=values)
            text = f"a.h5:/{name}"
        size = " ".join(map(str, values.shape))
        width = values.itemsize
        return (
            f'<DataItem Dimensions="{size}" NumberType="{kind}" Precision="{width}" '
            f'Format="{self.form}">{text}</DataItem>'
        )

    def grid(self, name, kind, cells, geometry="", numbers=None):
        topology = f'<Topology TopologyType="{kind}" NumberOfElements="{len(cells)}">'
        body = f"{topology}{self.item(cells, f'{name}/topology')}</Topology>{geometry}"
        if numbers is not None:
            array = self.item(numbers[:, None], f"{name}/values")
            body += f'<Attribute Name="{name}" Center="Cell">{array}</Attribute>'
        return f'<Grid Name="{name}" GridType="Uniform">{body}</Grid>'

    def geometry(self, points, name):
        return f'<Geometry GeometryType="XYZ">{self.item(points, name)}</Geometry>'

    def file(self, name, *grids):
        body = "".join(grids)
        (self.folder / name).write_text(
            f'<?xml version="1.0"?><!-- <DataItem>1</DataItem> --><Xdmf><Domain>{body}</Domain></Xdmf>'
        )
        return self.folder / name

    def mesh(self, **settings):
        return self.grid("mesh", "hexahedron", CELLS, self.geometry(POINTS, "mesh/x"), **settings)


def in_own_grid(writer):
    return writer.file(
        "a.xdmf", writer.mesh(), writer.grid("tags", "Quadrilateral", FACETS, numbers=TAGS)
    ), None


def in_mixed_cells(writer):
    """Facets between the first cell and the others, in one grid."""
    facets = FACETS[TAGS < 9]
    rows = [[9, *cell] for cell in CELLS.tolist()]
    rows[1:1] = [[5, *facet] for facet in facets.tolist()]
    numbers = np.full(len(rows), 1)
    numbers[1 : 1 + len(facets)] = TAGS[TAGS < 9]
    geometry = writer.geometry(POINTS, "mesh/x")
    text = writer.grid("patch", "Mixed", np.concatenate(rows), geometry, numbers)
    return writer.file("a.xdmf", text), None


def in_second_file(writer, order=None):
    order = np.arange(len(POINTS)) if order is None else order
    geometry = writer.geometry(POINTS[order], "tags/x")
    facets = np.argsort(order)[FACETS]
    tags = writer.file("b.xdmf", writer.grid("tags", "quadrilateral", facets, geometry, TAGS))
    return writer.file("a.xdmf", writer.mesh()), tags


def in_renumbered_file(writer):
    return in_second_file(writer, np.random.default_rng(0).permutation(len(POINTS)))
