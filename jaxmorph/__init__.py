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

import functools
import importlib
import pathlib
import re
import typing

if typing.TYPE_CHECKING:
    from . import cases as cases
    from . import cli as cli
    from . import integrations as integrations
    from . import io as io
    from . import plot as plot
    from . import shapes as shapes
    from ._public import *  # noqa: F403

__version__: str

_SUBMODULES = ("cases", "cli", "integrations", "io", "plot", "shapes")


@functools.cache
def _modules() -> dict[str, str]:
    """Lists the module of each public name, in the lines of `_public.py`."""
    lines = pathlib.Path(__file__).with_name("_public.py").read_text()
    return {name: module for module, name in re.findall(r"(?m)^from (\S+) import \w+ as (\w+)$", lines)}


def __getattr__(name: str) -> typing.Any:
    if name in _SUBMODULES:
        return importlib.import_module(f"{__name__}.{name}")
    if name == "__version__":
        return importlib.import_module("importlib.metadata").version(__name__)
    if name == "__all__":
        return sorted({*_modules(), *_SUBMODULES})
    if name.startswith("_") or name not in _modules():
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = getattr(importlib.import_module(_modules()[name], __name__), name)
    return globals()[name]


def __dir__() -> list[str]:
    return sorted({*__getattr__("__all__"), "__version__", *(name for name in globals() if name.startswith("__"))})
