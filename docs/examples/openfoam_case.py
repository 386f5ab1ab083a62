"""A decomposed OpenFOAM case moved part by part, and plans for the motion solver. Needs OpenFOAM's environment.

`python openfoam_case.py` copies the tutorial's airFoil2D into the working folder.
"""

import os
import pathlib
import shutil
import subprocess

import jax
import numpy as np

import jaxmorph as jm
from jaxmorph import io

jax.config.update("jax_enable_x64", True)
tutorial = pathlib.Path(os.environ["FOAM_TUTORIALS"]) / "incompressible/simpleFoam/airFoil2D"
shutil.copytree(tutorial, "airFoil2D")
dictionary = (
    "FoamFile { version 2.0; format ascii; class dictionary; object decomposeParDict; }\n"
    "numberOfSubdomains 2; method simple; simpleCoeffs { n (2 1 1); delta 0.001; }\n"
)
pathlib.Path("airFoil2D/system/decomposeParDict").write_text(dictionary)
subprocess.run(["decomposePar", "-case", "airFoil2D"], check=True, stdout=subprocess.DEVNULL)

whole = io.read("airFoil2D")
print(io.patch_roles(whole))  # by pointDisplacement, which this case does not have
plan = jm.prepare(whole, "walls", ("inlet", "outlet"))
print([path.parent.parent.name for path in io.export_case("airFoil2D", whole, plan)])

case = io.Decomposed("airFoil2D")
surface = case.surface()  # all boundary faces and patches, no other nodes
half = jm.prepare_surface(
    jm.Boundary(surface, "walls", ("inlet", "outlet")),
    nodes=io.global_nodes(surface),
    faces=surface.cells,
)
u = np.tile([0.01, 0.02], (half.plan.n_moving, 1))
with case.writing("moved") as writer:
    for k in range(len(case)):
        part = case.read(k)
        piece = half.attach(part.points, io.global_nodes(part))
        points = jm.deform(piece, u)
        print(f"processor{k}: {len(points)} points")
        writer.add(k, part.moved(points))
