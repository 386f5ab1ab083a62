"""From words to a command: parses, runs, and describes an error in one line.

Nothing of JAX is imported before the words are understood.
"""

import argparse
import importlib
import os
import textwrap
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from . import _help
from ._job import with_job
from ._output import Output
from ._parser import Parser, made, meant, quoted
from ._requests import COMMANDS, SU2, Deform, Demo, Info, Modes, Quality, Request, Sensitivity, Speech


def answer(words: Sequence[str]) -> int:
    """Runs one command and returns its exit status, as `main` does."""
    asked = "_ARGCOMPLETE" in os.environ  # by a shell: how do the words go on?
    top, parsers = parser(is_short="--help-all" not in words and not asked)
    if asked:
        import argcomplete

        argcomplete.autocomplete(top)
    if not words:
        top.print_help()
        return 0
    name = _checked(words, top, parsers)
    out = Output(name, as_json="--json" in words)
    with warnings.catch_warnings():
        warnings.showwarning = lambda message, *_: out.warn(one_line(message))
        try:
            request = request_of(words, parsers)
            importlib.import_module("._early", __package__).check(request)
            run = _command(request)
            out.verbose = getattr(request, "speech", Speech()).verbose
            return out.end(run(request, out))
        except OSError as error:
            out.complain(one_line(f"{error.filename}: {error.strerror}" if error.filename else error))
        except (ValueError, ImportError) as error:
            out.complain(one_line(error))
        except (MemoryError, RuntimeError) as error:  # JaxRuntimeError is a RuntimeError
            if not isinstance(error, MemoryError) and "RESOURCE_EXHAUSTED" not in str(error):
                raise
            out.complain("out of memory; fewer --sources and --dtype float32 need less.")
        except KeyboardInterrupt:
            out.complain("interrupted; no file is half written.")
            return out.end(130)
    return out.end(2)


def _command(request: Request) -> Callable[[Request, Output], int]:
    """Imports the command, and JAX with it, in double precision and with a cache."""
    importlib.import_module("._compiled", __package__).begin()
    is_part = isinstance(request, Deform) and request.decomposed
    module, name = ("_decomposed.deform_parts" if is_part else RUNS[type(request)]).split(".")
    return getattr(importlib.import_module(f".{module}", __package__), name)


RUNS: dict[Any, str] = {
    Deform: "_deform.deform",
    Modes: "_modes.modes",
    Sensitivity: "_sensitivity.sensitivity",
    SU2: "_su2.run",
    Quality: "_inspect.quality",
    Info: "_inspect.info",
    Demo: "_inspect.demo",
}
"""The function of each request's command, and its module, which imports JAX."""


def one_line(message: object) -> str:
    """Joins the words of a message by single spaces."""
    return " ".join(str(message).split())


def _checked(words: Sequence[str], top: Parser, parsers: Mapping[str, Parser]) -> str:
    """Returns the command's name.

    A flag of the program itself ends the process; unknown commands and flags with status 2.
    """
    name = words[0]
    if name.startswith("-"):
        top.check_flags(words)
        top.parse_args(words)
    if name not in COMMANDS:
        top.error(f"there is no command {name}{meant(name, COMMANDS)}")
    parsers[name].check_flags(words[1:])
    return name


def request_of(words: Sequence[str], parsers: Mapping[str, Parser] | None = None) -> Request:
    """Makes the request of the words and of the job that they name.

    `parsers` are those of the commands; by default they have all flags.

    Raises `ValueError` for a job that is none, `SystemExit` for words that make no sense.
    """
    name, command = words[0], (parsers or parser()[1])[words[0]]
    rest, values = with_job(name, words[1:])
    return made(COMMANDS[name], command.parse_args(quoted(rest, command.short), values))


def parser(*, is_short: bool = False) -> tuple[Parser, dict[str, Parser]]:
    """Builds the parser of the whole command line, and a dict with the parser of each command.

    `is_short` leaves rare flags out of the pages of help.
    """
    top = Parser(prog="jaxmorph", description="Moves meshes with their surfaces, and judges them.", epilog=_help.MAIN)
    text = "show the versions of jaxmorph, JAX, NumPy, SciPy and Python"
    top.add(["--version"], {"action": Version, "nargs": 0, "help": text})
    commands = top.add_subparsers(
        title="commands", dest="command", metavar="COMMAND", required=True, parser_class=Parser
    )
    parsers = {}
    for name, fields in COMMANDS.items():
        page = _help.PAGES[name]
        is_brief = is_short and bool(page.more)
        command = parsers[name] = commands.add_parser(
            name,
            help=page.summary,
            description=textwrap.fill(page.summary[0].upper() + page.summary[1:] + ".", 80),
            usage=f"jaxmorph {name} {page.usage}",
            epilog=page.below(is_brief),
            is_short=is_brief,
        )
        if page.more:
            command.add(["--help-all"], {"action": "help", "help": "show all flags and more examples"})
        command.add_fields(fields)
    return top, parsers


class Version(argparse.Action):
    """Prints versions, and ends."""

    def __call__(self, parser, namespace, values, option_string=None):
        from importlib.metadata import version
        from platform import python_version

        import jaxmorph

        others = ", ".join(f"{name} {version(name)}" for name in ("jax", "numpy", "scipy"))
        print(f"jaxmorph {jaxmorph.__version__} ({others}, Python {python_version()})")
        parser.exit()
