"""The command line, a thin skin over the library's public names: `jaxmorph deform`, `modes`, `sensitivity`, `quality` ..."""

import argparse
import sys
import warnings
from collections.abc import Sequence

import jax

from ._arguments import parser
from ._deform import deform
from ._inspect import info, quality
from ._job import with_job
from ._modes import modes
from ._output import Output
from ._sensitivity import sensitivity

INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command; the arguments are those of the process unless given.

    Returns the exit status: 0, 1 when a cell is inverted or a quality gate fails, 2 for bad input, after one line that says what
    is wrong with it, 130 when interrupted. Calculations are in float64: JAX's x64 mode is switched on. `SystemExit` (2) is
    raised for arguments that make no sense.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    out = Output(words[0] if words and not words[0].startswith("-") else "", as_json="--json" in words)
    with warnings.catch_warnings():
        warnings.showwarning = lambda message, *_: out.warn(_line(message))
        try:
            chosen = parser().parse_args(with_job(words))
            jax.config.update("jax_enable_x64", True)
            commands = {"deform": deform, "modes": modes, "sensitivity": sensitivity}
            commands |= {"quality": quality, "info": info, "demo": _demo}
            out.verbose = getattr(chosen, "verbose", False)
            return out.end(commands[chosen.command](chosen, out))
        except OSError as error:
            named = f"{error.filename}: {error.strerror}" if error.filename else error
            out.complain(_line(named))
        except (ValueError, ImportError) as error:
            out.complain(_line(error))
        except (MemoryError, jax.errors.JaxRuntimeError) as error:
            if not isinstance(error, MemoryError) and "RESOURCE_EXHAUSTED" not in str(error):
                raise
            out.complain("out of memory; fewer --sources and --dtype float32 need less.")
        except KeyboardInterrupt:
            out.complain("interrupted; no file is half written.")
            return out.end(INTERRUPTED)
    return out.end(2)


def _demo(arguments: argparse.Namespace, out: Output) -> int:
    from jaxmorph._demo import run

    return run(arguments.case, arguments.output)


def _line(message: object) -> str:
    return " ".join(str(message).split())
