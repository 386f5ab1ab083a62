"""`python -m jaxmorph`: the command line, as a process."""

import os
import sys
from typing import NoReturn

from jaxmorph.cli import main

WATCHERS = ("coverage", "mpi4py")
"""Packages that do something at the end of a process."""


def run() -> NoReturn:
    """Runs the command of the process, and ends it.

    Python would take apart all that was imported, for 0.1 seconds. That is left out, unless someone
    watches the process, or is in it.
    """
    status = main()
    is_watched = sys.gettrace() or sys.getprofile() or sys.flags.interactive or set(WATCHERS) & set(sys.modules)
    if not is_watched:
        try:
            for stream in filter(None, (sys.stdout, sys.stderr)):  # a service may close them
                stream.flush()
        except OSError:  # a closed pipe: Python has a status for it
            sys.exit(status)
        os._exit(status)
    sys.exit(status)


if __name__ == "__main__":
    run()
