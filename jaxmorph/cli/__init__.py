"""The command line, a thin skin over the library's public names."""

import io
import sys
from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command; by default with the arguments of the process.

    Returns the exit status: 0; 1 for an inverted cell or a failed quality gate; 2 for bad input,
    after one line that describes the fault; 130 when interrupted. Switches JAX's x64 mode on.
    Raises `SystemExit` (2) for arguments that make no sense, and `SystemExit` (0) after a page of
    help.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    if arguments is None and isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # the locale may lack a letter of a name
    from ._output import open_ended

    try:
        from ._entry import answer

        with open_ended():
            return answer(words)
        return 0
    except KeyboardInterrupt:
        name = " ".join(["jaxmorph", *(word for word in words[:1] if not word.startswith("-"))])
        print(f"{name}: interrupted.", file=sys.stderr)
        return 130
    finally:
        if sys.stdout is not None:  # a service may have closed it
            with open_ended():
                sys.stdout.flush()
