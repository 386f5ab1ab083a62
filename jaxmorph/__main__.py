"""`python -m jaxmorph`: the command line."""

import sys

from jaxmorph.cli import main

sys.exit(main())
