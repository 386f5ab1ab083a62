"""Shapes: traced functions from positions to positions, from design variables to a new wall."""

from ._axis import ReferenceAxis as ReferenceAxis
from ._combine import Linked as Linked
from ._combine import Part as Part
from ._combine import Together as Together
from ._curves import CST as CST
from ._curves import BSplineCurve as BSplineCurve
from ._curves import HicksHenne as HicksHenne
from ._curves import Modes as Modes
from ._displacement import displacement as displacement
from ._fit import Fit as Fit
from ._fit import fit as fit
from ._fit import fit_cst as fit_cst
from ._freeform import FreeForm as FreeForm
from ._line import bend as bend
from ._line import twist as twist
from ._naca import NACA4 as NACA4
from ._rigid import rotate as rotate
from ._rigid import scale as scale
from ._rigid import translate as translate
from ._section import Chord as Chord
from ._section import upper_side as upper_side
from ._shape import AbstractLinearShape as AbstractLinearShape
from ._shape import AbstractOperator as AbstractOperator
from ._shape import AbstractShape as AbstractShape
from ._smooth import Smoother as Smoother
