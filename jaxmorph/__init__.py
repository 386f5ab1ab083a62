"""Differentiable mesh morphing in JAX: reduced radial basis functions with exact surfaces.

"The paper" in docstrings is *Mesh deformation with exact surface reconstruction using a reduced
radial basis function approach*; the copy that we worked from names no authors. The documentation's
page on theory prints the equations that docstrings cite. The paper builds on

- radial basis functions for moving meshes: de Boer, van der Schoot and Bijl, Computers and
  Structures 85, 2007;
- their reduction to few sources: Rendall and Allen, Journal of Computational Physics 228, 2009;
- Delaunay graph mapping: Liu, Qin and Xia, Journal of Computational Physics 211, 2006.

The public names stand in `_public.py`. The first use of one imports all of them but `_LATER`, and
JAX with them: the command line shows its help without. Submodules are imported when they are first
used.
"""

import importlib
import typing

if typing.TYPE_CHECKING:
    from . import cases as cases
    from . import cli as cli
    from . import integrations as integrations
    from . import io as io
    from . import plot as plot
    from ._advice.fewest_steps import Steps as Steps
    from ._advice.fewest_steps import fewest_steps as fewest_steps
    from ._advice.valid_steps import ValidSteps as ValidSteps
    from ._improve.improve import Improvement as Improvement
    from ._improve.improve import improve as improve
    from ._public import *  # noqa: F403

__version__: str

_LATER = {
    **dict.fromkeys(("Improvement", "improve"), "._improve.improve"),
    **dict.fromkeys(("Steps", "fewest_steps"), "._advice.fewest_steps"),
    "ValidSteps": "._advice.valid_steps",
}
"""Names whose modules need optimistix and lineax: not imported (0.25 s) before they are used."""

_SUBMODULES = ("cases", "cli", "integrations", "io", "plot", "shapes")


def __getattr__(name: str) -> typing.Any:
    if name in _SUBMODULES:
        return importlib.import_module(f"{__name__}.{name}")
    if name == "__version__":
        return importlib.import_module("importlib.metadata").version(__name__)
    if name in _LATER:
        globals()[name] = getattr(importlib.import_module(_LATER[name], __name__), name)
        return globals()[name]
    if name == "__all__" or not name.startswith("_"):
        public = importlib.import_module(f"{__name__}._public")
        names = {key: value for key, value in vars(public).items() if not key.startswith("_") and key != "jaxtyping"}
        globals().update(names, __all__=sorted({*names, *_LATER, *_SUBMODULES}))
        if name in globals():
            return globals()[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*__getattr__("__all__"), "__version__", *(name for name in globals() if name.startswith("__"))})
