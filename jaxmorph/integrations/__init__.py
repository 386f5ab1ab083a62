"""Components for other frameworks, one file each; each needs the extra of its name."""

from jaxmorph.extend import attached as _attached

__getattr__, __dir__, __all__ = _attached(__name__, __file__)
