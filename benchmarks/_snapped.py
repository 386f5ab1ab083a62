"""A snapped mesh of OpenFOAM's for championship.py: a sphere in a box, polyhedra where cells of two sizes meet."""

import pathlib
import shutil
import sys
import tempfile

sys.path.insert(0, str(pathlib.Path(__file__).parents[1] / "tests"))

import foam

import jaxmorph as jm
from jaxmorph import io

PROGRAMS = ("blockMesh", "snappyHexMesh")

CONTROL = """application snappyHexMesh; startFrom startTime; startTime 0; stopAt endTime; endTime 1; deltaT 1;
writeControl timeStep; writeInterval 1; writeFormat ascii; writePrecision 17;"""

BOX = """
vertices ((-2 -2 -2) (2 -2 -2) (2 2 -2) (-2 2 -2) (-2 -2 2) (2 -2 2) (2 2 2) (-2 2 2));
blocks (hex (0 1 2 3 4 5 6 7) (10 10 10) simpleGrading (1 1 1));
boundary (box { type patch; faces ((0 3 2 1) (4 5 6 7) (0 1 5 4) (1 2 6 5) (2 3 7 6) (3 0 4 7)); });"""

SNAPPY = """
castellatedMesh true; snap true; addLayers false; mergeTolerance 1e-6;
geometry { body { type searchableSphere; centre (0 0 0); radius 0.7; } }
castellatedMeshControls
{
    maxLocalCells 100000; maxGlobalCells 100000; minRefinementCells 0; nCellsBetweenLevels 2; features ();
    refinementSurfaces { body { level (1 1); } }
    resolveFeatureAngle 30; refinementRegions {} locationInMesh (1.53 1.51 1.57); allowFreeStandingZoneFaces true;
}
snapControls { nSmoothPatch 3; tolerance 2; nSolveIter 30; nRelaxIter 5; }
addLayersControls
{
    relativeSizes true; layers {} expansionRatio 1; finalLayerThickness 0.3; minThickness 0.1; nGrow 0; featureAngle 60;
    nRelaxIter 3; nSmoothSurfaceNormals 1; nSmoothNormals 3; nSmoothThickness 10; maxFaceThicknessRatio 0.5;
    maxThicknessToMedialRatio 0.3; minMedianAxisAngle 90; nBufferCellsNoExtrude 0; nLayerIter 50;
}
meshQualityControls
{
    maxNonOrtho 65; maxBoundarySkewness 20; maxInternalSkewness 4; maxConcave 80; minVol 1e-13; minTetQuality 1e-15;
    minArea -1; minTwist 0.02; minDeterminant 0.001; minFaceWeight 0.05; minVolRatio 0.01; minTriangleTwist -1;
    nSmoothScale 4; errorReduction 0.75;
}"""

FILES = {
    "controlDict": CONTROL,
    "blockMeshDict": BOX,
    "snappyHexMeshDict": SNAPPY,
    "fvSolution": "",
}


def is_there() -> bool:
    return all(map(shutil.which, PROGRAMS))


def sphere() -> jm.Mesh:
    """Makes the mesh, of 2,064 points, with the patches `body` and `box`."""
    with tempfile.TemporaryDirectory() as folder:
        system = pathlib.Path(folder, "system")
        system.mkdir()
        for name, text in (FILES | {"fvSchemes": foam_schemes()}).items():
            head = f"FoamFile {{ version 2.0; format ascii; class dictionary; object {name}; }}\n"
            (system / name).write_text(head + text)
        foam.run(folder, "blockMesh")
        foam.run(folder, "snappyHexMesh", "-overwrite")
        return io.read(folder)


def foam_schemes() -> str:
    """Returns schemes that are asked for, and not used."""
    names = (
        "ddtSchemes",
        "gradSchemes",
        "divSchemes",
        "laplacianSchemes",
        "interpolationSchemes",
        "snGradSchemes",
    )
    return "\n".join(f"{name} {{ }}" for name in names)
