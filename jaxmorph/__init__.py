"""Differentiable mesh morphing in JAX: reduced radial basis functions with exact surfaces.

"The paper" in docstrings is *Mesh deformation with exact surface reconstruction using a reduced radial basis function
approach*; the copy that we worked from names no authors. It builds on radial basis functions for moving meshes (de Boer, van der
Schoot and Bijl, Computers and Structures 85, 2007; Rendall and Allen, Journal of Computational Physics 228, 2009) and on
Delaunay graph mapping (Liu, Qin and Xia, Journal of Computational Physics 211, 2006). The documentation's page on theory prints
the equations that docstrings cite.
"""

from importlib.metadata import version as _version

from . import shapes as shapes
from ._advice.choose import Choice as Choice
from ._advice.choose import choose as choose
from ._advice.fewest_steps import Steps as Steps
from ._advice.fewest_steps import fewest_steps as fewest_steps
from ._advice.inspect import Inspection as Inspection
from ._advice.inspect import inspect as inspect
from ._advice.largest_step import LargestStep as LargestStep
from ._advice.largest_step import largest_step as largest_step
from ._host.errors import MeshError as MeshError
from ._host.farthest import FarthestPoints as FarthestPoints
from ._host.graded import Graded as Graded
from ._host.greedy import Greedy as Greedy
from ._host.reduction import AbstractReduction as AbstractReduction
from ._host.reduction import AbstractSearchPoints as AbstractSearchPoints
from ._host.reduction import AllPoints as AllPoints
from ._host.reduction import Centre as Centre
from ._host.reduction import Corners as Corners
from ._host.reduction import GaussPoints as GaussPoints
from ._host.reduction import KDTree as KDTree
from ._improve.improve import Improvement as Improvement
from ._improve.improve import improve as improve
from ._improve.improve import untangle as untangle
from ._mesh.mesh import Mesh as Mesh
from ._methods.base import AbstractField as AbstractField
from ._methods.base import AbstractMethod as AbstractMethod
from ._methods.base import Surface as Surface
from ._methods.basis import AbstractBasis as AbstractBasis
from ._methods.basis import Gaussian as Gaussian
from ._methods.basis import Multiquadric as Multiquadric
from ._methods.basis import ThinPlateSpline as ThinPlateSpline
from ._methods.basis import WendlandC2 as WendlandC2
from ._methods.delaunay import DelaunayGraph as DelaunayGraph
from ._methods.fitted import FittedRBF as FittedRBF
from ._methods.multiscale import Multiscale as Multiscale
from ._methods.nearwall import NearWall as NearWall
from ._methods.rbf import RBF as RBF
from ._methods.reconstruction import SurfaceReconstruction as SurfaceReconstruction
from ._plan.plan import Plan as Plan
from ._plan.plan import deform as deform
from ._plan.plan import pullback as pullback
from ._plan.plan import refit as refit
from ._plan.plan import shard as shard
from ._plan.prepare import prepare as prepare
from ._plan.save import load as load
from ._plan.save import save as save
from ._plan.steps import march as march
from ._plan.steps import replay as replay
from ._plan.symmetry import Plane as Plane
from ._plan.velocity import velocity as velocity
from ._quality.distortion import distortion as distortion
from ._quality.quality import quality as quality
from ._quality.report import QualityReport as QualityReport
from ._quality.smooth import soft_maximum as soft_maximum
from ._quality.smooth_quality import SmoothQuality as SmoothQuality
from ._quality.smooth_quality import smooth_quality as smooth_quality
from ._quality.wall import WallQuality as WallQuality
from ._quality.wall import wall_quality as wall_quality

__version__ = _version("jaxmorph")
