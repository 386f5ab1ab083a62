"""The parser of the whole command line, and from words to a request."""

import argparse
import textwrap
from collections.abc import Mapping, Sequence

from . import _help
from ._job import with_job
from ._parser import Parser, made, quoted
from ._requests import COMMANDS, Request


def parser(*, is_short: bool = True) -> tuple[Parser, dict[str, Parser]]:
    """Builds the parser of the whole command line, and a dict with the parser of each command.

    The command's name is parsed as `command`. `is_short` leaves rare flags out of the pages of
    help.
    """
    top = Parser(prog="jaxmorph", description="Moves meshes with their surfaces, and judges them.", epilog=_help.MAIN)
    top.add(
        ["--version"],
        {"action": Version, "nargs": 0, "help": "show the versions of jaxmorph, JAX, NumPy, SciPy and Python"},
    )
    commands = top.add_subparsers(
        title="commands", dest="command", metavar="COMMAND", required=True, parser_class=Parser
    )
    parsers = {}
    for name, fields in COMMANDS.items():
        page = _help.PAGES[name]
        is_brief = is_short and bool(page.short)
        command = parsers[name] = commands.add_parser(
            name,
            help=page.summary,
            description=textwrap.fill(page.summary[0].upper() + page.summary[1:] + ".", 80),
            usage=f"jaxmorph {name} {page.usage}",
            epilog=page.short if is_brief else page.long,
            is_short=is_brief,
        )
        if page.short:
            command.add(["--help-all"], {"action": "help", "help": "show all flags and more examples"}, everyday=True)
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


def request_of(words: Sequence[str], top: Parser | None = None, parsers: Mapping[str, Parser] = {}) -> Request:
    """Makes the request of the words and of the job that they name.

    `top` is the parser, `parsers` those of the commands; by default they have all flags.

    Raises `ValueError` for a job that is none, `SystemExit` for words that make no sense.
    """
    if top is None:
        top, parsers = parser()
    words = with_job(words)
    arguments = top.parse_args(quoted(words, parsers.get(words[0], top).short))
    return made(COMMANDS[arguments.command], arguments)
