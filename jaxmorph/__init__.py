"""Differentiable mesh morphing in JAX: reduced radial basis functions with exact surfaces."""

from ._basis import AbstractBasis as AbstractBasis
from ._basis import Gaussian as Gaussian
from ._basis import Multiquadric as Multiquadric
from ._basis import ThinPlateSpline as ThinPlateSpline
from ._basis import WendlandC2 as WendlandC2
from ._choose import Choice as Choice
from ._choose import choose as choose
from ._distortion import distortion as distortion
from ._distortion import smooth_skewness as smooth_skewness
from ._fewest import Steps as Steps
from ._fewest import fewest_steps as fewest_steps
from ._host.greedy import Greedy as Greedy
from ._host.reduction import AbstractReduction as AbstractReduction
from ._host.reduction import AbstractSearchPoints as AbstractSearchPoints
from ._host.reduction import AllPoints as AllPoints
from ._host.reduction import Centre as Centre
from ._host.reduction import Corners as Corners
from ._host.reduction import GaussPoints as GaussPoints
from ._host.reduction import KDTree as KDTree
from ._improve import Improvement as Improvement
from ._improve import improve as improve
from ._improve import untangle as untangle
from ._inspect import Inspection as Inspection
from ._inspect import inspect as inspect
from ._mesh import Mesh as Mesh
from ._methods.base import AbstractField as AbstractField
from ._methods.base import AbstractMethod as AbstractMethod
from ._methods.base import Surface as Surface
from ._methods.delaunay import DelaunayGraph as DelaunayGraph
from ._methods.nearwall import NearWall as NearWall
from ._methods.rbf import RBF as RBF
from ._methods.reconstruction import SurfaceReconstruction as SurfaceReconstruction
from ._plan import Plan as Plan
from ._plan import deform as deform
from ._plan import pullback as pullback
from ._plan import refit as refit
from ._plan import shard as shard
from ._prepare import prepare as prepare
from ._quality import quality as quality
from ._report import QualityReport as QualityReport
from ._smooth import soft_maximum as soft_maximum
from ._steps import march as march
from ._steps import replay as replay
from ._symmetry import Plane as Plane

__version__ = "0.1.0"
