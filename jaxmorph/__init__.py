"""Differentiable mesh morphing in JAX: reduced radial basis functions with exact surfaces.

"The paper" in docstrings is *Mesh deformation with exact surface reconstruction using a reduced
radial basis function approach*; the copy that we worked from names no authors. The documentation's
page on theory prints the equations that docstrings cite. The paper builds on

- radial basis functions for moving meshes: de Boer, van der Schoot and Bijl, Computers and
  Structures 85, 2007;
- their reduction to few sources: Rendall and Allen, Journal of Computational Physics 228, 2009;
- Delaunay graph mapping: Liu, Qin and Xia, Journal of Computational Physics 211, 2006.

The first use of a public name imports its module, and JAX with it: the command line shows its help
without. Submodules are imported when they are first used.
"""

import importlib
import typing

if typing.TYPE_CHECKING:
    from . import cases as cases
    from . import cli as cli
    from . import integrations as integrations
    from . import io as io
    from . import plot as plot
    from . import shapes as shapes
    from ._public import *  # noqa: F403

__version__: str

_SUBMODULES = ("cases", "cli", "integrations", "io", "plot", "shapes")
_NAMES = {
    "._advice.compare": "Comparison compare",
    "._advice.fewest_steps": "Steps fewest_steps",
    "._advice.inspect": "inspect",
    "._advice.inspection": "Inspection",
    "._advice.largest_step": "LargestStep largest_step",
    "._advice.valid_steps": "ValidSteps",
    "._boundary.boundary": "Boundary",
    "._boundary.outer_faces": "FreeFaces boundary_faces",
    "._boundary.periodic": "Periodic",
    "._boundary.slide": "Revolution Slide",
    "._boundary.symmetry": "Plane",
    "._host.package.errors": "MeshError",
    "._host.sources.farthest": "FarthestPoints Graded",
    "._host.sources.greedy": "Greedy",
    "._host.sources.reduction": "AbstractReduction AbstractSearchPoints AllPoints Centre Corners GaussPoints KDTree",
    "._improve.curve": "curve",
    "._improve.improve": "Improvement improve",
    "._mesh.mesh": "Mesh elevate",
    "._methods.base": "AbstractField AbstractMethod AbstractPlacing Control",
    "._methods.cells.cells": "AbstractCellMethod",
    "._methods.cells.equations": "AbstractStiffness Biharmonic ByDistance ByVolume Laplacian LinearElasticity "
    "SpringAnalogy TorsionalSprings",
    "._methods.delaunay": "DelaunayGraph",
    "._methods.inverse_distance": "InverseDistance",
    "._methods.local": "LocalCorrection",
    "._methods.multiscale": "Multiscale",
    "._methods.nearwall": "NearWall",
    "._methods.rbf.basis": "AbstractBasis CompactC0 CompactC1 CompactC2a CompactC2b CubicSpline Gaussian"
    " InverseMultiquadric InverseQuadratic LinearSpline Multiquadric ThinPlateSpline WendlandC0 WendlandC2 WendlandC4"
    " WendlandC6",
    "._methods.rbf.compact": "CompactRBF",
    "._methods.rbf.fitted": "FittedRBF",
    "._methods.rbf.rbf": "Direct Iterative RBF",
    "._methods.reconstruction": "SurfaceReconstruction",
    "._methods.surface": "Surface",
    "._plan.deform": "deform pullback velocity",
    "._plan.halves": "SurfaceHalf prepare_in_chunks prepare_surface",
    "._plan.judge": "BoundaryQuality boundary_quality",
    "._plan.plan": "Plan",
    "._plan.prepare": "prepare",
    "._plan.refit": "refit",
    "._plan.save": "load save",
    "._plan.shard": "shard",
    "._plan.steps": "march replay",
    "._quality.distortion": "distortion",
    "._quality.face_quality": "FaceQuality face_quality",
    "._quality.proof.proof": "Proof proof proven_margin",
    "._quality.quality": "inverted quality",
    "._quality.report": "QualityReport",
    "._quality.smooth_quality": "SmoothQuality smooth_quality soft_maximum",
    "._quality.verdict": "Limits Verdict judge",
    "._quality.wall_quality": "WallQuality wall_quality",
}
"""Public names by module; type checkers read them in `_public.py`."""
_MODULES = {name: module for module, names in _NAMES.items() for name in names.split()}


def __getattr__(name: str) -> typing.Any:
    if name == "__all__":
        return [*_MODULES, *_SUBMODULES]
    if name == "__version__":
        return importlib.import_module("importlib.metadata").version(__name__)
    if name in _SUBMODULES:
        return importlib.import_module(f".{name}", __name__)
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(_MODULES[name], __name__), name)
    globals()[name] = value  # the next use is as fast as that of any name
    return value


def __dir__() -> list[str]:
    return sorted([*_MODULES, *_SUBMODULES, "__version__"])
