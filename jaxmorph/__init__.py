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

if typing.TYPE_CHECKING:  # `as` makes a name public for type checkers; `_NAMES` repeats it
    # isort: off
    from . import cases as cases, cli as cli, extend as extend, integrations as integrations, io as io
    from . import native as native, plot as plot, shapes as shapes
    from ._advice.compare import Comparison as Comparison, compare as compare
    from ._advice.cures import Cure as Cure, Turn as Turn, cures as cures
    from ._advice.fewest_steps import Steps as Steps, fewest_steps as fewest_steps
    from ._advice.inspect import Inspection as Inspection, inspect as inspect
    from ._advice.largest_step import (
        DesignedMesh as DesignedMesh,
        LargestStep as LargestStep,
        largest_step as largest_step,
    )
    from ._advice.methods import METHODS as METHODS
    from ._advice.valid_steps import ValidSteps as ValidSteps
    from ._boundary.boundary import Boundary as Boundary
    from ._boundary.facets import Facets as Facets
    from ._boundary.outer_faces import FreeFaces as FreeFaces, boundary_faces as boundary_faces
    from ._boundary.periodic import Periodic as Periodic
    from ._boundary.slide import Revolution as Revolution, Slide as Slide
    from ._boundary.symmetry import Plane as Plane
    from ._host.package.errors import MeshError as MeshError
    from ._host.sources.farthest import FarthestPoints as FarthestPoints, Graded as Graded
    from ._host.sources.greedy import Greedy as Greedy
    from ._host.sources.reduction import (
        AbstractReduction as AbstractReduction,
        AbstractSearchPoints as AbstractSearchPoints,
        AllPoints as AllPoints,
        Centre as Centre,
        Corners as Corners,
        GaussPoints as GaussPoints,
        KDTree as KDTree,
    )
    from ._improve.curve import curve as curve
    from ._improve.improve import Improvement as Improvement, improve as improve
    from ._mesh.mesh import Mesh as Mesh, elevate as elevate
    from ._methods.base import (
        AbstractField as AbstractField,
        AbstractMethod as AbstractMethod,
        AbstractPlacing as AbstractPlacing,
        Control as Control,
    )
    from ._methods.cells.cells import AbstractCellMethod as AbstractCellMethod
    from ._methods.cells.equations import (
        AbstractStiffness as AbstractStiffness,
        Biharmonic as Biharmonic,
        ByDistance as ByDistance,
        ByVolume as ByVolume,
        Laplacian as Laplacian,
        LinearElasticity as LinearElasticity,
        SpringAnalogy as SpringAnalogy,
        TorsionalSprings as TorsionalSprings,
    )
    from ._methods.delaunay import DelaunayGraph as DelaunayGraph
    from ._methods.inverse_distance import InverseDistance as InverseDistance
    from ._methods.local import LocalCorrection as LocalCorrection
    from ._methods.multiscale import Multiscale as Multiscale
    from ._methods.nearwall import NearWall as NearWall
    from ._methods.rbf.basis import (
        AbstractBasis as AbstractBasis,
        CompactC0 as CompactC0,
        CompactC1 as CompactC1,
        CompactC2a as CompactC2a,
        CompactC2b as CompactC2b,
        CubicSpline as CubicSpline,
        Gaussian as Gaussian,
        InverseMultiquadric as InverseMultiquadric,
        InverseQuadratic as InverseQuadratic,
        LinearSpline as LinearSpline,
        Multiquadric as Multiquadric,
        ThinPlateSpline as ThinPlateSpline,
        WendlandC0 as WendlandC0,
        WendlandC2 as WendlandC2,
        WendlandC4 as WendlandC4,
        WendlandC6 as WendlandC6,
    )
    from ._methods.rbf.compact import CompactRBF as CompactRBF
    from ._methods.rbf.fitted import FittedRBF as FittedRBF
    from ._methods.rbf.rbf import RBF as RBF, Direct as Direct, Iterative as Iterative
    from ._methods.reconstruction import SurfaceReconstruction as SurfaceReconstruction
    from ._methods.surface import Surface as Surface
    from ._plan.deform import deform as deform, pullback as pullback, velocity as velocity
    from ._plan.export import Layer as Layer, export as export
    from ._plan.halves import (
        SurfaceHalf as SurfaceHalf,
        prepare_in_chunks as prepare_in_chunks,
        prepare_surface as prepare_surface,
    )
    from ._plan.judge import BoundaryQuality as BoundaryQuality, boundary_quality as boundary_quality
    from ._plan.plan import Plan as Plan
    from ._plan.prepare import prepare as prepare
    from ._plan.refit import refit as refit
    from ._plan.save import load as load, save as save
    from ._plan.shard import shard as shard
    from ._plan.steps import march as march, replay as replay
    from ._quality.distortion import distortion as distortion
    from ._quality.face_quality import FaceQuality as FaceQuality, face_quality as face_quality
    from ._quality.proof.proof import Proof as Proof, proof as proof, proven_margin as proven_margin
    from ._quality.quality import inverted as inverted, quality as quality
    from ._quality.report import QualityReport as QualityReport
    from ._quality.smooth_quality import (
        SmoothQuality as SmoothQuality,
        smooth_quality as smooth_quality,
        soft_maximum as soft_maximum,
    )
    from ._quality.verdict import Limits as Limits, Verdict as Verdict, judge as judge
    from ._quality.wall_quality import WallQuality as WallQuality, wall_quality as wall_quality
    # isort: on

