"""A small mesh in a file of each format."""

import pathlib

import cgns
import exodus
import foam
import h5py
import meshio
import mfem_meshes
import numpy as np
from foam import PATCHES, mixed
from meshes import bricks
from plot3d import write as write_plot3d

from jaxmorph import io
from jaxmorph.io._registry import FORMATS

ENDINGS = [".vtk", *((form.suffixes or ("",))[0] for form in FORMATS)]


SINGLE = ["", ".cgns", ".med", ".e", ".xyz", ".vtu", ".vtk"]
"""Endings of formats that have files in single precision."""


def written(folder: pathlib.Path, ending: str, *, is_single: bool = False) -> pathlib.Path:
    """Writes a small mesh with a patch `floor` in the format of an ending."""
    path, mesh = folder / f"in{ending}", bricks(2)
    if ending == "":
        foam.write_case(path, *mixed(), PATCHES, foam.FORMS["binary-32-scalars" if is_single else "ascii"])
    elif ending == ".cgns":
        corners = np.asarray(mesh.cells["hexahedron"]) + 1
        with h5py.File(path, "w") as file:
            base = cgns.base(file, 3, 3)
            zone = cgns.zone(base, "box", tuple(np.asarray(mesh.points).T), len(corners), "<f4" if is_single else "<f8")
            cgns.elements(zone, "cells", 17, corners, 1, len(corners))
    elif ending == ".med":
        corners = np.asarray(mesh.cells["hexahedron"])[:, [0, 3, 2, 1, 4, 7, 6, 5]]  # MED's order
        tags = np.isin(np.arange(len(mesh.points)), mesh.patch("floor")).astype(int)
        tagged = meshio.Mesh(mesh.points, [("hexahedron", corners)], point_data={"point_tags": tags})
        tagged.point_tags = {1: ["floor"]}
        meshio.med.write(path, tagged)
        if is_single:
            with h5py.File(path, "r+") as file:
                (step,) = file["ENS_MAA"]["mesh"].values()
                values, attributes = step["NOE"]["COO"][()], dict(step["NOE"]["COO"].attrs)
                del step["NOE"]["COO"]
                step["NOE"].create_dataset("COO", data=values.astype("f4")).attrs.update(attributes)
    elif ending == ".e":
        corners = np.asarray(mesh.cells["hexahedron"])
        blocks, sets = [("box", "hexahedron", corners)], [("floor", mesh.patch("floor"))]
        exodus.write(path, np.asarray(mesh.points), blocks, node_sets=sets, real="f4" if is_single else "f8")
    elif ending == ".mesh":
        path.write_text(mfem_meshes.straight(mesh, "floor"))
    elif ending == ".xyz":
        grid = np.stack(np.meshgrid(*(np.linspace(0, 1, 3),) * 3, indexing="ij"))
        write_plot3d(path, [grid], "records" if is_single else "text", width=4 if is_single else 8)
    elif is_single:
        cells = [("hexahedron", np.asarray(mesh.cells["hexahedron"]))]
        meshio.write(path, meshio.Mesh(np.asarray(mesh.points, np.float32), cells))
    else:
        io.write(path, mesh)
    return path
