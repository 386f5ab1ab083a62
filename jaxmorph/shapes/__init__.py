"""Shapes: traced functions from positions to positions, from design variables to a new wall."""

from ._displacement import displacement as displacement
from ._freeform import FreeForm as FreeForm
from ._line import bend as bend
from ._line import twist as twist
from ._rigid import rotate as rotate
from ._rigid import scale as scale
from ._rigid import translate as translate
from ._shape import AbstractLinearShape as AbstractLinearShape
from ._shape import AbstractOperator as AbstractOperator
from ._shape import AbstractShape as AbstractShape
