"""Public names of `jaxmorph.shapes` and their homes, for type checkers and as the room runs."""

# isort: off
from ._cad import CAD as CAD
from ._curves import (
    BSplineCurve as BSplineCurve,
    CST as CST,
    HicksHenne as HicksHenne,
    Modes as Modes,
    NACA4 as NACA4,
)
from ._displacement import (
    Fit as Fit,
    displacement as displacement,
    fit as fit,
    names as names,
)
from ._displacement import path as path, project as project, pullback as pullback, varied as varied
from ._freeform import FreeForm as FreeForm, Hexahedron as Hexahedron
from ._metric import SobolevMetric as SobolevMetric
from ._motions import ReferenceAxis as ReferenceAxis, bend as bend, rotate as rotate, scale as scale
from ._motions import translate as translate, twist as twist
from ._onto import Onto as Onto, onto as onto
from ._optimisation import History as History, MeshGuard as MeshGuard, QualityRows as QualityRows
from ._section import Chord as Chord, upper_side as upper_side
from ._shape import (
    AbstractLinearShape as AbstractLinearShape,
    AbstractShape as AbstractShape,
    Chain as Chain,
)
from ._shape import (
    Function as Function,
    Linked as Linked,
    OnRows as OnRows,
    Part as Part,
    Together as Together,
)
from ._smooth import Offset as Offset, Smoother as Smoother
from ._walls import (
    Stations as Stations,
    area as area,
    area_of_revolution as area_of_revolution,
    centroid as centroid,
    chord as chord,
)
from ._walls import (
    thickness as thickness,
    volume as volume,
    volume_of_revolution as volume_of_revolution,
    wall_loop as wall_loop,
    wall_normals as wall_normals,
)
