"""Differentiable mesh morphing in JAX: reduced radial basis functions with exact surfaces.

"The paper" in docstrings is *Mesh deformation with exact surface reconstruction using a reduced
radial basis function approach*; the copy that we worked from names no authors. The documentation's
page on theory prints the equations that docstrings cite. The paper builds on

- radial basis functions for moving meshes: de Boer, van der Schoot and Bijl, Computers and
  Structures 85, 2007;
- their reduction to few sources: Rendall and Allen, Journal of Computational Physics 228, 2009;
- Delaunay graph mapping: Liu, Qin and Xia, Journal of Computational Physics 211, 2006.

The first use of a public name imports its module, and JAX with it: the command line shows its help
without. Submodules are imported when they are first used.
"""

# names without an underscore are offered to who types `jm.`
import importlib as _importlib
from typing import Any as _Any

from .extend import attached as _attached

_attribute, __dir__, __all__ = _attached(__name__, __file__)


def __getattr__(name: str) -> _Any:
    if name == "__version__":
        return _importlib.import_module("importlib.metadata").version(__name__)
    return _attribute(name)
