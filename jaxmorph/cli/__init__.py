"""The command line: `jaxmorph deform`, `quality`, `info`, `demo`; a thin skin over the library's public names."""

import argparse
import sys
import warnings
from collections.abc import Sequence

import jax

from ._arguments import parser
from ._deform import deform
from ._inspect import info, quality

INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command; the arguments are those of the process unless given.

    Returns the exit status: 0, 1 when a cell is inverted, 2 for bad input, after one line that says what is wrong with it.
    Calculations are in float64: JAX's x64 mode is switched on. `SystemExit` (2) is raised for arguments that make no sense.
    """
    chosen = parser().parse_args(arguments)
    jax.config.update("jax_enable_x64", True)
    commands = {"deform": deform, "quality": quality, "info": info, "demo": _demo}
    name = f"jaxmorph {chosen.command}"
    with warnings.catch_warnings():
        warnings.showwarning = lambda message, *_: print(f"{name}: warning: {_line(message)}", file=sys.stderr)
        try:
            return commands[chosen.command](chosen)
        except OSError as error:
            named = f"{error.filename}: {error.strerror}" if error.filename else error
            print(f"{name}: {_line(named)}", file=sys.stderr)
        except (ValueError, ImportError) as error:
            print(f"{name}: {_line(error)}", file=sys.stderr)
        except KeyboardInterrupt:
            print(f"{name}: interrupted; no file is half written.", file=sys.stderr)
            return INTERRUPTED
    return 2


def _demo(arguments: argparse.Namespace) -> int:
    from jaxmorph._demo import run

    return run(arguments.case, arguments.output)


def _line(message: object) -> str:
    return " ".join(str(message).split())
