"""Meshes from files and into files: everything but the coordinates as it was."""

from jaxmorph.extend import attached as _attached

__getattr__, __dir__, __all__ = _attached(__name__, __file__)
