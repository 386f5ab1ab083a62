"""From words to a command; imports nothing of JAX before the words are understood."""

import argparse
import contextlib
import ctypes
import hashlib
import importlib
import os
import platform
import re
import sys
import textwrap
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from . import _help
from ._job import with_job
from ._output import Output
from ._parser import Parser, build_request, guess_meant
from ._requests import COMMANDS, Request, Speech

ARENA_MAX = -8
"""The parameter of glibc's `mallopt` for the number of heaps."""

CACHE_SIZE = 256 * 2**20
"""Bytes in the cache at most; the least recently used go first."""


def answer(words: Sequence[str]) -> int:
    asked = "_ARGCOMPLETE" in os.environ  # by a shell: how do the words go on?
    top, parsers = parser(is_short="--help-all" not in words and not asked)
    if asked:
        import argcomplete

        argcomplete.autocomplete(top)
    if not words:
        top.print_help()
        return 0
    name = _find_command(words, top, parsers)
    out = Output(name, as_json="--json" in words)
    with warnings.catch_warnings():
        warnings.filterwarnings("always", DAMAGED_ENTRY)  # each entry, though two are of one name
        warnings.showwarning = lambda message, *_: is_healed(message) or out.warn(one_line(message))
        try:
            with out.progress("starting"):
                request = request_of(words, parsers)
                importlib.import_module("._early", __package__).check_request(request)
                run = _load_command(name, request)
            out.verbose = getattr(request, "speech", Speech()).verbose
            return out.end(run(request, out))
        except (OSError, ValueError, ImportError) as error:
            out.complain(one_line(error))
        except (MemoryError, RuntimeError) as error:  # JaxRuntimeError is a RuntimeError
            if not isinstance(error, MemoryError) and "RESOURCE_EXHAUSTED" not in str(error):
                raise
            out.complain("out of memory; fewer --sources and --dtype float32 need less.")
        except KeyboardInterrupt:
            out.complain("interrupted; no file is half written.")
            return out.end(130)
    return out.end(2)


def _find_command(words: Sequence[str], top: Parser, parsers: Mapping[str, Parser]) -> str:
    """Returns the command's name; ends the process for the program's own and for unknown flags."""
    name = words[0]
    if name.startswith("-"):
        top.check_flags(words)
        top.parse_args(words)
    if name not in COMMANDS:
        top.error(f"there is no command {name}{guess_meant(name, COMMANDS)}")
    parsers[name].check_flags(words[1:])
    return name


def _say_native_folder(request: Request, out: Output) -> int:
    from jaxmorph import native

    out.say(str(native.folder), folder=str(native.folder))
    return 0


def _load_command(name: str, request: Request) -> Callable[[Request, Output], int]:
    if name == "native":
        return _say_native_folder  # needs no JAX
    share_heap()
    begin_jax()
    name = "decomposed" if getattr(request, "decomposed", False) else name
    module, function = RUNS[name].split(".")
    return getattr(importlib.import_module(f".{module}", __package__), function)


RUNS = {
    "deform": "_deform.run_deform",
    "decomposed": "_decomposed.run_decomposed",
    "modes": "_plans.run_modes",
    "sensitivity": "_plans.run_sensitivity",
    "export": "_plans.run_export",
    "su2": "_su2.run_su2",
    "quality": "_inspect.run_quality",
    "info": "_inspect.run_info",
    "convert": "_inspect.run_convert",
    "demo": "_inspect.run_demo",
}
"""The function of each command, and its module, which imports JAX."""


def one_line(message: object) -> str:
    if isinstance(message, OSError) and message.filename:
        message = f"{message.filename}: {message.strerror}"
    return " ".join(str(message).split())


def request_of(words: Sequence[str], parsers: Mapping[str, Parser] | None = None) -> Request:
    """Makes the request of the words and of the job that they name.

    `parsers` are those of the commands; by default they have all flags. Raises `ValueError` for a
    bad job, `SystemExit` for words that make no sense.
    """
    name = words[0]
    command = (parsers or parser()[1])[words[0]]
    rest, values = with_job(name, words[1:])
    return build_request(COMMANDS[name], command.parse_args(rest, values))


