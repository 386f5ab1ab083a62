"""Differentiable mesh morphing in JAX: reduced radial basis functions with exact surfaces.

"The paper" in docstrings is *Mesh deformation with exact surface reconstruction using a reduced
radial basis function approach*; the copy that we worked from names no authors. The documentation's
page on theory prints the equations that docstrings cite. The paper builds on

- radial basis functions for moving meshes: de Boer, van der Schoot and Bijl, Computers and
  Structures 85, 2007;
- their reduction to few sources: Rendall and Allen, Journal of Computational Physics 228, 2009;
- Delaunay graph mapping: Liu, Qin and Xia, Journal of Computational Physics 211, 2006.

The public names stand in `_public.py`. The first use of a name imports its module, and JAX with it:
the command line shows its help without. Submodules are imported when they are first used.
"""

import importlib
import typing

from ._host.package.names import Names

if typing.TYPE_CHECKING:
    from . import cases as cases
    from . import cli as cli
    from . import integrations as integrations
    from . import io as io
    from . import plot as plot
    from . import shapes as shapes
    from ._public import *  # noqa: F403

__version__: str

_names = Names(__name__, ("cases", "cli", "integrations", "io", "plot", "shapes"))


def __getattr__(name: str) -> typing.Any:
    if name == "__version__":
        return importlib.import_module("importlib.metadata").version(__name__)
    return _names.found(name)


def __dir__() -> list[str]:
    return sorted({*_names.listed(), "__version__"})
