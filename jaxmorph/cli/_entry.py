"""From words to a command: parses, runs, and describes an error in one line.

Nothing of JAX is imported before the words are understood.
"""

import importlib
import os
import warnings
from collections.abc import Callable, Sequence

from ._flags import parser, request_of
from ._output import Output
from ._parser import Parser, meant
from ._parts import Speech
from ._requests import COMMANDS, Request


def answer(words: Sequence[str]) -> int:
    """Runs one command and returns its exit status, as `main` does."""
    top, parsers = parser(is_short="--help-all" not in words and "_ARGCOMPLETE" not in os.environ)
    _complete(top)
    if not words:
        top.print_help()
        return 0
    name = _checked(words, top, parsers)
    out = Output(name, as_json="--json" in words)
    with warnings.catch_warnings():
        warnings.showwarning = lambda message, *_: out.warn(one_line(message))
        try:
            request = request_of(words, top, parsers)
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
    module, name = request.run.split(".")
    return getattr(importlib.import_module(f".{module}", __package__), name)


def one_line(message: object) -> str:
    """Joins the words of a message by single spaces."""
    return " ".join(str(message).split())


def _checked(words: Sequence[str], top: Parser, parsers: dict[str, Parser]) -> str:
    """Returns the command's name, empty for a flag of the program itself.

    Ends the process with status 2 for unknown commands and flags.
    """
    name = words[0]
    if name.startswith("-"):
        top.check_flags(words)
        return ""
    if name not in COMMANDS:
        top.error(f"there is no command {name}{meant(name, COMMANDS)}")
    parsers[name].check_flags(words[1:])
    return name


def _complete(top: Parser) -> None:
    """Answers a shell that asks how the words go on, and ends; see argcomplete."""
    if "_ARGCOMPLETE" in os.environ:
        import argcomplete

        argcomplete.autocomplete(top)