def parser(*, is_short: bool = False) -> tuple[Parser, dict[str, Parser]]:
    """Builds the parsers of the program and of each command; `is_short`: without rare flags."""
    top = Parser(
        prog="jaxmorph",
        description="Moves meshes with their surfaces, and judges them.",
        epilog=_help.MAIN,
    )
    text = "show the versions of jaxmorph, JAX, NumPy, SciPy and Python"
    top.add_argument("--version", action=Version, nargs=0, help=text)
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
            command.add_argument(
                "--help-all", action="help", help="show all flags and more examples"
            )
        command.add_fields(fields)
    return top, parsers


class Version(argparse.Action):
    def __call__(self, parser, namespace, values, option_string=None):
        from importlib.metadata import version

        import jaxmorph

        others = ", ".join(f"{name} {version(name)}" for name in ("jax", "numpy", "scipy"))
        print(f"jaxmorph {jaxmorph.__version__} ({others}, Python {platform.python_version()})")
        parser.exit()


DAMAGED_ENTRY = "Error (reading|writing) persistent compilation cache entry"
"""What JAX's warnings of a cut or changed file in its cache begin with."""


def is_healed(message: object) -> bool:
    """Removes the entry of JAX's cache that a warning is of: what is compiled now replaces it.

    JAX keeps damaged entries, and does not say which one it read: the one of the latest time of
    use. An entry without a time, from a process that ended early, keeps others from being written.
    """
    if not re.match(DAMAGED_ENTRY, str(message)):
        return False
    import jax

    config: Any = jax.config
    times = {}
    for file in Path(config.jax_compilation_cache_dir or os.devnull).glob("*-cache"):
        used = file.with_name(f"{file.name.removesuffix('-cache')}-atime")
        times[file] = int.from_bytes(used.read_bytes(), "little") if used.exists() else None
    known = [time for time in times.values() if time is not None]
    bad = [file for file, time in times.items() if known and time in (None, max(known))]
    for file in bad:
        file.unlink(missing_ok=True)
    return bool(bad)


def share_heap() -> None:
    """Has all threads allocate from one heap. By default glibc gives each thread its own, and what
    one thread frees serves no other: a fifth of the peak of memory.
    """
    if sys.platform == "linux":
        with contextlib.suppress(AttributeError, OSError):  # another C library
            ctypes.CDLL(None).mallopt(ARENA_MAX, 1)


def begin_jax() -> None:
    """Switches double precision on, and JAX's compilation cache, in the user's cache folder.

    There is no cache if JAX has a folder already, if the folder is missing or open to other users,
    or without the packages that find and lock it.
    """
    import jax

    config: Any = jax.config
    config.update("jax_enable_x64", True)
    if config.jax_compilation_cache_dir:
        return
    facts = [platform.machine()]
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        facts += sorted(
            {
                line
                for line in lines
                if line.startswith(("model name", "flags", "Features", "CPU part"))
            }
        )
    machine = hashlib.sha256("\n".join(facts).encode()).hexdigest()[:16]
    try:
        import filelock  # noqa: F401  JAX locks the folder with it
        import platformdirs

        folder = platformdirs.user_cache_path("jaxmorph") / "compiled" / machine
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        about = folder.stat()  # machine code in it may do anything: this user alone may write to it
    except (ImportError, OSError):
        return
    is_mine = os.name != "posix" or (about.st_uid == os.getuid() and not about.st_mode & 0o022)
    if is_mine and os.access(folder, os.W_OK):
        config.update("jax_compilation_cache_dir", str(folder))
        config.update("jax_compilation_cache_max_size", CACHE_SIZE)
        config.update(
            "jax_persistent_cache_min_compile_time_secs", 0
        )  # reading takes a tenth of any compilation
