"""From words to a command: parses them, runs it, and says in one line what went wrong.

Nothing of JAX is imported before the words are understood.
"""

import contextlib
import gc
import os
import warnings
from collections.abc import Iterator, Sequence

from ._flags import COMMANDS, parser
from ._interrupt import STATUS, raise_again
from ._job import with_job
from ._output import Output
from ._parser import Parser, meant, quoted


def answer(words: Sequence[str], *, is_own: bool = False) -> int:
    """Runs one command and returns its exit status, as `main` says; `is_own` where the process has nothing else to do."""
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
            arguments = top.parse_args(quoted(with_job(words)))
            with _without_collection() if is_own else contextlib.nullcontext():
                from ._commands import run
                from ._requests import request_of
            raise_again()
            out.verbose = getattr(arguments, "verbose", False)
            return out.end(run(request_of(arguments), out))
        except OSError as error:
            named = f"{error.filename}: {error.strerror}" if error.filename else error
            out.complain(one_line(named))
        except (ValueError, ImportError) as error:
            out.complain(one_line(error))
        except (MemoryError, RuntimeError) as error:  # JaxRuntimeError is a RuntimeError
            if not isinstance(error, MemoryError) and "RESOURCE_EXHAUSTED" not in str(error):
                raise
            out.complain("out of memory; fewer --sources and --dtype float32 need less.")
        except KeyboardInterrupt:
            out.complain("interrupted; no file is half written.")
            return out.end(STATUS)
    return out.end(2)


def one_line(message: object) -> str:
    """Joins the words of a message by single spaces."""
    return " ".join(str(message).split())


@contextlib.contextmanager
def _without_collection() -> Iterator[None]:
    """Keeps the garbage collector off what is imported: it would go through all of it again and again, and at the end."""
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


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
