"""Meshes of published cases, generated."""

from ._agard445 import agard445 as agard445
from ._agard445 import agard445_mode as agard445_mode
from ._naca import naca0015 as naca0015
from ._naca import naca4 as naca4
