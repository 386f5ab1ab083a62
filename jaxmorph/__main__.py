"""`python -m jaxmorph`: the command line, as a process."""

import gc
import sys
from typing import NoReturn

from jaxmorph.cli import main

# Imports and traced code make many objects that live on. Python looks for cycles among them as it
# runs, and among all of them once more at its end: together a quarter of a short command's time.
GARBAGE = (100_000, 20, 20)


def run() -> NoReturn:
    """Runs the command of the process, and ends it with its status."""
    gc.set_threshold(*GARBAGE)
    status = main()
    gc.freeze()
    sys.exit(status)


if __name__ == "__main__":
    run()
