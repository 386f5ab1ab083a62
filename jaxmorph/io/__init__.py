"""Meshes from files and into files: everything but the coordinates as it was."""

from jaxmorph.extend import attached

__getattr__, __dir__, __all__ = attached(__name__, __file__)
