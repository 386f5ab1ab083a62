"""Shapes: traced functions from positions to positions, from design variables to a new wall."""

from jaxmorph.extend import attached as _attached

__getattr__, __dir__, __all__ = _attached(__name__, __file__)
