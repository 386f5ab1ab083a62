"""Meshes of published cases, generated."""

from ._naca import naca0015 as naca0015
from ._naca import naca4 as naca4