__version__: str


_SUBMODULES = ("cases", "cli", "extend", "integrations", "io", "native", "plot", "shapes")
_NAMES = {
    "._advice.compare": "Comparison compare",
    "._advice.cures": "Cure Turn cures",
    "._advice.fewest_steps": "Steps fewest_steps",
    "._advice.inspect": "Inspection inspect",
    "._advice.largest_step": "DesignedMesh LargestStep largest_step",
    "._advice.methods": "METHODS",
    "._advice.valid_steps": "ValidSteps",
    "._boundary.boundary": "Boundary",
    "._boundary.facets": "Facets",
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
    "._methods.cells.equations": "AbstractStiffness Biharmonic ByDistance ByVolume Laplacian LinearElasticity SpringAnalogy "
    "TorsionalSprings",
    "._methods.delaunay": "DelaunayGraph",
    "._methods.inverse_distance": "InverseDistance",
    "._methods.local": "LocalCorrection",
    "._methods.multiscale": "Multiscale",
    "._methods.nearwall": "NearWall",
    "._methods.rbf.basis": "AbstractBasis CompactC0 CompactC1 CompactC2a CompactC2b CubicSpline Gaussian InverseMultiquadric "
    "InverseQuadratic LinearSpline Multiquadric ThinPlateSpline WendlandC0 WendlandC2 WendlandC4 "
    "WendlandC6",
    "._methods.rbf.compact": "CompactRBF",
    "._methods.rbf.fitted": "FittedRBF",
    "._methods.rbf.rbf": "RBF Direct Iterative",
    "._methods.reconstruction": "SurfaceReconstruction",
    "._methods.surface": "Surface",
    "._plan.deform": "deform pullback velocity",
    "._plan.export": "Layer export",
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
"""Public names by module; the block above repeats them for type checkers."""
_MODULES = dict.fromkeys(_SUBMODULES, "") | {name: module for module, names in _NAMES.items() for name in names.split()}


def __getattr__(name: str) -> typing.Any:
    if name == "__all__":
        return list(_MODULES)
    if name == "__version__":
        return importlib.import_module("importlib.metadata").version(__name__)
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if not _MODULES[name]:
        return importlib.import_module(f".{name}", __name__)
    value = getattr(importlib.import_module(_MODULES[name], __name__), name)
    globals()[name] = value  # the next use is as fast as that of any name
    return value


def __dir__() -> list[str]:
    return sorted([*_MODULES, "__version__"])
