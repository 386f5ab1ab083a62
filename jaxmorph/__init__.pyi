"""Public names and their homes: type checkers read them here, and so does `jaxmorph` as it runs."""

# isort: off
from . import cases as cases, cli as cli, extend as extend, integrations as integrations, io as io
from . import native as native, plot as plot, shapes as shapes
from ._advice.compare import Comparison as Comparison, compare as compare
from ._advice.cures import Cure as Cure, cures as cures
from ._advice.fewest_steps import Steps as Steps, fewest_steps as fewest_steps
from ._advice.inspect import Inspection as Inspection, inspect as inspect
from ._advice.largest_step import (
    DesignedMesh as DesignedMesh,
    LargestStep as LargestStep,
    largest_step as largest_step,
)
from ._advice.methods import METHODS as METHODS
from ._advice.region import wall_layers as wall_layers
from ._advice.relay import Relay as Relay
from ._advice.remesh import remesh as remesh
from ._advice.transfer import Remeshed as Remeshed
from ._advice.turn import Turn as Turn
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
from ._methods.cells import AbstractCellMethod as AbstractCellMethod
from ._methods.corrections import (
    DelaunayGraph as DelaunayGraph,
    LocalCorrection as LocalCorrection,
    NearWall as NearWall,
)
from ._methods.elements import (
    AbstractStiffness as AbstractStiffness,
    Biharmonic as Biharmonic,
    ByDistance as ByDistance,
    ByVolume as ByVolume,
    Laplacian as Laplacian,
    LinearElasticity as LinearElasticity,
    SpringAnalogy as SpringAnalogy,
    TorsionalSprings as TorsionalSprings,
)
from ._methods.inverse_distance import InverseDistance as InverseDistance
from ._methods.multiscale import Multiscale as Multiscale
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
from ._methods.rbf.rbf import Direct as Direct, Iterative as Iterative, RBF as RBF
from ._methods.reconstruction import SurfaceReconstruction as SurfaceReconstruction
from ._methods.surface import Surface as Surface
from ._plan.deform import (
    deform as deform,
    pullback as pullback,
    shard as shard,
    velocity as velocity,
)
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
from ._plan.steps import march as march, replay as replay
from ._quality.distortion import distortion as distortion
from ._quality.face_quality import FaceQuality as FaceQuality, face_quality as face_quality
from ._quality.limits import Limits as Limits
from ._quality.proof import Proof as Proof, proof as proof, proven_margin as proven_margin
from ._quality.quality import inverted as inverted, quality as quality
from ._quality.report import QualityReport as QualityReport
from ._quality.smooth_quality import (
    SmoothQuality as SmoothQuality,
    smooth_quality as smooth_quality,
    soft_maximum as soft_maximum,
)
from ._quality.verdict import Verdict as Verdict, judge as judge
from ._quality.wall_quality import WallQuality as WallQuality, wall_quality as wall_quality

__version__: str
