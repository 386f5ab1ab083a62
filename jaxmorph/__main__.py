"""`python -m jaxmorph`: the command line, as a process."""

import gc
import sys
from typing import NoReturn

from jaxmorph.cli import main

# Imports and traced code make many objects, which live on: looked at for cycles as often as Python
# does by default, they take an eighth of a short command's time.
GARBAGE = (100_000, 20, 20)


def run() -> NoReturn:
    """Runs the command of the process, and ends it with its status."""
    gc.set_threshold(*GARBAGE)
    sys.exit(main())


if __name__ == "__main__":
    run()
