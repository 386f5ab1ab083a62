"""All commands, and with them JAX."""

import jax

from jaxmorph import _demo

from . import _su2
from ._compiled import keep_compiled
from ._decomposed import deform_parts
from ._deform import deform
from ._inspect import info, quality
from ._modes import modes
from ._output import Output
from ._ranges import deform_ranges
from ._requests import SU2, Deform, Demo, Info, Modes, Quality, Request, Sensitivity
from ._sensitivity import sensitivity


def run(request: Request, out: Output) -> int:
    """Runs what is asked for, in double precision. Returns the exit status."""
    jax.config.update("jax_enable_x64", True)
    keep_compiled()
    match request:
        case Deform(ranges=int()):
            return deform_ranges(request, out)
        case Deform(decomposed=True):
            return deform_parts(request, out)
        case Deform():
            return deform(request, out)
        case Modes():
            return modes(request, out)
        case Sensitivity():
            return sensitivity(request, out)
        case SU2():
            return _su2.run(request, out)
        case Quality():
            return quality(request, out)
        case Info(file):
            return info(file, out)
        case Demo(case, output):
            return _demo.run(case, output)
