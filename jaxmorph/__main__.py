"""`python -m jaxmorph`: the command line, as a process."""

import sys
from typing import NoReturn

from jaxmorph.cli import main


def run() -> NoReturn:
    """Runs the command of the process, and ends it with its status."""
    sys.exit(main())


if __name__ == "__main__":
    run()
