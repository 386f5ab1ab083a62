"""All commands, and with them JAX."""

import argparse

import jax

from jaxmorph import _demo

from ._deform import deform
from ._inspect import info, quality
from ._modes import modes
from ._output import Output
from ._requests import Deform, Demo, Info, Modes, Quality, Sensitivity, request_of
from ._sensitivity import sensitivity


def run(arguments: argparse.Namespace, out: Output) -> int:
    """Runs the command that the arguments name, in double precision. Returns the exit status."""
    jax.config.update("jax_enable_x64", True)
    match request_of(arguments):
        case Deform() as request:
            return deform(request, out)
        case Modes() as request:
            return modes(request, out)
        case Sensitivity() as request:
            return sensitivity(request, out)
        case Quality() as request:
            return quality(request, out)
        case Info(file):
            return info(file, out)
        case Demo(case, output):
            return _demo.run(case, output)
